"""The reproduction page: one self-contained HTML file made from the stored tables and figures."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from aoabench.errors import RunError
from aoabench.maths.digest import flatten
from aoabench.report.text import interval_text, number_text
from aoabench.store.files import read_provenance, read_table, write_atomically
from aoabench.studies.places import Places
from aoabench.studies.statements import Verdicts, headline
from aoabench.studies.stored import OTHER_VERSION, read
from aoabench.studies.study import Study, figure_path
from aoabench.studies.verdict import DEPENDS, FAILS, HOLDS, NOT_JUDGED, UNDECIDED

BENCH = ("what", "detail", "value", "unit", "target", "how")
VERDICTS = {
    HOLDS: "good",
    DEPENDS: "kind",
    FAILS: "bad",
    UNDECIDED: "soft",
    NOT_JUDGED: "soft",
}  # each with its class in the style sheet


def write(
    everything: list[Study],
    verdicts: Verdicts,
    places: Places,
    problems: Mapping[tuple[str, str], str] | None = None,
) -> Path:
    """Write report/index.html in `places.drawn` and return its path; `problems` maps (study, item)
    to the reason why a figure is missing ("" if none).
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    rows: list[dict[str, Any]] = [
        {str(k): v for k, v in row.items()} for row in verdicts.claims.to_dict("records")
    ]
    for row in rows:
        row["ours_text"] = interval_text(row["ours"], row["low"], row["high"])
        row["claim"] = row["class"] == "statement"
        row["ours_sort"] = "" if row["ours"] != row["ours"] else f"{row['ours']:.6g}"
    ordered = sorted(
        everything, key=lambda s: not s.claims
    )  # a leaderboard has no printed numbers and comes last
    html = environment.get_template("page.html.j2").render(
        studies=[_study(s, rows, places, problems or {}) for s in ordered],
        rows=rows,
        counts=verdicts.claims["verdict"].value_counts().to_dict(),
        headline=headline(verdicts.claims),
        classes=VERDICTS,
        bench=_bench(places.bench / "bench.parquet"),
        script=(Path(__file__).parent / "page.js").read_text(encoding="utf-8"),
        style=(Path(__file__).parent / "page.css").read_text(encoding="utf-8"),
    )
    path = places.drawn / "report" / "index.html"
    write_atomically(path, lambda temporary: temporary.write_text(html, encoding="utf-8"))
    return path


def _study(
    study: Study,
    rows: list[dict[str, Any]],
    places: Places,
    problems: Mapping[tuple[str, str], str],
) -> dict[str, Any]:
    items = []
    found: dict[str, Any] = {}
    for item in study.items:
        content = read(study, item, places.results)
        found |= content.values
        problem = content.problem or problems.get((study.name, item.name), "").partition(" (")[0]
        figure = figure_path(places.drawn, study, item)
        good = content.present and not problem
        origin = content.origin if good else {}
        scale = f" --scale {origin['scale']}" if origin.get("scale", "quick") != "quick" else ""
        items.append(
            {
                "item": item,
                "status": ""
                if good
                else f"Not computed ({problem})."
                if problem
                else "Not computed.",
                "image": embedded(figure) if good and item.figure and figure.exists() else "",
                "shown": None if content.shown is None else content.shown.to_dict("split"),
                "rows": [r for r in rows if r["study"] == study.name and r["item"] == item.name],
                "made": _made(origin),
                "settings": _settings(origin.get("config")) + _machine(origin),
                "command": f"aoabench reproduce {study.name} --only {item.name}{scale}",
            }
        )
    errata = [{**e, "effect_text": _effect(e.get("effect"), found)} for e in study.errata]
    readme = study.folder / "README.md"
    text = readings(readme.read_text(encoding="utf-8")) if readme.exists() else ""
    return {"study": study, "items": items, "readings": text, "errata": errata}


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
    from PIL import Image  # matplotlib brings it

    original = figure.read_bytes()
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


def _bench(path: Path) -> dict[str, Any]:
    """The rows of the bench table as texts, or the reason for their absence as `status`."""
    try:
        frame = read_table(path, columns=list(BENCH)).to_pandas()
        rows = [[r["what"], r["detail"], f"{r['value']:.3g} {r['unit']}", r["target"], r["how"]]
                for r in frame.to_dict("records")]  # fmt: skip
        return {"rows": rows, "time": read_provenance(path).get("time", ""), "status": ""}
    except FileNotFoundError:
        return {"rows": [], "time": "", "status": "Not computed."}
    except (ValueError, LookupError, TypeError, OSError, RunError):
        return {"rows": [], "time": "", "status": f"Not computed ({OTHER_VERSION})."}


def _effect(effect: dict[str, str] | None, found: dict[str, Any]) -> str:
    """The effect of an erratum, as words and our number; "" if the erratum has none or its number
    was not computed.
    """
    if effect is None or effect["id"] not in found:
        return ""
    texts = [number_text(found[i][0].value, found[i][0].se) for i in _ids(effect) if i in found]
    return f"{effect['says']}: {' instead of '.join(texts)} {effect['unit']}".strip()


def _ids(effect: dict[str, str]) -> list[str]:
    """The id of an effect's number, and the id of the number that it replaces, if given."""
    return [effect[key] for key in ("id", "instead_of") if key in effect]
