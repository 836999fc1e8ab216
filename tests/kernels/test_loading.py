"""The line about compiling is printed when something is compiled."""

import time

import numba

from aoabench.kernels import loading


def said_by(load, monkeypatch):
    monkeypatch.setattr(loading, "load", load)
    lines = []
    loading.prepare("kernels.none", lines.append)
    return lines


def compiled(_name):
    for _ in range(2):
        numba.njit("f8(f8)")(lambda x: x + 1.0)
    return loading


def test_compiling_is_said_once(monkeypatch):
    (line,) = said_by(compiled, monkeypatch)
    assert line.startswith("compiling kernels")


def test_what_only_takes_long_is_not_said(monkeypatch):
    def slow(_name):
        time.sleep(1.6)  # a slow disk
        return loading

    assert said_by(slow, monkeypatch) == []


def test_what_comes_from_the_cache_is_not_said(monkeypatch, tmp_path):
    """A function that another process has compiled before, in a file of its own."""
    (tmp_path / "kept.py").write_text(
        "from numba import njit\n\n\n@njit('f8(f8)', cache=True)\ndef f(x):\n    return x + 2.0\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def imported(_name):
        import importlib
        import sys

        sys.modules.pop("kept", None)
        return importlib.import_module("kept")

    assert len(said_by(imported, monkeypatch)) == 1
    assert said_by(imported, monkeypatch) == []
