"""`filter=all` and `estimator=all`: those that fit, and the reason for each other one."""

import pytest

import aoabench
from aoabench.config import catalogue, compose
from aoabench.config.compose import compose_cells
from aoabench.config.fit import left_out_text
from aoabench.config.presets import LISTS, options, variants
from aoabench.errors import UserError

ALL = ["filter=all", "estimator=all"]
SETTINGS = [
    ("square_track", "vmf"),
    ("square_track", "ofdm_crlb"),
    ("bs_grid", "ae_normal"),
    ("ble_room", "ble_multipath"),
    ("indoor_map", "ofdm_crlb"),
]


def cell_of(*words, **options):
    (cell,) = compose_cells(list(words), **options)
    return cell


@pytest.mark.parametrize(("scenario", "noise"), SETTINGS)
def test_all_are_those_that_fit_but_smoothers_and_variants(scenario, noise):
    cell = cell_of(*ALL, f"scenario={scenario}", f"noise={noise}")
    without = catalogue.not_in_all()
    fitting = catalogue.fitting(scenario)
    wanted = {
        f"{group}.{name}"
        for group, names in fitting.items()
        for name, noises in names.items()
        if noise in noises and name not in without[group]
    }
    ran = {f"{group}.{name}" for group in LISTS for name in cell.config[group] or {}}
    assert ran == wanted
    assert {key.partition(".")[2] for key in ran} == set(cell.estimators)
    every = {f"{group}.{name}" for group in LISTS for name in options(group)}
    assert set(cell.left_out) == every - ran, "each preset runs or has a reason"
    assert all(cell.left_out.values())


@pytest.mark.parametrize("name", ["square_track", "bs_grid", "ble_room", "indoor_map"])
def test_a_leaderboard_of_every_estimator_has_all(name):
    for board in compose_cells([f"experiment=leaderboard_{name}"]):
        words = [f"scenario={board.scenario_name}", f"noise={board.noise_name}"]
        every = set(cell_of(*ALL, *words).estimators)
        assert set(board.estimators) <= every
        if "every" in options("experiment")[f"leaderboard_{name}"]:
            assert set(board.estimators) == every


def test_what_all_never_has_is_data():
    found = catalogue.not_in_all()
    assert {"map_smoother", "ekf_vmf_smoother"} <= set(found["filter"])
    assert not {"ekf_vmf", "ukf_ae_adaptive_augmented"} & set(found["filter"])
    assert set(found["estimator"]) == set(variants("estimator")) == {"wcg_as_printed", "discrepancy_exact"}  # fmt: skip


def test_the_cell_is_the_same_as_with_the_names():
    words = ["filter.ekf_vmf.innovation_steps=7", "estimator.wcg.as_printed=true"]
    cell = cell_of(*ALL, *words)
    named = [f"{g}=[{','.join(cell.config[g])}]" for g in LISTS]
    assert cell.id == cell_of(*named, words[0]).id, "the parameter of what is left out is no part"
    assert cell.changed == {"filter.ekf_vmf.innovation_steps": 7}
    assert cell.estimators["ekf_vmf"].innovation_steps == 7


def test_names_beside_all_are_chosen_as_without_it():
    cell = cell_of("filter=[all,map_smoother]", "estimator=[wcg_as_printed,all]", "noise=ofdm_crlb")
    assert {"map_smoother", "wcg_as_printed", "ekf_vmf"} <= set(cell.estimators)
    assert not {"filter.map_smoother", "estimator.wcg_as_printed"} & set(cell.left_out)
    with pytest.raises(UserError, match=r"which estimator\.wcg needs"):
        cell_of("estimator=[all,wcg]", "noise=vmf")


def test_a_sweep_leaves_out_by_cell():
    cells = compose_cells(["filter=all", "noise=vmf,ofdm_crlb", "estimator=[all],[ls]"])
    with_all, filters, delays, rest = (set(cell.estimators) for cell in cells)
    assert filters < with_all
    assert "wcg" in delays - with_all
    assert "ekf_ae_adaptive" in filters - rest
    assert "ekf_toa_aoa" in rest - filters
    lines = list(left_out_text(cells))
    assert sum("ekf_toa_aoa " in line and "noise=vmf: needs" in line for line in lines) == 1
    assert "with" not in next(line for line in lines if "anchor_mean" in line), "in all cells alike"


def test_a_key_at_fault_is_a_mistake_and_not_left_out():
    with pytest.raises(UserError, match=r"single_anchor_1\.anchor=9"):
        cell_of("estimator=all", "estimator.single_anchor_1.anchor=9", "scenario=ble_room")
    with pytest.raises(UserError, match=r"ekf_vmf\.engine='fast'"):
        cell_of("filter=all", "filter.ekf_vmf.engine=fast")


def test_nothing_that_fits_is_a_mistake():
    with pytest.raises(UserError, match="filter=all: nothing runs with scenario=bs_grid noise=vmf"):
        cell_of("filter=all", "scenario=bs_grid")
    assert list(cell_of("filter=all", "estimator=[ls]", "scenario=bs_grid").estimators) == ["ls"]


def test_presets_of_ones_own_are_among_all(tmp_path):
    (tmp_path / "estimator").mkdir()
    file = tmp_path / "estimator" / "mine.yaml"
    text = "mine:\n  _target_: aoabench.estimators.lines.LineLeastSquares\n"
    file.write_text(f"# Mine\n{text}")
    cell = cell_of("estimator=all", config_dir=str(tmp_path))
    assert "mine" in cell.estimators
    file.write_text(f"# Mine\n# variant: of ls_lines\n{text}")
    cell = cell_of("estimator=all", config_dir=str(tmp_path))
    assert cell.left_out["estimator.mine"] == "a variant of ls_lines"
    assert options("estimator", str(tmp_path))["mine"] == "Mine"
    (tmp_path / "estimator" / "all.yaml").write_text("# Own\nall: {_target_: aoabench.estimators.lines.LineLeastSquares}\n")  # fmt: skip
    assert list(cell_of("estimator=all", config_dir=str(tmp_path)).estimators) == ["all"]


def test_the_composed_config_shows_what_runs():
    text = compose.show(["estimator=all", "scenario=bs_grid"], package="estimator")
    shown = {line[:-1] for line in text.splitlines() if not line.startswith(" ")}
    assert shown == set(cell_of("estimator=all", "scenario=bs_grid").estimators)


def test_from_python_the_notes_say_what_is_left_out(tmp_path):
    words = ["filter=all", "scenario.steps=2", "reps=1", "runner.n_jobs=1", "noise=ae_normal"]
    engines = [f"filter.{n}.engine=numpy" for n in cell_of(*words).estimators]
    frame = aoabench.run(*words, *engines, out=tmp_path / "out")
    assert "ekf_toa_aoa" not in set(frame["estimator"])
    assert any("ekf_toa_aoa: needs a noise" in line for line in frame.attrs["notes"])
