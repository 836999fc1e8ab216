"""Every method counts anchors, not packets: an anchor that sends a packet twice is one anchor."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from aoabench.config import catalogue
from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.deployment.solving import solve
from aoabench.maths.geometry import euler

METHODS = [*options("estimator"), *(name for name in options("filter") if name != "map_smoother")]
ANCHORS = {"a": (0, 0, 3, 45), "b": (8, 0, 3, 135), "c": (8, 6, 3, 225), "d": (0, 6, 3, -45)}
ANCHORS |= {"e": (4, 0, 3, 90)}
WRONG = {3: "b", 4: "b"}  # the anchors, by fix, whose azimuths are 70 deg off
PACKETS = 3


def write_log():
    """A log of anchors that each send every packet PACKETS times; a hears only fixes 1 and 4."""
    poses = [f"{name},{x},{y},{z},{facing}" for name, (x, y, z, facing) in ANCHORS.items()]
    Path("anchors.csv").write_text("\n".join(["id,x_m,y_m,z_m,facing_deg", *poses]))
    rows = ["fix,time_s,anchor,azimuth_deg,elevation_deg,rssi_dbm,range_m"]
    for k in range(6):
        for name, (x, y, z, facing) in ANCHORS.items():
            if name == "a" and k not in (1, 4):
                continue
            seen = euler([0, 0, np.radians(facing)]).T @ (
                np.array([3 + 0.3 * k, 2.5, 1]) - [x, y, z]
            )
            azimuth = np.degrees(np.arctan2(seen[1], seen[0])) + 70 * (WRONG.get(k) == name)
            far = np.hypot(*seen[:2])
            row = azimuth, np.degrees(np.arctan2(seen[2], far)), -40 - far, np.hypot(far, seen[2])
            rows += [f"{k},{k},{name},{','.join(map(repr, map(float, row)))}"] * PACKETS
    Path("log.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packets")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_log()
    return folder


@cache
def cell_of(combine):
    """The cell with all methods that fit this recording."""
    words = ["scenario=recorded", "scenario.path=log.csv", "scenario.anchors=anchors.csv"]
    words += [f"scenario.combine={combine}", "scenario.height_m=1", "scenario.motion=random_walk"]
    (cell,) = compose_cells([*words, "estimator=[ls_lines]"])
    found = catalogue.fitting_estimators(cell.scenario, cell.noise)
    found["filter"].remove("map_smoother")
    chosen = [f"{group}=[{','.join(names)}]" for group, names in found.items()]
    return compose_cells([*words, *chosen, "estimator.single_anchor_1.anchor=2"])[0]


def used(name, combine, engine):
    """The number of anchors that each fix uses, None where the method does not fit recordings."""
    cell = cell_of(combine)
    method = cell.estimators.get(name)
    if method is None or (engine == "numpy" and "engine" not in method.__dataclass_fields__):
        return None
    method = replace(method, engine=engine) if engine == "numpy" else method
    found = solve(cell.scenario, cell.noise, method, cell.scenario.tracks.counts)
    return found.estimates.anchors_used


@pytest.mark.parametrize("engine", ["auto", "numpy"])
@pytest.mark.parametrize("name", METHODS)
def test_anchors_are_counted_and_not_packets(name, engine, logged, monkeypatch):
    monkeypatch.chdir(logged)
    once = used(name, "first", engine)
    if once is None:
        pytest.skip("not for recordings, or one engine")
    each = used(name, "each", engine)
    assert np.nanmax(each) <= len(ANCHORS)
    voted = once > 0  # packets of one anchor agree, so that more fixes pass a vote
    np.testing.assert_array_equal(each[voted], once[voted])
    assert voted.any()
