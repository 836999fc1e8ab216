"""The machine code of kernels, and the processor that it is compiled for."""

import os
import subprocess
import sys

import pytest

SCRIPT = """
from importlib import import_module
for name in {kernels!r}:
    module, function = name.rsplit(".", 1)
    print("KERNEL", function)
    print(*getattr(import_module("aoabench.kernels." + module), function).inspect_asm().values())
"""


def features():
    """Features that numba compiles for: those of NUMBA_CPU_FEATURES, if set, or this machine's."""
    import llvmlite.binding as llvm
    import numba

    if numba.config.CPU_FEATURES is None:
        return {name for name, present in llvm.get_host_cpu_features().items() if present}
    return {f[1:] for f in numba.config.CPU_FEATURES.split(",") if f.startswith("+")}


def assembly(kernels, folder):
    """Text of the machine code of each kernel, "module.function", by the function's name.

    The modules are compiled again into `folder`, for numba's cache keeps no assembly. Skips the
    test where numba compiles without AVX2.
    """
    if "avx2" not in features():
        pytest.skip("no AVX2")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(kernels=kernels)],
        capture_output=True, text=True, check=True, env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
    )  # fmt: skip
    return dict(text.split(None, 1) for text in done.stdout.split("KERNEL ")[1:])


def vector_registers():
    """zmm or ymm: the registers that loops should use."""
    wide = "avx512f" in features() and "prefer-256-bit" not in features()
    return "zmm" if wide else "ymm"
