"""One flipped bit anywhere in a run's folder is reported, or changes no number."""

import random
import shutil

import pandas as pd
import pytest

import aoabench
from aoabench.store import tables
from tests.store import made

FLIPS = 200


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder of two cells that two collects have made; and what its readers return."""
    out = tmp_path_factory.mktemp("whole") / "run"
    made.cell(out, "a")
    tables.collect(out)
    made.cell(out, "b", ["ls"], sigma_deg=2.0)
    tables.collect(out, ["b"])
    expected = read(out)
    assert [len(frame) for frame in expected.values()] == [12, 1]
    return out, expected


def read(out):
    """The frames that readers return; None for one that reports why it cannot."""
    found = {}
    for name, ask in (("load", tables.load), ("compare", aoabench.compare)):
        try:
            found[name] = ask(out)
        except (aoabench.UserError, aoabench.RunError):
            found[name] = None
    return found


def assert_same(found, expected, cells=("a", "b")):
    for name, frame in found.items():
        if frame is not None:
            mine = frame[frame["cell"].isin(cells)].reset_index(drop=True)
            pd.testing.assert_frame_equal(mine, expected[name], check_exact=True)


def collected(out, *only):
    """What `load` returns after a collect; nothing if that reports why it cannot."""
    try:
        tables.collect(out, *only)
    except (aoabench.UserError, aoabench.RunError):
        return {}
    return {"load": tables.load(out)}


def check(whole, aside, seed):
    """Flip a bit of a file, each as likely as any other, and read. Where collect reads the file, and
    for every fifth seed, collect a copy and read; for every tenth, collect another cell and read.
    """
    out, expected = whole
    chance = random.Random(seed)
    files = sorted(f for f in out.rglob("*") if f.is_file() and f.stat().st_size)
    file = chance.choice(files)
    data = file.read_bytes()
    at, bit = chance.randrange(len(data)), chance.randrange(8)
    file.write_bytes(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])
    try:
        assert_same(read(out), expected)
        if seed % 5 == 0 or file.is_relative_to(out / "parts") or file.parent.name == "cells":
            assert_same(collected(shutil.copytree(out, aside / "run")), expected)
        if seed % 10 == 0:
            again = shutil.copytree(out, aside / "again")
            made.cell(again, "c", ["ls"], sigma_deg=3.0)
            assert_same(collected(again, ["c"]), expected)
    except BaseException as error:
        what = f"bit {bit} of byte {at} of {file.relative_to(out)}"
        raise AssertionError(f"seed {seed}: {what}") from error
    finally:
        file.write_bytes(data)
        shutil.rmtree(aside, ignore_errors=True)


def test_a_flipped_bit_is_reported_or_harmless(whole, tmp_path):
    for seed in range(FLIPS):
        check(whole, tmp_path / "aside", seed)
