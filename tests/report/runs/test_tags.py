"""Figures that tell the tags of a recording apart."""

import numpy as np
import pandas as pd
import pytest

from aoabench.errors import UserError
from aoabench.report.runs.choice import Asked
from aoabench.report.runs.drawing import prepare
from aoabench.report.runs.source import read
from aoabench.store import tables


@pytest.fixture(scope="module")
def steps(recorded):
    """The errors of the steps by estimator and tag."""
    frame = pd.read_parquet(recorded(True) / "steps.parquet")
    return {key: mine["error_3d_m"].to_numpy() for key, mine in frame.groupby(["estimator", "tag"])}


def test_a_distribution_has_the_fixes_of_each_tag(recorded, steps):
    drawing = prepare(recorded(True), Asked("box", by="tag"))
    table = drawing.table
    assert (drawing.choice.panels, drawing.choice.metric) == (("estimator",), "error_3d_m")
    assert len(table) == len(steps) == 4
    for row in table.to_dict("records"):
        mine = steps[row["panel"], row["group"]]
        assert row["n"] == len(mine)
        assert row["maximum"] == pytest.approx(mine.max(), rel=1e-6)
        assert row["q50"] == pytest.approx(np.median(mine), rel=1e-6)
    assert drawing.footer[0] == "N = 1 track (6 to 9 fixes) of each estimator and tag; recorded."
    band = prepare(recorded(True), Asked("cdf", by="tag")).footer[1]
    assert band == "Bands: 95 % intervals of each point alone, clustered by position."


def test_a_course_has_the_steps_of_each_tag(recorded, steps):
    drawing = prepare(recorded(True), Asked("time", by="tag"))
    for (panel, group), mine in drawing.table.groupby(["panel", "group"]):
        np.testing.assert_array_equal(mine["median"], steps[panel, group])
        np.testing.assert_allclose(mine["x"], 0.1 * np.arange(len(mine)), atol=1e-9)
    assert "A line is a track of the recording." in drawing.footer


def test_tags_are_on_an_axis_or_chosen(recorded, steps):
    whole = prepare(recorded(True), Asked(over=("tag",)))
    assert (whole.choice.kind, whole.choice.by) == ("curve", "estimator")
    for row in whole.table.to_dict("records"):
        mine = steps[row["group"], row["tag"]]
        assert row["value"] == pytest.approx(np.sqrt(np.mean(mine**2)))
    one = prepare(recorded(True), Asked("box"), ["tag=B"])
    assert set(one.table["of"]) == {6}
    both = prepare(recorded(True), Asked("box"), ["tag=A,B"])
    assert both.choice.panels == ("tag",)
    pairs = prepare(recorded(True), Asked("pairs"), ["tag=B"])
    assert pairs.table["of"].tolist() == [1]


def test_a_frame_has_tags_too(recorded):
    frame = tables.load(recorded(True))
    found = prepare(frame, Asked("box", by="tag")).table
    for row in found.to_dict("records"):
        mine = frame[(frame["tag"] == row["group"]) & (frame["estimator"] == row["panel"])]
        assert [row["q50"]] == mine["rmse_3d_m"].tolist()


def test_tags_are_told_apart_only_where_that_is_asked_for(recorded):
    assert read(recorded(True)).tags == ["A", "B"]
    assert "tag" not in read(recorded(True)).parameters
    table = prepare(recorded(True), Asked("box")).table
    assert table["of"].tolist() == [15, 15]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (Asked(by="tag", metric="cep50_m", over=("estimator",)), "metric=cep50_m: it is one number "
         "for all tags; allowed: a figure that does not tell tags apart"),
        (Asked(by="tags"), "by tags: no such column; did you mean 'tag'?"),
    ],
)  # fmt: skip
def test_what_a_tag_does_not_have_is_one_line(recorded, asked, message):
    with pytest.raises(UserError) as error:
        prepare(recorded(True), asked)
    assert str(error.value) == message


def test_results_without_tags_are_one_line(sweep, recorded):
    for asked, where in ((Asked(by="tag"), ()), (Asked(), ["tag=A"])):
        with pytest.raises(UserError, match=r"^tag: no results here are of recorded tags; allowed"):
            prepare(sweep, asked, where)
    with pytest.raises(UserError, match="where tag=C: no results have it; allowed: A, B"):
        prepare(recorded(True), Asked(), ["tag=C"])
