"""Fit the parameters of `ble_multipath` to the printed numbers and test them on other campaigns.

    python -m experiments.boquet2024.calibrate [--search 300] [--starts 2] [--evaluations 600]
    [--fresh 20] [--write]

The fit uses `--seeds` campaigns of root seed 2024, always the same draws, so that the misfit is a
function of the parameters alone, though too rough for derivatives. The fit minimises the squared
misfits of `numbers/fit.py` and the log ratios to the printed grids by Powell's method, from the
`--starts` best among `--search` random points and the shipped parameters. The test uses `--fresh`
campaigns of root seed 1, as the study does. `--write` writes the result into
configs/noise/ble_multipath.yaml.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from aoabench import resources
from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.estimators.discrepancy import Discrepancy
from aoabench.noise.multipath import BleMultipath
from aoabench.store.fixes import Fixes
from experiments.boquet2024.numbers.common import error, medians, printed_grids
from experiments.boquet2024.numbers.fit import SWEEP, day_statistics, misfits

FIT_SEED, FRESH_SEED = 2024, 1
METHODS = ("single_anchor_2", "anchor_mean", "vmf_ml")
# a log ratio of this much at every point of a grid weighs as much as one misfit of 1 times sqrt(42
# / 8)
GRID_WEIGHT = 0.35

# bounds of the fitted parameters, which vary on their logarithms
FREE = {
    "azimuth_noise_deg": (0.5, 6),
    "elevation_noise_deg": (0.5, 10),
    "steep_deg": (6, 35),
    "steep_power": (0.5, 5),
    "azimuth_bias_deg": (0.5, 12),
    "elevation_bias_deg": (0.5, 12),
    "azimuth_day_deg": (0.2, 4),
    "elevation_day_deg": (0.2, 4),
    "disturbed_1": (0.05, 0.9),
    "disturbed_2": (0.03, 0.7),
    "pull_1": (0.02, 2),
    "pull_2": (0.03, 6),
    "pull_3": (0.03, 6),
    "correlation_m": (0.4, 3),
    "outliers": (0.003, 0.2),
    "outlier_deg": (3, 60),
    "bias_scale_2": (0.5, 4),
    "bias_scale_3": (0.5, 4),
}


LISTS = (
    "disturbed",
    "pull",
    "bias_scale",
)  # NAME_1, NAME_2 ... are the elements; the first scale is 1


def noise_of(x: np.ndarray) -> BleMultipath:
    """The noise model of a point in the space of logarithms."""
    value = {name: float(v) for name, v in zip(FREE, np.exp(x))}
    lists = {name: _list(value, name) for name in LISTS}
    return replace(BleMultipath(), **value, **lists)  # type: ignore[arg-type]


@cache
def _room(packets: int) -> Any:
    words = ["scenario=ble_room", "noise=ble_multipath", f"scenario.packets={packets}"]
    return compose_cells([*words, f"estimator=[{','.join(METHODS)}]"])[0]


def campaigns(
    noise: BleMultipath, seed: int, count: int, packets: int
) -> tuple[Any, dict[str, Fixes]]:
    """A cell of the room with this noise, and the fixes of `count` campaigns."""
    cell = replace(_room(packets), noise=noise, seed=seed)
    filters = {f"df_boxes_{round(10 * r):02d}": Discrepancy(r_sigma=r, ties="first") for r in SWEEP}
    found = run_block(cell.scenario, noise, {**cell.estimators, **filters}, seed, 0, count)
    names = [f.name for f in fields(Fixes)]
    return cell, {
        name: Fixes(**{n: block["fixes"][n] for n in names}) for name, block in found.items()
    }


def table(noise: BleMultipath, seed: int, count: int, packets: int) -> pd.DataFrame:
    """The misfits of `count` campaigns."""
    cell, fixes = campaigns(noise, seed, count, packets)
    days = day_statistics(cell.scenario, noise, seed, 0, count)
    return pd.DataFrame(list(misfits(fixes, days, len(cell.scenario.points_m))))


def misfit(x: np.ndarray, count: int, packets: int) -> float:
    """The objective of the fit over `count` campaigns: half the sum of the squared misfits."""
    cell, fixes = campaigns(noise_of(x), FIT_SEED, count, packets)
    days = day_statistics(cell.scenario, cell.noise, FIT_SEED, 0, count)
    rows = misfits(fixes, days, len(cell.scenario.points_m))
    found = [row["misfit"] for row in rows if "misfit" in row]
    for name, grid in printed_grids().items():
        if name in fixes:
            ours = np.nanmean(medians(error(fixes[name]), len(grid)), axis=0)
            found += list(np.log(ours / grid) / GRID_WEIGHT / np.sqrt(len(grid) / 8))
    return 0.5 * float(np.sum(np.nan_to_num(np.array(found), nan=10.0) ** 2))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    for name, default in (
        ("search", 300),
        ("starts", 2),
        ("evaluations", 600),
        ("seeds", 6),
        ("packets", 10),
        ("fresh", 20),
    ):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    low, high = (np.log([bound[i] for bound in FREE.values()]) for i in (0, 1))
    shipped = BleMultipath(**{k: v for k, v in _shipped().items() if not k.startswith("_")})
    tried = np.random.default_rng(0).uniform(low, high, (args.search, len(low)))
    tried = np.vstack(
        [np.clip(np.log([_value(shipped, name) for name in FREE]), low + 1e-3, high - 1e-3), tried]
    )
    cost = [misfit(x, 3, 8) for x in tried]
    best = None
    for start in np.argsort(cost)[: args.starts]:
        found = minimize(
            misfit,
            tried[start],
            args=(args.seeds, args.packets),
            method="Powell",
            bounds=list(zip(low, high)),
            options={"maxfev": args.evaluations, "xtol": 0.05, "ftol": 1e-3},
        )
        print(f"from {cost[start]:.2f}: {found.fun:.2f} after {found.nfev} evaluations", flush=True)
        best = found if best is None or found.fun < best.fun else best
    assert best is not None
    rounded = {name: float(f"{_value(noise_of(best.x), name):.3g}") for name in FREE}
    noise = noise_of(np.log(list(rounded.values())))
    for name, value in rounded.items():
        print(f"{name}: {value:g}")
    print(table(noise, FRESH_SEED, args.fresh, 100).to_string(index=False))
    if args.write:
        _write(rounded)


def _list(values: dict[str, float], name: str) -> tuple[float, ...]:
    """Take the elements of a list out of the values."""
    numbered = sorted(key for key in values if re.fullmatch(rf"{name}_\d", key))
    found = tuple(values.pop(key) for key in numbered)
    return found if numbered[0].endswith("_1") else (1.0, *found)


def _value(noise: BleMultipath, name: str) -> float:
    stem, _, number = name.rpartition("_")
    if number.isdigit():
        values = getattr(noise, stem)
        return float(values[min(int(number), len(values)) - 1])
    return float(getattr(noise, name))


def _shipped() -> dict[str, Any]:
    cell = compose_cells(["scenario=ble_room", "noise=ble_multipath", "estimator=[anchor_mean]"])[0]
    return dict(cell.config["noise"])


def _write(values: dict[str, float]) -> None:
    path = resources.shipped("configs") / "noise" / "ble_multipath.yaml"
    text = path.read_text(encoding="utf-8")
    values = dict(values)
    lists = {name: "[" + ", ".join(f"{v:g}" for v in _list(values, name)) + "]" for name in LISTS}
    for name, value in {**{k: f"{v:g}" for k, v in values.items()}, **lists}.items():
        text = re.sub(rf"(?m)^{name}: \S.*?(\s+#)", rf"{name}: {value}\1", text)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
