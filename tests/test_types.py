"""Batches and estimates as a notebook shows them."""

import numpy as np

from aoabench.types import Anchors, Batch, Estimates, Outcome, Reason

ANCHORS = Anchors(np.zeros((4, 3)), np.broadcast_to(np.eye(3), (4, 3, 3)))


def test_a_batch_shows_shapes_units_and_ranges_not_arrays():
    azimuth = np.linspace(-3.0, 2.5, 2 * 50 * 4).reshape(2, 50, 4)
    azimuth[0, :, 0] = np.nan
    rssi = np.full((2, 50, 4), np.nan)
    batch = Batch(azimuth, np.zeros((2, 50, 4)), ANCHORS, rssi=rssi, time=np.arange(50.0)[None])
    assert repr(batch).splitlines() == [
        "Batch",
        "  azimuth    (2, 50, 4) rad, -2.986 to 2.5, 12.5 % NaN",
        "  elevation  (2, 50, 4) rad, 0 to 0",
        "  anchors    Anchors",
        "      position  (1, 1, 4, 3) m, 0 to 0",
        "      rotation  (1, 1, 4, 3, 3), 0 to 1",
        "  rssi       (2, 50, 4) dBm, 100 % NaN",
        "  time       (1, 50) s, 0 to 49",
    ]


def test_estimates_count_their_outcomes_by_name():
    outcome = np.full((2, 50), Outcome.OK.value)
    outcome[1, :3] = Outcome.DIVERGED
    reason = np.where(outcome == Outcome.OK, Reason.NONE.value, Reason.TOO_FAR.value)
    found = Estimates(np.ones((2, 50, 3)), None, None, outcome, reason=reason)
    assert repr(found).splitlines() == [
        "Estimates",
        "  position  (2, 50, 3) m, 1 to 1",
        "  outcome   (2, 50), 97 ok, 3 diverged",
        "  reason    (2, 50), 97 none, 3 too_far",
    ]


def test_what_is_no_array_is_shown_as_it_is():
    """A repr never fails: it is what a debugger shows of a mistake."""
    odd = Estimates([[1, 2]], None, "many", np.array([[9, 0]]))
    assert repr(odd).splitlines() == [
        "Estimates",
        "  position    [[1, 2]]",
        "  iterations  'many'",
        "  outcome     (1, 2), 1 ok, 1 9",
    ]
    assert "outcome     (0, 3)" in repr(
        Estimates(np.empty((0, 3, 3)), None, np.empty(0), np.empty((0, 3)))
    )
