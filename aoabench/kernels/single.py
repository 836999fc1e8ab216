"""Single precision for kernels: the bits of numbers, and functions as polynomials that vectorise.

The polynomials are minimax over the range that each docstring names.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from aoabench.kernels.compile import inlined

f4, i4 = np.float32, np.int32

ZERO, HALF, ONE = f4(0.0), f4(0.5), f4(1.0)
# logarithm below which a weight is 0: beside the largest weight, 1, it would not change a sum, and
# its square would be denormal
LOWEST = f4(-40.0)
LOG2, LOG2E = f4(math.log(2.0)), f4(1.0 / math.log(2.0))
_LOG2E = 1.0 / math.log(2.0)

_A0, _A1, _A2, _A3 = (f4(c) for c in (0.999999901, -0.3333199075, 0.1996972389, -0.1401948087))
_A4, _A5, _A6, _A7 = (f4(c) for c in (0.09914292764, -0.05948639267, 0.024252403, -0.004693276039))
_E0, _E1, _E2 = (f4(c) for c in (1.000000072, 0.6931469671, 0.2402211972))
_E3, _E4, _E5 = (f4(c) for c in (0.05550713272, 0.009675541343, 0.001327647263))
_L0, _L1, _L2, _L3 = (f4(c) for c in (0.9999999453, -0.5000036512, 0.3333505894, -0.2496990914))
_L4, _L5, _L6, _L7 = (f4(c) for c in (0.1990016553, -0.1725082891, 0.162225804, -0.1010689832))
# the float32 format; the bits of sqrt(1/2)
_BIAS, _FRACTION, _ROOT_HALF = i4(127), i4(0x007FFFFF), i4(0x3F3504F3)
_23 = i4(23)


@intrinsic
def as_float(typingctx: Any, bits: Any) -> Any:
    """The float32 whose bits are those of an int32."""
    return types.float32(types.int32), lambda c, builder, s, a: builder.bitcast(
        a[0], ir.FloatType()
    )


@intrinsic
def as_int(typingctx: Any, x: Any) -> Any:
    """The bits of a float32 as int32."""
    return types.int32(types.float32), lambda c, builder, s, a: builder.bitcast(
        a[0], ir.IntType(32)
    )


@intrinsic
def larger(typingctx: Any, a: Any, b: Any) -> Any:
    """max(a, b) of two float32, neither of them NaN, such that a loop over it vectorises."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        flags = ("nnan", "nsz")
        return builder.select(builder.fcmp_ordered(">", *args, flags=flags), *args, flags=flags)

    return types.float32(types.float32, types.float32), generate


@intrinsic
def inverse_root(typingctx: Any, x: Any) -> Any:
    """1 / sqrt(x), x > 0, from the processor's estimate and one step of Newton's method where it
    has one; relative error below 4e-7.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        root = builder.module.declare_intrinsic("llvm.sqrt", [ir.FloatType()])
        value = builder.call(root, args, fastmath=("fast",))
        return builder.fdiv(ir.Constant(ir.FloatType(), 1.0), value, flags=("fast",))

    return types.float32(types.float32), generate


@inlined
def arctan(t):
    """atan(t), 0 <= t <= 1; relative error below 2.5e-7."""
    u = t * t
    return t * (
        _A0 + u * (_A1 + u * (_A2 + u * (_A3 + u * (_A4 + u * (_A5 + u * (_A6 + u * _A7))))))
    )


@inlined
def exponential(x):
    """exp(x), x <= 0; relative error below 4e-6 (3e-7 for x > -1); 0 for x <= -40."""
    v = larger(x, LOWEST) * LOG2E
    k = np.floor(v + HALF)
    f = v - k
    p = _E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5))))
    scale = as_float(i4((i4(k) + _BIAS) << _23))
    return p * scale if x > LOWEST else ZERO


@inlined
def precise_exponential(x):
    """exp(x), x <= 0, as a double; relative error below 3e-7; 0 for x <= -40."""
    v = larger(x, LOWEST) * _LOG2E
    k = np.floor(v + 0.5)
    f = f4(v - k)
    p = _E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * _E5))))
    scale = as_float(i4((i4(k) + _BIAS) << _23))
    return np.float64(p * scale) if x > LOWEST else 0.0


@inlined
def logarithm(x):
    """log(x), 2^-33 <= x <= 1; absolute error below 2e-6, relative below 4e-7."""
    b = i4(as_int(x) - _ROOT_HALF)
    e = i4(b >> _23)
    f = as_float(i4(i4(b & _FRACTION) + _ROOT_HALF)) - ONE
    p = _L0 + f * (_L1 + f * (_L2 + f * (_L3 + f * (_L4 + f * (_L5 + f * (_L6 + f * _L7))))))
    return f * p + f4(e) * LOG2
