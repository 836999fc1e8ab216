"""Parts in Parquet files, which are never computed twice: their keys, provenance and integrity.

    <out>/parts/<key>/<start>-<stop>.<kind>.<unique>.parquet
        rows (or steps, or fixes) of one estimator in one cell, provenance as metadata
    <out>/parts/<key>/<start>-<stop>.json
        checksum file: file names and checksums; without a matching one the part is computed again
    <out>/parts/<key>/<start>-<stop>.json.damaged
        a checksum file that did not match its files

A part's key covers everything its numbers depend on (scenario, noise, this estimator's config,
seed, source code, library versions) and nothing else; `tables` makes the tables of a run from its
parts.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aoabench.columns import IDENTITY, KINDS
from aoabench.store.files import file_checksum, schema, write_atomically, write_table


@dataclass(frozen=True)
class Part:
    """Replications start..stop-1 of one estimator, and its file of each kind (see KINDS)."""

    start: int
    stop: int
    files: Mapping[str, Path]


def write_part(
    out: Path,
    key: str,
    start: int,
    stop: int,
    block: Mapping[str, Mapping[str, Any]],
    origin: Mapping[str, Any],
) -> None:
    """Write one estimator's results of a block, a table for each kind.

    Each file gets a unique name; the checksum file <start>-<stop>.json, written last, lists them
    with their checksums and makes the part valid. So two processes that write the same part do not
    mix.
    """
    folder, span = out / "parts" / key, f"{start:09d}-{stop:09d}"
    written = {}
    for kind, content in block.items():
        path = folder / f"{span}.{kind}.{uuid.uuid4().hex[:8]}.parquet"
        inner = {name: type_ for name, type_ in KINDS[kind].items() if name not in IDENTITY}
        written[kind] = [path.name, write_table(path, content, schema(inner, origin))]
    text = json.dumps(written)
    write_atomically(
        folder / f"{span}.json", lambda temporary: temporary.write_text(text, encoding="utf-8")
    )


def _verified(checksums: Path) -> Part | None:
    """The part of a checksum file; None if the checksum file is torn, altered or does not match."""
    try:
        named = json.loads(checksums.read_text(encoding="utf-8"))
        files = {kind: checksums.parent / Path(name).name for kind, (name, _) in named.items()}
        good = all(file_checksum(files[kind]) == checksum for kind, (_, checksum) in named.items())
        start, stop = (int(n) for n in checksums.stem.split("-"))
    except (OSError, ValueError, AttributeError, KeyError, TypeError):
        return None
    return Part(start, stop, files) if good else None


def intact_parts(out: Path, key: str, kind: str = "rows") -> list[Part]:
    """The parts of this kind whose checksums match, in order, without torn or altered ones."""
    parts = (_verified(file) for file in sorted((out / "parts" / key).glob("*.json")))
    return [part for part in parts if part is not None and kind in part.files]


def has_part(out: Path, key: str, start: int, stop: int, kind: str = "rows") -> bool:
    """Whether exactly this part exists and is intact."""
    checksums = out / "parts" / key / f"{start:09d}-{stop:09d}.json"
    part = _verified(checksums) if checksums.exists() else None
    return part is not None and kind in part.files


def examined(out: Path, key: str) -> tuple[list[Part], list[Path]]:
    """All intact parts, in order, and the checksum files that do not match, renamed so that they
    are reported once.
    """
    parts, damaged = [], []
    for checksums in sorted((out / "parts" / key).glob("*.json")):
        part = _verified(checksums)
        if part is None:
            damaged.append(checksums.rename(f"{checksums}.damaged"))
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
