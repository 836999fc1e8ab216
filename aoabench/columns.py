"""The columns of every stored table: names and types.

What is not known is NaN in a column of numbers and null in one of strings. A `reason` is the name
of a types.Reason in lower case, "" where nothing needs one, and null in tables of schema 1.
"""

from __future__ import annotations

# Version of the tables, in the metadata of each file; a file without one has version 1, whose
# tables lack times, reasons, n_unmeasured, imprecise, standard deviations and intervals.
SCHEMA = 2

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
    "outcome": "string",  # the worst of the fixes'; of a recorded track the commonest
    "n_fixes": "int64",
    "n_ok": "int64",
    "n_diverged": "int64",
    "n_oscillated": "int64",
    "n_failed": "int64",
    "n_rejected": "int64",
    "iterations": "double",
    "nees": "double",
    "n_unmeasured": "int64",  # fixes without an azimuth, elevation or delay of any anchor
    "n_imprecise": "int64",  # see Inputs.imprecise
    "reason": "string",  # the commonest of the fixes that are not ok
    "tag": "string",  # of the recorded track, null where simulated or unknown
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
    "tag": "string",  # as recorded, null where simulated or unknown
    "time_s": "double",
    "fix": "string",  # as recorded, null where simulated
    "reason": "string",
    "n_unmeasured": "int64",  # 1 without an azimuth, elevation or delay of any anchor, else 0
    "imprecise": "bool",
    "anchors_used": "double",
    "score": "double",
    **{f"sigma_{axis}_m": "double" for axis in "xyz"},
    **{f"cov_{pair}_m2": "double" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")},
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
    "reason": "bytes",
    "imprecise": "bytes",
    "n_unmeasured": "bytes",
    **{f"sigma_{axis}_m": "floats" for axis in "xyz"},
}


PART_FAILURES = {"replication": "int64", "error": "string", "lost": "bool"}


# number `n` of a replication's fixes with an outcome that is not ok, and its reason
PART_REASONS = {"replication": "int64", "outcome": "string", "reason": "string", "n": "int64"}


# tables of a part: rows always; failures only where an estimator raised or gave NaN, reasons only
# where a fix is not ok
KINDS = {
    "rows": REPLICATIONS,
    "steps": STEPS,
    "fixes": FIXES,
    "failures": PART_FAILURES,
    "reasons": PART_REASONS,
}


IDENTITY = ("cell", "experiment", "scenario", "noise", "estimator")


def _with(ends: str, *names: str) -> dict[str, str]:
    """Columns of numbers NAME and NAME_END, for each name and each of the `ends`."""
    return {name + end: "double" for name in names for end in ("", *ends.split())}


_RMSE = [f"rmse_{which}_{axis}_m" for axis in ("3d", "xy", "z") for which in ("pooled", "mean")]
# quantiles over fixes, of the error in the plane and of |error_z|, with their probabilities
CEP = {f"cep{q}_m": q / 100 for q in (50, 67, 75, 80, 90, 95)}
ERROR_Z = {f"error_z_q{q}_m": q / 100 for q in (50, 67, 95)}
WITHIN_M = (1, 2, 5)  # p_within_1m is the share of fixes with an error in the plane of at most 1 m
# The swept parameters follow the identity. The ends of an interval at the level 0.95 are _low and
# _high. Quantiles of the replications' RMSE (rmse_q50_3d_m) have a standard error, and the median
# an interval between order statistics. CEP and what follows need every fix: positions that all
# replications share, or stored steps; availability, the share of fixes that are ok, does not.
# largest_share is the share of the sum of squared 3-D errors that the largest unit of `se_by`
# holds; heavy_tail says whether it exceeds maths.tails.usual_share.
SUMMARY = {
    **dict.fromkeys(IDENTITY, "string"),
    "replications": "int64",
    **_with("_se _low _high", *_RMSE),
    **_with("_se", *(f"rmse_q{q}_3d_m" for q in ("05", "25"))),
    **_with("_se _low _high", "rmse_q50_3d_m"),
    **_with("_se", *(f"rmse_q{q}_3d_m" for q in ("75", "95"))),
    "largest_share": "double",
    "heavy_tail": "bool",
    **_with("_se _low _high", "failure_rate"),  # of replications with a failed or diverged fix
    **_with("_se", "nees_mean", "iterations_mean"),
    **_with("", "share_ok", "share_rejected", "share_oscillated", "share_diverged"),  # of fixes
    **_with("", "share_failed", "share_unmeasured", "share_imprecise"),
    "reason": "string",  # the commonest of the fixes that are not ok
    "share_reason": "double",  # of all fixes
    **_with("_low _high", *CEP, *ERROR_Z),
    **_with("_low _high", *(f"p_within_{limit}m" for limit in WITHIN_M), "availability"),
    "se_by": "string",
    "causal": "bool",  # false for a smoother, whose fixes use later measurements too
}


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
    "reason": "string",  # the commonest of its failed fixes
    "sentence": "string",  # the reason in words
    "error": "string",  # of an exception or of NaN
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
