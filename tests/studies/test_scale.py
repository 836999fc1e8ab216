"""The scale of a cell of a study's experiment."""

import pytest

from aoabench.studies.scale import scale_of

VMF = {"filter": {"pf_vmf": {"particles": 10000}}}


@pytest.mark.parametrize(
    ("experiment", "config", "reps", "reached", "scale"),
    [
        ("le2021_fig6", {}, 200, False, "paper"),
        ("le2021_fig6", {}, 250, False, "paper"),  # topped up by --decide
        ("le2021_fig6", {}, 199, False, "quick"),
        ("le2021_fig6", {}, 19, False, ""),
        ("le2021_errata", {"noise": {"sigma_deg": 4}}, 10, False, "quick"),
        ("le2021_errata", {"noise": {"sigma_deg": 3}}, 10, False, ""),
        ("le2021_errata", {"noise": {"sigma_deg": 3}}, 200, False, "paper"),
        ("nurminen2018_fig4", VMF, 10000, False, "paper"),
        ("nurminen2018_fig4", VMF, 200, False, ""),
        ("nurminen2018_fig4", {"filter": {"pf_vmf": {"particles": 1000}}}, 200, False, "quick"),
        ("nurminen2018_fig4", {"filter": {"ekf_vmf": {}}}, 200, False, "quick"),
        ("nurminen2018_layouts", VMF, 300, True, "paper"),
        ("nurminen2018_layouts", VMF, 300, False, ""),
        ("an_experiment_of_my_own", {}, 10**6, True, ""),
    ],
)
def test_it_follows_from_replications_and_config(experiment, config, reps, reached, scale):
    assert scale_of(experiment, config, reps, reached) == scale
