"""Smoothers on recordings: tags apart, gaps, and what a walk gains."""

import numpy as np
import pandas as pd
import pytest

import aoabench

ANCHORS = {
    "A1": (0, 3, 2.3, 0),
    "A2": (6, 0, 2.3, 90),
    "A3": (12, 3, 2.3, 180),
    "A4": (6, 6, 2.3, -90),
}
NAMES = ["ekf_vmf", "ekf_vmf_smoother", "map_smoother"]


def rows(tag, speed, start, rng):
    """Angles of a walk with deviations of 6 deg, one in six missing, and a gap of 1.5 s."""
    found = []
    for k in range(80):
        t = 0.1 * k
        at = np.array([start + speed * t, 3 + 0.8 * np.sin(0.6 * t), 1.1])
        for name, (x, y, z, facing) in ANCHORS.items():
            if 30 <= k < 45 or rng.random() < 0.16:
                continue
            dx, dy, dz = at - (x, y, z)
            azimuth = np.degrees(np.arctan2(dy, dx)) - facing + 6 * rng.normal()
            elevation = np.degrees(np.arctan2(dz, np.hypot(dx, dy))) + 6 * rng.normal()
            turned = (azimuth + 180) % 360 - 180
            found.append((round(t, 3), tag, name, turned, elevation, *at))
    return found


@pytest.fixture(scope="module")
def steps(tmp_path_factory):
    """The stored steps of two tags in one log, and of each tag in a log of its own."""
    folder, rng = tmp_path_factory.mktemp("log"), np.random.default_rng(3)
    anchors = pd.DataFrame([(k, *v) for k, v in ANCHORS.items()])
    anchors.columns = ["id", "x_m", "y_m", "z_m", "facing_deg"]
    anchors.to_csv(folder / "anchors.csv", index=False)
    each = {"T1": rows("T1", 0.8, 1, rng), "T2": rows("T2", -0.7, 11, rng)}
    found = {}
    for name, log in {**each, "both": sorted([*each["T1"], *each["T2"]])}.items():
        columns = ["time_s", "tag", "anchor", "azimuth_deg", "elevation_deg", "x_m", "y_m", "z_m"]
        pd.DataFrame(log, columns=columns).to_csv(folder / f"{name}.csv", index=False)
        words = [f"scenario.path={folder / name}.csv", f"scenario.anchors={folder / 'anchors.csv'}"]
        words += ["scenario=recorded", "scenario.window_s=0.05", f"filter=[{','.join(NAMES)}]"]
        aoabench.run(*words, "runner.n_jobs=1", out=folder / f"run-{name}")
        parts = sorted((folder / f"run-{name}" / "steps.parquet").glob("*.parquet"))
        found[name] = pd.concat([pd.read_parquet(part) for part in parts])
    return found


@pytest.mark.parametrize("name", NAMES)
def test_two_tags_in_one_log_equal_each_alone(name, steps):
    for tag in ("T1", "T2"):
        both, alone = (steps[log][steps[log]["estimator"] == name] for log in ("both", tag))
        both = both[both["tag"] == tag]
        columns = ["time_s", "x_m", "y_m", "z_m", "sigma_x_m", "cov_xy_m2"]
        assert len(alone) > 60
        assert np.array_equal(both[columns].to_numpy(), alone[columns].to_numpy())


def test_a_walk_is_known_better_afterwards(steps):
    rmse = {
        name: np.sqrt((frame["error_xy_m"] ** 2).mean())
        for name, frame in steps["both"].groupby("estimator")
    }
    assert rmse["ekf_vmf_smoother"] < 0.6 * rmse["ekf_vmf"]
    assert rmse["map_smoother"] < 0.6 * rmse["ekf_vmf"]
