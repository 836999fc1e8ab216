"""One replication by its number, with all that was seen and said; and the worst ones of a run."""

import re
import shlex
import shutil

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.cli.main import dispatch
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.engine.replay import replay
from aoabench.engine.replay_files import write
from aoabench.errors import RunError
from aoabench.store.documents import read_document, write_document

TRACK = [
    "noise=ae_flip",
    "filter=[pf_vmf,ekf_vmf,ukf_ae_adaptive]",
    "filter.pf_vmf.particles=500",
    "reps=20",
]


def run(out, *words):
    runner.run(compose_cells([*words, f"runner.out={out}"]), progress=False)
    return out


@pytest.fixture(scope="module")
def track(tmp_path_factory):
    return run(tmp_path_factory.mktemp("track"), *TRACK, "store.steps=true", "runner.n_jobs=1")


def traced(out, name, replication):
    said = write(replay(out, replication, name))
    assert "as stored" in said
    path = next((out / "replay").glob(f"*-{name}-{replication}.parquet"))
    assert path.with_suffix(".png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert path.with_suffix(".png").stat().st_size > 20_000
    return pd.read_parquet(path)


@pytest.mark.parametrize("name", ["pf_vmf", "ekf_vmf", "ukf_ae_adaptive"])
def test_a_replay_is_the_replication_that_was_stored(name, track):
    trace = traced(track, name, 13)
    stored = pd.read_parquet(track / "steps.parquet")
    stored = stored[(stored["estimator"] == name) & (stored["replication"] == 13)].reset_index(
        drop=True
    )
    for column in ("x_m", "y_m", "z_m", "error_3d_m", "outcome"):
        pd.testing.assert_series_equal(trace[column], stored[column], check_exact=True)
    rows = aoabench.load(track)
    row = rows[(rows["estimator"] == name) & (rows["replication"] == 13)].iloc[0]
    assert trace["nees"].mean() == pytest.approx(row["nees"])
    assert np.sqrt((trace["error_3d_m"] ** 2).mean()) == pytest.approx(row["rmse_3d_m"])
    assert np.allclose(trace["sigma_x_m"] ** 2, trace["cov_xx_m2"])
    truth = trace[["true_x_m", "true_y_m", "true_z_m"]].to_numpy()
    assert np.allclose(
        np.linalg.norm(trace[["x_m", "y_m", "z_m"]].to_numpy() - truth, axis=1), trace["error_3d_m"]
    )
    assert trace[[f"azimuth_{j}_rad" for j in range(4)]].notna().all(axis=None)


def test_innovations_are_measured_less_expected_at_the_prediction(track):
    """The random walk predicts the last mean; the model's unit vector is the direction in the
    anchor's frame.
    """
    cell = compose_cells(TRACK)[0]
    anchors = cell.scenario.true_anchors
    for name in ("ekf_vmf", "pf_vmf"):
        trace = traced(track, name, 5)
        before = trace[["x_m", "y_m", "z_m"]].shift(1).to_numpy()
        for j in range(4):
            p = (before - anchors.position[0, 0, j]) @ anchors.rotation[0, 0, j].T
            a, e = trace[f"azimuth_{j}_rad"], trace[f"elevation_{j}_rad"]
            measured = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
            expected = p / np.linalg.norm(p, axis=1, keepdims=True)
            told = trace[[f"innovation_{j}_{c}" for c in "xyz"]].to_numpy()
            assert np.allclose(told[1:], (measured - expected)[1:], atol=1e-6), (name, j)
            assert np.isfinite(told[0]).all()


def test_the_effective_number_of_particles_is_told(track):
    trace = traced(track, "pf_vmf", 5)
    assert trace["ess"].between(1, 500).all()
    assert trace["ess"].min() < 250
    assert "ess" not in traced(track, "ekf_vmf", 5)


def test_compiled_and_numpy_particle_filters_tell_the_same_of_themselves(tmp_path):
    """Other draws, so the mean over steps agrees within some tens of per cent only."""
    words = ["noise=vmf", "filter=[pf_vmf]", "filter.pf_vmf.particles=2000", "reps=1"]
    means = [
        traced(run(tmp_path / e, *words, f"filter.pf_vmf.engine={e}"), "pf_vmf", 0)["ess"].mean()
        for e in ("auto", "numpy")
    ]
    assert means[0] == pytest.approx(means[1], rel=0.4)


def test_access_nodes_tell_ranges_and_angles_of_those_that_were_heard(tmp_path):
    words = [
        "scenario=indoor_map",
        "noise=ofdm_crlb",
        "filter=[ekf_toa_aoa]",
        "reps=2",
        "scenario.route=[[17.5,24.5],[25,24.5]]",
    ]
    trace = traced(run(tmp_path, *words), "ekf_toa_aoa", 1)
    told = trace[[c for c in trace if c.startswith("innovation_")]]
    heard = trace[[c for c in trace if c.startswith("azimuth_")]].notna().to_numpy().sum()
    assert told.notna().to_numpy().sum() == 3 * heard > 0
    ranges = told[[c for c in told if c.endswith("range_m")]].iloc[5:]
    assert np.nanstd(ranges) == pytest.approx(3.0, rel=0.15)  # m: the clocks' 10 ns


def test_fixes_that_stand_alone_have_a_trace_and_a_picture(tmp_path):
    words = ["scenario=bs_grid", "scenario.positions=50", "estimator=[ls,ml_kcorr]", "reps=3"]
    trace = traced(run(tmp_path, *words), "ml_kcorr", 2)
    assert len(trace) == 50
    assert trace["iterations"].notna().any()
    assert trace[[c for c in trace if c.startswith("cov_")]].notna().any(axis=None)
    assert not [c for c in trace if c.startswith(("innovation_", "ess"))]


def test_what_is_not_in_the_run_is_the_users_mistake(track):
    for given, match in (
        ((20, "ekf_vmf"), "0 to 19"),
        ((3, "ekf_vfm"), "ekf_vmf"),
        ((3, "ekf_vmf", "abc"), "--cell=abc"),
    ):
        with pytest.raises(aoabench.UserError, match=match):
            replay(track, *given)


def test_a_replay_of_a_tampered_folder_is_refused_in_one_line(track, tmp_path):
    shutil.copytree(track, tmp_path / "run")
    (record,) = (tmp_path / "run" / "cells").iterdir()
    content = read_document(record)
    name, entry = next(iter(content["estimators"].items()))
    entry["reps"] += 10
    text = record.read_text()
    record.write_text(text.replace(f'"reps": {entry["reps"] - 10}', f'"reps": {entry["reps"]}'))
    with pytest.raises(RunError, match=r"\.json is torn or altered; delete it and run"):
        replay(tmp_path / "run", 1, name)
    write_document(record, content)
    with pytest.raises(RunError, match=rf"replication {entry['reps'] - 1} of part .* is missing"):
        replay(tmp_path / "run", entry["reps"] - 1, name)


def test_a_replay_of_a_failure_tells_what_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_trouble.py").write_text(
        "from dataclasses import dataclass\nimport numpy as np\nfrom aoabench import Estimates\n\n\n@dataclass(frozen=True)\nclass Trouble:\n"
        "    def __call__(self, batch, scenario, streams):\n        if 2 in streams.replications:\n"
        "            raise FloatingPointError('too far')\n        shape = batch.azimuth.shape[:2]\n"
        "        return Estimates(np.zeros((*shape, 3)), None, None, np.zeros(shape, dtype=np.int8))\n"
    )
    (tmp_path / "conf" / "estimator").mkdir(parents=True)
    (tmp_path / "conf" / "estimator" / "trouble.yaml").write_text(
        "trouble: {_target_: my_trouble.Trouble}\n"
    )
    aoabench.run(
        "estimator=[trouble]", "reps=5", out="out", config_dir="conf", plugins=["my_trouble"]
    )
    again = pd.read_parquet("out/failures.parquet")["replay"].iloc[0]
    assert again.startswith("aoabench replay out ")
    said = write(replay(tmp_path / "out", 2, "trouble", plugins=["my_trouble"]))
    assert "FloatingPointError: too far" in said
    assert "as stored" in said
    assert dispatch(shlex.split(again)[1:]) == 0
    assert (
        pd.read_parquet(next((tmp_path / "out" / "replay").glob("*.parquet")))["outcome"]
        == "failed"
    ).all()


def test_the_worst_are_named_with_the_command_that_replays_them(tmp_path, capsys):
    words = [
        "-m",
        "noise=vmf,ae_flip",
        "filter=[ekf_vmf,ekf_ae_nominal]",
        "reps=30",
        "runner.n_jobs=1",
        f"runner.out={tmp_path}",
        "--worst",
        "3",
    ]
    assert dispatch(["run", *words]) == 0
    said = capsys.readouterr().out
    frame = aoabench.load(tmp_path).nlargest(3, "rmse_3d_m")
    commands = re.findall(r"^ +aoabench (replay .*)$", said, re.MULTILINE)
    assert len(commands) == 3
    for command, row in zip(commands, frame.itertuples()):
        assert (
            f"--cell {row.cell} --estimator {row.estimator} --replication {row.replication}"
            in command
        )
        assert f"{row.rmse_3d_m:.4g} m" in said
        assert dispatch(shlex.split(command)) == 0
        assert f"{row.rmse_3d_m:.17g} (as stored)" in capsys.readouterr().out


@pytest.mark.parametrize("n", ["-1", "two"])
def test_worst_takes_a_number(n, tmp_path):
    with pytest.raises(aoabench.UserError, match="--worst"):
        dispatch(["run", "filter=[ekf_vmf]", f"runner.out={tmp_path}", "--worst", n])
