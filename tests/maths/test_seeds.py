"""States of seed sequences, against NumPy's."""

import numpy as np
import pytest

from aoabench.maths.seeds import seed_states

BIG = 2**32


@pytest.mark.parametrize("seed", [0, 1, BIG - 1, BIG, 3**80])
@pytest.mark.parametrize("spawn_key", [(0, 0), (3, 1), (BIG, 5), ()])
def test_states_are_those_of_numpy(seed, spawn_key, rng):
    entropy = (seed, *rng.integers(0, BIG, 4).tolist())
    last = [0, 1, BIG - 1, *rng.integers(0, BIG, 5).tolist()]
    expected = [
        np.random.SeedSequence((*entropy, r), spawn_key=spawn_key).generate_state(2, np.uint64)
        for r in last
    ]
    assert np.array_equal(seed_states(entropy, last, spawn_key), expected)
