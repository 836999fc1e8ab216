"""Limits that the compiled robust likelihood and the one in NumPy share; importable without
numba.
"""

from __future__ import annotations

STARTS = 36  # the most candidates of a start that are made of the rays of one or two anchors
REDUNDANT = 2  # a robust loss needs so many angles more than unknowns
USED = 0.25  # an anchor is used if its azimuth has this share of the weight of a perfect one
GROWTH = 4.0  # factor on the steepness of the truncated loss at each step
STEEP = 1e4  # steepness at which the truncated loss is reached; the transition is 1e-4 wide
EVEN = 1e-9  # relative difference of two costs up to which they are equal
SLACK = 1e-12  # relative growth of a cost that is still a descent
ROUNDING = 1e-13  # of a cost, whose unit is a squared deviation
GAIN = 1e-18  # expected decrease of a cost below which a step is rounding error
TINY = 1e-30  # m^2; a squared distance is at least this
FLAT = 1e-12  # of the squares of normals' vertical parts: the planes are then vertical
LEAST, MOST = 1e-12, 1e12  # damping
