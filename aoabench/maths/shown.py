"""A record of arrays as text for a terminal or a notebook: shapes, units and ranges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from enum import IntEnum
from typing import Any

import numpy as np

_UNITS = {
    **dict.fromkeys(("azimuth", "elevation", "azimuth_sigma", "elevation_sigma"), "rad"),
    **dict.fromkeys(("delay", "delay_sigma", "time"), "s"),
    **dict.fromkeys(("position", "position_sigma"), "m"),
    "rssi": "dBm",
    "covariance": "m^2",
}


def shown(record: Any, words: Mapping[str, type[IntEnum]] | None = None) -> str:
    """Return the name of a dataclass and a line for each field that is not None: its shape, its
    unit, its range and the share of NaN; `words` names the values of fields of integers.
    """
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    known = {name: value for name, value in values.items() if value is not None}
    width = max(map(len, known), default=0)
    lines = [type(record).__name__]
    for name, value in known.items():
        text = ", ".join(_parts(name, value, (words or {}).get(name)))
        lines += [f"  {name:{width}}  {text}".replace("\n", "\n    ")]
    return "\n".join(lines)


def _parts(name: str, value: Any, words: type[IntEnum] | None) -> Iterator[str]:
    """The words about one field."""
    if not isinstance(value, np.ndarray):
        yield repr(value)
        return
    unit = f" {_UNITS[name]}" if name in _UNITS else ""
    yield f"{value.shape}{unit}"
    if words is not None:
        numbers, counts = np.unique(value, return_counts=True)
        named = {one.value: one.name.lower() for one in words}
        yield from (f"{c} {named.get(n, n)}" for n, c in zip(numbers.tolist(), counts.tolist()))
    elif value.size and value.dtype.kind in "iuf":
        missing = float(np.isnan(value).mean())
        if missing < 1:
            yield f"{np.nanmin(value):.4g} to {np.nanmax(value):.4g}"
        if missing > 0:
            yield f"{100 * missing:.3g} % NaN"
