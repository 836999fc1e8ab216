"""Runs in which nothing, or little, is measured are known before they start."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.heard import check_heard
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.errors import UserError
from aoabench.roles import Scenario
from aoabench.types import Anchors

NODES = "x_m,y_m,z_m,facing_deg\n0,3,2.5,0\n6,0,2.5,90\n12,3,2.5,180\n6,6,2.5,-90\n"
WALLS = '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": [[0, 0], [12, 0], [12, 6], [0, 6], [0, 0]]}}]}'
INSIDE = "scenario.route=[[1,1],[11,1],[11,5],[1,5]]"
PLAN = ["scenario=indoor_map", "scenario.anchors=an.csv", "scenario.walls=walls.geojson",
        "scenario.corner_radius_m=0.3", "noise=ae_normal", "noise.sigma_deg=3", "filter=[ekf_aoa]"]  # fmt: skip


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("an.csv").write_text(NODES)
    Path("walls.geojson").write_text(WALLS)


def test_anchors_on_walls_measure_from_everywhere_inside(here):
    heard_by_all(compose_cells([*PLAN, INSIDE])[0])


@pytest.mark.skipif("AOABENCH_CASES" not in os.environ, reason="AOABENCH_CASES names no folder")
def test_anchors_on_walls_of_the_case(monkeypatch):
    monkeypatch.chdir(Path(os.environ["AOABENCH_CASES"]) / "anchors_on_walls")
    heard_by_all(compose_cells([*PLAN, INSIDE])[0])


def heard_by_all(cell):
    """All four anchors measure at each step, and the filter stays near the truth.

    The RMSE of a replication is below 0.3 m by a wide margin: three deg at 6 m are 0.3 m from one
    anchor at one step; 64 replications.
    """
    assert cell.notes == ()
    _, batch = Draws(cell.scenario, cell.noise, 1).tile(0, 8)
    assert np.isfinite(batch.azimuth).all()
    rows = run_block(cell.scenario, cell.noise, cell.estimators, 1, 0, 64)["ekf_aoa"]["rows"]
    assert np.all(rows["rmse_3d_m"] < 0.3)


def test_few_steps_with_a_measurement_are_told(here):
    """The route leaves the room by a door."""
    Path("walls.csv").write_text("x0_m,y0_m,x1_m,y1_m\n0,0,12,0\n12,0,12,6\n12,6,1,6\n0,6,0,0\n")
    way = [*PLAN, "scenario.walls=walls.csv", "scenario.route=[[0.5,5],[0.5,9],[90,9]]"]
    cell = compose_cells(way)[0]
    share = cell.scenario.hears(cell.scenario.truth(None)[:, :3]).any(axis=1).mean()
    assert 0.01 < share < 0.1
    (line,) = cell.notes
    told = float(line.split("measures at ")[1].split(" %")[0])
    assert told == pytest.approx(100 * share, abs=0.5)
    assert "scenario.least_heard=0.1" in line
    assert compose_cells([*way, "scenario.least_heard=0"])[0].notes == ()
    assert "printed below scenario.least_heard=0.9" in compose_cells(
        [*PLAN, "scenario.walls=walls.csv", "scenario.route=[[0.5,5],[0.5,9],[5,9]]",
         "scenario.least_heard=0.9"])[0].notes[0]  # fmt: skip


def test_drawn_tracks_are_only_doubted(here):
    Path("an.csv").write_text(NODES.replace("0,3,2.5,0", "0,3,2.5,180").split("6,0")[0])
    few = [*PLAN, "scenario.truth_from=model", "scenario.steps=3", INSIDE]
    (line,) = compose_cells(few)[0].notes
    assert "measures at 0 % of the steps of replication 0" in line


def test_odd_anchors_are_noted(here):
    Path("an.csv").write_text(NODES.replace("x_m,y_m", "y_m,x_m"))
    line, *_ = compose_cells([*PLAN, INSIDE])[0].notes
    assert line.startswith("access nodes 3 stand outside the walls, which lie within x 0 to 12")
    Path("an.csv").write_text(
        "id,"
        + NODES.replace("\n0,3", "\nw,0,3")
        .replace("\n6", "\ne,6")
        .replace("\n12,3,2.5,180", "\nn,12,3,2.5,90")
        .replace("e,6,6", "s,6,6")
    )
    (line,) = compose_cells([*PLAN, INSIDE])[0].notes
    assert line.startswith("access nodes n stand on a wall and face along it")


@dataclass(frozen=True)
class Deaf(Scenario):
    """A user's own scenario, whose anchor at the origin is heard up to a distance; the target is
    5 m away in x, more by a random number, and at the origin at one step.
    """

    name: str
    range_m: float
    spread_m: float = 0.0
    near: int | None = None

    @property
    def true_anchors(self):
        return Anchors(np.zeros((1, 3)), np.eye(3)[None])

    def truth(self, rng):
        truth = np.zeros((2000, 3))
        truth[:, 0] = 5 + self.spread_m * rng.random(2000)
        if self.near is not None:
            truth[self.near] = 0
        return truth

    def hears(self, points):
        return (np.linalg.norm(points, axis=1) < self.range_m)[:, None]


def test_any_scenario_with_hears_is_asked():
    assert check_heard(Deaf("own", 6), 1) == ()
    with pytest.raises(UserError, match=r"^scenario.name='own' is not allowed; .* measures"):
        check_heard(Deaf("own", 4), 1)
    (line,) = check_heard(Deaf("own", 4, spread_m=1), 1)
    assert "0 % of the steps of replication 0" in line
    (line,) = check_heard(Deaf("own", 4, near=7), 1)  # not among the steps looked at first
    assert "0.05 % of the steps;" in line
