"""Hydra's compose API over the presets, and plain nodes from composed configs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aoabench.config.guard import refuse_foreign_hydra
from aoabench.config.messages import first_line
from aoabench.config.plugins import spelled_out
from aoabench.config.presets import LISTS
from aoabench.errors import UserError
from aoabench.resources import shipped


@contextmanager
def hydra_initialised(config_dir: str | None = None) -> Iterator[None]:
    """Initialise Hydra's compose API over the shipped configs, and the user's own folder once it is
    checked.
    """
    from hydra._internal.hydra import Hydra
    from hydra._internal.utils import create_config_search_path
    from hydra.core.config_search_path import SearchPathQuery
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.singleton import Singleton
    from hydra.version import setbase

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
        yield
    finally:
        Singleton.set_state(before)


def with_defaults(cfg: Any, plugins: Sequence[str]) -> dict[str, Any]:
    """A composed config as plain nodes: interpolations unresolved, Hydra's own node left out, the
    defaults of the plug-ins' classes filled in.
    """
    from omegaconf import OmegaConf

    node = OmegaConf.create({key: cfg._get_node(key) for key in cfg if key != "hydra"})
    plain: Any = OmegaConf.to_container(node, resolve=False)
    for group in ("scenario", "noise"):
        plain[group] = spelled_out(plain.get(group), plugins)
    for group in LISTS:
        nodes = plain.get(group)
        if isinstance(nodes, dict):
            plain[group] = {name: spelled_out(one, plugins) for name, one in nodes.items()}
    return dict(plain)


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
