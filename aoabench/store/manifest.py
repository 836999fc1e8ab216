"""The generation of tables that readers see: the manifest names its files, and is replaced last.

<out>/tables.json                     the manifest: file, checksum and number of rows of each table
<out>/.tables/<name>.<unique>.parquet the tables of this generation and of the one before
<out>/<name>.parquet                  links to the tables of this generation (copies on file systems
                                      without links), for users; nothing here reads them
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from aoabench.errors import RunError
from aoabench.store.documents import read_document, write_document
from aoabench.store.files import (
    STALE_S,
    checksum_of,
    file_checksum,
    rows_of,
    table_of,
    write_atomically,
)
from aoabench.store.layout import check_kinds

if TYPE_CHECKING:
    import pyarrow as pa

INDEX = "index"  # the table that has no link
_MANIFEST, _FOLDER = "tables.json", ".tables"


@dataclass(frozen=True)
class Entry:
    """One table of a generation: its file's name, the file's checksum, its number of rows."""

    file: str
    checksum: str
    rows: int


@dataclass(frozen=True)
class Generation:
    """Tables of a run's folder that belong together, by name; `path` is the folder's own path when
    they were made.
    """

    out: Path
    path: str
    tables: Mapping[str, Entry]
    previous: tuple[str, ...] = ()

    def file(self, name: str) -> Path:
        return self.out / _FOLDER / self.tables[name].file

    def data(self, name: str) -> bytes:
        """The bytes of one table's file; raises as `read` does."""
        data = self.file(name).read_bytes()
        if checksum_of(data) != self.tables[name].checksum:
            raise torn(self.file(name), self.out)
        return data

    def read(self, name: str, columns: list[str] | None = None) -> pa.Table:
        """One table. Raises FileNotFoundError if its file is missing, RunError if it is torn or
        altered, and UserError for an unknown schema.
        """
        table = table_of(self.data(name), self.file(name), columns=columns)
        if len(table) != self.tables[name].rows:
            raise torn(self.file(name), self.out)
        return table


def torn(file: Path, out: Path, what: str = "is torn or altered") -> RunError:
    """The error for a table that cannot be used, and how to make it again."""
    return RunError(f"{file} {what}; make the tables again from the parts: aoabench collect {out}")


def current(out: Path) -> Generation | None:
    """The generation that the manifest names; None for a folder without one: of an earlier version,
    or without results.

    Raises RunError if the manifest is torn or altered, or missing beside its tables, and UserError
    for a file in place of a folder or a folder in place of a file.
    """
    check_kinds(out)
    file = out / _MANIFEST
    try:
        content = read_document(file)
        tables = {name: Entry(**entry) for name, entry in content["tables"].items()}
        if any(Path(entry.file).name != entry.file for entry in tables.values()):
            raise ValueError("a table lies in another folder")
        return Generation(out, content["path"], tables, tuple(content["previous"]))
    except (FileNotFoundError, NotADirectoryError):
        if (out / _FOLDER).is_dir():
            raise torn(file, out, "is missing") from None
        return None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise torn(file, out) from None


def read_together(
    out: Path, names: Mapping[str, list[str] | None]
) -> tuple[dict[str, pa.Table], Generation] | None:
    """The named tables of one generation (name -> columns, None: all) and the generation; None for
    a folder without one.

    A generation that a run has swept meanwhile is given up for the next one. Raises RunError if a
    table is missing, torn or altered.
    """
    generation = current(out)
    while generation is not None:
        try:
            return {name: generation.read(name, c) for name, c in names.items()}, generation
        except FileNotFoundError as error:
            latest = current(out)
            if latest == generation:
                raise torn(Path(error.filename), out, "is missing") from None
            generation = latest
    return None


def new_file(out: Path, name: str) -> Path:
    """The path of a new file for a table of the next generation."""
    return out / _FOLDER / f"{name}.{uuid.uuid4().hex[:8]}.parquet"


def publish(out: Path, made: Mapping[str, Path], before: Generation | None) -> None:
    """Make the files `made` (see `new_file`), and the tables of the generation `before` that are
    not made anew, the current generation. The caller holds the folder's lock.
    """
    kept = before.tables if before else {}
    now = {**kept, **{name: _entry(file) for name, file in made.items()}}
    previous = sorted({entry.file for entry in kept.values()})
    content = {"path": str(out), "tables": {n: asdict(e) for n, e in now.items()}}
    write_document(out / _MANIFEST, {**content, "previous": previous})
    generation = Generation(out, str(out), now, tuple(previous))
    link(generation)
    _sweep(generation, before.previous if before else ())


def link(generation: Generation) -> None:
    """Put the generation's tables under their own names, where they are not yet."""
    for name in generation.tables:
        place = generation.out / f"{name}.parquet"
        if name != INDEX and not _in_place(generation, name, place):
            write_atomically(place, lambda temporary, name=name: _link(generation, name, temporary))


def _link(generation: Generation, name: str, place: Path) -> None:
    try:
        os.link(generation.file(name), place)
    except OSError:  # a file system without links
        shutil.copy2(generation.file(name), place)


def _in_place(generation: Generation, name: str, place: Path) -> bool:
    """Whether a link, or a copy, of the table is in its place."""
    file = generation.file(name)
    if not place.is_file():
        return False
    if place.samefile(file):
        return True
    same_size = place.stat().st_size == file.stat().st_size
    return same_size and file_checksum(place) == generation.tables[name].checksum


def _sweep(generation: Generation, superseded: Iterable[str]) -> None:
    """Delete the superseded tables, and those that a killed run has left, from the tables' folder;
    keep those of this generation and of the one before, and those that Windows keeps for a reader.
    """
    keep = {entry.file for entry in generation.tables.values()} | set(generation.previous)
    gone, old = set(superseded) - keep, time.time() - STALE_S
    for file in (generation.out / _FOLDER).iterdir():
        with contextlib.suppress(FileNotFoundError, PermissionError):
            if file.name in gone or (file.name not in keep and file.stat().st_mtime < old):
                file.unlink()


def _entry(file: Path) -> Entry:
    data = file.read_bytes()
    return Entry(file.name, checksum_of(data), rows_of(data))
