"""Columns of a filter's trace in a replay."""

from __future__ import annotations

from aoabench.maths.geometry import Array


def innovations(values: Array, anchors: int, names: tuple[str, ...] = ()) -> dict[str, Array]:
    """Columns (R, T) of a trace from innovations (R, T, B d), measured minus expected or NaN, in
    anchor order.

    `names` are those of the d components; the default is azimuth and elevation for d = 2, and the
    components of a unit vector for d = 3.
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
