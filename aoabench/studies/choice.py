"""The items that a command names, in the order in which they are computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aoabench.errors import UserError, did_you_mean, shorten
from aoabench.studies import study
from aoabench.studies.study import Item, Study

Pair = tuple[Study, Item]


def chosen(names: Sequence[str], only: str | None, known: Sequence[str]) -> list[Pair]:
    """The items of the named studies (if none is named, those of `known` that need not be), in the
    order of their files; with `only`, those alone that it lists, separated by commas, as ITEM or
    STUDY/ITEM.

    Raises UserError for an unknown study or item.
    """
    for name in names:
        if name not in known:
            raise UserError(f"study {shorten(repr(name))}: unknown{_hint(name, known)}")
    studies = map(study.load, dict.fromkeys(names or known))
    pairs = [(s, item) for s in studies if names or not s.named_only for item in s.items]
    if only is None:
        return pairs
    words = [word.strip() for word in only.split(",")]
    wanted = {id(item) for word in words for item in _named(word, pairs)}
    return [(s, item) for s, item in pairs if id(item) in wanted]


def _named(word: str, pairs: Sequence[Pair]) -> list[Item]:
    """The items that a word of --only names; UserError if there are none."""
    found = [item for s, item in pairs if word in (item.name, f"{s.name}/{item.name}")]
    if found:
        return found
    present = [f"{s.name}/{item.name}" for s, item in pairs]
    if "/" not in word:
        present = list(dict.fromkeys(item.name for _, item in pairs))
    raise UserError(f"--only={shorten(word)}: unknown item{_hint(word, present)}")


def _hint(word: str, known: Sequence[str]) -> str:
    return did_you_mean(word, known) or "; allowed: " + ", ".join(known)


def cheapest_first(pairs: Sequence[Pair], seconds: Mapping[str, float]) -> list[Pair]:
    """The items ordered by their expected `seconds` (see progress.expected); items that share an
    experiment stay together, since the first of them computes for all, and an item comes after the
    one that it names.
    """
    cost: dict[tuple[str, str], float] = {}
    for s, item in pairs:
        cost[_group(s, item)] = cost.get(_group(s, item), 0.0) + seconds[f"{s.name}/{item.name}"]
    group_of = {(s.name, item.name): _group(s, item) for s, item in pairs}

    def rank(pair: Pair) -> tuple[float, int, tuple[str, str]]:
        own, first = _group(*pair), group_of.get((pair[0].name, pair[1].after or ""))
        later = first is not None and cost[own] <= cost[first]
        return cost[first if later and first else own], int(later), own

    return sorted(pairs, key=rank)


def _group(s: Study, item: Item) -> tuple[str, str]:
    return s.name, item.experiment or f"{item.name} alone"
