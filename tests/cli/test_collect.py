"""`aoabench collect`."""

import json
from pathlib import Path


def test_text_quiet_and_json(call, small_run):
    status, out, err = call("collect", small_run)
    assert (status, err) == (0, "")
    assert out.startswith("2 cells: ")
    assert call("collect", small_run, "-q") == (0, "", "")
    assert call("-q", "collect", small_run) == (0, "", ""), "before the command, too"
    (small_run / "tidy.parquet").unlink()
    status, out, err = call("collect", small_run, "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert (found["schema"], found["run"], found["cells"]) == (1, str(small_run), 2)
    assert all(Path(path).exists() for path in found["tables"].values())
    assert "tidy" in found["tables"]
