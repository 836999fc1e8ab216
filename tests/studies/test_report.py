"""Studies, verdict rows, figures and page: everything shown comes from the stored tables."""

import numpy as np
import pandas as pd
import pytest

from aoabench.report.text import interval_text, number_text, printed_text, significant
from aoabench.store.files import read_provenance, write_frame
from aoabench.studies import reproduce, statements, study
from aoabench.studies.places import Places


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    said = []
    places = Places.inside(folder)
    reproduce.reproduce(["nurminen2018"], "quick", "table1,fig1,fig2", places, said.append)
    return folder, "\n".join(said)


def test_reproduce_writes_tables_figures_page_and_verdicts(results):
    folder, said = results
    for item in ("table1", "fig1", "fig2"):
        path = folder / "tables" / f"nurminen2018_{item}.parquet"
        assert len(pd.read_parquet(path))
        origin = read_provenance(path)
        assert origin["scale"] == "quick"
        assert origin["libraries"]["numpy"]
    assert (folder / "figures" / "nurminen2018_fig1.png").stat().st_size > 10_000
    assert not (folder / "figures" / "nurminen2018_table1.png").exists(), "a table, not a figure"
    for word in ("claims that can fail", "holds", "tables", "figures", "page", "index.html"):
        assert word in said


def test_verdicts_come_from_the_tables(results, tmp_path):
    folder, _ = results
    s = study.load("nurminen2018")
    rows = statements.verdicts([s], folder).claims.set_index("id")
    assert len(rows) == len(s.claims)
    shares = rows[rows.index.str.startswith("table1/") & rows.index.str.endswith("/share")]
    assert len(shares) == 8
    assert set(shares["verdict"]) <= {"holds", "undecided"}, "quick: fewer samples"
    wrong = rows.loc["table1/model2/ae_fitted/sigma_azimuth_deg"]
    assert (wrong["verdict"], wrong["printed"]) == ("fails", "21")
    assert "N12" in wrong["reason"]
    assert rows.loc[rows["item"] == "fig4", "reason"].str.contains("not computed").all()
    nothing = statements.verdicts([s], tmp_path).claims
    assert set(nothing["verdict"]) == {"not judged"}


def test_a_changed_table_changes_the_verdict(results, tmp_path):
    folder, _ = results
    s = study.load("nurminen2018")
    frame = pd.read_parquet(folder / "tables" / "nurminen2018_table1.parquet")
    frame.loc[
        (frame["data"] == "model1") & (frame["model"] == "vmf") & (frame["quantity"] == "share"),
        "value",
    ] = 0.9
    write_frame(tmp_path / "tables" / "nurminen2018_table1.parquet", frame)
    rows = statements.verdicts([s], tmp_path).claims.set_index("id")
    assert rows.loc["table1/model1/vmf/share", "verdict"] == "fails"


def test_page_holds_printed_and_our_numbers_and_says_what_is_not_computed(results):
    folder, _ = results
    html = (folder / "report" / "index.html").read_text()
    rows = statements.verdicts([study.load("nurminen2018")], folder).claims
    for r in rows.itertuples():
        assert interval_text(r.ours, r.low, r.high) in html
    assert html.count("data:image/png;base64,") == 2
    assert "Not computed." in html
    assert "not computed" in html
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert 'src="http' not in html
    assert "N12" in html


def made_up_runs(layouts, counts=(10000,)):
    """Replications with random errors in the form that the runner gives."""
    rng = np.random.default_rng(1)
    order = study.load("nurminen2018").figures.ORDER
    names = [n for n in order if n.startswith("pf")] if len(counts) > 1 else order
    return pd.DataFrame([
        {"scenario": l, "noise": z, "estimator": n, "replication": r, "rmse_3d_m": rng.gamma(9), "filter.pf_vmf.particles": c}
        for l in layouts for z in ("ae_flip", "vmf") for c in counts for n in names for r in range(12)
    ])  # fmt: skip


def test_claims_are_found_by_the_figures_of_a_full_run():
    """Every reading in claims.yaml matches a number that figures.py can give, on tables with made-up numbers."""
    s = study.load("nurminen2018")
    names = [
        f"{a}_{m}"
        for a in ("ekf", "ukf")
        for m in ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")
    ]
    made_up = {
        "frames": pd.DataFrame([
            {"estimator": n, "frame_rpy_deg": f, "rmse_mean_3d_m": 1.0, "se_m": 0.1, "change_percent": 2.0, "change_se": 1.0}
            for n in names for f in ("[0, 0, 0]", "[90, 0, 0]")
        ]),
        "fig4": s.numbers.fig4(made_up_runs(["square_track"])),
        "layouts": s.numbers.layouts(made_up_runs([f"square_track{v}" for v in ("", "_far", "_corner", "_sides", "_upright")])),
        "adaptivity": s.numbers.adaptivity(
            made_up_runs([f"square_track{v}" for v in ("", "_far", "_corner", "_sides", "_upright")])
        ),
        "readings": s.numbers.readings(pd.concat([
            made_up_runs(["square_track"]).assign(**{"filter.pf_ae_adaptive.measurement.adaptive_about": about})
            for about in ("truth", "mean")
        ])),
        "particles": s.numbers.particles(made_up_runs(["square_track"], [3162, 10000])),
        "table1": s.numbers.table1("quick"), "fig1": s.numbers.fig1("quick"), "fig2": s.numbers.fig2("quick"),
    }  # fmt: skip
    found = {
        key
        for name, frame in made_up.items()
        for key in getattr(s.figures, f"{name}_values")(frame)
    }
    for claim in s.claims:
        for reading in claim.readings:
            assert reading.ids(found) or claim.item not in made_up, f"{claim.id} {reading.of}"


def test_figure_1_draws_the_tables_numbers(results):
    from aoabench.report import plots

    frame = pd.read_parquet(results[0] / "tables" / "nurminen2018_fig1.parquet")
    figure = study.load("nurminen2018").figures.fig1(frame)
    line = figure.axes[0].lines[0]
    assert np.array_equal(line.get_xdata(), frame["elevation_deg"])
    assert np.array_equal(line.get_ydata(), frame["azimuth_deg"])
    for axis in figure.axes:
        assert "[deg]" in axis.get_xlabel()
        assert "[deg]" in axis.get_ylabel()
    assert plots.COLOURS.keys() == plots.LABELS.keys() == plots.MARKERS.keys()


def test_box_levels_are_the_papers():
    import matplotlib.pyplot as plt

    from aoabench.report.plots import boxes

    figure, axis = plt.subplots()
    boxes(
        axis,
        [{"q05": 1, "q25": 2, "q50": 3, "q75": 4, "q95": 5, "minimum": 0, "maximum": 9}],
        [0],
        ["#000000"],
    )
    (box,) = axis.patches
    x = box.get_path().vertices[:, 0]
    assert (x.min(), x.max()) == (2, 4)
    drawn = [tuple(line.get_xdata()) for line in axis.lines]
    assert (3, 3) in drawn
    assert (0, 9) in drawn
    assert {min(d) for d in drawn} | {max(d) for d in drawn} >= {1, 5}
    plt.close(figure)


@pytest.mark.parametrize(("value", "se", "text"), [
    (0.123456, 0.0021, "0.1235 ± 0.0021"),
    (1234.5, 30.0, "1234 ± 30"),
    (0.5, 0.0, "0.5"),
    (float("nan"), float("nan"), "-"),
    (10.04, 0.96, "10.04 ± 0.96"),
    (10.04, 1.2, "10.0 ± 1.2"),
    (2281053069.0, 124579793.0, "2.28e+09 ± 1e+08"),
])  # fmt: skip
def test_numbers_show_the_digits_that_their_errors_support(value, se, text):
    assert number_text(value, se) == text


def test_a_count_without_error_has_all_its_digits():
    texts = {27648.0: "27648", -3.0: "-3", 0.0: "0", 2.25: "2.25", np.inf: "inf"}
    assert {value: interval_text(value, value, value) for value in texts} == texts


def test_significant_digits_without_an_exponent():
    given = {1665.369: "1670", 0.0001236: "0.000124", 9.996: "10", -1203.0: "-1200", 0.0: "0"}
    assert {value: significant(value, 3) for value in given} == given


def test_printed_numbers_keep_their_digits():
    assert printed_text(0.3, 0.005) == "0.30"
    assert printed_text(21, 0.5) == "21"
    assert printed_text(None, 0.0) == "-"


@pytest.mark.parametrize("name", study.names())
def test_every_erratum_names_a_test_that_exists(name):
    from pathlib import Path

    root, s = Path(__file__).parents[2], study.load(name)
    assert len({e["id"] for e in s.errata}) == len(s.errata)
    for e in s.errata:
        file, _, test = e["test"].partition("::")
        assert f"def {test}(" in (root / file).read_text(), e["id"]
