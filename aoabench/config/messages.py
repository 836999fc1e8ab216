"""Hydra's and OmegaConf's exceptions as one clear line."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from aoabench.config.overrides import Setting
from aoabench.config.presets import GROUPS, options
from aoabench.errors import UserError, did_you_mean, shorten
from aoabench.maths.digest import flatten


@contextmanager
def explained(settings: Sequence[Setting], config_dir: str | None = None) -> Iterator[None]:
    """Turn the exceptions of Hydra, OmegaConf and the YAML parser into one clear line."""
    import yaml
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    try:
        yield
    except UserError:
        raise
    except RecursionError:
        words = shorten(" ".join(shorten(s.word) for s in settings)) or "this config"
        raise UserError(
            f"{words}: cannot be composed: a value is nested too deeply, "
            "or a config contains itself"
        ) from None
    except (HydraException, OmegaConfBaseException) as error:
        raise UserError(_explain(error, settings, config_dir)) from None
    except (ValueError, TypeError, AssertionError, yaml.YAMLError) as error:
        # Hydra's own, e.g. of noise=null
        raise UserError(_not_composed(error, settings)) from None
    except OSError as error:  # Hydra's own, of the name of a preset
        if error.errno != errno.ENAMETOOLONG:
            raise
        longest = max((s.word for s in settings), key=len, default="")
        raise UserError(f"{shorten(longest)}: too long for the name of a preset") from None


def _explain(error: Exception, settings: Sequence[Setting], config_dir: str | None) -> str:
    from hydra.errors import MissingConfigException
    from omegaconf.errors import InterpolationResolutionError

    if isinstance(error, InterpolationResolutionError):
        return f"{error.full_key}: {first_line(error)}"
    missing = getattr(error, "missing_cfg_file", None)
    if isinstance(error, MissingConfigException) and missing:
        group, _, name = str(missing).rpartition("/")
        known = list(getattr(error, "options", None) or options(group, config_dir))
        hint = did_you_mean(name, known)
        return (
            f"{group or 'config'}={shorten(repr(name))}: unknown preset{hint or ';'} "
            f"allowed: {', '.join(known) or 'none'}"
        )
    text = str(error)
    for setting in settings:
        key = setting.key + (f"@{setting.package}" if setting.package else "")
        word = shorten(setting.word)
        if text.startswith(f"Error merging override {setting.line}") and error.__cause__:
            return f"{word}: {first_line(error.__cause__)}"
        if f"'{key}'" in text or f"full_key: {key}" in text:
            chosen = [s.line.partition(",")[0] for s in settings if s.key == "scenario"]
            return f"{word}: {_about_key(key, chosen)}"
        if f"{key} appears more than once" in text:
            return f"{word}: one {key} is chosen already; allowed: {word.lstrip('+')}"
    return _not_composed(error, settings)


def _not_composed(error: Exception, settings: Sequence[Setting]) -> str:
    """The message about an exception that names none of the overrides."""
    for setting in settings:
        if setting.key in GROUPS and not isinstance(setting.value, str | list):
            return f"{shorten(setting.word)}: the name of a preset must be a string"
    words = shorten(" ".join(shorten(s.word) for s in settings)) or "this config"
    return f"{words}: cannot be composed: {first_line(error)}"


def _about_key(key: str, chosen: Sequence[str]) -> str:
    """The message about an unknown key on the command line; `chosen` are the overrides that name a
    scenario.
    """
    hint = did_you_mean(key, [k for k in known_keys(chosen=chosen) if k != key])
    return f"unknown key {shorten(repr(key))}{hint or '; `aoabench run --cfg job` shows the keys'}"


def known_keys(chosen: Sequence[str] = ()) -> list[str]:
    """Dotted keys of the default config with the overrides `chosen`; call this where Hydra is
    initialised.
    """
    from hydra import compose
    from omegaconf import OmegaConf

    cfg = compose("config", overrides=list(chosen))
    keys = [key for key, _ in flatten(OmegaConf.to_container(cfg, resolve=False))]
    return [*keys, *GROUPS]


def first_line(error: BaseException) -> str:
    """The first line of an exception's text, or of its cause's, without names of classes."""
    from omegaconf.errors import GrammarParseError

    if isinstance(error, GrammarParseError):
        return "an interpolation ${...} in the value cannot be read"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if not lines:
        return first_line(error.__cause__) if error.__cause__ else "no reason is given"
    text = lines[0].replace("DictConfig", "a mapping").replace("ListConfig", "a list")
    return shorten(
        re.sub(r"^\w*(Error|Exception)( raised while resolving interpolation)?: ", "", text)
    )
