"""Shared pieces: the shipped configs as cells, and runs in a temporary folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pickle import dumps, loads
from typing import Any

import hydra
import numpy as np
import pytest

os.environ.setdefault("MPLBACKEND", "Agg")

from aoabench.cli.main import main
from aoabench.models.motion import RandomWalk
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.square_track import SquareTrack
from tests import helpers

pytest.approx = helpers.approx
np.allclose, np.isclose = helpers.stated(np.allclose), helpers.stated(np.isclose)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20180710)


@pytest.fixture
def track() -> SquareTrack:
    layout = AnchorLayout(
        [[-1, 0, 0], [6, 0, 0], [6, 5, 0], [-1, 5, 0]],
        [[1, 0, 0], [-1, 0, 0], [-1, 0, 0], [1, 0, 0]],
    )
    return SquareTrack("square_track", layout, RandomWalk())


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[Any, str, str]]:
    """The command line in this process: (words) -> exit status, standard output and error."""

    def run(*words: object) -> tuple[Any, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        return stop.value.code, *capsys.readouterr()

    return run


@pytest.fixture(scope="session", autouse=True)
def compose_once() -> Iterator[None]:
    """Hydra composes the same overrides of the shipped configs once per session, not 0.1 s each time.

    Each call returns a copy of its own. A search path with a user's folder, whose files tests
    change, is composed anew.
    """
    compose, done = hydra.compose, {}

    def composed(config_name: str, overrides: list[str] | None = None, **options: Any) -> Any:
        loader = hydra.core.global_hydra.GlobalHydra.instance().config_loader()
        path = [(entry.provider, entry.path) for entry in loader.get_search_path().get_path()]
        if "command-line" in dict(path):
            return compose(config_name, overrides, **options)
        key = (str(path), config_name, tuple(overrides or ()), tuple(sorted(options.items())))
        if key not in done:
            done[key] = dumps(compose(config_name, overrides, **options))
        return loads(done[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hydra, "compose", composed)
        yield
