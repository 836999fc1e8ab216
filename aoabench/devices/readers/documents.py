"""JSON and Excel as the content of a table: rows in memory."""

from __future__ import annotations

import json
import zlib
from io import BytesIO
from typing import Any
from xml.etree.ElementTree import ParseError
from zipfile import BadZipFile

from aoabench.devices.readers.reading import Part, Rows

_EXTRA = "reading .xlsx needs the extra: pip install 'aoabench[xlsx]'; or save it as CSV"


def from_json(text: bytes, path: str) -> Rows:
    """JSON lines, or an array of objects; names of nested values are joined by dots.

    Raises ValueError for other JSON, with the line where it is torn.
    """
    document = _document(text)
    if isinstance(document, list):
        return _records(document, list(range(len(document))), Part(0, "row", 1))
    if isinstance(document, dict) and b"\n" in text.strip():
        raise ValueError("its JSON is one object: one object a line, or an array of objects")
    places, found = [], []
    for i, line in enumerate(text.splitlines()):
        if line.strip():
            try:
                found.append(json.loads(line))
            except (ValueError, RecursionError):
                raise ValueError(f"line {i + 1} is no JSON object") from None
            places.append(i)
    return _records(found, places, Part(0, "line", 1))


def _document(text: bytes) -> Any:
    """The one JSON document that a text is, or None; raises ValueError for one nested too deep."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its JSON is nested too deep") from None
    except ValueError:
        return None


def _records(found: list[Any], places: list[int], part: Part) -> Rows:
    """Objects as rows; raises ValueError for anything else, and for lists within them."""
    import pandas as pd

    for place, one in zip(places, found):
        if not isinstance(one, dict):
            raise ValueError(f"{part.at(place)} is no JSON object")
    frame = pd.json_normalize(found) if _nested(found) else pd.DataFrame(found)
    frame.index = pd.Index(places)
    frame.columns = [str(name).strip() for name in frame.columns]
    return Rows(list(frame.columns), (part,), (), {}, frame)


def _nested(found: list[dict[str, Any]]) -> bool:
    return any(isinstance(value, dict) for one in found for value in one.values())


def from_excel(content: bytes, path: str, header: tuple[str, ...] | None) -> Rows:
    """The first sheet of an Excel file, whose first row names the columns unless `header` does.

    Raises ValueError without the library that reads it, and for a file that is no workbook.
    """
    import pandas as pd

    try:
        book = pd.ExcelFile(BytesIO(content), engine="openpyxl")
        frame = pd.read_excel(book, sheet_name=0, header=None if header else 0)
    except ImportError:
        raise ValueError(_EXTRA) from None
    except (BadZipFile, KeyError, EOFError, ParseError, zlib.error) as error:
        raise ValueError(f"this is no whole Excel workbook: {error}") from None
    sheet, others = str(book.sheet_names[0]), len(book.sheet_names) - 1
    if header and len(header) != len(frame.columns):
        raise ValueError(f"sheet {sheet!r} has {len(frame.columns)} columns, header {len(header)}")
    frame.columns = list(header or (str(name).strip() for name in frame.columns))
    notes = (f"{path}: sheet {sheet!r} is read, {others} others are not",) if others else ()
    return Rows(list(frame.columns), (Part(0, "row", 1 if header else 2),), notes, {}, frame)
