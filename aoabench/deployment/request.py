"""What `locate` is asked for: a log, its anchors, one method and the settings of the scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aoabench.errors import UserError
from aoabench.report.text import shown_name
from aoabench.roles import Estimator
from aoabench.scenarios.log_anchors import NEEDED
from aoabench.scenarios.recorded import Recorded

if TYPE_CHECKING:
    from aoabench.cell import Cell

DEFAULT = "robust_ml"
WALLS = "scenario.walls_"  # keys that declare the coordinates of the plan
_GROUPS = ("estimator", "filter", "experiment", "noise")


@dataclass(frozen=True)
class Request:
    """The files and the method of one call of `locate`.

    log: a file, or a pattern of files; anchors: the file of the anchors, None if a setting gives it
    or the log has the positions of its receivers; format: the log's format, None for the scenario's
    own choice; estimator or filter: the name of a preset, both None for DEFAULT; truth: a file of
    true positions; settings: overrides such as scenario.window_s=0.1, which come last.
    """

    log: str
    anchors: str | None = None
    format: str | None = None
    estimator: str | None = None
    filter: str | None = None
    truth: str | None = None
    settings: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.estimator is not None and self.filter is not None:
            raise UserError(
                f"--filter={self.filter} is not allowed with --estimator={self.estimator}; "
                "allowed: one of them"
            )
        for word in self.settings:
            group = word.partition("=")[0].lstrip("+~")
            if group in _GROUPS:
                flag = f"--{group}" if group in ("estimator", "filter") else "`aoabench run`"
                raise UserError(f"{word}: not allowed in `locate`; allowed: {flag}")

    @property
    def words(self) -> list[str]:
        """The overrides of `run` for the same cell."""
        from aoabench.config.overrides import file_setting

        files = {"path": self.log, "anchors": self.anchors, "truth": self.truth}
        given = [file_setting(f"scenario.{key}", f) for key, f in files.items() if f is not None]
        form = [] if self.format is None else [f"scenario.format={self.format}"]
        method = f"estimator=[{self.estimator or DEFAULT}]"
        if self.filter is not None:
            method = f"filter=[{self.filter}]"
        others = [word for word in self.settings if not word.startswith(WALLS)]
        return ["scenario=recorded", *given, *form, method, *others]

    @property
    def frame(self) -> dict[str, Any]:
        """The settings of the plan's coordinates, such as walls_crs, by their keys."""
        from aoabench.config.overrides import read

        found = read([word for word in self.settings if word.startswith(WALLS)])
        return {setting.key.partition(".")[2]: setting.value for setting in found}

    def asked(self, say: Callable[[str], None] | None = None) -> Asked:
        """The recording and the method; raises UserError for every mistake in the input."""
        from aoabench.config.compose import compose_cells

        try:
            (cell,) = compose_cells(self.words, sweep=False, say=say)
        except UserError as error:
            if self.anchors is None and NEEDED in str(error):
                raise UserError(f"--anchors is missing: {NEEDED}") from None
            raise
        return Asked.of(cell)


@dataclass(frozen=True)
class Asked:
    """A recording and the method that locates its tags; name: the method's name to show."""

    cell: Cell
    scenario: Recorded
    name: str
    method: Estimator

    @classmethod
    def of(cls, cell: Cell) -> Asked:
        """The recording and the only method of a cell."""
        if not isinstance(cell.scenario, Recorded):
            raise UserError(f"scenario={cell.scenario_name}: `locate` reads recordings alone")
        ((name, method),) = cell.estimators.items()
        return cls(cell, cell.scenario, shown_name(name, method.causal), method)
