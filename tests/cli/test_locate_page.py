"""docs/reference/locate.md: its examples run, its columns and options are those of the command."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from aoabench.cli.locate import locate
from aoabench.deployment import fixes
from tests.deployment.conftest import POINTS, log, room, rows_of  # noqa: F401

PAGE = (Path(__file__).parents[2] / "docs/reference/locate.md").read_text(encoding="utf-8")
EXAMPLES = re.search(r"```sh\n(.*?)```", PAGE, re.DOTALL)[1].splitlines()


def first_cells(title):
    """The names in the first cells of the table under a title."""
    part = PAGE.partition(f"## {title}\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return [name.split()[0] for row in rows for name in re.findall(r"`([^`]+)`", row)]


def test_every_column_and_option_is_on_the_page():
    assert first_cells("Columns") == [*fixes.COLUMNS, *fixes.OF_TRUTH]
    options = [name for one in locate.params for name in one.opts if name.startswith("-")]
    assert sorted(first_cells("Options")) == sorted(set(options) - {"--help", "-h"})


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_examples_run(room, log, example):  # noqa: F811
    log(rows_of(POINTS.repeat(3, axis=0), "T1"), "time_s,tag,anchor,azimuth_deg,elevation_deg")
    command = example.replace("aoabench ", f"{sys.executable} -m aoabench.cli ")
    done = subprocess.run(command, shell=True, cwd=room, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if "geojson" in example:
        found = json.loads((room / "track.geojson").read_text())["features"]
        outcomes = [feature["properties"]["outcome"] for feature in found]
    else:
        name = "fixes.csv" if ">" in example else "log-fixes.csv"
        outcomes = pd.read_csv(room / name)["outcome"].tolist()
    assert len(EXAMPLES) == 3
    assert outcomes == ["ok"] * 12
