"""Hashes of plain values and of dataclasses, and nested mappings as dotted keys."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np


def digest(content: Any) -> str:
    """Hash of plain values; equal for equal content, where 5 equals 5.0."""
    text = json.dumps(_canonical(content), sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _canonical(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _canonical(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_canonical(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def described(value: Any) -> Any:
    """Return the content of an object as plain values.

    A dataclass gives its public name and the fields that differ from their defaults, so that a new
    field with a neutral default changes nothing. Any other object gives a random text.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray) and value.dtype != object:
        content = hashlib.blake2b(np.ascontiguousarray(value).tobytes()).hexdigest()
        return [str(value.dtype), value.shape, content]
    if isinstance(value, list | tuple):
        return [described(v) for v in value]
    if isinstance(value, dict):
        return {str(k): described(v) for k, v in value.items()}
    if not is_dataclass(value) or isinstance(value, type):
        return uuid.uuid4().hex
    found = {}
    for f in fields(value):
        own = getattr(value, f.name)
        if f.init and (no_default(f) or not _equal(own, default_of(f))):
            found[f.name] = described(own)
    return [public_name(type(value)), found]


def _equal(one: Any, other: Any) -> bool:
    """Whether two values have the same digest."""
    if type(one) is type(other) and isinstance(one, bool | int | float | str | None):
        return bool(one == other or (one != one and other != other))
    return digest(described(one)) == digest(described(other))


def public_name(cls: type) -> str:
    """Name of a class with its package, without its file, such as noise.VonMisesFisher."""
    head, *rest = cls.__module__.split(".")
    return f"{rest[0] if head == 'aoabench' and rest else head}.{cls.__qualname__}"


def no_default(f: Any) -> bool:
    """Whether a dataclass field has no default."""
    return bool(f.default is MISSING and f.default_factory is MISSING)


def default_of(f: Any) -> Any:
    """The default of a dataclass field that has one."""
    return f.default_factory() if f.default is MISSING else f.default


def flatten(node: Any, prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Dotted keys and leaves of nested mappings; lists are leaves."""
    if isinstance(node, Mapping) and node:
        for key, value in node.items():
            yield from flatten(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, node
