"""Tables in every form that people have: one content, whatever its marks, packing and files."""

import gzip
import io
import json
import os
import sys
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pandas as pd
import pytest

from aoabench import loaded
from aoabench.devices.readers.columns import header
from aoabench.devices.readers.formats import opened
from aoabench.devices.readers.reading import Reading
from aoabench.devices.readers.sources import content_of
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue

NAMES = ["fix", "anchor", "azimuth_deg", "x_m"]
CHOSEN = {"fix": "fix", "anchor": "anchor", "azimuth": "azimuth_deg", "x": "x_m"}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def rows(rng):
    """Forty rows, with an empty cell."""
    azimuth = np.round(rng.uniform(-180, 180, 40), 3) + 0.0005
    azimuth[7] = np.nan
    anchors = np.tile(["007", "1E5", "a b", "d"], 10)
    return pd.DataFrame(dict(zip(NAMES, (np.repeat(range(10), 4), anchors, azimuth, azimuth / 7))))


def read(path="log.csv", names=CHOSEN, **given):
    return Table.read("path", path, names, Reading(**given))


def check(table, rows):
    assert table.texts("fix")[1] == [str(i) for i in range(10)]
    code, ids = table.texts("anchor")
    assert [ids[i] for i in code] == list(rows["anchor"])
    np.testing.assert_allclose(table.numbers("azimuth"), rows["azimuth_deg"], rtol=1e-15)
    np.testing.assert_allclose(table.numbers("x"), rows["x_m"], rtol=1e-15)


@pytest.mark.parametrize("mark", [",", ";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["log.csv", "log.tsv", "log.txt", "log.log", "log.csv.gz"])
def test_marks_and_encodings_are_recognised(mark, decimal, encoding, name, rows, here):
    text = rows.to_csv(sep=mark, decimal=decimal, index=False, lineterminator="\r\n")
    content = text.encode(encoding)
    Path(name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    check(read(name), rows)
    check(read(name, separator=mark, decimal=decimal, format="table"), rows)


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1", "ISO-8859-15"])
@pytest.mark.parametrize("packed", [False, True])
def test_a_declared_encoding(encoding, packed, here):
    text = "Zeit in s;Empf\u00e4nger;Winkel (\u00b0)\n0,5;T\u00fcr;1,5\n".encode(encoding)
    Path("log.csv").write_bytes(gzip.compress(text) if packed else text)
    found = opened("path", "log.csv", Reading(encoding=encoding))
    assert found.columns == ["Zeit in s", "Empf\u00e4nger", "Winkel (\u00b0)"]
    cells = found.cells({"anchor": "Empf\u00e4nger", "azimuth": "Winkel (\u00b0)"})
    assert cells.iloc[0].tolist() == ["T\u00fcr", 1.5]
    with pytest.raises(BadValue, match=r"not UTF-8: save .* or declare .*scenario.encoding=cp1252"):
        opened("path", "log.csv")
    with pytest.raises(BadValue, match=r"not UTF-8: save the file in UTF-8$"):
        opened("anchors", "log.csv")
    with pytest.raises(BadValue, match=r"byte \d+ is not ascii, which scenario.encoding declares"):
        opened("path", "log.csv", Reading(encoding="ascii"))


def test_a_mark_of_the_byte_order_wins_over_the_declared_encoding(here):
    Path("log.csv").write_text("Empf\u00e4nger,b\n1,2\n", encoding="utf-8-sig")
    found = opened("path", "log.csv", Reading(encoding="cp1252"))
    assert found.columns == ["Empf\u00e4nger", "b"]


def test_blanks_separate_cells(rows, here):
    rows = rows.assign(anchor=rows["anchor"].str.replace(" ", "_")).fillna(1.5).round(4)
    Path("log.txt").write_text(rows.to_string(index=False))
    check(read("log.txt"), rows)
    check(read("log.txt", separator="space"), rows)


@pytest.mark.parametrize(
    "before", ["# made by x\n#, more\n\n", "% a\n", "\n\n", "// a;b\n", "sep=;\n"]
)
def test_lines_above_and_among_the_rows(before, rows, here):
    mark = ";" if "sep" in before else ","
    lines = rows.to_csv(index=False, sep=mark).splitlines(keepends=True)
    among = [] if "sep" in before else ["# lost the link, again\n", "\n"]
    Path("log.csv").write_text(before + "".join([*lines[:5], *among, *lines[5:]]))
    table = read()
    check(table, rows)
    place = before.count("\n") + 2 + 30 + len(among)
    assert table.at(30, "azimuth") == f"line {place} has azimuth_deg={rows['azimuth_deg'][30]}"


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_files_joined_by_cat_repeat_the_names(mark, end, rows, here):
    first, second = rows[:10], rows[10:]
    texts = [mark + part.to_csv(index=False, lineterminator=end) for part in (first, second)]
    Path("log.csv").write_bytes("".join(texts).encode())
    table = read()
    check(table, rows)
    words = "that name the columns again are left out, as of several files in one"
    assert table.notes == (f"log.csv: 1 lines {words}",)
    assert table.at(10, "fix") == "line 13 has fix='2'"


def test_lines_may_end_with_cr_alone(rows, here):
    Path("log.csv").write_bytes(rows.to_csv(index=False, lineterminator="\r").encode())
    table = read()
    check(table, rows)
    assert table.at(0) == "line 2"


@pytest.mark.parametrize("mark", [",", ";"])
def test_a_title_above_the_names_is_told(mark, rows, here):
    title = "Measurement 3\n\n"
    Path("log.csv").write_text(title + rows.to_csv(index=False, sep=mark))
    words = "line 1 has one cell and the lines below have 4: lines above .* begin with #"
    with pytest.raises(BadValue, match=words):
        read()
    Path("log.csv").write_text("# " + title + rows.to_csv(index=False, sep=mark))
    check(read(), rows)


def test_an_id_may_begin_like_a_comment(here):
    Path("log.csv").write_text("anchor,azimuth_deg\n#1,10\n#2,20\n")
    table = read(names={"anchor": "anchor", "azimuth": "azimuth_deg"})
    assert table.texts("anchor")[1] == ["#1", "#2"]


@pytest.mark.parametrize("mark", [",", ";", " "])
def test_names_in_a_comment_as_numpy_writes_them(mark, here):
    values = np.array([[0, 1, 10.5], [0, 2, 20.25]])
    np.savetxt(
        "log.txt", values, delimiter=mark, header=mark.join(["fix", "anchor", "azimuth_deg"])
    )
    assert header("path", "log.txt") == ["fix", "anchor", "azimuth_deg"]
    found = read("log.txt", {"azimuth": "azimuth_deg"})
    np.testing.assert_allclose(found.numbers("azimuth"), values[:, 2])
    assert found.at(0) == "line 2"


def test_names_for_a_file_without_them(rows, here):
    Path("log.csv").write_text(rows.to_csv(index=False, header=False))
    check(read(header=tuple(NAMES)), rows)
    assert read(header=tuple(NAMES)).at(0) == "line 1"
    Path("log.csv").write_text(rows.to_csv(index=False))
    check(read(header=tuple(NAMES)), rows)  # a first line of the same names is no data
    with pytest.raises(
        BadValue, match=r"header=\['fix'\].*4 names, one for each column of log.csv"
    ):
        read(header=("fix",))


def test_decimal_commas_without_names(rows, here):
    rows = rows.fillna(0.5)
    text = rows.to_csv(index=False, header=False, sep=";", decimal=",")
    assert all(line.count(",") == 2 for line in text.splitlines())
    Path("log.csv").write_text(text)
    check(read(header=tuple(NAMES)), rows)


def test_dates_and_texts_are_no_decimal_commas(here):
    Path("log.csv").write_text('time;anchor;azimuth\n2024-05-01T10:00:00,5;"1,5";10\n')
    table = read(names={"anchor": "anchor", "azimuth": "azimuth"})
    assert table.texts("anchor")[1] == ["1,5"]
    assert table.numbers("azimuth") == [10]


def test_a_last_line_that_is_being_written_is_named_and_not_read(rows, here):
    text = rows.to_csv(index=False)
    for cut, whole in ((text[:-1], 40), (text + "10,007", 40), (text + "10,007,1.5,", 41)):
        Path("log.csv").write_text(cut)
        table = read()
        assert len(table.frame) == whole
        assert bool(table.notes) == (cut.endswith("10,007"))
    Path("log.csv").write_text(text + "10,007")
    assert read().notes == (
        "log.csv: line 42 is cut, as in a file that is still being written, and not read",
    )


# --- several files --------------------------------------------------------------------------------


def test_a_log_in_several_files_is_one_log(rows, here):
    Path("log.csv").write_text(rows.to_csv(index=False))
    whole = read()
    for i, first in enumerate(range(0, 40, 10)):
        part = rows[first : first + 10]
        marks = {"sep": ";", "decimal": ","} if i % 2 else {}
        part.to_csv(f"part_{9 + i}.csv", index=False, **marks)
    files = [f"part_{9 + i}.csv" for i in range(4)]
    for path in (files, "part_*.csv", "part_*", [files[0], *files[1:]]):
        table = read(path)
        check(table, rows)
        pd.testing.assert_frame_equal(
            table.frame.reset_index(drop=True), whole.frame.reset_index(drop=True)
        )
        assert table.at(35, "fix") == "line 7 of part_12.csv has fix='8'"
    named = read(files, CHOSEN | {"tag": "file"})
    assert named.texts("tag")[1] == ["part_9", "part_10", "part_11", "part_12"]
    Path("part_9.csv").write_text(rows.drop(columns="x_m").to_csv(index=False))
    with pytest.raises(BadValue, match=r"same columns in every file; part_9.csv has no x_m"):
        read(files)


def test_links_that_lead_back_add_no_files(here):
    (here / "logs").mkdir()
    (here / "logs" / "a.csv").write_text("anchor\nx\n")
    (here / "logs" / "again").symlink_to(here / "logs")
    assert len(read("logs/**/*.csv", {"anchor": "anchor"}).frame) == 1


def test_a_link_to_itself_is_no_file(here):
    Path("loop").symlink_to("loop")
    with pytest.raises(BadValue, match="an existing file"):
        header("path", "loop")


def test_angles_of_silicon_labs_with_ids_of_another_name_are_a_table(here):
    one = {"azimuth": 1.5, "azimuth_stdev": 2.0, "sequence": 7}
    Path("log.json").write_text(json.dumps([one | {"locator": name} for name in "ab"]))
    table = read("log.json", {"anchor": "locator", "azimuth": "azimuth"})
    assert table.texts("anchor")[1] == ["a", "b"]
    Path("log.json").write_text(json.dumps([one, one]))
    with pytest.raises(BadValue, match="without their topics"):
        header("path", "log.json")


def test_lists_and_globs_that_are_wrong(here):
    Path("a.csv").write_text("x\n1\n")
    Path("folder").mkdir()
    for path, words in (
        (["a.csv", "a.csv"], "each file once"),
        ("b*.csv", "or a glob; no file fits"),
        ("folder", "'folder/\\*.csv' names the files"),
        (["a.csv", "b.csv"], "path='b.csv'.*existing"),
        ([], "existing"),
        ([7], "path=7"),
    ):
        with pytest.raises(BadValue, match=words):
            header("path", path)


def test_a_folder_of_parquet(rows, here):
    frame = rows.assign(tag=np.where(rows.index % 2, "T 1", "T/2"))
    frame.to_parquet("logs", partition_cols=["tag"])
    table = read("logs", CHOSEN | {"tag": "tag"})
    code, tags = table.texts("tag")
    assert sorted(tags) == ["T 1", "T/2"]
    found = pd.Series(table.numbers("x")).groupby(np.array(tags)[code]).sum()
    expected = frame.groupby("tag")["x_m"].sum()
    np.testing.assert_allclose(found[expected.index], expected)


# --- JSON and Excel -------------------------------------------------------------------------------


@pytest.mark.parametrize("lines", [True, False])
@pytest.mark.parametrize("packed", [True, False])
def test_json_records(lines, packed, rows, here):
    nested = [
        {"fix": r.fix, "anchor": {"id": r.anchor}, "angle": {"az": r.azimuth_deg}, "x_m": r.x_m}
        for r in rows.itertuples()
    ]
    each = [json.dumps(one).replace("NaN", "null") for one in nested]
    text = ("\n".join(each) if lines else "[" + ",\n".join(each) + "]").encode()
    Path("log.jsonl").write_bytes(gzip.compress(text) if packed else text)
    table = read("log.jsonl", CHOSEN | {"anchor": "anchor.id", "azimuth": "angle.az"})
    check(table, rows)
    assert table.at(2) == ("line 3" if lines else "row 3")


@pytest.mark.parametrize(("text", "words"), [
    ('{"a": 1}\n{"a": \n', "line 2 is no JSON object"), ('{"a": 1}\n[2]\n', "line 2 is no JSON object"),
    ("[1, 2]", "row 1 is no JSON object"), ('{\n"a": 1\n}\n', "one object a line"), ("{}", "table"),
])  # fmt: skip
def test_json_that_is_no_table(text, words, here):
    Path("log.json").write_text(text)
    with pytest.raises(BadValue, match=words):
        header("path", "log.json")


def test_lists_in_json_are_refused_where_they_are_read(here):
    Path("log.jsonl").write_text('{"anchor": "a", "azimuth": 1, "iq": [1, 2]}\n')
    assert read("log.jsonl", {"anchor": "anchor"}).texts("anchor")[1] == ["a"]
    with pytest.raises(BadValue, match="'iq' has lists"):
        read("log.jsonl", {"anchor": "iq"})


def test_excel(rows, here):
    pytest.importorskip("openpyxl")
    with pd.ExcelWriter("log.xlsx") as book:
        rows.to_excel(book, sheet_name="run", index=False)
        rows.to_excel(book, sheet_name="other", index=False)
    table = read("log.xlsx")
    check(table, rows)
    assert table.notes == ("log.xlsx: sheet 'run' is read, 1 others are not",)
    assert table.at(0) == "row 2"
    rows.to_excel("log.xlsx", header=False, index=False)
    check(read("log.xlsx", header=tuple(NAMES)), rows)


def test_a_torn_workbook_and_another_archive_give_one_line(rows, here):
    pytest.importorskip("openpyxl")
    rows.to_excel("log.xlsx", index=False)
    whole = Path("log.xlsx").read_bytes()
    other = io.BytesIO()
    with ZipFile(other, "w") as archive:
        archive.writestr("log.csv", "a,b\n1,2\n")
    broken = bytearray(whole)
    with ZipFile("log.xlsx") as archive:
        place = archive.getinfo("xl/worksheets/sheet1.xml").header_offset + 80
    broken[place : place + 40] = bytes(40)
    for content in (whole[: len(whole) // 2], other.getvalue(), bytes(broken)):
        Path("log.xlsx").write_bytes(content)
        with pytest.raises(BadValue, match="no whole Excel workbook") as error:
            read("log.xlsx")
        assert "\n" not in str(error.value)


def test_without_openpyxl_the_extra_is_named(here, monkeypatch):
    Path("log.xlsx").write_bytes(b"PK\x03\x04")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(BadValue, match=r"pip install 'aoabench\[xlsx\]'; or save it as CSV"):
        header("path", "log.xlsx")


# --- wide tables ----------------------------------------------------------------------------------

WIDE = {
    "azimuth_{}": ("azimuth_{}", "elevation_{}", {}),
    "azimuth_deg_{}": ("azimuth_deg_{}", "elevation_deg_{}", {}),
    "{}_az_deg": ("{}_az_deg", "{}_el_deg", {}),
    "own": ("theta ({})", "phi ({})", {"patterns": ("theta ({anchor})", "phi ({anchor})")}),
}


@pytest.mark.parametrize(("azimuth", "elevation", "given"), WIDE.values(), ids=WIDE)
def test_a_wide_table_equals_the_long_one(azimuth, elevation, given, rng, here):
    ids = ["a1", "b_2", "c 3"]
    values = rng.uniform(-80, 80, (5, 3, 2)).round(3)
    values[2, 1] = np.nan  # not heard
    values[4] = np.nan  # nobody hears
    flat = {"fix": range(5), "x_m": np.arange(5) / 2}
    for j, i in enumerate(ids):
        flat |= {azimuth.format(i): values[:, j, 0], elevation.format(i): values[:, j, 1]}
    pd.DataFrame(flat).to_csv("log.csv", index=False)
    names = ("azimuth_deg", "elevation_deg")
    if given:
        names = given["patterns"]
    chosen = {
        "fix": "fix",
        "x": "x_m",
        "anchor": "anchor",
        "azimuth": names[0],
        "elevation": names[1],
    }
    assert set(chosen.values()) <= set(header("path", "log.csv", Reading(**given)))
    table = read(names=chosen, **given)
    keep = np.isfinite(values).all(axis=2)
    keep[4, 0] = True
    np.testing.assert_array_equal(table.numbers("azimuth"), values[keep][:, 0])
    np.testing.assert_array_equal(table.numbers("elevation"), values[keep][:, 1])
    fix, anchor = np.nonzero(keep)
    np.testing.assert_array_equal(table.numbers("x"), fix / 2)
    assert list(table.frame["anchor"]) == [ids[j] for j in anchor]
    assert table.at(1, "elevation") == f"line 2 has {elevation.format('b_2')}={values[0, 1, 1]}"


def test_rows_of_a_wide_table_without_an_order_are_fixes(here):
    for file in ("a.csv", "b.csv"):
        Path(file).write_text("azimuth_1,azimuth_2\n10,20\n30,40\n")
    chosen = {"fix": "fix", "anchor": "anchor", "azimuth": "azimuth_deg"}
    assert read("a.csv", chosen).texts("fix")[1] == ["1", "2"]
    both = read(["a.csv", "b.csv"], chosen)
    assert both.texts("fix")[1] == ["a 1", "a 2", "b 1", "b 2"]
    assert both.numbers("azimuth").tolist() == [10, 20, 30, 40] * 2


@pytest.mark.parametrize("names", [
    ["fix", "anchor", "azimuth_A1", "azimuth_A2"], ["fix", "azimuth_deg", "azimuth_sigma_deg", "azimuth_true_deg"],
    ["fix", "azimuth_deg", "elevation_deg"], ["azimuth_A1", "b"],
])  # fmt: skip
def test_a_long_table_stays_long(names, here):
    Path("log.csv").write_text(",".join(names) + "\n" + ",".join("1" * len(names)) + "\n")
    assert header("path", "log.csv") == names


# --- hostile files --------------------------------------------------------------------------------


def test_a_hundred_thousand_columns(here):
    n = 100_000
    names = ",".join(f"c{i}" for i in range(n))
    body = ",".join(map(str, range(n)))
    Path("log.csv").write_text(f"{names}\n{body}\n{body}\n")
    table = read(names={"azimuth": "c99999", "anchor": "c7"})
    assert table.numbers("azimuth").tolist() == [99999, 99999]
    assert table.texts("anchor")[1] == ["7"]
    Path("log.csv").write_text(f"{names}\n{body}\n{body},7\n")
    with pytest.raises(BadValue, match="line 3 has more"):
        read(names={"azimuth": "c99999"})


@pytest.mark.parametrize("content", [
    b"x" * 10_000_000, b"a,b\n" + b"1" * 10_000_000 + b",2\n", b"a,b\n\"" + b"1," * 5_000_000,
    bytes(range(256)) * 100, b"PK\x03\x04" + bytes(100), b"PAR1" + bytes(100), b"\x1f\x8b" + bytes(50),
    b"\xff\xfe\x00", b"a;b\n" * 3 + b"\xff", gzip.compress(b"a,b\n1,2\n")[:-9], b"[" * 200_000, b'{"a":' * 100_000,
], ids=range(12))  # fmt: skip
def test_hostile_content_is_refused_in_one_short_line(content, here):
    Path("log.csv").write_bytes(content)
    with pytest.raises(BadValue) as error:
        read().numbers("azimuth")
    assert len(str(error.value)) < 700
    assert "\n" not in str(error.value)


def test_a_stream_is_no_file(here):
    os.mkfifo("log.csv")
    with pytest.raises(BadValue, match="this is a stream: `aoabench locate -` reads one"):
        header("path", "log.csv")


@pytest.mark.parametrize("cut", ["3,a", "3,a,10", "3,a,10,12", '3,"a', ""])
def test_of_a_file_that_grows_whole_lines_are_read(cut, here):
    Path("log.csv").write_text("fix,anchor,azimuth_deg,x_m\n1,a,1,1\n2,a,2,2\n" + cut)
    with loaded.reading():
        content_of("log.csv")
        with Path("log.csv").open("a") as file:
            file.write(".5,7\n4,a,4,4\n")
        assert read().numbers("x").tolist() == [1, 2]


@pytest.mark.parametrize(("given", "words"), [
    ({"format": "csv"}, "format='csv'.*auto, table, ublox, silabs"), ({"separator": "ab"}, "separator='ab'"),
    ({"separator": "1"}, "one character"), ({"decimal": ";"}, "decimal=';'"),
    ({"encoding": "windows"}, "encoding='windows'.*cp1252"), ({"encoding": "utf-16"}, "extends ASCII"), ({"encoding": "rot13"}, "extends ASCII"), ({"header": "fix"}, "header='fix'.*a list"), ({"header": ("a", "a")}, "a occurs more than once"), ({"header": ()}, "name of each column"),
    ({"patterns": ("a{anchor}{anchor}",)}, "once"),
])  # fmt: skip
def test_options_that_are_wrong(given, words):
    with pytest.raises(BadValue, match=words):
        opened("path", "log.csv", Reading(**given))


def test_a_separator_that_the_file_does_not_have(rows, here):
    rows.to_csv("log.csv", index=False, sep=";")
    with pytest.raises(BadValue, match=r"separated by ';'\?"):
        header("path", "log.csv", Reading(separator="|"))


def test_memory_is_about_the_file(rng, here):
    buffer = io.StringIO()
    pd.DataFrame({"fix": np.arange(1000), "azimuth_deg": rng.uniform(size=1000)}).to_csv(buffer)
    Path("log.csv").write_text(buffer.getvalue())
    assert len(read(names={"azimuth": "azimuth_deg"}).frame) == 1000


@pytest.mark.parametrize("mark", [".", ","])
def test_dates_may_have_decimal_commas(mark, here):
    Path("log.csv").write_text(
        f"t;a\n2024-05-16 10:00:00{mark}125;1\n;2\n2024-05-16T12:00:01+02:00;3\n"
    )
    moments = read(names={"time": "t", "a": "a"}).dates("time")
    expected = [1715853600.125, np.nan, 1715853601]
    found = (moments - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-7)
