"""Compiled kernels are kept in a folder named after the source of all kernels."""

import ast
import os
import shutil
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import aoabench
from aoabench import resources
from aoabench.kernels import cache
from tests.helpers import Msvcrt

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


def kept(stated=""):
    return cache.kept(stated, "aoabench.kernels.small")


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


def test_a_second_clone_takes_what_the_first_one_compiled(tmp_path):
    """Another folder, and files that are newer."""
    home, clones = tmp_path / "home", [tmp_path / "first", tmp_path / "second"]
    for clone in clones:
        os.utime(package(clone) / "tiny.py", (1e9, 1e9) if clone is clones[0] else None)
    compiled, value, _ = loaded(started(clones[0], home))
    assert compiled > 0
    assert loaded(started(clones[1], home)) == (0, value, "")


def test_the_digest_knows_the_module_its_imports_and_the_outcomes(tmp_path, monkeypatch):
    """`kalman` imports `square_root`, which imports `limits`; it does not import `discrepancy`."""
    kernels = package(tmp_path)
    monkeypatch.setattr(cache, "__file__", str(kernels / "cache.py"))
    seen = [cache.source_digest("kernels.kalman")]
    assert cache.source_digest("kernels.kalman") == seen[0] != cache.source_digest("kernels.tiny")
    for name in ("kalman", "compile", "directions", "small", "square_root", "limits"):
        file = kernels / f"{name}.py"
        file.write_text(file.read_text() + "\n# changed\n")
        seen.append(cache.source_digest("kernels.kalman"))
    (kernels / "discrepancy.py").write_text("# changed")
    (kernels / "tiny.py").write_text("from aoabench.maths.geometry import LIGHT\n" + TINY)
    geometry, tiny = kernels.parent / "maths" / "geometry.py", cache.source_digest("kernels.tiny")
    geometry.write_text(geometry.read_text() + "\n# changed\n")
    assert cache.source_digest("kernels.tiny") != tiny
    assert cache.source_digest("kernels.kalman") == seen[-1]
    monkeypatch.setattr(cache, "Outcome", list(cache.Outcome)[:-1])
    seen.append(cache.source_digest("kernels.kalman"))
    assert len(set(seen)) == len(seen) == 8


def test_kernels_import_nothing_of_ours_but_kernels_maths_and_types():
    """The digest covers no other file."""
    for file in Path(cache.__file__).parent.glob("*.py"):
        if file.stem in ("cache", "loading", "helpers"):  # they hold no code that is compiled
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            ours = [n for n in names if n.split(".")[0] == "aoabench"]
            known = ("aoabench.kernels", "aoabench.maths.", "aoabench.types")
            assert all(n.startswith(known) for n in ours), (file, ours)
            assert getattr(node, "level", 0) == 0, file


def test_the_folder_of_a_module_stays_when_another_one_changes(tmp_path):
    kernels, home = package(tmp_path), tmp_path / "home"
    loaded(started(tmp_path, home))
    before = state(home)
    with (kernels / "discrepancy.py").open("a") as file:
        file.write("# changed")
    assert loaded(started(tmp_path, home))[0] == 0
    assert state(home) == before


def test_two_processes_at_once_and_a_package_that_cannot_be_written(tmp_path):
    package(tmp_path)
    home = tmp_path / "home"
    home.mkdir()
    folders = [p for p in (tmp_path / "aoabench").rglob("*") if p.is_dir()]
    for folder in folders:
        folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        first, second = started(tmp_path, home), started(tmp_path, home)
        (some, *values), (others, *more) = loaded(first)[:2], loaded(second)[:2]
        assert values == more == [5.0]
        assert min(some, others) == 0 < max(some, others), "one waited for the other"
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
        "        K.tiny.ready()\n"
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
    inner = f"small-{cache.source_digest('kernels.small')}"
    assert kept() == (own / inner, nowhere / "file")
    assert stat.S_IMODE(own.stat().st_mode) == 0o700
    own.chmod(0o777)
    assert kept() == (None, nowhere / "file")
    shutil.rmtree(own)
    (nowhere / "elsewhere").mkdir(mode=0o700)
    own.symlink_to(nowhere / "elsewhere")
    assert kept().folder is None
    own.unlink()
    monkeypatch.setattr(cache, "_user_id", lambda: os.getuid() + 1)
    (nowhere / f"aoabench-{os.getuid() + 1}").mkdir(mode=0o700)
    assert kept().folder is None, "it belongs to another user"


def test_the_folder_follows_the_environment(tmp_path, monkeypatch):
    digest = f"small-{cache.source_digest('kernels.small')}"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert kept().folder == tmp_path / "xdg" / "aoabench" / digest
    assert kept(str(tmp_path / "numba")).folder == tmp_path / "numba" / "aoabench" / digest
    monkeypatch.setenv("HOME", str(tmp_path))
    for stated in ("", "relative"):  # a relative path is not valid
        monkeypatch.setenv("XDG_CACHE_HOME", stated)
        assert kept().folder == tmp_path / ".cache" / "aoabench" / digest


def test_helpers_compile_for_the_cache_and_end_with_the_context(tmp_path, monkeypatch):
    """One for each processor but this process's, and none for nothing."""
    kernels, script = package(tmp_path), (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from aoabench.kernels import helpers\n"
        "helpers._processors = lambda: 2\n"
        "started, begin = [], helpers._started\n"
        "helpers._started = lambda k: started.append(begin(k)) or started[-1]\n"
        "with helpers.helping([]):\n"
        "    assert not started\n"
        "with helpers.helping([('aoabench.kernels.tiny', 'tiny'), ('aoabench.kernels.tiny', 'x')]):\n"
        "    (helper,) = started\n"
        "    with helpers.helping([('aoabench.kernels.tiny', 'tiny')]):\n"
        "        assert started == [helper]\n"
        "    while not any(f.stat().st_size for f in Path(sys.argv[1]).rglob('tiny.lock')):\n"
        "        assert helper.poll() is None\n"
        "        time.sleep(0.05)\n"
        "assert helper.poll() is not None\n"
        "print(0, 0.0)\n"
    )  # fmt: skip
    home = tmp_path / "home"
    script = script.replace("sys.argv[1]", repr(str(home)))
    (kernels / "tiny.py").write_text(TINY + "\n\nclass x:\n    ready = input\n")
    loaded(started(tmp_path, home, script))
    assert loaded(started(tmp_path, home)) == (0, 5.0, "")


def test_windows_waits_for_a_compiling_process_and_notes_the_kernel_once(tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "fcntl", None)
    monkeypatch.setattr(resources, "msvcrt", Msvcrt())
    order = []

    def second():
        with cache.alone(tmp_path, "tiny"):
            order.append("second")

    with cache.alone(tmp_path, "tiny"):
        thread = threading.Thread(target=second, daemon=True)
        thread.start()
        thread.join(0.3)
        order.append("first")
        assert not cache.noted(tmp_path, "tiny")
    thread.join(60)
    assert order == ["first", "second"]
    assert cache.noted(tmp_path, "tiny")
    assert (tmp_path / "tiny.lock").stat().st_size < 100
