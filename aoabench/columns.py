"""The columns of every stored table: names and types."""

from __future__ import annotations

REPLICATIONS = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "rmse_3d_m": "double",
    "rmse_xy_m": "double",
    "rmse_z_m": "double",
    "outcome": "string",
    "n_fixes": "int64",
    "n_ok": "int64",
    "n_diverged": "int64",
    "n_oscillated": "int64",
    "n_failed": "int64",
    "n_rejected": "int64",
    "iterations": "double",
    "nees": "double",
}


STEPS = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "step": "int64",
    "x_m": "double",
    "y_m": "double",
    "z_m": "double",
    "error_3d_m": "double",
    "error_xy_m": "double",
    "error_z_m": "double",
    "outcome": "string",
}


FIXES = {
    "replication": "int64",
    "error_3d_m": "floats",
    "error_xy_m": "floats",
    "iterations": "floats",
    "score": "floats",
    "anchors_used": "floats",
    "outcome": "bytes",
    "place": "ints",
}


PART_FAILURES = {"replication": "int64", "error": "string", "lost": "bool"}


# tables of a part: rows always; failures only where an estimator raised or gave NaN
KINDS = {"rows": REPLICATIONS, "steps": STEPS, "fixes": FIXES, "failures": PART_FAILURES}


IDENTITY = ("cell", "experiment", "scenario", "noise", "estimator")


TIMING = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "seconds_per_step": "double",
    "seconds_per_replication": "double",
    "replications": "int64",
    "steps": "int64",
}


FAILURES = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "replication": "int64",
    "outcome": "string",
    "n_failed": "int64",
    "n_fixes": "int64",
    "error": "string",
    "replay": "string",
}


PRECISION = {
    "cell": "string",
    "experiment": "string",
    "scenario": "string",
    "noise": "string",
    "estimator": "string",
    "metric": "string",
    "replications": "int64",
    "mean": "double",
    "se": "double",
    "relative_se": "double",
    "wanted_se": "double",
    "wanted_relative_se": "double",
    "reached": "bool",
}
