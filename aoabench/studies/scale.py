"""The scale at which a cell of an experiment was computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from aoabench.config.nodes import hydra_initialised
from aoabench.config.overrides import jobs, read
from aoabench.studies import study


@dataclass(frozen=True)
class Conditions:
    """Conditions on a cell of a scale: the least number of replications, whether a precision is
    required in its place, and the values that dotted keys may have.
    """

    reps: float
    until: bool
    values: Mapping[str, list[Any]]

    def met(self, config: Mapping[str, Any], reps: int, reached: bool) -> bool:
        """Whether a cell meets them; a key that its config lacks does not count."""
        found = {key: _at(config, key) for key in self.values}
        same = all(one is None or one in self.values[key] for key, one in found.items())
        return same and reps >= self.reps and (reached or not self.until)


def scale_of(experiment: str, config: Mapping[str, Any], reps: int, reached: bool) -> str:
    """ "paper" or "quick": the larger scale at which a study computes a cell of this experiment,
    with this config and at most this number of replications, or until a precision is `reached`; ""
    if there is none.
    """
    for scale in ("paper", "quick"):
        if any(one.met(config, reps, reached) for one in _conditions(experiment, scale)):
            return scale
    return ""


@cache
def _conditions(experiment: str, scale: str) -> tuple[Conditions, ...]:
    """The conditions on a cell of each item with the experiment."""
    items = [item for name in study.names() for item in study.load(name).items]
    words = [item.scale[scale] for item in items if item.experiment == experiment and item.scale]
    with hydra_initialised():  # which counts the values of sweeps
        return tuple(map(_conditions_of, words))


def _conditions_of(words: list[str]) -> Conditions:
    values = {
        setting.key: [one.value for (line,) in jobs([setting]) for one in read([line])]
        for setting in read(words)
    }
    until = [key for key in values if key.startswith("until.")]
    for key in until:
        del values[key]
    return Conditions(float(values.pop("reps", [0])[0]), bool(until), values)


def _at(config: Mapping[str, Any], key: str) -> Any:
    """The value of a dotted key; None if the config lacks it."""
    node: Any = config
    for name in key.split("."):
        node = node.get(name) if isinstance(node, Mapping) else None
    return node
