"""Every estimator that takes batches of the anchors heard finds in them what it finds in batches of
all anchors.
"""

import numpy as np
import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import call
from aoabench.errors import UserError
from aoabench.types import Outcome

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


def cell_of(place, group, name, rest):
    if name.startswith("single_anchor"):
        rest = [*rest, f"estimator.{name}.anchor={HEARD[place]}"]
    if name.startswith("discrepancy"):
        rest = [*rest, f"estimator.{name}.vote=false"]  # too many anchors to vote
    if name.startswith("pf_"):
        rest = [*rest, f"filter.{name}.particles=200"]
    angular = any(part in name for part in ANGULAR)
    words = ["noise=vmf"] if angular else ["noise=ofdm_crlb", "noise.an_sigma_m=0.5"]
    words += ["noise.mounting_yaw_deg=3", *rest]
    return compose_cells([*PLACES[place], *words, f"{group}=[{name}]"])[0]


def setting(place, group, name):
    """A cell of access nodes of which few hear the target, with errors of their positions and
    orientations in each replication.
    """
    rest = ["filter=[]"] if group == "estimator" else []
    try:
        return cell_of(place, group, name, rest)
    except UserError as error:
        if "height" not in str(error):
            raise
        return cell_of(place, group, name, [*rest, f"estimator.{name}.height_m=1.5"])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("group", "name"), ESTIMATORS)
def test_the_anchors_heard_are_enough(place, group, name):
    cell = setting(place, group, name)
    estimator, draws = cell.estimators[name], Draws(cell.scenario, cell.noise, 1)
    truth, whole = draws.tile(0, R)
    _, heard = draws.tile(0, R, estimator.heard_only)
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
