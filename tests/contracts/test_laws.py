"""Metamorphic laws of the snapshot estimators: what a change of the world does to a fix.

shift      anchors and target moved by (5e5, 5e6, 100) m, as onto a national grid: the fix moves with
           them
permute    anchors in another order: the fix stays
turn       everything turned about the vertical: the fix turns with it
rotate     everything rotated in space
scale      everything a thousand times larger, with the same angles: so is the fix

The rules of aoabench.testing try the laws on every estimator with noise of 10 deg; here they are
tried on both engines, to a micrometre, and with the law of scale. LAWS says which law holds for which method, and why not where it does not. A law holds to 1e-6 m, at
distances of a few metres, and a rounding error of the coordinates is 1e-9 m on the national grid.
"""

from dataclasses import fields, replace

import numpy as np
import pytest

from aoabench.maths.geometry import euler
from aoabench.testing import worlds
from aoabench.types import Anchors, Batch
from tests.contracts.test_geometry import engines, preset
from tests.helpers import Place

SHIFT = np.array([5e5, 5e6, 100.0])
LENGTH = "has parameters in metres"
PLANES = "its plane of known height is horizontal"
AXIS = "measures from the world's x axis, so that an azimuth's jump moves"
ROWS = "its invariant rows are in the anchors' frames, which turn with the world"
ORDER = "its number names one anchor"
LAWS = {  # by method: law -> "" (it holds) or the reason why it does not
    "ls": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": ""},
    "ls_lines": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": ""},
    "ls_anchor_discarding": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": LENGTH},
    "ml_kcorr": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": LENGTH},
    "vmf_ml": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": LENGTH},
    "robust_ml": {"shift": "", "permute": "", "turn": "", "rotate": "", "scale": LENGTH},
    "anchor_mean": {"shift": "", "permute": "", "turn": "", "rotate": PLANES, "scale": ""},
    "single_anchor_1": {"shift": "", "permute": ORDER, "turn": "", "rotate": PLANES, "scale": ""},
    "discrepancy": {"shift": "", "permute": "", "turn": "boxes", "rotate": PLANES, "scale": LENGTH},
    "discrepancy_exact": {
        "shift": "", "permute": "", "turn": "", "rotate": PLANES, "scale": LENGTH,
    },
}  # fmt: skip
REASONS = {"boxes": "the boxes around the ellipses lie along the world's axes"}
IN_PLANE = ("anchor_mean", "single_anchor_1", "discrepancy", "discrepancy_exact")
HEIGHT = 1.0


@pytest.fixture(scope="module")
def world():
    """60 fixes of 5 anchors with 3 deg noise, inside a room of 10 x 8 x 3 m."""
    rng = np.random.default_rng(11)
    s = rng.uniform([0, 0, 2], [10, 8, 3], (5, 3))
    R = np.array([euler(turn).T for turn in rng.uniform(-0.4, 0.4, (5, 3))])
    p = np.column_stack([rng.uniform(1, 9, 60), rng.uniform(1, 7, 60), np.full(60, HEIGHT)])
    local = np.einsum("bij,tbj->tbi", R, p[:, None] - s)
    azimuth = np.arctan2(local[..., 1], local[..., 0])
    elevation = np.arctan2(local[..., 2], np.hypot(local[..., 0], local[..., 1]))
    noise = np.radians(3.0) * rng.normal(size=(2, 60, 5))
    return Batch((azimuth + noise[0])[None], (elevation + noise[1])[None], Anchors(s, R))


def positions(name, engine, batch, height=HEIGHT):
    estimator = preset(name)
    names = {f.name for f in fields(estimator)}
    if engine != "auto":
        estimator = replace(estimator, engine=engine)
    if name in IN_PLANE:
        estimator = replace(estimator, height_m=height)
    if "tolerance_m" in names:
        estimator = replace(estimator, tolerance_m=1e-9)
    found = estimator(batch, Place(batch.anchors), None)
    p = found.position[0]
    return np.where(np.isnan(p), 0.0, p), found.outcome[0]


def transformed(law, batch):
    """The changed batch and height, and the map of positions (T, 3) into it."""
    if law == "shift":
        return (worlds.shifted(batch, SHIFT), HEIGHT + SHIFT[2]), lambda p: p + SHIFT
    if law == "permute":
        return (worlds.permuted(batch, np.array([3, 0, 4, 2, 1])), HEIGHT), lambda p: p
    if law == "scale":
        larger = Anchors(1000 * batch.anchors.position, batch.anchors.rotation)
        return (replace(batch, anchors=larger), 1000 * HEIGHT), lambda p: 1000 * p
    T = euler([0.0, 0.0, 2.2]) if law == "turn" else euler([0.7, -0.4, 2.2])
    return (worlds.rotated(batch, T), HEIGHT), lambda p: p @ T.T


CASES = [
    pytest.param(name, engine, law, id=f"{name}-{engine}-{law}")
    for name, laws in LAWS.items()
    for law, reason in laws.items()
    if not reason
    for engine in engines(preset(name))
]


@pytest.mark.parametrize(("name", "engine", "law"), CASES)
def test_law_holds(name, engine, law, world):
    before, outcome = positions(name, engine, world)
    changed, expected = transformed(law, world)
    after, again = positions(name, engine, *changed)
    wanted = expected(before)
    axes = 2 if name in IN_PLANE else 3
    scale = 1000 if law == "scale" else 1
    assert np.abs(after - wanted)[:, :axes].max() < 1e-6 * scale
    assert np.array_equal(outcome, again)


@pytest.mark.parametrize(
    ("name", "law"),
    [(n, law) for n, laws in LAWS.items() for law in laws if laws[law] in (PLANES, ORDER)],
)
def test_law_that_cannot_hold_does_not(name, law, world):
    """The reasons in the table are real: the fix moves by more than a centimetre."""
    before, _ = positions(name, "auto", world)
    changed, expected = transformed(law, world)
    after, _ = positions(name, "auto", *changed)
    assert np.abs(after - expected(before))[:, :2].max() > 0.01
