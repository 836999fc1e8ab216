"""What goes wrong in one replication is data: it costs that replication, is told, and too much of
it stops the cell.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.config.compose import compose_cells
from aoabench.engine import runner, tiles
from aoabench.roles import Estimator

PLUGIN = '''
from dataclasses import dataclass
from typing import Any, ClassVar
import numpy as np
from aoabench import Estimates, UserError


@dataclass(frozen=True)
class Sometimes:
    """Hands on to `inner`, and goes wrong in a tile that holds one of some replications."""

    inner: Any
    raises: Any = ()
    nan: Any = ()
    says: str = "no luck"
    tile: ClassVar[int] = TILE

    def __call__(self, batch, scenario, streams):
        bad = sorted(set(self.raises) & set(streams.replications))
        if bad:
            raise {"memory": MemoryError, "user": UserError}.get(self.says, ArithmeticError)(f"{self.says} in {bad[0]}")
        e = self.inner(batch, scenario, streams)
        position = e.position.copy()
        for i, r in enumerate(streams.replications):
            if r in self.nan:
                position[i] = np.nan
        return Estimates(position, e.covariance, e.iterations, e.outcome)
'''
YAML = """\
{name}:
  _target_: my_luck{tile}.Sometimes
  raises: {raises}
  nan: {nan}
  says: {says}
  inner: {{_target_: aoabench.filters.kalman.EKF, measurement: {{_target_: aoabench.models.unit_vector.UnitVector, kappa: null}}}}
"""


@pytest.fixture
def luck(tmp_path, monkeypatch):
    """A function that writes an estimator of that kind and returns the words that select it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "conf" / "estimator").mkdir(parents=True)

    def write(name="luck", raises=(), nan=(), says="no luck", tile=128):
        (tmp_path / f"my_luck{tile}.py").write_text(PLUGIN.replace("TILE", str(tile)))
        text = YAML.format(name=name, raises=list(raises), nan=list(nan), says=says, tile=tile)
        (tmp_path / "conf" / "estimator" / f"{name}.yaml").write_text(text)
        return {"config_dir": "conf", "plugins": [f"my_luck{tile}"]}

    return write


WORDS = ["noise=vmf", "filter=[ekf_vmf]", "estimator=[luck]", "reps=300", "store.steps=true"]


@pytest.mark.parametrize("how", [["runner.n_jobs=1"], ["runner.n_jobs=2", "runner.chunk=1"]])
def test_an_exception_costs_its_replication_and_no_bit_of_the_others(how, luck, tmp_path):
    """Two in one tile, one in the next; the others are those of the EKF inside, which saw full
    tiles.
    """
    bad = [3, 100, 130]
    frame = aoabench.run(*WORDS, *how, out="out", **luck(raises=bad))
    theirs, mine = (
        frame[frame["estimator"] == name].set_index("replication") for name in ("ekf_vmf", "luck")
    )
    assert list(mine.index[mine["outcome"] == "failed"]) == bad
    assert mine.loc[bad, "rmse_3d_m"].isna().all()
    assert (mine.loc[bad, "n_failed"] == 64).all()
    columns = ["rmse_3d_m", "rmse_xy_m", "rmse_z_m", "outcome", "n_ok", "nees"]
    pd.testing.assert_frame_equal(
        mine.drop(bad)[columns], theirs.drop(bad)[columns], check_exact=True
    )
    steps = pd.read_parquet("out/steps.parquet")
    steps = [
        steps[steps["estimator"] == name].set_index(["replication", "step"])
        for name in ("ekf_vmf", "luck")
    ]
    a, b = (s[~s.index.get_level_values(0).isin(bad)][["x_m", "y_m", "z_m"]] for s in steps)
    pd.testing.assert_frame_equal(a, b, check_exact=True)
    told = pd.read_parquet("out/failures.parquet")
    assert list(told["replication"]) == bad
    assert list(told["error"]) == [f"ArithmeticError: no luck in {r}" for r in bad]
    assert set(told["outcome"]) == {"failed"}
    assert told["replay"][1].endswith("--estimator luck --replication 100 --plugins my_luck128")
    summary = pd.read_parquet("out/summary.parquet").set_index("estimator")
    assert summary.loc["luck", "failure_rate"] == pytest.approx(3 / 300)


def test_nan_that_claims_to_be_a_position_is_told_as_well(luck):
    frame = aoabench.run(*WORDS, "runner.n_jobs=1", out="out", **luck(nan=[7, 299]))
    mine = frame[frame["estimator"] == "luck"].set_index("replication")
    assert list(mine.index[mine["outcome"] == "failed"]) == [7, 299]
    told = pd.read_parquet("out/failures.parquet")
    assert list(told["error"]) == ["64 of 64 fixes claim a position and give NaN"] * 2


def test_a_run_without_failures_has_an_empty_table(tmp_path):
    aoabench.run("filter=[ekf_vmf]", "reps=3", out=tmp_path)
    assert pd.read_parquet(tmp_path / "failures.parquet").empty


def test_too_many_failures_stop_the_cell_and_what_is_there_is_kept(luck, tmp_path):
    """The other cell goes on; with a higher limit the same command goes on from there and computes
    nothing twice.
    """
    words = [
        *WORDS,
        "noise=vmf,ae_flip",
        "estimator.luck.raises=[0,1,2,3,4,5]",
        "runner.n_jobs=1",
        "runner.out=out",
    ]
    given = luck()
    cells = compose_cells([*words, "runner.max_failed=0.01"], **given)
    with pytest.raises(
        aoabench.RunError,
        match=r"'luck' failed in 6 of 128 .* runner.max_failed=0.01 .* no luck in 0 ",
    ):
        runner.run(cells, progress=False)
    told = pd.read_parquet("out/failures.parquet")
    assert sorted(told["replication"]) == sorted([0, 1, 2, 3, 4, 5] * 2), (
        "the tables show what was reached"
    )
    before = {f: f.stat().st_mtime_ns for f in (tmp_path / "out").glob("parts/*/*.json")}
    with pytest.raises(aoabench.RunError, match="6 of 128"):
        runner.run(cells, progress=False)
    assert {f: f.stat().st_mtime_ns for f in (tmp_path / "out").glob("parts/*/*.json")} == before
    done = runner.run(compose_cells([*words, "runner.max_failed=0.02"], **given), progress=False)
    assert done.computed + done.reused == 2 * 2 * 300
    assert done.reused == 2 * 2 * 128
    assert len(aoabench.load("out")) == 1200


def test_a_cell_that_stops_does_not_stop_another(luck):
    """The second cell shares the EKF's parts with the first, which stops before they are all there."""
    cells = compose_cells(
        [
            *WORDS,
            "reps=1000",
            "estimator.luck.raises=[],[0,1,2,3]",
            "runner.max_failed=0.002",
            "runner.n_jobs=1",
            "runner.out=out",
        ],
        **luck(),
    )
    with pytest.raises(aoabench.RunError, match="failed in 4 of"):
        runner.run(cells[::-1], progress=False)
    sizes = aoabench.load("out").groupby(["cell", "estimator"]).size()
    good = next(cell.id for cell in cells if not cell.estimators["luck"].function.raises)
    assert dict(sizes[good]) == {"ekf_vmf": 1000, "luck": 1000}


def test_an_estimator_that_fails_always_is_stopped_early(luck):
    with pytest.raises(aoabench.RunError, match="failed in 128 of 128 replications"):
        aoabench.run("estimator=[luck]", "reps=100000", "runner.chunk=128", "runner.n_jobs=1", out="out",
                     **luck(raises=range(5000), tile=16))  # fmt: skip


def test_declared_failures_never_stop_a_run(tmp_path):
    """Two planes through one point determine it whatever was measured: every fix is a failure that
    the method declares.
    """
    words = [
        "scenario.anchors.position_m=[[0,0,0],[0,0,0]]",
        "scenario.anchors.facing=[[1,0,0],[1,0,0]]",
    ]
    words += ["runner.n_jobs=1", "runner.max_failed=0"]
    frame = aoabench.run("estimator=[ls]", *words, "reps=10", out=tmp_path)
    assert (frame["n_failed"] == 64).all()
    told = pd.read_parquet(tmp_path / "failures.parquet")
    assert len(told) == 10
    assert told["error"].isna().all()


@pytest.mark.parametrize(("says", "expected", "match"), [
    ("user", aoabench.UserError, "user in 3"),
    ("memory", aoabench.RunError, "out of memory .* the same command continues"),
])  # fmt: skip
@pytest.mark.parametrize("jobs", [1, 2])
def test_what_is_not_the_datas_fault_stops_the_run(says, expected, match, jobs, luck):
    words = ["estimator=[luck]", "reps=20", "runner.chunk=1", f"runner.n_jobs={jobs}"]
    with pytest.raises(expected, match=match):
        aoabench.run(*words, out="out", **luck(raises=[3], says=says, tile=1))


def test_a_bad_value_that_shows_in_a_worker_is_the_users_mistake_there_too(tmp_path):
    with pytest.raises(aoabench.UserError, match="times of arrival"):
        aoabench.run(
            "filter=[ekf_toa_aoa]",
            "noise=vmf",
            "reps=64",
            "runner.n_jobs=2",
            "runner.chunk=8",
            out=tmp_path,
        )


@dataclass(frozen=True)
class Picky(Estimator):
    """Raises on the 5th replication of each tile of 8; sees anchors that differ between
    replications.
    """

    inner: Any
    tile = 8
    needs = frozenset()

    def __call__(self, batch, scenario, streams):
        if {r % 8 for r in streams.replications} & {5}:
            raise ValueError("5")
        return self.inner(batch, scenario, streams)


def test_each_replication_keeps_its_own_anchors_when_a_tile_is_repeated():
    cell = compose_cells(["scenario=indoor_map", "noise=ofdm_crlb", "filter=[ekf_aoa]", "noise.an_sigma_m=1",
                          "scenario.route=[[17.5,24.5],[19.5,24.5]]"])[0]  # fmt: skip
    inner = cell.estimators["ekf_aoa"]
    draws = tiles.Draws(cell.scenario, cell.noise, 1)
    _, plain = tiles.estimate_tile(draws, inner, 8)
    _, tried, errors = tiles.try_tile(draws, Picky(inner), 8)
    assert errors == {13: "ValueError: 5"}
    others = np.arange(8) != 5
    assert np.array_equal(tried.position[others], plain.position[:8][others])
    assert np.array_equal(tried.covariance[others], plain.covariance[:8][others])
    assert np.isnan(tried.position[5]).all()


@dataclass(frozen=True)
class Stopped(Estimator):
    """Reports an interruption as a compiler does: as the cause of an error of its own."""

    def __call__(self, batch, scenario, streams):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise RuntimeError("compilation failed") from error


def test_an_interruption_is_no_outcome():
    cell = compose_cells(["scenario=square_track", "noise=ae_normal", "filter=[ekf_vmf]"])[0]
    draws = tiles.Draws(cell.scenario, cell.noise, 1)
    with pytest.raises(KeyboardInterrupt):
        tiles.try_tile(draws, Stopped(), 0)
