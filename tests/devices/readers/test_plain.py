"""Plain rows of a stream: the packets of the ordinary reader, or left to it."""

import numpy as np
import pytest

from aoabench.devices.readers.delimited import delimited, following
from aoabench.devices.readers.plain import plain_rows
from aoabench.devices.readers.reading import AUTO
from aoabench.scenarios.recorded import Recorded

HEAD = "time_s,tag,anchor,azimuth_deg,elevation_deg,sequence"
ROWS = ["0.5, T2 ,A1,1.25,-3e-1,7", "0.75,T10,007,-170.123456789, 4 ,-8", "1,NA,A1,+0.5,.5,9"]


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "anchors.csv").write_text("id,x_m,y_m,facing_deg\nA1,0,0,0\n007,5,0,90\n")
    path = tmp_path / "log.csv"
    path.write_text("\n".join([HEAD, *ROWS]) + "\n")
    return Recorded("recorded", str(path), str(tmp_path / "anchors.csv"))


def piece(rows, end="\n"):
    """Rows of a stream whose header has come before."""
    first = delimited(f"{HEAD}\n{ROWS[0]}\n".encode(), "path", "-", AUTO)
    return following(first, "".join(row + end for row in rows).encode(), 3)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_packets_are_those_of_the_ordinary_reader(scenario, end):
    content = piece(ROWS, end)
    quick, _ = scenario.packets_of(content, "-", quick=True)
    slow, _ = scenario.packets_of(content, "-")
    assert type(quick.table) is not type(slow.table)
    assert (quick.tags, quick.table.count) == (slow.tags, 3) == (("NA", "T2", "T10"), 3)
    for name in ("anchor", "tag", "sequence"):
        assert np.array_equal(getattr(quick, name), getattr(slow, name))
    assert np.allclose(quick.time, slow.time, rtol=0, atol=1e-15)
    assert quick.values.keys() == slow.values.keys()
    for name, value in slow.values.items():
        assert np.allclose(quick.values[name], value, rtol=0, atol=1e-14)


@pytest.mark.parametrize("row", [
    "0.5,T1,A1,,1,1", "0.5,T1,A1,nan,1,1", "0.5,T1,A1,1_0,1,1", "0.5,T1,A1,inf,1,1",
    "0.5,T1,A1,1,1", "0.5,T1,A1,1,1,1,1", '0.5,"T,1",A1,1,1,1', "# 0.5,T1,A1,1,1,1", "",
    "2026-01-01T00:00:00Z,T1,A1,1,1,1", "0.5,,A1,1,1,1", "0.5,T1,A1,\u0661,1,1",
])  # fmt: skip
def test_other_rows_are_left_to_the_ordinary_reader(row):
    names = {ours.partition("_")[0]: ours for ours in HEAD.split(",")}
    assert plain_rows(piece(ROWS[:1]), "path", "-", names) is not None
    assert plain_rows(piece([ROWS[0], row, ROWS[1]]), "path", "-", names) is None


def test_a_mistake_in_plain_rows_is_told_with_its_line(scenario):
    with pytest.raises(Exception, match="line 4 has azimuth_deg=400"):
        scenario.packets_of(piece([ROWS[0], "0.5,T1,A1,400,1,1"]), "-", quick=True)
    with pytest.raises(Exception, match="line 3 has anchor='A9'"):
        scenario.packets_of(piece(["0.5,T1,A9,40,1,1"]), "-", quick=True)


def test_receivers_that_move(tmp_path):
    """The reader of plain rows has no frame of pandas, and others ask it for the number of rows."""
    head = "time_s,anchor_x_m,anchor_y_m,anchor_facing_deg,azimuth_deg"
    rows = [",".join([f"{k}.5", *(str(k + n) for n in range(head.count(",")))]) for k in range(4)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    scenario = Recorded("recorded", str(path), None)
    first = delimited(f"{head}\n{rows[0]}\n".encode(), "path", "-", AUTO)
    content = following(first, "".join(f"{row}\n" for row in rows).encode(), 3)
    quick, _ = scenario.packets_of(content, "-", quick=True)
    slow, _ = scenario.packets_of(content, "-")
    assert type(quick.table) is not type(slow.table)
    assert np.array_equal(quick.anchor, slow.anchor)
    assert quick.values.keys() == slow.values.keys()
    for name, value in slow.values.items():
        assert np.allclose(quick.values[name], value, rtol=0, atol=1e-14, equal_nan=True)
