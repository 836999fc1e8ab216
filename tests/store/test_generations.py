"""Readers see one whole generation of tables; what is missing, torn or altered is one line."""

import json
import os
import shutil
import time

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import aoabench
from aoabench.errors import RunError, UserError
from aoabench.store import earlier, folder, index, layout, manifest, tables
from aoabench.store.documents import read_document, write_document
from aoabench.store.fixes import clusters, fixes
from tests.store import made

NAMES = ("tidy", "cells", "summary", "failures", "timing", "precision")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    out = tmp_path_factory.mktemp("source") / "run"
    made.cell(out, "b", ["ls"])
    made.cell(out, "a", sigma_deg=10)
    tables.collect(out)
    return out


@pytest.fixture
def out(source, tmp_path):
    return shutil.copytree(source, tmp_path / "run")


@pytest.fixture
def old(out):
    """The folder as an earlier version wrote it: without checksums, manifest and index."""
    (out / "tables.json").unlink()
    shutil.rmtree(out / ".tables")
    for path in (out / "cells").iterdir():
        record = read_document(path)
        del record["format"]
        path.write_text(json.dumps(record))
    return out


def frames(out):
    return {name: pd.read_parquet(out / f"{name}.parquet") for name in NAMES}


def assert_equal(found, expected):
    assert found.keys() == expected.keys()
    for name, frame in found.items():
        pd.testing.assert_frame_equal(frame, expected[name], check_exact=True, obj=name)


def refused(out, match, kind=RunError, ask=tables.load):
    with pytest.raises(kind, match=match) as error:
        ask(out)
    assert "\n" not in str(error.value)
    assert str(out) in str(error.value)


def rewritten(path, change):
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def test_load_returns_the_replications_in_the_order_of_the_cells_names(out):
    frame = tables.load(out)
    assert frame["cell"].tolist() == ["a"] * 8 + ["b"] * 4
    assert frame["estimator"].tolist() == ["ls"] * 4 + ["ml"] * 4 + ["ls"] * 4
    assert frame["noise.sigma_deg"].tolist() == [10.0] * 8 + [1.0] * 4
    pd.testing.assert_frame_equal(frame, earlier.shown(out, ["tidy"])["tidy"])
    assert pd.read_parquet(out / "tidy.parquet")["cell"].tolist() == ["b"] * 4 + ["a"] * 8


@pytest.mark.parametrize("which", ["out", "old"])
def test_load_of_some_cells_is_their_part_of_the_whole(which, request):
    """From today's tables and from those of an earlier version."""
    folder = request.getfixturevalue(which)
    whole = tables.load(folder)
    for ids in (["a"], ["b", "a"], ["c"], []):
        part = whole[whole["cell"].isin(ids)].reset_index(drop=True)
        found = tables.load(folder, ids).reset_index(drop=True)
        assert found["cell"].tolist() == part["cell"].tolist()
        pd.testing.assert_frame_equal(found, part, check_dtype=bool(ids))


def test_tables_of_changed_cells_alone_equal_those_of_all(out, monkeypatch):
    """A new cell at the end, at the start, in the middle with another parameter; an estimator less
    and more in a cell; small batches and groups of rows.
    """
    monkeypatch.setattr("aoabench.store.tidy._BATCH", 5)
    steps = [
        ("c", {"sigma_deg": 20.0}),
        ("d", {"sigma_deg": 0.5}),
        ("e", {"sigma_deg": 5.0, "k": 1}),
    ]
    steps += [("a", {"sigma_deg": 30, "estimators": ["ls"]}), ("b", {"estimators": ["ls", "nn"]})]
    for name, given in steps:
        made.cell(out, name, **given)
        tables.collect(out, [name])
        found, loaded = frames(out), tables.load(out)
        tables.collect(out)
        assert_equal(found, frames(out))
        pd.testing.assert_frame_equal(loaded, tables.load(out), check_exact=True)
        pd.testing.assert_frame_equal(loaded, earlier.shown(out, ["tidy"])["tidy"])


def test_a_reused_cell_changes_no_file(out):
    tables.collect(out, [])  # the copied records have other times
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    tables.collect(out, ["a"])
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_a_record_that_a_killed_run_wrote_is_collected_by_the_next_run(out):
    made.cell(out, "c", ["ls"])
    tables.collect(out, ["a"])
    assert set(tables.load(out)["cell"]) == {"a", "b", "c"}


def test_a_precision_that_is_asked_of_stored_replications_is_shown(out):
    precision = dict.fromkeys(tables.PRECISION, 1.0) | {"metric": "rmse_3d_m", "reached": True}
    precision = {k: v for k, v in precision.items() if k not in tables.IDENTITY}
    record = read_document(out / "cells" / "a.json")
    record["estimators"]["ml"]["precision"] = precision | {"replications": 4}
    write_document(out / "cells" / "a.json", record)
    tables.collect(out, ["a"])
    found = pd.read_parquet(out / "precision.parquet")
    assert found[["cell", "estimator", "replications"]].to_numpy().tolist() == [["a", "ml", 4]]


def test_a_part_that_was_computed_again_is_collected_again(out):
    def states():
        return dict(zip(*(index.read(out).column(name) for name in ("cell", "state"))))

    tables.collect(out, [])
    before = states()
    made.part(out, "bls", 0, 2, fixes=2)
    tables.collect(out, ["a"])
    assert states() == before
    tables.collect(out, ["b"])
    assert (states()["a"] == before["a"], states()["b"] == before["b"]) == (True, False)


def test_readers_see_the_last_whole_generation_while_tables_are_made(out, monkeypatch):
    """Before and after each file is put in place: the old generation until the manifest, then the
    new one.
    """
    replace, seen = os.replace, []

    def read():
        shown = tables.shown(out, "tidy", "cells", "summary")
        cells = [set(frame["cell"]) for frame in shown.values()]
        assert cells[0] == cells[1] == cells[2]
        assert (fixes(out, "c", "ls").error_3d_m.shape if "c" in cells[0] else (4, 2)) == (4, 2)
        seen.append(len(cells[0]))

    def watched(source, target):
        read()
        replace(source, target)
        read()
        if os.fspath(target).endswith("tables.json"):
            assert seen[-2:] == [2, 3]

    made.cell(out, "c", sigma_deg=3.0)
    monkeypatch.setattr(os, "replace", watched)
    tables.collect(out, ["c"])
    assert seen == sorted(seen)
    assert (seen.count(2) > 10, seen.count(3) > 10) == (True, True)


def test_compare_takes_all_it_needs_from_one_generation(out, monkeypatch):
    """Between its tables and the fixes of its intervals, a run changes the cell."""
    expected, shown = aoabench.compare(out), tables.shown

    def overtaken(_run, *names):
        found = shown(out, *names)
        made.cell(out, "a", ["ml", "ls"], sigma_deg=10, keys="new")
        tables.collect(out, ["a"])
        return found

    monkeypatch.setattr(tables, "shown", overtaken)
    pd.testing.assert_frame_equal(aoabench.compare(out), expected)


def test_a_part_with_the_replications_of_another_is_refused(out):
    made.write_part(out, "cls", 0, 4, made.block(4, 8), made.ORIGIN)
    record = read_document(out / "cells" / "b.json")
    record["estimators"]["ls"]["key"] = "cls"
    write_document(out / "cells" / "b.json", record)
    refused(out, "parts/cls does not hold the replications 0 to 3", ask=tables.collect)


def test_a_collect_that_is_killed_anywhere_leaves_a_whole_generation(source, tmp_path, monkeypatch):
    """Killed before each file that it puts in place; the next run, of another cell, goes on."""
    replace, number = os.replace, 0
    done = False
    while not done:
        out = shutil.copytree(source, tmp_path / f"{number}")
        made.cell(out, "c", ["ls"], sigma_deg=3.0)
        calls = []

        def dies(source, target, calls=calls, last=number):
            calls.append(target)
            if len(calls) > last:
                raise KeyboardInterrupt
            replace(source, target)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", dies)
            try:
                tables.collect(out, ["c"])
                done = True
            except KeyboardInterrupt:
                whole = {"a", "b", "c"} if out / "tables.json" in calls[:-1] else {"a", "b"}
                assert set(tables.load(out)["cell"]) == whole
        tables.collect(out, ["b"])
        assert set(tables.load(out)["cell"]) == {"a", "b", "c"}
        assert set(frames(out)["summary"]["cell"]) == {"a", "b", "c"}
        number += 1
    assert number > 14


def test_a_reader_that_is_overtaken_twice_reads_the_newest_generation(out, monkeypatch):
    stale = [manifest.current(out)]
    for _ in range(3):
        tables.collect(out)
    assert not stale[0].file("tidy").exists()
    real = manifest.current
    monkeypatch.setattr(manifest, "current", lambda out: stale.pop() if stale else real(out))
    assert len(tables.load(out)) == 12


def test_superseded_tables_are_deleted(out):
    for _ in range(4):
        tables.collect(out)
        for file in (out / ".tables").iterdir():
            os.utime(file, times=(1e9, 1e9))
    (out / ".tables" / "tidy.0123.parquet").touch()
    tables.collect(out)
    left = {file.name for file in (out / ".tables").iterdir()}
    assert len(left) == 2 * 7 + 1, "this generation, the one before, and a file being written"


def test_tables_are_copies_where_the_file_system_has_no_links(out, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise OSError(1, "no links")

    monkeypatch.setattr(os, "link", refuse)
    made.cell(out, "c")
    tables.collect(out, ["c"])
    assert set(pd.read_parquet(out / "tidy.parquet")["cell"]) == {"a", "b", "c"}
    times = {name: (out / f"{name}.parquet").stat().st_ino for name in NAMES}
    tables.collect(out, [])
    assert times == {name: (out / f"{name}.parquet").stat().st_ino for name in NAMES}


def test_lost_links_change_nothing_and_come_back(out):
    before = tables.load(out)
    for name in NAMES:
        (out / f"{name}.parquet").unlink()
    pd.testing.assert_frame_equal(tables.load(out), before)
    assert len(aoabench.compare(out)) == 1
    tables.collect(out, [])
    assert len(frames(out)["tidy"]) == 12


HOW = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:-20]),
    "emptied": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("a,b\n1,2\n"),
    "foreign": lambda path: pq.write_table(pa.table({"x": [1]}), path),
    "fewer rows": lambda path: pq.write_table(pq.read_table(path).slice(1), path),
    "deleted": lambda path: path.unlink(),
}


@pytest.mark.parametrize(("how", "name"), [
    *((how, "tidy") for how in HOW), ("fewer rows", "summary"), ("foreign", "cells"),
    ("fewer rows", "index"), ("deleted", "index"), ("deleted", "summary"),
    ("truncated", "tables.json"), ("emptied", "tables.json"), ("deleted", "tables.json"),
])  # fmt: skip
def test_a_table_that_cannot_be_used_is_named_and_collect_mends_it(how, name, out):
    before = tables.load(out)
    file = out / name if "." in name else manifest.current(out).file(name)
    HOW[how](file)
    line = rf"{file.name} is (torn or altered|missing); .*: aoabench collect {out}$"
    asked = {"tidy": [tables.load], "index": [lambda out: clusters(out, "a", "ls")]}
    for ask in asked.get(name, []) + [aoabench.compare]:
        refused(out, line, ask=ask)
    shutil.copytree(out, out.with_name("other"))
    made.cell(out.with_name("other"), "c", ["ls"])
    for mended, only in ((out, None), (out.with_name("other"), ["c"])):
        tables.collect(mended, only)
        found = tables.load(mended)
        pd.testing.assert_frame_equal(found[found["cell"] != "c"], before)


@pytest.mark.parametrize("how", ["deleted", "truncated"])
def test_a_table_that_no_reader_takes_is_made_again_by_the_next_run(how, out):
    tables.collect(out, [])  # the copied records have other times
    HOW[how](manifest.current(out).file("timing"))
    tables.collect(out, ["a"])
    assert len(pd.read_parquet(out / "timing.parquet")) == 3


@pytest.mark.parametrize("change", [
    lambda r: r["estimators"]["ls"].update(reps=3),
    lambda r: r.update(cell="b"),
    lambda r: r["config"]["noise"].update(sigma_deg=11),
    lambda r: r.pop("checksum"),
    lambda r: r.pop("format"),
])  # fmt: skip
def test_an_altered_record_is_named_and_mended_by_running_its_cell_again(change, out):
    path, before = out / "cells" / "a.json", tables.load(out)
    rewritten(path, change)
    line = r"a\.json is torn or altered; delete it and run the command of its cell again"
    for ask in (tables.collect, lambda out: tables.collect(out, ["b"]), folder.records):
        refused(out, line, ask=ask)
    pd.testing.assert_frame_equal(tables.load(out), before)
    path.unlink()
    refused(out, r"a\.json is missing, .* run the command of that cell again", ask=tables.collect)
    index.read(out, ["a"])
    made.cell(out, "a", sigma_deg=10)
    tables.collect(out, ["a"])
    pd.testing.assert_frame_equal(tables.load(out), before)


def test_a_cell_is_left_out_once_its_record_and_the_manifest_are_deleted(out):
    (out / "cells" / "a.json").unlink()
    (out / "tables.json").unlink()
    refused(out, r"tables\.json is missing; .* aoabench collect")
    tables.collect(out)
    assert set(tables.load(out)["cell"]) == {"b"}


@pytest.mark.parametrize("change", [
    lambda r: r["estimators"]["ls"].update(reps=-1),
    lambda r: r["estimators"]["ls"].update(reps=True),
    lambda r: r["estimators"]["ls"].update(reps=2.0),
    lambda r: r["estimators"]["ls"].update(key="../x"),
    lambda r: r.update(cell="b"),
    lambda r: r["estimators"]["ls"].pop("steps"),
    lambda r: r.update(estimators=[]),
    lambda r: r.update(scenario=None),
    lambda r: r.pop("seed"),
])  # fmt: skip
def test_a_record_of_an_earlier_version_has_to_make_sense(change, old):
    rewritten(old / "cells" / "a.json", change)
    refused(old, r"a\.json is torn or altered", ask=tables.collect)
    refused(old, r"a\.json is torn or altered")


def test_records_of_another_format_are_refused(out):
    path = out / "cells" / "a.json"
    write_document(path, {**read_document(path), "format": 3})
    refused(out, r"a\.json has format 3; allowed: 1 to 2", UserError, tables.collect)


def test_a_folder_of_an_earlier_version_is_read_and_collected(old, source):
    expected = tables.load(source)
    pd.testing.assert_frame_equal(tables.load(old), expected)
    pd.testing.assert_frame_equal(aoabench.compare(old), aoabench.compare(source))
    assert fixes(old, "a", "ls").error_3d_m.shape == (4, 2)
    tables.collect(old, [])
    pd.testing.assert_frame_equal(tables.load(old), expected)
    assert manifest.current(old) is not None
    assert read_document(old / "cells" / "a.json") == read_document(source / "cells" / "a.json")


def deleted_rows(out):
    path = out / "replications.parquet" / "a.parquet"
    pq.write_table(pq.read_table(path).slice(1), path)


@pytest.mark.parametrize(("harm", "line"), [
    (deleted_rows, r"a\.parquet has not the replications 0 to 3 of ls"),
    (lambda out: rewritten(out / "cells" / "a.json", lambda r: r["estimators"]["ml"].update(reps=3)),
     r"a\.parquet has not the replications 0 to 2 of ml"),
    (lambda out: rewritten(out / "cells" / "a.json", lambda r: r["estimators"].pop("ml")),
     r"a\.parquet has not the rows that its record names"),
    (lambda out: (out / "replications.parquet" / "a.parquet").unlink(), "not the same cells"),
    (lambda out: (out / "cells" / "a.json").unlink(), "not the same cells"),
    (lambda out: (out / "cells.parquet").unlink(), r"cells\.parquet .*is missing"),
    (lambda out: HOW["truncated"](out / "cells.parquet"), r"cells\.parquet is torn"),
    (lambda out: HOW["foreign"](out / "replications.parquet" / "b.parquet"), r"b\.parquet"),
    (lambda out: HOW["emptied"](out / "replications.parquet" / "b.parquet"), r"b\.parquet is torn"),
])  # fmt: skip
def test_a_folder_of_an_earlier_version_that_contradicts_itself_is_refused(harm, line, old):
    harm(old)
    for ask in (tables.load, aoabench.compare):
        refused(old, rf"{line}.*: aoabench collect {old}$", ask=ask)
    tables.collect(old)
    assert len(tables.load(old)) >= 4


def test_compare_of_a_folder_of_an_earlier_version_names_a_torn_summary(old):
    HOW["truncated"](old / "summary.parquet")
    refused(old, r"summary\.parquet is torn or altered; .*aoabench collect", ask=aoabench.compare)


def test_no_results_are_no_results(tmp_path):
    (tmp_path / "empty").mkdir()
    for out in (tmp_path / "empty", tmp_path / "nowhere"):
        for ask in (tables.load, aoabench.compare, tables.collect):
            refused(out, "no results here", UserError, ask)


@pytest.mark.parametrize("name", ["cells", "parts", ".tables", "replications.parquet", "tables.json", "tidy.parquet"])  # fmt: skip
def test_the_wrong_kind_of_thing_is_named(name, out):
    place = out / name
    is_folder = place.is_dir()
    if is_folder:
        place.rename(out / "elsewhere")
        place.touch()
    else:
        place.unlink()
        place.mkdir()
    kind = "file; allowed here: a folder" if is_folder else "folder; allowed here: a file"
    for ask in (tables.load, tables.collect, lambda out: index.read(out, ["c"])):
        refused(out, rf"{name} is a {kind}", UserError, ask)


def test_temporary_files_of_killed_runs_are_deleted_once_they_are_old(out):
    shown = ("a.json", "x.parquet", ".x.parquet.12", ".x.12.0123456789", ".x.12.0123456z")
    for folder_ in (out, out / "cells", out / "parts" / "als", out / "parts" / "bls"):
        for name in (".x.parquet.12.0123abcd", *shown):
            if not (folder_ / name).exists():
                (folder_ / name).touch()
            os.utime(folder_ / name, times=(time.time() - 3700,) * 2)
        (folder_ / ".y.parquet.12.0123abcd").touch()
    layout.sweep(out, ["als", "none"])
    left = {path.parent.name for path in out.rglob(".x.parquet.12.0123abcd")}
    assert left == {"bls"}, "the folder of another part key"
    assert len(list(out.rglob(".y.*"))) == 4, "a worker may be writing it"
    assert all((out / "cells" / name).exists() for name in shown)


def test_the_commands_of_failures_follow_a_folder_that_was_moved(out, monkeypatch):
    row = dict.fromkeys(tables.FAILURES, "x") | {"replication": 1, "n_failed": 1, "n_fixes": 2}
    row |= {"cell": "a", "estimator": "ls", "replay": f"aoabench replay {out}"}
    kept = tables._table([row, row | {"replay": None}], tables.FAILURES)
    file = tables._write(out, "failures", kept)
    manifest.publish(out, {"failures": file}, manifest.current(out))
    there = out.rename(out.with_name("moved"))
    made.cell(there, "c", ["ls"])
    tables.collect(there, ["c"])
    found = pd.read_parquet(there / "failures.parquet")["replay"]
    assert found[0] == f"aoabench replay {there} --cell a --estimator ls --replication 1"
    assert found.isna().tolist() == [False, True]
