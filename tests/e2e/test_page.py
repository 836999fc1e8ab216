"""The page in headless Chromium: it loads without a complaint, sorts, filters, and can be read
narrow and on paper.
"""

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import pytest

from aoabench.studies import page, statements, study
from aoabench.studies.places import Places

CHROMIUM = next(
    (p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None
)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium here (apt-get install chromium)"
)
COMMITTED = Path(__file__).parents[2] / "results"


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    """The page of the committed tables, with one of them missing."""
    results = tmp_path_factory.mktemp("results")
    for folder in ("tables", "figures", "bench"):
        shutil.copytree(COMMITTED / folder, results / folder)
    (results / "tables" / "nurminen2018_table1.parquet").unlink()
    everything = [study.load(name) for name in study.names()]
    return page.write(everything, statements.verdicts(everything, results), Places.inside(results))


def chromium(html, *options, timeout=120):
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        *options,
    ]
    command += [
        f"--user-data-dir={html.parent / 'profile'}",
        "--virtual-time-budget=5000",
        html.as_uri(),
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=True)


def told(html, script, width=None):
    """What `script`, run in the page, gives (as JSON), and what the browser's console said.

    With `width` the page lies in a frame that is so many pixels wide: windows have a least width.
    """
    send = "top.postMessage" if width else "(text) => { document.body.dataset.told = text; }"
    tail = f"<script>({send})(JSON.stringify((() => {{ {script} }})()), '*');</script></body>"
    altered = html.with_name("altered.html")
    altered.write_text(html.read_text(encoding="utf-8").replace("</body>", tail), encoding="utf-8")
    if width:
        outer = html.with_name("frame.html")
        listen = "addEventListener('message', (e) => { document.body.dataset.told = e.data; })"
        frame = f'<iframe src="altered.html" style="width: {width}px; height: 900px; border: 0"></iframe>'
        outer.write_text(
            f"<!doctype html><body><script>{listen}</script>{frame}</body>", encoding="utf-8"
        )
    done = chromium(outer if width else altered, "--dump-dom")
    found = re.search(r'<body data-told="([^"]*)"', done.stdout)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(unescape(found[1])) if found else None, console


ROWS = (
    "const shown = [...document.querySelectorAll('#front > tbody > tr')].filter((r) => !r.hidden);"
)


def test_it_loads_without_a_complaint_and_asks_no_network(html):
    count, console = told(
        html,
        ROWS
        + "return [shown.length, document.images.length, [...document.images].every((i) => i.alt)];",
    )
    assert console == []
    assert count[0] > 50
    assert count[1] > 15
    assert count[2], "every figure has a text"
    text = html.read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!data:|#)', text)
    assert "@import" not in text
    assert "url(" not in text


def test_a_click_on_a_head_sorts_by_number_and_back(html):
    script = """
      const button = document.querySelectorAll('#front th button')[4], column = () =>
        [...document.querySelectorAll('#front > tbody > tr')].map((r) => r.cells[4].dataset.sort);
      const before = button.parentElement.getAttribute('aria-sort');
      button.click(); const up = column(), state = button.parentElement.getAttribute('aria-sort');
      button.click(); const down = column(), last = button.parentElement.getAttribute('aria-sort');
      return [before, up, state, down, last];
    """
    (before, up, state, down, last), console = told(html, script)
    assert (before, state, last, console) == ("none", "ascending", "descending", [])
    rising = [float(x) for x in up if x]
    assert rising == sorted(rising)
    assert up[: len(rising)] == [x for x in up if x], "what is not computed comes last"
    assert [float(x) for x in down if x] == rising[::-1]


SET = """
      const set = (id, value) => { const e = document.getElementById(id); e.value = value; e.dispatchEvent(new Event('input')); };
      const now = () => [...document.querySelectorAll('#front > tbody > tr')].filter((r) => !r.hidden)
        .map((r) => [r.dataset.study, r.dataset.verdict, r.textContent, r.dataset.class, r.dataset.counts]);
"""


def test_filters_by_study_verdict_class_and_words_join(html):
    script = f"""{SET}
      set('by-study', 'le2021'); const one = now();
      set('by-verdict', 'holds'); const two = now();
      set('by-text', 'RMSE deg'); const three = now(), says = document.getElementById('shown').textContent;
      set('by-text', ''); set('by-study', ''); set('by-verdict', ''); set('by-class', ''); const all = now();
      set('by-class', 'own'); const own = now();
      return [one, two, three, says, all, own];
    """
    (one, two, three, says, every, own), console = told(html, script)
    assert console == []
    assert {r[0] for r in one} == {"le2021"}
    assert {r[4] for r in one} == {"yes"}, "at first those that can fail"
    assert {r[1] for r in two} == {"holds"}
    assert 0 < len(three) < len(two) < len(one) < len(every)
    assert all("rmse" in r[2].lower() and "deg" in r[2] for r in three)
    assert says == f"{len(three)} of {len(every)} shown"
    assert {r[3] for r in own} == {"own"}


def test_a_link_to_a_claim_shows_it_with_its_details(html):
    script = f"""{SET}
      set('by-verdict', 'undecided');
      const link = [...document.querySelectorAll('details.print li a')].find((a) => {{
        const row = document.getElementById(a.hash.slice(1)); return row && row.hidden; }});
      const row = document.getElementById(link.hash.slice(1));
      location.hash = link.hash; dispatchEvent(new Event('hashchange'));
      const every = [...document.querySelectorAll('#front > tbody > tr')], dead = [...document.querySelectorAll('a')].filter((a) =>
        a.hash && !document.getElementById(a.hash.slice(1))).map((a) => a.hash);
      return [row.hidden, row.querySelector('details').open, dead, every.every((r) => r.querySelector('details code'))];
    """
    (hidden, opened, dead, code), console = told(html, script)
    assert console == []
    assert (hidden, opened, dead, code) == (False, True, [], True)


def test_the_page_begins_with_what_was_found_and_ends_with_the_words(html):
    script = """return [[...document.querySelectorAll('h2')].map((h) => h.id),
      [...document.querySelectorAll('#found + ol li')].map((li) => li.textContent),
      document.querySelectorAll('dt').length];"""
    (heads, found, words), console = told(html, script)
    assert console == []
    assert heads[:2] == ["found", "claims"]
    assert heads[-3:] == ["leaderboard", "bench", "glossary"]
    assert found
    assert all(re.search(r"\d", text) for text in found)
    assert words > 10


def test_it_fits_a_narrow_window(html):
    script = """
      const wide = [...document.body.querySelectorAll('p, h1, h2, h3, td, th, select, input, code')].filter((e) =>
        !e.closest('.scroll') && !e.closest('details') && e.getBoundingClientRect().right > innerWidth + 1);
      return [innerWidth, document.documentElement.scrollWidth, wide.map((e) => e.outerHTML.slice(0, 80)),
              getComputedStyle(document.querySelector('#front td')).fontSize];
    """
    (inner, scroll, wide, size), console = told(html, script, width=400)
    assert console == []
    assert inner == 400
    assert scroll <= 400
    assert wide == []
    assert float(size.removesuffix("px")) >= 12


@pytest.mark.parametrize("width", [400, 1200])
def test_plots_of_readings_fit_and_can_be_read(html, width):
    script = """
      document.querySelectorAll('#front details').forEach((one) => { one.open = true; });
      const plots = [...document.querySelectorAll('svg.dots')].filter((e) => e.getBoundingClientRect().width > 0);
      const sizes = plots.map((e) => 12 * e.getBoundingClientRect().width / e.viewBox.baseVal.width);
      const out = plots.flatMap((e) => [...e.querySelectorAll('text')].filter((t) => {
        const [a, b] = [t.getBoundingClientRect(), e.getBoundingClientRect()];
        return a.left < b.left - 6 || a.right > b.right + 6 || a.bottom > b.bottom + 1; }).map((t) => t.textContent));
      return [plots.length, Math.min(...sizes), Math.max(...sizes), out, document.documentElement.scrollWidth,
              plots.every((e) => e.getAttribute('role') === 'img' && e.getAttribute('aria-label'))];
    """
    (count, least, most, out, scroll, named), console = told(html, script, width=width)
    assert console == []
    assert count > 30
    assert least >= 10, "pixels of the letters"
    assert most <= 16
    assert out == []
    assert scroll <= width
    assert named


def test_a_missing_table_is_not_computed_and_its_numbers_are_gone(html):
    script = "return [...document.querySelectorAll('#front > tbody > tr')].filter((r) => r.cells[1].textContent === 'table1' && " \
             "r.dataset.study === 'nurminen2018').map((r) => [r.dataset.verdict, r.cells[4].textContent.trim()]);"  # fmt: skip
    rows, _ = told(html, script)
    assert rows
    assert {tuple(r) for r in rows} == {("not judged", "-")}


def test_it_prints(html):
    pdf = html.with_name("page.pdf")
    chromium(html, f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    data = pdf.read_bytes()
    assert data.startswith(b"%PDF")
    assert len(data) > 100_000
