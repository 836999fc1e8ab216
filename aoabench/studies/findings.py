"""What was found, in sentences whose numbers come from the stored tables."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from aoabench.errors import UserError
from aoabench.maths.estimate import Estimate
from aoabench.store.files import write_atomically
from aoabench.studies import stored
from aoabench.studies.statements import headline
from aoabench.studies.study import Study

if TYPE_CHECKING:
    import pandas as pd

Values = Mapping[str, tuple[Estimate, float]]
_NUMBER = re.compile(r"\{([^{}:]+?)(?:\.(low|high|se))?(?::([^{}]*))?\}")
_MARKS = re.compile(r"(<!-- findings -->\n).*?(\n<!-- /findings -->)", re.DOTALL)


def filled(template: str, values: Values) -> str | None:
    """A sentence with {id}, {id.low}, {id.high} or {id.se}, each with a format such as {id:.2f},
    filled with our number of this id, the ends of its 95 % interval or its standard error; None if
    a number was not computed.

    Raises UserError for a format that is none.
    """
    if any(match[1] not in values for match in _NUMBER.finditer(template)):
        return None

    def text(match: re.Match[str]) -> str:
        estimate = values[match[1]][0]
        low, high = estimate.interval()
        parts = {None: estimate.value, "low": low, "high": high, "se": estimate.se}
        try:
            return format(parts[match[2]], match[3] or ".3g")
        except ValueError:
            raise UserError(
                f"finding: {match[0]}: no format of a number; allowed: {{id:.2f}} and the like"
            ) from None

    return " ".join(_NUMBER.sub(text, template).split())


def overview(
    studies: Sequence[Study], claims: pd.DataFrame, results: Path
) -> list[tuple[str, str]]:
    """The name and the first finding of each study, from the tables under `results`, and "" with a
    sentence on all claims and errata. A study whose first finding was not computed is left out.
    """
    texts = []
    for study in studies:
        if study.findings:
            contents = [stored.read(study, item, results).values for item in study.items]
            values = {key: value for one in contents for key, value in one.items()}
            texts.append((study.name, filled(study.findings[0], values)))
    head = headline(claims)
    errata = sum(len(study.errata) for study in studies)
    last = f"{head[:1].upper()}{head[1:]}; {errata} errata of the papers, each with a test."
    return [*((name, text) for name, text in texts if text), ("", last)]


def further(study: Study, values: Values) -> str:
    """The findings of a study after the first, as one text. A sentence whose numbers were not
    computed is left out with those after it, which build on it.
    """
    sentences = (filled(template, values) for template in study.findings)
    return " ".join(s for s in list(takewhile(bool, sentences))[1:] if s)


def write_into(readme: Path, texts: Sequence[tuple[str, str]]) -> None:
    """Write the texts of `overview` as a numbered list between the marks <!-- findings --> and
    <!-- /findings --> of a Markdown file.
    """
    text = readme.read_text(encoding="utf-8")
    new = _MARKS.sub(lambda m: m[1] + listed(texts) + m[2], text)
    write_atomically(readme, lambda temporary: temporary.write_text(new, encoding="utf-8"))


def listed(texts: Sequence[tuple[str, str]]) -> str:
    """The texts of `overview` as a numbered list in Markdown."""
    wrapped = partial(textwrap.fill, width=120, subsequent_indent="   ", break_on_hyphens=False)
    named = [f"`{name}`: {text}" if name else text for name, text in texts]
    return "\n".join(wrapped(f"{number}. {text}") for number, text in enumerate(named, 1))
