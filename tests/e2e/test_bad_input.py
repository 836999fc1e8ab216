"""What is knowable before a run gets one clear line that names key, value and what is allowed, and
exit status 2.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from aoabench.cli.main import main

F = "filter=[ekf_vmf]"

CASES = [
    # overrides, words that the line must hold
    (["run"], ["filter", "must be given", "ekf_vmf"]),
    (["run", "filter=[ekf_vfm]"], ["ekf_vfm", "did you mean 'ekf_vmf'"]),
    (
        ["run", "filter=[ekf_vmf,ukf_ae_adaptve]"],
        ["ukf_ae_adaptve", "did you mean 'ukf_ae_adaptive'"],
    ),
    (["run", "estimator=[wcgg]", F], ["estimator", "wcgg"]),
    (["run", F, "noise=vfm"], ["noise", "vfm", "did you mean 'vmf'"]),
    (
        ["run", F, "scenario=square_trak"],
        ["scenario", "square_trak", "did you mean 'square_track'"],
    ),
    (
        ["run", F, "experiment=nurminen2018_frame"],
        ["nurminen2018_frame", "did you mean 'nurminen2018_frames'"],
    ),
    (["run", F, "runner=locl"], ["runner", "locl", "local"]),
    (["run", F, "noise.sigma=5"], ["noise.sigma", "did you mean 'noise.sigma_deg'"]),
    (["run", F, "nois=vmf"], ["nois", "did you mean 'noise'"]),
    (["run", F, "rep=5"], ["rep", "did you mean 'reps'"]),
    (["run", F, "+noise.sigma=5"], ["noise.sigma", "unknown key", "sigma_deg"]),
    (["run", F, "+colour=red"], ["colour", "unknown key"]),
    (["run", F, "+runner.jobs=2"], ["runner.jobs", "unknown key", "n_jobs"]),
    (["run", F, "+store.step=true"], ["store.step", "steps"]),
    (["run", F, "filter.ekf_vmf.measurement.kapa=3"], ["kapa", "did you mean", "kappa"]),
    (["run", F, "filter.ukf_vmf.lambda_=1"], ["ukf_vmf", "not selected"]),
    (["run", F, "+filter.ekf_vmf.lambda_=1"], ["filter.ekf_vmf.lambda_", "unknown key"]),
    (["run", F, "noise.sigma_deg=0"], ["noise.sigma_deg", "0", "> 0", "180"]),
    (["run", F, "noise.sigma_deg=-3"], ["noise.sigma_deg", "-3", "> 0"]),
    (["run", F, "noise.sigma_deg=181"], ["noise.sigma_deg", "181", "<= 180"]),
    (["run", F, "noise.sigma_deg=ten"], ["noise.sigma_deg", "ten", "number"]),
    (["run", F, "noise.sigma_deg=true"], ["noise.sigma_deg", "True", "number"]),
    (["run", F, "noise.sigma_deg=.nan"], ["noise.sigma_deg"]),
    (["run", F, "noise.sigma_deg=inf"], ["noise.sigma_deg", "inf"]),
    (["run", F, "noise.kappa=0"], ["noise.kappa", "0", "> 0"]),
    (["run", F, "noise.kappa=-1"], ["noise.kappa", "-1", "> 0"]),
    (["run", F, "noise.sigma_deg=10", "noise.kappa=33"], ["noise.kappa", "33", "sigma_deg=10"]),
    (["run", F, "filter.ekf_vmf.measurement.kappa=0"], ["filter.ekf_vmf.measurement.kappa", "> 0"]),
    (
        ["run", "filter=[ukf_vmf]", "filter.ukf_vmf.lambda_=-1"],
        ["filter.ukf_vmf.lambda_", "-1", ">= 0"],
    ),
    (
        ["run", "filter=[ukf_ae_adaptive]", "filter.ukf_ae_adaptive.form=best"],
        ["form", "best", "averaged, centre, augmented"],
    ),
    (
        ["run", "filter=[ekf_ae_fitted]", "filter.ekf_ae_fitted.measurement.fit=mine"],
        ["fit", "mine", "printed, own"],
    ),
    (
        ["run", "filter=[ekf_ae_nominal]", "filter.ekf_ae_nominal.measurement.sigma_deg=200"],
        ["sigma_deg", "200", "180"],
    ),
    (["run", F, "reps=0"], ["reps", "0", ">= 1"]),
    (["run", F, "reps=2.5"], ["reps", "2.5", "integer"]),
    (["run", F, "reps=many"], ["reps", "many", "integer"]),
    (["run", F, "seed=-1"], ["seed", "-1", ">= 0"]),
    (["run", F, "seed=null"], ["seed", "None", "integer"]),
    (["run", F, "runner.n_jobs=0"], ["runner.n_jobs", "0", ">= 1"]),
    (["run", F, "runner.n_jobs=-2"], ["runner.n_jobs", "-2", ">= -1"]),
    (["run", F, "runner.chunk=0"], ["runner.chunk", "0", ">= 1"]),
    (["run", F, "runner.max_failed=1.5"], ["runner.max_failed", "1.5", "<= 1"]),
    (["run", F, "until.metric=rmse"], ["until.metric", "rmse", "rmse_3d_m"]),
    (["run", F, "until.metric=rmse_3d_m"], ["until.se", "> 0", "until.relative_se"]),
    (["run", F, "until.metric=rmse_3d_m", "until.se=0"], ["until.se", "0", "> 0"]),
    (
        ["run", F, "until.metric=rmse_3d_m", "until.relative_se=-1"],
        ["until.relative_se", "-1", "> 0"],
    ),
    (["run", F, "until.se=0.1"], ["until.se=0.1", "until.metric"]),
    (
        ["run", F, "until.metric=nees", "until.se=1", "until.min_reps=1"],
        ["until.min_reps", "1", ">= 2"],
    ),
    (
        ["run", F, "until.metric=nees", "until.se=1", "until.max_reps=100"],
        ["until.max_reps", "100", ">= 200"],
    ),
    (["run", F, "+until.reps=3"], ["until.reps", "unknown key", "min_reps"]),
    (["run", F, "-m", "until.metric=nees", "until.se=1,2"], ["until", "cannot be swept"]),
    (["run", F, "runner.backend=spark"], ["runner.backend", "spark", "loky"]),
    (["run", F, "runner.out=''"], ["runner.out", "folder"]),
    (["run", F, "runner.out=/dev/null/here"], ["runner.out", "/dev/null/here", "writable"]),
    (["run", F, "store.steps=perhaps"], ["store.steps", "perhaps", "true or false"]),
    (["run", F, "scenario.steps=0"], ["scenario.steps", "0", ">= 1"]),
    (["run", F, "scenario.dt=0"], ["scenario.dt", "0", ">= 1e-06"]),
    (["run", F, "scenario.side_m=-5"], ["scenario.side_m", "-5", ">= 0.001"]),
    (["run", F, "scenario.motion.q_z=0"], ["scenario.motion.q_z", "0", ">= 1e-06"]),
    (["run", F, "scenario.anchors.position_m=[[1,2]]"], ["scenario.anchors.position_m", "3"]),
    (["run", F, "scenario.anchors.position_m=[]"], ["scenario.anchors.position_m", "3"]),
    (
        ["run", F, "scenario.anchors.facing=[[1,0,0]]"],
        ["scenario.anchors.facing", "one row per anchor"],
    ),
    (
        ["run", F, "scenario.anchors.facing=[[0,0,0],[1,0,0],[1,0,0],[1,0,0]]"],
        ["scenario.anchors.facing", "length > 0"],
    ),
    (["run", F, "scenario.anchors.frame_rpy_deg=[1,2]"], ["frame_rpy_deg", "3"]),
    (
        ["run", F, "scenario.anchors.position_m=[[true,0,0]]"],
        ["scenario.anchors.position_m=", "True"],
    ),
    (
        ["run", F, "scenario=ble_room", "scenario.size_m=[0,1,1]"],
        ["scenario.size_m=[0, 1, 1]", "3 finite numbers > 0"],
    ),
    (
        ["run", F, "scenario=bs_grid", "scenario.size_m=[9,9]"],
        ["scenario.size_m=[9, 9]", "3 finite numbers > 0"],
    ),
    (["run", F, "scenario=bs_grid", "+scenario.dt=0"], ["scenario.dt=0", ">= 1e-06"]),
    (
        ["run", F, "scenario=ble_room", "scenario.points_m=[[9,1]]"],
        ["scenario.points_m[0]=[9.0, 1.0]"],
    ),
    (
        ["run", "estimator=[ls_lines]", "estimator.ls_lines.clip=5"],
        ["estimator.ls_lines.clip=5", "true or false"],
    ),
    (
        ["run", "estimator=[vmf_ml]", "estimator.vmf_ml.clip=no way"],
        ["estimator.vmf_ml.clip='no way'", "true or false"],
    ),
    (["run", F, "scenario.motion=null"], ["scenario", "motion"]),
    (["run", F, "noise=null"], ["noise=null", "must be a string"]),
    (["run", F, "noise.sigma_deg=2,5"], ["noise.sigma_deg=2,5", "-m"]),
    (["run", F, "-m", "noise.sigma_deg=range(1,-3)"], ["empty"]),
    (["run", F, "-m", "runner.out=a,b"], ["runner", "cannot be swept"]),
    (["run", F, "-m", "noise=[vmf,ae_flip]"], ["noise", "exactly one"]),
    (["run", F, "noise.kappa=1e-20"], ["noise.kappa", "1e-20", ">= 1e-06"]),
    (["run", F, "noise.sigma_deg=1e-300"], ["noise.sigma_deg", "1e-300"]),
    (["run", F, "reps=99999999999999999999"], ["reps", "<= 1e+08"]),
    (["run", F, "seed=99999999999999999999"], ["seed", "99999999999999999999"]),
    (["run", F, "scenario.anchors=null"], ["scenario"]),
    (["run", F, "scenario.anchors=3"], ["scenario"]),
    (["run", F, "scenario.motion=3"], ["scenario.motion=3", "derive from aoabench.Motion"]),
    (["run", F, "scenario.name=null"], ["scenario.name", "text"]),
    (
        ["run", F, "filter.ekf_vmf.measurement=null"],
        ["filter.ekf_vmf.measurement=None", "derive from aoabench.Measurement"],
    ),
    (["run", F, "store=3"], ["store", "steps"]),
    (["run", F, "~runner.out"], ["runner.out", "missing"]),
    (["run", F, "plugins=@x"], ["plugins"]),
    (["run", F, "+hydra.callbacks.evil={_target_:os.system}"], ["nothing under hydra"]),
    (["run", F, "hydra/launcher=basic"], ["nothing under hydra"]),
    (["run", F, "--experimental-rerun", "x.pickle"], ["--experimental-rerun"]),
    (["run", F, "--config-di", "/tmp"], ["--config-di"]),
    (["run", F, "noise.sigma_deg=[1"], ["noise.sigma_deg=[1", "cannot be read"]),
    (["run", F, "plugins=[no_such_package_xyz]"], ["plugins", "no_such_package_xyz"]),
    (["run", F, "plugins=['os; rm']"], ["plugins", "importable"]),
    (["run", F, "hydra.searchpath=[/tmp]"], ["hydra.searchpath", "nothing under hydra"]),
    (["run", F, "--config-dir", "/no/such/folder"], ["--config-dir", "/no/such/folder"]),
    (["run", F, "--config-path", "/tmp"], ["--config-path", "--help"]),
    (["run", F, "--config-name=x"], ["--config-name", "--help"]),
    (["run", F, "--no-such-flag"], ["--no-such-flag", "--help"]),
    (["run", "-m", F, "noise.sigma_deg=2,5,-1"], ["noise.sigma_deg", "-1", "> 0"]),
    (["rnu"], ["rnu", "did you mean 'run'"]),
    (["reproduce", "nurminen"], ["nurminen", "nurminen2018"]),
    (["reproduce", "--only", "fig99"], ["fig99", "did you mean 'fig"]),
    (["reproduce", "--scale", "huge"], ["--scale", "huge", "quick"]),
    (["compare", "/no/such/run"], ["/no/such/run", "no results"]),
    (["compare"], ["run"]),
    (["collect", "/no/such/run"], ["/no/such/run", "no results"]),
    (["collect"], ["run"]),
    (["list", "filtre"], ["filtre"]),
    (["replay", "/no/such/run", "--replication", "0", "--estimator", "x"], ["/no/such/run"]),
]


@pytest.mark.parametrize(("argv", "words"), CASES, ids=[" ".join(c[0]) for c in CASES])
def test_one_clear_line_and_status_2(argv, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(argv)
    out, err = capsys.readouterr()
    assert stop.value.code == 2, (out, err)
    assert len(err.strip().splitlines()) == 1, err
    assert "Traceback" not in out + err
    for word in words:
        assert word in err, (word, err)
    assert not (tmp_path / "results").exists(), "nothing was started"


NODES = "x_m,y_m,z_m,facing_deg\n0,3,2.5,0\n6,0,2.5,90\n12,3,2.5,180\n6,6,2.5,-90\n"
INWARD = "x_m,y_m,z_m,facing_deg\n0.1,3,2.5,0\n6,0.1,2.5,90\n11.9,3,2.5,180\n"
OUTWARD = NODES.replace(",0\n", ",180.0\n").replace(",90\n", ",-90.0\n").replace(",180\n", ",0.0\n")
OUTWARD = OUTWARD.replace(",-90\n", ",90.0\n")
WALLS = "x0_m,y0_m,x1_m,y1_m\n0,0,12,0\n12,0,12,6\n12,6,0,6\n0,6,0,0\n"
DEGREES = "x0_m,y0_m,x1_m,y1_m\n24.0,60.0,24.0002,60.0\n24.0,60.0,24.0,60.00005\n"
MILLIMETRES = (
    "x0_m,y0_m,x1_m,y1_m\n0,0,12000,0\n12000,0,12000,6000\n12000,6000,0,6000\n0,6000,0,0\n"
)
ROUTE = "scenario.route=[[1,1],[11,1],[11,5],[1,5]]"
AWAY = "scenario.route=[[1,8],[11,8],[11,9]]"
PLAN = ["run", "scenario=indoor_map", "scenario.anchors=a.csv", "scenario.walls=w.csv",
        "scenario.corner_radius_m=0.3", "noise=ae_normal", "filter=[ekf_aoa]"]  # fmt: skip

PLANS = {
    "anchors face away": (OUTWARD, WALLS, [ROUTE], ["scenario.route=", "on a wall that they face away from?", "no point of the route sees any access node"]),
    "route outside": (NODES, WALLS, [AWAY], ["scenario.route=", "a route outside the building", "no point of the route sees any access node"]),
    "nobody knows the side": (NODES.replace(",facing_deg", ",note"), WALLS, [ROUTE], ["scenario.anchors='a.csv'", "facing_deg"]),
    "degrees": (INWARD, DEGREES, [ROUTE], ["scenario.walls='", "w.csv'", "degrees", "scenario.walls_crs=local"]),
    "wgs84": (INWARD, DEGREES, [ROUTE, "scenario.walls_crs=wgs84"], ["scenario.origin_deg=", "w.csv is not", "its centre: [60.0"]),
    "mm": (INWARD, MILLIMETRES, [ROUTE], ["scenario.walls='w.csv'", "walls span 12000 m", "scenario.walls_unit=mm"]),
    "not mm": (INWARD, WALLS, [ROUTE, "scenario.walls_unit=mm"], ["scenario.walls_unit='mm'", "perhaps m"]),
    "no unit": (INWARD, WALLS, [ROUTE, "scenario.walls_unit=inch"], ["scenario.walls_unit='inch'", "m, cm, mm"]),
    "facing called yaw": (INWARD.replace("facing_deg", "yaw"), WALLS, [ROUTE], ["scenario.anchors=", "'yaw'", "call it facing_deg"]),
    "empty": ("", WALLS, [ROUTE], ["scenario.anchors=", "line 1 is empty"]),
    "no walls": (INWARD, "", [ROUTE], ["scenario.walls=", "columns x0_m"]),
    "share": (INWARD, WALLS, [ROUTE, "scenario.least_heard=2"], ["scenario.least_heard=2", "<= 1"]),
    "elsewhere": (INWARD, WALLS, ["scenario.route=[[901,1],[911,1],[911,5]]"], ["scenario.route=", "no point of the route sees any access node"]),
    "another country": (INWARD, WALLS, ["scenario.route=[[500001,1],[500011,1],[500011,5]]"], ["scenario.anchors='a.csv'", "same coordinates"]),
}  # fmt: skip


@pytest.mark.parametrize(("nodes", "walls", "more", "words"), PLANS.values(), ids=PLANS)
def test_plans_without_any_measurement_or_in_other_units(
    nodes, walls, more, words, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text(nodes)
    Path("w.csv").write_text(walls)
    test_one_clear_line_and_status_2([*PLAN, *more], words, capsys, tmp_path, monkeypatch)


LOG = ["run", "scenario=recorded", "scenario.path=l.csv", "scenario.anchors=a.csv"]
BEACONS = "id,x_m,y_m,z_m\na,0,0,2.5\nb,6,0,2.5\nc,3,5,2.5\n"
WHOLE = """fix,anchor,azimuth_deg,elevation_deg,rssi_dbm,x_m,y_m,z_m
1,a,45,-27,-60,2,2,1
1,b,153,-19,127,2,2,1
2,a,14,-20,-61,4,1,1
2,c,-76,-20,-70,4,1,1
"""
AZIMUTHS = "fix,anchor,azimuth_deg,x_m,y_m,z_m\n1,a,45,2,2,1\n1,b,153,2,2,1\n"
LONELY = "fix,anchor,azimuth_deg,elevation_deg\n1,a,45,-27\n2,b,153,-19\n"
DEAF = WHOLE.replace("-60", "127").replace("-61", "127").replace("-70", "-128")
FITS = "with this recording fit estimator=["

NEEDS = {  # an estimator that needs something, a log that has it not, and words of the line
    "elevation": ("estimator=[ls]", AZIMUTHS, ["scenario='recorded'", "measures elevations", "estimator.ls needs", FITS, "ls_lines"]),
    "elevation of ml": ("estimator=[ml_kcorr]", AZIMUTHS, ["measures elevations", "estimator.ml_kcorr needs", FITS]),
    "elevation of vmf": ("estimator=[vmf_ml]", AZIMUTHS, ["measures elevations", "estimator.vmf_ml needs", FITS]),
    "rssi": ("estimator=[rssi_anchor] scenario.height_m=1", WHOLE.replace("rssi_dbm", "note"), ["measures signal strengths", "estimator.rssi_anchor needs", FITS, "anchor_mean"]),
    "rssi that is never available": ("estimator=[rssi_anchor] scenario.height_m=1", DEAF, ["measures signal strengths", "estimator.rssi_anchor needs"]),
    "height": ("estimator=[anchor_mean]", WHOLE.replace("z_m", "up"), ["a known height", "estimator.anchor_mean needs", "scenario.height_m", FITS, "ls_lines"]),
    "height of discrepancy": ("estimator=[discrepancy]", WHOLE.replace("4,1,1", "4,1,2"), ["a known height", "estimator.discrepancy needs", "scenario.height_m"]),
    "truth": ("estimator=[best_anchor]", WHOLE.replace("x_m,y_m", "u,v").replace("z_m", "w"), ["scenario='recorded'", "estimator.best_anchor needs"]),
    "several anchors": ("estimator=[ls_lines]", LONELY, ["two or more anchors measure at a time", "estimator.ls_lines needs", "scenario.window_s"]),
    "several anchors, height free": ("estimator=[vmf_ml]", LONELY, ["two or more anchors measure at a time", "estimator.vmf_ml needs"]),
    "an anchor": ("estimator=[single_anchor_2] scenario.height_m=1", WHOLE.replace("1,b", "1,c"), ["estimator.single_anchor_2.anchor=2", "an anchor that measured: 1, 3"]),
    "delay": ("estimator=[wcg]", WHOLE, ["times of arrival", "estimator.wcg needs", FITS]),
    "motion": ("filter=[ekf_vmf]", WHOLE, ["scenario='recorded'", "motion model", "filter.ekf_vmf needs", FITS]),
    "motion at access nodes": ("filter=[ekf_aoa]", WHOLE, ["motion model", "filter.ekf_aoa needs", FITS]),
    "anything": ("estimator=[ls_lines]", "fix,anchor,azimuth_deg\n1,a,\n1,b,\n", ["scenario.path='l.csv'", "at least one azimuth or elevation"]),
}  # fmt: skip


@pytest.mark.parametrize(("estimator", "log", "words"), NEEDS.values(), ids=NEEDS)
def test_what_a_log_lacks_is_named_before_the_run(
    estimator, log, words, capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text(BEACONS)
    Path("l.csv").write_text(log)
    given = [*LOG, *estimator.split()]
    test_one_clear_line_and_status_2(given, words, capsys, tmp_path, monkeypatch)


@pytest.mark.parametrize(("argv", "words"), [
    (["filter=[ekf_toa_aoa]", "noise=vmf"], ["noise='vmf'", "filter.ekf_toa_aoa needs", "these fit: ofdm_crlb"]),
    (["estimator=[wcg]", "noise=ae_flip"], ["noise='ae_flip'", "estimator.wcg needs", "these fit: ofdm_crlb"]),
    (["estimator=[rssi_anchor]", "scenario=ble_room"], ["noise='vmf'", "these fit: ble_multipath, ofdm_crlb"]),
    (["filter=[ekf_vmf]", "scenario=bs_grid"], ["scenario='bs_grid'", "these fit: indoor_map", "square_track"]),
    (["estimator=[anchor_mean]", "scenario=bs_grid"], ["scenario='bs_grid'", "these fit: ble_room"]),
    (["estimator=[ls]", "scenario=indoor_map", "scenario.nearest=1"], ["two or more anchors measure at a time"]),
])  # fmt: skip
def test_what_fits_is_named(argv, words, capsys, tmp_path, monkeypatch):
    test_one_clear_line_and_status_2(["run", *argv], words, capsys, tmp_path, monkeypatch)


CASES_FOLDER = os.environ.get("AOABENCH_CASES", "")


@pytest.mark.skipif(not CASES_FOLDER, reason="AOABENCH_CASES names no folder of cases")
def test_the_case_of_degrees(capsys, tmp_path, monkeypatch):
    folder = Path(CASES_FOLDER) / "plan_degrees"
    shutil.copy(folder / "an.csv", tmp_path / "a.csv")
    shutil.copy(folder / "walls.geojson", tmp_path)
    argv = [*PLAN, ROUTE, "scenario.walls=walls.geojson"]
    test_one_clear_line_and_status_2(argv, ["degrees"], capsys, tmp_path, monkeypatch)


def test_a_bad_value_late_in_a_sweep_is_found_before_anything_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["run", "-m", F, "noise.sigma_deg=2,5,0", "runner.out=here"])
    assert stop.value.code == 2
    assert not (tmp_path / "here" / "parts").exists()


def test_an_unwritable_folder_is_named(tmp_path, monkeypatch, capsys):
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main(["run", F, f"runner.out={file}/inside"])
    assert stop.value.code == 2
    assert "runner.out" in capsys.readouterr().err


def test_the_real_command_does_the_same(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "aoabench.cli", "run", F, "noise.kappa=-1"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ,
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""
