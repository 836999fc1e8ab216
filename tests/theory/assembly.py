"""The machine code of kernels, and the processor that it is compiled for."""

import os
import subprocess
import sys
from importlib import import_module

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

    numba's cache keeps no assembly: kernels that come from the cache are compiled again into
    `folder`. Skips the test where numba compiles without AVX2.
    """
    if "avx2" not in features():
        pytest.skip("no AVX2")
    found = {name: compiled_here(name) for name in kernels}
    again = [name for name, text in found.items() if not text]
    if again:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT.format(kernels=again)],
            capture_output=True, text=True, check=True, env={**os.environ, "NUMBA_CACHE_DIR": str(folder)},
        )  # fmt: skip
        texts = dict(text.split(None, 1) for text in done.stdout.split("KERNEL ")[1:])
        found |= {name: texts[name.split(".")[1]] for name in again}
    return {name.split(".")[1]: text for name, text in found.items()}


def compiled_here(name):
    """The machine code of a kernel that this process has compiled; "" of one from the cache."""
    module, function = name.split(".")
    kernel = getattr(import_module(f"aoabench.kernels.{module}"), function).ready()
    return "" if kernel.stats.cache_hits else "\n".join(kernel.inspect_asm().values())


def vector_registers():
    """zmm or ymm: the registers that loops should use."""
    wide = "avx512f" in features() and "prefer-256-bit" not in features()
    return "zmm" if wide else "ymm"
