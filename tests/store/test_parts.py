"""Parts: what their checksum files vouch for, and what is missing of a range."""

import json
import os
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aoabench.store import parts as parts_module
from aoabench.store.documents import read_document, write_document
from aoabench.store.files import file_checksum
from aoabench.store.parts import examined, has_part, intact_parts, missing_ranges
from tests.store import made

pieces = st.lists(
    st.tuples(st.integers(0, 60), st.integers(1, 25)).map(lambda p: (p[0], p[0] + p[1])),
    max_size=8,
)


@given(pieces, st.integers(0, 60))
def test_gaps_and_pieces_make_the_whole_and_do_not_meet(done, reps):
    gaps = missing_ranges(done, reps)
    covered = {i for start, stop in done for i in range(start, stop)}
    missing = [i for start, stop in gaps for i in range(start, stop)]
    assert missing == sorted(set(range(reps)) - covered)
    assert all(start < stop for start, stop in gaps)
    assert all(before[1] < after[0] for before, after in pairwise(gaps))


@pytest.fixture
def stored(tmp_path):
    """A folder with the part 0-3 of `key`, which has rows and fixes; and its checksum file."""
    made.part(tmp_path, "key", 0, 3, fixes=2, machine={"blas": "Haswell"})
    return tmp_path, tmp_path / "parts" / "key" / "000000000-000000003.json"


def as_format_1(file):
    """Rewrite a checksum file as earlier versions wrote it."""
    kinds = read_document(file)["kinds"]
    file.write_text(json.dumps({kind: [k["file"], k["checksum"]] for kind, k in kinds.items()}))


def assert_refused(out, key, file):
    """Neither reused nor read, and set aside once."""
    assert not intact_parts(out, key)
    assert not has_part(out, key, *(int(n) for n in file.stem.split("-")))
    assert examined(out, key) == ([], [file.with_name(f"{file.name}.damaged")])
    assert examined(out, key) == ([], [])


def test_a_part_names_its_files_and_machine(stored):
    out, _ = stored
    (part,) = intact_parts(out, "key")
    assert (part.start, part.stop, part.machine) == (0, 3, {"blas": "Haswell"})
    assert set(part.files) == {"rows", "fixes"}
    assert intact_parts(out, "key", "fixes") == [part]
    assert intact_parts(out, "key", "steps") == []
    made.part(out, "other", 0, 3)
    assert intact_parts(out, "other")[0].machine is None


@pytest.mark.parametrize("earlier", [False, True])
def test_a_part_under_another_span_is_refused(stored, earlier):
    out, file = stored
    if earlier:
        as_format_1(file)
    assert_refused(out, "key", file.rename(file.with_name("000000003-000000006.json")))


def test_a_part_under_another_key_is_refused(stored):
    out, file = stored
    file.parent.rename(out / "parts" / "another")
    assert_refused(out, "another", out / "parts" / "another" / file.name)


@pytest.mark.parametrize("earlier", [False, True])
def test_a_part_whose_kind_is_altered_is_refused(stored, earlier):
    out, file = stored
    if earlier:
        as_format_1(file)
        assert len(intact_parts(out, "key", "fixes")) == 1
    text = file.read_text()
    file.write_text(text.replace("fixes", "fixew"))
    (fixes,) = file.parent.glob("*.fixes.*")
    fixes.rename(fixes.with_name(fixes.name.replace("fixes", "fixew")))
    assert_refused(out, "key", file)


def test_a_part_without_one_of_its_kinds_or_with_other_rows_is_refused(stored):
    out, file = stored
    text = file.read_text()
    for change in (
        lambda content: content["kinds"].pop("fixes"),
        lambda content: content["kinds"]["rows"].update(rows=4),
        lambda content: content.update(machine={"blas": "Prescott"}),
        lambda content: content.pop("checksum"),
        lambda content: content.pop("format"),
    ):
        content = json.loads(text)
        change(content)
        file.write_text(json.dumps(content))
        assert_refused(out, "key", file)


@pytest.mark.parametrize("change", [
    lambda content: content["kinds"].update(fixew=content["kinds"].pop("fixes")),
    lambda content: content["kinds"]["rows"].update(rows=4),
    lambda content: content["kinds"].pop("rows"),
])  # fmt: skip
def test_a_checksum_file_that_contradicts_itself_is_refused(change, stored):
    out, file = stored
    content = read_document(file)
    change(content)
    write_document(file, content)
    assert_refused(out, "key", file)


@pytest.mark.parametrize("earlier", [False, True])
def test_a_part_whose_file_is_altered_is_refused(earlier, stored):
    out, file = stored
    if earlier:
        as_format_1(file)
    (rows,) = file.parent.glob("*.rows.*")
    rows.write_bytes(rows.read_bytes()[:-1] + b"2")
    assert_refused(out, "key", file)


def test_a_document_without_its_checksum_is_refused(tmp_path):
    file = tmp_path / "a.json"
    write_document(file, {"a": 1})
    assert read_document(file) == {"format": 2, "a": 1}
    for text in ('{"format": 2, "a": 1}', file.read_text().replace("format", "fprmat"), "[1]", ""):
        file.write_text(text)
        with pytest.raises(ValueError, match=r"match|object|Expecting"):
            read_document(file)
    file.write_text('{"a": 1}')
    assert read_document(file) == {"a": 1}, "of an earlier version"


def test_a_part_of_an_earlier_version_with_too_few_rows_is_refused(stored):
    """Its checksum file vouches for the file, which has the rows of another part."""
    out, file = stored
    made.part(out, "short", 0, 2)
    (short,) = intact_parts(out, "short")
    as_format_1(file)
    (part,) = intact_parts(out, "key")
    part.files["rows"].write_bytes(short.files["rows"].read_bytes())
    named = json.loads(file.read_text())
    named["rows"][1] = file_checksum(part.files["rows"])
    file.write_text(json.dumps(named))
    assert_refused(out, "key", file)


def test_no_byte_of_a_checksum_file_is_unguarded(stored):
    """Each byte with one bit flipped, each bit in turn: refused, or the same part."""
    out, file = stored
    data = file.read_bytes()
    (part,) = intact_parts(out, "key")
    for i in range(len(data)):
        file.write_bytes(data[:i] + bytes([data[i] ^ 1 << i % 8]) + data[i + 1 :])
        assert intact_parts(out, "key") in ([], [part])


@pytest.fixture
def hashed(monkeypatch):
    """The names of the files whose content was compared with a checksum."""
    names, checksum = [], parts_module.file_checksum
    monkeypatch.setattr(
        parts_module, "file_checksum", lambda path: names.append(path.name) or checksum(path)
    )
    return names


def test_a_part_is_verified_again_only_if_a_file_of_it_has_changed(tmp_path, monkeypatch, hashed):
    monkeypatch.setattr(parts_module, "_SETTLED_NS", -(10**18))
    made.part(tmp_path, "key", 0, 4, fixes=2)
    (part,) = intact_parts(tmp_path, "key")
    assert len(hashed) == 2
    assert intact_parts(tmp_path, "key", "fixes") == [part]
    assert examined(tmp_path, "key") == ([part], [])
    assert has_part(tmp_path, "key", 0, 4)
    assert len(hashed) == 2
    file, data = part.files["fixes"], part.files["fixes"].read_bytes()
    before = file.stat()
    file.write_bytes(data[:100] + bytes([data[100] ^ 1]) + data[101:])
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert (file.stat().st_size, file.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    assert not intact_parts(tmp_path, "key")
    file.write_bytes(data)
    assert intact_parts(tmp_path, "key") == [part]
    part.files["rows"].unlink()
    assert not intact_parts(tmp_path, "key")
    made.part(tmp_path, "key", 0, 4)  # computed again, under other names
    (again,) = intact_parts(tmp_path, "key")
    assert again != part
    part.files["fixes"].unlink()
    assert intact_parts(tmp_path, "key") == [again]


def test_a_part_that_was_just_written_is_verified_each_time(tmp_path, hashed):
    """A change within one tick of the file system's clock shows in no time."""
    made.part(tmp_path, "key", 0, 4)
    assert intact_parts(tmp_path, "key") == intact_parts(tmp_path, "key") != []
    assert len(hashed) == 2
