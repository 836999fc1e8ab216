"""`aoabench list`."""

import json

from aoabench.config.presets import GROUPS, options


def test_groups_and_presets(call, tmp_path):
    status, out, err = call("list")
    assert (status, err) == (0, "")
    assert [line[:-1] for line in out.splitlines() if not line.startswith(" ")] == list(GROUPS)
    assert call("list", "-q") == (0, out, ""), "the list is what was asked for"
    assert call("list", "runner")[1].splitlines()[0] == "runner:"
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "mine.yaml").write_text("# My noise\n")
    assert "My noise" in call("list", "noise", "--config-dir", tmp_path)[1]
    assert call("list", "--config-dir", tmp_path / "no")[0] == 2


def test_json(call):
    status, out, err = call("list", "--json")
    assert (status, err) == (0, "")
    assert json.loads(out) == {"schema": 1, "groups": {group: options(group) for group in GROUPS}}
    found = json.loads(call("list", "noise", "--json")[1])
    assert found["groups"] == {"noise": options("noise")}


def test_what_fits_a_scenario_has_only_the_noises_that_each_method_takes(call):
    status, out, err = call("list", "--fits", "ble_room", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)["fits"]
    assert found["filter"] == {}, "campaigns are no tracks"
    assert found["estimator"]["wcg"] == ["ofdm_crlb"]
    assert set(found["estimator"]["discrepancy"]) == set(options("noise")) - {"recorded"}
    found = json.loads(call("list", "--fits", "indoor_map", "--json")[1])["fits"]
    assert found["filter"]["ekf_ae_adaptive"] == ["ae_flip", "ae_normal", "vmf"]
    assert "ble_multipath" in found["filter"]["ekf_vmf"]
