"""Users' files as bytes in UTF-8: one file, a list, a glob, or a folder of Parquet files."""

from __future__ import annotations

import codecs
import gzip
import os
import re
import stat
import zlib
from collections.abc import Sequence
from glob import glob, has_magic
from pathlib import Path
from typing import Any

from aoabench import loaded
from aoabench.devices.readers.reading import AUTO, Reading
from aoabench.errors import BadValue, listed, near_file

KINDS = (
    "table (.csv, .tsv, .txt, .parquet, .xlsx, JSON lines, or packed with gzip) "
    "or a device's log (u-blox, Silicon Labs)"
)
EXISTING = f"existing file: a {KINDS}"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_BINARY = {b"PAR1", b"PK\x03\x04"}


def expanded(key: str, path: Any) -> list[str]:
    """The files of a path, a list of paths or a glob such as logs/*.csv, in natural order.

    A folder stands for the Parquet files in it. Raises BadValue for what is no readable file.
    """
    if isinstance(path, Sequence) and not isinstance(path, str):
        found = [file for one in path for file in expanded(key, one)]
    elif isinstance(path, str) and has_magic(path) and not os.path.exists(path):
        files = (one for one in glob(path, recursive=True) if not os.path.isdir(one))
        # a link to a folder above itself leads to the same files again
        first = {os.path.realpath(one): one for one in sorted(files, key=len, reverse=True)}
        found = sorted(first.values(), key=natural)
    elif isinstance(path, str) and os.path.isdir(path):
        found = _parquet_files(path)
    else:
        _check_file(key, path)
        return [path]
    if not found:
        folder = isinstance(path, str) and os.path.isdir(path)
        hint = (
            f"this is a folder: '{path}/*.csv' names the files in it" if folder else "no file fits"
        )
        raise BadValue(key, path, f"an {EXISTING}, a list of files, or a glob; {hint}")
    twice = sorted({one for one in found if found.count(one) > 1})
    if twice:
        raise BadValue(key, path, f"each file once; {listed(twice)} occurs more than once")
    for one in found:
        _check_file(key, one)
    return found


def natural(text: str) -> tuple[list[tuple[int, int, str]], str]:
    """A key that sorts texts with their digits as numbers: T2 before T10."""
    parts = re.split(r"(\d+)", text.lower())
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in parts if p], text


def content_of(path: object) -> bytes:
    """The bytes of a file as it is, read once."""
    return loaded.read(Path(str(path)))[0]


def text_of(path: object, given: Reading = AUTO) -> bytes:
    """The content of a file: unpacked if it is packed with gzip; a text, whose encoding may be
    `given`, in UTF-8 without a mark of the byte order.

    Raises OSError or ValueError for bytes that are neither a text nor a known binary format.
    """
    content = content_of(path)
    if os.path.getsize(str(path)) > len(content) and content[:4] not in _BINARY:
        content = content[: content.rfind(b"\n") + 1]  # of a file that grows, the whole lines
    if content[:2] == b"\x1f\x8b":
        try:
            content = gzip.decompress(content)
        except (EOFError, zlib.error) as error:
            raise ValueError(f"the gzip file is torn: {error}") from None
    if content[:2] in _UTF_16:
        return content.decode("utf-16").encode()
    marked = content.startswith(codecs.BOM_UTF8)
    content = content.removeprefix(codecs.BOM_UTF8)
    if content[:4] not in _BINARY and (place := content.find(b"\0")) >= 0:
        raise ValueError(f"byte {place} is 0, as in binary files; this is no text")
    if content[:4] in _BINARY:
        return content
    if b"\r" in content and b"\n" not in content:
        content = content.replace(b"\r", b"\n")  # one line end each, as of a serial line
    return content if marked else given.in_utf8(content)


def stem(path: str) -> str:
    """The name of a file without its folder and endings."""
    name = os.path.basename(path)
    while os.path.splitext(name)[1].lower() in _ENDINGS:
        name = os.path.splitext(name)[0]
    return name


_ENDINGS = {
    ".csv", ".tsv", ".txt", ".log", ".dat", ".gz", ".json", ".jsonl", ".ndjson", ".xlsx",
    ".parquet", ".pq",
}  # fmt: skip


def _parquet_files(folder: str) -> list[str]:
    """The Parquet files below a folder, less hidden ones and what other tools write beside them."""
    found = [
        str(file)
        for file in Path(folder).rglob("*")
        if file.suffix.lower() in (".parquet", ".pq")
        and not any(part[0] in "._" for part in file.relative_to(folder).parts)
    ]
    return sorted(found, key=natural)


def _check_file(key: str, path: Any) -> None:
    """Raise BadValue unless `path` is a regular file."""
    if isinstance(path, str) and os.path.isfile(path):
        return
    hint = near_file(path) if isinstance(path, str) else ""
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISFIFO(mode) or stat.S_ISCHR(mode) or stat.S_ISSOCK(mode):
            hint = "; this is a stream: `aoabench locate -` reads one from standard input"
    except (OSError, TypeError, ValueError):
        pass
    raise BadValue(key, path, f"an {EXISTING}{hint}")
