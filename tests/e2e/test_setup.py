"""`make setup` with and without uv, with stand-ins for python and uv that write down their words."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = """#!/bin/bash
echo "python $*" >> "$LOG"
if [ "$2" = venv ]; then mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; fi
"""
UV = """#!/bin/bash
echo "uv $*" >> "$LOG"
exit $UV_STATUS
"""
LOCKED, EDITABLE = "--require-hashes -r requirements.lock", "--no-deps --no-build-isolation -e ."
WITH_PIP = "python -m pip install --quiet --disable-pip-version-check --no-compile "
WITH_UV = "uv pip install --quiet --python .venv/bin/python "
COMPILE = "python -m compileall -qq -j 0 .venv/lib"
pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def installed(folder, uv):
    """The commands of `make setup` after the one that makes the environment; `uv`: the status with
    which uv ends, None without uv.
    """
    tools = folder / "tools"
    tools.mkdir()
    for name in ("bash", "cp", "mkdir", "touch"):
        (tools / name).symlink_to(shutil.which(name))
    for name, text in (("python3", PYTHON), ("uv", UV)):
        if name != "uv" or uv is not None:
            (tools / name).write_text(text)
            (tools / name).chmod(0o755)
    for name in ("Makefile", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    log = folder / "log"
    environment = {"PATH": str(tools), "LOG": str(log), "UV_STATUS": str(uv)}
    done = subprocess.run(
        [shutil.which("make"), "setup", f"PYTHON={tools}/python3"],
        cwd=folder, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (folder / ".venv" / ".ready").exists()
    first, *rest = log.read_text().splitlines()
    assert first == "python -m venv .venv"
    return rest


def test_with_uv(tmp_path):
    assert installed(tmp_path, 0) == [WITH_UV + LOCKED, COMPILE, WITH_UV + EDITABLE]


def test_without_uv(tmp_path):
    assert installed(tmp_path, None) == [WITH_PIP + LOCKED, COMPILE, WITH_PIP + EDITABLE]


def test_pip_takes_over_where_uv_fails(tmp_path):
    """uv does not know the index that pip's settings name, for one."""
    both = [[WITH_UV + words, WITH_PIP + words] for words in (LOCKED, EDITABLE)]
    assert installed(tmp_path, 1) == [*both[0], COMPILE, *both[1]]


def test_what_fails_is_not_ready(tmp_path):
    """The environment is set up again by the next command."""
    with pytest.MonkeyPatch.context() as patch:
        failing = PYTHON + '[ "$2" != pip ]\n'
        patch.setitem(globals(), "PYTHON", failing)
        with pytest.raises(AssertionError):
            installed(tmp_path, None)
    assert not (tmp_path / ".venv" / ".ready").exists()
