"""Files of tables: what they hold, and which of them are compressed."""

import errno
import json
import os
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aoabench.errors import RunError, WriteError
from aoabench.store.documents import read_document, write_document
from aoabench.store.files import file_checksum, read_table, save, write_atomically


def compression(file):
    group = pq.read_metadata(file).row_group(0)
    return {group.column(i).compression for i in range(group.num_columns)}


@pytest.mark.parametrize(("rows", "used"), [(2, "UNCOMPRESSED"), (2000, "ZSTD")])
def test_only_tables_that_become_smaller_are_compressed(tmp_path, rows, used):
    """Compressing and reading some twenty tiny pages costs more than all else about a part."""
    file = tmp_path / "new" / "a.parquet"
    table = pa.table({"number": np.arange(rows), "text": ["ok"] * rows})
    assert save(file, table) == file_checksum(file)
    assert compression(file) == {used}
    assert read_table(file).equals(table)
    assert [f.name for f in file.parent.iterdir()] == ["a.parquet"]


@pytest.mark.parametrize("rows", [2, 2000])
def test_pages_have_checksums(tmp_path, rows):
    """A flipped bit in the values is reported where no other checksum is at hand."""
    file = tmp_path / "a.parquet"
    values = np.random.default_rng(0).standard_normal(rows)
    save(file, pa.table({"value": values}))
    column = pq.read_metadata(file).row_group(0).column(0)
    data = bytearray(file.read_bytes())
    data[column.dictionary_page_offset + column.total_compressed_size // 2] ^= 1
    file.write_bytes(data)
    with pytest.raises(RunError, match="torn or altered"):
        read_table(file)


def test_a_document_is_text_of_one_line_for_each_name(tmp_path):
    content = {"text": 'a "b"\n', "numbers": {"one": [1, 2.5, None]}, "path": tmp_path}
    write_document(tmp_path / "a.json", content)
    text = (tmp_path / "a.json").read_text()
    names = [line.split('"')[1] for line in text.splitlines()[1:-1]]
    assert names == ["format", *content, "checksum"]
    assert json.loads(text)["numbers"] == {"one": [1, 2.5, None]}
    known = {"format": 2, **content, "path": str(tmp_path)}
    assert read_document(tmp_path / "a.json") == known


def test_windows_puts_a_file_in_place_once_its_reader_has_closed_it(tmp_path, monkeypatch):
    target, replace, refused = tmp_path / "table", os.replace, []

    def busy(source, place):
        if len(refused) < 3:
            refused.append(place)
            raise PermissionError(errno.EACCES, "Access is denied", str(source), None, str(place))
        replace(source, place)

    monkeypatch.setattr(os, "replace", busy)
    with pytest.raises(WriteError, match="Permission denied"):
        write_atomically(target, lambda path: path.write_text("new", encoding="utf-8"))
    assert refused == [target]
    monkeypatch.setattr(sys, "platform", "win32")
    write_atomically(target, lambda path: path.write_text("new", encoding="utf-8"))
    assert len(refused) == 3
    assert target.read_text(encoding="utf-8") == "new"
    monkeypatch.setattr("aoabench.store.files._READ_S", 0.0)
    refused.clear()
    with pytest.raises(WriteError, match="Permission denied"):
        write_atomically(target, lambda path: path.write_text("newer", encoding="utf-8"))
    assert [file.name for file in tmp_path.iterdir()] == ["table"]
