"""One paired comparison: its change with an interval, its verdict and the line that states both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aoabench.maths import statistics
from aoabench.maths.statistics import Paired

LEVEL = 0.05  # of all claims of a table together; each 95 % interval stands alone
FAILURES = "failure_rate"
NONE_SEEN, EQUAL, TOO_FEW, NO_VALUES = "no difference seen", "equal", "too few", "no values"


class Verdict(NamedTuple):
    """Verdict of a comparison, the units needed to detect 1 % (NaN: unknown), and the line."""

    word: str
    needed: float
    text: str


@dataclass(frozen=True)
class Comparison:
    """An estimator against the baseline of a cell, in the replications where both have a value.

    Each mean covers all values of its own estimator. `of` is the number of replications, and `by`
    names the independent unit: replication or position.
    """

    metric: str
    estimator: str
    baseline: str
    of: int
    mean: float
    baseline_mean: float
    pair: Paired
    by: str

    def __repr__(self) -> str:
        pair = f"{self.estimator} against {self.baseline}"
        means = f"{self.mean:.4g} and {self.baseline_mean:.4g}"
        change = self._change(*self.change, "+")
        return f"Comparison({self.metric} of {pair}: {means}, {change}, {self._count()})"

    @property
    def unit(self) -> str:
        """Unit of the change: %, percentage points, or the metric's own if the baseline is 0."""
        if self.metric == FAILURES:
            return "percentage points"
        if math.isfinite(self.pair.percent.value):
            return "%"
        return self.metric.rpartition("_")[2] if self.metric.endswith("_m") else ""

    @property
    def change(self) -> tuple[float, float, float]:
        """Return the change in `unit`, and the lower and the upper end of its 95 % interval.

        The change of a mean is the centre of its interval. The interval of a rate is Bonett and
        Price's, whose centre is a difference shrunken towards 0.
        """
        pair = self.pair
        change = pair.percent if math.isfinite(pair.percent.value) else pair.difference
        rate = self.metric == FAILURES
        return (100 * pair.difference.value if rate else change.value, *change.interval())

    def row(self, p_holm: float, comparisons: int) -> dict[str, Any]:
        """The columns of the table, given the adjusted p-value and the number of comparisons."""
        change, low, high = self.change
        verdict = self.verdict(p_holm, comparisons)
        return {
            "metric": self.metric, "estimator": self.estimator, "baseline": self.baseline,
            "n": self.pair.n, "of": self.of,
            "mean": self.mean, "baseline_mean": self.baseline_mean,
            "change": change, "change_low": low, "change_high": high, "unit": self.unit,
            "p": self.pair.p_value, "p_holm": p_holm, "by": self.by, "units": self.pair.units,
            "verdict": verdict.word, "needed": verdict.needed, "text": verdict.text,
        }  # fmt: skip

    def verdict(self, p_holm: float, comparisons: int) -> Verdict:
        """The verdict, with LEVEL as the level of all `comparisons` together."""
        a, b, pair = self.estimator, self.baseline, self.pair
        means = {a: self.mean, b: self.baseline_mean}
        empty = [name for name, mean in means.items() if math.isnan(mean)]
        if empty:
            why = f"no {self.metric} of {' and '.join(empty)}"
            return Verdict(NO_VALUES, math.nan, f"{a} and {b} cannot be compared: {why}")
        if math.isnan(pair.p_value):
            why = f"too few pairs with a value, N = {pair.n}"
            return Verdict(TOO_FEW, math.nan, f"{a} and {b} cannot be compared: {why}")
        if pair.difference.value == 0 == pair.difference.se:
            line = f"{a} is equal to {b} in every replication, {self._count()}"
            return Verdict(EQUAL, math.nan, line)
        relative = self.unit in ("%", "percentage points")
        need = statistics.needed(pair, 1.0, comparisons, LEVEL) if relative else math.nan
        if p_holm < LEVEL:
            return self._seen(p_holm, need)
        return self._unseen(p_holm, need)

    def _seen(self, p_holm: float, needed: float) -> Verdict:
        """The verdict for a significant difference: better or worse, lower or higher."""
        change, low, high = self.change
        smaller = change < 0
        ends = (-high, -low) if smaller else (low, high)
        word = words(self.metric)[0 if smaller else 1]
        amount = self._change(abs(change), *ends)
        a, b = self.estimator, self.baseline
        line = f"{a} is {word} than {b} by {amount}, {_p(p_holm)}, {self._count()}"
        return Verdict(word, needed, line)

    def _unseen(self, p_holm: float, needed: float) -> Verdict:
        """The verdict for no significant difference, with the units needed to detect 1 %."""
        found = f"{self._change(*self.change, '+')}, {_p(p_holm)}"
        a, b = self.estimator, self.baseline
        line = f"{a} and {b}: no difference seen at this {self._count()}: {found}"
        if not math.isfinite(needed) or needed == 0:
            return Verdict(NONE_SEEN, math.nan, line)
        one = f"1{' percentage point' if self.metric == FAILURES else ' %'}"
        if needed <= self.pair.units:
            return Verdict(NONE_SEEN, needed, f"{line}; this number suffices to detect {one}")
        count = np.format_float_positional(needed, 2, fractional=False, trim="-")
        units = f"N = {count}" if self.by == "replication" else f"{count} positions"
        return Verdict(NONE_SEEN, needed, f"{line}; about {units} would suffice to detect {one}")

    def _change(self, value: float, low: float, high: float, sign: str = "") -> str:
        """A change with its unit and interval."""
        texts = rounded(value, low, high, sign)
        return f"{texts[0]}{f' {self.unit}'.rstrip()} [{texts[1]}, {texts[2]}]"

    def _count(self) -> str:
        """The number of pairs, and of replications if some form no pair."""
        n = self.pair.n
        part = f" (only {n} of {self.of} replications have both)" if n < self.of else ""
        return f"N = {n}{part}"


def _p(p_holm: float) -> str:
    return f"p {'= ' if p_holm > 0 else '< '}{max(p_holm, 1e-300):.2g} (Holm)"


def words(metric: str) -> tuple[str, str]:
    """The words for an estimator whose values are smaller, and larger, than another estimator's."""
    lower_is_better = metric.startswith("rmse") or metric == FAILURES
    return ("better", "worse") if lower_is_better else ("lower", "higher")


def rounded(value: float, low: float, high: float, sign: str = "") -> tuple[str, str, str]:
    """A value and its interval to two digits of the interval's half-width."""
    half = (high - low) / 2
    digits = (
        min(max(1 - math.floor(math.log10(half)), 0), 9) if half > 0 and math.isfinite(half) else 6
    )
    return tuple(f"{v:{sign}.{digits}f}" for v in (value, low, high))  # type: ignore[return-value]
