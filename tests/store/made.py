"""Parts and records of a run that nobody simulated."""

import numpy as np

from aoabench.store.folder import write_record
from aoabench.store.parts import write_part

ORIGIN = {"config": {}}


def block(start, stop, fixes=0, seed=1):
    """The tables of one estimator's replications, with that many fixes each of their own (0: none
    are stored).
    """
    n = stop - start
    rng = np.random.default_rng([seed, start])
    count, number = np.full(n, 5), np.arange(start, stop)
    errors = {f"rmse_{axis}_m": rng.gamma(4, 0.1, n) for axis in ("3d", "xy", "z")}
    zeros = dict.fromkeys(("n_diverged", "n_oscillated", "n_failed", "n_rejected"), count * 0)
    rest = {"n_unmeasured": count * 0, "n_imprecise": count * 0, "reason": np.full(n, "")}
    rest["tag"] = np.full(n, None)
    rows = {"replication": number, **errors, "outcome": np.full(n, "ok"), "n_fixes": count}
    rows |= {"n_ok": count, **zeros, "iterations": np.full(n, np.nan), "nees": rng.gamma(3, 1, n)}
    made = {"rows": rows | rest}
    if fixes:
        floats = ("error_3d_m", "error_xy_m", "iterations", "score", "anchors_used")
        floats += ("sigma_x_m", "sigma_y_m", "sigma_z_m")
        flags = ("outcome", "reason", "imprecise", "n_unmeasured")
        made["fixes"] = {
            "replication": number,
            **{name: rng.gamma(4, 0.1, (n, fixes)).astype(np.float32) for name in floats},
            **{name: np.zeros((n, fixes), dtype=np.int8) for name in flags},
            "place": np.tile(np.arange(fixes, dtype=np.int32), (n, 1)),
        }
    return made


def part(out, key, start, stop, fixes=0, machine=None):
    write_part(out, key, start, stop, block(start, stop, fixes), ORIGIN, machine)


def cell(out, name, estimators=("ls", "ml"), keys="", **parameters):
    """The record and the parts of a cell with these estimators and 4 replications of 2 fixes, in two
    parts of the first estimator; `parameters` are those of its noise,
    and `keys` begins its part keys.
    """
    entries = {}
    for estimator in estimators:
        key = f"{keys}{name}{estimator}"
        two = estimator == estimators[0]
        for start, stop in [(0, 2), (2, 4)] if two else [(0, 4)]:
            part(out, key, start, stop, fixes=2)
        timing = {"seconds_per_step": 1e-6, "seconds_per_replication": 5e-6}
        timing |= {"replications": 1, "steps": 5}
        entries[estimator] = {"key": key, "reps": 4, "steps": False, "timing": timing}
    config = {"scenario": {"name": "place"}, "noise": {"sigma_deg": 1.0, **parameters}}
    same = {"experiment": None, "scenario": "place", "noise": "normal", "seed": 1, "draws": "d"}
    config |= {"filter": {}, "estimator": {name: {} for name in estimators}, "seed": 1}
    rest = {"changed": {}, "swept": [], "plugins": [], "provenance": {}}
    write_record(out, {"cell": name, **same, "config": config, "estimators": entries, **rest})
