"""Read an item's stored table, and draw its figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench.errors import RunError, WriteError
from aoabench.maths.estimate import Estimate
from aoabench.store.files import read_provenance, read_table
from aoabench.studies.places import Places
from aoabench.studies.study import Item, Study, figure_path, table_path

if TYPE_CHECKING:
    import pandas as pd

OTHER_VERSION = "the table is of another version"


_UNFIT = (
    LookupError,
    AttributeError,
    TypeError,
    ValueError,
    OSError,
    RunError,
)  # raised where a table lacks a column or value that is read


def table(results: Path, study: Study, item: Item) -> pd.DataFrame | None:
    """An item's stored table; None if it was not computed."""
    path = table_path(results, study, item)
    return read_table(path).to_pandas() if path.exists() else None


def draw(study: Study, item: Item, places: Places, formats: tuple[str, ...] = ("png",)) -> str:
    """Draw an item's figure from its stored table, if the item has both; return the reason why the
    table cannot be drawn, or "". The old figure of such a table is deleted.

    Raises WriteError if the figure cannot be written.
    """
    path = figure_path(places.drawn, study, item)
    if not item.figure or not table_path(places.results, study, item).exists():
        return ""
    from aoabench.report import plots

    try:
        frame = table(places.results, study, item)
        plots.save(lambda: getattr(study.figures, item.name)(frame), path, formats)
    except WriteError:
        raise
    except _UNFIT as error:
        path.unlink(missing_ok=True)
        return f"{OTHER_VERSION} ({type(error).__name__}: {' '.join(str(error).split())[:80]})"
    return ""


def drawn(study: Study, item: Item, places: Places, formats: tuple[str, ...] = ("png",)) -> str:
    """Draw an item's figure as `draw` does, and return the reason why its table cannot be used for
    figure and values, or "".
    """
    return draw(study, item, places, formats) or read(study, item, places.results).problem


@dataclass(frozen=True)
class Stored:
    """The content of an item's stored table."""

    present: bool
    values: dict[
        str, tuple[Estimate, float]
    ]  # by id, with the samples they rest on (NaN: not sampled)
    shown: pd.DataFrame | None = None  # texts to show as a table, where figures.py has NAME_table
    problem: str = ""  # why a stored table cannot be read
    origin: Mapping[str, Any] = field(default_factory=dict)  # its provenance
    reps: float = float("nan")  # the replications behind it, where it comes from an experiment

    @property
    def scale(self) -> str:
        """The scale at which the table was computed; "" if it does not say."""
        return str(self.origin.get("scale", ""))


_read_before: dict[Path, tuple[Any, Stored]] = {}  # by table, with what the content depends on


def read(study: Study, item: Item, results: Path) -> Stored:
    """Read an item's stored table; for a table of another version, only `problem` is set. The
    content is kept, and not read again while the file is the same.
    """
    path = table_path(results, study, item).absolute()
    try:
        status = path.stat()
    except OSError:
        return Stored(False, {})
    state = status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino
    functions = [getattr(study.figures, f"{item.name}_{n}", None) for n in ("values", "table")]
    known = state, functions, item
    before, content = _read_before.get(path, (None, None))
    if content is None or before != known:
        content = _read(study, item, results)
        _read_before[path] = known, content
    return content


def _read(study: Study, item: Item, results: Path) -> Stored:
    """The content of a table that is present."""
    try:
        frame = table(results, study, item)
        origin = read_provenance(table_path(results, study, item))
        found: dict[str, Any] = getattr(study.figures, f"{item.name}_values", lambda _: {})(frame)
        shown = getattr(study.figures, f"{item.name}_table", lambda _: None)(frame)
    except _UNFIT:
        return Stored(True, {}, problem=OTHER_VERSION)
    pairs = {
        key: value if isinstance(value, tuple) else (value, float("nan"))
        for key, value in found.items()
    }
    config = origin["config"] if isinstance(origin.get("config"), dict) else {}
    known = item.paper_reps if origin.get("scale") == "paper" else float("nan")
    return Stored(True, pairs, shown, origin=origin, reps=config.get("reps", known))
