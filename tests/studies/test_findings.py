"""What was found: sentences filled from the tables, on the page and in README.md."""

import math
import re
from pathlib import Path

import pandas as pd
import pytest

from aoabench.errors import UserError
from aoabench.maths.estimate import Estimate
from aoabench.store.files import write_frame
from aoabench.studies import findings, reproduce, statements, study
from aoabench.studies.places import Places

ROOT = Path(__file__).parents[2]
VALUES = {
    "fig4/0.5/a_b": (Estimate(2.7512, 0.01), 10.0),
    "lost": (Estimate(math.nan, math.nan), math.nan),
}


def test_a_sentence_takes_value_interval_and_standard_error_by_id():
    low, high = VALUES["fig4/0.5/a_b"][0].interval()
    text = "up to {fig4/0.5/a_b:.2f} m [{fig4/0.5/a_b.low:.2f}, {fig4/0.5/a_b.high:.2f}], {fig4/0.5/a_b.se:.3f}\n  {fig4/0.5/a_b}"
    assert findings.filled(text, VALUES) == f"up to 2.75 m [{low:.2f}, {high:.2f}], 0.010 2.75"


def test_a_sentence_without_its_number_is_left_out():
    assert findings.filled("a {fig4/0.5/a_b} and {other:.1f}", VALUES) is None
    assert findings.filled("no number", VALUES) == "no number"


def test_a_format_that_is_none_is_one_line():
    with pytest.raises(UserError, match=r"finding: \{lost:.2q\}: no format"):
        findings.filled("{lost:.2q}", VALUES)


def test_the_overview_has_the_first_sentence_of_a_study_and_counts_the_claims(tmp_path):
    (tmp_path / "figures.py").write_text(
        "from aoabench.maths.statistics import Estimate\n"
        "def item_values(frame): return {'x': Estimate(frame['x'][0], 0.0)}\n"
    )
    items = (study.Item("item", "title", "caption"), study.Item("none", "title", "caption"))
    found = ("x is {x:.1f}.", "twice {x:.0f}.", "y is {y}.", "again {x:.0f}.")
    errata = ({"id": "A1"}, {"id": "A2"})
    mine = study.Study("mine", tmp_path, "", "", items, (), errata, findings=found)
    other = study.Study("other", tmp_path, "", "", (), (), (), findings=("{gone}",))
    write_frame(study.table_path(tmp_path, mine, items[0]), pd.DataFrame({"x": [1.25]}))
    claims = statements.verdicts([mine, other], tmp_path).claims
    first, last = findings.overview([mine, other], claims, tmp_path)
    assert first == ("mine", "x is 1.2.")
    values = {"x": (Estimate(1.25, 0.0), math.nan)}
    assert findings.further(mine, values) == "twice 1.", "the rest builds on what is missing"
    assert findings.further(other, values) == ""
    assert last[0] == ""
    assert last[1].startswith("Of 0 statements that can fail, 0 hold")
    assert last[1].endswith("; 2 errata of the papers, each with a test.")


def test_a_list_replaces_what_stands_between_the_marks(tmp_path):
    readme = tmp_path / "README.md"
    readme.write_text("a\n<!-- findings -->\n1. old\n2. old\n<!-- /findings -->\nb\n")
    findings.write_into(readme, [("mine", "new \\1"), ("", "next")])
    assert (
        readme.read_text()
        == "a\n<!-- findings -->\n1. `mine`: new \\1\n2. next\n<!-- /findings -->\nb\n"
    )


def test_readme_says_what_the_committed_tables_say():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.search(r"<!-- findings -->\n(.*?)\n<!-- /findings -->", text, re.DOTALL)[1]
    everything = [study.load(name) for name in study.names()]
    claims = statements.verdicts(everything, ROOT / "results").claims
    assert shown == findings.listed(findings.overview(everything, claims, ROOT / "results")), (
        "make report COMMIT=1 writes it again"
    )
    assert text.index("<!-- findings -->") < 1500, "on the first screen"


@pytest.mark.parametrize("name", study.names())
def test_every_number_of_a_finding_is_one_of_the_committed_tables(name):
    s = study.load(name)
    claims = statements.verdicts([s], ROOT / "results").claims
    texts = findings.overview([s], claims, ROOT / "results")
    assert len(texts) == 1 + bool(s.findings)
    assert not re.search(r"\bnan\b|\binf\b", " ".join(text for _, text in texts))
    for template in s.findings:
        assert "{" in template, "numbers are not typed"


def test_readme_is_written_with_commit_and_at_the_committed_places_only(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text("<!-- findings -->\nold\n<!-- /findings -->\n")
    monkeypatch.setattr(reproduce, "all_studies", lambda: ["le2021"])
    table = ROOT / "results" / "tables" / "le2021_fig5.parquet"
    for folder in ("results", "mine"):
        (tmp_path / folder / "tables").mkdir(parents=True)
        (tmp_path / folder / "tables" / table.name).write_bytes(table.read_bytes())
    from aoabench.studies.places import of_report

    monkeypatch.delenv("COMMIT", raising=False)
    reproduce.draw(["le2021"], of_report("paper"), lambda _: None)
    assert "old" in readme.read_text()
    monkeypatch.setenv("COMMIT", "1")
    reproduce.draw(["le2021"], Places.inside(tmp_path / "mine"), lambda _: None)
    assert "old" in readme.read_text()
    reproduce.draw(["le2021"], of_report("paper"), lambda _: None)
    assert "1. Of" in readme.read_text()
