"""Digests of the rows of every preset, to show that a change left each number as it was.

A line per setting, estimator and column of a fixed list; ids of cells are left out, so that numbers
alone count. The bits depend on the processor and on the libraries, which the head of the file names.
After a change that means to move numbers, write the file again:

    python -m tests.golden.fingerprint > tests/golden/fingerprint.txt
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator
from importlib import metadata

import numpy as np
from numba.core.registry import cpu_target
from threadpoolctl import threadpool_info

import aoabench

COLUMNS = (
    "replication", "rmse_3d_m", "rmse_xy_m", "rmse_z_m", "outcome", "n_fixes", "n_ok", "n_diverged",
    "n_oscillated", "n_failed", "n_rejected", "iterations", "nees",
)  # fmt: skip
MODELS = ("ae_nominal", "ae_fitted", "ae_adaptive", "vmf")
KALMAN = [f"{kind}_{model}" for kind in ("ekf", "ukf") for model in MODELS]
KALMAN += ["ukf_ae_adaptive_augmented", "ekf_aoa"]
SMOOTHERS = [f"{kind}_{model}_smoother" for kind in ("ekf", "ukf") for model in MODELS]
SMOOTHERS += ["map_smoother"]
PARTICLES = [f"pf_{model}" for model in MODELS]
SNAPSHOT = ["ls", "ml_arctan", "ml_atan2", "ml_kcorr", "ls_lines", "ls_anchor_discarding", "vmf_ml"]
ROOM = [
    "anchor_mean", "best_anchor", "discrepancy", "discrepancy_exact", "ls_anchor_discarding",
    "ls_lines", "robust_ml", "rssi_anchor", "single_anchor_1", "single_anchor_2", "single_anchor_3",
    "vmf_ml",
]  # fmt: skip


def chosen(names: list[str]) -> str:
    """The names as a list of Hydra's grammar."""
    return f"[{','.join(names)}]"


TRACK = [f"filter={chosen(KALMAN)}", f"estimator={chosen(SNAPSHOT)}"]
REFERENCE = [f"{kind}_{model}" for kind in ("ekf", "ukf", "pf") for model in MODELS]
CASES: dict[str, tuple[list[str], int]] = {  # name: overrides, replications
    **{
        f"square_{noise}": (["scenario=square_track", f"noise={noise}", *TRACK], 90)
        for noise in ("ae_flip", "vmf", "ae_normal")
    },
    "particles": (
        ["scenario=square_track", "noise=vmf", f"filter={chosen(PARTICLES)}",
         *(f"filter.{name}.particles=512" for name in PARTICLES)], 3,
    ),
    "smoothers": (
        ["scenario=square_track", "noise=vmf", f"filter={chosen(SMOOTHERS)}"], 40,
    ),
    "map_smoothers": (
        ["scenario=indoor_map", "noise=ofdm_crlb", "noise.an_sigma_m=0.5", "scenario.dt=2",
         "filter=[ekf_toa_aoa_smoother,ekf_aoa_smoother]"], 2,
    ),
    "grid": (
        ["scenario=bs_grid", "noise=ae_normal", "noise.sigma_deg=4",
         f"estimator={chosen(['ls', 'ml_arctan', 'ml_atan2', 'ml_kcorr', 'robust_ml', 'vmf_ml'])}"], 2,
    ),
    "map": (
        ["scenario=indoor_map", "noise=ofdm_crlb", "noise.an_sigma_m=0.5", "scenario.dt=2",
         "filter=[ekf_toa_aoa,ekf_aoa]", "estimator=[wcg,wcg_as_printed]"], 3,
    ),
    "room": (
        ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=6",
         f"estimator={chosen(ROOM)}"], 2,
    ),
    "track_in_numpy": (
        ["scenario=square_track", "noise=vmf", f"filter={chosen(REFERENCE)}",
         f"estimator={chosen(SNAPSHOT[:4] + SNAPSHOT[-1:])}",
         *(f"filter.{name}.engine=numpy" for name in REFERENCE),
         *(f"filter.{name}.particles=256" for name in PARTICLES),
         *(f"estimator.{name}.engine=numpy" for name in SNAPSHOT[:4])], 2,
    ),
    "map_in_numpy": (
        ["scenario=indoor_map", "noise=ofdm_crlb", "noise.an_sigma_m=0.5", "scenario.dt=2",
         "filter=[ekf_toa_aoa,ekf_aoa]", "filter.ekf_toa_aoa.engine=numpy",
         "filter.ekf_aoa.engine=numpy"], 1,
    ),
}  # fmt: skip


def head() -> Iterator[str]:
    """Lines that name what the bits depend on: libraries, and what they do on this processor."""
    names = ("numpy", "scipy", "numba", "llvmlite", "shapely")
    yield "# libraries: " + " ".join(f"{name} {metadata.version(name)}" for name in names)
    _, cpu, features = cpu_target.target_context.codegen().magic_tuple()
    vector = [f for f in features.split(",") if f.startswith(("+avx", "+fma", "+sse"))]
    yield f"# kernels for: {cpu} {' '.join(sorted(vector))}"
    simd = np.show_config(mode="dicts")["SIMD Extensions"]
    yield "# NumPy uses: " + " ".join(sorted([*simd["baseline"], *simd["found"]]))
    blas = {str(i.get("architecture")) for i in threadpool_info() if i["user_api"] == "blas"}
    yield "# BLAS for: " + " ".join(sorted(blas))


def lines(case: str) -> Iterator[str]:
    """A line `CASE ESTIMATOR COLUMN ROWS DIGEST` per estimator and column."""
    overrides, reps = CASES[case]
    with tempfile.TemporaryDirectory() as out:
        serial = ["runner.backend=sequential", "runner.n_jobs=1", "runner.chunk=128"]
        frame = aoabench.run(*overrides, f"reps={reps}", *serial, out=out)
    for estimator, rows in frame.groupby("estimator", sort=True):
        for column in COLUMNS:
            values = rows[column]
            number = values.dtype.kind in "fi"
            data = values.to_numpy(float).tobytes() if number else "|".join(values).encode()
            digest = hashlib.blake2b(data, digest_size=8).hexdigest()
            yield f"{case} {estimator} {column} {len(rows)} {digest}"


def main() -> None:
    """Print the head and all lines."""
    print(*head(), sep="\n")
    for case in CASES:
        print(*lines(case), sep="\n", flush=True)


if __name__ == "__main__":
    main()
