"""Le, Slock, Rossi 2021: the numbers behind each table and figure, one function per item, each
giving one frame.

Every fix of a replication has another position, and all replications have the same positions:
standard errors are over positions, from each position's mean over the replications' draws.
"""

from .curves import fig5, fig6, fig7
from .outcomes import table1
from .variants import errata, pole, zones

__all__ = ["errata", "fig5", "fig6", "fig7", "pole", "table1", "zones"]
