"""Tests of plug-ins: what every estimator, filter, noise and scenario has to do.

    from aoabench.testing import check_estimator

    def test_my_estimator():
        check_estimator(MyEstimator())

A plug-in is tried in a small simulation, and each rule that it breaks is reported in words. The
presets that ship pass the same rules.
"""

from aoabench.testing.estimators import check_estimator
from aoabench.testing.noises import check_noise
from aoabench.testing.rules import ContractError, Result
from aoabench.testing.scenarios import check_scenario

__all__ = ["ContractError", "Result", "check_estimator", "check_noise", "check_scenario"]
