"""`aoabench new` and `aoabench test`: skeletons that pass at once, and rules in words."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from aoabench.config.compose import compose_cells
from aoabench.studies import study
from aoabench.testing import skeletons
from aoabench.testing.plugins import module_of, plugins_of


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working folder, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    before, path = set(sys.modules), list(sys.path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]
    sys.path[:] = path


@pytest.mark.parametrize("kind", skeletons.KINDS)
def test_a_skeleton_runs_and_obeys_every_rule(here, call, kind):
    name = f"fresh_{kind}"
    code, out, err = call("new", kind, name)
    assert code == 0, err
    files = [f"{name}.py", f"conf/{kind}/{name}.yaml", f"test_{name}.py"]
    assert [line.removeprefix("wrote ") for line in out.splitlines()[:3]] == files
    run = next(line.strip() for line in out.splitlines() if "aoabench run" in line)
    words = [word.strip("'") for word in run.split()[1:]]
    code, out, err = call(*words, "reps=3", "runner.n_jobs=1", "runner.out=out")
    assert code == 0, err
    code, out, err = call("test", name)
    assert code == 0, out
    (head,) = (line for line in out.splitlines() if line.startswith(f"{kind}={name}"))
    skipped = out.count("\n  skipped")
    count = out.count("\n  passed")
    rest = f", {skipped} skipped" if skipped else ""
    assert head.endswith(f"): {count} of {count} rules hold{rest}")
    assert out.endswith(f"1 plug-in in {name}: every rule holds\n")
    compile(Path(f"test_{name}.py").read_text(), "test", "exec")
    sys.path.insert(0, str(here))
    space = {}
    exec(Path(f"test_{name}.py").read_text(), space)
    space["test_every_rule_holds"]()


def test_the_skeletons_are_formatted_and_clean(here, call):
    for kind in skeletons.KINDS:
        code, _, err = call("new", kind, f"clean_{kind}")
        assert code == 0, err
    files = sorted(map(str, here.glob("*.py")))
    assert len(files) == 8
    ruff = [sys.executable, "-m", "ruff"]
    rules = "--select=E,F,W,UP,B,C4,SIM,NPY,PIE,PT"
    for words in (
        ["format", "--line-length=100", "--check"],
        ["check", "--line-length=100", rules],
    ):
        done = subprocess.run([*ruff, *words, *files], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


@pytest.fixture
def checkout(here, monkeypatch):
    """An empty checkout, in which studies are looked up."""
    for module in (skeletons, study):
        monkeypatch.setattr(module, "shipped", lambda folder: here.resolve() / folder)
    monkeypatch.setattr(study, "load", study.load.__wrapped__)
    return here


def test_the_skeleton_of_a_study_passes_its_test(checkout, call):
    code, out, err = call("new", "study", "fresh_study")
    assert code == 0, err
    files = [line.removeprefix("wrote ") for line in out.splitlines() if "wrote" in line]
    assert len(files) == 8
    assert all(Path(file).stat().st_size for file in files)
    ruff = [sys.executable, "-m", "ruff", "format", "--line-length=100", "--check"]
    done = subprocess.run([*ruff, *files[3:5], files[-1]], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert pytest.main(["-q", "-p", "no:cacheprovider", files[-1]]) == 0


def test_a_study_is_written_into_the_checkout_alone(here, call):
    code, _, err = call("new", "study", "fresh_study")
    assert code == 2
    assert "--dir='.' is not allowed; allowed: for a study, the checkout of aoabench in use" in err
    assert err.count("\n") == 1
    assert not list(here.iterdir())


def test_nothing_is_replaced(here, call):
    assert call("new", "noise", "mine")[0] == 0
    Path("mine.py").write_text("mine")
    for kind in ("noise", "filter"):
        code, _, err = call("new", kind, "mine")
        assert code == 2
        assert err.count("\n") == 1
        assert "mine" in err
    assert Path("mine.py").read_text() == "mine"
    assert not Path("conf/filter").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ekf_vmf", "a name other than that of the preset filter=ekf_vmf"),
        ("lambda", "a name other than Python's own lambda"),
        ("json", "a name other than that of the installed module json"),
        ("numpy", "a name other than that of the installed module numpy"),
        ("my-noise", "lower-case letters, digits and _"),
        ("../up", "lower-case letters, digits and _"),
        ("MyNoise", "lower-case letters, digits and _"),
    ],
)
def test_a_name_that_is_taken_or_none_is_one_line(here, call, name, words):
    code, _, err = call("new", "noise", name)
    assert code == 2
    assert f"NAME={name!r} is not allowed; allowed: {words}" in err
    assert not list(here.iterdir())


def test_an_unknown_kind(call):
    code, _, err = call("new", "filters", "mine")
    assert code == 2
    assert "did you mean 'filter'?" in err


BAD = """
from dataclasses import dataclass, replace
from aoabench import Estimator, KalmanFilter
from aoabench.estimators.lines import LineLeastSquares

@dataclass(frozen=True)
class Off(LineLeastSquares):
    def __call__(self, batch, scenario, streams):
        found = super().__call__(batch, scenario, streams)
        return replace(found, position=found.position + [0.1, 0, 0])

@dataclass(frozen=True)
class Needs(KalmanFilter):
    pass
"""


def test_a_broken_rule_is_said_in_words_and_as_json(here, call):
    (here / "lab").mkdir()
    (here / "lab" / "off_x.py").write_text(BAD)
    code, out, _ = call("test", "lab/off_x.py")
    assert code == 1
    broken = [line for line in out.splitlines() if line.startswith("  broken")]
    assert [line.split()[1] for line in broken] == ["turned", "rotated"]
    assert "turning the world about the vertical changes the position by up to 0.178 m" in broken[0]
    assert "Needs (estimator): not tried: it needs measurement" in out
    code, out, _ = call("test", "lab/off_x.py", "--json")
    assert code == 1
    found = json.loads(out)
    assert (found["schema"], found["broken"]) == (1, 1)
    rules = {r["rule"]: r["status"] for r in found["plugins"][0]["rules"]}
    assert rules["turned"] == "broken"
    assert rules["permuted"] == "passed"
    assert call("test", "lab/off_x.py", "--skip", "turned,rotated")[0] == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no_such_module"], "plugins=[no_such_module]: cannot be imported"),
        (["no/such.py"], "PLUGIN='no/such.py' is not allowed; allowed: an existing file"),
        (["json"], "json: no plug-in in it"),
        (["json", "--skip", "permutes"], "--skip=permutes: no such rule; did you mean 'permuted'?"),
        (["json", "--config-dir", "no"], "--config-dir=no: no such folder"),
    ],
)
def test_mistakes_are_one_line(here, call, words, message):
    code, out, err = call("test", *words)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_presets_give_the_parameters(here):
    (here / "lab_x.py").write_text(BAD)
    (here / "conf" / "filter").mkdir(parents=True)
    (here / "conf" / "filter" / "needs.yaml").write_text(
        "needs: {_target_: lab_x.Needs, measurement: {_target_: aoabench.models.unit_vector.UnitVector}}\n"
    )
    found = plugins_of(module_of("lab_x"), "conf")
    assert [(one.name, one.lacks) for one in found] == [("filter=needs", ""), ("Off", "")]


def test_each_cell_of_a_sweep_has_the_defaults_of_a_plug_ins_class(here, call):
    """The first one too, composed before anything else has imported the plug-in."""
    assert call("new", "noise", "fresh_sweep")[0] == 0
    words = ["noise=fresh_sweep", "filter=[ekf_vmf]", "plugins=[fresh_sweep]"]
    cells = compose_cells([*words, "seed=1,2"], config_dir="conf")
    assert [cell.config["noise"]["scale_deg"] for cell in cells] == [4.0, 4.0]


def test_list_and_cfg_know_the_plug_ins_named(here, call):
    assert call("new", "noise", "fresh_listed")[0] == 0
    code, out, err = call("list", "fresh_listed", "--config-dir", "conf")
    assert (code, out, err.count("\n")) == (2, "", 1)
    named = "plugins=[fresh_listed]"
    assert f"named on the command line: '{named}'" in err
    code, out, err = call(
        "run", "noise=fresh_listed", named, "--config-dir", "conf", "--cfg", "job", "-p", "noise"
    )
    assert "scale_deg: 4.0" in out, err
    code, out, err = call("list", "fresh_listed", named, "--config-dir", "conf")
    assert code == 0, err
    assert "scale b of the errors" in out
    (example,) = (line for line in out.splitlines() if line.startswith("  example: "))
    assert example.endswith(f"noise=fresh_listed estimator=all reps=20 --config-dir conf '{named}'")
    assert "noise.scale_deg" in call("list", "noise.scale_deg", named, "--config-dir", "conf")[1]
    code, _, err = call("list", "fresh_listed", "reps=3")
    assert (code, "one NAME and plugins=[...]" in err) == (2, True)


def test_a_preset_of_ones_own_that_is_not_read_is_told(here, call):
    assert call("new", "estimator", "fresh_unread")[0] == 0
    hint = "; conf/estimator/fresh_unread.yaml is read with --config-dir conf\n"
    assert call("run", "estimator=[fresh_unread,ls]")[2].endswith(f"unknown preset{hint}")
    assert call("list", "fresh_unread")[2].endswith(f"no such group or preset{hint}")


def test_a_misspelt_name_of_many_is_one_short_line(call):
    err = call("run", "filter=[ekf_vmff]")[2]
    assert err.endswith("; did you mean 'ekf_vmf'? allowed: those of `aoabench list filter`\n")
    assert "allowed: all, anchor_mean, " in call("run", "estimator=[xyz]")[2]
