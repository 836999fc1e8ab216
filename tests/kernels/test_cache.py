"""Compiled kernels are kept in a folder named after the source of all kernels."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

import aoabench
from aoabench.kernels import cache

# a kernel that uses a shared piece, and a process that loads it and prints how many functions numba
# compiled, what the kernel computes and what was said
TINY = """
from aoabench.kernels.compile import kernel
from aoabench.kernels.small import solve


@kernel("f8(f8)")
def tiny(g):
    return solve(1.0, 0.0, 1.0, 0.0, 0.0, 1.0, g, 2.0, 3.0)[0]
"""
LOAD = """
import numba
from numba.core import event
from aoabench.kernels.loading import load, prepare

seen, before, said = event.RecordingListener(), numba.config.CACHE_DIR, []
with event.install_listener("numba:compile", seen):
    prepare("kernels.tiny", said.append)
assert numba.config.CACHE_DIR == before
print(len(seen.buffer), load("kernels.tiny").tiny(5.0), *said)
"""


def package(folder):
    """A copy of the package below `folder`, with the kernel `tiny`."""
    source = Path(aoabench.__file__).parent
    shutil.copytree(source, folder / "aoabench", ignore=shutil.ignore_patterns("__pycache__"))
    kernels = folder / "aoabench" / "kernels"
    (kernels / "tiny.py").write_text(TINY)
    return kernels


def started(folder, home, script=LOAD, **environment):
    """A process that runs `script` on the package in `folder`, with its cache below `home`."""
    environment = {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(folder), **environment}
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-B", "-c", script],
        env=kept | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
    )


def loaded(process):
    """How many functions a process of `started` compiled, its kernel's result, and its lines."""
    out, error = process.communicate()
    assert process.returncode == 0, error
    compiled, value, *said = out.split(maxsplit=2)
    return int(compiled), float(value), "".join(said)


def state(folder):
    """Every file below a folder, with its inode and time."""
    return {p: (p.stat().st_ino, p.stat().st_mtime_ns) for p in folder.rglob("*") if p.is_file()}


def test_a_change_of_a_shared_piece_is_compiled_and_nothing_else_is(tmp_path):
    """`solve` is no part of the file that defines the kernel."""
    kernels, home = package(tmp_path), tmp_path / "home"
    compiled, value, said = loaded(started(tmp_path, home))
    assert compiled > 0
    assert said.startswith("compiling kernels")
    (first,) = (home / "aoabench").iterdir()
    before = state(home)
    assert loaded(started(tmp_path, home)) == (0, value, "")
    assert state(home) == before

    small = kernels / "small.py"
    times = small.stat()
    text = small.read_text()
    assert "x = g0 / a00" in text
    small.write_text(text.replace("x = g0 / a00", "x = g1 / a00"))
    os.utime(small, ns=(times.st_atime_ns, times.st_mtime_ns))
    compiled, changed, _ = loaded(started(tmp_path, home))
    assert compiled > 0
    assert (value, changed) == (5.0, 2.0)
    assert len(list((home / "aoabench").iterdir())) == 2
    assert {p: s for p, s in state(home).items() if first in p.parents} == before


def test_the_digest_knows_every_kernel_file_and_the_outcomes(tmp_path, monkeypatch):
    kernels = package(tmp_path)
    monkeypatch.setattr(cache, "__file__", str(kernels / "cache.py"))
    seen = [cache.source_digest()]
    assert cache.source_digest() == seen[0]
    for file in sorted(kernels.glob("*.py")):
        file.write_text(file.read_text() + "\n# changed\n")
        seen.append(cache.source_digest())
    (kernels / "another.py").write_text("")
    seen.append(cache.source_digest())
    monkeypatch.setattr(cache, "Outcome", list(cache.Outcome)[:-1])
    seen.append(cache.source_digest())
    assert len(set(seen)) == len(seen) > 10


def test_two_processes_at_once_and_a_package_that_cannot_be_written(tmp_path):
    package(tmp_path)
    home = tmp_path / "home"
    home.mkdir()
    folders = [p for p in (tmp_path / "aoabench").rglob("*") if p.is_dir()]
    for folder in folders:
        folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        first, second = started(tmp_path, home), started(tmp_path, home)
        assert loaded(first)[1] == loaded(second)[1] == 5.0
        assert loaded(started(tmp_path, home)) == (0, 5.0, "")
    finally:
        for folder in folders:
            folder.chmod(stat.S_IRWXU)
    assert not list((tmp_path / "aoabench").rglob("*.nb?"))


def test_workers_take_what_is_compiled(tmp_path):
    """Processes and threads of joblib compile nothing and write nothing."""
    script = LOAD + (
        "def of_worker():\n"
        "    from aoabench.kernels.loading import load\n"
        "    import numba, numba.core.event as event\n"
        "    seen = event.RecordingListener()\n"
        "    with event.install_listener('numba:compile', seen):\n"
        "        load.cache_clear()\n"
        "        K = load('kernels.tiny')\n"
        "    return len(seen.buffer), len(K.tiny.overloads)\n"
        "import joblib\n"
        "for backend in ('loky', 'threading'):\n"
        "    jobs = [joblib.delayed(of_worker)() for _ in range(2)]\n"
        "    assert joblib.Parallel(2, backend=backend)(jobs) == [(0, 1)] * 2\n"
    )
    package(tmp_path)
    home = tmp_path / "home"
    loaded(started(tmp_path, home))
    before = state(home)
    assert loaded(started(tmp_path, home, script))[0] == 0
    assert state(home) == before


def test_what_cannot_be_written_is_said_once_and_temporary_files_serve(tmp_path):
    """A file in the place of the cache's folder."""
    package(tmp_path)
    home, temporary = tmp_path / "home", tmp_path / "temporary"
    home.write_text("")
    temporary.mkdir()
    compiled, value, said = loaded(started(tmp_path, home, TMPDIR=str(temporary)))
    assert compiled > 0
    assert said.count("compiling") == said.count(f"{home} cannot be written") == 1
    assert str(temporary) in said
    assert loaded(started(tmp_path, home, TMPDIR=str(temporary))) == (0, value, "")


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """A cache folder that cannot be written, and a folder for temporary files."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path))
    return tmp_path


def test_a_folder_among_temporary_files_that_others_can_write_is_not_used(nowhere, monkeypatch):
    own = nowhere / f"aoabench-{os.getuid()}"
    assert cache.kept() == (own / cache.source_digest(), nowhere / "file")
    assert stat.S_IMODE(own.stat().st_mode) == 0o700
    own.chmod(0o777)
    assert cache.kept() == (None, nowhere / "file")
    shutil.rmtree(own)
    (nowhere / "elsewhere").mkdir(mode=0o700)
    own.symlink_to(nowhere / "elsewhere")
    assert cache.kept().folder is None
    own.unlink()
    monkeypatch.setattr(cache, "_user_id", lambda: os.getuid() + 1)
    (nowhere / f"aoabench-{os.getuid() + 1}").mkdir(mode=0o700)
    assert cache.kept().folder is None, "it belongs to another user"


def test_the_folder_follows_the_environment(tmp_path, monkeypatch):
    digest = cache.source_digest()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache.kept().folder == tmp_path / "xdg" / "aoabench" / digest
    assert cache.kept(str(tmp_path / "numba")).folder == tmp_path / "numba" / "aoabench" / digest
    monkeypatch.setenv("HOME", str(tmp_path))
    for stated in ("", "relative"):  # a relative path is not valid
        monkeypatch.setenv("XDG_CACHE_HOME", stated)
        assert cache.kept().folder == tmp_path / ".cache" / "aoabench" / digest
