"""Which kernel computes what a measurement model's methods do.

A measurement model says so by its own class attribute `kernel`. A subclass does not inherit that:
it may change what the kernel would not know of.
"""

from __future__ import annotations

from aoabench.roles import Measurement

KINDS = ("unit_vector", "azel", "azel_adaptive")  # as numbered in the kernels' files


def kind_of(measurement: Measurement, engine: str = "auto") -> int | None:
    """The number of the kernel that this measurement model names in its own class, or None."""
    name = vars(type(measurement)).get("kernel")
    return KINDS.index(name) if engine == "auto" and name in KINDS else None
