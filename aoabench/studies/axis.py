"""A number axis of a dot plot: from values to places, and the values of its ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

_PAD = 0.06  # of the axis, left free at each end
_LOGARITHMIC = 1.3  # decades of positive values from which on the axis is logarithmic
_BOTH_SIDES = 3.0  # decades of the numbers' sizes from which on it is so on both sides of 0
_TICKS = 4  # at most about so many intervals between ticks


@dataclass(frozen=True)
class Axis:
    """Places from 0 to 1 of values from `low` to `high`: linear, logarithmic, or (`kind` both)
    logarithmic on both sides of 0 by asinh(value / `unit`), about linear within +- `unit`.
    """

    low: float
    high: float
    kind: str = "linear"
    unit: float = 1.0

    def place(self, value: float) -> float:
        """Where a value lies, from 0 to 1; values beyond an end lie on it."""
        if self.kind == "log" and value <= 0:
            return 0.0
        first, last = self._bent(self.low), self._bent(self.high)
        return min(max((self._bent(value) - first) / (last - first), 0.0), 1.0)

    def ticks(self) -> list[float]:
        """Round values within the axis, in ascending order."""
        if self.kind == "linear":
            return _steps(self.low, self.high)
        if self.kind == "both":
            powers = _powers(10 * self.unit, max(abs(self.low), abs(self.high)), _TICKS // 2)
            found = [-p for p in reversed(powers)] + [0.0] + powers
        else:
            found = _powers(self.low, self.high, _TICKS)
            if len(found) < 3:
                first, last = (math.floor(math.log10(end)) for end in (self.low, self.high))
                found = [m * 10.0**k for k in range(first, last + 1) for m in (1, 2, 5)]
        return [tick for tick in found if self.low <= tick <= self.high]

    def _bent(self, value: float) -> float:
        if self.kind == "log":
            return math.log10(value)
        return math.asinh(value / self.unit) if self.kind == "both" else value


def axis(numbers: Sequence[float], others: Sequence[float]) -> Axis:
    """An axis for all finite values among `numbers`, which may be drawn as dots, and `others`, such
    as limits and ends of intervals; from 0 to 1 if there are none.
    """
    dots = [v for v in numbers if math.isfinite(v)]
    values = dots + [v for v in others if math.isfinite(v)]
    if not values:
        return Axis(0.0, 1.0)
    low, high = min(values), max(values)
    sizes = [abs(v) for v in dots if v]
    unit, kind = 1.0, "linear"
    if low > 0 and math.log10(high / low) >= _LOGARITHMIC:
        kind = "log"
    elif low <= 0 and sizes and math.log10(max(sizes) / min(sizes)) >= _BOTH_SIDES:
        kind, unit = "both", 10.0 ** math.floor(math.log10(min(sizes)))
    if low == high:
        half = abs(low) / 10 or 1.0
        return Axis(low - half, high + half)
    return _padded(Axis(low, high, kind, unit))


def _padded(axis: Axis) -> Axis:
    """The axis with some room at both ends."""
    if axis.kind == "log":
        factor = (axis.high / axis.low) ** _PAD
        return replace(axis, low=axis.low / factor, high=axis.high * factor)
    if axis.kind == "both":
        first, last = (math.asinh(end / axis.unit) for end in (axis.low, axis.high))
        room = _PAD * (last - first)
        low, high = (axis.unit * math.sinh(end) for end in (first - room, last + room))
        return replace(axis, low=low, high=high)
    room = _PAD * (axis.high - axis.low)
    return replace(axis, low=axis.low - room, high=axis.high + room)


def _steps(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from low to high."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def _powers(low: float, high: float, most: int) -> list[float]:
    """Powers of ten from low to high, about `most` of them at equal distances, with the highest."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    step = max(1, math.ceil((last - first) / most))
    return [10.0**k for k in reversed(range(last, first - 1, -step))]


def tick_text(value: float) -> str:
    """A tick's value as a short text, with a proper minus sign."""
    size = abs(value)
    power = round(math.log10(size)) if size else 0
    round_power = size > 0 and abs(size - 10.0**power) <= 1e-9 * size
    text = f"1e{power}" if round_power and (power > 4 or power < -3) else f"{size:.6g}"
    return f"\N{MINUS SIGN}{text}" if value < 0 else text
