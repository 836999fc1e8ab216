"""The words of a command line as overrides, read once and with Hydra's grammar.

A word is KEY=VALUE, GROUP=NAME, +KEY=VALUE or ~KEY. No other module of the package parses such a
word.
"""

from __future__ import annotations

import difflib
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from aoabench.config.file_names import quoted, quoted_folder, quoted_names
from aoabench.config.presets import GROUPS, LISTS, options
from aoabench.errors import Mistakes, UserError, shorten

# Keys whose values are names of files or folders. The user need not quote them: names that Hydra's
# grammar cannot read as text are quoted here.
PATH_KEYS = ("scenario.path", "scenario.anchors", "scenario.walls", "scenario.truth", "runner.out")

_TOP_LEVEL = (*GROUPS, "reps", "seed", "plugins", "store.steps", "until.metric", "runner.out")
_MOST_VALUES = 100_000  # of one swept key
_MOST_CELLS = 1_000_000  # of a sweep
_KEY = re.compile(r"[A-Za-z_$][\w$-]*([./][\w$-]+)*(@[\w$.-]*)?", re.ASCII)
_OF_A_PLUG_IN = re.compile(r"(scenario|noise|filter|estimator)\.")
_BRACKETS = {")": "(", "]": "[", "}": "{"}
_BARE = re.compile(r"[A-Za-z0-9_ \t/\\+.$%*@?|:,()\[\]{}'\"-]")  # Hydra reads these without quotes


@dataclass(frozen=True)
class Setting:
    """One override.

    `word` is the user's text and `line` the text that Hydra reads (with file names quoted). `key`
    is the dotted key or the config group, without prefix and package; `package` is "" if not given.
    """

    word: str
    line: str
    key: str
    package: str
    is_sweep: bool
    is_deletion: bool
    parsed: Any = field(repr=False, compare=False)  # hydra.core.override_parser.types.Override

    @property
    def value(self) -> Any:
        """The value as plain Python; for a sweep, Hydra's own object."""
        return self.parsed.value()

    @property
    def texts(self) -> list[str]:
        """All texts in the value, before and after Hydra removes escapes and quotes."""
        return [self.line.partition("=")[2], *leaves(self.value)]


def read(words: Iterable[str], sweep: bool = True) -> list[Setting]:
    """The words as settings; with `sweep`, commas in a file name separate values.

    Raises UserError for words that are no overrides or that Hydra's grammar cannot read.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    mistakes = Mistakes()
    found = [mistakes.tried(_read, parser, word, sweep) for word in words]
    mistakes.check()
    return [setting for setting in found if setting is not None]


def refuse_two_ways(settings: Sequence[Setting]) -> None:
    """Raise UserError for a group or key of a run to which a word adds with `+` and that another
    word sets or adds to: Hydra would take one of them, or neither.
    """
    found: dict[str, list[Setting]] = {}
    for setting in settings:
        if "." not in setting.key and not setting.is_deletion:
            found.setdefault(setting.key, []).append(setting)
    for key, each in found.items():
        if len(each) > 1 and any(setting.line.startswith("+") for setting in each):
            names = dict.fromkeys(name for setting in each for name in leaves(setting.value))
            one = f"one list, {key}=[{','.join(names)}]" if key in LISTS else "one of them"
            words = " and ".join(shorten(setting.word) for setting in each)
            raise UserError(f"{words}: {key} is set in two ways; allowed: {one}")


def file_setting(key: str, path: object) -> str:
    """The override that sets `key` to one file or folder, whatever its name."""
    return f"{key}={quoted(str(path))}"


def jobs(settings: Sequence[Setting]) -> list[list[str]]:
    """The lines of each job: all combinations of the values of swept keys; a key's last setting
    counts. Call this where Hydra is initialised.

    Raises UserError for a sweep whose values cannot be counted, or over too many cells.
    """
    lines: dict[str, list[str]] = {}
    for setting in settings:
        key = setting.parsed.get_key_element()
        lines[key] = (
            [f"{key}={v}" for v in _values(setting)] if setting.is_sweep else [setting.line]
        )
    count = math.prod(map(len, lines.values()))
    if count > _MOST_CELLS:
        swept = " ".join(shorten(s.word, 80) for s in settings if s.is_sweep)
        raise UserError(f"{swept}: a sweep over {count} cells; allowed: at most {_MOST_CELLS}")
    return [list(job) for job in itertools.product(*lines.values())]


def _read(parser: Any, word: str, sweep: bool) -> Setting:
    from hydra.errors import HydraException

    typed = _without_shell_quotes(word)
    head, equals, value = typed.partition("=")
    if not equals and not typed.startswith("~"):
        raise UserError(_no_override(typed))
    name = head.lstrip("+~")
    if not _KEY.fullmatch(name):
        raise UserError(
            f"{shorten(word)} cannot be read: {shorten(name)!r} is not a key; allowed: KEY=VALUE "
            "without spaces, with a key of letters, digits, _ and dots"
        )
    line = typed
    if name == "runner.out" and value:
        line = f"{head}={quoted_folder(parser, value, sweep)}"
    elif name in PATH_KEYS and value:
        line = f"{head}={quoted_names(parser, value, sweep)}"
    if head == name and _OF_A_PLUG_IN.match(name):
        line = f"++{line}"  # the class defines the parameters, not the preset
    try:
        parsed = parser.parse_rule(line, "override")
    except (HydraException, RecursionError) as error:
        raise UserError(_unreadable(word, value, error)) from None
    return Setting(
        word=typed,
        line=line,
        key=parsed.key_or_group,
        package=parsed.package or "",
        is_sweep=parsed.is_sweep_override(),
        is_deletion=parsed.is_delete(),
        parsed=parsed,
    )


def _without_shell_quotes(word: str) -> str:
    """The word without quotes around all of it, which Windows' command prompt does not remove."""
    whole = len(word) > 2 and word[0] == word[-1] and word[0] in "'\"" and "=" in word
    return word[1:-1] if whole else word


def _no_override(word: str) -> str:
    """The message about a word without `=`."""
    presets = [(name, group) for group in GROUPS for name in options(group)]
    known = {n: f"{g}=[{n}]" if g in LISTS else f"{g}={n}" for n, g in presets}
    known |= {key: f"{key}=..." for key in _TOP_LEVEL}
    text = f"{shorten(word)!r} is not an override; allowed: KEY=VALUE, GROUP=NAME, ~KEY"
    key, mark, value = word.partition(":")
    if mark and key in _TOP_LEVEL:
        return f"{text}; did you mean '{shorten(f'{key}={value.strip()}')}'?"
    close = difflib.get_close_matches(word, known, n=1)
    return f"{text}; did you mean '{known[close[0]]}'?" if close else text


def leaves(value: Any) -> Iterator[str]:
    """The texts in a parsed value, those of a sweep too."""
    from hydra.core.override_parser.types import ChoiceSweep, QuotedString

    if isinstance(value, ChoiceSweep):
        value = value.list
    elif isinstance(value, dict):
        value = [*value, *value.values()]
    if isinstance(value, list):
        for item in value:
            yield from leaves(item)
    else:
        yield value.text if isinstance(value, QuotedString) else str(value)


def _values(setting: Setting) -> list[str]:
    """The values of a sweep, as Hydra reads them."""
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.override_parser.types import RangeSweep
    from hydra.errors import HydraException

    if not setting.parsed.is_discrete_sweep():
        raise UserError(
            f"{shorten(setting.word)}: not single values; "
            "allowed: VALUE,VALUE or range(START,STOP,STEP)"
        )
    setting.parsed.config_loader = GlobalHydra.instance().config_loader()
    value, too_many = setting.value, f"more than {_MOST_VALUES} values, the allowed maximum"
    if isinstance(value, RangeSweep) and value.step:  # if shuffled, Hydra makes a list of it
        assert value.start is not None
        assert value.stop is not None
        if (value.stop - value.start) / value.step > _MOST_VALUES:
            raise UserError(f"{shorten(setting.word)}: {too_many}")
    try:
        found = list(itertools.islice(setting.parsed.sweep_string_iterator(), _MOST_VALUES + 1))
    except (HydraException, ValueError, TypeError) as error:
        raise UserError(f"{shorten(setting.word)}: {_reason(error)}") from None
    if len(found) > _MOST_VALUES:
        raise UserError(f"{shorten(setting.word)}: {too_many}")
    return found


def _unreadable(word: str, value: str, error: Exception) -> str:
    """The message about a word that Hydra's grammar cannot read, in plain English."""
    complaint = _complaint(value) or _reason(error)
    key = shorten(word.partition("=")[0].lstrip("'\""))
    if len(value) > 80 or set(value) & set('"$`\\'):
        value = "VALUE"
    quoted = rf'"{key}=\"{value}\""' if "'" in value else f"'{key}=\"{value}\"'"
    return (
        f"{shorten(word)} cannot be read: {complaint}; "
        f"allowed: KEY=VALUE, KEY=[VALUE,VALUE], or text in two pairs of quotes: {quoted}"
    )


def _complaint(value: str) -> str:
    """The message about the first quote or bracket without a partner, or the first character that
    needs quotes; "" if none.
    """
    opened: list[str] = []
    quote = ""
    for i, mark in enumerate(value):
        if quote:
            quote = "" if mark == quote and value[i - 1] != "\\" else quote
        elif mark in "'\"":
            quote = mark
        elif mark in "([{" and value[i - 1 : i] != "\\":
            opened.append(mark)
        elif mark in _BRACKETS and value[i - 1 : i] != "\\":
            if not opened or opened.pop() != _BRACKETS[mark]:
                return f"{mark!r} closes nothing"
        elif not _BARE.match(mark):
            return f"{mark!r} needs quotes"
    if quote:
        return f"the quote {quote} is not closed"
    return f"{opened[-1]!r} is not closed" if opened else ""


def _reason(error: Exception) -> str:
    """The reason that Hydra gives for refusing a value, without names of classes."""
    if isinstance(error, RecursionError):
        return "the value is nested too deeply"
    text = str(error)
    if "while evaluating" in text:  # a function's own message comes last
        own = text.rpartition("': ")[2].strip() or "the function in the value fails"
        return shorten(own.splitlines()[0].lower())
    if "arg 3 must not be zero" in text or "Invalid range values" in text:
        return "the step of a range must not be 0"
    return "the text is not a value"
