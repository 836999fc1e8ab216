"""Lu et al. 2019: figures and our numbers, each a function of an item's table alone."""

from .drawing import STYLES, errata, fig2, fig3, fig4, nees
from .readings import readings, readings_table, readings_values
from .values import (
    errata_values,
    fig2_values,
    fig3_values,
    fig4_values,
    nees_values,
    operations_values,
    table1_values,
    table2_values,
)
