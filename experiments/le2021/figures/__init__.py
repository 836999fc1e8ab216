"""Le, Slock, Rossi 2021: figures and our numbers, each a function of an item's table alone."""

from .common import NAMES, STYLES
from .curves import fig5, fig5_values, fig6, fig6_values, fig7, fig7_values
from .outcomes import table1, table1_values
from .variants import errata, errata_values, pole, pole_values, zones, zones_values

__all__ = [
    "NAMES",
    "STYLES",
    "errata",
    "errata_values",
    "fig5",
    "fig5_values",
    "fig6",
    "fig6_values",
    "fig7",
    "fig7_values",
    "pole",
    "pole_values",
    "table1",
    "table1_values",
    "zones",
    "zones_values",
]
