"""What the figures of a run draw: the marks against the numbers, axes, legends and footers."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

import aoabench
from aoabench.errors import UserError
from aoabench.report.runs import look
from aoabench.report.runs.choice import Asked
from aoabench.report.runs.distribution import density_of
from aoabench.report.runs.drawing import plot, prepare

ONE = ("noise=vmf", "noise.sigma_deg=5")


def panels(figure):
    """The visible axes of the panels, by title."""
    axes = [a for a in figure.axes if a.get_visible() and a.get_label() != "<colorbar>"]
    return {axis.get_title(loc="left"): axis for axis in axes}


def footer(figure):
    return " ".join(figure.get_supxlabel().split())


def names(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def segments(axis):
    """The ends of the vertical error bars of an axis: one array (N, 2) for each group."""
    found = [c for c in axis.collections if type(c).__name__ == "LineCollection"]
    return [np.array([s[:, 1] for s in c.get_segments()]) for c in found]


def test_a_curve_and_its_bars_are_the_estimates(sweep):
    figure = aoabench.plot(sweep)
    assert isinstance(figure, Figure)
    table = prepare(sweep, Asked()).table
    assert list(panels(figure)) == ["noise = ae_flip", "noise = vmf"]
    for title, axis in panels(figure).items():
        for group, bars in zip(("ekf_vmf", "ekf_ae_nominal"), segments(axis)):
            mine = table[(table["panel"] == title) & (table["group"] == group)]
            (line,) = [one for one in axis.lines if one.get_label() == group]
            np.testing.assert_array_equal(line.get_ydata(), mine["value"])
            np.testing.assert_allclose(line.get_xdata(), mine["noise.sigma_deg"], rtol=0.05)
            np.testing.assert_allclose(bars, mine[["low", "high"]])
        assert axis.get_ylim()[0] == 0
    assert names(figure) == ["ekf_vmf", "ekf_ae_nominal"]
    assert axis.get_xlabel() == "noise.sigma [deg]"
    assert footer(figure) == (
        "N = 7 replications of each estimator and cell; synthetic; scenario square_track; noise "
        "ae_flip, vmf; seed 1. Bars: 95 % intervals of each point alone, over replications."
    )


def test_groups_differ_in_colour_line_and_marker(sweep):
    (one, other) = [line for line in panels(aoabench.plot(sweep))["noise = vmf"].lines
                    if not line.get_label().startswith("_")]  # fmt: skip
    assert one.get_color() != other.get_color()
    assert one.get_linestyle() != other.get_linestyle()
    assert one.get_marker() != other.get_marker()


def test_texts_are_places_without_a_line(sweep):
    figure = aoabench.plot(sweep, over="noise", where="noise.sigma_deg=5")
    (axis,) = panels(figure).values()
    assert [label.get_text() for label in axis.get_xticklabels()] == ["ae_flip", "vmf"]
    assert {line.get_linestyle() for line in axis.lines} == {"None"}


def test_a_curve_over_decades_has_a_logarithmic_axis(frame):
    whole = frame({"a": [1.0, 2.0], "b": [1e4, 2e4]}, x=[1, 2, 3])
    (axis,) = panels(plot(whole)).values()
    assert axis.get_yscale() == "log"
    (axis,) = panels(plot(whole, where="estimator=a")).values()
    assert (axis.get_yscale(), axis.get_xscale()) == ("linear", "linear")


def test_parameters_of_even_ratios_have_a_logarithmic_axis(frame):
    (axis,) = panels(plot(frame({"a": [1.0, 2.0]}, x=[1, 10, 100]))).values()
    assert axis.get_xscale() == "log"
    assert [label.get_text() for label in axis.get_xticklabels()] == ["1", "10", "100"]


def test_an_estimator_without_values_is_named(frame):
    whole = frame({"a": [1.0, 2.0], "b": [np.nan, np.nan], "c": [1.0, np.nan]}, x=[1, 2])
    figure = plot(whole)
    assert names(figure) == ["a", "b (no value)", "c"]
    assert footer(figure).endswith("Replications without a value: b 4 of 4, c 2 of 4.")
    assert "2 of 6 points have no interval: too few replications." in footer(figure)
    (axis,) = panels(plot(whole, kind="box", where="x=1")).values()
    assert [text.get_text() for text in axis.texts] == ["no value"]


def test_a_heat_map_has_the_means_at_their_places(frame):
    whole = frame({"a": [1.0, 3.0]}, x=[1, 2], y=[5, 10, 15])
    whole["rmse_3d_m"] *= whole["x"] + whole["y"]
    whole = whole[(whole["x"] == 1) | (whole["y"] != 10)]  # a field that was not run
    figure = plot(whole, over=["x", "y"])
    (axis,) = panels(figure).values()
    (image,) = [c for c in axis.get_children() if isinstance(c, AxesImage)]
    grid = np.ma.filled(image.get_array(), np.nan)
    np.testing.assert_allclose(grid, [[12, 14], [22, np.nan], [32, 34]])
    assert [t.get_text() for t in axis.texts] == ["12", "14", "22", "32", "34"]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("x", "y")
    figure = plot(whole)  # more values come first
    (axis,) = panels(figure).values()
    assert {axis.get_xlabel(), axis.get_ylabel()} == {"x", "y"}


def test_a_distribution_has_its_points_and_band(sweep):
    drawing = prepare(sweep, Asked("cdf", "error_xy_m"), ONE)
    figure = plot(sweep, "cdf", "error_xy_m", where=ONE)
    (axis,) = panels(figure).values()
    steps = pd.read_parquet(sweep / "steps.parquet")
    (cell,) = set(aoabench.load(sweep).query("noise == 'vmf' and `noise.sigma_deg` == 5")["cell"])
    assert len(axis.lines) == len(axis.collections) == 2
    for line, name in zip(axis.lines, ("ekf_vmf", "ekf_ae_nominal")):
        error = np.sort(steps[(steps["cell"] == cell) & (steps["estimator"] == name)]["error_xy_m"])
        np.testing.assert_array_equal(line.get_xdata()[1:-1], error)
        np.testing.assert_allclose(line.get_ydata()[1:-1], np.arange(1, 36) / 35)
        assert line.get_label() == f"{name}: median {np.median(error):.3g}"
    assert "N = 7 replications (35 fixes) of each estimator; synthetic" in footer(figure)
    assert drawing.footer[1] == "Bands: 95 % intervals of each point alone, over replications."


def test_one_replication_has_no_band(frame):
    figure = plot(frame({"a": [1.0], "b": [2.0]}))
    assert "N = 1 replication of each estimator" in footer(figure)
    assert "No bands: they need two replications" in footer(figure)


def test_heavy_tails_have_a_logarithmic_axis_and_outliers_are_counted(frame):
    heavy = frame({"a": np.logspace(-1, 2, 50), "b": np.linspace(0.1, 0.2, 50)})
    for kind in ("cdf", "box", "violin"):
        figure = plot(heavy, kind)
        (axis,) = panels(figure).values()
        assert axis.get_xscale() == "log"
        assert "Logarithmic axis, as the largest 95 % quantile exceeds 10 times" in footer(figure)
        x = np.append(np.linspace(0.5, 1.5, 99), 1000.0)
        figure = plot(frame({"a": x, "b": x[:-1]}), kind)
        (axis,) = panels(figure).values()
        assert axis.get_xscale() == "linear"
        assert axis.get_xlim()[1] < 3
        assert "1 value lies beyond the axis." in footer(figure)
        if kind != "cdf":
            assert [text.get_text() for text in axis.texts] == ["max 1e+03 \u2192"]


def test_a_box_is_the_quantiles(frame):
    x = np.random.default_rng(2).gamma(3.0, size=200)
    (axis,) = panels(plot(frame({"a": x}), "box")).values()
    q05, q25, q50, q75, q95 = np.quantile(x, [0.05, 0.25, 0.5, 0.75, 0.95])
    (box,) = axis.patches
    assert np.unique(box.get_path().vertices[:, 0]) == pytest.approx([q25, q75])
    ends = sorted({tuple(line.get_xdata()) for line in axis.lines if len(line.get_xdata()) == 2})
    assert (q50, q50) in [pytest.approx(end) for end in ends]
    assert [pytest.approx((a, b)) for a, b in ((q05, q25), (q75, q95))] == [
        sorted(end) for end in (axis.lines[0].get_xdata(), axis.lines[1].get_xdata())
    ]


def test_a_violin_is_a_kernel_s_density():
    from scipy import stats

    x = np.random.default_rng(2).gamma(3.0, size=200)
    at, half = density_of(x, (0.0, 100.0), log=False)
    wanted = stats.gaussian_kde(x)(at)
    np.testing.assert_allclose(half, 0.4 * wanted / wanted.max(), rtol=1e-9)
    assert (at[0], at[-1]) == (x.min(), x.max())
    at, half = density_of(x, (0.0, 100.0), log=True)
    wanted = stats.gaussian_kde(np.log10(x))(np.log10(at))
    np.testing.assert_allclose(half, 0.4 * wanted / wanted.max(), rtol=1e-9)
    at, half = density_of(np.ones(5), (0.0, 2.0), log=False)
    assert at.tolist() == [1.0, 1.0]


def test_errors_over_time_have_a_band_of_replications(sweep):
    figure = plot(sweep, "time", where=(*ONE, "estimator=ekf_vmf"))
    (axis,) = panels(figure).values()
    table = prepare(sweep, Asked("time"), (*ONE, "estimator=ekf_vmf")).table
    (line,) = axis.lines
    np.testing.assert_array_equal(line.get_xydata(), table[["x", "median"]])
    band = axis.collections[0].get_paths()[0].vertices
    assert set(table["low"]) | set(table["high"]) == set(band[:, 1])
    assert axis.get_xlabel() == "time [s]"
    assert "Lines: median over replications; bands: 5 to 95 % of them." in footer(figure)


def test_a_recording_says_so(recorded):
    figure = plot(recorded(True), "time")
    (axis,) = panels(figure).values()
    assert len(axis.lines) == 4
    assert names(figure) == ["ls_lines", "vmf_ml"]
    assert footer(figure) == (
        "N = 2 tracks of each estimator; recorded. A line is a track of the recording."
    )
    assert "N = 2 tracks (15 fixes) of each estimator" in footer(plot(recorded(True), "cdf"))


def test_pairs_are_points_about_the_diagonal(sweep):
    figure = plot(sweep, baseline="ekf_vmf", where=ONE)
    (axis,) = panels(figure).values()
    frame = aoabench.load(sweep).query("noise == 'vmf' and `noise.sigma_deg` == 5")
    wide = frame.pivot(index="replication", columns="estimator", values="rmse_3d_m")
    (points,) = axis.collections
    np.testing.assert_array_equal(points.get_offsets(), wide[["ekf_vmf", "ekf_ae_nominal"]])
    assert axis.get_xlim() == axis.get_ylim()
    assert axis.get_xlabel() == "ekf_vmf: RMSE 3-D [m]"
    text = axis.texts[0].get_text()
    smaller = int((wide["ekf_ae_nominal"] < wide["ekf_vmf"]).sum())
    assert text.endswith(f"smaller in {smaller} of 7")
    row = aoabench.compare(sweep, "ekf_vmf")
    row = row[(row["cell"] == frame["cell"].iloc[0])].iloc[0]
    assert f"mean {row['change']:+.0f} % [" in text


def test_pairs_that_are_equal_or_lacking_are_said(frame):
    x = [1.0, 2.0, 3.0]
    figure = plot(frame({"a": x, "b": x, "c": [np.nan] * 3}), baseline="a")
    texts = {title: axis.texts[0].get_text() for title, axis in panels(figure).items()}
    assert texts == {"b": "equal in all 3", "c": "no pairs: none of 3 replications has both values"}
    (axis,) = panels(plot(frame({"a": [1.0], "b": [2.0]}), "pairs")).values()
    assert axis.texts[0].get_text() == "change unknown, too few pairs\nsmaller in 0 of 1"


@pytest.mark.parametrize("kind", ["curve", "cdf", "box", "violin"])
def test_thirty_estimators_have_room(frame, kind):
    values = {f"an_estimator_{i:02d}": [1.0 + i, 2.0 + i] for i in range(30)}
    figure = plot(frame(values, x=[1, 2]), kind, where="x=1" if kind != "curve" else ())
    inches = figure.get_size_inches()
    boxes = [legend.get_window_extent() for legend in figure.legends]
    boxes += [axis.get_tightbbox() for axis in panels(figure).values()]
    for box in boxes:
        low, high = (np.array(end) / figure.dpi for end in (box.min, box.max))
        assert (low >= -0.01).all()
        assert (high <= inches + 0.01).all()
    assert len(names(figure)) == (30 if kind in ("curve", "cdf") else 0)


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("mean RMSE 3-D [m]", ["mean RMSE 3-D [m]"]),
        ("estimator.df_area_of_ties.azimuth_sigma [deg]", ["estimator.df_area_of_ties.", "azimuth_sigma [deg]"]),
        ("x" * 50, ["x" * 50]),
        ("a 3.5 ..b ", ["a 3.5 ..b"]),
        ("", [""]),
    ],
)  # fmt: skip
def test_long_labels_are_broken_at_spaces_and_dots(text, lines):
    assert look.broken(text, 30).splitlines() == (lines if text else [])


def test_labels_of_neighbouring_panels_do_not_meet(frame):
    name = "estimator.an_estimator_of_mine.azimuth_sigma_deg"
    figure = plot(frame({"a": [1.0, 2.0]}, **{name: [1, 2]}, noise=list("abc")), over=name)
    labels = [axis.xaxis.label.get_window_extent() for axis in panels(figure).values()]
    assert all(one.x1 < other.x0 for one, other in pairwise(labels))


def test_too_many_colours_are_one_line(frame):
    values = {f"e{i}": [1.0, 2.0] for i in range(41)}
    with pytest.raises(UserError, match="41 colours for the values of estimator: at most 40 are"):
        plot(frame(values))


@pytest.mark.parametrize("kind", ["cdf", "box", "violin", "curve", "heatmap", "pairs"])
def test_of_too_many_panels_the_first_are_drawn_and_the_foot_says_so(frame, kind):
    swept = {"noise": list("abcdefghijklm"), "x": [1, 2], "y": [1, 2]}
    number = {"curve": 2, "heatmap": 3}.get(kind, 1)
    whole = frame({"a": [1.0, 2.0], "b": [2.0, 1.0]}, **dict(list(swept.items())[:number]))
    given = ["estimator=a"] if kind == "heatmap" else []
    figure = plot(
        whole, kind, over={"curve": "x", "heatmap": ["x", "y"]}.get(kind, ()), where=given
    )
    assert len(panels(figure)) == 12
    said = "12 of 13 panels are drawn; choose others with where KEY=VALUE[,VALUE], KEY one of "
    assert said + ("estimator, noise." if kind == "pairs" else "noise.") in footer(figure)
    figure = plot(whole, kind, where=[*given, "noise=m,l"])
    assert "panels are drawn" not in footer(figure)
    (last,) = [title for title in panels(figure) if title.endswith("m")]
    assert last


def test_panels_that_do_not_fit_are_not_read(frame):
    """The axes and the table are those of the panels that are drawn."""
    whole = frame({"a": [1.0, 2.0]}, noise=list("abcdefghijklm"))
    whole.loc[whole["noise"] == "m", "rmse_3d_m"] = 1e9
    table = prepare(whole, Asked("box")).table
    assert len(table) == 12
    assert table["maximum"].max() == 2


def test_the_figure_is_not_pyplot_s(frame):
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    plot(frame({"a": [1.0, 2.0]}))
    assert plt.get_fignums() == before


def test_limits_hold_negative_values():
    table = pd.DataFrame({"n": [3], "minimum": [-2.0], "q05": [-1.5], "q50": [0.0], "q95": [1.0], "maximum": [1.2]})  # fmt: skip
    assert not look.is_heavy(table)
    assert look.limits(table, log=False, whole=True) == pytest.approx((-2.0, 1.26))


def test_a_line_of_the_foot_does_not_begin_with_the_end_of_a_clause():
    text = "N = 20 replications (20,000 fixes) of each estimator; scenario bs_grid; seed 1."
    for letters in range(20, 90):
        lines = look._lines(text, letters)
        assert " ".join(lines) == text
        assert not {line.split()[0] for line in lines} & {"1.", "bs_grid;"}
        assert max(map(len, lines)) <= letters
