"""Configs from elsewhere: none of them makes us import or run what the command line does not list
in plugins, write outside the output folder, or listen to another machine; and nothing is unpickled
from disk."""

import pickle
from dataclasses import replace

import pytest

import aoabench
from aoabench.cli.main import main
from aoabench.config.compose import compose_cells
from aoabench.engine import runner
from aoabench.engine.replay import replay
from aoabench.engine.replay_files import write
from aoabench.store import folder
from aoabench.store.documents import read_document, write_document

HIT = "{_target_: os.system, command: touch HIT}"
EXPERIMENT = "# @package _global_\n# X\ndefaults:\n  - override /filter: [ekf_vmf]\n"
VMF = "_target_: aoabench.noise.angular.VonMisesFisher\ndefault_sigma_deg: 10\n"
MINE = "mine:\n  _target_: aoabench.filters.kalman.EKF\n  measurement: "

# file, its text, the overrides that choose it
CORPUS = {
    "os.system": ("noise/x.yaml", "_target_: os.system\ncommand: touch HIT\n", ["noise=x"]),
    "eval": ("noise/x.yaml", "_target_: builtins.eval\nsource: open('HIT','w')\n", ["noise=x"]),
    "exec by args": ("noise/x.yaml", "_target_: builtins.exec\n_args_: ['open(\"HIT\",\"w\")']\n", ["noise=x"]),
    "subprocess": ("estimator/x.yaml", "x: {_target_: subprocess.Popen, args: [touch, HIT]}\n", ["estimator=[x]"]),
    "our module's os": ("estimator/x.yaml", "x: {_target_: aoabench.cli.main.os.system, command: touch HIT}\n", ["estimator=[x]"]),
    "our plug-in's numpy": ("noise/x.yaml", "_target_: aoabench.noise.angular.np.load\nfile: x\n", ["noise=x"]),
    "our plug-in's builtins": ("noise/x.yaml", "_target_: aoabench.noise.angular.__builtins__.eval\n", ["noise=x"]),
    "our plug-in's Path": ("noise/x.yaml", "_target_: aoabench.scenarios.indoor_map.Path\n", ["noise=x"]),
    "a class that is not a plug-in": ("noise/x.yaml", "_target_: aoabench.engine.tasks.Task\n", ["noise=x"]),
    "importlib": ("noise/x.yaml", "_target_: importlib.import_module\nname: evil\n", ["noise=x"]),
    "a module beside us": ("noise/x.yaml", "_target_: evil.Evil\n", ["noise=x"]),
    "a module that looks like ours": ("noise/x.yaml", "_target_: aoabench_evil.noise.Evil\n", ["noise=x"]),
    "hydra's own": ("noise/x.yaml", "_target_: hydra.utils.instantiate\nconfig: " + HIT + "\n", ["noise=x"]),
    "nested": ("noise/x.yaml", VMF + f"sigma_deg: {HIT}\n", ["noise=x"]),
    "nested in a list": ("noise/x.yaml", VMF + f"sigma_deg: [1, [{HIT}]]\n", ["noise=x"]),
    "nested in a filter": ("filter/mine.yaml", MINE + HIT + "\n", ["filter=[mine]"]),
    "partial": ("noise/x.yaml", VMF + "_partial_: true\n", ["noise=x"]),
    "by environment": ("noise/x.yaml", "_target_: ${oc.env:EVIL}\ncommand: touch HIT\n", ["noise=x"]),
    "by another key": ("noise/x.yaml", "a: os\nb: system\n_target_: ${noise.a}.${noise.b}\ncommand: touch HIT\n", ["noise=x"]),
    "by a decoded text": ("noise/x.yaml", "_target_: ${oc.decode:'os.system'}\ncommand: touch HIT\n", ["noise=x"]),
    "by a created node": ("noise/x.yaml", VMF + "sigma_deg: ${oc.create:'" + HIT + "'}\n", ["noise=x"]),
    "by an experiment": ("experiment/x.yaml", EXPERIMENT + f"noise: {HIT}\n", ["experiment=x"]),
    "by an experiment's filter": ("experiment/x.yaml", EXPERIMENT + f"filter: {{ekf_vmf: {{measurement: {HIT}}}}}\n", ["experiment=x"]),
    "a tag": ("noise/x.yaml", "!!python/object/apply:os.system ['touch HIT']\n", ["noise=x"]),
    "a tag inside": ("noise/x.yaml", VMF + "sigma_deg: !!python/name:os.system\n", ["noise=x"]),
    "plugins": ("experiment/x.yaml", EXPERIMENT + "plugins: [evil]\n", ["experiment=x"]),
    "plugins by interpolation": ("experiment/x.yaml", EXPERIMENT + "plugins: ${oc.decode:'[evil]'}\n", ["experiment=x"]),
    "plugins by a sweep": ("experiment/x.yaml", EXPERIMENT + "hydra: {sweeper: {params: {plugins: '[evil]'}}}\n", ["experiment=x", "-m"]),
    "plugins added by a sweep": ("experiment/x.yaml", EXPERIMENT + "hydra: {sweeper: {params: {+plugins: '[evil]'}}}\n", ["experiment=x", "-m"]),
    "a root config": ("config.yaml", "hydra: {callbacks: {x: " + HIT + "}}\n", ["filter=[ekf_vmf]"]),
    "callback": ("experiment/x.yaml", EXPERIMENT + "hydra: {callbacks: {x: " + HIT + "}}\n", ["experiment=x"]),
    "launcher": ("experiment/x.yaml", EXPERIMENT + "hydra: {launcher: " + HIT + "}\n", ["experiment=x", "-m"]),
    "a dotted key": ("experiment/x.yaml", EXPERIMENT + "hydra.callbacks.x: " + HIT + "\n", ["experiment=x"]),
    "a header after a blank": ("noise/x.yaml", " # @package hydra.callbacks\nx: " + HIT + "\n", ["noise=x"]),
    "logging by a sweep": (
        "experiment/x.yaml",
        EXPERIMENT + "hydra: {sweeper: {params: {+hydra.job_logging.handlers: '{h: {class: evil.H}}'}}}\n",
        ["experiment=x", "-m"],
    ),
    "sweeper": ("experiment/x.yaml", EXPERIMENT + "hydra: {sweeper: " + HIT + "}\n", ["experiment=x", "-m"]),
    "search path": ("experiment/x.yaml", EXPERIMENT + "hydra: {searchpath: ['pkg://evil', 'file:///tmp']}\n", ["experiment=x"]),
    "logging": ("experiment/x.yaml", EXPERIMENT + "hydra: {job_logging: {handlers: {h: {class: evil.H}}}}\n", ["experiment=x"]),
    "hydra's folder": ("experiment/x.yaml", EXPERIMENT + "hydra: {run: {dir: ../..}}\n", ["experiment=x"]),
    "hydra's defaults": ("experiment/x.yaml", "# @package _global_\ndefaults:\n  - override /hydra/launcher: x\n", ["experiment=x"]),
    "hydra's package": ("noise/x.yaml", "# @package hydra.callbacks\nx: " + HIT + "\n", ["noise=x"]),
    "a package in defaults": ("experiment/x.yaml", "defaults:\n  - /noise@hydra.callbacks: vmf\n", ["experiment=x"]),
    "an own hydra group": ("hydra/callbacks/x.yaml", "x: " + HIT + "\n", ["filter=[ekf_vmf]"]),
    "a file elsewhere": ("experiment/x.yaml", "# @package _global_\ndefaults:\n  - ../../outside\n", ["experiment=x"]),
    "outside by its folder": ("experiment/x.yaml", EXPERIMENT + "runner: {out: ../outside}\n", ["experiment=x"]),
    "outside from the root": ("experiment/x.yaml", EXPERIMENT + "runner: {out: /tmp/outside}\n", ["experiment=x"]),
    "outside at home": ("experiment/x.yaml", EXPERIMENT + "runner: {out: ~/outside}\n", ["experiment=x"]),
    "outside by interpolation": ("experiment/x.yaml", EXPERIMENT + "runner: {out: '${oc.env:HOME}/outside'}\n", ["experiment=x"]),
    "outside by a runner": ("runner/x.yaml", "out: in/../../outside\nn_jobs: 1\n", ["filter=[ekf_vmf]", "runner=x"]),
    "outside by a sweep": ("experiment/x.yaml", EXPERIMENT + "hydra: {sweeper: {params: {runner.out: ../outside}}}\n", ["experiment=x", "-m"]),
    "another machine": ("runner/x.yaml", "out: out\nn_jobs: 1\nbackend: dask\naddress: tcp://127.0.0.1:8786\n", ["filter=[ekf_vmf]", "runner=x"]),
    "another machine by an experiment": (
        "experiment/x.yaml", EXPERIMENT + "runner: {backend: dask, address: 'tcp://127.0.0.1:8786'}\n", ["experiment=x"],
    ),
    "another machine by a sweep": (
        "experiment/x.yaml",
        EXPERIMENT + "runner: {backend: dask}\nhydra: {sweeper: {params: {runner.address: 'tcp://127.0.0.1:8786'}}}\n",
        ["experiment=x", "-m"],
    ),
    "a name that is a path": ("filter/mine.yaml", "../../outside: {_target_: aoabench.filters.kalman.EKF}\n", ["filter=[mine]"]),
    "a second name that is a path": (
        "experiment/x.yaml",
        EXPERIMENT + "filter: {../../outside: {_target_: aoabench.filters.kalman.EKF, measurement: {_target_: "
        "aoabench.models.unit_vector.UnitVector, kappa: 9}}}\n",
        ["experiment=x"],
    ),
}  # fmt: skip


def arm(place):
    """What must not be imported lies where it would be found."""
    for name in ("evil.py", "aoabench_evil.py"):
        (place / name).write_text("open('HIT', 'w')\n")


@pytest.mark.parametrize("case", CORPUS)
def test_a_config_from_elsewhere_gets_nowhere(case, tmp_path, monkeypatch, capsys):
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.syspath_prepend(work)
    monkeypatch.setenv("EVIL", "os.system")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    arm(work)
    (tmp_path / "outside.yaml").write_text("hydra: {callbacks: {x: " + HIT + "}}\n")
    file, text, words = CORPUS[case]
    (work / "conf" / file).parent.mkdir(parents=True)
    (work / "conf" / file).write_text(text)
    if not any(word.startswith(("filter", "estimator", "experiment")) for word in words):
        words = [*words, "filter=[ekf_vmf]"]
    with pytest.raises(SystemExit) as stop:
        main(["run", "reps=2", "runner.n_jobs=1", *words, "--config-dir", "conf"])
    said = capsys.readouterr().err
    assert stop.value.code == 2, said
    assert len(said.strip().splitlines()) == 1, said
    assert not (work / "HIT").exists()
    assert {p.name for p in tmp_path.iterdir()} <= {"work", "outside.yaml"}
    assert not list(work.rglob("*.parquet"))


def test_the_command_line_may_lead_elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frame = aoabench.run("filter=[ekf_vmf]", "reps=2", out=tmp_path / "a" / ".." / "elsewhere")
    assert len(frame) == 2
    assert (tmp_path / "elsewhere" / "summary.parquet").exists()


@pytest.fixture
def finished(tmp_path):
    out = tmp_path / "out"
    cell = compose_cells(["filter=[ekf_vmf]", "reps=3", "runner.n_jobs=1", f"runner.out={out}"])
    runner.run(cell, progress=False)
    return out, cell


def rewritten(out, change):
    path = next((out / "cells").glob("*.json"))
    record = read_document(path)
    change(record)
    write_document(path, record)
    return path.stem


def test_a_run_folder_from_elsewhere_cannot_name_code(finished, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out, _ = finished

    def change(record):
        record["config"]["filter"]["ekf_vmf"]["measurement"] = {
            "_target_": "os.system",
            "command": "touch HIT",
        }
        record["plugins"] = ["evil"]

    rewritten(out, change)
    arm(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(aoabench.UserError, match=r"os\.system"):
        replay(out, 1, "ekf_vmf")
    assert not (tmp_path / "HIT").exists()


def test_a_run_folder_from_elsewhere_cannot_name_files(finished, tmp_path):
    out, cells = finished
    name = "../../../outside"

    def change(record):
        record["config"]["filter"][name] = record["config"]["filter"]["ekf_vmf"]
        record["estimators"][name] = record["estimators"]["ekf_vmf"]

    cell = rewritten(out, change)
    frame = next((out / "replications.parquet").glob("*.parquet"))
    assert replay(out, 1, name).as_stored
    write(replace(replay(out, 1, "ekf_vmf"), estimator=name))
    assert not list(tmp_path.glob("outside*"))
    stem = f"{cell}-_._.._.._outside-1"
    assert {p.name for p in (out / "replay").iterdir()} == {f"{stem}.parquet", f"{stem}.png"}
    rewritten(out, lambda record: record.update(cell="../../outside"))
    refused = pytest.raises(aoabench.RunError, match=rf"{cell}\.json is torn or altered")
    with refused:  # it does not belong to its file
        folder.records(out)
    rewritten(
        out,
        lambda record: (
            record.update(cell=cell),
            record["estimators"]["ekf_vmf"].update(key="../../x"),
        ),
    )
    with refused:
        folder.records(out)
    with refused:
        runner.run(cells, progress=False)
    (out / "cells" / f"{cell}.json").unlink()
    assert frame.exists()
    assert runner.run(cells, progress=False).computed == 0, "the parts are still there"


def test_nothing_is_unpickled(tmp_path, monkeypatch):
    """Neither a run nor what reads one; compiled kernels, which numba keeps beside our own code,
    left out.
    """

    def refuse(*_args, **_kwargs):
        raise AssertionError("something was unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    words = [
        "filter=[ekf_vmf]",
        "filter.ekf_vmf.engine=numpy",
        "store.steps=true",
        "runner.n_jobs=1",
    ]
    for reps in (5, 9):
        assert len(aoabench.run(*words, f"reps={reps}", out=tmp_path)) == reps
    again = replay(tmp_path, 7, "ekf_vmf")
    assert again.as_stored
    assert "as stored" in write(again)
