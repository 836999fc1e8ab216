"""Overrides to cells, composed with Hydra.

Only Hydra's compose API is used. Hydra's callbacks, launchers, logging configuration and reruns are
not used, because their `_target_`s would run code before our checks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from aoabench.cell import Cell
from aoabench.config.build import Builder
from aoabench.config.composer import Composed, Composer
from aoabench.config.guard import refuse_hydra, refuse_unreadable
from aoabench.config.job import Job
from aoabench.config.messages import NotComposed, explain, explained
from aoabench.config.nodes import hydra_initialised, resolved, with_defaults
from aoabench.config.overrides import Setting, jobs, read, refuse_two_ways
from aoabench.config.plugins import Speller, parse_plugins
from aoabench.config.presets import LISTS
from aoabench.errors import Mistakes, UserError, shorten

_SILENT_S = 1.0  # seconds of composing without a line of progress
_EVERY_S = 10.0  # seconds between further lines
_MOST_MISTAKES = 20  # different ones, after which no further job is composed
_MOST_JOBS = 200  # composed after the first mistake


def compose_cells(
    overrides: Sequence[str],
    *,
    config_dir: str | None = None,
    plugins: Sequence[str] = (),
    extra: Mapping[str, Any] | None = None,
    sweep: bool = True,
    out: str | None = None,
    say: Callable[[str], None] | None = None,
) -> list[Cell]:
    """Return the cells of command-line overrides: one for each combination of the values that
    commas in the overrides, and the experiment's own sweep, give to the keys.

    Without `sweep` the list has one cell, and several values for a key are a mistake. `out` is the
    folder of the tables, literally, in place of runner.out. `say` gets a line of progress where
    composing takes longer than _SILENT_S. Raises UserError for every mistake.
    """
    named = [f"plugins=[{','.join(plugins)}]"] if plugins else []
    settings = _checked([*overrides, *named], sweep)
    refuse_unreadable(config_dir, settings)
    allowed = parse_plugins(settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        composer = Composer(config_dir)
        swept = [*_own_sweep(settings, composer), *settings] if sweep else settings
        keys = tuple(dict.fromkeys(s.key for s in swept if not s.is_deletion))
        typed = [s.key for s in settings]
        builder = Builder(allowed, extra or {})
        job = Job(composer, swept, keys, typed, allowed, config_dir, out, builder)
        cells = _built(job, _reported(jobs(swept), say))
    if not cells:
        raise UserError(
            f"{' '.join(shorten(s.word) for s in settings)}: the sweep is empty; "
            "allowed: at least one value for each key"
        )
    if len({cell.runner for cell in cells}) > 1:
        raise UserError("runner, store and until cannot be swept: the cells of one run share them")
    return cells


def _built(job: Job, each: Iterable[Sequence[str]]) -> list[Cell]:
    """The cells of all jobs; UserError with the mistakes of the first jobs that have any."""
    mistakes, cells, wrong = Mistakes(), [], 0
    for lines in each:
        cell = mistakes.tried(job.cell, lines)
        wrong += bool(mistakes.found)
        if cell is None and (len(mistakes.found) >= _MOST_MISTAKES or wrong >= _MOST_JOBS):
            break
        cells += [] if cell is None else [cell]
    mistakes.check()
    return cells


def _reported(
    lines: Sequence[Sequence[str]], say: Callable[[str], None] | None
) -> Iterator[Sequence[str]]:
    """Yield the jobs; tell `say` how far they are composed, where that takes long."""
    due = time.monotonic() + _SILENT_S
    for number, job in enumerate(lines):
        if say and time.monotonic() >= due:
            say(f"composing {len(lines)} cells: {number} done ...")
            due = time.monotonic() + _EVERY_S
        yield job


def _checked(words: Sequence[str], sweep: bool) -> list[Setting]:
    """The overrides as settings; UserError if one sets Hydra's own node, or several values without
    `sweep`.
    """
    settings = read(words, sweep)
    refuse_two_ways(settings)
    for setting in settings:
        refuse_hydra(setting)
        if setting.is_sweep and not sweep:
            raise UserError(
                f"{shorten(setting.word)}: several values need -m (a sweep over the values), "
                "or brackets (one list)"
            )
    return settings


def _own_sweep(settings: Sequence[Setting], composer: Composer) -> list[Setting]:
    """The sweep defined by the chosen experiment. Call this where Hydra is initialised."""
    try:
        params = composer.sweep([s.line for s in settings if not s.is_sweep])
    except NotComposed:
        return []  # the jobs report it, with their other mistakes
    own = read(f"{key}={value}" for key, value in params.items())
    for setting in own:
        refuse_hydra(setting)
        if setting.key == "plugins":
            raise UserError(
                f"{shorten(setting.word)}: only plugins=[...] on the command line can name plugins"
            )
    return own


def show(
    overrides: Sequence[str],
    config_dir: str | None = None,
    resolve: bool = False,
    package: str = "",
    sweep: bool = False,
) -> str:
    """The composed config as YAML, or one dotted part of it; for a `sweep`, the part common to all
    jobs.
    """
    from omegaconf import OmegaConf

    settings = _checked(overrides, sweep)
    refuse_unreadable(config_dir, settings)
    with hydra_initialised(config_dir), explained(settings, config_dir):
        found = Composer(config_dir).composed([s.line for s in settings if not s.is_sweep])
        mistakes = Mistakes()
        for problem in found.problems:
            mistakes.note(explain(problem, settings, config_dir))
        mistakes.check()
        plugins = parse_plugins(settings)
        nodes = with_defaults(found.nodes, Speller(plugins))
        if found.by_all.words and not sweep:
            nodes = _of_fitting(nodes, found, plugins)
        whole = OmegaConf.create(nodes)
        part = OmegaConf.select(whole, package) if package else whole
        if part is None:
            raise UserError(
                f"--package={package}: unknown key; `aoabench run --cfg job` shows the keys"
            )
        return (
            OmegaConf.to_yaml(part, resolve=resolve) if OmegaConf.is_config(part) else f"{part}\n"
        )


def _of_fitting(nodes: dict[str, Any], found: Composed, plugins: Sequence[str]) -> dict[str, Any]:
    """The nodes without the presets that `all` leaves out, for which the cell is built."""
    cell = Builder(plugins).cell(
        resolved(nodes), found.choices, typed=("runner.out", "reps"), by_all=found.by_all
    )
    for group in LISTS:
        one = nodes.get(group)
        if isinstance(one, dict):
            left = {name: n for name, n in one.items() if f"{group}.{name}" not in cell.left_out}
            nodes = {**nodes, group: left}
    return nodes
