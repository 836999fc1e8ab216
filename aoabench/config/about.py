"""What a preset is: its class with its source, what it needs or offers, its keys, an example; and
the keys of a run that no plug-in defines.
"""

from __future__ import annotations

import inspect
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from aoabench.config import catalogue
from aoabench.config.adopt import as_estimator, as_noise, as_scenario
from aoabench.config.catalogue import Parameter, composed, group_of, parameters
from aoabench.config.every import SMOOTHER, variant_of
from aoabench.config.plugins import construct, resolve
from aoabench.config.presets import GROUPS, LISTS, options, own_options, variants
from aoabench.errors import BadValue, Unfit, UserError, did_you_mean
from aoabench.resources import shipped
from aoabench.roles import NEEDS, Estimator

_PLUGGED = ("scenario", "noise", *LISTS)
_PLACES = ((), ("noise=ofdm_crlb",), ("scenario=ble_room", "noise=ble_multipath"))
_CITED = re.compile(r"\[([A-Z][^\[\]\d]*\s\d{4}(?:[,;][^\[\]]*)?)\]")  # [Le 2021, IV-B]
_LINE = re.compile(r"( *)(\w+): *([^#]*?) *(?:# *(.*))?")


class About(NamedTuple):
    """A preset: its group, name and description; a command that uses it; its keys; its class, and
    the first paragraph of its docstring; its source; names of NEEDS that it needs or offers; why
    `all` leaves it out, "" if it does not.

    source: the paper with its section or equations, if the docstrings of class or module name one,
    else the file of the class.
    """

    group: str
    preset: str
    description: str
    example: str
    parameters: list[Parameter]
    target: str = ""
    what: str = ""
    source: str = ""
    needs: Sequence[str] = ()
    offers: Sequence[str] | None = None
    not_in_all: str = ""


def about(name: str, config_dir: str | None = None, plugins: Sequence[str] = ()) -> About:
    """A preset of any group; UserError for an unknown name, and for a class outside the packages
    that presets may name, ours and `plugins`.
    """
    group = group_of(name, config_dir)
    chosen = f"{group}=[{name}]" if group in LISTS else f"{group}={name}"
    description = options(group, config_dir)[name]
    if group not in _PLUGGED:
        keys = _commented(_file(group, name, config_dir), group) if group == "runner" else []
        if group == "experiment":
            example = f"aoabench run {chosen} --cfg job"
        else:
            cluster = composed([chosen], config_dir)["runner"]["backend"] == "dask"
            example = _example(chosen, *["runner.address=tcp://HOST:PORT"] * cluster)
        return About(group, name, description, example, list(keys))
    plain = composed([chosen], config_dir, plugins)
    node = plain[group][name] if group in LISTS else plain[group]
    cls = resolve(node["_target_"], group, plugins)
    wants = _wants(group, name, node, chosen, plugins)
    words = variants(group, config_dir).get(name, "") if group in LISTS else ""
    return About(
        group,
        name,
        description,
        wants.example + _own(group, name, config_dir, plugins),
        parameters(name, config_dir, plugins),
        target=node["_target_"],
        what=_first(inspect.getdoc(cls)),
        source=_source(cls),
        needs=wants.needs,
        offers=wants.offers,
        not_in_all=variant_of(words) if words else "" if wants.causal else SMOOTHER,
    )


def of_key(
    key: str, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, Parameter]:
    """A key by its dotted name, or all keys below it, by the preset that has them; "" for keys of a
    run, which no preset of a plug-in defines. UserError for an unknown key.
    """
    found: dict[str, Parameter] = {}
    group, _, rest = key.partition(".")
    known = [p for p in run_keys() if p.key == key or p.key.startswith(f"{key}.")]
    if known:
        return {f" {p.key}": p for p in known}
    names = list(options(group, config_dir)) if group in _PLUGGED else []
    if group in LISTS:
        names = [name for name in names if name == rest.partition(".")[0]]
    near = [p.key for p in run_keys()]
    for name in names:
        each = parameters(name, config_dir, plugins)
        near += [p.key for p in each]
        for one in each:
            if one.key == key or one.key.startswith(f"{key}."):
                found[f"{name} {one.key}"] = one
    if not found:
        hint = did_you_mean(key, near) or "; `aoabench list` shows the presets, which have keys"
        raise UserError(f"{key!r}: no such key{hint}")
    return found


def run_keys() -> list[Parameter]:
    """The keys of a run: reps, seed, runner.*, store.*, until.*, with the words of their files."""
    runner = _commented(_file("runner", "local", None), "runner")
    return [*_commented(shipped("configs") / "config.yaml", ""), *runner]


def _file(group: str, name: str, config_dir: str | None) -> Path:
    """The file of a preset."""
    roots = [shipped("configs"), *([Path(config_dir)] if config_dir else [])]
    files = [root / group / f"{name}.yaml" for root in roots]
    return next(file for file in files if file.is_file())


def _commented(file: Path, head: str) -> Iterator[Parameter]:
    """The keys of a YAML file of plain values, with the comments on their lines."""
    import yaml

    above = head
    for line in file.read_text(encoding="utf-8").splitlines():
        found = _LINE.fullmatch(line)
        if found is None or found[2] == "defaults":
            continue
        indent, key, value, text = found.groups()
        if not value and not indent:
            above = ".".join(filter(None, (head, key)))
            continue
        above = above if indent else head
        path = ".".join(filter(None, (above, key)))
        yield Parameter(path, yaml.safe_load(value), "", text or "", "")


class _Wants(NamedTuple):
    """What a preset needs and offers, whether it is causal, and an example."""

    needs: list[str]
    offers: list[str] | None
    causal: bool
    example: str


def _wants(group: str, name: str, node: Any, chosen: str, plugins: Sequence[str]) -> _Wants:
    """What a preset needs and offers; one that cannot be built as it is, such as a recording
    without its file, states neither.
    """
    try:
        made = construct(node, group, plugins)
    except BadValue as error:
        return _Wants([], None, True, _example(chosen, f"{error.key}=..."))
    if group in LISTS:
        one = as_estimator(made, name)
        return _Wants(sorted(one.needs), None, one.causal, _example(chosen, *_place(one)))
    if group == "noise":
        offers = as_noise(made, name).offers()
        return _Wants([], None if offers is None else sorted(offers), True, _example(chosen))
    return _Wants([], sorted(as_scenario(made, name).offers()), True, _example(chosen))


def _place(estimator: Estimator) -> tuple[str, ...]:
    """The overrides of a scenario and a noise in which an estimator runs; none for the default."""
    for words in _PLACES:
        plain = composed(words)
        scenario = as_scenario(construct(plain["scenario"], "scenario"), "scenario")
        noise = as_noise(construct(plain["noise"], "noise"), "noise")
        try:
            estimator.check(scenario, noise)
        except (BadValue, Unfit):
            continue
        return words
    return ()


def need_text(need: str) -> str:
    """A need in words: "a noise that measures elevations"."""
    group, words = NEEDS[need]
    return f"a {group} {words.removeprefix('one ')}"


def _first(text: str | None) -> str:
    """The first paragraph of a docstring, on one line."""
    return " ".join((text or "").partition("\n\n")[0].split())


def _source(cls: type) -> str:
    """The papers that a class or its module names, with section or equations, else its file."""
    module = inspect.getmodule(cls)
    for text in (cls.__doc__, inspect.getdoc(module)):
        found = [" ".join(one.split()) for one in _CITED.findall(text or "")]
        if found:
            return "; ".join(dict.fromkeys(found))
    return f"{cls.__module__.replace('.', '/')}.py"


def fits(
    found: About, config_dir: str | None = None, plugins: Sequence[str] = ()
) -> dict[str, list[str]]:
    """Presets that run with this one. Of a filter or estimator: scenario -> noises; of a scenario:
    group -> filters or estimators; of a noise: "scenario" -> scenarios. Nothing for other groups,
    and where a preset cannot be built as it is, such as a recording without its file.
    """
    try:
        if found.group in LISTS:
            return catalogue.fitting_places(found.group, found.preset, config_dir, plugins)
        if found.group == "noise":
            return {"scenario": catalogue.scenarios_of(found.preset, config_dir, plugins)}
        if found.group != "scenario":
            return {}
        whole = catalogue.fitting(found.preset, config_dir, plugins)
    except UserError:
        return {}
    return {group: list(names) for group, names in whole.items() if names}


def _example(chosen: str, *more: str) -> str:
    """A command that uses a preset."""
    group = chosen.partition("=")[0]
    words = [f"'{chosen}'" if "[" in chosen else chosen, *more]
    words += [] if group in LISTS else ["estimator=all"]
    return f"aoabench run {' '.join(words)} reps=20"


def _own(group: str, name: str, config_dir: str | None, plugins: Sequence[str]) -> str:
    """What a command needs beside, to use a preset of a folder of one's own."""
    if config_dir is None or name not in own_options(group, config_dir):
        return ""
    named = f" 'plugins=[{','.join(plugins)}]'" if plugins else ""
    return f" --config-dir {shlex.quote(config_dir)}{named}"


def names(config_dir: str | None = None) -> list[str]:
    """Everything that `list NAME` knows: groups, presets, keys of a run."""
    presets = [name for group in GROUPS for name in options(group, config_dir)]
    return [*GROUPS, *presets, *(p.key for p in run_keys())]
