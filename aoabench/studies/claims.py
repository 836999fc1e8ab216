"""The claims of a study: what its paper prints, and by which of our numbers each is judged."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml

from aoabench.errors import UserError, did_you_mean
from aoabench.report.text import printed_text

# Classes of a claim; all but the judged ones with the reason why they are not judged.
CLASSES = {
    "number": "",
    "statement": "",
    "input": "an input of the simulation",
    "identity": "holds by construction",
    "fitted": "a target of our fit",
    "own": "a diagnostic of ours",
}
QUANTIFIERS = ("for all", "exists", "typical")
CHOSEN = (
    "paper",
    "before",
    "after",
)  # who set a limit: the paper, or we before or after our result
BOUNDS = ("above", "at_least", "below", "at_most")
QUOTED_WORDS = 12  # the longest quotation


@dataclass(frozen=True)
class Limits:
    """The values for which a claim is true: from `low` to `high`, each end included or not."""

    low: float = -math.inf
    high: float = math.inf
    with_low: bool = True
    with_high: bool = True


@dataclass(frozen=True)
class Reading:
    """One way to read a claim: patterns of the ids of our numbers, of any item, and what sets it
    apart.

    A reading for `robustness` changes what the paper states (another layout); it is shown and not
    counted.
    """

    of: tuple[str, ...]
    columns: Mapping[str, str]
    robustness: bool = False

    @property
    def name(self) -> str:
        """What sets the reading apart, in words; "" for the only reading."""
        return ", ".join(self.columns.values())

    def ids(self, found: Iterable[str]) -> list[str]:
        """The ids in `found` that match, in their order there; none if a pattern matches none."""
        known = list(found)
        matches = [{i for i in known if fnmatchcase(i, pattern)} for pattern in self.of]
        every = set().union(*matches) if all(matches) else set()
        return [i for i in known if i in every]


@dataclass(frozen=True)
class Claim:
    """One printed number or statement, or a number of ours that stands beside it unjudged.

    A number holds within its `rounding` (half a unit of the last printed digit) and `printed_se`
    (the Monte Carlo error of the print); `as_printed` is its text in the paper where that differs
    (52% for 0.52). A statement holds for values `above` or `at_least` one
    limit and `below` or `at_most` another, for all, some (exists) or most (typical) of a reading's
    numbers; differences within `tie` count as none. `chosen` names who set the limits.
    `not_judged` is the reason why a number or statement cannot be judged. `tolerance` is that of a
    fit.
    """

    id: str
    item: str
    kind: str  # `class` in the file
    what: str
    readings: tuple[Reading, ...]
    where: str = ""
    quote: str = ""
    unit: str = ""
    printed: float | None = None
    as_printed: str = ""
    rounding: float = 0.0
    printed_se: float = 0.0
    quantifier: str = "for all"
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    chosen: str = ""
    tie: float = 0.0
    tolerance: float | None = None
    reason: str = ""
    not_judged: str = ""

    @property
    def printed_text(self) -> str:
        """The printed number with the paper's digits; "" without one."""
        if self.printed is None:
            return ""
        return self.as_printed or printed_text(self.printed, self.rounding)

    @property
    def judged(self) -> bool:
        """Whether the claim can hold or fail, and so counts."""
        return self.kind in ("number", "statement") and not self.not_judged

    def limits(self, z: float) -> Limits:
        """The values for which the claim is true; the printed number's own error counts z times."""
        if self.kind == "number":
            assert self.printed is not None
            slack = self.rounding + z * self.printed_se + 1e-9 * abs(self.printed)
            return Limits(self.printed - slack, self.printed + slack)
        low = self.above if self.at_least is None else self.at_least
        high = self.below if self.at_most is None else self.at_most
        return Limits(
            -math.inf if low is None else low,
            math.inf if high is None else high,
            self.above is None,
            self.below is None,
        )


@dataclass(frozen=True)
class Claims:
    """The content of claims.yaml: the claims, and the reasons by patterns of ids why numbers of
    ours are in none.
    """

    claims: tuple[Claim, ...]
    unclaimed: Mapping[str, str]


def load(path: Path, items: Iterable[str]) -> Claims:
    """Read a claims.yaml; UserError names the claim and key that cannot be."""
    spec = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    known = list(items)
    claims: dict[str, Claim] = {}
    for entry in spec.get("claims", []):
        label = f"{path}: {entry.get('id', 'a claim without id')}"
        claim = _claim(label, entry)
        if claim.id in claims:
            raise UserError(f"{label}: the id occurs twice")
        if claim.item not in known:
            raise UserError(f"{label}: item {claim.item!r} is not in study.yaml")
        claims[claim.id] = claim
    return Claims(tuple(claims.values()), spec.get("not judged", {}))


def _claim(label: str, entry: Mapping[str, Any]) -> Claim:
    """A claim from its entry in the file."""
    given = dict(entry)
    readings = given.pop("readings", None) or [{"of": given.pop("of", given.get("id"))}]
    robustness = given.pop("robustness", [])
    if "of" in given:
        raise UserError(f"{label}: of: belongs into readings where these are given")
    known = {f.name for f in fields(Claim)} - {"kind"} | {"class", "of", "robustness"}
    for key in entry:
        if key not in known:
            hint = did_you_mean(key, known) or f"; allowed: {', '.join(sorted(known))}"
            raise UserError(f"{label}: unknown key {key!r}{hint}")
    given["kind"] = given.pop("class", None)
    missing = [key for key in ("id", "item", "what") if key not in given]
    if missing:
        raise UserError(f"{label}: {', '.join(missing)} missing")
    every = [(r, False) for r in readings] + [(r, True) for r in robustness]
    given["readings"] = tuple(_reading(label, r, beyond) for r, beyond in every)
    claim = Claim(**given)
    fault = _fault(claim)
    if fault:
        raise UserError(f"{label}: {fault}")
    return claim


def _reading(label: str, entry: Mapping[str, Any], robustness: bool) -> Reading:
    """A reading from its entry; all keys but `of` are its columns."""
    of = entry.get("of")
    patterns = (of,) if isinstance(of, str) else tuple(of or ())
    if not patterns:
        raise UserError(f"{label}: a reading needs `of`, the ids of our numbers")
    columns = {key: f"{value}" for key, value in entry.items() if key != "of"}
    return Reading(patterns, columns, robustness)


def _fault(claim: Claim) -> str:
    """Why a claim cannot be as it is written; "" if it can."""
    bounds = [key for key in BOUNDS if getattr(claim, key) is not None]
    if claim.kind not in CLASSES:
        return f"class {claim.kind!r}; allowed: {', '.join(CLASSES)}"
    if claim.quantifier not in QUANTIFIERS:
        return f"quantifier {claim.quantifier!r}; allowed: {', '.join(QUANTIFIERS)}"
    if len(claim.quote.split()) > QUOTED_WORDS:
        return f"quote: {len(claim.quote.split())} words; allowed: at most {QUOTED_WORDS}"
    if claim.kind in ("number", "statement") and not (claim.where and claim.quote):
        return "where and quote: needed, as the claim is the paper's"
    if claim.kind == "number" and (claim.printed is None or bounds):
        return "printed: needed for a number, and no limits beside it"
    if claim.kind == "statement":
        if not bounds and not claim.not_judged:
            return f"limits: one of {', '.join(BOUNDS)} is needed for a statement"
        if bounds and claim.chosen not in CHOSEN:
            return f"chosen {claim.chosen!r}: who set the limits; allowed: {', '.join(CHOSEN)}"
    if (
        len({"above", "at_least"} & set(bounds)) == 2
        or len({"below", "at_most"} & set(bounds)) == 2
    ):
        return "limits: above excludes at_least, and below excludes at_most"
    if claim.kind == "fitted" and (claim.printed is None or not claim.tolerance):
        return "printed and tolerance: needed for a target of the fit"
    if len({r.name for r in claim.readings}) < len(claim.readings):
        return "readings: two have the same columns"
    return ""
