"""The columns of every stored table: names and types.

What is not known is NaN in a column of numbers and null in one of strings. A `reason` is the name
of a types.Reason in lower case, "" where nothing needs one, and null in tables of schema 1.
"""

from __future__ import annotations

import re

# Version of the tables, in the metadata of each file; a file without one has version 1, whose
# tables lack times, reasons, n_unmeasured, imprecise, standard deviations and intervals.
SCHEMA = 2

_UNITS = {f"_{unit}": unit for unit in ("m", "s", "ns", "deg", "rad")}
_UNITS |= {"_m_s": "m/s", "_m2": "m^2", "_db": "dB", "_dbm": "dBm"}
_UNITS |= {"_hz": "Hz", "_khz": "kHz", "_ghz": "GHz"}

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


TABLES = {
    "replications": REPLICATIONS,
    "steps": STEPS,
    "summary": SUMMARY,
    "timing": TIMING,
    "failures": FAILURES,
    "precision": PRECISION,
}


MEANINGS = {
    "cell": "id of scenario, noise, seed and their parameters",
    "experiment": "preset of the experiment, empty without one",
    "scenario": "preset of the scenario",
    "noise": "preset of the noise",
    "estimator": "name of the filter or estimator",
    "replication": "number of the replication, from 0",
    "step": "number of the step or fix in its replication, from 0",
    "rmse_3d_m": "root mean square error over the fixes that have a position, in space",
    "rmse_xy_m": "the same in the plane",
    "rmse_z_m": "the same in height; NaN for methods in the plane",
    "outcome": "ok, oscillated, rejected, diverged or failed; of a replication the worst of its "
    "fixes, of a recorded track the commonest",
    "n_fixes": "fixes",
    "iterations": "mean iterations per fix",
    "nees": "normalised estimation error squared, mean over fixes; 3 for a consistent filter",
    "n_unmeasured": "fixes without an azimuth, elevation or delay of any anchor",
    "n_imprecise": "fixes whose reported deviation exceeds the extent of the anchors",
    "reason": "commonest reason of the fixes that are not ok",
    "tag": "tag of the recorded track; null where simulated",
    "x_m": "estimated position, x",
    "y_m": "estimated position, y",
    "z_m": "estimated position, z",
    "error_3d_m": "distance from the true position",
    "error_xy_m": "distance in the plane",
    "error_z_m": "estimated less true height",
    "time_s": "time of the fix",
    "fix": "name or number of the recorded fix",
    "imprecise": "whether the reported deviation exceeds the extent of the anchors",
    "anchors_used": "anchors that the fix uses",
    "score": "the method's own measure of how well the measurements agree",
    "replications": "replications that the row covers",
    "largest_share": "share of the sum of squared errors of the largest replication or position",
    "heavy_tail": "whether largest_share is too large for intervals of RMSE to hold",
    "failure_rate": "share of replications with a failed or diverged fix",
    "nees_mean": "mean NEES over the replications",
    "iterations_mean": "mean iterations per fix over the replications",
    "share_unmeasured": "share of fixes without any measurement",
    "share_imprecise": "share of fixes whose reported deviation exceeds the extent of the anchors",
    "share_reason": "share of all fixes that have this reason",
    "availability": "share of fixes that are ok",
    "se_by": "what standard errors are clustered by: replication or position",
    "causal": "false for a smoother, whose fixes use later measurements too",
    "seconds_per_step": "time of the estimator per step, measured serially",
    "seconds_per_replication": "time of the estimator per replication",
    "steps": "steps of a replication",
    "sentence": "the reason in words",
    "error": "exception, or NaN that was not declared",
    "replay": "command that repeats the replication",
    "metric": "column whose mean has to be precise",
    "mean": "mean of the metric over the replications",
    "se": "its standard error",
    "relative_se": "the standard error as a fraction of the mean",
    "wanted_se": "until.se",
    "wanted_relative_se": "until.relative_se",
    "reached": "whether the precision was reached",
}
_PATTERNS = {
    r"n_(\w+)": "fixes that are {}",
    r"share_(\w+)": "share of fixes that are {}",
    r"sigma_(.)_m": "reported standard deviation in {}",
    r"cov_(..)_m2": "reported covariance, element {}",
    r"rmse_pooled_(\w+)_m": "root mean square error over all fixes, {}",
    r"rmse_mean_(\w+)_m": "mean of the replications' RMSE, {}",
    r"rmse_q(\d+)_3d_m": "{} % quantile of the replications' RMSE in space",
    r"cep(\d+)_m": "error in the plane that {} % of the fixes do not exceed",
    r"error_z_q(\d+)_m": "error in height, without sign, that {} % of the fixes do not exceed",
    r"p_within_(\d+)m": "share of fixes with an error in the plane of at most {} m",
    r"(\w+)_se": "standard error of {}",
    r"(\w+)_low": "lower end of the 95 % interval of {}",
    r"(\w+)_high": "upper end of the 95 % interval of {}",
}


def meaning(column: str) -> str:
    """The meaning of a column of a stored table in words; KeyError for an unknown column."""
    if column in MEANINGS:
        return MEANINGS[column]
    for pattern, text in _PATTERNS.items():
        if found := re.fullmatch(pattern, column):
            return text.format(found[1])
    raise KeyError(column)


def unit_of(name: str) -> str:
    """The unit that the name of a column or parameter states: "m", "deg", "s" ...; "" if none."""
    if name.startswith("seconds_"):
        return "s"
    ends = [end for end in _UNITS if name.endswith(end)]
    return _UNITS[max(ends, key=len)] if ends else ""
