"""JSON files that carry a checksum of their own content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aoabench.errors import UserError
from aoabench.store.files import write_atomically

FORMAT = 2  # of the files written here; files of format 1 have neither a format nor a checksum


def write_document(path: Path, content: Mapping[str, Any]) -> None:
    """Write an object with its `format` and its `checksum`, atomically, one line for each of its
    names; values that JSON does not know become text.
    """
    plain = json.loads(json.dumps({"format": FORMAT, **content}, default=str))
    signed = plain | {"checksum": _checksum(plain)}
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in signed.items()]
    text = "{\n" + ",\n".join(lines) + "\n}"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def read_document(path: Path) -> dict[str, Any]:
    """The object in a file, without its checksum; an object of format 1 has no `format`.

    Raises OSError if the file cannot be read, ValueError if it holds no object or one whose
    checksum does not match, and UserError for an unknown format.
    """
    try:
        content = json.loads(path.read_bytes())
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(content, dict):
        raise ValueError("not an object")
    if "format" not in content and "checksum" not in content:
        return content
    checksum, number = content.pop("checksum", None), content.get("format")
    if type(number) is not int or checksum != _checksum(content):
        raise ValueError("the checksum does not match")
    if not 1 < number <= FORMAT:
        raise UserError(
            f"{path} has format {number}; allowed: 1 to {FORMAT}; read it with the aoabench that "
            "wrote it, or repeat the run with another runner.out"
        )
    return content


def _checksum(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
