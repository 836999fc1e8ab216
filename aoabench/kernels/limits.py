"""Limits that the compiled filters and those in NumPy share; importable without numba."""

from __future__ import annotations

# An EKF skips, for one step, an anchor at less than this share of the predicted position's standard
# deviation (root of the trace of its covariance) from the predicted position. There one standard
# deviation would turn the linearised direction by more than 1000 rad.
NEAREST = 1e-3
# A normalised innovation squared is reported without this share of the sum of v^2 / r, which
# bounds the rounding error of its computation.
ROUNDED = 1e-12
# effective number of particles up to which a particle filter's covariance is only rounding error
ONE_PARTICLE = 1.00001
