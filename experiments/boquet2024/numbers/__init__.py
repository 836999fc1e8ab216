"""Boquet et al. 2024: the numbers behind each figure, one function per item, each giving one frame.

A replication is a campaign with a channel of its own, so standard errors are over campaigns; those
of quantiles of all fixes leave out one campaign at a time (jackknife). Errors are horizontal.
"""

from .areas import areas
from .campaign import fig5, fig6, fig7, fig8
from .common import METHODS, SCORED
from .comparisons import boxes, errata, ranking, rejection
from .fit import misfit
from .geometry import fig2, fig3a, fig3b, fig3c, rule
from .readings import readings
from .robust import VARIANTS as robust_variants
from .robust import robust
from .timing import speed
