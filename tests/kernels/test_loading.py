"""The line about compiling is printed when something is compiled; several kernels are compiled on
several processors.
"""

import re
import time
from contextlib import contextmanager
from pathlib import Path

import numba
import pytest

from aoabench.filters.kalman import EKF, UKF
from aoabench.kernels import loading
from aoabench.kernels.cache import Kept
from aoabench.models.unit_vector import UnitVector


class Fake:
    """A kernel that calls `act` when it is needed."""

    module, kept = "kernels.none", Kept(Path("folder"))

    def __init__(self, name="one", noted=True, act=lambda: None):
        self.name, self.noted, self.ready = name, noted, act


def compiled():
    for _ in range(2):
        numba.njit("f8(f8)")(lambda x: x + 1.0)


@pytest.fixture
def said_by(monkeypatch):
    def run(*kernels):
        monkeypatch.setattr(loading, "load", lambda _name: loading)
        monkeypatch.setattr(loading, "kernels_of", lambda _module, _entries: list(kernels))
        lines = []
        loading.prepare("kernels.none", lines.append)
        return lines

    return run


@pytest.mark.parametrize("noted", [True, False])
def test_compiling_is_said_once(said_by, noted):
    """Also where the cache holds the kernel for another processor."""
    (line,) = said_by(Fake(noted=noted, act=compiled), Fake(noted=noted, act=compiled))
    assert line.startswith("compiling kernels")


def test_what_only_takes_long_is_not_said(said_by):
    before = loading.waited_s()
    assert said_by(Fake(act=lambda: time.sleep(1.6))) == []  # a slow disk
    assert loading.waited_s() - before >= 1.6, "counted once"


def test_without_numba_a_line_says_so(monkeypatch):
    monkeypatch.setattr(loading, "load", lambda _name: None)
    lines = []
    loading.prepare("kernels.none", lines.append)
    assert lines[0].startswith("numba is not installed")


@pytest.mark.parametrize(("kind", "name"), [(EKF, "ekf"), (UKF, "ukf")])
def test_an_estimator_asks_for_the_kernels_that_it_calls_alone(kind, name, monkeypatch):
    asked = []
    monkeypatch.setattr(loading, "_compile", lambda kernels, _say: asked.extend(kernels))
    kind(UnitVector(kappa=10.0)).prepare(print)
    assert [kernel.name for kernel in asked] == [name]


@pytest.fixture
def helped(monkeypatch):
    """The names of the kernels that helpers were given, by call."""
    calls = []

    @contextmanager
    def helping(kernels):
        calls.append([name for _, name in kernels])
        yield

    monkeypatch.setattr(loading, "helping", helping)
    return calls


def test_ahead_takes_all_kernels_that_the_cache_lacks_once(helped, monkeypatch):
    one, two = Fake("one", noted=False), Fake("two", noted=False)
    monkeypatch.setattr(loading, "load", lambda name: None if "kalman" in name else loading)
    monkeypatch.setattr(loading, "kernels_of", lambda _: [one, Fake("three"), two])
    with loading.ahead():
        assert helped == [["one", "two"]]


def test_every_module_that_estimators_name_is_compiled_ahead():
    package = Path(loading.__file__).parents[1]
    files = [f for room in ("estimators", "filters") for f in (package / room).glob("*.py")]
    named = {name for f in files for name in re.findall(r'"kernels\.(\w+)"', f.read_text())}
    assert set(loading._MODULES) == named


def test_kernels_are_collected_and_helpers_take_those_that_were_never_compiled(said_by, helped):
    """Helpers begin at the other end, and take neither what is cached nor the first, which this
    process compiles anyway.
    """
    seen, lines = [], []
    with loading.together(lines.append):
        for name, noted in (("a", False), ("b", False), ("c", True), ("d", False), ("a", False)):
            said_by(Fake(name, noted, lambda name=name: seen.append(name)))
        assert seen == helped == []
    assert helped == [["a", "d", "b"]]
    assert seen == [*"abcda"]
    assert len(lines) == 1
