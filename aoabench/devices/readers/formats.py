"""Opens a log or a table: which format it has, and several files as one."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aoabench import loaded
from aoabench.devices.readers.delimited import delimited
from aoabench.devices.readers.documents import from_excel, from_json
from aoabench.devices.readers.foreign import reason_of
from aoabench.devices.readers.gpx import from_gpx, is_gpx
from aoabench.devices.readers.parquet import parquet
from aoabench.devices.readers.reading import AUTO, FILE, Content, Part, Reading
from aoabench.devices.readers.silabs import SILABS, is_angles_alone
from aoabench.devices.readers.sources import KINDS, expanded, stem, text_of
from aoabench.devices.readers.ublox import UBLOX
from aoabench.devices.readers.wide import widened
from aoabench.errors import BadValue, check_choice, listed

if TYPE_CHECKING:
    import pandas as pd

HEAD = 1 << 16  # bytes that show a format
DEVICES = {device.name: device for device in (UBLOX, SILABS)}
FORMATS = ("auto", "table", *DEVICES)
_TOPICS = (
    "these look like Silicon Labs angles without their topics, which name locator and tag: "
    "`mosquitto_sub -v` records both"
)


def opened(key: str, path: Any, given: Reading = AUTO) -> Content:
    """The content of a path, a list of paths or a glob; read once within `loaded.reading`.

    Several files are one content, whose column `file` has each file's name. Raises BadValue for a
    format that is not known and for a file that cannot be read.
    """
    check_choice("format", given.format, FORMATS)
    files = tuple(expanded(key, path))
    return loaded.once(("content", files, given), lambda: _opened(key, path, files, given))


def _opened(key: str, path: Any, files: Sequence[str], given: Reading) -> Content:
    folder = path if isinstance(path, str) and os.path.isdir(path) else ""
    labels = [f"{stem(file)} " if len(files) > 1 else "" for file in files]
    found = [
        widened(_one(key, file, given, folder), given.patterns, label)
        for file, label in zip(files, labels)
    ]
    whole = found[0]
    if len(found) > 1:
        whole = several(key, path, found, files)
    if not whole.columns:
        raise BadValue(key, path, f"a {KINDS}")
    return whole


def _one(key: str, path: str, given: Reading, folder: str) -> Content:
    """The content of one file."""
    try:
        text = text_of(path, given)
        if text[:4] == b"PAR1":
            return parquet(text, key, path, folder)
        if text[:4] == b"PK\x03\x04":
            return from_excel(text, path, given.header)
        return text_content(text, key, path, given)
    except BadValue:
        raise
    except (OSError, ValueError, csv.Error, MemoryError) as error:
        raise BadValue(key, path, f"a readable {KINDS}; {why(error, key, given)}") from None


def why(error: Exception, key: str, given: Reading) -> str:
    """Why a file cannot be read; a log's encoding may be declared."""
    declared = given.encoding
    if isinstance(error, UnicodeDecodeError) and declared is not None:
        return f"byte {error.start} is not {declared}, which scenario.encoding declares"
    hint = ", or declare its encoding, such as scenario.encoding=cp1252 for Western Windows"
    is_log = key == "path" and isinstance(error, UnicodeDecodeError)
    return reason_of(error) + hint * is_log


def text_content(text: bytes, key: str, path: str, given: Reading) -> Content:
    """The content of a text in the declared or recognised format."""
    head = text[:HEAD].decode(errors="replace")
    looks = looks_like(head)
    declared = looks if given.format == "auto" else given.format
    device = DEVICES.get(declared)
    found = device.read(text.decode(errors="replace"), path, 1) if device else None
    if declared != looks and (found is None or found.frame.empty):
        wanted = f"{_words(declared)}, as scenario.format={declared} declares"
        hint = f"these look like {_words(looks)}: scenario.format={looks}"
        raise BadValue(key, path, f"{wanted}; {hint}")
    if device and found is not None and found.frame.empty:
        more = "".join(f"; {note.removeprefix(f'{path}: ')}" for note in found.notes)
        raise BadValue(key, path, f"a log with at least one whole line: {device.whole}{more}")
    if found is not None:
        return found
    if is_angles_alone(head):
        raise BadValue(key, path, f"a {KINDS}; {_TOPICS}")
    if is_gpx(head):
        return from_gpx(text, path)
    if text.lstrip()[:1] in (b"{", b"["):
        return from_json(text, path)
    return delimited(text, key, path, given)


def looks_like(head: str) -> str:
    """The format of a text by its first lines: a device's, or table."""
    return next((name for name, device in DEVICES.items() if device.recognised(head)), "table")


def _words(name: str) -> str:
    """What messages call a format."""
    return DEVICES[name].words if name in DEVICES else "a table"


@dataclass(frozen=True)
class Several(Content):
    """Several files as one: their rows one after the other, and the column `file`."""

    key: str = ""
    each: tuple[Content, ...] = ()
    files: tuple[str, ...] = ()

    def cells(self, names: Mapping[str, str]) -> pd.DataFrame:
        """The chosen columns; raises BadValue for a file that lacks one."""
        import pandas as pd

        frames = []
        for part, content, file in zip(self.parts, self.each, self.files):
            own = FILE in content.columns
            wanted = {o: t for o, t in names.items() if t != FILE or own}
            lacking = [t for t in wanted.values() if t not in content.columns]
            if lacking:
                words = f"the same columns in every file; {file} has no {listed(lacking)}"
                raise BadValue(self.key, file, words)
            frame = content.cells(wanted)
            if len(wanted) < len(names):
                frame = frame.assign(**{o: stem(file) for o in names if o not in wanted})
            frame.index = frame.index + part.start
            frames.append(frame[list(names)])
        return pd.concat(frames)

    def shown(self, name: str) -> str:
        return self.each[0].shown(name)


def several(key: str, path: Any, found: Sequence[Content], files: Sequence[str]) -> Several:
    """Contents as one; raises BadValue if the files state different conventions."""
    start, parts = 0, []
    for content, file in zip(found, files):
        part = content.parts[0]
        if dict(content.stated) != dict(found[0].stated):
            raise BadValue(key, path, f"files of one format; {file} and {files[0]} differ")
        parts.append(Part(start, part.word, part.first, file))
        start += 1 << 40
    columns = list(dict.fromkeys(name for one in found for name in one.columns))
    twice = [n for one in found for n in dict.fromkeys(one.columns) if one.columns.count(n) > 1]
    names = [*columns, *dict.fromkeys(twice), *([] if FILE in columns else [FILE])]
    notes = tuple(note for one in found for note in one.notes)
    each, stated = tuple(found), found[0].stated
    return Several(names, tuple(parts), notes, stated, key, each, tuple(files))
