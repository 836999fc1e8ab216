"""Checks of a composed config before anything is built from it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from aoabench.config.presets import LISTS, options
from aoabench.errors import Mistakes, UserError, check_number, did_you_mean

_TOP_LEVEL = (
    "scenario",
    "noise",
    "filter",
    "estimator",
    "runner",
    "store",
    "until",
    "reps",
    "seed",
    "plugins",
)


class NoEstimator(UserError):
    """Neither a filter nor an estimator is given."""


def check_top_level(
    plain: Mapping[str, Any],
    choices: Mapping[str, Any],
    plugins: Sequence[str],
    mistakes: Mistakes,
) -> None:
    """Enter unknown keys, reps and seed in `mistakes`; raise UserError for plugins from a file and
    missing groups, without which nothing can be built.
    """
    for key in plain:
        if key not in _TOP_LEVEL:
            hint = did_you_mean(str(key), _TOP_LEVEL) or "; allowed: " + ", ".join(_TOP_LEVEL)
            mistakes.note(UserError(f"{key}: unknown key{hint}"))
    if list(plain.get("plugins") or []) != list(plugins):
        raise UserError(
            f"plugins={plain.get('plugins')}: a file must not name plug-in packages; "
            "allowed: plugins=[...] on the command line"
        )
    limits: dict[str, Any] = {"most": 100_000_000, "integer": True}
    mistakes.tried(check_number, "reps", plain.get("reps"), least=1, **limits)
    limits["most"] = 2**63 - 1
    mistakes.tried(check_number, "seed", plain.get("seed"), least=0, **limits)
    for group in ("scenario", "noise"):
        if not isinstance(choices.get(group), str) or not plain.get(group):
            mistakes.note(
                UserError(
                    f"{group}={choices.get(group)}: exactly one preset is needed; "
                    f"allowed: {', '.join(options(group))}"
                )
            )
    if not (plain.get("scenario") and plain.get("noise")):
        mistakes.check()


def check_names(plain: Mapping[str, Any], extra: Mapping[str, Any]) -> None:
    """Raise UserError for a job without any preset or object as an estimator, and for invalid
    names.
    """
    groups = [plain.get(group) for group in LISTS]
    presets = [name for nodes in groups if isinstance(nodes, dict) for name in nodes]
    for name in extra:
        if name in presets:
            raise UserError(
                f"estimators[{name!r}]: a preset of this name is selected; choose another name"
            )
    for name in (*presets, *extra):
        if not isinstance(name, str) or re.search(r"^\.|[/\\\x00-\x1f]", name):
            raise UserError(
                f"{name!r} is not allowed as the name of an estimator; "
                "allowed: a text without slashes and without a dot as its first character"
            )
    if not any(groups) and not extra:
        known = ", ".join((*options("filter"), *options("estimator")))
        raise NoEstimator(
            "filter=[], estimator=[]: at least one filter or estimator must be given, "
            f"e.g. 'filter=[ekf_vmf]'; allowed: all, {known}"
        )
