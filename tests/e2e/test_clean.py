"""In a checkout, commands leave what is committed as it is; with COMMIT=1 equal results are equal bytes."""

import shutil
import subprocess
from pathlib import Path

import pytest

from aoabench.cli.main import main
from aoabench.studies import reproduce

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="no git here")


def git(*words):
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "core.autocrlf=false"]
    return subprocess.run([*command, *words], capture_output=True, text=True, check=True).stdout


def call(*words):
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    assert stop.value.code == 0, words


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A small checkout of one study with a committed table, its figure and the page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reproduce, "all_studies", lambda: ["le2021"])
    for name in (".gitignore", "README.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "results" / "tables").mkdir(parents=True)
    table = Path("results") / "tables" / "le2021_fig5.parquet"
    shutil.copy(ROOT / table, tmp_path / table)
    monkeypatch.setenv("COMMIT", "1")
    call("report", "-q")
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", "as it is")
    monkeypatch.delenv("COMMIT")
    return tmp_path


def test_commands_leave_the_checkout_clean_and_commit_writes_the_same_bytes(checkout, monkeypatch):
    committed = git("ls-files").split()
    for name in ("figures/le2021_fig5.png", "report/index.html", "report/verdicts.parquet"):
        assert f"results/{name}" in committed
    call("reproduce", "--only", "fig5", "-q")
    assert (checkout / "results" / "quick" / "figures" / "le2021_fig5.png").exists()
    assert (checkout / "results" / "quick" / "report" / "index.html").exists()
    call("report", "-q")
    call("report", "--format", "svg", "--scale", "quick", "-q")
    assert (checkout / "results" / "draft" / "figures" / "le2021_fig5.png").exists()
    words = ["scenario=bs_grid", "noise=ae_normal", "estimator=[ls,ls_lines]", "runner.n_jobs=1"]
    call("run", *words, "reps=2", "-q")
    call("compare", "results/raw/run", "-q")
    call("replay", "results/raw/run", "--replication", 0, "--estimator", "ls", "-q")
    assert git("status", "--porcelain") == ""
    monkeypatch.setenv("COMMIT", "1")
    call("report", "-q")
    assert git("status", "--porcelain") == ""


def test_a_folder_without_tables_is_one_line(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["report", "--results", str(tmp_path / "nothing")])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{tmp_path / 'nothing' / 'tables'}: no tables here" in line
    assert not (tmp_path / "nothing").exists()
