"""Bit-identity, pairing, top-up, reuse and integrity of runs, through the Python interface."""

import ast
import dataclasses
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.columns import REPLICATIONS, STEPS, TIMING
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.resources import shipped
from aoabench.store import keys, reach
from aoabench.store.files import read_provenance
from aoabench.store.keys import RunKeys
from aoabench.store.parts import missing_ranges
from tests.commands import Command

BASE = ["noise=ae_flip", "filter=[ekf_vmf,ukf_ae_adaptive]"]


def rows(out):
    frame = aoabench.load(out)
    return frame.sort_values(["cell", "estimator", "replication"]).reset_index(drop=True)


def run(out, *overrides):
    cells = compose_cells([*BASE, *overrides, f"runner.out={out}"])
    return runner.run(cells, progress=False)


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    out = tmp_path_factory.mktemp("reference")
    run(out, "reps=300", "runner.n_jobs=1", "store.steps=true")
    return out


@pytest.mark.parametrize("how", [
    ["runner.n_jobs=2"],
    ["runner.n_jobs=2", "runner.chunk=1"],
    ["runner.n_jobs=2", "runner.chunk=7"],
    ["runner.n_jobs=1", "runner.chunk=64"],
    ["runner.n_jobs=1", "runner.chunk=256"],
    ["runner.n_jobs=2", "runner.backend=threading"],
    ["runner.n_jobs=2", "runner.backend=sequential"],
])  # fmt: skip
def test_rows_do_not_depend_on_how_they_are_run(how, reference, tmp_path):
    run(tmp_path, "reps=300", *how)
    pd.testing.assert_frame_equal(rows(tmp_path), rows(reference), check_exact=True)


def test_draws_and_rows_do_not_depend_on_the_selection(reference, tmp_path):
    cells = compose_cells(
        ["noise=ae_flip", "filter=[ekf_ae_nominal,ekf_vmf]", "reps=300", f"runner.out={tmp_path}"]
    )
    runner.run(cells, progress=False)
    alone, among = rows(tmp_path), rows(reference)
    columns = [c for c in alone if c != "cell"]
    a, b = (f[f["estimator"] == "ekf_vmf"][columns].reset_index(drop=True) for f in (alone, among))
    pd.testing.assert_frame_equal(a, b, check_exact=True)


def test_top_up_computes_only_what_is_missing_and_equals_a_fresh_run(reference, tmp_path):
    first = run(tmp_path, "reps=40")
    assert (first.computed, first.reused) == (80, 0)
    second = run(tmp_path, "reps=300")
    assert (second.computed, second.reused) == (520, 80)
    pd.testing.assert_frame_equal(rows(tmp_path), rows(reference), check_exact=True)
    third = run(tmp_path, "reps=300")
    assert (third.computed, third.reused) == (0, 600)
    fourth = run(tmp_path, "reps=100")
    assert fourth.computed == 0
    assert len(rows(tmp_path)) == 200, "the tables show what was asked for last"


def test_two_hundred_then_a_thousand_computes_eight_hundred(tmp_path):
    cells = [
        compose_cells(["filter=[ekf_vmf]", f"reps={n}", f"runner.out={tmp_path}"])
        for n in (200, 1000)
    ]
    assert runner.run(cells[0], progress=False).computed == 200
    assert runner.run(cells[1], progress=False).computed == 800
    frame = aoabench.load(tmp_path)
    assert list(frame["replication"]) == list(range(1000))


def test_a_further_estimator_joins_the_cell(tmp_path):
    for names in ("ekf_vmf", "ukf_vmf"):
        runner.run(
            compose_cells([f"filter=[{names}]", "reps=20", f"runner.out={tmp_path}"]),
            progress=False,
        )
    frame = aoabench.load(tmp_path)
    assert frame["cell"].nunique() == 1
    assert set(frame["estimator"]) == {"ekf_vmf", "ukf_vmf"}


def test_a_changed_parameter_is_another_cell_and_its_column(tmp_path):
    frame = aoabench.run(
        "filter=[ukf_vmf,ekf_vmf]",
        "filter.ukf_vmf.lambda_=0.5,1",
        "noise.sigma_deg=4,8",
        "reps=20",
        out=tmp_path,
    )
    assert frame["cell"].nunique() == 4
    assert set(frame["noise.sigma_deg"]) == {4, 8}
    assert set(frame["filter.ukf_vmf.lambda_"]) == {0.5, 1}
    cells = pd.read_parquet(tmp_path / "cells.parquet")
    assert {
        "noise.sigma_deg",
        "filter.ukf_vmf.lambda_",
        "config",
        "scenario",
        "noise",
        "seed",
    } <= set(cells)
    assert json.loads(cells["config"][0])["scenario"]["name"] == "square_track"


def test_a_parameter_given_on_the_command_line_has_its_column_even_at_its_default(tmp_path):
    overrides = ["filter=[pf_vmf]", "filter.pf_vmf.particles=50", "noise.sigma_deg=10", "reps=2"]
    frame = aoabench.run(*overrides, out=tmp_path)
    assert set(frame["filter.pf_vmf.particles"]) == {50}
    assert set(frame["noise.sigma_deg"]) == {10}
    frame = aoabench.run(
        "filter=[ukf_vmf]", "filter.ukf_vmf.lambda_=0.5", "reps=2", out=tmp_path / "b"
    )
    assert set(frame["filter.ukf_vmf.lambda_"]) == {0.5}


def test_layout_variants_share_their_draws():
    """Streams are keyed on the scenario's name, which variants of one track have in common."""
    a, b = compose_cells(["scenario=square_track,square_track_far", "filter=[ekf_vmf]"])
    from aoabench.engine.draws import Draws

    one, other = (Draws(c.scenario, c.noise, 1).drawn(5, 1) for c in (a, b))
    assert np.array_equal(one.truth, other.truth)
    assert np.array_equal(one.prior[0], other.prior[0])
    assert a.id != b.id


def test_seeds_and_roles_give_different_draws():
    from aoabench.streams import generator

    keys = [
        (1, "a", 0, 0, 0),
        (2, "a", 0, 0, 0),
        (1, "b", 0, 0, 0),
        (1, "a", 1, 0, 0),
        (1, "a", 0, 1, 0),
        (1, "a", 0, 3, 1),
    ]
    draws = [tuple(generator(*k).random(4)) for k in keys]
    assert len(set(draws)) == len(keys)
    assert draws[0] == tuple(generator(*keys[0]).random(4))


PARTICLES = ["noise=ae_flip", "reps=12", "filter.pf_vmf.particles=300"]


@pytest.fixture(scope="module")
def particle_reference(tmp_path_factory):
    out = tmp_path_factory.mktemp("particles")
    runner.run(
        compose_cells([*PARTICLES, "filter=[pf_vmf,pf_ae_adaptive]", "filter.pf_ae_adaptive.particles=200",
                       "runner.n_jobs=1", f"runner.out={out}"]),
        progress=False,
    )  # fmt: skip
    return rows(out)


@pytest.mark.parametrize("how", [
    ["filter=[pf_vmf,pf_ae_adaptive]", "runner.n_jobs=2", "runner.chunk=1"],
    ["filter=[pf_ae_adaptive,ekf_vmf,pf_vmf]", "runner.n_jobs=2", "runner.chunk=7"],
    ["filter=[pf_vmf,pf_ae_nominal]", "runner.n_jobs=1", "runner.chunk=64"],
    ["filter=[pf_vmf]", "runner.n_jobs=2", "runner.backend=threading", "runner.chunk=5"],
])  # fmt: skip
def test_particle_filters_do_not_depend_on_how_they_are_run_nor_on_the_selection(
    how, particle_reference, tmp_path
):
    extra = ["filter.pf_ae_adaptive.particles=200"] if "pf_ae_adaptive" in how[0] else []
    runner.run(compose_cells([*PARTICLES, *how, *extra, f"runner.out={tmp_path}"]), progress=False)
    found = rows(tmp_path)
    for name in set(found["estimator"]) & {"pf_vmf", "pf_ae_adaptive"}:
        a, b = (
            f[f["estimator"] == name]["rmse_3d_m"].to_numpy() for f in (found, particle_reference)
        )
        assert np.array_equal(a, b), name


# --- tables ---------------------------------------------------------------------------------------


def test_tables_follow_the_documented_schemas(reference):
    frame = pd.read_parquet(reference / "replications.parquet")
    assert list(frame.columns) == list(REPLICATIONS)
    assert (frame["n_fixes"] == 64).all()
    assert (frame["n_ok"] + frame["n_diverged"] == 64).all()
    steps = pd.read_parquet(reference / "steps.parquet")
    assert list(steps.columns) == list(STEPS)
    assert len(steps) == 64 * len(frame)
    summary = pd.read_parquet(reference / "summary.parquet").set_index("estimator")
    timing = pd.read_parquet(reference / "timing.parquet")
    assert list(timing.columns) == list(TIMING)
    assert (timing["seconds_per_step"] > 0).all()
    for name, group in steps.groupby("estimator"):
        mine = frame[frame["estimator"] == name].set_index("replication")
        square = group["error_3d_m"] ** 2
        assert np.allclose(np.sqrt(square.groupby(group["replication"]).mean()), mine["rmse_3d_m"])
        assert summary.loc[name, "rmse_pooled_3d_m"] == pytest.approx(np.sqrt(square.mean()))
        assert summary.loc[name, "rmse_mean_3d_m"] == pytest.approx(mine["rmse_3d_m"].mean())
        assert summary.loc[name, "rmse_mean_3d_m_se"] == pytest.approx(
            mine["rmse_3d_m"].std() / np.sqrt(300)
        )
    origin = read_provenance(reference / "replications.parquet" / f"{frame['cell'][0]}.parquet")
    assert origin["config"]["seed"] == 1
    assert {"numpy", "scipy"} <= set(origin["libraries"])
    assert origin["cpu_features"]


def test_steps_asked_for_later_are_computed_then(tmp_path):
    run(tmp_path, "reps=20")
    assert run(tmp_path, "reps=20", "store.steps=true").computed == 40
    assert len(pd.read_parquet(tmp_path / "steps.parquet")) == 20 * 64 * 2


# --- keys and integrity ---------------------------------------------------------------------------


def test_an_altered_part_is_found_and_computed_again(tmp_path):
    run(tmp_path, "reps=20")
    before = rows(tmp_path)
    for i, part in enumerate(sorted((tmp_path / "parts").rglob("*.parquet"))):
        data = bytearray(part.read_bytes())
        data[len(data) // 3] ^= 1
        part.write_bytes(data if i == 0 else data[: len(data) // 2])
    assert run(tmp_path, "reps=20").computed == 40
    pd.testing.assert_frame_equal(rows(tmp_path), before, check_exact=True)


def keys_of(*overrides):
    cells = compose_cells([*BASE, *overrides])
    return list(RunKeys.of(cells).parts[cells[0].id].values())


def test_keys_depend_on_what_numbers_depend_on_and_nothing_else():
    base = keys_of()
    for same in (
        ["reps=7"],
        ["runner.n_jobs=1"],
        ["store.steps=true"],
        ["runner.out=/tmp/x"],
        ["filter=[ukf_ae_adaptive,ekf_vmf]"],
    ):
        assert set(keys_of(*same)) == set(base)
    for other in (
        ["seed=2"],
        ["noise=vmf"],
        ["noise.sigma_deg=9"],
        ["scenario=square_track_far"],
        ["scenario.steps=63"],
    ):
        assert not set(keys_of(*other)) & set(base)
    mine = keys_of("filter.ekf_vmf.measurement.kappa=40")
    assert mine[0] != base[0]
    assert mine[1] == base[1], "another estimator's parameter"


def test_changed_source_is_never_reused_and_a_changed_plot_is(tmp_path):
    """On a copy of the package: what the rows depend on, then what they do not."""
    import os
    import shutil
    import subprocess
    import sys
    from pathlib import Path

    package = Path(aoabench.__file__).parent
    shutil.copytree(package, tmp_path / "aoabench", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in ("configs", "experiments"):
        shutil.copytree(shipped(folder), tmp_path / folder, dirs_exist_ok=True)
    words = [
        "run",
        "filter=[ekf_vmf]",
        "filter.ekf_vmf.engine=numpy",
        "reps=8",
        "runner.n_jobs=1",
        "runner.out=out",
    ]

    def said():
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        done = subprocess.run([sys.executable, "-m", "aoabench.cli", *words], cwd=tmp_path, env=environment,
                              capture_output=True, text=True, check=True)  # fmt: skip
        return done.stdout.splitlines()[0]

    def change(file, name=None):
        path = tmp_path / "aoabench" / file
        tree = ast.parse(path.read_text())
        body = next((n.body for n in tree.body if name and name == vars(n).get("name")), tree.body)
        body.append(ast.parse("_changed = True").body[0])
        path.write_text(ast.unparse(tree))

    assert "8 replications x estimators computed, 0 reused" in said()
    for file in ("report/plots.py", "report/trace.py", "engine/runner.py", "filters/kalman.py"):
        change(file)
    assert "0 replications x estimators computed, 8 reused" in said()
    for file, name in (("engine/metrics.py", "per_replication"), ("filters/kalman.py", "EKF")):
        change(file, name)
        assert "8 replications x estimators computed, 0 reused" in said(), file


@pytest.mark.parametrize(("done", "reps", "gaps"), [
    ([], 10, [(0, 10)]),
    ([(0, 10)], 10, []),
    ([(0, 4), (6, 8)], 10, [(4, 6), (8, 10)]),
    ([(0, 20)], 10, []),
    ([(5, 20)], 10, [(0, 5)]),
    ([(0, 6), (4, 8)], 10, [(8, 10)]),
    ([(12, 20)], 10, [(0, 10)]),
])  # fmt: skip
def test_missing_ranges(done, reps, gaps):
    assert missing_ranges(done, reps) == gaps


# --- an estimator of one's own --------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class AlwaysTheMiddle:
    """Answers the middle of the anchors; fails on the first step."""

    shift_m: float = 0.0

    def __call__(self, batch, scenario, streams):
        R, T, _ = batch.azimuth.shape
        position = np.tile(batch.anchors.position.mean(axis=(0, 1, 2)) + self.shift_m, (R, T, 1))
        outcome = np.zeros((R, T), dtype=np.int8)
        outcome[:, 0] = aoabench.Outcome.FAILED
        position[:, 0] = np.nan
        return aoabench.Estimates(position, None, None, outcome)


def test_an_object_of_ones_own_gets_its_rows_and_the_same_draws(tmp_path, reference):
    frame = aoabench.run(*BASE, "reps=60", estimators={"middle": AlwaysTheMiddle()}, out=tmp_path)
    mine = frame[frame["estimator"] == "middle"]
    assert len(mine) == 60
    assert (mine["outcome"] == "failed").all()
    assert (mine["n_failed"] == 1).all()
    assert mine["rmse_3d_m"].between(1, 5).all()
    summary = pd.read_parquet(tmp_path / "summary.parquet").set_index("estimator")
    assert summary.loc["middle", "failure_rate"] == 1.0
    theirs = frame[frame["estimator"] == "ekf_vmf"]["rmse_3d_m"].to_numpy()
    among = rows(reference)
    assert np.array_equal(
        theirs, among[among["estimator"] == "ekf_vmf"]["rmse_3d_m"].to_numpy()[:60]
    )
    again = aoabench.run(
        *BASE, "reps=60", estimators={"middle": AlwaysTheMiddle(shift_m=1.0)}, out=tmp_path
    )
    assert not np.allclose(again[again["estimator"] == "middle"]["rmse_3d_m"], mine["rmse_3d_m"])


PLUGIN = '''
from dataclasses import dataclass
import numpy as np
from aoabench import Estimates


@dataclass(frozen=True)
class Origin:
    """Answers the origin."""

    height_m: float = 0.0

    def __call__(self, batch, scenario, streams):
        R, T, _ = batch.azimuth.shape
        position = np.zeros((R, T, 3))
        position[..., 2] = self.height_m
        return Estimates(position, None, None, np.zeros((R, T), dtype=np.int8))
'''


def test_one_file_and_one_yaml_add_an_estimator(tmp_path, monkeypatch):
    """Through two worker processes, named in plugins and found by --config-dir."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_origin.py").write_text(PLUGIN)
    (tmp_path / "conf" / "estimator").mkdir(parents=True)
    (tmp_path / "conf" / "estimator" / "origin.yaml").write_text(
        "# Mine\norigin:\n  _target_: my_origin.Origin\n  height_m: 0\n"
    )
    frame = aoabench.run(
        "estimator=[origin]",
        "filter=[ekf_vmf]",
        "reps=300",
        "runner.n_jobs=2",
        out="out",
        config_dir="conf",
        plugins=["my_origin"],
    )
    assert frame.groupby("estimator").size().to_dict() == {"ekf_vmf": 300, "origin": 300}
    with pytest.raises(aoabench.UserError, match="plugins"):
        aoabench.run("estimator=[origin]", "reps=3", out="out", config_dir="conf")


def test_load_says_what_is_missing(tmp_path):
    with pytest.raises(aoabench.UserError, match="no results"):
        aoabench.load(tmp_path)


# --- several cells, other people's mistakes -------------------------------------------------------


def test_cells_that_are_one_are_merged_and_shared_parts_computed_once(tmp_path):
    done = runner.run(
        compose_cells(["filter=[ekf_vmf],[ukf_vmf]", "reps=20", f"runner.out={tmp_path}/a"]),
        progress=False,
    )
    assert done.computed == 40
    assert aoabench.load(tmp_path / "a")["cell"].nunique() == 1
    cells = compose_cells(
        [
            "filter=[ekf_vmf,ukf_vmf]",
            "filter.ukf_vmf.lambda_=0,1,2,3",
            "reps=20",
            f"runner.out={tmp_path}/b",
            "runner.n_jobs=2",
        ]
    )
    done = runner.run(cells, progress=False)
    assert done.computed == 20 + 4 * 20
    frame = aoabench.load(tmp_path / "b")
    assert frame.groupby(["cell", "estimator"]).size().eq(20).all()
    assert frame["cell"].nunique() == 4


def test_equal_numbers_are_one_cell(tmp_path):
    cells = compose_cells(
        ["filter=[ekf_vmf]", "noise.sigma_deg=5,5.0", "reps=5", f"runner.out={tmp_path}"]
    )
    assert runner.run(cells, progress=False).computed == 5


def test_run_returns_just_what_was_asked_for(tmp_path):
    aoabench.run("noise=vmf", "filter=[ekf_vmf]", "reps=5", out=tmp_path)
    frame = aoabench.run("noise=ae_flip", "filter=[ukf_vmf]", "reps=5", out=tmp_path)
    assert set(zip(frame["noise"], frame["estimator"])) == {("ae_flip", "ukf_vmf")}
    assert len(aoabench.load(tmp_path)) == 10


def test_an_object_may_not_take_a_presets_name(tmp_path):
    with pytest.raises(aoabench.UserError, match="ekf_vmf"):
        aoabench.run("filter=[ekf_vmf]", estimators={"ekf_vmf": AlwaysTheMiddle()}, out=tmp_path)


@dataclasses.dataclass(frozen=True)
class WithArray:
    """Carries a long array, whose repr is abbreviated."""

    offsets: np.ndarray

    def __call__(self, batch, scenario, streams):
        position = np.full((*batch.azimuth.shape[:2], 3), self.offsets[1000])
        return aoabench.Estimates(position, None, None, np.zeros(position.shape[:2], dtype=np.int8))


def test_every_element_of_an_objects_content_counts(tmp_path):
    offsets = np.zeros(5000)
    first = aoabench.run("filter=[]", "reps=5", estimators={"a": WithArray(offsets)}, out=tmp_path)
    offsets = offsets.copy()
    offsets[1000] = 3.0
    second = aoabench.run("filter=[]", "reps=5", estimators={"a": WithArray(offsets)}, out=tmp_path)
    assert not np.allclose(first["rmse_3d_m"], second["rmse_3d_m"])


@dataclasses.dataclass(frozen=True)
class Careless:
    """Breaks the contract in one way or another."""

    how: str

    def __call__(self, batch, scenario, streams):
        R, T, _ = batch.azimuth.shape
        position, outcome = np.zeros((R, T, 3)), np.zeros((R, T), dtype=np.int8)
        if self.how == "nan":
            position[:, 5:] = np.nan
        if self.how == "shape":
            position = position[:, :-1]
        if self.how == "writes":
            batch.anchors.position[...] += 1
        return aoabench.Estimates(position, None, None, outcome)


def test_a_nan_that_claims_to_be_a_position_is_a_failure(tmp_path):
    frame = aoabench.run("filter=[]", "reps=5", estimators={"a": Careless("nan")}, out=tmp_path)
    assert (frame["outcome"] == "failed").all()
    assert (frame["n_failed"] == 59).all()


def test_wrong_shapes_are_named(tmp_path):
    with pytest.raises(
        aoabench.UserError, match=r"Careless: Estimates.position must have the shape"
    ):
        aoabench.run(
            "filter=[]",
            "reps=5",
            "runner.n_jobs=1",
            estimators={"a": Careless("shape")},
            out=tmp_path,
        )


def test_what_estimators_share_cannot_be_written(tmp_path):
    with pytest.raises(aoabench.RunError, match="read-only"):
        aoabench.run(
            "filter=[]",
            "reps=5",
            "runner.n_jobs=1",
            estimators={"a": Careless("writes")},
            out=tmp_path,
        )


def test_estimators_that_saw_older_draws_leave_the_cell(tmp_path, monkeypatch):
    aoabench.run("filter=[ekf_vmf]", "reps=5", out=tmp_path)
    for module in (reach, keys):
        monkeypatch.setattr(module, "version", lambda name: "another")
    aoabench.run("filter=[ukf_vmf]", "reps=5", out=tmp_path)
    assert set(aoabench.load(tmp_path)["estimator"]) == {"ukf_vmf"}


def test_a_lost_table_is_made_again_and_a_torn_record_is_reported_and_mended(tmp_path):
    both = ("noise=vmf,ae_flip", "filter=[ekf_vmf]", "reps=5", "runner.n_jobs=1")
    other = ("noise=ae_normal", "filter=[ekf_vmf]", "reps=5", "runner.n_jobs=1")
    aoabench.run(*both, out=tmp_path)
    lost = sorted((tmp_path / "replications.parquet").glob("*.parquet"))[0]
    lost.unlink()
    aoabench.run(*other, out=tmp_path)
    assert lost.exists()
    before = aoabench.load(tmp_path)
    assert len(before) == 15
    record = tmp_path / "cells" / f"{lost.stem}.json"
    record.write_text('{"cell": ')
    for words in (both, (*other, "reps=9")):
        with pytest.raises(
            aoabench.RunError, match=rf"{lost.stem}\.json is torn or altered; delete it"
        ):
            aoabench.run(*words, out=tmp_path)
    assert not list((tmp_path / "parts").rglob("*-000000009.json")), "nothing was computed"
    pd.testing.assert_frame_equal(aoabench.load(tmp_path), before)
    record.unlink()
    with pytest.raises(
        aoabench.RunError, match=rf"{lost.stem}\.json is missing.* run the command of that"
    ):
        aoabench.run(*other, out=tmp_path)
    assert (
        runner.run(compose_cells([*both, f"runner.out={tmp_path}"]), progress=False).computed == 0
    )
    pd.testing.assert_frame_equal(aoabench.load(tmp_path), before)


def test_steps_follow_what_was_asked_for_last(tmp_path):
    run(tmp_path, "reps=20", "store.steps=true")
    run(tmp_path, "reps=10", "store.steps=true")
    assert pd.read_parquet(tmp_path / "steps.parquet")["replication"].max() == 9
    run(tmp_path, "reps=10")
    assert not list((tmp_path / "steps.parquet").glob("*.parquet"))


def test_equal_numbers_have_equal_keys(tmp_path):
    aoabench.run("filter=[ekf_vmf]", "noise.sigma_deg=5", "reps=5", out=tmp_path)
    aoabench.run("filter=[ukf_vmf]", "noise.sigma_deg=5.0", "reps=5", out=tmp_path)
    assert set(aoabench.load(tmp_path)["estimator"]) == {"ekf_vmf", "ukf_vmf"}


def test_two_runs_into_one_folder_at_once_keep_each_others_results(tmp_path):
    """Five rounds of two processes with different estimators and noises."""
    for i in range(5):
        out = tmp_path / str(i)
        words = [["filter=[ekf_vmf]", "noise=vmf"], ["filter=[ukf_vmf]", "noise=vmf,ae_flip", "-m"]]
        jobs = [Command(*w, "reps=2", "runner.n_jobs=1", f"runner.out={out}") for w in words]
        assert [job.finished()[0] for job in jobs] == [0, 0]
        frame = aoabench.load(out)
        assert set(zip(frame["noise"], frame["estimator"])) == {
            ("vmf", "ekf_vmf"),
            ("vmf", "ukf_vmf"),
            ("ae_flip", "ukf_vmf"),
        }
        assert len(pd.read_parquet(out / "summary.parquet")) == 3
        assert len(pd.read_parquet(out / "timing.parquet")) == 3


def test_compare_names_the_cells_and_pairs_what_is_common(tmp_path, capsys):
    from aoabench.cli.main import dispatch

    aoabench.run("filter=[ekf_vmf,ekf_ae_nominal]", "noise.sigma_deg=3,9", "reps=20", out=tmp_path)
    aoabench.run("filter=[ukf_vmf]", "noise.sigma_deg=3", "reps=5", out=tmp_path)
    dispatch(["compare", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.index("noise.sigma_deg=3") < said.index("noise.sigma_deg=9")
    assert "only 5 of 20 replications" in said
    assert "ekf_ae_nominal is worse than ekf_vmf by " in said
    dispatch(["compare", str(tmp_path), "--metric", "iterations"])
    assert "nan" not in capsys.readouterr().out


def test_results_are_keyed_on_the_content_of_data_files(tmp_path, monkeypatch):
    """The same command with another plan under the same name computes again; untouched it does not."""
    from aoabench.config.compose import compose_cells

    monkeypatch.chdir(tmp_path)
    nodes = "x_m,y_m,z_m,facing_deg\n0,3,3,0\n10,3,3,180\n5,0,3,90\n"
    words = [
        "scenario=indoor_map",
        "scenario.walls=null",
        "scenario.anchors=nodes.csv",
        "scenario.route=[[2,3],[8,3]]",
    ]
    keys = []
    for text in (nodes, nodes, nodes.replace("5,0,3", "5,1,3")):
        (tmp_path / "nodes.csv").write_text(text)
        cells = compose_cells([*words, "noise=ofdm_crlb", "filter=[ekf_aoa]"])
        keys += RunKeys.of(cells).draws.values()
    assert keys[0] == keys[1] != keys[2]


def test_known_access_nodes_are_drawn_per_replication_and_paired_over_the_uncertainty():
    """Role 2 of the streams: other replications differ, and the errors scale with an_sigma_m."""
    import numpy as np

    from aoabench.config.compose import compose_cells
    from aoabench.engine.draws import Draws

    offset = {}
    for sigma in (1.0, 3.0):
        words = [
            "scenario=indoor_map",
            "noise=ofdm_crlb",
            "filter=[ekf_aoa]",
            f"noise.an_sigma_m={sigma}",
        ]
        cell = compose_cells([*words, "scenario.route=[[17.5,24.5],[19.5,24.5]]"])[0]
        anchors = Draws(cell.scenario, cell.noise, 1).tile(0, 4)[1].anchors
        offset[sigma] = anchors.position - cell.scenario.true_anchors.position
        assert anchors.of(2).position.shape == (1, 1, 107, 3)
        assert np.array_equal(anchors.of(2).position[0], anchors.position[2])
    assert np.allclose(3 * offset[1.0], offset[3.0])
    assert not np.allclose(offset[1.0][0], offset[1.0][1])


def test_a_report_says_what_was_computed_not_the_rows_of_its_tables():
    rows = ({"cell": "a", "mean": 1.0},) * 100
    report = runner.RunReport(Path("results/raw/run"), 40, 20, 3.14159, precision=rows)
    said = "results/raw/run: 40 estimator-replications computed, 20 reused"
    assert repr(report) == f"RunReport({said}, 3.14 s)"
    report = dataclasses.replace(report, damaged=(Path("a.json"), Path("b.json")))
    assert repr(report) == f"RunReport({said}, 2 damaged, 3.14 s)"
