"""Hydra's and OmegaConf's exceptions as one clear line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError, did_you_mean
from aoabench.maths.digest import flatten


@contextmanager
def explained(overrides: Sequence[str], config_dir: str | None = None) -> Iterator[None]:
    """Turn Hydra's and OmegaConf's exceptions into one clear line."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    try:
        yield
    except UserError:
        raise
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_explain(error, overrides, config_dir)) from None
    except (
        ValueError,
        TypeError,
        AssertionError,
    ) as error:  # Hydra's own: noise=null, range(1,5,0)
        raise UserError(f"{' '.join(overrides)}: cannot be composed: {first_line(error)}") from None


def _explain(error: Exception, overrides: Sequence[str], config_dir: str | None) -> str:
    from hydra.errors import MissingConfigException, OverrideParseException

    if isinstance(error, OverrideParseException):
        return f"{error.override!r} cannot be read: {first_line(error)}"
    missing = getattr(error, "missing_cfg_file", None)
    if isinstance(error, MissingConfigException) and missing:
        group, _, name = str(missing).rpartition("/")
        known = list(getattr(error, "options", None) or options(group, config_dir))
        hint = did_you_mean(name, known)
        return (
            f"{group or 'config'}={name!r}: unknown preset{hint or ';'} "
            f"allowed: {', '.join(known) or 'none'}"
        )
    text = str(error)
    for override in overrides:
        key = override.partition("=")[0].lstrip("+~")
        if f"'{key}'" in text or f"full_key: {key}" in text:
            chosen = [
                o.partition(",")[0] for o in overrides if o.startswith("scenario=")
            ]  # the first of a sweep
            return f"{override}: {_about_key(key, chosen, config_dir)}"
    return f"{' '.join(overrides)}: {first_line(error)}"


def _about_key(key: str, chosen: Sequence[str], config_dir: str | None) -> str:
    """Why a key given on the command line does not exist; `chosen` are the overrides that name a
    scenario.
    """
    head, _, rest = key.partition(".")
    if head in ("filter", "estimator") and rest:
        name = rest.partition(".")[0]
        if name in options(head, config_dir):
            hint = did_you_mean(key, [k for k in known_keys(name, head) if k != key])
            return f"no such key, or {head} {name!r} is not selected: {head}=[{name}]{hint}"
        return f"unknown {head} {name!r}{did_you_mean(name, options(head, config_dir))}"
    hint = did_you_mean(key, [k for k in known_keys(chosen=chosen) if k != key])
    return f"unknown key {key!r}{hint or '; `aoabench run --cfg job` shows the keys'}"


def known_keys(
    preset: str | None = None, group: str = "filter", chosen: Sequence[str] = ()
) -> list[str]:
    """Dotted keys of the default config, with one preset and what is `chosen`; call it where Hydra
    is initialised.
    """
    from hydra import compose
    from omegaconf import OmegaConf

    cfg = compose("config", overrides=[*chosen, *([f"{group}=[{preset}]"] if preset else [])])
    keys = [key for key, _ in flatten(OmegaConf.to_container(cfg, resolve=False))]
    return [*keys, *GROUPS]


def first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__
