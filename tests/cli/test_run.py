"""`aoabench run`: words, help, what is printed and where, names of files."""

import json

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.cli.outcomes import not_ok, not_ok_text
from aoabench.report.text import interval_text
from aoabench.types import SENTENCES, Reason

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
    assert (
        "experiment: boquet2024_methods, boquet2024_readings, boquet2024_robust, le2021_errata"
        in flat
    )
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
    for name, title in (
        ("pooled_3d", "pooled RMSE 3-D"),
        ("mean_3d", "mean RMSE 3-D"),
        ("pooled_xy", "pooled RMSE xy"),
    ):
        assert interval_text(*(row[f"rmse_{name}_m{end}"] for end in ("", "_low", "_high"))) in text
        assert title in text
    assert "median RMSE 3-D" in text
    assert f"{row['rmse_q50_3d_m']:.4g} [0, inf]" in text, "three values bound no median"
    assert row["rmse_q50_3d_m_high"] is None, "JSON has no infinity"
    assert "95 % interval" in text
    assert "not ok" not in text
    mean = f"mean rmse_3d_m of ekf_vmf = {row['rmse_mean_3d_m']:.4g}"
    call("run", *words, "filter=[ekf_vmf,ekf_ae_nominal]")
    assert mean in call("compare", tmp_path, "--baseline", "ekf_vmf")[1], "the mean, in both"


@pytest.mark.parametrize(("three", "text"), [
    ((0.36682, 0.36011, 0.37346), "0.3668 [0.3601, 0.3735]"),
    ((12345.6, 11111.1, 13333.3), "12346 [11111, 13333]"),
    ((2.0, np.nan, np.nan), "2"),
    ((2.0, 2.0, 2.0), "2"),
    ((3e9, 1e9, 5e9), "3e+09 [1e+09, 5e+09]"),
    ((np.nan, np.nan, np.nan), "-"),
])  # fmt: skip
def test_a_number_with_its_interval(three, text):
    assert interval_text(*three) == text


def test_estimators_with_fixes_that_are_not_ok_name_the_commonest_reason(call, tmp_path):
    """Two anchors in one place: no plane or line method has a position; the filter has one."""
    words = [
        "scenario.anchors.position_m=[[0,0,0],[0,0,0]]",
        "scenario.anchors.facing=[[1,0,0],[1,0,0]]",
    ]
    words += [
        "filter=[ekf_vmf]",
        "estimator=[ls]",
        "reps=2",
        "runner.n_jobs=1",
        f"runner.out={tmp_path}",
    ]
    (found,) = strict(call("run", *words, "--json")[1])["not_ok"]
    assert (found["estimator"], found["share_not_ok"], found["share_failed"]) == ("ls", 1, 1)
    assert found["share_reason"] == 1
    assert found["sentence"] == SENTENCES[Reason[found["reason"].upper()]]
    text = call("run", *words)[1]
    assert f"  ls: 100 % failed: {found['sentence']}" in text
    assert "fixes failed" in text
    failed = pd.read_parquet(tmp_path / "failures.parquet")
    assert set(failed["sentence"]) == {found["sentence"]}


def test_shares_of_unmeasured_and_imprecise_fixes_are_shown_where_there_are_any(
    call, recording, tmp_path
):
    """The second of two fixes has no angle."""
    text = call("run", *recording)[1]
    assert "unmeasured" not in text
    assert "imprecise" not in text
    with (tmp_path / "l.csv").open("a") as log:
        log.write("2,a,,\n2,b,,\n")
    assert "fixes unmeasured" in call("run", *recording)[1]
    (row,) = strict(call("run", *recording, "--json")[1])["summary"]
    assert (row["share_unmeasured"], row["share_imprecise"]) == (0.5, 0)


def test_lines_of_fixes_that_are_not_ok():
    """The largest share first, at most 20 of them; a reason that is not the only one has its share."""
    rows = pd.DataFrame([
        {"cell": f"c{i}", "noise": "vmf", "estimator": "ls", "share_ok": 1 - 0.01 * i, "share_rejected": 0.004 * i,
         "share_failed": 0.006 * i, "share_oscillated": 0.0, "share_diverged": 0.0, "reason": "behind",
         "share_reason": 0.006 * i}
        for i in range(25)
    ])  # fmt: skip
    rows.loc[24, "reason"] = None  # a table of schema 1
    lines = list(not_ok_text(not_ok(rows), {f"c{i}": f"cell c{i}" for i in range(25)}))
    assert len(lines) == 22
    assert (
        lines[1]
        == "  cell c24 ls: 9.6 % rejected, 14.4 % failed: the tables of this run hold no reasons"
    )
    behind = "the position lies behind an anchor that it uses (13.8 %)"
    assert lines[2] == f"  cell c23 ls: 9.2 % rejected, 13.8 % failed: {behind}"
    assert lines[-1] == "  and 4 more, see reason in summary.parquet"
    assert list(not_ok_text(not_ok(rows[:1]), {})) == []


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


def test_fewer_replications_than_stored_are_remarked_once(call, tmp_path):
    words = ["run", "noise=vmf", "filter=[ekf_vmf]", "runner.n_jobs=1", f"runner.out={tmp_path}"]
    remark = "aoabench: the tables now show fewer replications than are stored; reps=4 shows all\n"
    assert [remark in call(*words, f"reps={n}")[2] for n in (4, 3, 3, 4)] == [0, 1, 0, 0]
    assert len(aoabench.load(tmp_path)) == 4
    assert remark not in call(*words, "reps=3", "noise.sigma_deg=5")[2], "another cell"
    assert remark in call(*words, "reps=2", "filter=[ekf_vmf,ukf_vmf]")[2]
