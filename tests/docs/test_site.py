"""What the documentation shows that is neither a command nor a snippet: pictures, links, words."""

import importlib.util
import re
import runpy
import shutil
import subprocess

import pytest
import yaml

from tests.docs.snippets import (
    KINDS,
    PAGES,
    ROOT,
    blocks,
    check_aoabench,
    check_make,
    inline,
    words_of,
)

MKDOCS = yaml.safe_load((ROOT / ".ci" / "mkdocs.yml").read_text(encoding="utf-8"))
DOCS = [page for page in PAGES if page.is_relative_to(ROOT / "docs")]
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]


def in_navigation(entry):
    """The pages of an entry of the navigation."""
    if isinstance(entry, str):
        return [entry]
    return [
        page
        for part in (entry.values() if isinstance(entry, dict) else entry)
        for page in in_navigation(part)
    ]


def test_every_page_is_in_the_navigation_once():
    found = in_navigation(MKDOCS["nav"])
    assert sorted(found) == sorted(page.relative_to(ROOT / "docs").as_posix() for page in DOCS)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_to_files(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s#:]+)(?:#[^)]*)?\)", text):
        assert (page.parent / target).is_file(), target


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_within_sentences_exist(page):
    for command in inline(page):
        words = [word for word in words_of(command) if word != "..."]
        (check_make if words[0] == "make" else check_aoabench)(words[1:])


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_blocks_are_of_kinds_that_are_checked(page):
    for block in blocks(page):
        assert block.kind in KINDS, f"line {block.line}: a block of the kind {block.kind!r}"


def test_the_picture_of_frames_shows_what_the_page_says():
    drawn = runpy.run_path(str(ROOT / "docs" / "figures" / "angles.py"))
    text = (ROOT / "docs" / "explanation" / "angles.md").read_text(encoding="utf-8")
    azimuth, elevation = drawn["measured"](drawn["FACING_DEG"])
    bearing, _ = drawn["measured"]()
    assert f"{bearing:.1f} - {drawn['FACING_DEG']:.0f} = {azimuth:.1f} deg" in text
    assert f"({azimuth:.1f}, {elevation:.1f})" in text
    assert drawn["measured"](bearing, drawn["PITCH_DEG"])[1] == pytest.approx(
        elevation + drawn["PITCH_DEG"]
    )


def test_the_picture_of_poles_shows_what_the_page_says():
    drawn = runpy.run_path(str(ROOT / "docs" / "figures" / "angles.py"))
    near, half, _ = (drawn["spread"](e, 20_000)[0].std() for e in drawn["ELEVATIONS_DEG"])
    assert near == pytest.approx(drawn["SIGMA_DEG"], rel=0.03)
    assert half == pytest.approx(2 * drawn["SIGMA_DEG"], rel=0.05)  # 1 / cos(60 deg)
    assert abs(drawn["spread"](85, 20_000)[0]).max() > 175


@pytest.fixture(scope="module")
def hooks():
    pytest.importorskip("mkdocs", reason="`make docs` installs it")
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / ".ci" / "docs_hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_parts_are_those_of_the_pages(hooks):
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    used = {
        name
        for text in texts
        for name in re.findall(r"^<!-- generated: (\w+) -->$", text, re.MULTILINE)
    }
    assert used == set(hooks.PARTS)


def test_links_out_of_the_docs_lead_to_copies(hooks):
    page = ROOT / "docs" / "howto" / "reproduce.md"
    found = hooks._LINK.sub(
        lambda one: hooks._turned(one, page, "howto"),
        "[a](../../results/report/index.html), [b](sweep.md#c)",
    )
    assert found == "[a](../repository/results/report/index.html), [b](sweep.md#c)"


SITE = ROOT / "results" / "draft" / "site"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


def is_built():
    """Whether a site was built after its config and hooks were last changed."""
    made = SITE / "index.html"
    sources = [
        ROOT / ".ci" / name for name in ("mkdocs.yml", "docs_hooks.py", "search_from_files.js")
    ]
    return made.exists() and all(made.stat().st_mtime > one.stat().st_mtime for one in sources)


def test_pages_load_no_script_from_another_server(hooks):
    shim = '<script src="https://unpkg.com/iframe-worker/shim"></script>'
    html = f"<head></head><body>{shim}<script src=a.js></script></body>"
    found = hooks.on_post_page(html, None, None)
    assert "unpkg" not in found
    assert found.index("window.IFrameWorker") < found.index("<script src=a.js>")
    assert hooks.on_post_template(html, "404.html", None) == found
    assert hooks.on_post_template(html, "sitemap.xml", None) == html


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (apt-get install chromium)")
@pytest.mark.skipif(not is_built(), reason="no site here, or one of an earlier config (make docs)")
@pytest.mark.parametrize("page", ["index.html", "howto/plot.html"])
def test_the_site_is_searched_where_pages_are_opened_as_files(page, tmp_path):
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000")
    url = f"{(SITE / page).as_uri()}?q=covariance"
    command = [CHROMIUM, *options, f"--user-data-dir={tmp_path}", "--dump-dom", url]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    (count,) = re.findall(r'md-search-result__meta">(\d+) matching documents<', done.stdout)
    assert int(count) > 1
    assert f'href="{(SITE / "reference" / "python.html").as_uri()}' in done.stdout
    scripts = re.findall(r'<script[^>]* src="([^"]*)"', done.stdout)
    assert scripts
    assert not [script for script in scripts if "://" in script and "file://" not in script]


def test_reference_pages_are_complete(hooks):
    presets, tables = hooks.presets(), hooks.tables()
    assert (
        "| `noise.default_sigma_deg` | `10.0` | deg | a number &gt; 0 and &gt;= 1e-05 and &lt;= 180 |"
        in presets
    )
    assert "### ukf_ae_adaptive_augmented" in presets
    assert (
        "| `cep95_m_low` | double | m | lower end of the 95 % interval of cep95_m |"
        in tables.replace("\\_", "_")
    )
    assert "## locate" in hooks.commands()
