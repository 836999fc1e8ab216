"""Every estimator in both engines on a corpus of degenerate and everyday geometries.

tests/corpus/geometry/*.yaml hold the cases:

anchors            rows x, y, z m and, optionally, yaw, pitch, roll deg
angles_deg         rows azimuth, elevation in the anchors' frames, null = not measured; or
truth              the target's position, from which exact angles follow; the answer is this position
without            numbers of anchors that measured nothing; azimuth_only: no elevation either
sigma_deg          rows of stated deviations
height_m           the target's known height
expect             per family (free: methods that need no height, plane: methods in a plane) or per
                   estimator: outcome, reason, position, tolerance_m, plane (x and y alone)
"""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.optimize import least_squares

from aoabench.config.compose import compose_cells
from aoabench.maths.geometry import LIGHT, euler, to_azel
from aoabench.streams import Streams
from aoabench.types import SENTENCES, Anchors, Batch, Outcome, Reason
from tests.contracts.test_presets import setting
from tests.helpers import Place, directions

FOLDER = Path(__file__).parents[1] / "corpus" / "geometry"
PRESETS = Path(__file__).parents[2] / "configs"
CASES = {
    f"{file.stem}-{case['name']}": case
    for file in sorted(FOLDER.glob("*.yaml"))
    for case in yaml.safe_load(file.read_text(encoding="utf-8"))
}
FREE = ("ls", "ls_lines", "ls_anchor_discarding", "ml_kcorr", "vmf_ml", "robust_ml")
PRINTED = ("ml_arctan", "ml_atan2")  # as printed: wrong where an azimuth jumps
PLANE = (
    "vmf_ml", "robust_ml", "anchor_mean", "single_anchor_1", "discrepancy", "discrepancy_exact",
)  # fmt: skip


@cache
def preset(name):
    needs_rssi = ["noise=ble_multipath"] if name in PLANE else ["noise=ae_normal"]
    cell = compose_cells(["scenario=ble_room", *needs_rssi, f"estimator=[{name}]"])[0]
    return cell.estimators[name]


def engines(estimator):
    names = {f.name for f in fields(estimator)}
    return ("auto", "numpy") if "engine" in names else ("auto",)


def anchors_of(case):
    rows = [[*row, 0, 0, 0][:6] for row in case["anchors"]]
    turns = [euler(np.radians([roll, pitch, yaw])).T for *_, yaw, pitch, roll in rows]
    return Anchors(np.array([row[:3] for row in rows], dtype=float), np.array(turns))


def batch_of(case):
    anchors = anchors_of(case)
    if "truth" in case:
        s, R = anchors.position[0, 0], anchors.rotation[0, 0]
        local = (R @ (np.array(case["truth"], dtype=float) - s)[..., None])[..., 0]
        angles = np.stack(to_azel(*local.T), axis=-1)
    else:
        angles = np.radians(np.array(case["angles_deg"], dtype=float))
    angles[case.get("without", []), :] = np.nan
    angles[case.get("azimuth_only", []), 1] = np.nan
    sigma = case.get("sigma_deg")
    stated = [None, None] if sigma is None else np.radians(np.array(sigma, dtype=float)).T
    azimuth, elevation, *stated = (
        None if a is None else np.asarray(a)[None, None] for a in (*angles.T, *stated)
    )
    return Batch(azimuth, elevation, anchors, None, None, *stated)


def run(name, case, engine="auto"):
    estimator = preset(name)
    batch = batch_of(case)
    scenario = Place(batch.anchors, case.get("height_m"))
    if engine != "auto":
        estimator = replace(estimator, engine=engine)
    if name in PLANE and "height_m" in {f.name for f in fields(estimator)}:
        estimator = replace(estimator, height_m=case.get("height_m"))
    return estimator(batch, scenario, None)


def expected(case, name, plane):
    expect = case["expect"]
    return expect.get(name, expect.get("plane" if plane else "free"))


def runs():
    for key, case in CASES.items():
        known = "height_m" in case
        for name in (*FREE, *(PLANE if known else ())):
            plane = known and name in PLANE
            want = expected(case, name, plane)
            if want is not None:
                for engine in engines(preset(name)):
                    yield pytest.param(case, name, engine, want, id=f"{key}-{name}-{engine}")


@pytest.mark.parametrize(("case", "name", "engine", "want"), list(runs()))
def test_right_answer(case, name, engine, want):
    found = run(name, case, engine)
    outcome = Outcome(int(found.outcome[0, 0])).name.lower()
    reason = Reason(int(found.reason[0, 0]))
    wanted = want["outcome"]
    assert outcome in ([wanted] if isinstance(wanted, str) else wanted), (reason, found.position)
    assert (outcome == "ok") == (reason == Reason.NONE)
    assert bool(SENTENCES[reason]) == (outcome != "ok")
    if "reason" in want:
        assert reason.name.lower() == want["reason"]
    if outcome in ("failed", "rejected"):
        assert np.isnan(found.position).all()
    else:
        assert np.isfinite(found.position[0, 0, :2]).all()
    if wanted == "ok":
        right = np.array(want.get("position", case.get("truth")), dtype=float)
        axes = 2 if want.get("plane") else len(right)
        error = np.linalg.norm(found.position[0, 0, :axes] - right[:axes])
        assert error < want.get("tolerance_m", 1e-6), error


TWICE = [
    pytest.param(case, name, id=f"{key}-{name}")
    for key, case in CASES.items()
    for name in (*FREE, *PRINTED, *(PLANE[4:] if "height_m" in case else ()))
    if len(engines(preset(name))) > 1
]


@pytest.mark.parametrize(("case", "name"), TWICE)
def test_both_engines_agree(case, name):
    """Outcome and reason are equal, and the position up to the conditioning of the fix."""
    fast, slow = (run(name, case, engine) for engine in ("auto", "numpy"))
    assert fast.outcome == slow.outcome
    assert fast.reason == slow.reason
    far = np.abs(np.nan_to_num(fast.position)).max()
    place = batch_of(case).anchors.position
    size, apart = far + np.abs(place).max(), np.ptp(place, axis=-2).max()
    # a rounding of a direction moves a far fix by far / apart of itself, in each of 1000 updates
    close = 1e-7 + 1000 * np.finfo(float).eps * far / max(apart, 1e-3)
    assert np.allclose(fast.position, slow.position, rtol=0, atol=close * size, equal_nan=True)
    assert np.isnan(fast.covariance).all() == np.isnan(slow.covariance).all()


def best_fit(case, starts=40):
    """The position of least squared difference of directions, by scipy from many starts."""
    batch = batch_of(case)
    s, d = batch.anchors.position[0, 0], directions(batch)[0, 0]
    known = np.isfinite(d).all(axis=-1)
    s, d = s[known], d[known]
    size = max(np.ptp(s, axis=0).max(), 1e-3)

    def residual(p):
        u = p - s
        return (u / np.linalg.norm(u, axis=-1, keepdims=True) - d).ravel()

    rng = np.random.default_rng(1)
    tries = s.mean(axis=0) + size * rng.normal(size=(starts, 3))
    tries = np.concatenate([tries, s + size * d, s + 10 * size * d])
    found = [least_squares(residual, p, xtol=1e-15, ftol=1e-15, gtol=1e-15) for p in tries]
    return min(found, key=lambda f: f.cost)


TYPED = [
    key
    for key, case in CASES.items()
    if (want := case["expect"].get("free", {})).get("outcome") == "ok" and "position" in want
]


@pytest.mark.parametrize("key", TYPED)
def test_typed_positions_are_the_best_fits(key):
    """The positions in the corpus against an optimiser that knows nothing of our estimators."""
    case = CASES[key]
    want = case["expect"]["free"]
    fit = best_fit(case)
    right = np.array(want["position"], dtype=float)
    scale = np.linalg.norm(right - anchors_of(case).position[0, 0].mean(axis=0))
    assert np.linalg.norm(fit.x - right) < max(want.get("tolerance_m", 0.0), 1e-4 * scale, 1e-6)


def test_the_corpus_is_large_enough_and_names_are_different():
    assert len(CASES) >= 60
    assert sum(len(yaml.safe_load(f.read_text())) for f in FOLDER.glob("*.yaml")) == len(CASES)


EVERY = [(group, file.stem) for group in ("estimator", "filter") for file in sorted(PRESETS.glob(f"{group}/*.yaml"))]  # fmt: skip


def everything_measured(case, states):
    """The case's batch with delays, strengths, deviations and a prior about the anchors' centre."""
    batch = batch_of(case)
    s = batch.anchors.position[0, 0]
    size = max(np.ptp(s, axis=0).max(), 1.0)
    truth = np.array(case.get("truth", s.mean(axis=0) + [0.3 * size, 0.2 * size, -1.0]))
    known = np.isfinite(batch.azimuth)
    delay = np.where(known, np.linalg.norm(truth - s, axis=-1) / LIGHT, np.nan)
    sigma = np.full_like(batch.azimuth, np.radians(2.0))
    mean = np.zeros((1, states))
    mean[0, :3] = s.mean(axis=0) + [0.1 * size, -0.2 * size, -0.5]
    return truth[None, None], replace(
        batch,
        anchors=replace(batch.anchors, position_sigma=np.full_like(batch.anchors.position, 0.1)),
        delay=delay,
        delay_sigma=np.full_like(delay, 1e-8),
        rssi=np.where(known, -60.0 - np.arange(len(s)), np.nan),
        azimuth_sigma=sigma if batch.azimuth_sigma is None else batch.azimuth_sigma,
        elevation_sigma=sigma if batch.elevation_sigma is None else batch.elevation_sigma,
        prior_mean=mean,
        prior_cov=np.diag([size**2] * 3 + [1.0] * (states - 3)),
    )


@pytest.mark.parametrize(("group", "name"), EVERY)
def test_every_preset_says_what_happened_in_every_geometry(group, name):
    """A position that is finite or a failure, a reason if and only if the outcome is not ok, and
    the same from both engines; the height is 2 m below the anchors where the case has none.
    """
    cell = compose_cells([*setting(name, "vmf"), f"{group}=[{name}]"])[0]
    estimator, motion = cell.estimators[name], cell.scenario.motion
    names = {f.name for f in fields(estimator)}
    if "particles" in names:
        estimator = replace(estimator, particles=500)
    for key, case in CASES.items():
        truth, batch = everything_measured(
            case, 3 if motion is None else len(motion.matrices(1)[0])
        )
        height = case.get("height_m", batch.anchors.position[..., 2].min() - 2.0)
        scenario = Place(batch.anchors, height, motion=motion)
        found = []
        for engine in engines(estimator):
            one = replace(estimator, engine=engine) if "engine" in names else estimator
            if "anchor" in names and one.anchor > batch.anchors.count:
                continue
            more = (truth,) if "truth" in one.needs else ()
            found.append(one(batch, scenario, Streams(1, "place", (0,)), *more))
        for e in found:
            outcome, reason = e.outcome[0, 0], e.reason[0, 0]
            assert (outcome == Outcome.OK) == (reason == Reason.NONE), key
            lost = outcome in (Outcome.FAILED, Outcome.REJECTED)
            assert np.isfinite(e.position[0, 0, :2]).all() != lost, key
            if "particles" not in names:  # whose engines draw different particles
                assert (outcome, reason) == (found[0].outcome[0, 0], found[0].reason[0, 0]), key
