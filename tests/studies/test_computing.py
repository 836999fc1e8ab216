"""From items to tables: what items share, and what each of them took."""

import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pandas as pd
import pytest

from aoabench.store import tables
from aoabench.store.files import read_provenance, write_frame
from aoabench.studies import computing, pipeline, reproduce, stored, study
from aoabench.studies.background import Background
from aoabench.studies.places import Places
from aoabench.studies.study import Item, Study

FUNCTIONS = """
import pandas as pd

def first(runs):
    return pd.DataFrame([{"n": len(runs)}])

second = third = first
"""


def item(name, reps=4):
    scale = {"quick": [f"reps={reps}"]}
    return Item(name, "t", "c", figure=False, experiment="le2021_zones", scale=scale)


@pytest.fixture
def composed(monkeypatch):
    """The overrides that were composed; any experiment becomes four positions of the grid."""
    seen, compose = [], computing.compose_cells

    def cells(overrides):
        seen.append(overrides)
        kept = [o for o in overrides if not o.startswith("experiment")]
        return compose([*kept, "scenario=bs_grid", "scenario.positions=4", "estimator=ls", "noise=ae_normal", "runner.n_jobs=1"])  # fmt: skip

    monkeypatch.setattr(computing, "compose_cells", cells)
    return seen


def made_up(folder, items):
    folder.mkdir(exist_ok=True)
    (folder / "numbers.py").write_text(FUNCTIONS)
    (folder / "figures.py").write_text("")
    return Study(folder.name, folder, "title", "cite", items, (), ())


def computed(s, one, runs):
    return computing.reduce(s, one, "quick", runs.folder(s), computing.run(s, one, "quick", runs))


@pytest.mark.parametrize("fresh", [False, True])
def test_items_with_the_same_experiment_and_overrides_share_its_run(tmp_path, composed, fresh):
    """Also where everything is computed again: once in a command, not once for each item."""
    s = made_up(tmp_path, (item("first"), item("second"), item("third", reps=6)))
    ran, run = [], computing.runner.run
    with pytest.MonkeyPatch.context() as patch:
        note = SimpleNamespace(
            run=lambda *words, **more: ran.append(words[2]) or run(*words, **more)
        )
        patch.setattr(computing, "runner", note)
        runs = computing.Runs(tmp_path / "raw", fresh)
        found = [computed(s, one, runs) for one in s.items]
    assert [frame["n"].sum() for frame, _ in found] == [4, 4, 6]
    assert [origin["reps"] for _, origin in found] == [4, 4, 6]
    assert ran == [fresh] * 2
    assert len(composed) == 2


def test_items_read_the_parts_and_the_tables_are_made_once_at_the_end(tmp_path, composed):
    s = made_up(tmp_path / "mine", (item("first"), item("third", reps=6)))
    runs = computing.Runs(tmp_path / "raw")
    found = [computed(s, one, runs)[0] for one in s.items]
    assert [frame["n"].sum() for frame in found] == [4, 6]
    out = runs.folder(s)
    assert not (out / "tables.json").exists()
    runs.tabulate(s)
    summary = tables.shown(out, "summary")["summary"]
    assert list(summary["replications"]) == [6]
    made = (out / "tables.json").stat().st_mtime_ns
    runs.tabulate(s)
    assert (out / "tables.json").stat().st_mtime_ns == made
    whole = tables.load(out)
    tables.collect(out)
    pd.testing.assert_frame_equal(tables.load(out), whole)


@pytest.fixture
def small(tmp_path, composed, monkeypatch):
    """A command's study of two items with other overrides, and the places of its tables."""
    s = made_up(tmp_path, (item("first"), item("third", reps=6)))
    monkeypatch.setattr(reproduce, "all_studies", lambda: [s.name])
    monkeypatch.setattr(study, "load", lambda _: s)
    monkeypatch.setattr(reproduce, "_conclude", lambda *_: None)
    return s, Places.inside(tmp_path / "results")


def test_a_table_holds_the_seconds_of_its_item_in_the_command(small, monkeypatch):
    """Those of its run and of reducing it, without those of other items and of drawing."""
    s, places = small
    now, took = [0.0], {"first": 2.5, "third": 4.25}

    def passing(seconds, function):
        def timed(*words):
            now[0] += seconds(*words)
            return function(*words)

        return timed

    monkeypatch.setattr(pipeline, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    run, reduce = computing.run, computing.reduce
    monkeypatch.setattr(computing, "run", passing(lambda _, one, *rest: took[one.name] - 1.5, run))
    monkeypatch.setattr(computing, "reduce", passing(lambda *_: 1.5, reduce))
    monkeypatch.setattr(stored, "drawn", passing(lambda *_: 100.0, stored.drawn))
    # so that the made-up clock does not pass for two at once
    monkeypatch.setattr(Background, "submit", lambda _, call: done(call()))
    finished = reproduce.reproduce([s.name], "quick", None, places, lambda _: None)
    paths = {one.name: study.table_path(places.results, s, one) for one in s.items}
    assert {name: read_provenance(path)["seconds"] for name, path in paths.items()} == took
    assert {row["item"]: row["seconds"] for row in finished.computed} == took


def done(result):
    future = Future()
    future.set_result(result)
    return future


def test_an_item_is_reduced_while_the_next_ones_experiment_runs(small, monkeypatch):
    s, places = small
    running, ran, said = threading.Event(), [], []
    run, reduce = computing.run, computing.reduce

    def second_begins(*words):
        ran.append(words[1].name)
        if len(ran) == 2:
            running.set()
        return run(*words)

    def first_waits(*words):
        assert running.wait(60), "the second run has not begun"
        return reduce(*words)

    monkeypatch.setattr(computing, "run", second_begins)
    monkeypatch.setattr(computing, "reduce", first_waits)
    finished = reproduce.reproduce([s.name], "quick", None, places, said.append)
    assert [row["item"] for row in finished.computed] == ["first", "third"]
    assert [row["rows"] for row in finished.computed] == [1, 1]
    assert [line.split(":")[0] for line in said] == [f"{s.name} first", f"{s.name} third"]
    assert "2 of 2 done" in said[1]
    assert (places.raw / s.name / "summary.parquet").exists()


@pytest.mark.parametrize("which", ["times", "fresh"])
def test_nothing_runs_beside_an_item_that_measures_times_or_a_fresh_run(small, monkeypatch, which):
    s, places = small
    events, run, reduce = [], computing.run, computing.reduce

    def noted(event, function):
        def call(*words):
            events.append((event, words[1].name))
            found = function(*words)
            time.sleep(0.05)
            events.append((f"after {event}", words[1].name))
            return found

        return call

    monkeypatch.setattr(computing, "run", noted("run", run))
    monkeypatch.setattr(computing, "reduce", noted("reduce", reduce))
    if which == "times":
        items = tuple(replace(one, times=one.name == "third") for one in s.items)
        s = replace(s, items=items)
        monkeypatch.setattr(study, "load", lambda _: s)
    reproduce.reproduce([s.name], "quick", None, places, lambda _: None, fresh=which == "fresh")
    expected = [
        (event, one)
        for one in ("first", "third")
        for event in ("run", "after run", "reduce", "after reduce")
    ]
    assert events == expected


def test_an_error_of_an_item_ends_the_command(small, monkeypatch):
    s, places = small
    monkeypatch.setattr(s.numbers, "first", lambda runs: runs["absent"])
    with pytest.raises(KeyError, match="absent"):
        reproduce.reproduce([s.name], "quick", None, places, lambda _: None)
    assert not study.table_path(places.results, s, s.items[0]).exists()


def test_calls_in_the_background_are_left_out_after_an_exception():
    done, begun, first = [], threading.Event(), threading.Event()

    def fail():
        raise ZeroDivisionError

    def interrupted():
        with Background() as background:
            background.submit(lambda: (begun.set(), first.wait(60), done.append(1)))
            background.submit(lambda: done.append(2))
            assert begun.wait(60)
            threading.Timer(0.2, first.set).start()
            fail()

    with pytest.raises(ZeroDivisionError):
        interrupted()
    assert done == [1]
    with Background() as background:
        future = background.submit(fail)
        background.submit(lambda: done.append(3))
    assert done == [1, 3]
    with pytest.raises(ZeroDivisionError):
        future.result()


def test_a_stored_table_is_read_once_until_it_changes(tmp_path, monkeypatch):
    s, results = made_up(tmp_path, (item("first"),)), tmp_path / "results"
    reads, table = [], stored.table
    monkeypatch.setattr(stored, "table", lambda *words: reads.append(words) or table(*words))
    monkeypatch.setattr(
        s.figures, "first_values", lambda frame: {"n": frame["n"][0]}, raising=False
    )
    path = study.table_path(results, s, s.items[0])

    def value():
        return stored.read(s, s.items[0], results).values["n"][0]

    assert not stored.read(s, s.items[0], results).present
    for n in (1, 2):
        write_frame(path, pd.DataFrame([{"n": n}]), {})
        assert (value(), value(), len(reads)) == (n, n, n)
    monkeypatch.setattr(s.figures, "first_values", lambda frame: {"n": -frame["n"][0]})
    assert (value(), len(reads)) == (-2, 3)
    path.unlink()
    assert not stored.read(s, s.items[0], results).present
