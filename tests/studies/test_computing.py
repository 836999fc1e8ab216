"""From items to tables: what items share, and what each of them took."""

from types import SimpleNamespace

import pandas as pd
import pytest

from aoabench.store.files import read_provenance, write_frame
from aoabench.studies import computing, reproduce, stored, study
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
    (folder / "numbers.py").write_text(FUNCTIONS)
    (folder / "figures.py").write_text("")
    return Study(folder.name, folder, "title", "cite", items, (), ())


@pytest.mark.parametrize("fresh", [False, True])
def test_items_with_the_same_experiment_and_overrides_share_its_run(tmp_path, composed, fresh):
    """Also where everything is computed again: once in a command, not once for each item."""
    s = made_up(tmp_path, (item("first"), item("second"), item("third", reps=6)))
    ran, run = [], computing.runner.run
    with pytest.MonkeyPatch.context() as patch:
        note = SimpleNamespace(run=lambda *words: ran.append(words[2]) or run(*words))
        patch.setattr(computing, "runner", note)
        runs = computing.Runs(tmp_path / "raw", fresh)
        found = [computing.compute(s, one, "quick", runs) for one in s.items]
    assert [frame["n"].sum() for frame, _ in found] == [4, 4, 6]
    assert [origin["reps"] for _, origin in found] == [4, 4, 6]
    assert ran == [fresh] * 2
    assert len(composed) == 2


def test_a_table_holds_the_seconds_of_its_item_in_the_command(tmp_path, composed, monkeypatch):
    """Without those of the items before it, and of drawing."""
    s = made_up(tmp_path, (item("first"), item("second")))
    now, took = [0.0], {"first": 2.5, "second": 4.25}

    def passing(seconds, function):
        def timed(*words):
            now[0] += seconds(*words)
            return function(*words)

        return timed

    monkeypatch.setattr(reproduce, "all_studies", lambda: [s.name])
    monkeypatch.setattr(study, "load", lambda _: s)
    monkeypatch.setattr(reproduce, "_conclude", lambda *_: None)
    monkeypatch.setattr(reproduce, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    compute = passing(lambda _, one, *rest: took[one.name], reproduce.compute)
    monkeypatch.setattr(reproduce, "compute", compute)
    monkeypatch.setattr(reproduce, "_drawn", passing(lambda *_: 100.0, reproduce._drawn))
    places = Places.inside(tmp_path / "results")
    done = reproduce.reproduce([s.name], "quick", None, places, lambda _: None)
    paths = {one.name: study.table_path(places.results, s, one) for one in s.items}
    assert {name: read_provenance(path)["seconds"] for name, path in paths.items()} == took
    assert {row["item"]: row["seconds"] for row in done.computed} == took


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
