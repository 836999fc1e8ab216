"""Interpolations that read the machine are refused: parameters are stored in tables that people
share.
"""

from __future__ import annotations

from typing import Any

from aoabench.errors import UserError, shorten

VARIABLES = ("DASK_SCHEDULER_ADDRESS",)  # of the environment, which any config may read
_REFUSED = ("hydra", "now", "python_version")


def guard() -> None:
    """Let OmegaConf's `oc.env` read VARIABLES only, and Hydra's own resolvers nothing.

    This lasts until Hydra's state is put back: all resolvers are a part of it.
    """
    from omegaconf import OmegaConf

    OmegaConf.register_new_resolver("oc.env", _environment, replace=True)
    for name in _REFUSED:
        OmegaConf.register_new_resolver(name, _refusing(name), replace=True)


def _environment(*given: Any) -> Any:
    """OmegaConf's `oc.env`; UserError for a variable that configs must not read."""
    from omegaconf.resolvers import oc

    if given[:1] and given[0] in VARIABLES:
        return oc.env(*given)
    name = shorten(repr(str(given[0]))[1:-1], 80) if given else ""
    raise UserError(
        f"${{oc.env:{name}}} is not allowed, because tables hold all parameters; "
        f"allowed: the value itself, or ${{oc.env:{','.join(VARIABLES)}}}"
    )


def _refusing(name: str) -> Any:
    def refuse(*_given: Any) -> Any:
        raise UserError(f"${{{name}:...}} is not allowed; allowed: the value itself")

    return refuse
