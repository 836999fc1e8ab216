"""The text that `aoabench run` prints about a finished run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any


def print_run(done: Any, cells: Sequence[Any]) -> None:
    import pandas as pd

    out = done.out
    rate = f", {done.computed / done.seconds:,.0f}/s" if done.computed else ""
    print(
        f"{len({c.id for c in cells})} cells: {done.computed} replications x estimators computed, "
        f"{done.reused} reused, {done.seconds:.1f} s{rate}"
    )
    summary = pd.read_parquet(out / "summary.parquet")
    asked = {(c.id, name) for c in cells for name in c.estimators}
    mine = summary[[pair in asked for pair in zip(summary["cell"], summary["estimator"])]]
    table = pd.read_parquet(out / "cells.parquet")
    extra = [
        c
        for c in table.columns
        if c not in ("experiment", "scenario", "noise", "seed", "estimators", "config")
    ]
    mine = mine.merge(table[extra], on="cell")
    swept = [c for c in extra if c != "cell" and mine[c].nunique(dropna=False) > 1]
    shown = mine[["scenario", "noise", *swept, "estimator", "replications"]].copy()
    for name, title in (("rmse_pooled_3d_m", "RMSE 3-D [m]"), ("rmse_pooled_xy_m", "RMSE xy [m]")):
        shown[title] = [f"{v:.4g} ± {s:.1g}" for v, s in zip(mine[name], mine[f"{name}_se"])]
    shown["failed"] = [f"{v:.1%}" for v in mine["failure_rate"]]
    shown["fixes ok"] = [f"{v:.2%}" for v in mine["share_ok"]]
    print(shown.to_string(index=False, max_rows=60))
    failures = pd.read_parquet(out / "failures.parquet")
    told = failures.loc[
        [pair in asked for pair in zip(failures["cell"], failures["estimator"])], "error"
    ].dropna()
    if len(told):
        print(
            f"exceptions and NaN in {len(told)} replications, e.g. {told.iloc[0]}; "
            f"see {out}/failures.parquet"
        )
    if done.precision:
        _print_precision(done.precision)
    print(
        f"tables: {out}/{{tidy,replications,cells,summary,timing}}.parquet    "
        f"in Python: aoabench.load({str(out)!r})"
    )


def _print_precision(rows: Sequence[Any]) -> None:
    """What was asked for with until.*, and what was reached."""
    first, short = rows[0], [row for row in rows if not row["reached"]]
    wanted = [f"{first['wanted_se']:g}"] if first["wanted_se"] else []
    wanted += (
        [f"{first['wanted_relative_se']:.3g} of the mean"] if first["wanted_relative_se"] else []
    )
    print(
        f"{first['metric']} until its standard error is at most {' and '.join(wanted)}: reached by "
        f"{len(rows) - len(short)} of {len(rows)} (precision.parquet)"
    )
    for row in short[:20]:
        print(
            f"  not reached: cell {row['cell']} {row['estimator']}: {row['mean']:.4g} "
            f"± {row['se']:.2g} after {row['replications']} replications"
        )


def print_worst(out: Path, cells: Sequence[Any], n: int) -> None:
    """The worst replications: those without a position first, then by their RMSE; how many medians
    that is.
    """
    from aoabench.store import folder, tables

    frame = tables.load(out)
    asked = {(c.id, name) for c in cells for name in c.estimators}
    frame = frame[[pair in asked for pair in zip(frame["cell"], frame["estimator"])]]
    median = frame.groupby(["cell", "estimator"])["rmse_3d_m"].transform("median")
    frame = frame.assign(times=frame["rmse_3d_m"] / median)
    worst = frame.sort_values(
        "rmse_3d_m", ascending=False, na_position="first", kind="stable"
    ).head(n)
    by_id = {c.id: c for c in cells}
    print(f"the {len(worst)} worst replications, by RMSE 3-D:")
    for row in worst.to_dict("records"):
        cell = by_id[row["cell"]]
        error = (
            "no position" if row["rmse_3d_m"] != row["rmse_3d_m"] else f"{row['rmse_3d_m']:.4g} m"
        )
        times = (
            f", {row['times']:.3g} times its estimator's median"
            if row["times"] == row["times"]
            else ""
        )
        print(
            f"  {row['noise']} {row['estimator']} replication {row['replication']}: "
            f"{error}{times}, {row['outcome']}"
        )
        again = folder.replay_command(
            out, row["cell"], row["estimator"], row["replication"], cell.config, cell.plugins
        )
        print(f"    {again}")
