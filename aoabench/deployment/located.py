"""From a device's log to positions: what `aoabench locate` computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from aoabench.deployment import fixes
from aoabench.deployment.request import Asked
from aoabench.deployment.solving import Residuals, solve
from aoabench.errors import UserError
from aoabench.maths.geometry import Array
from aoabench.types import Outcome

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Located:
    """The fixes of a recording.

    frame: the table of fixes (see `fixes.table`); residuals: their `fix` counts in order of the
    tracks, not of the table's rows; rejected (K, 2) m: positions in the plane of rejected fixes;
    errors: the messages of tracks on which the method failed.
    """

    asked: Asked
    frame: pd.DataFrame
    residuals: Residuals
    rejected: Array
    errors: tuple[str, ...]

    @property
    def with_truth(self) -> bool:
        """Whether the truth of a fix is known."""
        return "true_x_m" in self.frame


def locate(
    asked: Asked,
    max_sigma_m: float | None = None,
    say: Callable[[str], None] | None = None,
) -> Located:
    """The fixes of all tags in a recording.

    A fix whose stated standard deviation exceeds `max_sigma_m` in some direction of the plane is
    rejected. `say` prints a line of progress. Raises UserError for mistakes in the input.
    """
    scenario, method = asked.scenario, asked.method
    method.prepare(say or (lambda line: None))
    tracks = scenario.tracks
    solved = solve(scenario, asked.cell.noise, method, tracks.counts)
    estimates = solved.estimates
    if max_sigma_m is not None and estimates.covariance is None:
        raise UserError(
            f"--max-sigma={max_sigma_m:g}: {asked.name} states no deviations; "
            "allowed: a method that does, such as robust_ml"
        )
    with_truth = bool(np.isfinite(tracks.truth[:, :2]).all(axis=1).any())
    marks = scenario.marks if with_truth else None
    frame = fixes.table(tracks, solved, max_sigma_m, marks)
    away = estimates.outcome[0] == Outcome.REJECTED
    if max_sigma_m is not None:
        away |= fixes.ellipses(estimates)[0] > max_sigma_m
    rejected = estimates.position[0, away, :2]
    rejected = rejected[np.isfinite(rejected).all(axis=1)]
    return Located(asked, frame, solved.residuals, rejected, tuple(solved.errors.values()))
