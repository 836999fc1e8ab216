"""Which items a command computes, in which order, and what it says of the time left."""

import itertools
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from aoabench.errors import UserError
from aoabench.studies import pipeline, places, progress, reproduce, study
from aoabench.studies.choice import cheapest_first, chosen
from aoabench.studies.computing import Runs

KNOWN = study.names()


def names(pairs):
    return [f"{s.name}/{item.name}" for s, item in pairs]


def test_a_list_names_items_of_all_studies_or_of_one():
    assert names(chosen([], "nurminen2018/fig4,table1", KNOWN)) == [
        "le2021/table1",
        "lu2019/table1",
        "nurminen2018/table1",
        "nurminen2018/fig4",
    ]
    assert names(chosen(["lu2019"], "fig4, table1", KNOWN)) == ["lu2019/table1", "lu2019/fig4"]
    assert names(chosen(["lu2019", "lu2019"], "lu2019/fig4,fig4", KNOWN)) == ["lu2019/fig4"]
    everything = [study.load(n) for n in KNOWN]
    default = [s for s in everything if not s.named_only]
    assert [s.name for s in everything if s.named_only] == ["coverage"]
    assert len(chosen([], None, KNOWN)) == sum(len(s.items) for s in default)
    assert len(chosen(["coverage"], None, KNOWN)) == len(study.load("coverage").items)


@pytest.mark.parametrize(
    ("studies", "only", "words"),
    [
        ([], "fig99", ["--only=fig99", "did you mean 'fig"]),
        ([], "fig4,fug5", ["--only=fug5", "did you mean 'fig5'"]),
        ([], "nurminen2018/fig44", ["did you mean 'nurminen2018/fig4'"]),
        ([], "nurmine2018/fig4", ["did you mean 'nurminen2018/fig4'"]),
        (["le2021"], "nurminen2018/fig4", ["--only=nurminen2018/fig4", "le2021/fig"]),
        ([], "fig4,", ["--only=: unknown item", "allowed: "]),
        (["le2012"], None, ["'le2012'", "did you mean 'le2021'"]),
    ],
)
def test_a_mistake_is_one_line_that_names_it(studies, only, words):
    with pytest.raises(UserError) as told:
        chosen(studies, only, KNOWN)
    line = str(told.value)
    assert "\n" not in line
    assert len(line) < 1000
    for word in words:
        assert word in line


def test_cheap_items_come_first_and_those_of_one_experiment_stay_together():
    pairs = chosen(["le2021"], None, KNOWN)
    seconds = {f"le2021/{i.name}": 1.0 for _, i in pairs} | {"le2021/zones": 2.5}
    assert names(cheapest_first(pairs, seconds)) == [
        f"le2021/{name}" for name in ("fig5", "errata", "pole", "zones", "fig6", "fig7", "table1")
    ]  # fig6, fig7, table1 share one experiment: 3 s


@pytest.mark.parametrize("fig4", [1.0, 50.0, 300.0])
def test_an_item_comes_after_the_one_that_has_a_part_of_its_replications(fig4):
    """Whichever took longer when it was last computed."""
    pairs = chosen(["nurminen2018"], "readings,fig4,frames,layouts", KNOWN)
    seconds = {"nurminen2018/fig4": fig4, "nurminen2018/readings": 60.0}
    seconds |= {"nurminen2018/frames": 30.0, "nurminen2018/layouts": 2.0}
    found = [name.split("/")[1] for name in names(cheapest_first(pairs, seconds))]
    assert found.index("fig4") < min(found.index("layouts"), found.index("readings"))
    assert (found[0] == "frames") == (fig4 > 30)


def test_the_first_figure_is_cheap_at_both_scales():
    for scale in ("quick", "paper"):
        seconds = progress.expected(scale)
        pairs = cheapest_first(chosen([], None, KNOWN), seconds)
        first = next(k for k, (_, item) in enumerate(pairs) if item.figure)
        assert sum(seconds[name] for name in names(pairs)[: first + 1]) < 30


def test_the_time_left_follows_the_speed_of_this_machine():
    pairs = chosen(["le2021"], "fig5,fig6,fig7", KNOWN)
    pace = progress.Pace(pairs, {"le2021/fig5": 10.0, "le2021/fig6": 30.0, "le2021/fig7": 60.0})
    assert pace.text() == "0 of 3 done, about 2 min left"
    pace.ran(0.1)
    assert pace.left_s == pytest.approx(100 * 25.1 / 25), "fig5 runs nothing, its function computes"
    pace.ran(100.0)
    assert pace.left_s == pytest.approx(70 * 125 / 55), "fig6 ran"
    pace.done(120.0)
    assert pace.left_s == pytest.approx(60 * 145 / 65), "each second counts once"
    assert pace.text() == "1 of 3 done, about 2 min left"
    pace.done(140.0)
    assert pace.left_s == pytest.approx(60 * 165 / 65)
    pace.ran(390.0)
    pace.done(400.0)
    assert pace.text() == "3 of 3 done"
    assert progress.Pace([], {}).left_s == 0


def test_the_time_left_of_a_recorded_run_is_calm_and_about_right():
    """All items at quick scale in a new home on a busy machine: kernels were compiled for 168 of
    614 s, and the first items took twice as long as expected.
    """
    events = pd.read_csv(Path(__file__).with_name("recorded_pace.csv"))
    items = events[events["event"] == "ran"]
    pairs = [
        (SimpleNamespace(name=study), SimpleNamespace(name=item, experiment="x" if runs else None))
        for (study, item), runs in zip(items["item"].str.split("/"), items["experiment"])
    ]
    expected = dict(zip(items["item"], items["expected_s"]))
    pace = progress.Pace(pairs, expected)
    printed = [pace.left_s]
    for event in events.itertuples():
        (pace.ran if event.event == "ran" else pace.done)(event.elapsed_s)
        printed.append(pace.left_s)
    assert max(printed) < 1.15 * sum(expected.values()), (
        "never far more than all is expected to take"
    )
    assert max(b / a for a, b in itertools.pairwise(printed)) < 1.15, "it does not jump up"
    true = events["left_s"].to_numpy()
    ratio = (np.array(printed[1:]) / true)[true > 60]
    assert 0.6 < ratio.min() < ratio.max() < 3.0
    last = (np.array(printed[1:]) / true)[(true > 60) & (true < 200)]
    assert last.max() < 2, "better once half of it is done"


def test_seconds_in_which_kernels_are_compiled_do_not_count(tmp_path, monkeypatch):
    """They count neither before the command nor during it."""
    waited = [40.0]
    now = [100.0]
    monkeypatch.setattr(pipeline, "waited_s", lambda: waited[0])
    monkeypatch.setattr(pipeline.time, "perf_counter", lambda: now[0])
    pairs = chosen(["le2021"], "fig5", KNOWN)
    pace = progress.Pace(pairs, {"le2021/fig5": 10.0})
    where = places.of_scale("quick", tmp_path)
    line = pipeline.Pipeline("quick", where, ("png",), print, pace, Runs(tmp_path / "raw"))
    now[0] += 25.0
    waited[0] += 20.0
    assert line._elapsed_s() == pytest.approx(5.0)


def test_durations_are_short_texts():
    texts = [progress.duration(s) for s in (0.2, 89, 91, 5399, 5401)]
    assert texts == ["1 s", "89 s", "2 min", "90 min", "1.5 h"]


def test_seconds_are_kept_with_commit_only(tmp_path, monkeypatch):
    file = tmp_path / "pace.yaml"
    file.write_text("{quick: {le2021/fig5: 3.0, le2021/fig6: 4.0}}")
    monkeypatch.setattr(progress, "_pace_file", lambda: file)
    monkeypatch.setattr(reproduce, "all_studies", lambda: ["le2021"])
    where = places.of_scale("quick", tmp_path / "results")
    monkeypatch.delenv("COMMIT", raising=False)
    lines = []
    reproduce.reproduce(["le2021"], "quick", "fig5", where, lines.append)
    assert progress.expected("quick")["le2021/fig5"] == 3.0
    assert re.match(r"le2021 fig5: 1012 rows, [\d.]+ s \(quick\); 1 of 1 done$", lines[0])
    assert (tmp_path / "results" / "figures" / "le2021_fig5.png").exists()
    monkeypatch.setenv("COMMIT", "1")
    done = reproduce.reproduce(["le2021"], "quick", "fig5", where, lines.append)
    seconds = progress.expected("quick")
    assert seconds["le2021/fig5"] == done.computed[0]["seconds"] != 3.0
    assert seconds["le2021/fig6"] == 4.0
    assert seconds["le2021/new"] == 10.0
