"""Hydra's and OmegaConf's exceptions as one clear line."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from aoabench.config.overrides import Setting
from aoabench.config.presets import ALL, GROUPS, LISTS, options, unread
from aoabench.errors import Mistakes, UserError, did_you_mean, shorten
from aoabench.maths.digest import flatten


class NotComposed(Exception):
    """Hydra refuses choices of presets: its exceptions, by the lines of overrides at fault."""

    def __init__(self, errors: Mapping[str, Exception]) -> None:
        self.errors = dict(errors)
        super().__init__(*map(str, errors.values()))


@contextmanager
def explained(settings: Sequence[Setting], config_dir: str | None = None) -> Iterator[None]:
    """Turn the exceptions of Hydra, OmegaConf and the YAML parser into one clear line each."""
    try:
        yield
    except UserError:
        raise
    except NotComposed as error:
        mistakes = Mistakes()
        for one in error.errors.values():
            mistakes.note(explain(one, settings, config_dir))
        mistakes.check()
    except Exception as error:
        raise explain(error, settings, config_dir) from None


def explain(
    error: Exception, settings: Sequence[Setting], config_dir: str | None = None
) -> UserError:
    """An exception of Hydra, OmegaConf or the YAML parser as one clear line; raises any other."""
    import yaml
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, UserError):
        return error
    if isinstance(error, RecursionError):
        words = shorten(" ".join(shorten(s.word) for s in settings)) or "this config"
        return UserError(
            f"{words}: cannot be composed: a value is nested too deeply, "
            "or a config contains itself"
        )
    if isinstance(error, HydraException | OmegaConfBaseException):
        return UserError(_explain(error, settings, config_dir))
    if isinstance(error, ValueError | TypeError | AssertionError | yaml.YAMLError):
        return UserError(_not_composed(error, settings))  # Hydra's own, e.g. of noise=null
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        longest = max((s.word for s in settings), key=len, default="")
        return UserError(f"{shorten(longest)}: too long for the name of a preset")
    raise error


def _explain(error: Exception, settings: Sequence[Setting], config_dir: str | None) -> str:
    from hydra.errors import MissingConfigException
    from omegaconf.errors import InterpolationResolutionError

    if isinstance(error, InterpolationResolutionError):
        return f"{error.full_key}: {first_line(error)}"
    missing = getattr(error, "missing_cfg_file", None)
    if isinstance(error, MissingConfigException) and missing:
        group, _, name = str(missing).rpartition("/")
        known = list(getattr(error, "options", None) or options(group, config_dir))
        return unknown_preset(group or "config", name, known)
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


_MOST_ALLOWED = 12  # names in a message that proposes one


def unknown_preset(group: str, name: str, known: Sequence[str]) -> str:
    """The message about a name that no preset of a group has."""
    every = [ALL, *known] if group in LISTS else known
    hint = did_you_mean(name, every)
    if own := unread(group, name):
        allowed = own
    elif hint and len(every) > _MOST_ALLOWED:
        allowed = f"{hint} allowed: those of `aoabench list {group}`"
    else:
        allowed = f"{hint or ';'} allowed: {', '.join(every) or 'none'}"
    return f"{group}={shorten(repr(name))}: unknown preset{allowed}"


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
