"""Files to start from: a plug-in's class, preset and test, and a study of one table and figure.
They run, and their tests pass, at once.
"""

from __future__ import annotations

import builtins
import keyword
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from aoabench import loaded
from aoabench.config.presets import GROUPS, options
from aoabench.errors import BadValue, UserError
from aoabench.resources import shipped

KINDS = ("estimator", "filter", "noise", "scenario")
STUDY = "study"
_STUDY_FILES = ("study.yaml", "claims.yaml", "errata.yaml", "numbers.py", "figures.py", "README.md")
_RUN = {  # the overrides beside the new preset
    "estimator": "'estimator=[{name},ls_lines]'",
    "filter": "'filter=[{name},ekf_vmf]'",
    "noise": "noise={name} 'filter=[ekf_vmf]' 'estimator=[ls_lines]'",
    "scenario": "scenario={name} 'filter=[ekf_vmf]' 'estimator=[ls_lines]'",
}


class Written(NamedTuple):
    """The files that were written, and the commands that use them."""

    files: list[Path]
    commands: list[str]


def write(kind: str, name: str, folder: Path) -> Written:
    """Write the class NAME.py, the preset conf/KIND/NAME.yaml and the test test_NAME.py into a
    folder.

    Raises UserError for a name that is taken or is none, and for a file that exists.
    """
    check_name(name, folder)
    words = {
        "kind": kind,
        "name": name,
        "cls": "".join(part.capitalize() for part in name.split("_")),
        "title": name.replace("_", " ").capitalize(),
        "role": "estimator" if kind == "filter" else kind,
    }
    texts = {
        folder / f"{name}.py": _rendered(f"{kind}.py.j2", words),
        folder / "conf" / kind / f"{name}.yaml": _rendered(f"{kind}.yaml.j2", words),
        folder / f"test_{name}.py": _rendered("test.py.j2", words),
    }
    return Written(_created(texts), _commands(kind, name))


def write_study(name: str, folder: Path) -> Written:
    """Write experiments/NAME, configs/experiment/NAME.yaml and tests/studies/test_NAME.py into a
    checkout.

    Raises UserError for a name that is taken or is none, for a folder that is not the checkout in
    use, and for a file that exists.
    """
    check_name(name, folder)
    if shipped("experiments") != folder.resolve() / "experiments":
        place = shipped("experiments").parent
        here = f": {place}" if (place / "tests").is_dir() else ", installed with pip install -e"
        raise BadValue("--dir", str(folder), f"for a study, the checkout of aoabench in use{here}")
    words = {"name": name, "title": name.replace("_", " ").capitalize()}
    places = {f"{file}.j2": folder / "experiments" / name / file for file in _STUDY_FILES}
    places["experiment.yaml.j2"] = folder / "configs" / "experiment" / f"{name}.yaml"
    places["test.py.j2"] = folder / "tests" / "studies" / f"test_{name}.py"
    texts = {path: _rendered(f"study/{file}", words) for file, path in places.items()}
    commands = [f"aoabench reproduce {name}", f"python -m pytest tests/studies/test_{name}.py"]
    return Written(_created(texts), commands)


def _commands(kind: str, name: str) -> list[str]:
    chosen = _RUN[kind].format(name=name)
    run = f"aoabench run {chosen} reps=20 --config-dir conf 'plugins=[{name}]'"
    return [run, f"aoabench test {name}", f"python -m pytest test_{name}.py"]


def _created(texts: Mapping[Path, str]) -> list[Path]:
    """Write files that must not exist yet; raise UserError before any is written if one does."""
    for path in texts:
        if path.exists():
            raise UserError(f"{path}: exists already and is not replaced; choose another NAME")
    try:
        for path, text in texts.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror}") from None
    return list(texts)


def _rendered(template: str, words: Mapping[str, str]) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True
    )
    source = (Path(__file__).parent / "templates" / template).read_text(encoding="utf-8")
    return environment.from_string(source).render(words)


def check_name(name: str, folder: Path) -> None:
    """Raise BadValue for a name that is no module's, or that a preset or a module has."""
    reason = ""
    if not (name.isascii() and name.isidentifier() and name == name.lower() and name[0] != "_"):
        reason = "lower-case letters, digits and _, a letter first, such as my_estimator"
    elif keyword.iskeyword(name) or keyword.issoftkeyword(name) or name in vars(builtins):
        reason = f"a name other than Python's own {name}"
    elif name in sys.stdlib_module_names or name == "aoabench" or _installed(name, folder):
        reason = f"a name other than that of the installed module {name}"
    else:
        own = folder / "conf"
        places = [g for g in GROUPS if name in options(g, str(own) if own.is_dir() else None)]
        if places:
            reason = f"a name other than that of the preset {places[0]}={name}"
    if reason:
        raise BadValue("NAME", name, reason)


def _installed(name: str, folder: Path) -> bool:
    """Whether a module of this name can be imported from elsewhere than the folder."""
    loaded.forget_places()
    spec = loaded.spec_of(name)
    origin = spec.origin if spec else None
    return spec is not None and not (origin and Path(origin).parent == folder.resolve())
