"""Nurminen et al. 2018: figures and printed values, each a function of an item's table alone."""

from .common import ORDER
from .layouts import adaptivity, adaptivity_values, layouts, layouts_values
from .models import fig1, fig1_values, fig2, fig2_values, table1_values
from .replications import (
    fig3,
    fig4,
    fig4_values,
    frames,
    frames_values,
    particles,
    particles_values,
    readings,
    readings_values,
)
