"""Shipped folders and versions of installed libraries."""

from __future__ import annotations

import functools
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


def shipped(folder: str) -> Path:
    """Where `configs` or `experiments` lie: inside the installed package, or beside it in a
    checkout.
    """
    package = Path(__file__).resolve().parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


@functools.cache
def version(name: str) -> str | None:
    """Version of an installed library; None if it is not there."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
