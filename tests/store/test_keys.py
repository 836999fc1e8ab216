"""What a key covers: each line of docs/explanation/keys.md, as a program or a plug-in that differs in one thing.

`STALE` cases differ in something that decides the numbers: the second run must not reuse the first
one's. `SAME` cases differ in nothing that does: it must.
"""

import ast
import copy
import dataclasses
import functools
import importlib
import os
import sys
import textwrap
from dataclasses import InitVar, dataclass, field
from pathlib import Path

import numpy as np
import pytest

import aoabench
from aoabench import loaded
from aoabench.config.adopt import as_estimator
from aoabench.config.compose import compose_cells
from aoabench.config.presets import options
from aoabench.engine import runner, tasks
from aoabench.engine.block import run_block
from aoabench.errors import RunError, UserError
from aoabench.store import definitions, keys
from aoabench.store.definitions import parsed
from aoabench.store.keys import RunKeys
from aoabench.store.live import NotPlain, changes, plain
from aoabench.store.reach import _is_aside, reach

HEAD = """
    import os
    from dataclasses import dataclass, field, InitVar
    from pathlib import Path
    import numpy as np
    import aoabench
    from aoabench import Estimates, Estimator


    def fixes(batch, x):
        shape = batch.azimuth.shape[:2]
        return Estimates(np.full((*shape, 3), float(x)), None, None, np.zeros(shape, dtype=np.int8))


"""
PLUG = """
    @dataclass(frozen=True)
    class Constant(Estimator):
        {fields}

        def __call__(self, batch, scenario, streams):
            return fixes(batch, {value})
"""


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Write modules that are imported anew, as by a new process, whenever `fresh` is called."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    class Modules:
        def write(self, name, text):
            path = tmp_path / f"{name.replace('.', '/')}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(textwrap.dedent(text))

        def fresh(self):
            for name in set(sys.modules) - before:
                file = getattr(sys.modules[name], "__file__", None) or ""
                if str(tmp_path) in file or not file:
                    del sys.modules[name]
            importlib.invalidate_caches()
            return importlib.import_module("plug")

    yield Modules()
    Modules().fresh() if (tmp_path / "plug.py").exists() else None
    for name in set(sys.modules) - before:
        if str(tmp_path) in (getattr(sys.modules[name], "__file__", None) or ""):
            del sys.modules[name]


BASE = compose_cells(["noise=vmf", "filter=[]", "estimator=[ls]"])[0]


def keyed(obj, node, plugins=()):
    """The key of an estimator, and the notes; without `node` it is given from Python."""
    nodes = {"filter": None, "estimator": {"mine": node} if node else None}
    config = {**BASE.config, **nodes}
    obj = as_estimator(obj, "estimators.mine")
    cell = dataclasses.replace(BASE, estimators={"mine": obj}, config=config, plugins=plugins)
    found = RunKeys.of([cell])
    return found.parts[cell.id]["mine"], found.notes


def configured():
    """The key of plug.Constant as from a preset, and the notes."""
    obj = sys.modules["plug"].Constant()
    node = {"_target_": "plug.Constant", **dataclasses.asdict(obj)}
    return keyed(obj, node, ("plug",))


def given(obj):
    """The key of an object as from Python, and the notes."""
    return keyed(obj, None)


# --- from the command line: source and files before and after ------------------------------------

PLAIN = HEAD + PLUG.format(fields="gain: float = 1.0", value="self.gain")
FILE = HEAD + PLUG.format(fields="path: str = 'w.txt'", value="Path(self.path).read_text()")
BESIDE = HEAD + PLUG.format(
    fields="factor = 1", value="Path(__file__).with_name('w.txt').read_text()"
)
STATED = HEAD + PLUG.format(fields="files = (Path('w.txt'),)", value="Path('w.txt').read_text()")
ENVIRONMENT = HEAD + PLUG.format(fields="", value="os.environ.get('AOA_TEST', 1)")
BY_NAME = HEAD + PLUG.format(fields="", value="__import__('helper').K")
IMPORTLIB = (
    HEAD
    + "    import importlib\n"
    + PLUG.format(fields="", value="importlib.import_module('helper').K")
)
HELPER = HEAD + "    from helper import value\n" + PLUG.format(fields="", value="value()")
DEEP = HEAD + PLUG.format(fields="", value="__import__").replace(
    "return fixes(batch, __import__)",
    "from pack.inner import value\n            return fixes(batch, value())",
)
STAR = HEAD + "    from helper import *\n" + PLUG.format(fields="", value="value()")
GLOBAL = HEAD + "    K = 1.0\n" + PLUG.format(fields="", value="K")
MADE = HEAD + "    K = np.ones(3).sum()\n" + PLUG.format(fields="", value="K")
BRANCH = HEAD + "    if True:\n        K = 1.0\n" + PLUG.format(fields="", value="K")
VALUE = "K = 1.0\n\n\ndef value():\n    return K\n"

STALE = {
    "a default": (PLAIN, {}, ("plug", "= 1.0", "= 2.0")),
    "a method": (PLAIN, {}, ("plug", "self.gain)", "2 * self.gain)")),
    "a function": (PLAIN, {}, ("plug", "float(x)", "-float(x)")),
    "a global": (GLOBAL, {}, ("plug", "K = 1.0", "K = 2.0")),
    "a global that is computed": (MADE, {}, ("plug", "np.ones(3)", "np.ones(4)")),
    "a global in a branch": (BRANCH, {}, ("plug", "K = 1.0", "K = 2.0")),
    "a helper": (HELPER, {"helper": VALUE}, ("helper", "K = 1.0", "K = 2.0")),
    "a helper of a helper": (
        HELPER,
        {"helper": "from other import value\n", "other": VALUE},
        ("other", "K = 1.0", "K = 2.0"),
    ),
    "an import inside a method": (
        DEEP,
        {
            "pack.__init__": "",
            "pack.inner": "from . import other\n\n\ndef value():\n    return other.value()\n",
            "pack.other": VALUE,
        },
        ("pack.other", "K = 1.0", "K = 2.0"),
    ),
    "import *": (STAR, {"helper": VALUE}, ("helper", "K = 1.0", "K = 2.0")),
    "an import for its effect": (
        HEAD + "    import helper\n" + PLUG.format(fields="", value="1"),
        {"helper": "STATE = []\nSTATE.append(1)\n"},
        ("helper", "(1)", "(2)"),
    ),
    "a file in a parameter": (FILE, {"w.txt": "1"}, ("w.txt", "1", "2")),
    "a file in `files`": (STATED, {"w.txt": "1"}, ("w.txt", "1", "2")),
}


def write(modules, plug, files):
    modules.write("plug", plug)
    for name, text in files.items():
        if name.endswith(".txt"):
            Path(name).write_text(text)
        else:
            modules.write(name, text)


def edit(change):
    name, old, new = change
    path = Path(name if name.endswith(".txt") else f"{name.replace('.', '/')}.py")
    text = path.read_text()
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("case", STALE)
def test_another_key(case, modules):
    plug, files, change = STALE[case]
    write(modules, plug, files)
    modules.fresh()
    first, notes = configured()
    assert not notes
    modules.fresh()
    assert configured() == (first, ()), "the same code in a new process has the same key"
    edit(change)
    modules.fresh()
    second, notes = configured()
    assert not notes
    assert second != first


SAME = {
    "a docstring": ("class Constant(Estimator):", 'class Constant(Estimator):\n    "Other."\n'),
    "a comment": ("K = 1.0", "# why\n\nK = 1.0"),
    "an annotation": ("def fixes(batch, x):", "def fixes(batch: object, x: 'float') -> None:"),
    "an unused function": ("K = 1.0", "K = 1.0\n\n\ndef unused():\n    return 3\n"),
    "an unused class": ("K = 1.0", "K = 1.0\n\n\nclass Unused:\n    x = 3\n"),
    "a message": ("'no'", "'other words'"),
    "what is printed": ("print('a')", "print('b')"),
}


@pytest.mark.parametrize("case", SAME)
def test_the_same_key(case, modules):
    text = textwrap.dedent(GLOBAL).replace(
        "    return fixes(batch, K)",
        "    if K < 0:\n            raise ValueError('no')\n        print('a')\n        return fixes(batch, K)",
    )
    modules.write("plug", text)
    modules.fresh()
    first = configured()
    old, new = SAME[case]
    assert old in text
    modules.write("plug", text.replace(old, new))
    modules.fresh()
    assert configured() == first


NEVER = {
    "a file beside the plug-in": (BESIDE, {"w.txt": "1"}, "reads a file"),
    "a file beside the plug-in, and one that is not meant": (
        BESIDE.replace("factor = 1", "other: str = 'x.txt'"),
        {"w.txt": "1", "x.txt": "1"},
        "reads a file (__file__)",
    ),
    "an environment variable": (ENVIRONMENT, {}, "reads environment variables"),
    "importlib": (IMPORTLIB, {"helper": VALUE}, "uses importlib in plug.py"),
    "__import__": (BY_NAME, {"helper": VALUE}, "uses __import__ in plug.py"),
    "exec": (HEAD + PLUG.format(fields="", value="eval('1')"), {}, "uses eval in plug.py"),
    "a global of no plain type": (
        HEAD + "    K = np.random.default_rng(1)\n" + PLUG.format(fields="", value="K.normal()"),
        {},
        "plug.K is a Generator, which is no plain value",
    ),
    "a compiled module": (
        HEAD + "    import helper\n" + PLUG.format(fields="", value="helper.value()"),
        {"helper": VALUE},
        "uses helper, which has no Python source",
    ),
    "a decorator that hides the function": (
        HEAD
        + "    def twice(f):\n        return lambda *a: f(*a)\n\n\n    @twice\n    def value():\n        return 1\n\n"
        + PLUG.format(fields="", value="value()"),
        {},
        "plug.value is not what its source says",
    ),
}


@pytest.mark.parametrize("case", NEVER)
def test_never_reused(case, modules):
    plug, files, reason = NEVER[case]
    write(modules, plug, files)
    if case == "a compiled module":
        import py_compile

        py_compile.compile("helper.py", cfile="helper.pyc", doraise=True)
        Path("helper.py").unlink()
    modules.fresh()
    (first, notes), (second, _) = configured(), configured()
    assert first != second
    assert len(notes) == 1
    assert "'mine' is computed anew, not reused: " in notes[0]
    assert reason in notes[0]
    assert "cache_key()" in notes[0]


def test_cache_key_stands_for_what_cannot_be_seen(modules):
    vouched = (
        ENVIRONMENT
        + "\n        def cache_key(self):\n            return os.environ.get('AOA_TEST', '1')\n"
    )
    modules.write("plug", vouched)
    modules.fresh()
    first, notes = configured()
    assert not notes
    assert configured()[0] == first


def test_cache_key_that_changes(modules, monkeypatch):
    test_cache_key_stands_for_what_cannot_be_seen(modules)
    first = configured()[0]
    monkeypatch.setenv("AOA_TEST", "2")
    assert configured()[0] != first


def test_a_library_of_another_version(modules, monkeypatch):
    """A distribution among the installed libraries that the plug-in imports, and one without any
    metadata, whose source counts.
    """
    from aoabench.store import reach as module

    site = Path("site-packages")
    (site / "libwith-1.0.dist-info").mkdir(parents=True)
    (site / "libwith-1.0.dist-info/METADATA").write_text("Name: libwith\nVersion: 1.0\n")
    (site / "libwith.py").write_text("K = 1\n")
    (site / "libwithout.py").write_text("K = 1\n")
    monkeypatch.syspath_prepend(site.resolve())
    text = HEAD + "    import libwith, libwithout\n"
    modules.write("plug", text + PLUG.format(fields="", value="libwith.K + libwithout.K"))
    modules.fresh()

    def found():
        for one in (module.version, module._distributions, module._all_distributions):
            one.cache_clear()
        modules.fresh()
        return configured()

    first = found()
    assert not first[1]
    assert found() == first
    (site / "libwithout.py").write_text("K = 2\n")
    second = found()
    assert second[0] != first[0]
    (site / "libwith-1.0.dist-info/METADATA").write_text("Name: libwith\nVersion: 2.0\n")
    assert found()[0] not in (first[0], second[0])


# --- from Python: objects before and after -------------------------------------------------------


@dataclass(frozen=True)
class Gain(aoabench.Estimator):
    gain: float = 1.0
    table: np.ndarray = field(default_factory=lambda: np.zeros(2))
    factor = 3

    def __call__(self, batch, scenario, streams):
        return _fixes(batch, self.gain * OFFSET)


OFFSET = 2.0


def _fixes(batch, x):
    shape = batch.azimuth.shape[:2]
    zero = np.zeros(shape, dtype=np.int8)
    return aoabench.Estimates(np.full((*shape, 3), float(x)), None, None, zero)


class Extended(Gain):
    def __init__(self, more):
        super().__init__()
        object.__setattr__(self, "more", more)


@dataclass(frozen=True)
class Hidden(Gain):
    more: InitVar[float] = 0.0

    def __post_init__(self, more):
        super().__post_init__()


def made(k):
    @dataclass(frozen=True)
    class Local(Gain):
        def __call__(self, batch, scenario, streams):
            return _fixes(batch, k)

    return Local()


def middle(batch, scenario, streams):
    return _fixes(batch, OFFSET)


def test_objects_that_are_plain_values_are_reused():
    for obj in (Gain(), Gain(2.0), Gain(table=np.arange(2.0)), middle):
        key, notes = given(obj)
        assert not notes
        assert given(obj) == (key, ())
    assert len({given(Gain())[0], given(Gain(2.0))[0], given(Gain(table=np.arange(2.0)))[0]}) == 3


@dataclass(frozen=True, slots=True)
class Slotted:
    gain: float = 1.0

    def __call__(self, batch, scenario, streams):
        return _fixes(batch, self.gain)


@functools.lru_cache(1)
def cached(batch, scenario, streams):
    return _fixes(batch, OFFSET)


def scaled(batch, scenario, streams, by):
    return _fixes(batch, by * OFFSET)


@pytest.mark.parametrize("make", [
    lambda k: Gain(k).__call__,
    lambda k: functools.partial(scaled, by=k),
    lambda k: functools.partial(Gain(k)),
    lambda k: Slotted(k),
])  # fmt: skip
def test_methods_partial_functions_and_slots_are_keyed_on_what_they_hold(make):
    key, notes = given(make(1.0))
    assert not notes
    assert given(make(1.0)) == (key, ())
    assert given(make(2.0))[0] != key


@pytest.mark.parametrize(
    "obj", [Gain().__call__, functools.partial(scaled, by=1), cached, functools.partial(cached)]
)
def test_their_code_counts(obj, monkeypatch):
    key, notes = given(obj)
    assert not notes
    monkeypatch.setattr(sys.modules[__name__], "OFFSET", 100.0)
    assert given(obj)[0] != key


def test_a_global_variable_set_at_run_time(monkeypatch):
    before = [given(Gain())[0], given(middle)[0]]
    monkeypatch.setattr(sys.modules[__name__], "OFFSET", 100.0)
    after = [given(Gain())[0], given(middle)[0]]
    assert not set(before) & set(after)


def test_a_class_attribute_set_at_run_time(monkeypatch):
    before = given(Gain())[0]
    monkeypatch.setattr(Gain, "factor", 100)
    assert given(Gain())[0] != before
    monkeypatch.setattr(Gain, "new", 1, raising=False)
    assert len({before, given(Gain())[0]}) == 2


def test_a_file_named_in_a_field(tmp_path):
    path = tmp_path / "w.txt"
    keys = []
    for text in ("1", "1", "2"):
        path.write_text(text)
        keys.append(given(Gain(table=str(path)))[0])
    assert keys[0] == keys[1] != keys[2]


@pytest.mark.parametrize(("obj", "reason"), [
    (lambda: made(1), "cannot be imported from tests.store.test_keys by its name"),
    (lambda: Extended(1), "Extended derives from a dataclass and is none itself"),
    (lambda: Hidden(more=1), "Hidden takes 'more', which it does not keep"),
    (lambda: lambda b, s, r: _fixes(b, 1), "cannot be imported"),
    (lambda: Gain(table=np.random.default_rng(0)), "is a Generator, which is no plain value"),
])  # fmt: skip
def test_objects_that_are_no_plain_values_are_computed_anew(obj, reason):
    one = obj()
    (first, notes), (second, _) = given(one), given(one)
    assert first != second
    assert len(notes) == 1
    assert reason in notes[0]


@dataclass(frozen=True, slots=True)
class SlottedGain(Gain):
    more: float = 1.0


def test_state_beside_slots():
    one = SlottedGain()
    assert not given(one)[1]
    object.__setattr__(one, "secret", 1)
    assert "SlottedGain has 'secret', which is no field" in given(one)[1][0]


def test_state_that_is_no_field():
    one = Gain()
    object.__setattr__(one, "secret", 1)
    assert "Gain has 'secret', which is no field" in given(one)[1][0]


def test_a_shipped_class_that_is_replaced_in_part(monkeypatch):
    from aoabench.filters import kalman
    from aoabench.maths import linalg

    def key():
        cells = compose_cells(["filter=[ekf_vmf]"])
        keys = RunKeys.of(cells)
        return keys.parts[cells[0].id]["ekf_vmf"], keys.notes

    first = key()
    assert not first[1]
    assert key() == first
    monkeypatch.setattr(kalman.EKF, "__call__", lambda *a: None)
    assert "EKF.__call__ is not what its source says" in key()[1][0]
    monkeypatch.undo()
    monkeypatch.setattr(linalg, "cholesky", lambda a: a)
    assert "linalg.cholesky is not what its source says" in key()[1][0]
    monkeypatch.undo()
    assert key() == first


def test_defaults_of_a_function_changed_at_run_time(monkeypatch):
    monkeypatch.setattr(_with_default, "__defaults__", (2,))
    with pytest.raises(NotPlain, match="defaults"):
        changes(reach([(__name__, "_with_default")]))


def _with_default(x=1):
    return x


def test_plain_values():
    same = [1, 1.5, "a", None, True, [1, (2,)], {"a": {1: np.arange(3)}}, {3, 1}, 1j, Path("a")]
    assert plain(same) == plain(list(same))
    assert plain(np.arange(3)) != plain(np.arange(3.0)) != plain(np.arange(3.0)[None])
    for odd in (object(), np.array([object()]), open, iter([])):
        with pytest.raises(NotPlain):
            plain(odd)


# --- what runs and what is named by the key ------------------------------------------------------


def cells_of_plug(out, *words):
    Path("conf/estimator").mkdir(parents=True)
    Path("conf/estimator/mine.yaml").write_text("mine: {_target_: plug.Constant}\n")
    words = ["estimator=[mine]", "filter=[]", "reps=64", f"runner.out={out}", *words]
    return compose_cells(words, config_dir="conf", plugins=["plug"])


def stored(out):
    return list(Path(out).glob("parts/*/*.json"))


@pytest.mark.parametrize("workers", ["runner.n_jobs=1", "runner.n_jobs=2"])
def test_a_plug_in_edited_while_the_workers_start(workers, modules, monkeypatch):
    """Workers that import the new file refuse; none of their numbers is stored."""
    modules.write("plug", PLAIN)
    modules.fresh()
    cells = cells_of_plug("out", workers, "runner.chunk=32")
    compute = runner.compute_all

    def edited(*arguments):
        edit(("plug", "= 1.0", "= 9.0"))
        compute(*arguments)

    monkeypatch.setattr(runner, "compute_all", edited)
    with pytest.raises(RunError, match=r"plug\.py was changed after it was imported; start again"):
        runner.run(cells, progress=False)
    assert not stored("out")


@pytest.mark.parametrize("changed", ["plug.py", "w.txt"])
def test_an_edit_during_a_task(changed, modules, monkeypatch):
    """The finished task is kept, the one in which the file changed is not stored."""
    write(modules, FILE, {"w.txt": "1"})
    modules.fresh()
    cells = cells_of_plug("out", "runner.n_jobs=1", "runner.chunk=32", "reps=256")
    block, count = tasks.run_block, []

    def edited(*arguments):
        count.append(1)
        if len(count) == 2:
            edit(("w.txt", "1", "2") if changed == "w.txt" else ("plug", "float(x)", "-float(x)"))
        return block(*arguments)

    monkeypatch.setattr(tasks, "run_block", edited)
    with pytest.raises(RunError, match=rf"{changed} was changed after it was"):
        runner.run(cells, progress=False)
    assert len(stored("out")) == 1


@pytest.mark.parametrize("changed", ["plug.py", "w.txt"])
def test_an_edit_while_a_run_waits_for_another(changed, modules, monkeypatch):
    """Keys are made before the wait, and nothing is computed from what changed during it."""
    write(modules, FILE, {"w.txt": "1"})
    modules.fresh()
    cells = cells_of_plug("out")
    lock = runner.locked

    def waited(*arguments):
        edit(("w.txt", "1", "2") if changed == "w.txt" else ("plug", "float(x)", "-float(x)"))
        return lock(*arguments)

    monkeypatch.setattr(runner, "locked", waited)
    with pytest.raises(RunError, match=rf"{changed} was changed after it was"):
        runner.run(cells, progress=False)
    assert not stored("out")


def test_an_edit_that_leaves_size_and_time_as_they_were(modules, monkeypatch):
    """Python would load the compiled code of the earlier file."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    modules.write("plug", GLOBAL)
    status = Path("plug.py").stat()
    assert modules.fresh().K == 1.0
    first = configured()[0]
    edit(("plug", "K = 1.0", "K = 2.0"))
    os.utime("plug.py", ns=(status.st_atime_ns, status.st_mtime_ns))
    assert modules.fresh().K == 2.0
    assert configured()[0] != first


def test_a_module_edited_after_its_import(modules):
    """A notebook's second run says so, whether the first one was before the edit or never."""
    modules.write("plug", PLAIN)
    plug = modules.fresh()
    first = given(plug.Constant())
    assert first == given(plug.Constant())
    edit(("plug", "= 1.0", "= 2.0"))
    with pytest.raises(UserError, match=r"plug\.py was changed after it was imported; start again"):
        given(plug.Constant())
    importlib.reload(plug)
    assert given(plug.Constant())[0] != first[0]


def test_a_module_that_was_imported_before_the_recording_began(modules):
    """Its functions are compared with those in the file as it is read later."""
    modules.write("plug", PLAIN)
    plug = modules.fresh()
    loaded._sources.pop("plug")
    assert not given(plug.Constant())[1]
    loaded._read_later.pop(plug)
    edit(("plug", "self.gain)", "self.gain + 1)"))
    with pytest.raises(UserError, match=r"plug\.py was changed after it was imported; start again"):
        given(plug.Constant())


def test_a_recording_corrected_after_it_was_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("fix,anchor,azimuth_deg,x_m,y_m\n1,1,10,1,1\n1,2,20,1,1\n")
    Path("anchors.csv").write_text("x_m,y_m,z_m,facing_deg\n0,0,1,0\n5,0,1,90\n")
    words = ["scenario=recorded", "scenario.path=log.csv", "scenario.anchors=anchors.csv"]
    cells = compose_cells([*words, "filter=[]", "estimator=[ls_lines]"])
    before = RunKeys.of(cells).draws
    for file in ("log.csv", "anchors.csv"):
        text = Path(file).read_text()
        Path(file).write_text(text.replace("0,1", "0,2"))
        with pytest.raises(UserError, match=rf"{file} was changed after it was read; start again"):
            RunKeys.of(cells)
        Path(file).write_text(text)
    assert RunKeys.of(cells).draws == before


def test_fresh_computes_again_and_replaces(modules):
    modules.write("plug", PLAIN)
    modules.fresh()
    cells = cells_of_plug("out", "runner.n_jobs=1")
    assert runner.run(cells, progress=False).computed == 64
    files = stored("out")
    assert runner.run(cells, progress=False).computed == 0
    assert runner.run(cells, progress=False, fresh=True).computed == 64
    assert stored("out") == files
    assert len(aoabench.load("out")) == 64


# --- the package's own source --------------------------------------------------------------------

PACKAGE = Path(aoabench.__file__).parent
DOMAIN = [
    f"aoabench.{file.relative_to(PACKAGE).with_suffix('').as_posix().replace('/', '.')}"
    for pattern in (
        *(
            "scenarios/*",
            "noise/*",
            "models/*",
            "filters/*",
            "estimators/*",
            "kernels/*",
            "maths/*",
        ),
        *("devices/**/*", "roles*", "types*", "streams*", "engine/block*", "engine/tiles*"),
        *("engine/metrics*", "engine/inputs*"),
    )
    for file in sorted(PACKAGE.glob(f"{pattern}.py"))
    if file.name not in ("__init__.py", "cache.py", "loading.py")
]


def source_of(module):
    path = PACKAGE.parent / f"{module.replace('.', '/')}.py"
    return loaded.Source(path, path.read_bytes(), loaded.digest_of(path.read_bytes()), True)


def digests(module, tree=None):
    """The digest of each definition in a module's source, or in a changed syntax tree of it."""
    source = source_of(module)
    content = ast.unparse(ast.parse(source.content) if tree is None else tree).encode()
    source = dataclasses.replace(source, content=content, digest=loaded.digest_of(content))
    found = parsed(module, source)
    return {name: found.definition(name).digest for name in [*found.names, None]}


@pytest.mark.parametrize("module", DOMAIN)
def test_text_for_people_changes_no_key(module):
    """Docstrings, annotations, messages, checks' messages, a class's text, and a function that
    nothing uses.
    """
    before, tree = digests(module), ast.parse(source_of(module).content)
    for node in list(ast.walk(tree)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                first.value = ast.Constant("Some other text.")
            elif not isinstance(node, ast.Module):
                node.body.insert(0, ast.Expr(ast.Constant("Some text.")))
        if isinstance(node, ast.ClassDef):
            node.body += ast.parse("def __repr__(self):\n    return str(3)\n").body
        if isinstance(node, ast.FunctionDef):
            node.returns = ast.Name("object")
            for argument in node.args.args:
                argument.annotation = ast.Name("object")
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            node.exc.args = [ast.Constant("other"), *node.exc.args]
    tree.body.append(ast.parse("def unused():\n    return 3\n").body[0])
    after = digests(module, ast.fix_missing_locations(tree))
    after.pop("unused")
    assert after == before


@pytest.mark.parametrize("module", DOMAIN)
def test_a_changed_number_changes_the_definition(module):
    """A number of each definition, but none in text for people: checks, messages, annotations."""
    known = parsed(module, source_of(module))
    for name in known.names:
        node = known.definition(name).nodes[-1]
        bare = definitions._Bare(shipped=True).visit(copy.deepcopy(node))
        numbers = [n for n in ast.walk(bare) if isinstance(n, ast.Constant) and is_number(n.value)]
        if numbers:
            before = known._analysed([copy.deepcopy(bare)]).digest
            numbers[len(numbers) // 2].value += 1
            assert known._analysed([bare]).digest != before, name


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def test_everything_shipped_is_as_its_source_says():
    """So no shipped estimator, scenario or noise is ever computed anew for want of proof."""
    for module in DOMAIN:
        importlib.import_module(module)
    roots = [
        (module, name) for module in DOMAIN for name in parsed(module, source_of(module)).names
    ]
    found = reach(roots)
    assert len(found.definitions) > 700
    assert changes(found) == []
    assert not found.unseen
    assert not found.reads
    assert not found.values
    assert {"numpy", "scipy", "numba", "llvmlite", "shapely", "pandas", "pyarrow"} <= set(
        found.libraries
    )


# each class of estimator once, on a scenario with few fixes
RUNS = [
    ("filter", "noise=vmf", ["scenario.steps=2"]),
    ("filter", "noise=ofdm_crlb", ["scenario=indoor_map", "scenario.dt=40"]),
    ("estimator", "noise=ae_normal", ["scenario.steps=2"]),
    ("estimator", "noise=ble_multipath", ["scenario=ble_room", "scenario.packets=2"]),
]


@pytest.mark.parametrize(("group", "noise", "words"), RUNS)
def test_every_function_that_runs_is_covered(group, noise, words):
    """Python reports the functions that a block of each estimator calls, compiled ones apart."""
    seen = set()
    for name in options(group):
        more = ["filter=[]"] if group == "estimator" else []
        more += [f"filter.{name}.particles=50"] if name.startswith("pf_") else []
        try:
            cell = compose_cells([noise, *words, *more, f"{group}=[{name}]"])[0]
        except UserError:
            continue
        kind = frozenset(keys._roots(keys._parts(cell.estimators[name])))
        if kind in seen:
            continue
        seen.add(kind)
        ran = functions_called(cell)
        objects = [cell.scenario, cell.noise, *cell.estimators.values()]
        found = reach({keys._BLOCK, *keys._roots(keys._parts(objects))})
        assert len(ran) > 15
        assert not ran - set(found.definitions), f"{name}: the key does not see some code"
    assert len(seen) > 1


def functions_called(cell):
    """Module and top-level name of aoabench's functions that one block of a cell calls."""
    called = set()

    def note(frame, event, _argument):
        if event == "call" and frame.f_code.co_filename.startswith(str(PACKAGE)):
            called.add((frame.f_globals["__name__"], frame.f_code.co_qualname.partition(".")[0]))

    for estimator in cell.estimators.values():
        estimator.prepare(print)
    sys.setprofile(note)
    try:
        run_block(cell.scenario, cell.noise, cell.estimators, 1, 0, 1)
    finally:
        sys.setprofile(None)
    return {(m, n) for m, n in called if not _is_aside(m) and not n.startswith("<")}
