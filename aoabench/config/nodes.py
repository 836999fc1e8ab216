"""Hydra's compose API over the presets, and plain nodes from composed configs."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aoabench.config.guard import refuse_foreign_hydra
from aoabench.config.messages import first_line
from aoabench.config.plugins import Speller
from aoabench.config.presets import LISTS
from aoabench.config.resolvers import guard
from aoabench.errors import UserError
from aoabench.resources import shipped

# an interpolation that names another key by its path from the top, or reads the environment
_REFERENCE = re.compile(r"\$\{(?:(\w+)(?:\.\w+)*|oc\.env:[^${}]*)\}")
_HYDRA = threading.RLock()


@contextmanager
def hydra_initialised(config_dir: str | None = None) -> Iterator[None]:
    """Initialise Hydra's compose API over the shipped configs, and the user's own folder once it is
    checked. No interpolation reads the machine meanwhile, except as `resolvers` allows. Hydra has
    one state for all threads: others wait.
    """
    from hydra._internal.hydra import Hydra
    from hydra._internal.utils import create_config_search_path
    from hydra.core.config_search_path import SearchPathQuery
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton
    from hydra.version import setbase

    with _HYDRA:
        refuse_foreign_hydra(config_dir)
        before = Singleton.get_state()
        GlobalHydra.instance().clear()
        setbase("1.3")
        path = create_config_search_path(str(shipped("configs")))
        if config_dir:
            path.prepend(
                "command-line",
                f"file://{Path(config_dir).resolve()}",
                SearchPathQuery(provider="schema"),
            )
        Hydra.create_main_hydra2(task_name="aoabench", config_search_path=path)
        try:
            guard()
            yield
        finally:
            Singleton.set_state(before)


def plain_nodes(cfg: Any, speller: Speller) -> dict[str, Any]:
    """A composed config without Hydra's own node as plain nodes: interpolations unresolved, the
    defaults of the plug-ins' classes filled in.
    """
    from omegaconf import OmegaConf

    nodes: Any = OmegaConf.to_container(cfg, resolve=False)
    return with_defaults(nodes, speller)


def with_defaults(nodes: Mapping[str, Any], speller: Speller) -> dict[str, Any]:
    """Plain nodes of a config with the defaults of the plug-ins' classes filled in."""
    found = dict(nodes)
    for group in ("scenario", "noise"):
        found[group] = speller(nodes.get(group))
    for group in LISTS:
        named = nodes.get(group)
        if isinstance(named, dict):
            found[group] = {name: speller(one) for name, one in named.items()}
    return found


@dataclass
class Resolver:
    """`resolved` for the jobs of one sweep: equal nodes are resolved once, where all interpolations
    are plain references or read the environment.
    """

    known: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __call__(self, raw: Mapping[str, Any]) -> Mapping[str, Any]:
        own = [key for key, node in raw.items() if is_open(node)]
        if not own:
            return raw
        part = {key: raw[key] for key in _reached(raw, own)}
        text = repr(part)
        if text not in self.known:
            self.known[text] = resolved(part)
        return {**raw, **{key: self.known[text][key] for key in own}}


def _reached(raw: Mapping[str, Any], own: Sequence[str]) -> Sequence[str]:
    """The top-level keys that interpolations below the keys `own` can reach, with `own`."""
    reached = list(own)
    for key in reached:  # grows meanwhile
        for text in _texts(raw[key]):
            plain = _REFERENCE.findall(text)
            if len(plain) < text.count("${"):
                return list(raw)
            reached += [name for name in plain if name in raw and name not in reached]
    return reached


def _texts(node: Any) -> Iterator[str]:
    """The texts in a plain node."""
    if isinstance(node, str):
        yield node
    elif isinstance(node, Mapping | list):
        for value in node.values() if isinstance(node, Mapping) else node:
            yield from _texts(value)


def resolved(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Plain nodes with their interpolations resolved; UserError for one that cannot be."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        plain: Any = OmegaConf.to_container(
            OmegaConf.create(dict(raw)), resolve=True, throw_on_missing=True
        )
    except OmegaConfBaseException as error:
        key = getattr(error, "full_key", None)
        raise UserError(f"{key}: {first_line(error)}" if key else first_line(error)) from None
    return dict(plain)


def is_open(node: Any) -> bool:
    """Whether a text in a plain node holds an interpolation, or stands for a missing value."""
    if isinstance(node, str):
        return "${" in node or node == "???"
    if isinstance(node, Mapping):
        return any(map(is_open, node.values()))
    return isinstance(node, list) and any(map(is_open, node))
