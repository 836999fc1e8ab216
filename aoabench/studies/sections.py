"""The parts of the page that come from one study: items with provenance, errata, readings."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any

from aoabench.maths.digest import flatten
from aoabench.report.text import interval_text
from aoabench.studies import findings
from aoabench.studies.places import Places
from aoabench.studies.stored import Stored, read
from aoabench.studies.study import Item, Study, figure_path

Row = dict[str, Any]


def section(
    study: Study, rows: list[Row], places: Places, problems: Mapping[tuple[str, str], str]
) -> dict[str, Any]:
    """What the page shows of a study, from the rows of all claims; `problems` see page.write."""
    contents = {item.name: read(study, item, places.results) for item in study.items}
    items = []
    for item in study.items:
        problem = problems.get((study.name, item.name), "").partition(" (")[0]
        mine = [r for r in rows if r["study"] == study.name and r["item"] == item.name]
        items.append({**_item(study, item, contents[item.name], problem, places), "rows": mine})
    found = {key: value for content in contents.values() for key, value in content.values.items()}
    readme = study.folder / "README.md"
    text = readings(readme.read_text(encoding="utf-8")) if readme.exists() else ""
    more = findings.further(study, found)
    wrong = errata(study, found)
    return {"study": study, "found": more, "items": items, "readings": text, "errata": wrong}


def errata(study: Study, found: Mapping[str, Any]) -> list[Row]:
    """The study's errata, each with its effect as text in `effect_text`; `found` holds the numbers
    of its tables by their ids, as in Stored.values.
    """
    return [{**e, "effect_text": _effect(e.get("effect"), found)} for e in study.errata]


def _item(
    study: Study, item: Item, content: Stored, problem: str, places: Places
) -> dict[str, Any]:
    """What the page shows of an item; `problem` is the reason why its figure is missing, or ""."""
    problem = content.problem or problem
    good = content.present and not problem
    why = f" ({problem})" if problem else ""
    figure = figure_path(places.drawn, study, item)
    origin = content.origin if good else {}
    return {
        "item": item,
        "status": "" if good else f"Not computed{why}.",
        "image": embedded(figure) if good and item.figure and figure.exists() else "",
        "shown": None if content.shown is None else content.shown.to_dict("split"),
        "made": _made(origin),
        "settings": _settings(origin.get("config")) + _machine(origin),
        "command": command(study, item, str(origin.get("scale", "quick"))),
    }


def command(study: Study, item: Item, scale: str) -> str:
    """The command that computes an item at a scale."""
    more = "" if scale == "quick" else f" --scale {scale}"
    return f"aoabench reproduce {study.name} --only {item.name}{more}"


def readings(markdown: str) -> str:
    """HTML of a study's README without its title: second-level headings become <h4>.

    Links and images are replaced by their text, as the page is self-contained; HTML in the text is
    escaped.
    """
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    rules = {
        "link_open": "",
        "link_close": "",
        "table_open": '<div class="scroll"><table>\n',
        "table_close": "</table></div>\n",
    }
    for name, html in rules.items():
        parser.add_render_rule(name, lambda *_, html=html: html)
    parser.add_render_rule("image", lambda _, tokens, i, *rest: escape(tokens[i].content))
    tokens = parser.parse(markdown)
    titles = [i for i, t in enumerate(tokens) if (t.type, t.tag) == ("heading_open", "h1")]
    for i in reversed(titles):
        del tokens[i : i + 3]  # heading_open, its text and heading_close
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(int(token.tag[1]) + 2, 6)}"
    return str(parser.renderer.render(tokens, parser.options, {}))


def embedded(figure: Path, colours: int = 255) -> str:
    """A PNG as base64, with a palette instead of 24 bits a pixel where that makes it smaller."""
    return _embedded(figure.read_bytes(), colours)


@lru_cache(128)  # of figures drawn by this command
def _embedded(original: bytes, colours: int) -> str:
    from PIL import Image  # matplotlib brings it

    with Image.open(io.BytesIO(original)) as image:
        small, held = io.BytesIO(), image.convert("RGB")
        held.quantize(colours, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).save(
            small, "PNG", optimize=True
        )
    return base64.b64encode(min(original, small.getvalue(), key=len)).decode()


def _made(origin: Mapping[str, Any]) -> str:
    """Scale, seconds, time and version of a table in one line, if its provenance has them."""
    texts = {"scale": "scale {}", "seconds": "{} s", "time": "{}", "aoabench": "aoabench {}"}
    return ", ".join(text.format(origin[key]) for key, text in texts.items() if key in origin)


def _machine(origin: Mapping[str, Any]) -> list[tuple[str, str]]:
    libraries = {"Python": origin.get("python"), **origin.get("libraries", {})}
    versions = ", ".join(f"{name} {number}" for name, number in libraries.items() if number)
    return [("versions", versions), ("processor", ", ".join(origin.get("cpu_features", [])))]


def _settings(config: Any) -> list[tuple[str, str]]:
    """Dotted keys and values of a table's config; for several cells, each key with its distinct
    values.
    """
    if not isinstance(config, dict):
        return []
    cells = [dict(flatten(cell)) for cell in config.get("cells", [])]
    common = [(key, str(value)) for key, value in config.items() if key not in ("cells", "scale")]
    if not cells:
        return common
    lines = [*common, ("cells", str(len(cells)))]
    for key in dict.fromkeys(name for cell in cells for name in cell):
        texts = dict.fromkeys(_short(cell[key]) for cell in cells if key in cell)
        if key not in ("runner.out", "runner.n_jobs", "runner.backend", "runner.chunk"):
            lines.append((key, ", ".join(texts)))
    return lines


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 200 else f"{text[:200]} ..."


def _effect(effect: dict[str, str] | None, found: Mapping[str, Any]) -> str:
    """The effect of an erratum, as words and our number with its 95 % interval; "" if the erratum
    has none or its number was not computed.
    """
    if effect is None or effect["id"] not in found:
        return ""
    numbers = [found[i][0] for i in _ids(effect) if i in found]
    texts = [interval_text(number.value, *number.interval()) for number in numbers]
    return f"{effect['says']}: {' instead of '.join(texts)} {effect['unit']}".strip()


def _ids(effect: dict[str, str]) -> list[str]:
    """The id of an effect's number, and the id of the number that it replaces, if given."""
    return [effect[key] for key in ("id", "instead_of") if key in effect]
