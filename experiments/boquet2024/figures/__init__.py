"""Boquet et al. 2024: figures and printed values, each a function of an item's table alone."""

from .areas import areas, areas_values
from .campaign import fig5, fig5_values, fig6, fig6_values, fig7, fig7_values, fig8, fig8_values
from .common import NAMES
from .comparisons import (
    boxes,
    boxes_values,
    errata_values,
    ranking,
    ranking_values,
    rejection,
    rejection_values,
)
from .fit import misfit, misfit_values, speed, speed_values
from .geometry import (
    fig2,
    fig2_values,
    fig3a,
    fig3a_values,
    fig3b,
    fig3b_values,
    fig3c,
    fig3c_values,
    rule,
    rule_values,
)
from .readings import readings, readings_values
from .robust import robust, robust_values
