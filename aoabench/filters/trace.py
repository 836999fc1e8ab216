"""What a filter shows of a replayed replication."""

from __future__ import annotations

from aoabench.maths.geometry import Array


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
