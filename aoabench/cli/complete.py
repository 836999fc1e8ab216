"""Completion of overrides in a shell."""

from __future__ import annotations

import click
from click.shell_completion import BashComplete, CompletionItem, add_completion_class

from aoabench.config.overrides import PATH_KEYS
from aoabench.config.presets import GROUPS, LISTS, options

_KEYS = ("reps", "seed", "store.steps", "until.metric", "runner.n_jobs", "plugins")


class _Bash(BashComplete):
    """click's completion for bash, without a space after KEY=."""

    source_template = BashComplete.source_template.replace(
        "COMPREPLY+=($value)",
        "COMPREPLY+=($value)\n            [[ $value == *= ]] && compopt -o nospace",
    )


add_completion_class(_Bash)


def override_items(
    ctx: click.Context, _param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Completions of one override of `run`: groups and keys, then after `=` presets or files.

    bash splits words at `=`, so that GROUP, = and the beginning of NAME arrive as three words, of
    which only NAME is completed.
    """
    words = [*(ctx.params.get("words") or ()), *ctx.args]
    before = words[:-1] if words[-1:] == ["="] else words
    split = bool(before) and "=" not in before[-1] and before[-1] in (*GROUPS, *PATH_KEYS)
    if split:
        key, value, head = before[-1], incomplete, ""
    else:
        key, equals, value = incomplete.partition("=")
        if not equals:
            names = (*GROUPS, *PATH_KEYS, *_KEYS)
            return [CompletionItem(f"{n}=") for n in names if n.startswith(incomplete)]
        head = f"{key}="
    if key in PATH_KEYS:
        return [CompletionItem(value, type="file")]
    folder = ctx.params.get("config_dir")
    presets = list(options(key, folder)) if key in GROUPS else []
    return [CompletionItem(head + item) for item in _names(key, value, presets)]


def _names(group: str, value: str, names: list[str]) -> list[str]:
    """Completions of a value: a name, or in brackets a list whose last name is completed."""
    if group not in LISTS:
        return [name for name in names if name.startswith(value)]
    done, comma, last = value.rpartition(",")
    start = done + comma if comma else "["
    last = last.removeprefix("[")
    taken = done.removeprefix("[").split(",")
    return [f"{start}{n}]" for n in names if n.startswith(last) and n not in taken]
