"""Functions of angles in double precision, without calls, so that loops around them vectorise.

Each kernel compiles these functions with its own options.
"""

from __future__ import annotations

import math

import numpy as np

from aoabench.kernels.compile import spliced

TURN, HALF_PI = 2.0 * math.pi, 0.5 * math.pi
TINY = 1e-300
TAN_EIGHTH = 0.41421356237309503  # tan(pi / 8)
_REST = 6.123233995736766e-17  # pi / 2 = HALF_PI + _REST

# coefficients of polynomials: arctan after two halvings, sine and cosine within an eighth of a turn
_A0, _A1, _A2, _A3 = (
    1.0 - 3.3e-17,
    -0.333333333333286125,
    0.199999999988882964,
    -0.142857141834355388,
)
_A4, _A5, _A6, _A7 = (
    0.111111062730520832,
    -0.0909077507849640526,
    0.0768997990214833756,
    -0.0664044937578105326,
)
_A8, _A9, _A10 = 0.0568941176226270065, -0.0435095403193050827, 0.0211690605246042418
_S1, _S2, _S3, _S4 = (
    -0.166666666666666666,
    0.00833333333333332026,
    -0.000198412698412530222,
    2.75573192133478667e-6,
)
_S5, _S6, _S7 = -2.50521047273601406e-8, 1.60583462371199003e-10, -7.57779904448778001e-13
_C1, _C2, _C3, _C4 = (
    -0.499999999999999993,
    0.0416666666666664288,
    -0.00138888888888588082,
    0.0000248015872828235969,
)
_C5, _C6, _C7 = -2.75573128463784456e-7, 2.08755527170372636e-9, -1.13520037105950103e-11


@spliced
def arctan(t):
    """atan(t), 0 <= t <= 1, by a polynomial after halving; relative error below 5e-16."""
    s = t / (1.0 + math.sqrt(1.0 + t * t))
    u = s * s
    p = _A5 + u * (_A6 + u * (_A7 + u * (_A8 + u * (_A9 + u * _A10))))
    return 2.0 * s * (_A0 + u * (_A1 + u * (_A2 + u * (_A3 + u * (_A4 + u * p)))))


@spliced
def angle(y, x, length):
    """atan2(y, x), where length = hypot(x, y); 0 where both are 0."""
    a = 2.0 * arctan(abs(y) / (length + abs(x) + TINY))
    return math.copysign(a if x >= 0.0 else math.pi - a, y)


@spliced
def direction_angle(y, x):
    """atan2(y, x), whatever the length; 0 where both are 0; relative error below 1e-15.

    Between tan(pi / 8) and 1, the smaller component is turned by an eighth of a turn before the
    only division.
    """
    a, b = abs(x), abs(y)
    least, most = b if b < a else a, a if b < a else b
    turned = least > TAN_EIGHTH * most
    s = (least - most if turned else least) / (least + most if turned else most + TINY)
    u = s * s
    p = _A5 + u * (_A6 + u * (_A7 + u * (_A8 + u * (_A9 + u * _A10))))
    t = s * (_A0 + u * (_A1 + u * (_A2 + u * (_A3 + u * (_A4 + u * p)))))
    t += 0.5 * HALF_PI if turned else 0.0
    t = HALF_PI - t if b > a else t
    return math.copysign(math.pi - t if x < 0.0 else t, y)


@spliced
def sine_cosine(x):
    """sin(x) and cos(x), |x| < 1e5."""
    q = np.rint(x / HALF_PI)
    r = (x - q * HALF_PI) - q * _REST
    u = r * r
    s = r + r * u * (_S1 + u * (_S2 + u * (_S3 + u * (_S4 + u * (_S5 + u * (_S6 + u * _S7))))))
    c = 1.0 + u * (_C1 + u * (_C2 + u * (_C3 + u * (_C4 + u * (_C5 + u * (_C6 + u * _C7))))))
    quarter = q - 4.0 * np.floor(0.25 * q)
    odd = (quarter == 1.0) | (quarter == 3.0)
    a = c if odd else s
    b = s if odd else c
    return -a if quarter >= 2.0 else a, -b if (quarter == 1.0) | (quarter == 2.0) else b


@spliced
def wrapped(a):
    """An angle brought into (-pi, pi]."""
    a -= TURN * np.rint(a / TURN)
    return a if a > -math.pi else math.pi
