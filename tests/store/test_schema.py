"""The tables' columns and version: their own schema, those of an earlier version, and unknown ones."""

import json
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import aoabench
from aoabench import columns
from aoabench.store import files, fixes, tables
from aoabench.store.documents import read_document, write_document
from aoabench.types import SENTENCES, Estimates, Outcome, Reason

NEW = {  # columns that tables of schema 1 lack
    "rows": ("n_unmeasured", "n_imprecise", "reason"),
    "fixes": ("reason", "imprecise", "n_unmeasured", "sigma_x_m", "sigma_y_m", "sigma_z_m"),
}


class Choosy:
    """Rejects fixes 0, 3, 6 ...; fails at fixes 1, 7, 13 ..., and gives NaN at fix 2."""

    def __call__(self, batch, scenario, streams):
        position = np.full((*batch.azimuth.shape[:2], 3), [3.6, 4.25, 1.0])
        outcome = np.zeros(position.shape[:2], dtype=np.int8)
        reason = np.zeros_like(outcome)
        outcome[:, ::3], reason[:, ::3] = Outcome.REJECTED, Reason.NO_AGREEMENT
        outcome[:, 1::6], reason[:, 1::6] = Outcome.FAILED, Reason.ONE_PLACE
        position[:, 2] = np.nan
        return Estimates(position, None, None, outcome, reason=reason)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("schema") / "out"
    words = ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=3", "runner.n_jobs=1"]
    aoabench.run(
        *words, "estimator=[anchor_mean]", "reps=4", out=out, estimators={"choosy": Choosy()}
    )
    return out


def as_version_1(out):
    """Rewrite the records of a run as an earlier version wrote them, and take its manifest away."""
    (out / "tables.json").unlink()
    shutil.rmtree(out / ".tables")
    for path in (out / "cells").iterdir():
        record = read_document(path)
        record.pop("format")
        path.write_text(json.dumps(record))


def as_schema_1(out):
    """Rewrite the files of a run as an earlier version wrote them."""
    as_version_1(out)

    def strip(path, names=()):
        table = pq.read_table(path)
        table = table.drop_columns([c for c in names if c in table.column_names])
        meta = {k: v for k, v in (table.schema.metadata or {}).items() if k != b"aoabench_schema"}
        pq.write_table(table.replace_schema_metadata(meta), path)

    for path in out.rglob("parts/*/*.json"):
        kinds = read_document(path)["kinds"]
        kinds.pop("reasons", None)
        named = {}
        for kind, entry in kinds.items():
            file = path.parent / entry["file"]
            strip(file, NEW.get(kind, ()))
            named[kind] = [file.name, files.file_checksum(file)]
        path.write_text(json.dumps(named))
    for path in (out / "replications.parquet").glob("*.parquet"):
        strip(path, NEW["rows"])
    for name in ("cells", "summary", "failures", "tidy", "timing", "precision"):
        strip(out / f"{name}.parquet")


def test_tables_have_exactly_their_columns_and_version(run):
    (cell,) = (path.stem for path in (run / "cells").glob("*.json"))
    summary = pq.read_schema(run / "summary.parquet")
    swept = [n for n in summary.names if n not in columns.SUMMARY]
    assert summary.names[5 : 5 + len(swept)] == swept == ["scenario.packets"]
    assert [n for n in summary.names if n not in swept] == list(columns.SUMMARY)
    wanted = files.schema(columns.SUMMARY)
    assert all(summary.field(name).type == wanted.field(name).type for name in columns.SUMMARY)
    for path, known in (
        (run / "replications.parquet" / f"{cell}.parquet", columns.REPLICATIONS),
        (run / "failures.parquet", columns.FAILURES),
    ):
        assert pq.read_schema(path).names == list(known)
    for path in run.rglob("*.parquet"):
        if path.is_file():
            version = files.version_in(pq.read_schema(path).metadata, path)
            assert version == columns.SCHEMA == 2


def test_reasons_of_every_fix_are_counted(run):
    """126 fixes: 42 rejected, 21 failed, one NaN, in each of 4 replications."""
    summary = pd.read_parquet(run / "summary.parquet").set_index("estimator")
    choosy = summary.loc["choosy"]
    assert (choosy["share_rejected"], choosy["share_failed"]) == (42 / 126, 22 / 126)
    assert (choosy["reason"], choosy["share_reason"]) == ("no_agreement", 42 / 126)
    mean = summary.loc["anchor_mean"]
    assert (mean["reason"], mean["share_reason"]) == ("behind", mean["share_diverged"])
    assert 0 < mean["share_diverged"] < 0.1
    assert (summary["share_unmeasured"] == 0).all()
    assert (choosy["share_imprecise"], 0 < mean["share_imprecise"] < 0.1) == (0, True)
    failed = pd.read_parquet(run / "failures.parquet")
    assert list(failed["replication"]) == [0, 1, 2, 3]
    assert set(failed["reason"]) == {"one_place"}, "of the failed fixes, not of the rejected ones"
    assert set(failed["sentence"]) == {SENTENCES[Reason.ONE_PLACE]}
    rows = aoabench.load(run)
    assert set(rows.loc[rows["estimator"] == "choosy", "reason"]) == {"no_agreement"}
    of_mean = rows[rows["estimator"] == "anchor_mean"]
    assert of_mean["reason"].tolist() == np.where(of_mean["n_ok"] < 126, "behind", "").tolist()
    cell = rows["cell"].iloc[0]
    found = fixes.fixes(run, cell, "choosy")
    assert (
        found.reason[:, :4].tolist()
        == [[Reason.NO_AGREEMENT, Reason.ONE_PLACE, Reason.NOT_A_NUMBER, Reason.NO_AGREEMENT]] * 4
    )
    assert np.isnan(found.sigma_x_m).all()
    assert not found.imprecise.any()


def test_a_folder_of_the_earlier_schema_is_read(run, tmp_path):
    """What it holds is unchanged, and what it lacks is unknown, not 0."""
    out = tmp_path / "old"
    shutil.copytree(run, out)
    as_schema_1(out)
    before, after = aoabench.load(run), aoabench.load(out)
    pd.testing.assert_frame_equal(
        before.drop(columns=list(NEW["rows"])), after.drop(columns=list(NEW["rows"]))
    )
    assert after[list(NEW["rows"])].isna().all(axis=None)
    assert len(aoabench.compare(out, metric="rmse_xy_m")) == 1
    old = fixes.fixes(out, after["cell"].iloc[0], "choosy")
    assert old.reason is old.sigma_x_m is old.imprecise is None
    assert np.array_equal(old.error_xy_m, fixes.fixes(run, after["cell"].iloc[0], "choosy").error_xy_m, equal_nan=True)  # fmt: skip
    tables.collect(out)
    summary = pd.read_parquet(out / "summary.parquet")
    assert summary["reason"].isna().all()
    assert summary[["share_reason", "share_unmeasured", "share_imprecise"]].isna().all(axis=None)
    same = [c for c in columns.SUMMARY if c not in ("reason", "share_reason", "share_unmeasured", "share_imprecise")]  # fmt: skip
    pd.testing.assert_frame_equal(summary[same], pd.read_parquet(run / "summary.parquet")[same])
    failed = pd.read_parquet(out / "failures.parquet")
    assert len(failed) == 4
    assert failed[["reason", "sentence"]].isna().all(axis=None)


def test_a_new_cell_in_an_old_folder_leaves_both_readable(run, tmp_path):
    out = tmp_path / "mixed"
    shutil.copytree(run, out)
    as_schema_1(out)
    aoabench.run("filter=[ekf_vmf]", "reps=2", "runner.n_jobs=1", out=out)
    frame = aoabench.load(out)
    unknown = frame["n_unmeasured"].isna()
    assert set(frame["scenario"][unknown]) == {"ble_room"}
    assert set(frame["scenario"][~unknown]) == {"square_track"}
    tidy = pd.read_parquet(out / "tidy.parquet")
    assert list(tidy["n_unmeasured"].isna()) == list(tidy["scenario"] == "ble_room")


@pytest.mark.parametrize("version", ["3", "0", "x"])
def test_a_folder_of_an_unknown_schema_is_refused_in_one_line(version, run, tmp_path):
    out = tmp_path / "new"
    shutil.copytree(run, out)
    as_version_1(out)
    for path in [f for f in out.rglob("*.parquet") if f.is_file() and "parts" not in f.parts]:
        table = pq.read_table(path)
        meta = {**table.schema.metadata, b"aoabench_schema": version.encode()}
        pq.write_table(table.replace_schema_metadata(meta), path)
    for ask in (aoabench.load, aoabench.compare):
        with pytest.raises(
            aoabench.UserError, match=rf"schema {version}; allowed: 1 to 2; .*runner.out"
        ) as error:
            ask(out)
        assert "\n" not in str(error.value)
        assert str(out) in str(error.value)


def test_a_part_of_an_unknown_schema_is_refused(run, tmp_path):
    out = tmp_path / "parts"
    shutil.copytree(run, out)
    for path in out.rglob("parts/*/*.json"):
        content = read_document(path)
        for entry in content["kinds"].values():
            file = path.parent / entry["file"]
            table = pq.read_table(file)
            pq.write_table(table.replace_schema_metadata({b"aoabench_schema": b"9"}), file)
            entry["checksum"] = files.file_checksum(file)
        write_document(path, content)
    with pytest.raises(aoabench.UserError, match=r"\.rows\..*schema 9"):
        tables.collect(out)


def test_a_table_of_no_run_has_no_version(tmp_path):
    files.write_frame(tmp_path / "a.parquet", pd.DataFrame({"x": [1.0]}))
    assert b"aoabench_schema" not in pq.read_schema(tmp_path / "a.parquet").metadata
    assert pa.types.is_float64(pq.read_schema(tmp_path / "a.parquet").field("x").type)
