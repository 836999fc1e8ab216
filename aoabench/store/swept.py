"""The parameters that differ between the cells of a run."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from aoabench.store.index import LEAF, Index

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def swept_parameters(index: Index) -> dict[str, list[Any]]:
    """The dotted parameters that differ between the cells or that a command line or experiment set:
    name -> value in each cell, None where a cell lacks it.
    """
    import pyarrow.compute as pc

    table = index.table
    leaves = {n[len(LEAF) :]: table[n] for n in table.column_names if n.startswith(LEAF)}
    varied = {
        name
        for name, texts in leaves.items()
        if name.startswith(("scenario.", "noise.")) and len(texts.fill_null("null").unique()) > 1
    }
    for text in table["named"].unique().to_pylist():
        mine = pc.equal(table["named"], text)
        named = [name for name in json.loads(text) if name in leaves and name not in varied]
        varied |= {n for n in named if pc.any(pc.and_(mine, leaves[n].is_valid())).as_py()}
    keep = sorted(name for name in varied if not name.endswith("_target_") and name != "seed")
    return {name: _decoded(leaves[name]) for name in keep}


def cell_table(index: Index, swept: Mapping[str, Sequence[Any]]) -> pd.DataFrame:
    """A row per cell of the index, with a column per swept parameter and the resolved config."""
    import pandas as pd

    columns = ("cell", "experiment", "scenario", "noise", "seed")
    estimators = [", ".join(entries) for entries in index.column("estimators")]
    known = {name: index.column(name) for name in columns}
    rest = {"estimators": estimators, "config": index.column("config")}
    cells = pd.DataFrame({**known, **swept, **rest})
    cells["experiment"] = cells["experiment"].astype("string")
    for parameter in swept:
        cells[parameter] = one_kind(cells[parameter])
    return cells


def differing(frame: pd.DataFrame, keys: Sequence[str]) -> list[str]:
    """The keys with several values in the frame; parameters of scenario and noise alone where they
    differ between cells of the same scenario and noise, as another preset has other parameters.
    """
    some = [key for key in keys if frame[key].nunique(dropna=False) > 1]
    presets = [key for key in ("scenario", "noise") if key in some]
    if not presets:
        return some
    groups = frame.groupby(presets, dropna=False)
    return [
        key
        for key in some
        if not key.startswith(("scenario.", "noise."))
        or (groups[key].nunique(dropna=False) > 1).any()
    ]


def cell_names(frame: pd.DataFrame) -> dict[str, str]:
    """By its id, what tells each cell of a frame from the others: scenario, noise and parameters
    that differ, or "cell ID" where they do not. Empty if there is one cell.
    """
    cells = frame.drop_duplicates("cell")
    if len(cells) < 2:
        return {}
    presets = [key for key in ("scenario", "noise") if key in cells]
    varied = differing(cells, [*presets, *(c for c in cells.columns if "." in c)])
    found = {
        row["cell"]: " ".join(
            f"{row[key]}" if key in presets else f"{key}={row[key]}"
            for key in varied
            if row[key] is not None and row[key] == row[key]
        )
        for row in cells.to_dict("records")
    }
    alike = Counter(found.values())
    return {c: text if text and alike[text] == 1 else f"cell {c}" for c, text in found.items()}


def _decoded(texts: pa.ChunkedArray) -> list[Any]:
    """The values of a parameter from JSON; values of mixed types become text."""
    coded = texts.fill_null("null").combine_chunks().dictionary_encode()
    distinct = [_scalar(json.loads(text)) for text in coded.dictionary.to_pylist()]
    if len({_kind(value) for value in distinct} - {None}) > 1:
        distinct = [None if value is None else str(value) for value in distinct]
    return [distinct[i] for i in coded.indices.to_pylist()]


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
    if values.dtype.kind in "biuf":
        return values
    given = values.dropna()
    kinds = {bool if isinstance(v, bool) else str if isinstance(v, str) else float for v in given}
    if len(kinds) < 2:
        return values
    return given.map(lambda v: v if isinstance(v, str) else json.dumps(v)).reindex(values.index)
