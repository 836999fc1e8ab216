"""`aoabench replay`: its words; what it computes is tested with the engine."""

import json


def test_mistakes_and_a_replay(call, small_run):
    words = ["replay", small_run, "--replication", 2, "--estimator"]
    status, out, err = call(*words, "ekf_vmf")
    assert (status, out) == (2, "")
    assert "--cell: this run has several" in err
    cell = json.loads(next((small_run / "cells").glob("*.json")).read_text())["cell"]
    status, _, err = call(*words, "ekf_vfm", "--cell", cell)
    assert status == 2
    assert "did you mean 'ekf_vmf'" in err
    status, _, err = call(*words, "ekf_vmf", "--cell", cell, "--plugins", "os; rm")
    assert status == 2
    assert "plugins='os; rm'" in err
    status, _, err = call(*words, "ekf_vmf", "--cell", cell, "plugins=[no_such_package]")
    assert status == 2
    assert "plugins=[no_such_package]: cannot be imported" in err
    status, _, err = call(*words, "ekf_vmf", "--cell", cell, "noise=vmf")
    assert status == 2
    assert "noise=vmf: replay repeats the run as it was; allowed: plugins=[...]" in err
    status, out, err = call(*words, "ekf_vmf", "--cell", cell, "plugins=[]", "-q")
    assert (status, err) == (0, "")
    assert "(as stored)" in out
