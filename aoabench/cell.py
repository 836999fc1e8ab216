"""A cell of an experiment, and the options of its run."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from aoabench.columns import REPLICATIONS
from aoabench.errors import BadValue, Mistakes, check_bool, check_choice, check_number
from aoabench.maths.digest import described, digest
from aoabench.roles import Estimator, Noise, Scenario


@dataclass(frozen=True)
class Until:
    """Stop when the standard error of the mean of `metric` is small enough: `se` in the metric's
    unit, or relative to the mean.

    The standard error is checked after the first min_reps, 1.25 min_reps, 1.25^2 min_reps ...
    max_reps replications are complete, so that the outcome depends on the replications alone. If
    both limits are given, the run stops when both are reached.
    """

    metric: str
    se: float | None = None
    relative_se: float | None = None
    min_reps: int = 200
    max_reps: int = 20_000

    def __post_init__(self) -> None:
        tried = (mistakes := Mistakes()).tried
        columns = [c for c, kind in REPLICATIONS.items() if kind == "double"]
        tried(check_choice, "until.metric", self.metric, columns)
        tried(check_number, "until.se", self.se, above=0, optional=True)
        tried(check_number, "until.relative_se", self.relative_se, above=0, optional=True)
        limits: dict[str, Any] = {"most": 100_000_000, "integer": True}
        few = len(mistakes.found)
        tried(check_number, "until.min_reps", self.min_reps, least=2, **limits)
        least = self.min_reps if len(mistakes.found) == few else 2
        tried(check_number, "until.max_reps", self.max_reps, least=least, **limits)
        if self.se is self.relative_se is None and not mistakes.found:
            allowed = "a number > 0, for until.se or until.relative_se (or both), with until.metric"
            mistakes.note(BadValue("until.se", None, allowed))
        mistakes.check()

    @property
    def counts(self) -> list[int]:
        """Numbers of replications after which to check, increasing; the last one is max_reps."""
        found = [self.min_reps]
        while found[-1] < self.max_reps:
            found.append(min(math.ceil(1.25 * found[-1]), self.max_reps))
        return found


@dataclass(frozen=True)
class RunnerOptions:
    """Options of a run that do not change the result of any replication."""

    out: str
    n_jobs: int = -1
    backend: str = "loky"
    chunk: int | None = None
    address: str | None = None
    steps: bool = False
    max_failed: float = 0.5
    until: Until | None = None
    other_machines: str = "report"
    tls_ca_file: str | None = None
    tls_cert: str | None = None
    tls_key: str | None = None

    def __post_init__(self) -> None:
        tried = (mistakes := Mistakes()).tried
        local = max(64, 4 * (os.cpu_count() or 1))  # more would only use up the memory
        most = math.inf if self.backend == "dask" else local
        tried(check_number, "runner.n_jobs", self.n_jobs, least=-1, most=most, integer=True)
        if self.n_jobs == 0:
            allowed = "an integer >= 1, or -1 for all cores"
            mistakes.note(BadValue("runner.n_jobs", 0, allowed))
        tried(check_number, "runner.chunk", self.chunk, least=1, integer=True, optional=True)
        tried(check_number, "runner.max_failed", self.max_failed, least=0, most=1)
        backends = ("loky", "threading", "sequential", "dask")
        tried(check_choice, "runner.backend", self.backend, backends)
        if self.backend == "dask" and not _is_address(self.address):
            allowed = "the scheduler's tcp://HOST:PORT (or tls://HOST:PORT)"
            mistakes.note(BadValue("runner.address", self.address, allowed))
        if self.backend != "dask" and self.address is not None:
            allowed = "null, unless runner.backend=dask"
            mistakes.note(BadValue("runner.address", self.address, allowed))
        if not isinstance(self.out, str) or not self.out:
            mistakes.note(BadValue("runner.out", self.out, "the path of a folder"))
        tried(check_bool, "store.steps", self.steps)
        tried(check_choice, "runner.other_machines", self.other_machines, ("report", "refuse"))
        tried(self._check_tls)
        mistakes.check()

    @property
    def tls(self) -> dict[str, str | None]:
        """The files of TLS by the names of their options; None for those that are not given."""
        names = ("tls_ca_file", "tls_cert", "tls_key")
        return {name: getattr(self, name) for name in names}

    def _check_tls(self) -> None:
        """Raise BadValue unless all files of TLS are given and can be read, or none is given."""
        if set(self.tls.values()) == {None}:
            return
        for name, file in self.tls.items():
            if not isinstance(file, str) or not _can_be_read(file):
                allowed = f"a file in PEM that can be read, as {', '.join(self.tls)} go together"
                raise BadValue(f"runner.{name}", file, allowed)
        if not str(self.address).startswith("tls://"):
            raise BadValue("runner.address", self.address, "tls://HOST:PORT, with runner.tls_key")


def _can_be_read(file: str) -> bool:
    path = os.path.expanduser(file)
    return "\0" not in file and os.path.isfile(path) and os.access(path, os.R_OK)


def _is_address(value: object) -> bool:
    return (
        isinstance(value, str)
        and re.fullmatch(r"(tcp|tls)://(\[[0-9a-fA-F:]+\]|[\w.-]+):\d{1,5}", value) is not None
    )


@dataclass(frozen=True)
class Cell:
    """One scenario, one noise and the estimators to compare, as objects and as the plain config."""

    scenario_name: str
    noise_name: str
    scenario: Scenario
    noise: Noise
    estimators: Mapping[str, Estimator]
    seed: int
    reps: int
    runner: RunnerOptions
    config: Mapping[str, Any]
    # estimators' parameters that differ from their presets
    changed: Mapping[str, Any] = field(default_factory=dict)
    swept: tuple[str, ...] = ()  # dotted parameters that the command line sets
    experiment: str | None = None
    plugins: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # lines to print for the user
    # presets that `all` does not choose here, by dotted key, with the reason
    left_out: Mapping[str, str] = field(default_factory=dict)

    @property
    def steps(self) -> bool:
        """Whether the run stores steps: if asked to, and always those of a recording."""
        return self.runner.steps or self.scenario.tracks is not None

    @cached_property
    def id(self) -> str:
        """Short name of the cell, from scenario, noise, seed and changed parameters; further
        estimators of the same cell share it.
        """
        parts = [described(self.scenario), described(self.noise), self.seed]
        return digest([*parts, self.scenario_name, self.noise_name, dict(self.changed)])[:12]
