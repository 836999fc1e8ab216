"""Files of tables: what they hold, and which of them are compressed."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aoabench.errors import RunError
from aoabench.store.documents import read_document, write_document
from aoabench.store.files import file_checksum, read_table, save


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
