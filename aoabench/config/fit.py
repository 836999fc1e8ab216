"""Whether estimators get what they need from scenario and noise, and what else would fit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from aoabench.cell import Cell
from aoabench.config import catalogue
from aoabench.config.every import SMOOTHER
from aoabench.errors import BadValue, Mistakes, Unfit
from aoabench.roles import NEEDS, Estimator, Noise, Scenario

_MOST = 12  # number of names in a message
_ADVICE = {  # parameters of a recording that may mend what it lacks
    "height": "; scenario.height_m states it",
    "motion": "; scenario.motion states how the target moves, and scenario.columns.time, or else "
    "scenario.dt from fix to fix, when",
    "several_anchors": "; scenario.window_s puts rows of nearly equal times into one fix",
}


class Fitting(NamedTuple):
    """The estimators that run, by their dotted keys; lines about others; those that `all` leaves
    out, with the reason.
    """

    estimators: dict[str, Estimator]
    notes: tuple[str, ...]
    left_out: dict[str, str]


def those_that_fit(
    estimators: Mapping[str, Estimator],
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
    keys: Collection[str] = (),
    by_all: Collection[str] = (),
) -> Fitting:
    """The estimators that run, by their dotted keys, and why others do not.

    Of those chosen `by_all`, smoothers and those that scenario and noise do not suit are left out.
    In a simulated scenario all others run. Those that a recording does not suit are left out if
    another one runs. An estimator of which one of the job's `keys` is at fault is never left out.
    Raises UserError if scenario or noise lacks a property that an estimator needs; `choices` are
    the names of the presets. The message names presets that fit: estimators for a recording, which
    cannot be changed, else scenarios or noises.
    """
    fit, found = dict[str, Estimator](), dict[str, Unfit | BadValue]()
    left_out = {p: SMOOTHER for p, one in estimators.items() if p in by_all and not one.causal}
    for path, estimator in estimators.items():
        if path in left_out:
            continue
        try:
            estimator.check(scenario, noise)
        except (Unfit, BadValue) as error:
            found[path] = error
        else:
            fit[path] = estimator
    recorded, notes = scenario.tracks is not None, list[str]()
    wrong = dict[str, Unfit | BadValue]()
    for path, problem in found.items():
        own = isinstance(problem, BadValue) and f"{path}.{problem.key}" in keys
        if path in by_all and not own:
            left_out[path] = _why(path, problem, recorded)
        elif recorded and fit and not own:
            it = "it " if isinstance(problem, Unfit) else ""
            notes.append(f"{path} does not run: {it}{_why(path, problem, recorded)}")
        else:
            wrong[path] = problem
    _refuse(wrong, estimators, scenario, noise, choices)
    return Fitting(fit, tuple(notes), left_out)


def _refuse(
    wrong: Mapping[str, Unfit | BadValue],
    estimators: Mapping[str, Estimator],
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
) -> None:
    """Raise UserError if there are estimators that do not fit: a line for those with one reason."""
    alike: dict[tuple[str, str], list[str]] = {}
    mistakes = Mistakes()
    for path, error in wrong.items():
        if isinstance(error, Unfit):
            alike.setdefault((error.group, error.allowed), []).append(path)
        else:
            mistakes.note(BadValue(f"{path}.{error.key}", error.value, error.allowed))
    for reason, paths in alike.items():
        some = {path: estimators[path] for path in paths}
        mistakes.note(_error(Unfit(*reason), some, scenario, noise, choices))
    mistakes.check()


def _error(
    error: Unfit,
    estimators: Mapping[str, Estimator],
    scenario: Scenario,
    noise: Noise,
    choices: Mapping[str, Any],
) -> BadValue:
    """The error for estimators that do not fit for one reason, which names what does."""
    group = error.group if scenario.tracks is None else "scenario"
    rest = _instead(error, list(estimators.values()), scenario, noise)
    *most, last = estimators
    who = f"{', '.join(most)} and {last} need" if most else f"{last} needs"
    if scenario.tracks is None and error.allowed == NEEDS["motion"][1]:
        rest = f", because its fixes are separate points and no track in time{rest}"
    return BadValue(group, choices[group], f"{error.allowed}, which {who}{rest}")


def left_out_text(cells: Sequence[Cell]) -> Iterator[str]:
    """Lines about the presets that `all` leaves out, one for each reason; of a sweep, with the
    scenario and noise where that depends on them.
    """
    places = {id(cell): f"scenario={cell.scenario_name} noise={cell.noise_name}" for cell in cells}
    where: dict[tuple[str, str, str], dict[str, None]] = {}
    for cell in cells:
        for (group, why), names in _by_reason(cell.left_out).items():
            where.setdefault((group, why, ", ".join(names)), {})[places[id(cell)]] = None
    everywhere = set(places.values())
    for (group, why, listed), some in where.items():
        at = "" if everywhere == some.keys() else f" with {', '.join(some)}"
        yield f"{group}=all leaves out {listed}{at}: {why}"


def _by_reason(left_out: Mapping[str, str]) -> dict[tuple[str, str], list[str]]:
    """The names of presets by their group and the reason why they are left out."""
    found: dict[tuple[str, str], list[str]] = {}
    for path, why in left_out.items():
        group, _, name = path.partition(".")
        found.setdefault((group, why), []).append(name)
    return found


def misbuilt(path: str, error: BadValue) -> str:
    """Why an estimator cannot be built as its preset states it, without the preset's name."""
    key = error.key.removeprefix(f"{path}.")
    if key.rpartition(".")[2] == "noise":  # `noise: ${noise}` of a model that is fitted to it
        return f"needs another noise: {error.allowed}"
    return str(BadValue(key, error.value, error.allowed))


def _why(path: str, error: Unfit | BadValue, recorded: bool) -> str:
    """Why an estimator does not run; on a recording with what may mend it."""
    if not isinstance(error, Unfit):
        return str(BadValue(f"{path}.{error.key}", error.value, error.allowed))
    if recorded:
        needed = error.allowed.partition(", such as ")[0].replace("one ", "a recording ", 1)
        return f"needs {needed}{_advice(error)}"
    known = error.allowed.removeprefix("one ")
    return f"needs a {error.group} {known}" if known != error.allowed else str(error)


def _advice(error: Unfit) -> str:
    """The parameter of a recording that may mend what it lacks, as the end of a message."""
    return "".join(text for need, text in _ADVICE.items() if NEEDS[need][1] == error.allowed)


def _instead(
    error: Unfit, estimators: Sequence[Estimator], scenario: Scenario, noise: Noise
) -> str:
    """What mends an error, or fits all of the estimators in place of the preset at fault, as the
    end of a message.
    """
    group = error.group
    if scenario.tracks is not None:
        found = catalogue.fitting_estimators(scenario, noise)
        some = [f"{one}=[{','.join(names)}]" for one, names in found.items() if names]
        return (
            f"{_advice(error)}; with this recording fit {' '.join(some) or 'no shipped estimators'}"
        )
    each = [
        catalogue.fitting_noises(scenario, one)
        if group == "noise"
        else catalogue.fitting_scenarios(noise, one)
        for one in estimators
    ]
    names = [name for name in each[0] if all(name in others for others in each)]
    if not names:
        return f"; no shipped {group} fits with the rest"
    more = ", ..." * (len(names) > _MOST)
    return f"; these fit: {', '.join(names[:_MOST])}{more}"
