"""Every preset gives the bits that were stored; `fingerprint.py` writes the file again."""

from pathlib import Path

import pytest

from aoabench.config.presets import options

pytest.importorskip("numba")

from tests.golden import fingerprint

STORED = Path(__file__).with_name("fingerprint.txt").read_text(encoding="utf-8").splitlines()


@pytest.fixture(scope="module")
def same_machine():
    """Skips where the processor's family or a library is another one: the bits differ rightly."""
    taken = [line for line in STORED if line.startswith("#")]
    differ = [(a, b) for a, b in zip(taken, fingerprint.head(), strict=True) if a != b]
    if differ:
        pytest.skip("; ".join(f"taken with {a[2:]}, this is {b[2:]}" for a, b in differ))


@pytest.mark.parametrize("case", fingerprint.CASES)
def test_rows_have_the_stored_bits(case, same_machine):
    stored = [line for line in STORED if line.split()[0] == case]
    moved = set(stored) ^ set(fingerprint.lines(case))
    lines = sorted({line.rsplit(None, 2)[0] for line in moved})
    assert not moved, f"{len(lines)} lines moved or are new: {', '.join(lines[:20])} ..."


def test_every_estimator_that_ships_has_its_lines():
    named = {tuple(line.split()[:2]) for line in STORED if not line.startswith("#")}
    assert {case for case, _ in named} == set(fingerprint.CASES)
    assert {estimator for _, estimator in named} == {*options("filter"), *options("estimator")}
