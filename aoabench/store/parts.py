"""Parts in Parquet files, which are never computed twice: their keys, provenance and integrity.

    <out>/parts/<key>/<start>-<stop>.<kind>.<unique>.parquet
        rows (or steps, or fixes) of one estimator in one cell, provenance as metadata
    <out>/parts/<key>/<start>-<stop>.json
        checksum file: key, replications, machine, and of each kind the file's name, checksum and
        number of rows; without a matching one the part is computed again
    <out>/parts/<key>/<start>-<stop>.json.damaged
        a checksum file that did not match its files

A part's key covers everything its numbers depend on (scenario, noise, this estimator's config,
seed, source code, library versions) and nothing else; `tables` makes the tables of a run from its
parts.
"""

from __future__ import annotations

import os
import re
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from aoabench.columns import IDENTITY, KINDS
from aoabench.store.documents import read_document, write_document
from aoabench.store.files import file_checksum, rows_of, schema, write_table


@dataclass(frozen=True)
class Part:
    """Replications start..stop-1 of one estimator, and its file of each kind (see KINDS).

    machine: the processor and libraries that computed it, by name; None if unknown.
    """

    start: int
    stop: int
    files: Mapping[str, Path]
    machine: Mapping[str, str] | None = None


class Status(NamedTuple):
    """What tells a changed file: its size, the times of its content and of its status, its
    inode.
    """

    size: int
    modified_ns: int
    changed_ns: int
    inode: int


def write_part(
    out: Path,
    key: str,
    start: int,
    stop: int,
    block: Mapping[str, Mapping[str, Any]],
    origin: Mapping[str, Any],
    machine: Mapping[str, str] | None = None,
) -> None:
    """Write one estimator's results of a block, a table for each kind.

    Each file gets a unique name; the checksum file <start>-<stop>.json, written last, lists them
    with their checksums and makes the part valid. So two processes that write the same part do not
    mix. `machine` names the processor and libraries that computed the block (see Part).
    """
    folder, span = out / "parts" / key, _span(start, stop)
    kinds = {}
    for kind, content in block.items():
        path = folder / f"{span}.{kind}.{uuid.uuid4().hex[:8]}.parquet"
        inner = {name: type_ for name, type_ in KINDS[kind].items() if name not in IDENTITY}
        checksum = write_table(path, content, schema(inner, origin))
        rows = len(content["replication"])
        kinds[kind] = {"file": path.name, "checksum": checksum, "rows": rows}
    content = {"key": key, "start": start, "stop": stop, "kinds": kinds, "machine": machine}
    write_document(folder / f"{span}.json", content)


def _span(start: int, stop: int) -> str:
    return f"{start:09d}-{stop:09d}"


_SETTLED_NS = 2_000_000_000  # age of a file whose next change gets another time
_MOST_KNOWN = 2**17  # parts
_known: dict[Path, tuple[Part, tuple[Status, ...]]] = {}  # verified by this process, settled files


def _verified(checksums: Path) -> Part | None:
    """The part of a checksum file; None if the checksum file is torn, altered or moved, or does not
    match its files. A part that this process has verified is not read again while size, times and
    inode of its files stay as they are.
    """
    path = checksums.absolute()
    part, before = _known.get(path, (None, ()))
    if part is not None and _statuses(checksums, part) == before:
        return part
    now = time.time_ns()
    part = _compared(checksums)
    statuses = () if part is None else _statuses(checksums, part)
    if part and statuses and all(now - s.changed_ns > _SETTLED_NS for s in statuses):
        if len(_known) >= _MOST_KNOWN:
            _known.clear()
        _known[path] = part, statuses
    return part


def _statuses(checksums: Path, part: Part) -> tuple[Status, ...]:
    """The statuses of a part's checksum file and of its files; () if one is missing."""
    try:
        found = [os.stat(file) for file in (checksums, *part.files.values())]
    except OSError:
        return ()
    return tuple(Status(s.st_size, s.st_mtime_ns, s.st_ctime_ns, s.st_ino) for s in found)


def _compared(checksums: Path) -> Part | None:
    """The part of a checksum file, as for `_verified`, from the content of all its files."""
    try:
        content = read_document(checksums)
        if "format" not in content:
            return _verified_format_1(checksums, content)
        start, stop, kinds = content["start"], content["stop"], content["kinds"]
        here = checksums.parent.name, checksums.stem
        if (content["key"], _span(start, stop)) != here or not kinds.keys() <= KINDS.keys():
            return None
        if kinds["rows"]["rows"] != stop - start:
            return None
        files = {kind: checksums.parent / Path(known["file"]).name for kind, known in kinds.items()}
        if any(file_checksum(files[kind]) != known["checksum"] for kind, known in kinds.items()):
            return None
        return Part(start, stop, files, content["machine"])
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None


def _verified_format_1(checksums: Path, named: Mapping[str, Any]) -> Part | None:
    """The part of a checksum file {kind: [file, checksum]} of an earlier version; None as in
    `_verified`.
    """
    import pyarrow as pa

    span = re.fullmatch(r"(\d{9,})-(\d{9,})", checksums.stem)
    if span is None:
        return None
    files = {kind: checksums.parent / Path(name).name for kind, (name, _) in named.items()}
    for kind, file in files.items():
        if kind not in KINDS or not file.name.startswith(f"{checksums.stem}.{kind}."):
            return None
    if any(file_checksum(files[kind]) != checksum for kind, (_, checksum) in named.items()):
        return None
    start, stop = (int(number) for number in span.groups())
    try:
        rows = rows_of(files["rows"].read_bytes())
    except pa.ArrowException:
        return None
    return Part(start, stop, files) if rows == stop - start else None


def checksum_files(out: Path, key: str) -> list[Path]:
    """The checksum files of all parts, in order."""
    folder = out / "parts" / key
    try:
        names = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return []
    return [folder / name for name in sorted(names) if name.endswith(".json")]


def intact_parts(out: Path, key: str, kind: str = "rows") -> list[Part]:
    """The parts of this kind whose checksums match, in order, without torn or altered ones."""
    parts = (_verified(file) for file in checksum_files(out, key))
    return [part for part in parts if part is not None and kind in part.files]


def has_part(out: Path, key: str, start: int, stop: int, kind: str = "rows") -> bool:
    """Whether exactly this part exists and is intact."""
    checksums = out / "parts" / key / f"{_span(start, stop)}.json"
    part = _verified(checksums) if checksums.exists() else None
    return part is not None and kind in part.files


def examined(out: Path, key: str) -> tuple[list[Part], list[Path]]:
    """All intact parts, in order, and the checksum files that do not match, renamed so that they
    are reported once.
    """
    parts, damaged = [], []
    for checksums in checksum_files(out, key):
        part = _verified(checksums)
        if part is None:
            damaged.append(checksums.replace(f"{checksums}.damaged"))
        else:
            parts.append(part)
    return parts, damaged


def discard(out: Path, key: str) -> None:
    """Remove all parts of a key, their checksum files first, so that none is left half removed."""
    for pattern in ("*.json", "*"):
        for file in (out / "parts" / key).glob(pattern):
            file.unlink(missing_ok=True)


def missing_ranges(done: Sequence[tuple[int, int]], reps: int) -> list[tuple[int, int]]:
    """The ranges of 0..reps-1 that the ranges `done` do not cover."""
    gaps, position = [], 0
    for start, stop in sorted(done):
        if start > position:
            gaps.append((position, min(start, reps)))
        position = max(position, stop)
        if position >= reps:
            break
    if position < reps:
        gaps.append((position, reps))
    return [(a, b) for a, b in gaps if a < b]
