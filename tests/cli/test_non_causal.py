"""Smoothers are marked as non-causal wherever they stand beside filters."""

import json

import pandas as pd
import pytest

import aoabench
from aoabench.engine.replay import replay
from aoabench.engine.replay_files import _picture
from aoabench.store.folder import read_record, write_record
from aoabench.store.tables import collect

MARKED = "ekf_vmf_smoother (non-causal)"
WORDS = [
    "filter=[ekf_vmf,ekf_vmf_smoother]", "filter.ekf_vmf.engine=numpy",
    "filter.ekf_vmf_smoother.filter.engine=numpy", "scenario.steps=4", "noise=vmf", "reps=4",
    "runner.n_jobs=1",
]  # fmt: skip


@pytest.fixture
def mixed_run(tmp_path, call):
    """A run of a filter and its smoother, and what it printed."""
    status, *said = call("run", *WORDS, f"runner.out={tmp_path / 'run'}")
    assert status == 0
    return tmp_path / "run", "".join(said)


def test_the_table_of_a_run(mixed_run):
    out, said = mixed_run
    assert MARKED in said
    assert "ekf_vmf (" not in said
    assert "non-causal: its fixes use later measurements" in said
    summary = pd.read_parquet(out / "summary.parquet").set_index("estimator")
    assert dict(summary["causal"]) == {"ekf_vmf": True, "ekf_vmf_smoother": False}
    assert set(aoabench.load(out)["estimator"]) == {"ekf_vmf", "ekf_vmf_smoother"}


def test_a_run_of_filters_says_nothing(call, tmp_path):
    words = [w for w in WORDS if "smoother" not in w]
    _, *said = call("run", "filter=[ekf_vmf]", *words, f"runner.out={tmp_path / 'run'}")
    assert "ekf_vmf" in "".join(said)
    assert "non-causal" not in "".join(said)
    assert pd.read_parquet(tmp_path / "run/summary.parquet")["causal"].all()


def test_comparisons(mixed_run, call):
    out, _ = mixed_run
    text = call("compare", out, "--baseline", "ekf_vmf")[1]
    assert "ekf_vmf_smoother is non-causal" in text
    assert "ekf_vmf is non-causal" not in text
    found = json.loads(call("compare", out, "--json")[1])
    assert found["non_causal"] == ["ekf_vmf_smoother"]


def test_a_replay_of_one(mixed_run, tmp_path, monkeypatch):
    titles = []
    monkeypatch.setattr(
        "aoabench.report.trace.figure", lambda _f, title, *_rest: titles.append(title)
    )
    monkeypatch.setattr("aoabench.report.plots.save", lambda draw, path: draw())
    for name in ("ekf_vmf", "ekf_vmf_smoother"):
        done = replay(mixed_run[0], 1, name)
        assert done.as_stored
        pd.DataFrame({"x_m": [0.0]}).to_parquet(tmp_path / "trace.parquet")
        _picture(done, tmp_path / "trace.parquet")
    assert MARKED in titles[1]
    assert "non-causal" not in titles[0]


def test_records_of_before_are_of_causal_estimators(mixed_run):
    out, _ = mixed_run
    (file,) = (out / "cells").glob("*.json")
    record = {k: v for k, v in read_record(file).items() if k != "format"}
    del record["estimators"]["ekf_vmf_smoother"]["causal"]
    write_record(out, record)
    collect(out)
    assert pd.read_parquet(out / "summary.parquet")["causal"].all()
