"""`aoabench compare`: text and JSON, quiet, a folder that cannot be written."""

import json
import math

import aoabench
from aoabench.report.comparison import lines


def test_json_holds_the_rows_of_the_table(call, small_run):
    status, out, err = call("compare", small_run, "--metric", "iterations", "--json")
    found = json.loads(out, parse_constant=lambda name: 1 / 0)
    assert (status, err) == (0, "")
    assert (found["schema"], found["run"], found["metric"]) == (1, str(small_run), "iterations")
    assert (found["comparisons"], found["left_out"]) == (0, {})
    table = aoabench.compare(small_run, metric="iterations")
    assert len(found["rows"]) == len(table) == 2
    for row, ours in zip(found["rows"], table.to_dict("records")):
        assert set(row) == set(ours)
        assert row["mean"] is None
        assert math.isnan(ours["mean"])
        assert row["text"] == ours["text"]


def test_quiet_prints_the_table_alone(call, small_run, monkeypatch):
    text = call("compare", small_run)[1]
    assert "ekf_ae_nominal" in text
    assert call("compare", small_run, "-q") == (0, text, "")

    def refuse(*_arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("aoabench.store.files.write_frame", refuse)
    assert "cannot be written" in call("compare", small_run)[2]
    assert call("compare", small_run, "-q") == (0, text, "")


def test_the_foot_explains_what_is_printed_alone(call, small_run):
    words = "detects it with probability 0.8"
    table = aoabench.compare(small_run)
    for verdict, printed in (("worse", False), ("no difference seen", True)):
        changed = table.assign(verdict=verdict, needed=300.0)
        changed.attrs = table.attrs
        assert (words in "\n".join(lines(changed))) == printed
