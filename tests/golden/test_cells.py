"""The ids of the shipped cells are those that were stored; `cells.py` writes the file again."""

from pathlib import Path

import pytest

from aoabench.config.presets import options
from tests.golden import cells

STORED = Path(__file__).with_name("cells.txt").read_text(encoding="utf-8").splitlines()


def stored(kind, name):
    return [line for line in STORED if line.split()[:2] == [kind, name]]


@pytest.mark.parametrize("scenario", options("scenario"))
def test_a_scenario_has_its_ids_with_every_noise(scenario):
    assert list(cells.of_scenario(scenario)) == stored("scenario", scenario)


@pytest.mark.parametrize("experiment", options("experiment"))
def test_every_experiment_composes_into_its_cells(experiment):
    found = list(cells.of_experiment(experiment))
    assert found == stored("experiment", experiment)
    assert len(set(found)) == len(found) >= 1


def test_nothing_is_stored_that_does_not_ship():
    known = {("scenario", name) for name in options("scenario")}
    known |= {("experiment", name) for name in options("experiment")}
    assert {tuple(line.split()[:2]) for line in STORED} == known


def test_cells_of_scenarios_and_noises_differ():
    ids = [line.split()[-1] for line in STORED if line.startswith("scenario ")]
    assert len(set(ids)) == len(ids)
