"""docs/reference/locate.md: its columns and options are those of the command."""

import re
from pathlib import Path

from aoabench.cli.locate import locate
from aoabench.deployment import fixes

PAGE = (Path(__file__).parents[2] / "docs/reference/locate.md").read_text(encoding="utf-8")


def first_cells(title):
    """The names in the first cells of the table under a title."""
    part = PAGE.partition(f"## {title}\n")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return [name.split()[0] for row in rows for name in re.findall(r"`([^`]+)`", row)]


def test_every_column_and_option_is_on_the_page():
    assert first_cells("Columns") == [*fixes.COLUMNS, *fixes.OF_TRUTH]
    options = [name for one in locate.params for name in one.opts if name.startswith("-")]
    assert sorted(first_cells("Options")) == sorted(set(options) - {"--help", "-h"})
