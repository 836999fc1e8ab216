"""Copies of plug-ins: as a worker process gets them, and with other members."""

from __future__ import annotations

import pickle
from copy import copy
from typing import Any, TypeVar

_T = TypeVar("_T")


def sent(obj: _T) -> _T:
    """The object as a worker process gets it; the bytes come from this process alone."""
    found: _T = pickle.loads(pickle.dumps(obj))
    return found


def with_members(obj: _T, **members: Any) -> _T:
    """A copy of an object of a subclass of its class, whose members are the given ones: functions,
    properties or values.
    """
    kind = type(obj)
    made = type(kind.__name__, (kind,), {"__module__": kind.__module__, **members})
    found = copy(obj)
    object.__setattr__(found, "__class__", made)
    return found
