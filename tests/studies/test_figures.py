"""What the figures draw is what their tables hold, in one style; the committed tables all draw."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from aoabench.report import animation, plots
from aoabench.report.text import number_text
from aoabench.store.files import read_provenance, write_frame
from aoabench.studies import page, reproduce, sections, statements, stored, study
from aoabench.studies.places import Places

RESULTS = Path(__file__).parents[2] / "results"
COMMITTED = [
    (s, item)
    for s in map(study.load, study.names())
    for item in s.items
    if item.figure and study.table_path(RESULTS, s, item).exists()
]
IDS = [f"{s.name}_{item.name}" for s, item in COMMITTED]
PURE = (
    "iterations",
    "particles",
    "NEES",
    "square root of the CRB",
    "share",
    "P(",
    "RMSE of the mean / RMSE of A",
    "ratio",
    "R_",  # R_sigma and R_d
    "misfit in units",
    "deviation of B over that of A",
)


@pytest.fixture
def figure_of():
    """Draws an item from its committed table, in the house style."""
    with plt.style.context(str(plots.STYLE)):
        yield lambda s, item: getattr(s.figures, item.name)(stored.table(RESULTS, s, item))
    plt.close("all")


def find(name):
    s = study.load(name.split("_")[0])
    return s, next(i for i in s.items if i.name == name.split("_")[1])


def lines_of(axis, colour):
    return [line for line in axis.lines if to_hex(line.get_color()).upper() == colour]


@pytest.mark.parametrize(("s", "item"), COMMITTED, ids=IDS)
def test_every_committed_table_draws_with_units_and_the_one_bound(s, item, figure_of):
    figure = figure_of(s, item)
    assert plots.COLUMN - 0.2 <= figure.get_figwidth() <= plots.PAGE
    labels = [figure.get_supxlabel(), figure.get_supylabel()]
    for axis in figure.axes:
        labels += [axis.get_xlabel(), axis.get_ylabel()]
        for line in axis.lines:
            if "CRB" in str(line.get_label()):
                assert to_hex(line.get_color()) == "#000000"
                assert line.get_linestyle() == "--"
                assert line.get_linewidth() == plots.BOUND["lw"]
    for label in filter(None, labels):
        assert re.search(r"\[.+\]", label) or any(word in label for word in PURE), label


def test_figure_6_draws_rmse_and_bound_of_its_table(figure_of):
    s, item = find("le2021_fig6")
    frame = stored.table(RESULTS, s, item)
    left, middle, _ = figure_of(s, item).axes
    for name in s.figures.NAMES:
        style = s.figures.STYLES[name]
        rows = frame[frame["estimator"] == name].sort_values("sigma_deg")
        assert any(
            np.array_equal(line.get_ydata(), rows["rmse_m"])
            for line in lines_of(left, style["color"].upper())
        ), name
    (bound,) = [line for line in left.lines if line.get_label() == plots.BOUND_LABEL]
    assert np.array_equal(
        bound.get_ydata(), frame[frame["estimator"] == "ls"].sort_values("sigma_deg")["bound_m"]
    )
    (one,) = [
        line
        for line in middle.lines
        if line.get_linestyle() == "--" and to_hex(line.get_color()) == "#000000"
    ]
    assert set(one.get_ydata()) == {1}


def test_particles_draws_the_mean_rmse_of_its_table(figure_of):
    s, item = find("nurminen2018_particles")
    frame = stored.table(RESULTS, s, item)
    for axis, noise in zip(figure_of(s, item).axes, ("ae_flip", "vmf")):
        for model, colour in plots.COLOURS.items():
            rows = frame[(frame["noise"] == noise) & (frame["estimator"] == f"pf_{model}")]
            drawn = lines_of(axis, colour)[0]
            assert np.array_equal(drawn.get_xdata(), rows["particles"])
            assert np.array_equal(drawn.get_ydata(), rows["rmse_mean_3d_m"])


def test_nees_draws_its_table(figure_of):
    s, item = find("lu2019_nees")
    frame = stored.table(RESULTS, s, item)
    axis = figure_of(s, item).axes[0]
    rows = frame[
        (frame["scenario"] == "indoor_map_model")
        & (frame["an_sigma_m"] == frame["an_sigma_m"].min())
    ]
    for line, name in zip(axis.lines, ("ekf_toa_aoa", "ekf_aoa")):
        assert np.array_equal(line.get_ydata(), rows[rows["estimator"] == name]["nees"])


def test_the_leaderboard_is_in_the_order_of_its_rmse_and_says_intervals():
    s = study.load("leaderboard")
    for item in s.items:
        frame = stored.table(RESULTS, s, item)
        for _, rows in frame.groupby("setting"):
            assert rows["rmse_m"].is_monotonic_increasing
            others = rows[rows["rank"] > 1]
            assert (others["above_low"] <= others["above_percent"]).all()
            assert (others["above_percent"] <= others["above_high"]).all()
            (best,) = rows[rows["estimator"] == rows["best"]].to_dict("records")
            assert (best["rank"], best["kind"] != "limit") == (1, True)
        shown = stored.read(s, item, RESULTS).shown
        assert list(shown["estimator"]) == list(frame["estimator"])
        marked = shown[shown["above the best [%], 95 % interval"] == "best"]
        assert list(marked["rank"]) == ["1"] * frame["setting"].nunique()


@pytest.fixture
def results(tmp_path):
    for name in ("le2021_fig5", "le2021_fig7", "nurminen2018_fig1"):
        write_frame(
            tmp_path / "tables" / f"{name}.parquet",
            pd.read_parquet(RESULTS / "tables" / f"{name}.parquet"),
        )
    return tmp_path


def test_a_table_of_another_version_is_one_line_and_not_computed(results):
    path = results / "tables" / "le2021_fig7.parquet"
    reproduce.draw(["le2021"], Places.inside(results), lambda _: None)
    assert (results / "figures" / "le2021_fig7.png").exists()
    write_frame(path, pd.read_parquet(path).drop(columns=["iterations", "more_iterations"]))
    (results / "tables" / "nurminen2018_fig1.parquet").write_bytes(b"PAR1 torn")
    said = []
    reproduce.draw(["le2021", "nurminen2018"], Places.inside(results), said.append)
    told = [line for line in said if "another version" in line and "\n" not in line]
    assert len(told) == 2
    assert told[0].startswith(
        "le2021 fig7: not computed: the table is of another version (KeyError"
    )
    assert "aoabench reproduce le2021 --only fig7" in told[0]
    assert not (results / "figures" / "le2021_fig7.png").exists(), "no old figure stays"
    rows = (
        pd.read_parquet(results / "report" / "verdicts.parquet")
        .set_index(["study", "item"])
        .sort_index()
    )
    fig7 = rows.loc[("le2021", "fig7")]
    assert set(fig7["verdict"]) == {"not judged"}
    assert set(fig7["reason"]) == {"the table is of another version"}
    assert fig7["ours"].isna().all()
    html = (results / "report" / "index.html").read_text()
    assert html.count("Not computed (the table is of another version).") == 2


def test_a_table_with_a_flipped_bit_is_not_read(results):
    path = results / "tables" / "le2021_fig7.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 8] ^= 1  # in a page
    path.write_bytes(data)
    assert stored.read(*find("le2021_fig7"), results).problem == stored.OTHER_VERSION


def test_a_deleted_table_takes_its_numbers_and_figure_from_the_page(results):
    reproduce.draw(["nurminen2018"], Places.inside(results), lambda _: None)
    html = (results / "report" / "index.html").read_text()
    number = number_text(
        stored.read(*find("nurminen2018_fig1"), results).values["fig1/growth_at_pole"][0].value,
        0.0,
    )
    assert f">{number}<" in html
    images = html.count("data:image/png")
    (results / "tables" / "nurminen2018_fig1.parquet").unlink()
    said = []
    reproduce.draw(["nurminen2018"], Places.inside(results), said.append)
    html = (results / "report" / "index.html").read_text()
    assert f">{number}<" not in html
    assert html.count("data:image/png") == images - 1, (
        "the old figure lies there still, but is of no table"
    )
    assert any(line.startswith("nurminen2018: not computed; ") and "fig1" in line for line in said)


def test_the_page_copes_without_any_table_and_without_a_bench(tmp_path):
    everything = [study.load(name) for name in study.names()]
    html = page.write(
        everything, statements.verdicts(everything, tmp_path), Places.inside(tmp_path)
    ).read_text()
    assert "data:image" not in html
    assert html.count("Not computed.") == sum(len(s.items) for s in everything) + 1
    write_frame(tmp_path / "bench" / "bench.parquet", pd.DataFrame({"what": ["a"], "value": [1.0]}))
    html = page.write(
        everything, statements.verdicts(everything, tmp_path), Places.inside(tmp_path)
    ).read_text()
    assert "Not computed (the table is of another version)." in html


@pytest.mark.parametrize(("form", "head"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_in_other_formats_are_the_same_each_time(results, form, head):
    path, contents = results / "figures" / f"nurminen2018_fig1.{form}", []
    for _ in range(2):
        assert stored.draw(*find("nurminen2018_fig1"), Places.inside(results), ("png", form)) == ""
        contents.append(path.read_bytes())
    assert contents[0].startswith(head)
    assert contents[0] == contents[1]
    assert path.with_suffix(".png").exists()


def test_an_embedded_figure_is_smaller_and_looks_the_same(results):
    import base64
    import io

    from PIL import Image

    stored.draw(*find("nurminen2018_fig1"), Places.inside(results))
    path = results / "figures" / "nurminen2018_fig1.png"
    data = base64.b64decode(sections.embedded(path))
    assert len(data) < path.stat().st_size
    small, large = (
        np.asarray(Image.open(f).convert("RGB"), dtype=float) for f in (io.BytesIO(data), path)
    )
    assert small.shape == large.shape
    assert np.sqrt(np.mean((small - large) ** 2)) < 4  # of 255


READINGS = """# Title

## H *a*

One <b>
two `x<y` **bold** [words](a.md) ![picture](b.png) <https://a.b>

| a | b |
|---|---|
| `1` | 2 |

- first
  goes on
- second

### Third

    indented <i>
"""


def test_readings_become_html_with_shifted_headings_and_links_without_targets():
    html = sections.readings(READINGS)
    assert "Title" not in html
    assert "<h1" not in html
    assert "<h4>H <em>a</em></h4>" in html
    assert "<h5>Third</h5>" in html
    assert (
        "<p>One &lt;b&gt;\ntwo <code>x&lt;y</code> <strong>bold</strong> words picture https://a.b</p>"
        in html
    )
    assert '<div class="scroll"><table>\n<thead>\n<tr>\n<th>a</th>\n<th>b</th>' in html
    assert "<td><code>1</code></td>\n<td>2</td>" in html
    assert "</table></div>" in html
    assert "<li>first\ngoes on</li>\n<li>second</li>" in html
    assert "<pre><code>indented &lt;i&gt;" in html


@pytest.mark.parametrize("text", [
    "<script>alert(1)</script>",
    "a <img src=x onerror=alert(1)> b",
    "[words](javascript:alert(1))",
    "![<script>](x.png)",
    "| <script> |\n|---|\n| <b onclick=x> |",
    "```html\n<script>\n```",
    "# <script>",
    "## <script>",
])  # fmt: skip
def test_nothing_in_readings_is_code_for_the_browser(text):
    html = sections.readings(text)
    assert not re.search(r"<(script|img|b|a)\b", html)
    assert "href" not in html


def test_every_study_has_readings_with_closed_tags():
    for name in study.names():
        html = sections.readings(
            (study.load(name).folder / "README.md").read_text(encoding="utf-8")
        )
        assert "<h4>" in html
        for tag in ("p", "ul", "ol", "li", "table", "tr", "td", "th", "h4", "code", "pre", "div"):
            assert len(re.findall(rf"<{tag}\b", html)) == html.count(f"</{tag}>"), f"{name} {tag}"


def traces():
    files = sorted((RESULTS / "tables").glob("track-*.parquet"))
    assert len(files) == 2
    anchors = read_provenance(files[0])["config"]["scenario"]["anchors"]
    return {f.stem.split("-")[1]: pd.read_parquet(f) for f in files}, anchors


def test_the_animation_draws_the_traces_and_their_ellipses():
    found, anchors = traces()
    step = 30
    axis = animation.frame(found, step, anchors).axes[0]
    for name, trace in found.items():
        model = name.removeprefix("ekf_")
        (line,) = [x for x in axis.lines if x.get_label() == f"EKF-{plots.LABELS[model]}"]
        assert np.array_equal(line.get_xdata(), trace["x_m"][step - 8 : step + 1])
        assert np.array_equal(line.get_ydata(), trace["y_m"][step - 8 : step + 1])
    row = next(iter(found.values())).iloc[step]
    P = np.array(
        [[row["sigma_x_m"] ** 2, row["cov_xy_m2"]], [row["cov_xy_m2"], row["sigma_y_m"] ** 2]]
    )
    d = animation.ellipse(row) - [row["x_m"], row["y_m"]]
    assert np.einsum("ni,ij,nj->n", d, np.linalg.inv(P), d) == pytest.approx(5.991, rel=1e-3)
    plt.close("all")


def test_the_animation_is_written(tmp_path):
    found, anchors = traces()
    path = animation.write(
        {name: trace[:3] for name, trace in found.items()}, anchors, tmp_path / "a.gif"
    )
    assert path.read_bytes().startswith(b"GIF89a")
    assert (RESULTS / "figures" / "track.gif").stat().st_size < 700_000
