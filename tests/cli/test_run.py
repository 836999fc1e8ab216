"""`aoabench run`: words, help, what is printed and where, names of files."""

import json

import pytest

from .conftest import SMALL

ANCHORS = "id,x_m,y_m,z_m\na,0,0,2.5\nb,6,0,2.5\nc,3,5,2.5\n"
LOG = "fix,anchor,azimuth_deg,elevation_deg\n1,a,46,-27\n1,b,152,-19\n1,c,-110,-26\n"
TRUTH = LOG.replace("deg\n", "deg,x_m,y_m,z_m\n").replace("7\n", "7,2,2,1\n")
TRUTH = TRUTH.replace("9\n", "9,2,2,1\n").replace("6\n", "6,2,2,1\n")
RECORDED = ["scenario=recorded", "estimator=[ls_lines]", "runner.n_jobs=1"]
ODD = 'my log (1), ä=b [2] {c} it\'s "x" & $y #z.csv'


def test_help_shows_presets_and_the_default_config(call, tmp_path):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "mine_alone.yaml").write_text("# Mine\n")
    status, out, _ = call("run", "--help")
    assert status == 0
    flat = " ".join(out.split())
    assert "experiment: boquet2024_methods, le2021_errata" in flat
    assert "\n  reps: 100\n" in out
    assert "_target_: aoabench.scenarios.square_track.SquareTrack" in out
    assert "mine_alone" not in out
    assert "mine_alone" in call("run", "--config-dir", tmp_path, "--help")[1]
    assert "mine_alone" in call("run", "-h", "-cd", tmp_path)[1]


@pytest.mark.parametrize(("word", "hint"), [
    ("noise:vmf", "did you mean 'noise=vmf'?"),
    ("ekf_vmf", "did you mean 'filter=[ekf_vmf]'?"),
    ("ekf_vfm", "did you mean 'filter=[ekf_vmf]'?"),
    ("vmf", "did you mean 'noise=vmf'?"),
    ("reps", "did you mean 'reps=...'?"),
    ("worst", "did you mean '--worst'?"),
    ("quiet", "did you mean '--quiet'?"),
    ("qqqqq", "allowed: KEY=VALUE, GROUP=NAME, ~KEY"),
])  # fmt: skip
def test_a_word_that_is_no_override_is_refused(word, hint, call):
    status, out, err = call("run", *SMALL, word)
    assert (status, out) == (2, "")
    assert err.startswith(f"aoabench: {word!r} is not an override")
    assert hint in err
    assert len(err.splitlines()) == 1


def test_the_text_of_a_run(call, tmp_path):
    out = tmp_path / "out"
    status, text, err = call("run", *SMALL, f"runner.out={out}")
    assert (status, err) == (0, "")
    assert text.startswith("1 cell: 3 replications x estimators computed, 0 reused, ")
    assert f"aoabench.load('{out}')" in text
    assert "steps" not in text
    assert "\x1b" not in text + err
    again = call("run", *SMALL, "store.steps=true", f"runner.out={out}")[1]
    assert ",timing,steps}.parquet" in again


@pytest.fixture
def recording(tmp_path, monkeypatch):
    """The words that choose a recording in the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(ANCHORS)
    (tmp_path / "l.csv").write_text(LOG)
    return [*RECORDED, "scenario.path=l.csv", "scenario.anchors=a.csv"]


def test_quiet_prints_errors_only(call, tmp_path):
    out = f"runner.out={tmp_path / 'out'}"
    assert call("run", "-q", *SMALL, out) == (0, "", "")
    status, text, err = call("run", "-q", *SMALL, "reps=0", out)
    assert (status, text) == (2, "")
    assert err.startswith("aoabench: reps=0 ")
    status, text, err = call("run", "-q", *SMALL, out, "--worst", "1")
    assert (status, err) == (0, "")
    assert text.startswith("the 1 worst replications"), "that was asked for"


def test_quiet_keeps_remarks_away_too(call, recording):
    assert "noise is not used" in call("run", *recording, "noise.sigma_deg=3")[2]
    assert call("run", "--quiet", *recording, "noise.sigma_deg=3") == (0, "", "")


def strict(text):
    """The object in `text`, which must be strict JSON."""

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_json(call, tmp_path):
    out = tmp_path / "out"
    words = ["-m", "noise.sigma_deg=3,5", *SMALL, f"runner.out={out}", "--worst", "2", "--json"]
    status, text, _ = call("run", *words)
    found = strict(text)
    assert status == 0
    assert next(iter(found)) == "schema"
    assert found["schema"] == 1
    assert found["out"] == str(out)
    assert (found["computed"], found["reused"]) == (6, 0)
    assert {cell["cell"] for cell in found["cells"]} == {row["cell"] for row in found["summary"]}
    assert sorted(row["noise.sigma_deg"] for row in found["summary"]) == [3, 5]
    for row in found["summary"]:
        assert row["replications"] == 3
        assert row["rmse_pooled_3d_m"] > 0
        assert row["iterations_mean"] is None, "a Kalman filter does not iterate: NaN is null"
    assert found["cells"][0]["config"]["filter"]["ekf_vmf"]["engine"] == "numpy"
    assert [row["replay"].split()[:2] for row in found["worst"]] == [["aoabench", "replay"]] * 2
    assert found["notes"] == found["figures"] == found["precision"] == found["damaged"] == []
    assert found["errors"] == {"replications": 0, "first": None}


def test_json_and_text_show_the_same_numbers(call, tmp_path):
    words = [*SMALL, f"runner.out={tmp_path}"]
    (row,) = strict(call("run", *words, "--json")[1])["summary"]
    text = call("run", *words)[1]
    assert f"{row['rmse_pooled_3d_m']:.4g} ± {row['rmse_pooled_3d_m_se']:.1g}" in text


def test_json_of_a_recording(call, recording, tmp_path):
    """Remarks go to standard error, too; with -q into the object alone."""
    (tmp_path / "l.csv").write_text(TRUTH)
    status, text, err = call("run", *recording, "--json")
    assert status == 0
    found = strict(text)
    assert found["notes"] == err.splitlines()
    assert len(found["notes"]) == 1
    assert found["figures"]
    assert all(path.endswith(".png") for path in found["figures"])
    status, quiet, err = call("run", *recording, "--json", "-q")
    assert (status, err) == (0, "")
    assert strict(quiet)["notes"] == found["notes"]


def test_json_without_ground_truth_has_null(call, recording):
    found = strict(call("run", *recording, "--json")[1])
    assert found["summary"][0]["rmse_pooled_3d_m"] is None


def test_of_a_mistake_json_prints_nothing(call):
    status, out, err = call("run", "--json", "filter=[ekf_vmf]", "reps=0")
    assert (status, out) == (2, "")
    assert err.startswith("aoabench: reps=0")


def test_names_of_files_need_the_shells_quotes_only(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / f"anchors {ODD}").write_text(ANCHORS)
    (tmp_path / ODD).write_text(LOG)
    words = [*RECORDED, f"scenario.path={ODD}", f"scenario.anchors=anchors {ODD}"]
    status, text, err = call("run", *words, f"runner.out=out {ODD}", "--json")
    assert status == 0, err
    found = strict(text)
    assert found["out"] == f"out {ODD}"
    assert found["cells"][0]["config"]["scenario"]["path"] == ODD
    assert found["summary"][0]["share_ok"] == 1


def test_a_sweep_over_names_of_files(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = ["plain.csv", "my log (1) ä=b.csv", "with, comma.csv"]
    (tmp_path / "it's.csv").write_text(ANCHORS)
    for name in names:
        (tmp_path / name).write_text(LOG)
    swept = f'scenario.path={names[0]},{names[1]},"{names[2]}"'
    status, text, err = call("run", "-m", *RECORDED, swept, "scenario.anchors=it's.csv", "--json")
    assert status == 0, err
    found = strict(text)
    assert sorted(cell["config"]["scenario"]["path"] for cell in found["cells"]) == sorted(names)
    assert sorted(row["scenario.path"] for row in found["summary"]) == sorted(names)


def test_a_file_that_is_not_there_is_named_as_it_was_typed(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(ANCHORS)
    words = ["scenario=recorded", "scenario.path=no (1), ä.csv", "scenario.anchors=a.csv"]
    status, _, err = call("run", *words, "estimator=[ls_lines]")
    assert status == 2
    assert "scenario.path='no (1), ä.csv'" in err


def test_redirected_output_is_plain_text(tmp_path, monkeypatch, capfd):
    """Also where FORCE_COLOR makes rich take a file for a terminal."""
    from aoabench.cli.main import main

    monkeypatch.setenv("FORCE_COLOR", "1")
    with pytest.raises(SystemExit) as stop:
        main(["run", *SMALL, f"runner.out={tmp_path}"])
    assert stop.value.code == 0
    out, err = capfd.readouterr()
    assert err == ""
    assert not {"\x1b", "\r"} & set(out)
