"""`make bench`: speed and memory to results/bench (a table and a figure) and into the README."""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aoabench.store.files import write_frame
from benchmarks import measures


def main() -> None:
    """Measure all or some, merge with what was measured before, and show it."""
    import pandas as pd

    names = [part.__name__ for part in measures.ALL]
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=measures.__doc__)
    parser.add_argument("--results", default="results", type=Path)
    parser.add_argument("--repeats", default=7, type=int)
    parser.add_argument(
        "--only", nargs="+", choices=names, default=names, metavar="PART", help=", ".join(names)
    )
    given = parser.parse_args()
    path = given.results / "bench" / "bench.parquet"
    frame = pd.read_parquet(path) if path.exists() else pd.DataFrame({"part": []})
    for part in measures.ALL:
        if part.__name__ in given.only:
            found = []
            for row in part(given.repeats):
                found.append({"part": part.__name__, **asdict(row)})
                print(
                    f"{row.what:34s} {row.detail:32s} {row.value:10.3f} {row.unit:5s} {row.target}",
                    flush=True,
                )
            others = frame[frame["part"].isin(set(names) - {part.__name__})]
            frame = pd.concat([others, pd.DataFrame(found)]) if len(others) else pd.DataFrame(found)
            frame = frame.sort_values(
                "part", key=lambda c: c.map(names.index), kind="stable", ignore_index=True
            )
            write_frame(path, frame)  # part by part: nothing measured is lost
    draw(frame, path.with_suffix(".png"))
    readme = Path("README.md")
    if readme.exists() and given.results == Path("results"):
        write_into(readme, markdown(frame))
    print(f"written to {path}")
    sys.exit(0)


def draw(frame: Any, path: Path) -> None:
    """Two panels on logarithmic axes: particle-steps and Kalman steps of each engine."""
    from aoabench.report import plots

    def make() -> Any:
        figure, axes = plots.new(plots.PAGE, 2.6, cols=2)
        panels = [
            ("particle-step", "ns per particle and step"),
            ("Kalman step", "µs per replication and step"),
        ]
        models = list(plots.LABELS)
        for axis, (what, label) in zip(axes, panels):
            part = frame[frame["what"].str.fullmatch(rf"{what}( in .*)?")]
            if not len(part):
                continue
            engines = list(dict.fromkeys(part["what"]))[::-1]
            for height, engine in enumerate(engines):
                for _, row in part[part["what"] == engine].iterrows():
                    key = re.sub(r"^(pf|ekf|ukf)_", "", row["detail"])
                    i = models.index(key) if key in models else models.index("ae_nominal")
                    marker = "s" if row["detail"].lower().startswith("ukf") else "o"
                    axis.plot(
                        row["value"],
                        height + 0.13 * (1.5 - i),
                        marker,
                        color=plots.COLOURS[models[i]],
                        markersize=4,
                    )
            names = [
                e.replace(what, "").removeprefix(" in ").replace("NumPy", "aoabench, NumPy")
                for e in engines
            ]
            axis.set_yticks(range(len(engines)), [name or "aoabench" for name in names])
            axis.set(xscale="log", xlabel=label, ylim=(-0.5, len(engines) - 0.5))
            axis.set_xlim(left=0.5 * part["value"].min())
            axis.grid(axis="x", which="major", linewidth=0.4)
        for key, label in plots.LABELS.items():
            axes[0].plot([], [], "o", color=plots.COLOURS[key], label=label)
        axes[0].legend(loc="upper right", fontsize=6)
        axes[1].plot([], [], "o", color=plots.GREY, label="EKF")
        axes[1].plot([], [], "s", color=plots.GREY, label="UKF")
        axes[1].legend(loc="upper right", fontsize=6)
        return figure

    plots.save(make, path)


def markdown(frame: Any) -> str:
    """The table for the README: all but what the ratios were made from."""
    frame = frame[~frame["what"].str.contains(" in ")]
    lines = ["| what | | measured | target | how |", "|---|---|---|---|---|"]
    for _, row in frame.iterrows():
        lines.append(
            f"| {row['what']} | {row['detail']} | {row['value']:.3g} {row['unit']} "
            f"| {row['target']} | {row['how']} |"
        )
    return "\n".join(lines)


def write_into(readme: Path, table: str) -> None:
    """Replace what lies between the two marks."""
    text = readme.read_text(encoding="utf-8")
    new = re.sub(
        r"(?s)(<!-- bench -->\n).*?(\n<!-- /bench -->)", lambda m: m[1] + table + m[2], text
    )
    readme.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
