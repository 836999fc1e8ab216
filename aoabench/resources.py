"""Shipped folders, the folder that output goes to, and versions of installed libraries."""

from __future__ import annotations

import functools
import os
from importlib import metadata
from pathlib import Path
from typing import Any


def shipped(folder: str) -> Path:
    """Path of `configs` or `experiments`: inside the installed package, or beside it in a
    checkout.
    """
    package = Path(__file__).resolve().parent
    inside = package / folder
    return inside if inside.is_dir() else package.parent / folder


def committing() -> bool:
    """Whether COMMIT=1 stands in the environment: committed files may be replaced."""
    return os.environ.get("COMMIT") == "1"


def output_folder() -> Path:
    """`results`, whose files are committed, if `committing`; else results/draft, which git
    ignores.
    """
    return Path("results") if committing() else Path("results/draft")


@functools.cache
def printed(study: str) -> dict[str, Any]:
    """Numbers printed in a study's paper, by the ids of their claims; None for a claim without a
    number.
    """
    import yaml

    path = shipped("experiments") / study / "claims.yaml"
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))["claims"]
    return {entry["id"]: entry.get("printed") for entry in entries}


@functools.cache
def version(name: str) -> str | None:
    """Version of an installed library; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
