"""Nurminen et al. 2018: the numbers behind each table and figure, one function per item, each
giving one frame.
"""

from .models import fig1, table1
from .replications import adaptivity, fig3, fig4, frames, layouts, particles, readings
from .update import FIG2, exact_mean, fig2
