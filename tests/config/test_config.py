"""What a config may name, and that nothing else gets in."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from aoabench.config.compose import compose_cells
from aoabench.config.plugins import construct, resolve
from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError
from aoabench.resources import shipped


@pytest.mark.parametrize("target", [
    "os.system",
    "builtins.eval",
    "subprocess.Popen",
    "aoabench.cli.main.os.system",
    "aoabench.cli.main.main",
    "aoabench.engine.tasks.Task",
    "aoabench.store.files.os.remove",
    "aoabench.noise.angular.np.load",
    "aoabench.noise.angular.math.exp",
    "aoabench.noise.angular.param",
    "aoabench.noise.angular.Any",
    "aoabench.noise.angular._Angular",
    "aoabench.noise.angular.Measurements",
    "aoabench.models.azel.Batch",
    "aoabench.filters.kalman.sigma_points",
    "aoabench.noise.angular.__builtins__.eval",
    "aoabench.noisex.Evil",
    "..os.system",
    "",
    None,
    7,
    ["os.system"],
])  # fmt: skip
def test_targets_other_than_our_plug_ins_are_refused(target):
    with pytest.raises(UserError, match="_target_"):
        resolve(target, "noise")


def test_our_own_classes_resolve():
    from aoabench.noise.angular import VonMisesFisher

    assert resolve("aoabench.noise.angular.VonMisesFisher", "noise") is VonMisesFisher


@pytest.mark.parametrize("node", [
    {"_target_": "aoabench.noise.angular.VonMisesFisher", "_args_": [1]},
    {"_target_": "aoabench.noise.angular.VonMisesFisher", "_partial_": True},
    {"_target_": "aoabench.filters.kalman.EKF", "measurement": {"_target_": "os.system"}},
    {"_target_": "aoabench.filters.kalman.EKF", "measurement": [{"_target_": "builtins.exec"}]},
    {"_target_": "aoabench.filters.kalman.EKF"},
    {"sigma_deg": 3},
])  # fmt: skip
def test_bad_nodes_are_refused(node):
    with pytest.raises(UserError):
        construct(node, "x")


def test_linked_folders_are_read_as_hydra_reads_them(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "x.yaml").write_text(
        "# @package _global_\nhydra:\n  callbacks: {evil: {_target_: os.system}}\n"
    )
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "experiment").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserError, match="callbacks"):
        compose_cells(["filter=[ekf_vmf]", "experiment=x"], config_dir=str(tmp_path / "conf"))


def test_files_beside_the_groups_are_none_of_our_business(tmp_path):
    (tmp_path / "mkdocs.yml").write_text("plugins: [search]\nx: !Ref y\n")
    assert len(compose_cells(["filter=[ekf_vmf]"], config_dir=str(tmp_path))) == 1


def test_overrides_of_the_python_interface_cannot_reach_hydra_either():
    for override in (
        "hydra.searchpath=[file:///tmp]",
        "+hydra.callbacks.x={_target_:os.system}",
        "hydra/launcher=basic",
    ):
        with pytest.raises(UserError, match="hydra"):
            compose_cells(["filter=[ekf_vmf]", override])


def test_a_users_experiment_may_sweep(tmp_path):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "mine.yaml").write_text(
        "# @package _global_\n# Mine\ndefaults:\n  - override /filter: [ekf_vmf]\nhydra:\n  sweeper:\n    params:\n      noise.sigma_deg: 3,4,5\n"
    )
    cells = compose_cells(["experiment=mine", "reps=2"], config_dir=str(tmp_path))
    assert [c.noise.sigma_deg for c in cells] == [3, 4, 5]
    assert {c.experiment for c in cells} == {"mine"}
    narrowed = compose_cells(["experiment=mine", "noise.sigma_deg=4"], config_dir=str(tmp_path))
    assert [c.noise.sigma_deg for c in narrowed] == [4], "the command line wins"


def test_a_users_preset_may_not_hide_behind_a_shipped_name(tmp_path):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "vmf.yaml").write_text("_target_: aoabench.noise.angular.NormalAngles\n")
    with pytest.raises(UserError, match="shipped preset"):
        compose_cells(["filter=[ekf_vmf]", "noise=vmf"], config_dir=str(tmp_path))


@pytest.mark.parametrize("text", [
    "defaults: [ekf_vmf]\nekf_vmf: {measurement: {kappa: 20}}\n",
    "other: {_target_: aoabench.filters.kalman.EKF}\n",
    "",
])  # fmt: skip
def test_a_filter_file_holds_one_key_its_own_name(text, tmp_path):
    (tmp_path / "filter").mkdir()
    (tmp_path / "filter" / "mine.yaml").write_text(text)
    with pytest.raises(UserError, match="one key, 'mine'"):
        compose_cells(["filter=[mine]"], config_dir=str(tmp_path))


def test_a_users_filter_of_its_own_name_works(tmp_path):
    (tmp_path / "filter").mkdir()
    (tmp_path / "filter" / "mine.yaml").write_text(
        "# Mine\nmine:\n  _target_: aoabench.filters.kalman.EKF\n  measurement:\n"
        "    _target_: aoabench.models.unit_vector.UnitVector\n    kappa: 20\n"
    )
    cell = compose_cells(["filter=[mine,ekf_vmf]"], config_dir=str(tmp_path))[0]
    assert cell.estimators["mine"].measurement.kappa == 20
    assert cell.estimators["ekf_vmf"].measurement.kappa is None
    assert not cell.changed


def test_an_experiment_can_be_narrowed():
    cells = compose_cells(["experiment=nurminen2018_fig4", "filter=[pf_vmf,ekf_vmf]", "noise=vmf"])
    assert [set(c.estimators) for c in cells] == [{"pf_vmf", "ekf_vmf"}]


def test_glob_sweeps_over_presets():
    cells = compose_cells(["scenario=glob(square_track*)", "filter=[ekf_vmf]"])
    assert len(cells) == 5


@pytest.mark.parametrize("override", [
    "experiment=../foo/evil", "noise=${oc.env:X}", "+noise@hydra.callbacks.x=vmf", "+hydra/callbacks=x", "++hydra.job.name=x",
])  # fmt: skip
def test_overrides_cannot_leave_the_groups(override):
    with pytest.raises(UserError):
        compose_cells(["filter=[ekf_vmf]", override])


def test_files_that_only_hydra_would_reach_may_not_touch_hydra(tmp_path):
    (tmp_path / "evil.yaml").write_text(
        "# @package _global_\nhydra: {sweeper: {params: {hydra.searchpath: '[pkg://x]'}}}\n"
    )
    with pytest.raises(UserError, match="hydra"):
        compose_cells(["filter=[ekf_vmf]"], config_dir=str(tmp_path))
    (tmp_path / "evil.yaml").unlink()
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "x.yaml").write_text(
        "# @package _global_\ndefaults:\n  - sub: .${oc.env:NO,.}/evil\n"
    )
    with pytest.raises(UserError, match="defaults"):
        compose_cells(["filter=[ekf_vmf]", "experiment=x"], config_dir=str(tmp_path))


def test_plugins_must_be_importable_names_and_classes_must_be_theirs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_alias.py").write_text("from os import system\nfrom subprocess import Popen\n")
    (tmp_path / "conf" / "estimator").mkdir(parents=True)
    for name in ("system", "Popen"):
        (tmp_path / "conf" / "estimator" / f"{name}.yaml").write_text(
            f"{name}:\n  _target_: my_alias.{name}\n"
        )
        with pytest.raises(UserError, match="_target_"):
            compose_cells([f"estimator=[{name}]"], config_dir="conf", plugins=["my_alias"])


def test_hydras_state_is_left_as_it_was():
    from hydra.core.global_hydra import GlobalHydra

    compose_cells(["filter=[ekf_vmf]"])
    assert not GlobalHydra.instance().is_initialized()


def test_options_list_every_shipped_file_with_a_description():
    for group in GROUPS:
        for name, text in options(group).items():
            assert text, f"{group}/{name} has no description in its first comment"


def test_shipped_folders_exist():
    assert (shipped("configs") / "config.yaml").is_file()
    assert os.path.isdir(shipped("experiments"))


def test_threads_compose_at_the_same_time():
    """Hydra has one state for all threads."""
    words = [
        ["scenario=bs_grid", "noise=ae_normal", "estimator=[ls]"],
        ["noise=vmf", "filter=[ekf_vmf]"],
    ]
    alone = [compose_cells(one)[0].id for one in words]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda one: compose_cells(one)[0].id, words * 8))
    assert found == alone * 8
