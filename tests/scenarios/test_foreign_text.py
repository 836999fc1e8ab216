"""What other people's files may hold: texts that a terminal would obey, columns of any kind, secrets."""

import json
from datetime import date, time, timedelta
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import aoabench
from aoabench.errors import BadValue, RunError, UserError, listed, printable
from tests.scenarios.test_recorded import here, read  # noqa: F401 - a fixture

RED, UP, RTL = "\x1b[31m", "\x1b[1A\x1b[2K", "‮"


@pytest.mark.parametrize(("text", "shown"), [
    (f"a{RED}b", r"a\x1b[31mb"), (f"{RTL}a", r"\u202ea"), ("a\rb\tc\0", r"a\rb\tc\x00"),
    ("\x9b2J", r"\x9b2J"), ("a\u2028b", r"a\u2028b"), ("\udcff", r"\udcff"), ("\U000e0041", r"\U000e0041"),
    ("±1° é 日本 95 %\n", "±1° é 日本 95 %\n"),
])  # fmt: skip
def test_nothing_that_a_terminal_obeys_is_printed(text, shown):
    assert printable(text) == shown
    for error in (UserError, RunError):
        assert str(error(text)) == shown
    assert str(BadValue("key", 1, text)) == f"key=1 is not allowed; allowed: {shown}"


def test_names_are_listed_within_bounds():
    assert listed(["a", 1, RED]) == r"a, 1, \x1b[31m"
    assert listed(list("abc"), most=2) == "a, b, ... (3)"
    assert len(listed(["x" * 10**6] * 100)) < 1500


def hostile(call_or_read):
    """Check the error or the lines of a call: one line, no characters that a terminal obeys."""
    with pytest.raises(UserError) as told:
        call_or_read()
    assert printable(str(told.value)) == str(told.value)
    assert len(str(told.value)) < 3000
    return str(told.value)


ID = f"{RED}{UP}a1"


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize("place", ["log", "anchors", "column", "name of the log"])
def test_foreign_texts_in_errors_are_escaped(kind, place, here):  # noqa: F811
    log, anchors = pd.read_csv("log.csv", dtype=str), pd.read_csv("anchors.csv", dtype=str)
    path = f"l{RED}og.{kind}" if place == "name of the log" else f"log.{kind}"
    if place == "anchors":
        anchors["id"] = [f"{ID}{i}" * 100 for i in range(len(anchors))]
    if place == "log":
        log.loc[1, "anchor"] = ID * 1000
    if place in ("column", "name of the log"):
        log = log.rename(columns={"azimuth_deg": f"azimuth{RED}", "x_m": "x_m" * 1000})
    for frame, name in ((log, path), (anchors, f"anchors.{kind}")):
        frame.to_csv(name, index=False) if kind == "csv" else frame.to_parquet(name)
    said = hostile(lambda: read(path=path, anchors=f"anchors.{kind}"))
    assert "x1b" in said or place == "column"


def test_foreign_texts_in_notes_and_tables_are_escaped(here, capsys):  # noqa: F811
    from aoabench.cli.main import main

    (here / "c" / "estimator").mkdir(parents=True)
    (here / "c" / "estimator" / "mine.yaml").write_text(f"# {RED}nice\nmine: {{_target_: x.Y}}\n")
    path = f"l{RED}og.csv"
    pd.read_csv("log.csv").drop(columns=["x_m", "y_m", "z_m"]).to_csv(path, index=False)
    aoabench.cli.main._complain(f"a{RED}\nb")
    words = ["run", "scenario=recorded", f"scenario.path={path}", "scenario.anchors=anchors.csv", "estimator=[ls_lines]", "runner.out=o", "runner.n_jobs=1"]  # fmt: skip
    (here / "d" / "noise").mkdir(parents=True)
    (here / "d" / "noise" / "other.yaml").write_text(f'defaults: [vmf]\nname: "{RTL}"\n')
    shown = ["run", "noise=other", "estimator=[ls]", "--config-dir", "d", "--cfg", "job"]
    for command in (words, ["list", "estimator", "--config-dir", "c"], ["list", RED], shown):
        with pytest.raises(SystemExit):
            main(command)
    done = capsys.readouterr()
    assert not {"\x1b", RTL} & set(done.out + done.err)
    assert r"name: \u202e" in done.out
    assert r"l\x1b[31mog.csv: 2 fixes" in done.err
    assert r"a\x1b[31m b" in done.err


@pytest.mark.parametrize("text", [
    "root:x:0:0,hunter2\n", "hunter2\n", '{"password": "hunter2", "user": 1}\n', "-----BEGIN KEY-----,hunter2\n",
    "export A=hunter2,export B=1\n", "hunter2;x_m\n", "1.5,2.5,hunter2\n",
])  # fmt: skip
def test_the_first_line_of_a_file_that_is_no_table_is_not_quoted(text, here):  # noqa: F811
    Path("secret.csv").write_text(text)
    for options in ({"path": "secret.csv"}, {"anchors": "secret.csv"}):
        said = hostile(lambda options=options: read(**options))
        assert "hunter2" not in said
        assert "no names of columns" in said or "has password, user" in said


# --- Parquet --------------------------------------------------------------------------------------

COLUMNS = ("fix", "anchor", "azimuth_deg", "x_m", "time_s")
T = pa.int64()
ODD = {
    "struct": pa.array([{"a": 1}] * 4), "list": pa.array([[1, 2]] * 4), "fixed list": pa.array([[1.0]] * 4, pa.list_(pa.float32(), 1)),
    "large list": pa.array([["a"]] * 4, pa.large_list(pa.string())), "map": pa.array([[("a", 1)]] * 4, pa.map_(pa.string(), T)),
    "binary": pa.array([b"\xff\x00"] * 4), "fixed binary": pa.array([b"ab"] * 4, pa.binary(2)), "large binary": pa.array([b"a"] * 4, pa.large_binary()),
    "duration": pa.array([timedelta(1)] * 4), "time of day": pa.array([time(1, 2)] * 4),
    "dictionary of binary": pa.array([b"a", b"b"] * 2).dictionary_encode(),
    "half float": pa.array(np.ones(4, np.float16)), "decimal": pa.array([Decimal("1.5")] * 4), "bool": pa.array([True] * 4),
    "date": pa.array([date(2026, 1, 2)] * 4), "nothing": pa.nulls(4), "uint64": pa.array([2**64 - 1] * 4, pa.uint64()),
    "dictionary": pa.array(["a1", "a2"] * 2).dictionary_encode(), "dictionary of numbers": pa.array([1, 2] * 2).dictionary_encode(),
    "large string": pa.array(["a1"] * 4, pa.large_string()), "string view": pa.array(["a1"] * 4, pa.string_view()),
    "text of NaN": pa.array(["nan", "\0", "", RED]), "infinite": pa.array([np.inf, -np.inf, np.nan, 0]),
}  # fmt: skip


def refusal(options):
    """The line about files that are refused; "" if they are read."""
    try:
        read(**options)
    except UserError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("column", COLUMNS)
def test_any_kind_of_column_is_read_or_refused_in_a_line(column, here):  # noqa: F811
    log, anchors = (pa.Table.from_pandas(pd.read_csv(f)) for f in ("log.csv", "anchors.csv"))
    log = log.append_column("time_s", pa.array([0, 0, 1, 1]))
    for name, odd in ODD.items():
        place = log.schema.get_field_index(column)
        given = log.set_column(place, column, odd)
        if column == "time_s":
            given = given.drop(["fix"])
        pq.write_table(given, "log.parquet")
        pq.write_table(anchors.set_column(0, "id", odd.slice(0, len(anchors))), "anchors.parquet")
        for options in ({"path": "log.parquet"}, {"anchors": "anchors.parquet"})[
            : 2 if column == "fix" else 1
        ]:
            said = refusal(options)
            assert "\n" not in said
            assert "allowed: a readable" not in said
            if pa.types.is_nested(odd.type) or "binary" in name:
                assert "has the type " in said, name


def with_index(frame, how):
    if how == "default":
        return frame
    if how == "named":
        return frame.set_index("fix")
    if how == "named range":
        return frame.drop(columns="fix").rename_axis("fix")
    if how == "unnamed":
        return frame.set_index(pd.Index([7, 9, 8, 1]))
    return frame.set_index(["fix", "anchor"])


@pytest.mark.parametrize("how", ["default", "named", "named range", "unnamed", "multi"])
def test_an_index_of_pandas_is_read_as_columns(how, here):  # noqa: F811
    frame = pd.read_csv("log.csv")
    frame["fix"] = [0, 1, 2, 3] if how == "named range" else [0, 1, 3, 9]
    if how == "named range":
        frame = frame.assign(x_m=3.0)
    frame.to_csv("log.csv", index=False)
    with_index(frame, how).to_parquet("log.parquet")
    meta = json.loads(pq.read_schema("log.parquet").metadata[b"pandas"])["index_columns"]
    assert isinstance(meta[0], dict) == (how in ("default", "named range"))
    for a, b in zip(
        vars(read(path="log.parquet").recorded).values(), vars(read().recorded).values()
    ):
        np.testing.assert_array_equal(a, b)
    anchors = pd.read_csv("anchors.csv")
    anchors.set_index("id").to_parquet("anchors.parquet")
    np.testing.assert_array_equal(
        read(anchors="anchors.parquet").true_anchors.position, read().true_anchors.position
    )


def test_strange_metadata_of_pandas_is_no_matter(here):  # noqa: F811
    table = pa.Table.from_pandas(pd.read_csv("log.csv"), preserve_index=False)
    for text in (
        "{",
        "[]",
        '{"index_columns": 3}',
        '{"index_columns": [{"name": "q", "start": "a"}]}',
    ):
        pq.write_table(table.replace_schema_metadata({"pandas": text}), "log.parquet")
        assert read(path="log.parquet").recorded.azimuth.shape == (2, 3)
