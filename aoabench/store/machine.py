"""The kind of processor as the libraries see it: equal kinds give equal last digits."""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from aoabench.errors import shorten


@functools.cache
def machine() -> dict[str, str]:
    """What the last digits of numbers depend on besides code and versions, by name.

    numpy_features: those that NumPy uses; numpy_blas, scipy_blas: library, version and the kind of
    processor it computes for; llvm_cpu, llvm_features: the target of compiled kernels. A name is
    absent if the library is, or if it does not tell. NPY_DISABLE_CPU_FEATURES, OPENBLAS_CORETYPE,
    NUMBA_CPU_NAME and NUMBA_CPU_FEATURES count.
    """
    simd = np.show_config(mode="dicts").get("SIMD Extensions", {})
    features = sorted({*simd.get("baseline", []), *simd.get("found", [])})
    return {"numpy_features": " ".join(features), **dict(_blas()), **_llvm()}


def difference(there: Mapping[str, str], here: Mapping[str, str], word: str = "here") -> str:
    """What differs between two machines, in words, with `word` for the second; "" if nothing."""
    found = []
    for name in sorted({*there, *here}):
        theirs, ours = there.get(name, "none"), here.get(name, "none")
        if theirs == ours:
            continue
        if name.endswith("features"):
            theirs, ours = (_only(a, b) for a, b in ((theirs, ours), (ours, theirs)))
        words = name.replace("_", " ").replace("numpy", "NumPy's").replace("scipy", "SciPy's")
        words = words.replace("blas", "BLAS").replace("llvm", "LLVM's")
        found.append(shorten(f"{words} {theirs}, {word} {ours}", 150))
    return "; ".join(found)


def _only(one: str, other: str) -> str:
    """The features of one list that the other lacks."""
    found = [name for name in one.split() if name not in other.split()]
    return "has " + " ".join(found) if found else "lacks these"


def _blas() -> Iterator[tuple[str, str]]:
    """The BLAS libraries of NumPy and SciPy, as far as threadpoolctl knows them."""
    from threadpoolctl import threadpool_info

    _load_scipys_blas()
    libraries = [found for found in threadpool_info() if found["user_api"] == "blas"]
    for package in ("numpy", "scipy"):
        own = [lib for lib in libraries if f"{package}.libs" in lib["filepath"]]
        shared = [lib for lib in libraries if ".libs" not in lib["filepath"]]
        for lib in (own or shared)[:1]:
            words = (lib["internal_api"], lib["version"], lib.get("architecture"))
            yield f"{package}_blas", " ".join(word for word in words if word)


def _load_scipys_blas() -> None:
    """Load the BLAS inside SciPy's wheel, if there is one: 4 ms, where scipy.linalg takes 200."""
    spec = importlib.util.find_spec("scipy")
    if spec is not None and spec.origin is not None:
        for library in (Path(spec.origin).parents[1] / "scipy.libs").glob("*openblas*"):
            ctypes.CDLL(str(library))


def _llvm() -> dict[str, str]:
    """The target of numba's compiler by the rules of numba.core.config; numba is not imported."""
    try:
        from llvmlite import binding
    except ImportError:
        return {}
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return {"llvm_cpu": "off"}
    name = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    features = os.environ.get("NUMBA_CPU_FEATURES", "" if name.lower() == "generic" else None)
    if features is None:
        try:
            features = binding.get_host_cpu_features().flatten()
        except RuntimeError:  # LLVM knows none of this processor
            features = ""
    used = sorted(name[1:] for name in features.split(",") if name.startswith("+"))
    if os.environ.get("NUMBA_ENABLE_AVX") == "0":
        used = [name for name in used if not name.startswith("avx")]
    return {"llvm_cpu": name, "llvm_features": " ".join(used)}
