"""`filter=all` and `estimator=all`: every preset of the group that fits.

Presets that are variants of others are left out before Hydra composes; smoothers, and what scenario
and noise do not suit, once they are built (see `fit`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from aoabench.config.overrides import leaves
from aoabench.config.presets import ALL, LISTS, options, variants

SMOOTHER = "a smoother, which uses later measurements too"


@dataclass(frozen=True)
class ByAll:
    """What `all` stands for in a job: dotted keys of the presets to run if they fit, and those of
    the presets left out, with the reason.
    """

    chosen: frozenset[str] = frozenset()
    left_out: dict[str, str] = field(default_factory=dict)

    def __or__(self, other: ByAll) -> ByAll:
        return ByAll(self.chosen | other.chosen, self.left_out | other.left_out)

    @property
    def words(self) -> str:
        """The overrides that chose by `all`."""
        groups = {key.partition(".")[0] for key in (*self.chosen, *self.left_out)}
        return " ".join(f"{group}={ALL}" for group in LISTS if group in groups)


def variant_of(words: str) -> str:
    """The reason for leaving out a variant, from the words of its preset."""
    return f"a variant {words}"


def expanded(line: str, parsed: Any, config_dir: str | None) -> tuple[str, ByAll]:
    """A line of overrides with the names of presets in place of `all`, and what it stands for;
    `parsed` is the line as Hydra reads it.

    Names beside it, as in `filter=[all,map_smoother]`, are chosen as without it. A preset of the
    user's own that is called `all` is that preset.
    """
    group = parsed.key_or_group
    if group not in LISTS or parsed.package or parsed.is_delete() or parsed.is_sweep_override():
        return line, ByAll()
    names = list(leaves(parsed.value()))
    known = options(group, config_dir)
    if ALL not in names or ALL in known:
        return line, ByAll()
    named = [name for name in names if name != ALL]
    variant = variants(group, config_dir)
    every = [name for name in known if name not in variant and name not in named]
    head = line.partition("=")[0]
    left_out = {f"{group}.{n}": variant_of(words) for n, words in variant.items()}
    left_out = {key: why for key, why in left_out.items() if key.partition(".")[2] not in named}
    chosen = frozenset(f"{group}.{name}" for name in every)
    return f"{head}=[{','.join([*every, *named])}]", ByAll(chosen, left_out)
