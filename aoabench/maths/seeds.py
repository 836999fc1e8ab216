"""States of many of NumPy's seed sequences at once.

numpy.random.SeedSequence hashes its words, 32 bits each, into a pool of four [O'Neill, seed_seq_fe,
2015]; NumPy keeps this algorithm for good. Sequences that differ in one word share the hash of the
words before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

_POOL, _MASK = 4, 0xFFFFFFFF
_FIRST_IN, _NEXT_IN, _FIRST_OUT, _NEXT_OUT = 0x43B0D7E5, 0x931E8875, 0x8B51F9DD, 0x58F38DED
_LEFT, _RIGHT = 0xCA01F9DD, 0x4973F715
Word = Any  # one for all sequences (int), or one for each, (R,) uint64 below 2^32


def seed_states(
    entropy: tuple[int, ...], last: Sequence[int], spawn_key: tuple[int, ...]
) -> np.ndarray:
    """The states (R, 2) uint64 of SeedSequence((*entropy, last[i]), spawn_key=spawn_key), for
    numbers `last` (R,) below 2^32 and entropy of at least four 32-bit words.
    """
    pool, constant = _before(entropy)
    after = [word for number in spawn_key for word in _words(number)]
    pool, _ = _mixed(pool, constant, [np.array(last, dtype=np.uint64), *after])
    constant, found = _FIRST_OUT, []
    for word in pool:
        word, constant = _hashed(word, constant, _NEXT_OUT)
        found.append(word)
    return np.stack([found[0] | found[1] << 32, found[2] | found[3] << 32], axis=1)


@lru_cache(maxsize=256)
def _before(entropy: tuple[int, ...]) -> tuple[tuple[Word, ...], int]:
    """The pool after the words of `entropy`, and the constant of the next hash."""
    words = [word for number in entropy for word in _words(number)]
    constant, pool = _FIRST_IN, []
    for word in words[:_POOL]:
        word, constant = _hashed(word, constant)
        pool.append(word)
    for source in range(_POOL):
        for place in range(_POOL):
            if place != source:
                word, constant = _hashed(pool[source], constant)
                pool[place] = _joined(pool[place], word)
    return _mixed(tuple(pool), constant, words[_POOL:])


def _mixed(
    pool: tuple[Word, ...], constant: int, words: Sequence[Word]
) -> tuple[tuple[Word, ...], int]:
    """The pool after further words, and the constant of the next hash."""
    now = list(pool)
    for word in words:
        for place in range(_POOL):
            hashed, constant = _hashed(word, constant)
            now[place] = _joined(now[place], hashed)
    return tuple(now), constant


def _hashed(word: Word, constant: int, factor: int = _NEXT_IN) -> tuple[Word, int]:
    """The hash of a word, and the constant of the next hash."""
    following = constant * factor & _MASK
    found = (word ^ constant) * following & _MASK
    return found ^ found >> 16, following


def _joined(x: Word, y: Word) -> Word:
    found = (_LEFT * x & _MASK) - (_RIGHT * y & _MASK) & _MASK
    return found ^ found >> 16


def _words(number: int) -> Iterable[int]:
    """The 32-bit words of a number >= 0, the lowest first; one at least."""
    yield number & _MASK
    while number := number >> 32:
        yield number & _MASK
