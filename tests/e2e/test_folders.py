"""Folders of runs: every name that the file system allows, and no folder that holds anything else."""

import json
import os
import stat
from pathlib import Path

import pytest

import aoabench
from aoabench.cli.main import main
from aoabench.config.compose import compose_cells
from aoabench.config.overrides import read
from aoabench.errors import UserError
from aoabench.store import tables
from aoabench.store.claim import MARKER, claim

SMALL = ["estimator=[ls]", "estimator.ls.engine=numpy", "scenario.steps=2", "reps=2", "runner.n_jobs=1"]  # fmt: skip

RUN = [
    " lead, trail ",
    'ünï 日本#=it\'s "x"',
    "[x]*?{b}(c\n\t\x1b$H%s{0}\\",
    "a:b",
    "~nobody",
    "2026",
]
COMPOSED = [*RUN, " lead", "trail ", " ", "ünï", "a,b", "x=y", "a#b", "it's", "[x]*?", "[x]", "{b}", "{b: 1}", "(c", "s3:", "1e5",
            "null", "true", "\\", "a\\", "'", "-q", "x" * 255, "a/./b", "..x", "+x", "a+b@c&d;e|f<g>h^i`j!",
            "range(1,3)", "choice(a,b)", "glob(*)", "file://x"]  # fmt: skip


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The working folder of the tests, in which the names are relative."""
    before, folder = os.getcwd(), tmp_path_factory.mktemp("home")
    os.chdir(folder)
    yield folder
    os.chdir(before)


def made(home):
    """The folders of runs below `home`, which hold a marker."""
    return {path.parent.relative_to(home).as_posix() for path in home.rglob(MARKER)}


@pytest.mark.parametrize("name", RUN, ids=ascii)
def test_a_folder_of_any_name_is_run_read_and_collected(name, home):
    before = made(home)
    frame = aoabench.run(*SMALL, out=name)
    assert made(home) - before == {Path(name).as_posix()}
    assert aoabench.load(name).equals(frame)
    assert "estimator" in aoabench.compare(name)
    tables.collect(home / name)
    assert aoabench.load(home / name).equals(frame)


@pytest.mark.parametrize("name", [" a:ü,b ", "./~nobody"])
def test_the_command_line_does_the_same(name, home, capsys):
    for _ in range(2):
        with pytest.raises(SystemExit) as stop:
            main(["run", *SMALL, f"runner.out={name}", "--json"])
        found = json.loads(capsys.readouterr().out)
        assert (stop.value.code, found["computed"] + found["reused"]) == (0, 2)
        assert Path(found["out"]).samefile(home / name)


@pytest.mark.parametrize("name", COMPOSED, ids=ascii)
def test_the_shells_word_is_the_name(name):
    for setting in read([f"runner.out={name}", f"++runner.out={name}"], sweep=False):
        assert setting.value == name
        assert not setting.is_sweep


@pytest.mark.parametrize("name", ["${x}", "${oc.env:HOME}", "'q'", '"q"', "a\\$\\{b\\}"])
def test_from_python_no_name_has_a_meaning(name, home):
    (cell,) = compose_cells(SMALL, out=name)
    assert cell.runner.out == name
    (cell,) = compose_cells(SMALL, out=f"~{name}")
    assert cell.runner.out == str(home / f"~{name}")


def test_what_the_shells_word_may_mean():
    """Quotes are removed, keys are put in, and a leading ~ is the home folder."""
    given = {
        "'a, b'": "a, b",
        '"it\'s"': "it's",
        "r/${seed}": "r/7",
        "~/r": os.path.expanduser("~/r"),
        "~": os.path.expanduser("~"),
        "a\\ b": "a\\ b",
        " a,b ": " a,b ",
    }
    for word, meant in given.items():
        (cell,) = compose_cells([*SMALL, "seed=7", f"runner.out={word}"], sweep=False)
        assert cell.runner.out == meant
    with pytest.raises(UserError, match="cannot be swept"):
        compose_cells([*SMALL, "runner.out=a,b"])  # with -m
    with pytest.raises(UserError, match=r"^runner.out='' is not allowed"):
        compose_cells([*SMALL, "runner.out="])
    with pytest.raises(UserError, match=r"^runner.out='' is not allowed"):
        compose_cells(SMALL, out="")


def test_a_zero_byte_is_refused_in_one_line(home):
    with pytest.raises(UserError, match=r"^runner.out='a\\x00b' cannot be written: .*allowed: a"):
        aoabench.run(*SMALL, out="a\0b")


def test_a_folder_of_configs_of_any_name(home):
    for name in ("a,b#x=y ", "a:b [x]", "ünï %20? it's"):
        (home / "c" / name / "noise").mkdir(parents=True)
        text = "_target_: aoabench.noise.angular.VonMisesFisher\nsigma_deg: 7\n"
        (home / "c" / name / "noise" / "mine.yaml").write_text(text)
        (cell,) = compose_cells([*SMALL, "noise=mine"], config_dir=f"c/{name}")
        assert cell.noise.sigma_deg == 7


def occupied(folder):
    folder.mkdir(parents=True)
    (folder / "summary.parquet").write_text("mine")
    (folder / "b.txt").write_text("mine")
    return folder


def test_a_folder_that_holds_anything_else_is_refused(tmp_path, monkeypatch, capsys):
    """From Python, the command line and a config alike, before anything is written."""
    monkeypatch.chdir(tmp_path)
    folder = occupied(tmp_path / "work")
    says = "holds 'b.txt' and 'summary.parquet'"
    with pytest.raises(UserError, match=rf"runner.out='{folder}' is not allowed; .* {says}"):
        aoabench.run(*SMALL, out=folder)
    with pytest.raises(SystemExit) as stop:
        main(["run", *SMALL, "runner.out=work"])
    line = capsys.readouterr().err
    assert stop.value.code == 2
    assert f"runner.out='work' is not allowed; allowed: a new or empty folder, or one of runs; this one {says}" in line  # fmt: skip
    (tmp_path / "conf" / "runner").mkdir(parents=True)
    (tmp_path / "conf" / "runner" / "x.yaml").write_text("out: .\n")
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as stop:
        main(["run", *SMALL[:-1], "runner=x", "--config-dir", str(tmp_path / "conf")])
    assert stop.value.code == 2
    assert "runner.out='.' is not allowed" in capsys.readouterr().err
    assert {path.name for path in folder.iterdir()} == {"summary.parquet", "b.txt"}
    assert (folder / "summary.parquet").read_text() == "mine"


def test_folders_that_are_a_runs(tmp_path):
    """A new one, an empty one, one with hidden files only, one with parts and no marker, and one
    with a marker and other files.
    """
    for i, names in enumerate([[], [".gitkeep", ".lock"], ["parts/", "x"], [MARKER, "x"]]):
        folder = tmp_path / str(i)
        folder.mkdir()
        for name in names:
            (folder / name).mkdir() if name.endswith("/") else (folder / name).write_text("")
        claim(folder, "x")
        claim(folder, "x")
        assert (folder / MARKER).exists()
    assert json.loads((tmp_path / "0" / MARKER).read_text()) == {"format": 1}
    assert stat.S_ISREG((tmp_path / "0" / MARKER).stat().st_mode)
    folder = tmp_path / "file"
    folder.mkdir()
    (folder / "parts").write_text("")
    with pytest.raises(UserError, match="this one holds 'parts'"):
        claim(folder, "x")
    for name in ("\x1b[31m", "y", "z"):
        (folder / name).write_text("")
    with pytest.raises(UserError, match=r"holds '\\x1b\[31m' and 'parts' and 2 more"):
        claim(folder, "x")


def config(folder, text):
    (folder / "conf" / "experiment").mkdir(parents=True)
    (folder / "conf" / "experiment" / "x.yaml").write_text(f"# @package _global_\n{text}")
    return str(folder / "conf")


def test_a_config_leads_outside_by_no_link(tmp_path, monkeypatch):
    work = tmp_path / "work"
    (work / "deep").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (work / "link").symlink_to(tmp_path / "elsewhere")
    (work / "inside").symlink_to(work / "deep")
    monkeypatch.chdir(work)
    folder = config(tmp_path, "runner: {out: link/deep/x}\n")
    with pytest.raises(
        UserError, match=r"^runner.out='link/deep/x' is not allowed; .* below the w"
    ):
        compose_cells([*SMALL, "experiment=x"], config_dir=folder)
    (typed,) = compose_cells([*SMALL, "experiment=x", "runner.out=link/x"], config_dir=folder)
    assert typed.runner.out == "link/x"
    (tmp_path / "conf" / "experiment" / "x.yaml").write_text(
        "# @package _global_\nrunner: {out: inside/x}\n"
    )
    (cell,) = compose_cells([*SMALL, "experiment=x"], config_dir=folder)
    assert cell.runner.out == "inside/x"


@pytest.mark.parametrize(("text", "says"), [
    ("reps: 100000000\n", "reps=100000000 is not allowed; .* <= 1e"),
    ("hydra: {sweeper: {params: {reps: '3,100000000'}}}\n", "reps=100000000 is not allowed"),
    ("until: {metric: nees, se: 1, max_reps: 100000000}\n", "until.max_reps=100000000 is not allowed"),
    ("runner: {n_jobs: 100000}\n", "runner.n_jobs=100000 is not allowed; .* <= "),
])  # fmt: skip
def test_a_config_asks_for_no_endless_work(text, says, tmp_path):
    words = [word for word in SMALL if word.partition("=")[0] not in ("reps", "runner.n_jobs")]
    with pytest.raises(UserError, match=says):
        compose_cells([*words, "experiment=x"], config_dir=config(tmp_path, text))


def test_the_command_line_may_ask_for_more_replications_but_not_for_any_number_of_processes():
    words = [word for word in SMALL if word.partition("=")[0] not in ("reps", "runner.n_jobs")]
    assert compose_cells([*words, "reps=100000000"])[0].reps == 100_000_000
    assert compose_cells([*words, "runner.n_jobs=64"])[0].runner.n_jobs == 64
    with pytest.raises(UserError, match=r"^runner.n_jobs=100000 is not allowed"):
        compose_cells([*words, "runner.n_jobs=100000"])
    dask = ["runner=dask", "runner.address=tcp://127.0.0.1:8786", "runner.n_jobs=5000"]
    assert compose_cells([*words, *dask])[0].runner.n_jobs == 5000, "the cluster's threads"
