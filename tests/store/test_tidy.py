"""The tidy table from an earlier one: the rows of any cells, in any order, read in any pieces."""

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aoabench.columns import REPLICATIONS
from aoabench.store import tidy
from aoabench.store.files import schema

COUNTS = {"a": 3, "b": 1, "c": 4, "d": 2}


def rows(cell, count):
    columns = {name: [None] * count for name in REPLICATIONS}
    columns |= {"cell": [cell] * count, "replication": list(range(count))}
    return pa.table(
        {n: pa.array(v, schema(REPLICATIONS).field(n).type) for n, v in columns.items()}
    )


def written(path, cells, rows_of, earlier):
    """The cell, replication and seed of each row of the table of these cells."""
    frame = pd.DataFrame({"cell": cells, "seed": [ord(cell) for cell in cells]})
    tidy.write(path, frame, [COUNTS[cell] for cell in cells], rows_of, earlier)
    found = pq.read_table(path)
    return list(zip(*(found[name].to_pylist() for name in ("cell", "replication", "seed"))))


@pytest.mark.parametrize(("batch", "later"), [(1, 100), (4, 4), (100, 1)])
@pytest.mark.parametrize("cells", ["abcd", "acd", "dcba", "adbc", "bd", "c"])
def test_rows_come_from_the_earlier_table_where_it_has_them(
    cells, batch, later, tmp_path, monkeypatch
):
    monkeypatch.setattr(tidy, "_BATCH", batch)
    path, asked = tmp_path / "tidy.parquet", []

    def rows_of(cell):
        asked.append(cell)
        return rows(cell, COUNTS[cell])

    expected = [(cell, i, ord(cell)) for cell in cells for i in range(COUNTS[cell])]
    assert written(path, list("abcd"), rows_of, None) == [
        (cell, i, ord(cell)) for cell in "abcd" for i in range(COUNTS[cell])
    ]
    asked.clear()
    monkeypatch.setattr(tidy, "_BATCH", later)
    data = path.read_bytes()
    assert written(path, list(cells), rows_of, tidy.Earlier(data, COUNTS)) == expected
    assert asked == []
    earlier = tidy.Earlier(data, COUNTS)
    del earlier.spans["c"]
    assert written(path, list(cells), rows_of, earlier) == expected
    assert asked == ["c"] * ("c" in cells)


def test_columns_that_an_earlier_version_did_not_write_are_empty(tmp_path):
    path = tmp_path / "tidy.parquet"
    written(path, list("abcd"), lambda cell: rows(cell, COUNTS[cell]), None)
    old = pq.read_table(path).drop_columns(["tag", "reason"])
    pq.write_table(old, path, write_page_checksum=True)
    earlier = tidy.Earlier(path.read_bytes(), COUNTS)
    (first,) = earlier.rows(0, 3)
    assert first.schema.equals(rows("a", 3).schema)
    assert first["replication"].to_pylist() == [0, 1, 2]
    assert first["tag"].null_count == first["reason"].null_count == 3
    earlier.spans.pop("b")
    found = written(path, list("abcd"), lambda cell: rows(cell, COUNTS[cell]), earlier)
    assert [cell for cell, _, _ in found] == list("aaabccccdd")
