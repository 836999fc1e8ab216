"""A claim's readings as a dot plot: a line of SVG for each, with its number and interval.

Lines and words carry what colours do, so that the plot reads in print and without colours.
"""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from aoabench.studies.axis import Axis, axis, tick_text
from aoabench.studies.claims import Limits
from aoabench.studies.verdict import FAILS, HOLDS, NOT_JUDGED, UNDECIDED

WIDTH = 400  # units of the drawing, about pixels
LEFT, RIGHT = 148.0, 320.0  # ends of the axis; the names stand before it, the verdicts behind it
_LINE = 14  # height of a line of text
_GAP = 6  # between two readings
_NAME = 21  # characters of a reading's name in a line
_CHARACTER = 7.2  # width of a character, at most about
_RADIUS = 4.0
WITHOUT_NUMBER = "no number"
STATED = "as stated"  # the name of a reading that nothing sets apart


@dataclass(frozen=True)
class Dot:
    """One reading: its name, our number with the ends of its interval (NaN: none), its verdict with
    the class of this in the style sheet, the number as text, and whether the reading is for
    robustness and so not counted.
    """

    name: str
    value: float
    low: float
    high: float
    verdict: str
    style: str = ""
    text: str = ""
    robustness: bool = False


def svg(
    dots: Sequence[Dot], limits: Limits, printed: float | None = None, words: str = "",
    unit: str = ""
) -> str:  # fmt: skip
    """The readings of one claim as an <svg> element, in their order, those for robustness apart.

    The values that `limits` allow are shaded, with a line at `printed` or, without it, at each
    finite limit; `words` stand above the line. The element is an image for readers of screens, with
    `described` as its text.
    """
    scale = _axis(dots, limits, printed)
    top = _LINE + _GAP if words else _GAP
    parts: list[str] = []
    y = float(top)
    apart = False
    for dot in dots:
        if dot.robustness and not apart:
            apart = True
            y += _LINE + _GAP
            parts.append(_text(0, y - _GAP, "robustness, not counted:", "soft"))
        drawn, height = _reading(dot, scale, y)
        parts.append(drawn)
        y += height
    behind = _limits(scale, limits, printed, words, top, y)
    foot, height = _foot(scale, y, unit)
    label = escape(described(dots, words, unit), quote=True)
    head = (
        f'<svg class="dots" viewBox="0 0 {WIDTH} {y + height:g}" role="img" aria-label="{label}">'
    )
    return "\n".join([head, *behind, *parts, *foot, "</svg>"])


def described(dots: Sequence[Dot], words: str = "", unit: str = "") -> str:
    """The plot in words: how many readings have which verdict, and the range of their numbers."""
    values = [dot.value for dot in dots if math.isfinite(dot.value)]
    spread = ""
    if values:
        spread = f", our numbers from {min(values):.4g} to {max(values):.4g} {unit}".rstrip()
    counts = Counter(dot.verdict for dot in dots)
    found = ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
    against = f"; {words}" if words else ""
    return f"Dot plot of {len(dots)} readings{spread}{against}: {found}"


def _axis(dots: Sequence[Dot], limits: Limits, printed: float | None) -> Axis:
    ends = [end for dot in dots for end in (dot.low, dot.high)]
    given = [limits.low, limits.high, math.nan if printed is None else printed]
    return axis([dot.value for dot in dots], [*ends, *given])


def _x(scale: Axis, value: float) -> float:
    return round(LEFT + (RIGHT - LEFT) * scale.place(value), 1)


def _reading(dot: Dot, scale: Axis, y: float) -> tuple[str, float]:
    """The line of a reading below y, and its height."""
    names = textwrap.wrap(dot.name, _NAME) or [STATED]
    height = _LINE * len(names) + _GAP
    middle = y + height / 2
    first = middle - _LINE * (len(names) - 1) / 2 + 4
    parts = [_text(0, first + _LINE * i, name, "name") for i, name in enumerate(names)]
    if math.isfinite(dot.value):
        parts += [*_interval(dot, scale, middle), _mark(dot.verdict, _x(scale, dot.value), middle)]
    else:
        parts.append(_text((LEFT + RIGHT) / 2, middle + 4, WITHOUT_NUMBER, "soft", "middle"))
    parts.append(_text(RIGHT + 8, middle + 4, dot.verdict))
    title = f"{dot.name or STATED}: {dot.text or WITHOUT_NUMBER}, {dot.verdict}"
    inside = f"<title>{escape(title)}</title>{''.join(parts)}"
    return f'<g class="{escape(dot.style, quote=True)}">{inside}</g>', height


def _interval(dot: Dot, scale: Axis, y: float) -> Iterator[str]:
    """A bar with a cross-bar at each finite end; an infinite end is an arrow at the axis' end."""
    if math.isnan(dot.low) or math.isnan(dot.high):
        return
    ends = [(end, _x(scale, end), sign) for end, sign in ((dot.low, -1), (dot.high, 1))]
    path = f"M{ends[0][1]:g} {y:g}H{ends[1][1]:g}"
    for end, x, sign in ends:
        if math.isfinite(end):
            path += f"M{x:g} {y - 3:g}v6"
        else:
            path += f"M{x - 4 * sign:g} {y - 4:g}L{x:g} {y:g}L{x - 4 * sign:g} {y + 4:g}"
    yield f'<path d="{path}"/>'


def _mark(verdict: str, x: float, y: float) -> str:
    """A filled circle for holds, a cross for fails, an open circle for undecided, and an open
    diamond for not judged.
    """
    r = _RADIUS
    if verdict == HOLDS:
        return f'<circle class="full" cx="{x:g}" cy="{y:g}" r="{r:g}"/>'
    if verdict == UNDECIDED:
        return f'<circle cx="{x:g}" cy="{y:g}" r="{r:g}"/>'
    if verdict == FAILS:
        d, across = (
            f"M{x - r:g} {y - r:g}l{2 * r:g} {2 * r:g}",
            f"m{-2 * r:g} 0l{2 * r:g} {-2 * r:g}",
        )
        return f'<path class="thick" d="{d}{across}"/>'
    assert verdict == NOT_JUDGED, verdict
    return f'<path class="open" d="M{x - r:g} {y:g}l{r:g} {-r:g}l{r:g} {r:g}l{-r:g} {r:g}z"/>'


def _limits(
    scale: Axis, limits: Limits, printed: float | None, words: str, top: float, bottom: float
) -> Iterator[str]:
    """The shade of the values that the limits allow, the lines, and the words above them."""
    finite = [end for end in (limits.low, limits.high) if math.isfinite(end)]
    if finite:
        low, high = _x(scale, limits.low), _x(scale, limits.high)
        size = f'width="{max(high - low, 0.5):g}" height="{bottom - top:g}"'
        yield f'<rect class="within" x="{low:g}" y="{top:g}" {size}/>'
    lines = finite if printed is None else [printed]
    for value in lines:
        yield f'<path class="limit" d="M{_x(scale, value):g} {top:g}V{bottom:g}"/>'
    if words and lines:
        middle = sum(_x(scale, value) for value in lines) / len(lines)
        half = _CHARACTER * len(words) / 2
        x = min(max(middle, half), WIDTH - half)
        yield _text(x, _LINE, words, "", "middle")


def _foot(scale: Axis, y: float, unit: str) -> tuple[list[str], float]:
    """The axis below y with its ticks and their values, and its height."""
    parts = [f'<path class="axis" d="M{LEFT:g} {y:g}H{RIGHT:g}"/>']
    free = -math.inf
    for tick in scale.ticks():
        x, text = _x(scale, tick), tick_text(tick)
        parts.append(f'<path class="axis" d="M{x:g} {y:g}v4"/>')
        half = _CHARACTER * len(text) / 2
        if x - half > free:
            parts.append(_text(x, y + 4 + _LINE, text, "soft", "middle"))
            free = x + half + 4
    height = 4 + _LINE + _GAP
    note = {"log": "logarithmic", "both": "logarithmic on both sides of 0"}.get(scale.kind, "")
    if caption := ", ".join(filter(None, [unit, note])):
        below = len(caption) > _NAME - 2  # it would reach the first tick's value
        parts.append(_text(0, y + 4 + _LINE * (1 + below), caption, "soft"))
        height += _LINE * below
    return parts, height


def _text(x: float, y: float, text: str, style: str = "", anchor: str = "") -> str:
    kind = f' class="{style}"' if style else ""
    place = f' text-anchor="{anchor}"' if anchor else ""
    return f'<text x="{x:g}" y="{y:g}"{kind}{place}>{escape(text)}</text>'
