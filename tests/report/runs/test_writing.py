"""Files of the figures: formats, and the self-contained page."""

import re

import pytest

from aoabench.errors import BadValue
from aoabench.report.runs.choice import Asked
from aoabench.report.runs.drawing import prepare
from aoabench.report.runs.writing import check_out, page, write

HEADS = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml", "html": b"<!doctype html>"}


@pytest.mark.parametrize("form", HEADS)
def test_the_suffix_decides_and_equal_data_give_equal_files(frame, tmp_path, form):
    drawing = prepare(frame({"a": [1.0, 2.0]}), Asked())
    files = [tmp_path / "new" / f"v1.2-{i}.{form}" for i in (1, 2)]
    for file in files:
        write(drawing, file, "aoabench plot x")
    assert sorted((tmp_path / "new").iterdir()) == files
    one, other = (file.read_bytes() for file in files)
    assert one.startswith(HEADS[form])
    assert one == other


@pytest.mark.parametrize("name", ["a.gif", "a", "a.PNG", "a.png.gz"])
def test_other_suffixes_are_one_line(tmp_path, name):
    with pytest.raises(BadValue, match=r"allowed: a file that ends in \.png, \.pdf, \.svg, \.html"):
        check_out(tmp_path / name)


def test_the_page_holds_all_it_shows(frame):
    """No file or address but itself; the table's numbers; names from elsewhere are text."""
    evil = "<script>alert(1)</script>"
    drawing = prepare(frame({"a": [1.25, 1.75], evil: [3.0, 4.0]}, x=[1, 2]), Asked())
    text = page(drawing, f"aoabench plot '{evil}'")
    outside = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", text)
    assert all(link.startswith(("#", "data:,")) for link in outside)
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 3
    assert text.count("<tr>") == 1 + len(drawing.table) == 5
    assert re.findall(r"<th scope=\"col\">(\w+)", text) == [
        "estimator", "x", "value", "low", "high", "n", "of",
    ]  # fmt: skip
    assert "<td>1.5</td>" in text
    assert f"<figcaption>{' '.join(drawing.footer)}</figcaption>" in text


def test_a_long_table_is_cut_with_a_count(frame, monkeypatch):
    monkeypatch.setattr("aoabench.report.runs.writing._MOST_ROWS", 3)
    text = page(prepare(frame({"a": [1.0, 2.0]}, x=list(range(5))), Asked()), "aoabench plot x")
    assert text.count("<tr>") == 4
    assert "<p>2 more rows are left out.</p>" in text
