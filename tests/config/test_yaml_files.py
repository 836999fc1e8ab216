"""YAML files of a user's folder: each that is no config is refused in one line that names the file,
before anything large is built.
"""

import os
import re

import pytest
import yaml

from aoabench.cli.main import main
from aoabench.config.compose import compose_cells, show
from aoabench.config.guard import refuse_foreign_hydra
from aoabench.config.messages import explained
from aoabench.config.overrides import read
from aoabench.config.presets import options
from aoabench.config.yaml_files import MOST_LEVELS, MOST_NODES, Unreadable, load
from aoabench.errors import UserError

EXPERIMENT = "# @package _global_\n# X\ndefaults:\n  - override /filter: [ekf_vmf]\n"
VMF = "_target_: aoabench.noise.angular.VonMisesFisher\n"
PARAMS = EXPERIMENT + "hydra:\n  sweeper:\n    params:\n"


def bomb(indent="", opened="[", closed="]", item="*{0}", levels=5):
    """Nine aliases of nine aliases of ...: 9^5 values in some hundred bytes."""
    lines = [f"{indent}a0: &a0 {{x: 1}}"]
    for i in range(1, levels + 1):
        inside = ", ".join(item.format(f"a{i - 1}", j) for j in range(9))
        lines.append(f"{indent}a{i}: &a{i} {opened}{inside}{closed}")
    return "\n".join(lines) + "\n"


def nested(opened, closed, depth=200):
    return f"{VMF}a: {opened * depth}1{closed * depth}\n"


NOISES = {  # text of noise/x.yaml, and what the line says
    "duplicate key": (VMF + "sigma_deg: 1\nsigma_deg: 2\n", "line 3: the key 'sigma_deg' is given twice"),
    "duplicate key inside": (VMF + "a: {b: 1, b: 2}\n", "line 2: the key 'b' is given twice"),
    "two documents": (VMF + "---\n" + VMF, "line 2: a second document begins; allowed: one"),
    "brackets": (nested("[", "]"), "more than 30 nested levels"),
    "maps": (nested("{a: ", "}"), "more than 30 nested levels"),
    "3000 brackets": (nested("[", "]", 3000), "more than 30 nested levels"),
    "block maps": (VMF + "".join(" " * i + "a:\n" for i in range(200)), "line 32: more than 30 nested"),
    "brackets without ends": (VMF + "a: " + "[" * 3000, "more than 30 nested levels"),
    "an anchor in itself": (VMF + "b: &b [*b]\n", "line 2: *b contains itself"),
    "an anchor in a map in itself": (VMF + "b: &b {c: {d: *b}}\n", "*b contains itself"),
    "a file in itself": (f"&a\n{VMF}b: *a\n", "*a contains itself"),
    "an anchor merged into itself": (VMF + "b: &b\n  <<: *b\n", "*b contains itself"),
    "levels by aliases": (VMF + "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 40)), "nested levels"),
    "alias bomb": (VMF + bomb(), "more than 10000 values, aliases counted"),
    "alias bomb of maps": (VMF + bomb("", "{", "}", "k{1}: *{0}"), "more than 10000 values, aliases counted"),
    "alias bomb of merges": (VMF + bomb("", "{<<: [", "]}"), "more than 10000 values, aliases counted"),
    "many values": (VMF + "a: [" + "1, " * 10_001 + "1]\n", "more than 10000 values"),
    "a large file": (VMF + "a: " + "x" * 250_000 + "\n", "allowed: at most 250000"),
    "unknown alias": (VMF + "a: *nope\n", "undefined alias 'nope'"),
    "a defaults list of itself": ("defaults: [x]\n" + VMF, "contains itself: noise/x -> noise/x"),
    "itself by its full name": ("defaults: [/noise/x]\n" + VMF, "contains itself: noise/x -> noise/x"),
    "itself by its group": ("defaults: [{/noise: x}]\n" + VMF, "contains itself: noise/x -> noise/x"),
    "defaults of a number": ("defaults: 3\n" + VMF, "defaults: 3 is not allowed; allowed: a list of"),
    "defaults of null": ("defaults: [null]\n" + VMF, "defaults: [None] is not allowed"),
    "defaults of lists": ("defaults: [[a]]\n" + VMF, "defaults: [['a']] is not allowed"),
    "defaults with two keys": ("defaults: [{a: b, c: d}]\n" + VMF, "is not allowed; allowed: a list of"),
    "a long chain": ("defaults: [x0]\n" + VMF, "more than 20 levels"),
    "a wide tree": ("defaults: [x0]\n" + VMF, "more than 200 configs"),
    "nested resolvers": (VMF + "a: " + "${oc.decode:" * 200 + "1" + "}" * 200, "more than 20 interpolations"),
    "a long interpolation": (VMF + "a: ${oc.create:[" + "1," * 600 + "1]}\n", "of more than 1000 characters"),
    "brackets in an interpolation": (VMF + "a: ${oc.create:" + "[" * 400 + "]" * 400 + "}\n", "cannot be read"),
    "an open interpolation": (VMF + "sigma_deg: ${noise\n", "'sigma_deg': the interpolation '${noise' cannot be read"),
    "an empty interpolation": (VMF + "sigma_deg: ${}\n", "cannot be read; allowed: ${KEY}"),
    "a list": ("- a\n- b\n", "holds a list; allowed: lines KEY: VALUE"),
    "a text": ("abc\n", "holds one value, 'abc'; allowed: lines KEY: VALUE"),
    "a number": ("3\n", "holds one value, 3"),
    "a null key": (VMF + "null: 3\n", "the key None is not allowed; allowed: a printable text"),
    "an escape sequence in a key": (VMF + '"\\e[31mx": 1\n', r"the key '\x1b[31mx' is not allowed"),
    "an escape sequence inside": (VMF + 'a: [{"\\u202ex": 1}]\n', r"the key '\u202ex' is not allowed"),
    "a list as key": (VMF + "? [a]\n: 3\n", "line 2: found unhashable key"),
    "a set": (VMF + "a: !!set {x, y}\n", "'a' is a set; allowed: texts, numbers"),
    "pairs": (VMF + "a: !!omap [x: 1]\n", "'a[0]' is a tuple"),
    "bytes": (VMF + "a: {b: !!binary aGVsbG8=}\n", "'a.b' is a bytes"),
    "a date": (VMF + "a: !!timestamp 2020-01-01\n", "'a' is a date"),
    "a path": (VMF + "a: !!python/object/apply:pathlib.Path [a]\n", "'a' is a PosixPath"),
    "an object": (VMF + "a: !!python/object/apply:os.getcwd []\n", "could not determine a constructor"),
    "a tab": (VMF + "\ta: 1\n", "line 2: found character '\\t' that cannot start any token"),
    "no UTF-8": (b"_target_: \xff\xfe\n", "can't decode byte 0xff"),
    "a zero byte": (VMF + "a: \0\n", "character 51: special characters are not allowed"),
    "5000 digits": (VMF + "a: " + "9" * 5000 + "\n", "5000 digits"),
    "400 digits": (VMF + "a: " + "9" * 400 + "\n", "'a': a number of more than 300 digits"),
    "base 60": (VMF + "a: " + ":".join(["59"] * 3000) + "\n", "'a': a number of more than 300 digits"),
    "a long key": (VMF + "x" * 5000 + ": 1\n", "line 2: could not find expected ':'"),
    "a directive": ("%YAML 3.0\n---\n" + VMF, "line 1: found incompatible YAML document"),
}  # fmt: skip

EXPERIMENTS = {  # text of experiment/x.yaml, and what the line says
    "hydra in itself": (EXPERIMENT + "hydra: &h {sweeper: *h}\n", "*h contains itself"),
    "params in themselves": (PARAMS + "      a: &h {a: *h}\n", "*h contains itself"),
    "alias bomb in params": (PARAMS + bomb("      "), "aliases counted"),
    "alias bomb of maps in params": (PARAMS + bomb("      ", "{", "}", "k{1}: *{0}"), "aliases counted"),
    "list as params": (EXPERIMENT + "hydra: {sweeper: {params: [a]}}\n", "'hydra.sweeper.params' is not allowed"),
    "list in params": (PARAMS + "      noise.sigma_deg: [3]\n", "is not allowed"),
    "itself": ("# @package _global_\ndefaults: [x]\n", "experiment/x -> experiment/x"),
    "in turn": ("# @package _global_\ndefaults: [/experiment/y]\n", "experiment/x -> experiment/y -> experiment/x"),
    "a sweep over too many values": (PARAMS + "      seed: shuffle(range(0,10000000000))\n", "more than 100000 values"),
    "a sweep over too many cells": (PARAMS + "      seed: range(0,9999)\n      scenario.dt: range(1,9999)\n", "a sweep over 99970002 cells"),
}  # fmt: skip

OTHERS = {  # further files of a case
    "in turn": {"experiment/y.yaml": "# @package _global_\ndefaults: [/experiment: x]\n"},
    "a long chain": {f"noise/x{i}.yaml": f"defaults: [x{i + 1}]\n{VMF}" for i in range(25)},
    "a wide tree": {
        f"noise/x{i}.yaml": f"defaults: [x{i + 1}, /noise/x{i + 1}]\n{VMF}" for i in range(9)
    },
}
CASES = [
    *(("noise", *case) for case in NOISES.items()),
    *(("experiment", *case) for case in EXPERIMENTS.items()),
]


def write(folder, files):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(folder)


@pytest.mark.parametrize(
    ("group", "case", "content"), CASES, ids=[f"{group}: {name}" for group, name, _ in CASES]
)
def test_a_file_that_is_no_config_is_refused_in_one_line(group, case, content, tmp_path):
    text, says = content
    others = OTHERS.get(case, {})
    folder = write(tmp_path, {f"{group}/x.yaml": text} | others)
    with pytest.raises(UserError) as error:
        compose_cells(["filter=[ekf_vmf]", f"{group}=x", "reps=2"], config_dir=folder)
    line = str(error.value)
    assert says in line
    assert "\n" not in line
    assert len(line) < 600
    assert f"{folder}/{group}/x" in line or "a sweep" in case
    assert not re.search(r"Exception|Error|Config[A-Z]|Lexer|<unicode|Node", line), line


VALUES = {  # value of noise.sigma_deg in a file, and what the line says
    "itself": ("${noise.sigma_deg}", "noise.sigma_deg: Recursive interpolation detected"),
    "its parent": ("${noise}", "noise.sigma_deg: Interpolation to parent node detected"),
    "an unknown key": ("${nope.x}", "noise.sigma_deg: Interpolation key 'nope.x' not found"),
    "an unknown resolver": ("${nope:3}", "noise.sigma_deg: Unsupported interpolation type nope"),
    "a resolver that fails": ("${oc.decode:3}", "noise.sigma_deg: `oc.decode` can only take strings"),
    "a missing value": ("???", "noise.sigma_deg: Missing mandatory value"),
    "a word": ("x" * 5000, "noise.sigma_deg='xxx"),
}  # fmt: skip


@pytest.mark.parametrize(("value", "says"), VALUES.values(), ids=VALUES)
def test_a_value_of_a_file_that_cannot_be_resolved(value, says, tmp_path):
    folder = write(tmp_path, {"noise/x.yaml": f"{VMF}sigma_deg: {value}\n"})
    with pytest.raises(UserError, match=re.escape(says)) as error:
        compose_cells(["filter=[ekf_vmf]", "noise=x"], config_dir=folder)
    assert len(str(error.value)) < 400
    assert not re.search(r"Exception|Error|Config[A-Z]", str(error.value))


def test_names_and_descriptions_that_a_terminal_would_obey(tmp_path, capsys):
    file = tmp_path / "noise" / "\x1b[31mx.yaml"
    write(tmp_path, {"noise/y.yaml": f"# Mine \x1b[31m\n{VMF}", f"noise/{file.name}": VMF})
    assert options("noise", str(tmp_path)).items() >= {("y", r"Mine \x1b[31m")}
    assert file.stem not in options("noise", str(tmp_path))
    with pytest.raises(SystemExit) as stop:
        main(["run", "filter=[ekf_vmf]", "noise=y", "--config-dir", str(tmp_path)])
    assert stop.value.code == 2
    assert r"\x1b[31mx.yaml' is not allowed" in (line := capsys.readouterr().err)
    assert "\x1b" not in line
    with pytest.raises(SystemExit):
        main(["run", "filter=[ekf_vmf]", "noise=\x1b[31m"])
    assert "\x1b" not in capsys.readouterr().err


def test_a_preset_that_cannot_be_composed_cannot_be_listed(tmp_path, capsys):
    folder = write(tmp_path, {"noise/x.yaml": "defaults: [nope]\n" + VMF})
    with pytest.raises(SystemExit) as stop:
        main(["list", "x", "--config-dir", folder])
    assert stop.value.code == 2
    assert "noise='nope': unknown preset; allowed: ae_flip" in capsys.readouterr().err


def test_what_hydra_reads_is_read(tmp_path):
    """Numbers and words as OmegaConf's loader takes them, aliases, and both bounds themselves."""
    file = tmp_path / "x.yaml"
    file.write_text("a: 1e3\nb: &b [on, 2020-01-01]\nc: *b\nd: {<<: {e: 1}, f: .5}\n")
    assert load(file) == {
        "a": 1000.0,
        "b": [True, "2020-01-01"],
        "c": [True, "2020-01-01"],
        "d": {"e": 1, "f": 0.5},
    }
    file.write_text("# nothing\n")
    assert load(file) == {}
    file.write_text("[" * MOST_LEVELS + "1" + "]" * MOST_LEVELS)
    load(file)
    file.write_text("[" * (MOST_LEVELS + 1) + "]" * (MOST_LEVELS + 1))
    with pytest.raises(Unreadable, match="nested levels"):
        load(file)
    file.write_text("a: &a [" + ",".join("1" * 990) + "]\nb: [" + ",".join(["*a"] * 9) + "]\n")
    load(file)
    file.write_text("a: &a [" + ",".join("1" * 990) + "]\nb: [" + ",".join(["*a"] * 10) + "]\n")
    with pytest.raises(Unreadable, match=f"more than {MOST_NODES} values"):
        load(file)


def test_a_file_beside_the_groups_is_read_within_the_bounds_too(tmp_path):
    folder = write(tmp_path, {"site/a.yaml": bomb(), "site/b.yaml": "c: 1\n"})
    for word in ("+site=a", "+site=b,a", "+site=[b,a]"):
        with pytest.raises(UserError, match=r"site/a\.yaml: not a config: .*aliases counted"):
            compose_cells(["filter=[ekf_vmf]", word], config_dir=folder)
    with pytest.raises(UserError, match="site: unknown key"):
        compose_cells(["filter=[ekf_vmf]", "+site=b"], config_dir=folder)


def test_links_to_folders_above_are_followed_once(tmp_path):
    write(tmp_path, {"noise/sub/x.yaml": VMF, "elsewhere/y.yaml": "hydra: {callbacks: {a: b}}\n"})
    for name in "abcd":
        (tmp_path / name).symlink_to(".")
        (tmp_path / "noise" / name).symlink_to("..")
    (tmp_path / "self").symlink_to("self")
    with pytest.raises(UserError, match=r"y\.yaml: 'hydra.callbacks.a' is not allowed"):
        refuse_foreign_hydra(str(tmp_path))
    (tmp_path / "elsewhere" / "y.yaml").unlink()
    assert len(compose_cells(["filter=[ekf_vmf]"], config_dir=str(tmp_path))) == 1


def test_a_folder_is_checked_below_each_group_that_links_to_it(tmp_path):
    """What may stand beside the groups may not stand in one."""
    write(tmp_path, {"aside/x.yaml": "plugins: [os]\n"})
    refuse_foreign_hydra(str(tmp_path))
    (tmp_path / "noise").symlink_to("aside")
    with pytest.raises(UserError, match=r"noise/x\.yaml: 'plugins' is not allowed"):
        refuse_foreign_hydra(str(tmp_path))


def test_a_folder_of_too_many_files(tmp_path, monkeypatch):
    monkeypatch.setattr("aoabench.config.guard._MOST_FILES", 10)
    write(tmp_path, {f"noise/x{i}.yaml": VMF for i in range(10)})
    with pytest.raises(UserError, match="more than 10 folders and YAML files; allowed: a folder"):
        refuse_foreign_hydra(str(tmp_path))


def test_pipes_are_no_configs(tmp_path):
    """Opening one would wait for ever."""
    (tmp_path / "noise").mkdir()
    os.mkfifo(tmp_path / "noise" / "x.yaml")
    refuse_foreign_hydra(str(tmp_path))
    assert "x" not in options("noise", str(tmp_path))


@pytest.mark.parametrize("error", [RecursionError("x"), yaml.YAMLError("x"), ValueError("x")])
def test_the_net_under_hydra(error):
    with (
        pytest.raises(UserError, match=r"^seed=3: cannot be composed: "),
        explained(read(["seed=3"])),
    ):
        raise error


SECRETS = {
    "plain": "${oc.env:SECRET}",
    "with a default": "${oc.env:SECRET,3}",
    "of a name elsewhere": "${oc.env:${noise.kappa}}",
    "of a built name": "${oc.${noise.name}:SECRET}",
    "decoded": "${oc.decode:'\\${oc.env:SECRET}'}",
    "selected": "${oc.select:nope,${oc.env:SECRET}}",
}


@pytest.mark.parametrize("value", SECRETS.values(), ids=SECRETS)
def test_a_config_reads_no_variable_of_the_environment(value, tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    text = f"{VMF}sigma_deg: {value}\nkappa: SECRET\nname: env\n"
    folder = write(tmp_path, {"noise/x.yaml": text})
    with pytest.raises(UserError, match=r"\$\{oc.env:SECRET\} is not allowed, because") as error:
        compose_cells(["filter=[ekf_vmf]", "noise=x"], config_dir=folder)
    assert "hunter2" not in str(error.value)


@pytest.mark.parametrize("value", ["${oc.env:SECRET}", "\\${oc.env:SECRET}"])
def test_neither_does_an_experiments_sweep(value, tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "7")
    folder = write(tmp_path, {"experiment/x.yaml": f"{PARAMS}      noise.sigma_deg: '{value}'\n"})
    with pytest.raises(UserError, match="SECRET} is not allowed"):
        compose_cells(["experiment=x"], config_dir=folder)


@pytest.mark.parametrize(("value", "says"), [
    ("${oc.env:SECRET}", r"\$\{oc.env:SECRET\} is not allowed"),
    ("${hydra:runtime.cwd}", r"\$\{hydra:...\} is not allowed"),
    ("${now:%Y}", r"\$\{now:...\} is not allowed"),
    ("${python_version:}", r"\$\{python_version:...\} is not allowed"),
])  # fmt: skip
def test_the_command_line_reads_no_more(value, says, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    with pytest.raises(UserError, match=f"^scenario.name: {says}"):
        compose_cells(["filter=[ekf_vmf]", f"scenario.name={value}"])
    with pytest.raises(UserError, match=f"^scenario.name: {says}"):
        show(["filter=[ekf_vmf]", f"scenario.name={value}"], resolve=True)


def test_the_address_of_a_scheduler_may_be_read_and_resolvers_are_left_as_they_were(monkeypatch):
    from omegaconf import OmegaConf

    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", "tcp://127.0.0.1:8786")
    (cell,) = compose_cells(["filter=[ekf_vmf]", "runner=dask"])
    assert cell.runner.address == "tcp://127.0.0.1:8786"
    monkeypatch.setenv("SECRET", "x")
    assert OmegaConf.create({"a": "${oc.env:SECRET}"}).a == "x"
