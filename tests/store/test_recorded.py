"""What runs have recorded, read without tables: what `load` and `fixes` give once they are made."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from aoabench.errors import RunError, UserError
from aoabench.store import fixes as fixes_module
from aoabench.store import recorded, tables
from aoabench.store.folder import read_record, values, write_record
from tests.store import made


@pytest.fixture
def folder(tmp_path):
    """Three cells that differ in two parameters, one of which only one cell has as a text."""
    made.cell(tmp_path, "c", sigma=2.0, kind="wide")
    made.cell(tmp_path, "a", ("ml", "ls"), sigma=0.5)
    made.cell(tmp_path, "b", sigma=1.0)
    return tmp_path


def test_replications_are_those_of_the_tables(folder):
    wanted = {"c": {"ls": 3, "ml": 4}, "a": {"ls": 4}}
    found = recorded.replications(folder, wanted)
    tables.collect(folder)
    frame = tables.load(folder)
    counts = [wanted.get(cell, {}).get(name, 0) for cell, name in zip(frame["cell"], frame["estimator"])]  # fmt: skip
    expected = frame[frame["replication"] < counts].reset_index(drop=True)
    assert len(found) == 11
    pd.testing.assert_frame_equal(found, expected)
    assert list(recorded.replications(folder, {"a": {"ml": 2, "ls": 1}})["estimator"]) == ["ml", "ml", "ls"]  # fmt: skip


def test_fixes_are_those_of_the_tables(folder):
    found = recorded.fixes(folder, "a", "ml", 3)
    tables.collect(folder)
    expected = fixes_module.fixes(folder, "a", "ml")
    for field in dataclasses.fields(fixes_module.Fixes):
        mine, whole = getattr(found, field.name), getattr(expected, field.name)
        assert len(whole) == 4
        assert np.array_equal(mine, whole[:3]), field.name
        assert mine.dtype == whole.dtype
    assert np.array_equal(found.accepted, expected.accepted[:3])
    with pytest.raises(UserError, match="no fixes of 'absent'"):
        recorded.fixes(folder, "a", "absent", 3)


def test_a_later_run_of_fewer_replications_changes_nothing(folder):
    """As where two experiments share a cell: each reads as many replications as it asked for."""
    record = read_record(folder / "cells" / "a.json")
    record["estimators"]["ml"]["reps"] = 1
    write_record(folder, {k: v for k, v in record.items() if k != "format"})
    assert read_record(folder / "cells" / "a.json")["estimators"]["ml"]["reps"] == 1
    assert len(recorded.fixes(folder, "a", "ml", 3).outcome) == 3
    assert len(recorded.replications(folder, {"a": {"ml": 4}})) == 4


def test_an_array_of_fixes_is_read_once_and_alone(folder, monkeypatch):
    found = recorded.fixes(folder, "a", "ml", 4)
    seen, parts = [], fixes_module.noted_parts
    monkeypatch.setattr(
        fixes_module, "noted_parts", lambda *words: seen.append(words[3]) or parts(*words)
    )
    assert seen == []
    assert found.error_xy_m is found.error_xy_m
    assert seen == [["replication", "error_xy_m"]]


def test_a_part_that_was_lost_is_reported_before_anything_is_read(folder):
    (folder / "parts" / "aml" / "000000002-000000004.json").unlink()
    with pytest.raises(RunError, match="replications from 2 on of part aml are missing"):
        recorded.fixes(folder, "a", "ml", 4)
    assert len(recorded.fixes(folder, "a", "ml", 2).outcome) == 2
    with pytest.raises(RunError, match="replications from 2 on of part aml are missing"):
        recorded.replications(folder, {"a": {"ml": 4}})


def test_values_that_are_known_are_not_read_again(tmp_path):
    for start, stop in ((0, 2), (2, 4), (4, 8)):
        made.part(tmp_path, "key", start, stop)
    whole = values(tmp_path, "key", "rmse_3d_m", 8)
    assert len(whole) == 8
    assert np.array_equal(values(tmp_path, "key", "rmse_3d_m", 5, whole[:3]), whole[:5])
    (tmp_path / "parts" / "key" / "000000000-000000002.json").unlink()
    assert np.array_equal(values(tmp_path, "key", "rmse_3d_m", 8, whole[:4]), whole)
    with pytest.raises(RunError, match="replications from 1 on"):
        values(tmp_path, "key", "rmse_3d_m", 8, whole[:1])
