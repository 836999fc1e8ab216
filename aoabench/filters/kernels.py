"""Which kernel computes what a measurement model's methods do.

A measurement model says so by its own class attribute `kernel`. A subclass does not inherit that:
it may change what the kernel would not know of.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from aoabench.geometry import Array

KINDS = ("unit_vector", "azel", "azel_adaptive")  # as numbered in the kernels' files


def kind_of(measurement: Any, engine: str = "auto") -> int | None:
    """The number of the kernel that this measurement model names in its own class, or None."""
    name = vars(type(measurement)).get("kernel")
    return KINDS.index(name) if engine == "auto" and name in KINDS else None


def variances(measurement: Any) -> np.ndarray:
    """Variances (181, 2) rad^2 of azimuth and elevation at -90, -89 ... 90 degrees, for a model
    that has them.
    """
    return measurement.variances() if hasattr(measurement, "variances") else np.ones((181, 2))


def innovations(values: Array, anchors: int, names: tuple[str, ...] = ()) -> dict[str, Array]:
    """Columns (R, T) of a trace from innovations (R, T, B d) in anchor order: measured less
    expected, or NaN.

    `names` of the d components; without them two are azimuth and elevation, three those of a unit
    vector.
    """
    each = values.reshape(*values.shape[:2], anchors, -1)
    names = names or {2: ("azimuth_rad", "elevation_rad"), 3: ("x", "y", "z")}.get(
        each.shape[-1], ()
    )
    names = names or tuple(str(c) for c in range(each.shape[-1]))
    return {
        f"innovation_{j}_{name}": each[..., j, c]
        for j in range(anchors)
        for c, name in enumerate(names)
    }
