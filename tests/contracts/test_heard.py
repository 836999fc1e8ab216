"""Every estimator that takes batches of the anchors heard finds in them what it finds in batches of
all anchors.
"""

import re
from functools import cache

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import call
from aoabench.errors import UserError
from aoabench.types import Outcome, Reason

ESTIMATORS = [("filter", n) for n in options("filter")] + [
    ("estimator", n) for n in options("estimator")
]
PLACES = {  # the anchors heard are the same in all replications, or differ
    "route": ["scenario=indoor_map", "scenario.dt=12", "scenario.nearest=12"],
    "model": [
        "scenario=indoor_map_model",
        "scenario.dt=2",
        "scenario.steps=12",
        "scenario.nearest=12",
        "scenario.walls=indoor_map.geojson",
        "scenario.prior_sigma_xy_m=20",
    ],
}
ANGULAR = ("adaptive", "fitted")  # parts of the names of those that need an angular noise
HEARD = {"route": 11, "model": 33}  # number of an anchor that is heard
R = 3


def changed(place, group, name):
    """The overrides of one estimator."""
    if name.startswith("single_anchor"):
        return [f"estimator.{name}.anchor={HEARD[place]}"]
    if name.startswith("discrepancy"):
        return [f"estimator.{name}.vote=false"]  # too many anchors to vote
    return [f"filter.{name}.particles=200"] if name.startswith("pf_") else []


def cell_of(place, angular, chosen, rest=()):
    """A cell of access nodes of which few hear the target, with errors of their positions and
    orientations in each replication, and the chosen estimators (group, name).
    """
    words = ["noise=vmf"] if angular else ["noise=ofdm_crlb", "noise.an_sigma_m=0.5"]
    words += ["noise.mounting_yaw_deg=3", *rest]
    for group in ("filter", "estimator"):
        words.append(f"{group}=[{','.join(name for g, name in chosen if g == group)}]")
    words += [word for pair in chosen for word in changed(place, *pair)]
    return compose_cells([*PLACES[place], *words])[0]


def is_angular(name):
    return any(part in name for part in ANGULAR)


@cache
def setting(place, angular):
    """A cell with the estimators that need an angular noise, or all others, its draws, and truth and
    batch by whether the batch has the anchors heard alone.
    """
    chosen = [(group, name) for group, name in ESTIMATORS if is_angular(name) == angular]
    try:
        cell = cell_of(place, angular, chosen)
    except UserError as error:
        if not re.fullmatch(r".* a known height, .* which estimator\..* need; .*", str(error)):
            raise
        low = re.findall(r"estimator\.(\w+)", str(error))
        cell = cell_of(place, angular, chosen, [f"estimator.{n}.height_m=1.5" for n in low])
    draws = Draws(cell.scenario, cell.noise, 1)
    return cell, draws, {heard: draws.tile(0, R, heard) for heard in (False, True)}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_the_anchors_heard_are_enough(place, group, name):
    cell, draws, batches = setting(place, is_angular(name))
    estimator = cell.estimators[name]
    truth, whole = batches[False]
    _, heard = batches[estimator.heard_only]
    if estimator.heard_only:
        assert heard.azimuth.shape[2] < whole.azimuth.shape[2]
    a, b = (call(estimator, batch, draws, (0, 1, 2), truth) for batch in (whole, heard))
    given = np.isfinite(a.position[..., 0])
    assert given.any()
    assert np.array_equal(a.outcome, b.outcome)
    # particle filters sum over the anchors in another order; resampling multiplies the rounding
    near = 1e-6 if name.startswith("pf_") else 1e-12
    assert np.allclose(a.position, b.position, rtol=near, atol=near, equal_nan=True)
    # a snapshot diverges at a bound that follows from the anchors that it uses, a filter from all
    same = (a.outcome != Outcome.DIVERGED) | (group == "filter")
    for field in ("iterations", "anchors_used", "reason"):
        one, other = getattr(a, field), getattr(b, field)
        assert (one is None) == (other is None)
        if one is not None:
            assert np.array_equal(one[same], other[same], equal_nan=True), field
    for field in ("covariance", "score"):
        one, other = getattr(a, field), getattr(b, field)
        assert (one is None) == (other is None)
        if one is not None:
            least = max(1e-9, near)
            assert np.allclose(one[given], other[given], rtol=least, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("name", ["ekf_toa_aoa", "ekf_vmf"])
def test_the_bound_of_filters_is_that_of_all_anchors_as_known(name):
    """Here all anchors are known some 30 m away from where they are."""
    rest = [f"filter.{name}.extent_factor=0.7", "noise.an_error=common", "noise.an_sigma_m=30"]
    cell = cell_of("route", False, [("filter", name)], rest)
    estimator, draws = cell.estimators[name], Draws(cell.scenario, cell.noise, 1)
    found = []
    for heard_only in (False, estimator.heard_only):
        truth, batch = draws.tile(0, R, heard_only)
        found.append(call(estimator, batch, draws, (0, 1, 2), truth).reason == Reason.TOO_FAR)
    assert np.array_equal(*found)
    assert 0 < found[0].mean() < 1
