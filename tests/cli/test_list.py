"""`aoabench list`."""

import json
import shlex

import pytest
import yaml

from aoabench.cli.common import wrapped
from aoabench.config import about, catalogue, compose
from aoabench.config.compose import compose_cells
from aoabench.config.presets import GROUPS, options
from aoabench.maths.digest import flatten


def test_groups_and_presets(call, tmp_path):
    status, out, err = call("list")
    assert (status, err) == (0, "")
    assert [line[:-1] for line in out.splitlines() if not line.startswith(" ")] == list(GROUPS)
    assert call("list", "-q") == (0, out, ""), "the list is what was asked for"
    assert call("list", "runner")[1].splitlines()[0] == "runner:"
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "mine.yaml").write_text("# My noise\n")
    assert f"My noise (in {tmp_path})\n" in call("list", "noise", "--config-dir", tmp_path)[1]
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


def test_a_preset_with_source_needs_and_an_example_that_runs(call):
    status, out, err = call("list", "wcg", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert found["source"] == "Lu 2019, (12)-(14)"
    assert found["needs"] == ["delay", "elevation", "stated_sigma"]
    assert found["not_in_all"] == ""
    words = shlex.split(found["example"])
    assert list(compose_cells(words[2:])[0].estimators) == ["wcg"]
    text = call("list", "wcg")[1]
    assert "needs: a noise that measures times of arrival" in text
    assert about.about("vmf").offers == ["elevation", "stated_sigma"]
    for name, why in (("map_smoother", "a smoother"), ("wcg_as_printed", "a variant of wcg")):
        assert about.about(name).not_in_all.startswith(why)
        assert (
            f"not in {'filter' if name == 'map_smoother' else 'estimator'}=all: {why}"
            in call("list", name)[1]
        )
    assert "scenario.path=..." in call("list", "recorded")[1], "what it cannot be built without"
    assert "experiment=leaderboard_bs_grid" in call("list", "leaderboard_bs_grid")[1]


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("ekf_vmf", "Nurminen 2018, Alg. 2"),
        ("ekf_aoa", "Lu 2019, (15)-(26)"),  # over two lines in the module
        ("vmf_ml", "Nurminen 2018, (5); Boquet 2024, M_vMF"),
        ("ekf_vmf_smoother", "Rauch, Tung and Striebel 1965"),
        ("recorded", "aoabench/scenarios/recorded.py"),
    ],
)
def test_a_source_is_a_paper_or_a_file(name, source):
    assert about.about(name).source == source


def test_a_preset_says_what_runs_with_it(call):
    """It says the same as --fits and as the check before a run."""
    places = {name: catalogue.fitting(name) for name in ("ble_room", "indoor_map", "square_track")}
    for group, name in (("estimator", "wcg"), ("filter", "ekf_ae_fitted"), ("filter", "ekf_vmf")):
        found = json.loads(call("list", name, "--json")[1])["fits"]
        for scenario, whole in places.items():
            assert found.get(scenario) == whole[group].get(name)
    found = json.loads(call("list", "ble_room", "--json")[1])["fits"]
    assert found == {"estimator": list(places["ble_room"]["estimator"])}
    found = json.loads(call("list", "ofdm_crlb", "--json")[1])["fits"]
    for scenario, whole in places.items():
        some = any("ofdm_crlb" in noises for names in whole.values() for noises in names.values())
        assert (scenario in found["scenario"]) == some
    text = call("list", "ekf_ae_fitted")[1]
    assert "square_track_upright,track noise=ae_flip,ae_normal,vmf" in text
    assert "runs with" not in call("list", "recorded")[1]
    assert "runs with" not in call("list", "slurm")[1]


def test_a_parameter_with_meaning_unit_and_range(call):
    out = call("list", "ekf_vmf")[1]
    line = next(line for line in out.splitlines() if "measurement.unstated_deg" in line)
    assert line.split()[0] == "filter.ekf_vmf.measurement.unstated_deg"
    assert "[deg]; 2 finite numbers > 0 and <= 180" in line


def test_keys_by_their_names(call):
    status, out, err = call("list", "noise.sigma_deg")
    assert (status, err) == (0, "")
    assert [s for s in out.splitlines() if not s.startswith(" ")] == [
        "ae_flip:",
        "ae_normal:",
        "vmf:",
    ]
    out = call("list", "until")[1]
    assert [line.split()[0] for line in out.splitlines()] == [
        f"until.{k}" for k in ("metric", "se", "relative_se", "min_reps", "max_reps")
    ]
    assert "standard error of the mean to reach" in call("list", "until.se")[1]
    found = json.loads(call("list", "runner.n_jobs", "--json")[1])
    assert [(p["key"], p["value"]) for p in found["parameters"]] == [("runner.n_jobs", -1)]
    assert call("list", "local")[1].count("  runner.") == 10
    assert call("list", "filter.ekf_vmf.engine")[1].startswith("ekf_vmf:\n")
    status, _, err = call("list", "noise.sigma_dg")
    assert (status, err) == (
        2,
        "aoabench: 'noise.sigma_dg': no such key; did you mean 'noise.sigma_deg'?\n",
    )


def test_every_key_of_a_run_has_its_default_and_a_meaning():
    """The comments of the files are the text, so that a new key needs one."""
    config = yaml.safe_load(compose.show([]))
    shown = {p.key: p for p in about.run_keys()}
    nodes = {key: config[key] for key in ("reps", "seed", "plugins", "store", "until", "runner")}
    assert {key: p.value for key, p in shown.items()} == dict(flatten(nodes))
    assert all(p.help for key, p in shown.items() if not key.startswith("runner.tls_"))


def test_lines_wrap_in_a_terminal_alone(monkeypatch):
    line = "  name   " + "word " * 40
    assert wrapped(line, 9) == line
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    lines = wrapped(line, 9).splitlines()
    assert len(lines) > 3
    assert max(map(len, lines)) <= 60
    assert all(one.startswith(" " * 9 + "word") for one in lines[1:])


def test_the_example_of_a_cluster_names_its_scheduler(call):
    for name in ("dask", "slurm"):
        assert f"runner={name} runner.address=tcp://HOST:PORT" in call("list", name)[1]
    assert "runner.address" not in call("list", "local")[1].partition("example:")[2].split("\n")[0]


def test_presets_of_ones_own_fit_too(call, tmp_path, monkeypatch):
    """With `plugins`, before or behind a name, and a package that is not named is passed over."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for role, name in (("noise", "listed_noise"), ("estimator", "listed_estimator")):
        assert call("new", role, name)[0] == 0
    own = ("--config-dir", "conf", "plugins=[listed_noise,listed_estimator]")
    found = json.loads(call("list", "--fits", "bs_grid", "--json", *own)[1])["fits"]
    assert "listed_noise" in found["estimator"]["ls"]
    assert found["estimator"]["listed_estimator"] == found["estimator"]["ls"]
    fits = json.loads(call("list", "listed_estimator", "--json", *own)[1])["fits"]
    assert fits["bs_grid"] == found["estimator"]["ls"]
    some = ("--config-dir", "conf", "plugins=[listed_estimator]")
    fits = json.loads(call("list", "listed_estimator", "--json", *some)[1])["fits"]
    assert fits["bs_grid"] == [n for n in found["estimator"]["ls"] if n != "listed_noise"]


def test_words_other_than_plugins_are_refused(call):
    for words in (("noise=vmf",), ("ls", "reps=2")):
        status, out, err = call("list", *words)
        assert (status, out) == (2, "")
        assert f"{words[-1]}: not allowed here" in err
