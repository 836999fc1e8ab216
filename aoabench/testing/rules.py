"""Rules that a plug-in has to obey, and what came out of trying them."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from aoabench.errors import UserError, did_you_mean, shorten

Subject = TypeVar("Subject")


class ContractError(AssertionError):
    """A plug-in breaks rules of its role; the text has each of them in words."""

    def __init__(self, name: str, results: Sequence[Result]) -> None:
        self.results = tuple(results)
        broken = [one for one in results if one.problem]
        head = f"{name} breaks {len(broken)} of {len(results)} rules"
        lines = [f"  {one.rule}: {one.problem}; {one.expected}" for one in broken]
        super().__init__("\n".join([head, *lines]))


class NotTried(Exception):
    """A rule says nothing about a plug-in; the text is the reason."""


@dataclass(frozen=True)
class Rule(Generic[Subject]):
    """A rule: its name, what it demands, and a function that tries it.

    The function returns what is wrong, in words, or ""; it raises NotTried where the rule says
    nothing about the subject.
    """

    name: str
    expected: str
    problem: Callable[[Subject], str]


@dataclass(frozen=True)
class Result:
    """What came out of trying a rule: `problem` says what is wrong, `skipped` why the rule was not
    tried; both are "" where the plug-in obeys it.
    """

    rule: str
    expected: str
    problem: str = ""
    skipped: str = ""


def examined(
    rules: Collection[Rule[Subject]], subject: Subject, skip: Mapping[str, str]
) -> list[Result]:
    """Try rules on a subject, but for those in `skip` (rule -> reason).

    Raises UserError for an unknown rule in `skip`.
    """
    names = [rule.name for rule in rules]
    for name in skip:
        if name not in names:
            hint = did_you_mean(name, names) or f"; allowed: {', '.join(names)}"
            raise UserError(f"skip={name!r}: no such rule{hint}")
    return [_tried(rule, subject, skip.get(rule.name, "")) for rule in rules]


def _tried(rule: Rule[Subject], subject: Subject, skipped: str) -> Result:
    if skipped:
        return Result(rule.name, rule.expected, skipped=skipped)
    try:
        problem = rule.problem(subject)
    except NotTried as reason:
        return Result(rule.name, rule.expected, skipped=str(reason))
    except Exception as error:  # the user's code can raise anything
        problem = _raised(error)
    return Result(rule.name, rule.expected, problem)


def _raised(error: Exception) -> str:
    """An exception in words, with the line of the user's code that raised it, if there is one."""
    if isinstance(error, UserError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    ours = Path(__file__).parents[1]
    theirs = [f for f in frames if not Path(f.filename).is_relative_to(ours)]
    last = (theirs or frames)[-1]
    text = shorten(" ".join(str(error).split()), 300)
    return f"it raises {type(error).__name__}: {text} ({Path(last.filename).name}:{last.lineno})"


def confirmed(name: str, results: Sequence[Result]) -> list[Result]:
    """Return the results; raise ContractError if a rule is broken."""
    if any(one.problem for one in results):
        raise ContractError(name, results)
    return list(results)
