"""The parameters that differ between the cells of a run."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aoabench.maths.digest import flatten

if TYPE_CHECKING:
    import pandas as pd


def swept_parameters(noted: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Per cell, the dotted parameters that differ between the cells or that a command line or
    experiment set.
    """
    full = {r["cell"]: dict(flatten(r["config"])) | r["changed"] for r in noted}
    names = {
        name
        for leaves in full.values()
        for name in leaves
        if name.startswith(("scenario.", "noise."))
    }
    varied = {
        name
        for name in names
        if len({json.dumps(leaves.get(name)) for leaves in full.values()}) > 1
    }
    varied |= {
        name for r in noted for name in (*r["changed"], *r["swept"]) if name in full[r["cell"]]
    }
    keep = sorted(name for name in varied if not name.endswith("_target_") and name != "seed")
    found = {
        cell: {name: _scalar(leaves.get(name)) for name in keep} for cell, leaves in full.items()
    }
    for name in keep:
        if (
            len({_kind(values[name]) for values in found.values()} - {None}) > 1
        ):  # mixed types are stored as text
            for values in found.values():
                values[name] = None if values[name] is None else str(values[name])
    return found


def _kind(value: Any) -> str | None:
    return (
        None if value is None else "number" if type(value) in (int, float) else type(value).__name__
    )


def natural(values: Iterable[Any]) -> list[tuple[bool, float, str]]:
    """Sort key: numbers by value, everything else by its text."""
    return [
        (not isinstance(v, int | float), float(v) if isinstance(v, int | float) else 0.0, str(v))
        for v in values
    ]


def _scalar(value: Any) -> Any:
    return (
        value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)
    )


def one_kind(values: pd.Series) -> pd.Series:
    """The column as Parquet can store it: unchanged if its values are all numbers, all text or all
    bool, else as text.
    """
    given = values.dropna()
    kinds = {bool if isinstance(v, bool) else str if isinstance(v, str) else float for v in given}
    text = given.map(lambda v: v if isinstance(v, str) else json.dumps(v))
    return values if len(kinds) < 2 else text.reindex(values.index)
