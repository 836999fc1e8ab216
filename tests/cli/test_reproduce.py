"""`aoabench reproduce` and `report` with --json and -q, on one small item."""

import json
from pathlib import Path

import pytest

from aoabench.studies import reproduce as reproducing

KEYS = {"schema", "results", "verdicts", "readings", "not_computed", "page"}


@pytest.fixture
def one_item(monkeypatch):
    """Only the study nurminen2018, to keep the page small."""
    monkeypatch.setattr(reproducing, "all_studies", lambda: ["nurminen2018"])


def strict(text):
    return json.loads(text, parse_constant=lambda name: 1 / 0)


def test_json_and_quiet(call, tmp_path, one_item):
    words = ["nurminen2018", "--only", "table1", "--results", tmp_path]
    status, out, err = call("reproduce", *words, "--json")
    assert status == 0, err
    found = strict(out)
    assert set(found) == {*KEYS, "scale", "items"}
    assert (found["schema"], found["scale"], found["results"]) == (1, "quick", str(tmp_path))
    (item,) = found["items"]
    assert (item["study"], item["item"]) == ("nurminen2018", "table1")
    assert Path(found["page"]).exists()
    assert {row["item"] for row in found["verdicts"]} == {"table1"}, "only what was asked"
    assert isinstance(found["verdicts"][0]["ours"], float)
    assert f"table1: {item['rows']} rows" in err, "progress goes to standard error"

    status, out, err = call("report", "--results", tmp_path, "--json", "-q")
    assert (status, err) == (0, "")
    drawn = strict(out)
    assert set(drawn) == KEYS
    by_item = {row["item"]: row for row in drawn["verdicts"]}
    assert by_item["fig4"]["ours"] is None, "not computed: NaN is null"
    assert [r for r in drawn["verdicts"] if r["item"] == "table1"] == found["verdicts"]
    assert call("report", "--results", tmp_path, "--quiet") == (0, "", "")
    status, out, _ = call("report", "--results", tmp_path)
    assert status == 0
    assert "claims that can fail" in out
    assert "statements that can fail" in call("report", "--results", tmp_path, "--all")[1]


@pytest.mark.parametrize(("words", "fault"), [
    (["--decide", "--scale", "quick"], "--scale=quick: --decide adds"),
    (["--decide", "--fresh"], "--fresh: --decide adds"),
    (["--budget", "3"], "--budget=3: only with --decide"),
    (["--decide", "--budget", "0"], "--budget"),
])  # fmt: skip
def test_words_that_exclude_each_other_are_one_line(words, fault, call):
    status, out, err = call("reproduce", *words)
    assert status == 2
    assert fault in err
    assert "Traceback" not in err
