"""Choice of the kernel that replaces a measurement model's methods.

A measurement model names its kernel in its own class attribute `kernel`. A subclass does not
inherit the kernel, because it may change methods that the kernel replaces.
"""

from __future__ import annotations

from aoabench.roles import Measurement

KINDS = ("unit_vector", "azel", "azel_adaptive")  # as numbered in the kernels' files
COMPONENTS = (3, 2, 2)  # of one anchor


def kind_of(measurement: Measurement, engine: str = "auto") -> int | None:
    """Number of the kernel that the measurement model names in its own class, or None."""
    name = vars(type(measurement)).get("kernel")
    return KINDS.index(name) if engine == "auto" and name in KINDS else None
