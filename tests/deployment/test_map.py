"""The map of `locate`: what is drawn where."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Ellipse
from matplotlib.quiver import Quiver

from aoabench.deployment import figures, fixes, located
from aoabench.deployment.request import Request
from aoabench.report import located as report
from tests.deployment.conftest import ANCHORS, POINTS, rows_of

mpl.use("Agg")


@pytest.fixture
def drawn(room, log):
    """The function (changed frame, more surroundings) -> axis of the map."""
    asked = Request(str(log(rows_of(POINTS))), str(room / "anchors.csv")).asked()
    found = located.locate(asked)
    anchors = asked.scenario.true_anchors

    def draw(change=lambda frame: frame, **more):
        place = anchors.position[0, 0], asked.scenario.anchors_file.ids, anchors.rotation[0, 0]
        figure = report.figure(change(found.frame), report.Surroundings(*place, **more), "title")
        return figure.axes[0], found.frame

    return draw


def of(axis, kind, label=None):
    artists = [*axis.collections, *axis.patches]
    return [a for a in artists if type(a) is kind and label in (None, a.get_label())]


def test_fixes_ellipses_anchors_and_walls_are_where_they_are(drawn):
    walls = np.array([[[0, 0], [12, 0]], [[12, 0], [12, 6.0]]])
    axis, frame = drawn(walls=walls)
    (lines,) = of(axis, LineCollection)
    assert np.array_equal(lines.get_segments(), walls)
    (anchors,) = of(axis, PathCollection, "anchor")
    assert np.array_equal(anchors.get_offsets(), np.array([a[:2] for a in ANCHORS.values()], float))
    (arrows,) = of(axis, Quiver)
    facing = np.radians([a[3] for a in ANCHORS.values()])
    assert np.allclose(np.stack([arrows.U, arrows.V]), [np.cos(facing), np.sin(facing)], atol=1e-12)
    ellipses = of(axis, Ellipse)
    for ellipse, row in zip(ellipses, frame.to_dict("records"), strict=True):
        assert ellipse.center == (row["x_m"], row["y_m"])
        assert ellipse.width == pytest.approx(2 * 2.4477 * row["sigma_major_m"], rel=1e-4)
        assert ellipse.angle == row["ellipse_deg"]
    (points,) = of(axis, PathCollection, "fix")
    assert np.allclose(points.get_offsets(), frame[["x_m", "y_m"]], atol=1e-12)
    assert points.get_array().tolist() == [1, 2, 3, 4]
    bar = axis.figure.axes[1]
    axis.figure.draw_without_rendering()
    assert bar.get_ylabel() == "fix"
    assert [float(t.get_text()) for t in bar.get_yticklabels()] == [1, 2, 3, 4]
    assert {t.get_text() for t in axis.texts} == set(ANCHORS)


def test_the_colour_is_time_if_it_is_known(drawn):
    axis, _ = drawn(lambda frame: frame.assign(time_s=[100.0, 100.5, 102.0, 110.0]))
    (points,) = of(axis, PathCollection, "fix")
    assert points.get_array().tolist() == [0, 0.5, 2, 10]
    assert axis.figure.axes[1].get_ylabel() == "time [s]"


def test_rejected_and_diverged_fixes_are_crosses_and_far_ones_are_counted(drawn):
    def change(frame):
        frame = frame.assign(outcome=["ok", "diverged", "rejected", "ok"])
        frame.loc[2, ["x_m", "y_m"]] = np.nan
        frame.loc[3, ["x_m", "y_m"]] = 500.0
        return frame

    axis, frame = drawn(change, rejected=np.array([[5.0, 3.0]]))
    (rejected,), (diverged,) = (of(axis, PathCollection, name) for name in ("rejected", "diverged"))
    assert rejected.get_offsets().tolist() == [[5, 3]]
    assert np.allclose(diverged.get_offsets(), frame.loc[[1], ["x_m", "y_m"]], atol=1e-12)


def test_each_tag_has_its_marker_and_each_track_its_line(drawn):
    axis, _ = drawn(lambda frame: frame.assign(tag=["T10", "T2", "T10", "T2"], track=[0, 1, 0, 1]))
    assert [p.get_label() for p in of(axis, PathCollection)][:2] == ["tag T2", "tag T10"]
    tracks = [line for line in axis.lines if line.get_linestyle() == "-"]
    assert [len(line.get_xdata()) for line in tracks] == [2, 2]


def test_ten_tags_have_a_colour_each_a_name_and_ellipses(drawn):
    import pandas as pd

    tags = [f"T{i}" for i in range(10)]

    def change(frame):
        many = pd.concat([frame] * 250, ignore_index=True)
        return many.assign(tag=tags * 100, track=list(range(10)) * 100, x_m=list(range(10)) * 100)

    axis, _ = drawn(change)
    points = {p.get_label(): p for p in of(axis, PathCollection) if p.get_label() in
              [f"tag {tag}" for tag in tags]}  # fmt: skip
    assert len(points) == 10
    assert len({tuple(p.get_edgecolor()[0]) for p in points.values()}) == 10
    assert {ellipse.center[0] for ellipse in of(axis, Ellipse)} == set(range(10))
    texts = [text.get_text() for text in axis.figure.legends[0].get_texts()]
    assert set(points) <= set(texts)


def test_the_title_names_the_log_and_counts(room, log, tmp_path, monkeypatch):
    titles = []
    monkeypatch.setattr(report, "figure", lambda frame, around, title: titles.append(title))
    monkeypatch.setattr(figures.plots, "save", lambda make, path: make())
    path = log(
        [*rows_of(POINTS, "T1"), *rows_of(POINTS, "T2")], "fix,tag,anchor,azimuth_deg,elevation_deg"
    )
    asked = Request(str(path), str(room / "anchors.csv")).asked()
    figures.write(located.locate(asked), tmp_path / "out.csv")
    assert titles == ["log.csv: 8 fixes of 2 tags, robust_ml"]


def test_a_map_without_any_fix(drawn):
    axis, _ = drawn(lambda frame: frame.assign(**dict.fromkeys(fixes._GIVEN[:3], np.nan)))
    assert of(axis, PathCollection, "anchor")
    assert len(axis.figure.axes) == 1


def test_far_fixes_do_not_set_the_scale(drawn):
    import pandas as pd

    def change(frame):
        far = frame.iloc[:1].assign(x_m=1e4, y_m=1e4)
        return pd.concat([*[frame] * 60, far], ignore_index=True)

    axis, _ = drawn(change)
    assert axis.get_xlim()[1] < 20
    legend = axis.figure.legends[0]
    assert "beyond the map: 1" in [t.get_text() for t in legend.get_texts()]
