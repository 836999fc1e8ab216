"""Numbers as text."""

from __future__ import annotations

from math import floor, log10


def printed_text(value: float | None, rounding: float) -> str:
    """A printed number with the paper's digits, `rounding` being half a unit of the last one."""
    if value is None:
        return "-"
    return (
        f"{value:.{max(0, -floor(log10(2 * rounding) + 1e-9))}f}" if rounding > 0 else f"{value:g}"
    )


NON_CAUSAL = "non-causal: its fixes use later measurements too, as live positioning cannot"


def shown_name(estimator: str, causal: bool) -> str:
    """An estimator's name in tables and figures; a smoother is marked as non-causal."""
    return estimator if causal else f"{estimator} (non-causal)"


def number_text(value: float, se: float) -> str:
    """A number with its standard error, to the digits that the error supports."""
    if value != value:
        return "-"
    if se != se or se <= 1e-12 * abs(value):  # no standard error, or 0 up to rounding
        return f"{value:.4g}"
    if abs(value) >= 1e6:
        return f"{value:.3g} ± {se:.1g}"
    digits = max(0, 1 - floor(log10(abs(se))))
    return f"{value:.{digits}f} ± {se:.{digits}f}"


def interval_text(value: float, low: float, high: float) -> str:
    """A number with its interval, to two digits of the interval's half-width; a number without
    error alone.
    """
    if value != value:
        return "-"
    half = (high - low) / 2
    if half != half or half <= 1e-12 * abs(value):
        return f"{value:.4g}"
    if half >= 1e6:
        return f"{value:.4g} [{low:.4g}, {high:.4g}]"
    digits = max(0, 1 - floor(log10(half)))
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
