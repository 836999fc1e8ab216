"""The reproduction page: one self-contained HTML file made from the stored tables and figures."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from aoabench.errors import RunError
from aoabench.maths.intervals import normal_quantile
from aoabench.report.text import interval_text, significant
from aoabench.store.files import read_provenance, read_table, write_atomically
from aoabench.studies import dots, findings, sections
from aoabench.studies.claims import CLASSES, Claim
from aoabench.studies.places import Places
from aoabench.studies.sections import Row
from aoabench.studies.statements import Verdicts
from aoabench.studies.stored import OTHER_VERSION, Stored, read
from aoabench.studies.study import Study, code_of
from aoabench.studies.verdict import DEPENDS, FAILS, HOLDS, LEVEL, NOT_JUDGED, UNDECIDED

BENCH = ("what", "detail", "value", "unit", "target", "how")
VERDICTS = {
    HOLDS: "good",
    DEPENDS: "kind",
    FAILS: "bad",
    UNDECIDED: "soft",
    NOT_JUDGED: "soft",
}  # each with its class in the style sheet
FOLDED = 8  # readings from which on a claim's plot is folded
CHOSEN = {
    "paper": "the limit is the paper's",
    "before": "we set the limit before our result",
    "after": "we set the limit after our result",
}


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

    here = Path(__file__).parent
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(here),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    rows = _rows(everything, verdicts, places)
    ordered = sorted(everything, key=lambda s: not s.claims)  # a leaderboard comes last
    html = environment.get_template("page.html.j2").render(
        coarse=any(s.scale == "quick" for s in _contents(everything, places)),
        overview=findings.overview(ordered, verdicts.claims, places.results),
        studies=[sections.section(s, rows, places, problems or {}) for s in ordered],
        rows=rows,
        counts=verdicts.claims["verdict"].value_counts().to_dict(),
        classes=[kind for kind in CLASSES if kind in set(verdicts.claims["class"])],
        styles=VERDICTS,
        folded=FOLDED,
        bench=_bench(places.bench / "bench.parquet"),
        script=(here / "page.js").read_text(encoding="utf-8"),
        style=(here / "page.css").read_text(encoding="utf-8"),
    )
    path = places.drawn / "report" / "index.html"
    write_atomically(path, lambda temporary: temporary.write_text(html, encoding="utf-8"))
    return path


def _contents(everything: list[Study], places: Places) -> Iterator[Stored]:
    """The stored tables of all items."""
    for study in everything:
        for item in study.items:
            yield read(study, item, places.results)


def _rows(everything: list[Study], verdicts: Verdicts, places: Places) -> list[Row]:
    """A row for each claim, with its readings, code, errata and anchor in the page, and the command
    that computes its number again, at the scale of the stored table or that the claim needs.
    """
    grouped: dict[tuple[str, str], list[Row]] = {}
    for row in _records(verdicts.readings):
        grouped.setdefault((row["study"], row["id"]), []).append(row)
    items = {(s.name, item.name): (s, item) for s in everything for item in s.items}
    scales = {key: read(*pair, places.results).scale for key, pair in items.items()}
    claims = {(s.name, claim.id): claim for s in everything for claim in s.claims}
    rows = _records(verdicts.claims)
    for row in rows:
        study, item = items[row["study"], row["item"]]
        row["readings_of"] = grouped.get((row["study"], row["id"]), [])
        row["anchor"] = "claim-" + re.sub(r"[^\w.-]+", "-", f"{row['study']}-{row['id']}")
        row["computes"] = code_of(study, getattr(study.numbers, item.name))
        row["reads"] = code_of(study, getattr(study.figures, f"{item.name}_values"))
        named = set(re.findall(r"\w+", row["reason"]))
        row["errata"] = [e["id"] for e in study.errata if e["id"] in named]
        row["chosen_text"] = CHOSEN.get(row["chosen"], "")
        row["statement"] = row["class"] == "statement"
        row["printed_unit"] = "" if row["statement"] or not row["printed"] else row["unit"]
        row["plot"] = _plot(claims[row["study"], row["id"]], row)
        quick = item.judged_at == "any" and scales[study.name, item.name] != "paper"
        row["command"] = sections.command(study, item, "quick" if quick else "paper")
    return rows


def _plot(claim: Claim, row: Row) -> str:
    """The dot plot of a claim with several readings, as SVG; "" for one reading."""
    if len(row["readings_of"]) < 2:
        return ""
    drawn = [
        dots.Dot(
            r["reading"], r["ours"], r["low"], r["high"], r["verdict"], VERDICTS[r["verdict"]],
            f"{r['ours_text']} {r['unit']}".rstrip(), r["robustness"],
        )
        for r in row["readings_of"]
    ]  # fmt: skip
    before = "claimed" if row["statement"] else "printed"
    words = f"{before} {row['printed']} {row['printed_unit']}".rstrip() if row["printed"] else ""
    limits = claim.limits(normal_quantile(LEVEL))
    return dots.svg(drawn, limits, claim.printed, words, row["unit"])


def _records(frame: Any) -> list[Row]:
    """Rows of a frame as dictionaries, with our number and its interval as text."""
    rows = [{str(key): value for key, value in row.items()} for row in frame.to_dict("records")]
    for row in rows:
        row["ours_text"] = interval_text(row["ours"], row["low"], row["high"])
        row["ours_sort"] = "" if row["ours"] != row["ours"] else f"{row['ours']:.6g}"
        least = f"{significant(row['shows'], 2)} {row['unit']}".rstrip()
        row["power"] = f"this N shows a difference of {least}" if row["shows"] > 0 else ""
    return rows


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
