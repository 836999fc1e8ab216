"""Random streams, one for each (root seed, scenario name, replication, role).

No stream depends on the estimator, the worker or the task. So every estimator and every job of a
sweep gets the same draws (paired comparisons), replications can be added later, and one replication
can be repeated by its number.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISpawnableSeedSequence

from aoabench.maths.seeds import seed_states

TRUTH, MEASUREMENT, ANCHORS, ESTIMATOR = range(4)  # roles
_FEW = 4  # replications whose keys are not worth computing together
PRIOR, PARTICLES = range(2)  # purposes within the role ESTIMATOR


@lru_cache(maxsize=256)
def _words(name: str) -> tuple[int, ...]:
    digest = hashlib.blake2b(name.encode(), digest_size=16).digest()
    return tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))


def generator(
    seed: int, scenario: str, replication: int, role: int, purpose: int = 0
) -> np.random.Generator:
    """Return the generator of one role in one replication.

    `seed >= 0` is the root seed, `scenario` the scenario's name, `replication >= 0` its number.
    Equal arguments give equal draws; streams with any differing argument are independent.
    """
    sequence = np.random.SeedSequence(
        (seed, *_words(scenario), replication), spawn_key=(role, purpose)
    )
    return np.random.Generator(np.random.Philox(sequence))


def generators(
    seed: int, scenario: str, replications: Sequence[int], role: int, purpose: int = 0
) -> list[np.random.Generator]:
    """Return the `generator` of one role in each of several replications.

    Keys of replications below 2^32 are computed together, in a fifth of the time.
    """
    if len(replications) < _FEW or max(replications) >= 1 << 32:
        return [generator(seed, scenario, r, role, purpose) for r in replications]
    before, key = (seed, *_words(scenario)), (role, purpose)
    states = seed_states(before, replications, key)
    seeds = [_Seed((*before, r), key, state) for r, state in zip(replications, states)]
    return [np.random.Generator(np.random.Philox(one)) for one in seeds]  # type: ignore[arg-type]


@dataclass
class _Seed(ISpawnableSeedSequence):
    """The SeedSequence of these arguments, whose state (2,) uint64 is known."""

    entropy: tuple[int, ...]
    spawn_key: tuple[int, ...]
    state: np.ndarray

    @cached_property
    def _whole(self) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.entropy, spawn_key=self.spawn_key)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """NumPy's generators ask for their key once."""
        if n_words == len(self.state) and np.dtype(dtype) == self.state.dtype:
            return self.state
        return self._whole.generate_state(n_words, dtype)

    def spawn(self, n_children: int) -> list[Any]:
        """Further sequences, as SeedSequence spawns them."""
        return self._whole.spawn(n_children)


@lru_cache(maxsize=256)
def philox_key(seed: int, scenario: str, role: int, purpose: int) -> tuple[int, int]:
    """Key (two 32-bit words) of one role's counter-based generator in all replications."""
    first, second = np.random.SeedSequence(
        (seed, *_words(scenario)), spawn_key=(role, purpose)
    ).generate_state(2)
    return int(first), int(second)


@dataclass(frozen=True)
class Streams:
    """Random streams of the estimators for a tile of replications, numbered `replications`."""

    seed: int
    scenario: str
    replications: tuple[int, ...]

    def estimator(self, i: int, purpose: int = PARTICLES) -> np.random.Generator:
        """The generator for the tile's i-th replication; every estimator gets the same one."""
        return generator(self.seed, self.scenario, self.replications[i], ESTIMATOR, purpose)

    def philox_key(self, purpose: int = PARTICLES) -> tuple[int, int]:
        """Key (two 32-bit words) of a counter-based generator; the counter has to contain the
        replication's number.
        """
        return philox_key(self.seed, self.scenario, ESTIMATOR, purpose)
