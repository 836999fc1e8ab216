"""Places of the anchors heard, against loops over replications, steps and anchors."""

import numpy as np
import pytest

from aoabench.maths.places import at_anchors, at_places, numbers_of


def masks(rng, R, T, B, most):
    """Masks (R, T, B) of at most `most` anchors a step, none at the first."""
    mask = np.zeros((R, T, B), dtype=bool)
    for r in range(R):
        for t in range(1, T):
            mask[r, t, rng.choice(B, rng.integers(1, most + 1), replace=False)] = True
    mask[0, 1] = np.arange(B) < most
    return mask


@pytest.mark.parametrize("most", [1, 3, 7])
@pytest.mark.parametrize("R", [1, 4])
def test_numbers_ascend_and_fill_the_first_places(rng, R, most):
    mask = masks(rng, R, 6, 7, most)
    numbers = numbers_of(mask)
    assert numbers.shape == (R, 6, most)
    for own, heard in zip(numbers.reshape(-1, most), mask.reshape(-1, 7)):
        found = own[own >= 0]
        assert found.tolist() == np.flatnonzero(heard).tolist()
        if most < 7:
            assert own.tolist() == [*found, *[-1] * (most - len(found))]
        else:  # as in arrays of all anchors
            assert own.tolist() == [j if heard[j] else -1 for j in range(7)]


def test_a_place_remains_where_nothing_is_heard():
    assert numbers_of(np.zeros((2, 3), dtype=bool)).tolist() == [[-1], [-1]]


@pytest.mark.parametrize("replications", [(1, 1), (4, 1), (1, 4), (4, 4)])
@pytest.mark.parametrize("steps", [1, 6])
def test_values_at_places_and_back(rng, replications, steps):
    """From arrays of all anchors, the same or different in each replication and step, to places."""
    of_values, of_numbers = replications
    numbers = numbers_of(masks(rng, of_numbers, 6, 9, 3))
    values = rng.standard_normal((of_values, steps, 9, 2))
    found = at_places(values, numbers, np.array([5.0, 6.0]))
    R = max(replications)
    assert found.shape == (R, 6, 3, 2)
    for r, t, k in np.ndindex(R, 6, 3):
        number = numbers[r if of_numbers > 1 else 0, t, k]
        own = values[r if of_values > 1 else 0, t if steps > 1 else 0, number]
        assert found[r, t, k].tolist() == ([5, 6] if number < 0 else own.tolist())
    back = at_anchors(found[..., 0], numbers, 9)
    assert back.shape == (R, 6, 9)
    for r, t, j in np.ndindex(R, 6, 9):
        place = numbers[r if of_numbers > 1 else 0, t].tolist()
        there = j in place
        assert np.array_equal(
            back[r, t, j], found[r, t, place.index(j), 0] if there else np.nan, equal_nan=True
        )
