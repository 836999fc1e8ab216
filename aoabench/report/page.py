"""The reproduction page: one self-contained HTML file made from the stored tables and figures."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aoabench import store
from aoabench.report import study as studies

if TYPE_CHECKING:
    import pandas as pd


def write(everything: list[studies.Study], verdicts: pd.DataFrame, results: Path) -> Path:
    """Write <results>/report/index.html and return its path."""
    import jinja2

    template = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    ).get_template("page.html.j2")
    rows: list[dict[str, Any]] = [{str(k): v for k, v in row.items()} for row in verdicts.to_dict("records")]
    for row in rows:
        row["ours_text"] = studies.number_text(row["ours"], row["se"])
    html = template.render(
        studies=[_study(s, rows, results) for s in everything],
        rows=rows,
        counts=verdicts["verdict"].value_counts().to_dict(),
    )
    path = results / "report" / "index.html"
    store.write_atomically(path, lambda temporary: temporary.write_text(html, encoding="utf-8"))
    return path


def _study(study: studies.Study, rows: list[dict[str, Any]], results: Path) -> dict[str, Any]:
    items = []
    for item in study.items:
        table = studies.table_path(results, study, item)
        figure = studies.figure_path(results, study, item)
        image = base64.b64encode(figure.read_bytes()).decode() if table.exists() and figure.exists() else None
        items.append(
            {
                "item": item,
                "image": image,
                "computed": table.exists(),
                "rows": [r for r in rows if r["study"] == study.name and r["item"] == item.name],
                "origin": store.read_provenance(table) if table.exists() else {},
                "command": f"aoabench reproduce {study.name} --only {item.name}",
            }
        )
    found: dict[str, Any] = {}
    for item in study.items if any("effect" in e for e in study.errata) else ():
        found |= studies.values(study, item, results)
    errata = [{**e, "effect_text": _effect(e.get("effect"), found)} for e in study.errata]
    readme = (study.folder / "README.md").read_text(encoding="utf-8")
    return {"study": study, "items": items, "readme": readme, "errata": errata}


def _effect(effect: dict[str, str] | None, found: dict[str, Any]) -> str:
    """What an erratum does, in words and a number of ours; nothing if it says none or was not computed."""
    if effect is None or effect["id"] not in found:
        return ""
    texts = [studies.number_text(found[i][0].value, found[i][0].se) for i in _ids(effect) if i in found]
    return f"{effect['says']}: {' instead of '.join(texts)} {effect['unit']}".strip()


def _ids(effect: dict[str, str]) -> list[str]:
    """What an effect's number is, and what it is instead of, if it says."""
    return [effect[key] for key in ("id", "instead_of") if key in effect]
