"""Lines of devices: each field against its meaning, whatever stands in front, around and between."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from aoabench.devices.readers.columns import header
from aoabench.devices.readers.live import Live
from aoabench.devices.readers.reading import Reading
from aoabench.devices.readers.stamps import seconds
from aoabench.devices.readers.table import Table
from aoabench.errors import BadValue

LINE = '+UUDF:6C1DEBA3FFAC,-69,16,-7,0,17,"6C1DEBA09949","",4336143,5778'
LINES = [LINE, LINE.replace("49949", "4994A").replace("16,", "-16,").replace("5778", "5779")]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def read(content, path="capture.log", **given):
    Path(path).write_bytes(content if isinstance(content, bytes) else content.encode())
    form = Reading(**given)
    names = header("path", path, form)
    return Table.read("path", path, {name: name for name in names}, form)


# --- u-blox ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
def test_fields_of_a_ublox_line(end, here):
    table = read(end.join(LINES))
    row = table.frame.iloc[0].to_dict()
    assert row == {
        "tag": "6C1DEBA3FFAC", "rssi_dbm": -69, "azimuth_deg": 16, "elevation_deg": -7, "rssi_2_dbm": 0, "channel": 17,
        "anchor": "6C1DEBA09949", "text": "", "anchor_time_s": 4336.143, "sequence": 5778,
    }  # fmt: skip
    assert table.frame["azimuth_deg"].tolist() == [16, -16]
    assert table.stated["azimuth_sense"] == "clockwise"


def test_old_lines_have_no_sequence(here):
    table = read(LINE.rpartition(",")[0] + "\n")
    assert "sequence" not in table.names
    assert table.frame["anchor_time_s"].tolist() == [4336.143]


def test_other_lines_and_torn_ones(here):
    noise = ["+STARTUP", "OK", "", "+UUDFP:6C1DEBA3FFAC,0201061AFF", "AT+UDFENABLE=1"]
    torn = [LINE[:30], LINE.replace(',"', ",", 1), LINE[:20] + LINE]
    table = read("\r\n".join([*noise, LINES[0], *torn, LINES[1]]))
    assert len(table.frame) == 3  # the last torn one holds a whole line
    assert table.at(0, "azimuth_deg") == "line 6 has azimuth_deg=16.0"
    assert table.at(2) == "line 10"
    assert table.notes == ("capture.log: 3 +UUDF lines are cut or garbled, and not read",)


@pytest.mark.parametrize(("before", "time"), [
    ("1715853600.125 ", 1715853600.125), ("1715853600125: ", 1715853600.125), ("[1715853600125000] ", 1715853600.125),
    ("1715853600125000000\t", 1715853600.125), ("2024-05-16T10:00:00.125Z ", 1715853600.125), ("[2024-05-16 10:00:00,125] ", 1715853600.125),
    ("2024-05-16 12:00:00.125+02:00 INFO ", 1715853600.125), ("10:00:00.125 -> ", 36000.125), ("12.5,", 12.5),
    ("192.168.1.20:5000 ", None), ("COM5: ", None), ("", None),
])  # fmt: skip
def test_times_of_the_host(before, time, here):
    table = read("".join(f"{before}{line}\r\n" for line in LINES))
    assert ("time_s" in table.names) == (time is not None)
    if time is not None:
        np.testing.assert_allclose(table.frame["time_s"], time, rtol=0, atol=3e-7)
    assert table.frame["azimuth_deg"].tolist() == [16, -16]


def test_times_of_day_go_on_after_midnight():
    found = seconds(pa.array(["23:59:59.5 ", "00:00:00.5 ", "", "23:59:59.9 ", "00:00:01 "]))
    np.testing.assert_allclose(found, [86399.5, 86400.5, np.nan, 86399.9, 86401.0])


# --- Silicon Labs ---------------------------------------------------------------------------------

PAYLOAD = {"azimuth": 12.5, "azimuth_stdev": 2.1, "elevation": -3.25, "elevation_stdev": -2.5,
           "distance": 3.1, "distance_stdev": 0.0, "sequence": 100}  # fmt: skip
TOPIC = "silabs/aoa/angle/ble-pd-0A0000000100/ble-pd-0B0000000001"


@pytest.mark.parametrize("indent", [None, "\t", 2])
@pytest.mark.parametrize("before", ["", "2024-05-16T10:00:00.125Z "])
def test_fields_of_silicon_labs(indent, before, here):
    text = "".join(
        f"{before}{TOPIC} {json.dumps(PAYLOAD | {'sequence': i}, indent=indent)}\n" for i in (7, 8)
    )
    table = read(text)
    row = table.frame.iloc[1].to_dict()
    if before:
        assert row.pop("time_s") == pytest.approx(1715853600.125, abs=3e-7)
    assert row == {
        "tag": "ble-pd-0B0000000001", "anchor": "ble-pd-0A0000000100", "azimuth_deg": 12.5, "azimuth_sigma_deg": 2.1,
        "elevation_deg": -3.25, "elevation_sigma_deg": -2.5, "range_m": 3.1, "range_sigma_m": 0, "sequence": 8,
    }  # fmt: skip
    assert table.stated["negative_sigma"] == "absent"
    assert table.at(1) == f"line {2 if indent is None else 10}"


@pytest.mark.parametrize("indent", [None, "\t"])
@pytest.mark.parametrize("packed", [dict, json.dumps], ids=["%J", "%j"])
def test_silicon_labs_as_objects_with_the_time_and_the_topic(indent, packed, here):
    """The outer object is on one line, as mosquitto_sub writes it."""
    payload = PAYLOAD if packed is dict else json.dumps(PAYLOAD, indent=indent)
    head = {"tst": "2024-05-16T12:00:00.125000+0200", "topic": TOPIC, "qos": 0, "retain": 0}
    lines = [json.dumps(head | {"payloadlen": 9, "payload": payload}) + "\n"] * 3
    plain = read(f"2024-05-16T10:00:00.125Z {TOPIC} {json.dumps(PAYLOAD)}\n" * 3)
    for text in ("".join(lines), lines[0] + lines[1][:120] + "\n" + lines[2]):
        table = read(text)
        whole = len(table.frame)
        assert whole == 3 - len(table.notes)
        pd.testing.assert_frame_equal(
            table.frame, plain.frame.take([0, 1, 2] if whole == 3 else [0, 2])
        )


def test_other_topics_and_torn_payloads_are_counted(here):
    whole = f"{TOPIC} {json.dumps(PAYLOAD)}\n"
    other = 'silabs/aoa/position/positioning/ble-pd-0B0000000001 {"x": 1, "sequence": 3}\n'
    table = read(whole + other + whole[:90] + "\n" + whole)
    assert len(table.frame) == 2
    assert table.notes == (
        "capture.log: 1 angles without a whole payload, and not read",
        "capture.log: 1 messages of other topics than silabs/aoa/angle, not read",
    )
    with pytest.raises(BadValue, match="mosquitto_sub -v"):
        read(json.dumps(PAYLOAD))


# --- what a file is, and is not -------------------------------------------------------------------


@pytest.mark.parametrize(("text", "words"), [
    ('{"topic": "silabs/aoa/angle/A/B", "payload": {"azimuth": 1}}\n', "mosquitto_sub -v.*1 angles without"),
    (LINE[:-30], r"at least one whole line: \+UUDF:tag.*1 \+UUDF lines are cut"), (f"{TOPIC} {{}}\n", "mosquitto_sub -v"),
])  # fmt: skip
def test_a_log_without_any_whole_line(text, words, here):
    with pytest.raises(BadValue, match=words):
        read(text)


@pytest.mark.parametrize(("text", "declared", "words"), [
    (LINE, "silabs", "look like u-blox lines.*scenario.format=ublox"), (LINE, "table", "look like u-blox lines.*scenario.format=ublox"),
    (f"{TOPIC} {json.dumps(PAYLOAD)}\n", "ublox", "look like Silicon Labs.*scenario.format=silabs"),
    ("fix,anchor\n1,2\n", "ublox", "look like a table: scenario.format=table"),
])  # fmt: skip
def test_a_file_of_another_format_than_declared(text, declared, words, here):
    with pytest.raises(BadValue, match=words):
        read(text, format=declared)


def test_a_declared_format_may_begin_late(here):
    chatter = "OK\r\n" * 40_000
    assert len(read(chatter + LINE, format="ublox").frame) == 1


# --- live -----------------------------------------------------------------------------------------

CSV = "time_s,anchor,azimuth_deg\n" + "".join(f"{i / 8},a{i % 3},{i}.5\n" for i in range(20))
STREAMS = {
    "ublox": "OK\r\n" + "\r\n".join(LINES * 5) + "\r\n",
    "silabs": "".join(f"{TOPIC} {json.dumps(PAYLOAD, indent=1)}\n" for _ in range(6)),
    "silabs %j": "".join(
        json.dumps({"topic": TOPIC, "payload": json.dumps(PAYLOAD, indent="\t")}) + "\n"
        for _ in range(6)
    ),
    "csv": CSV,
    "comments": CSV.replace("1.5\n", "1.5\n# lost the link, 3 times\n"),
    "semicolons": CSV.replace(",", ";").replace(".", ","),
    "preamble": "# made by x\n# version 2\nsep=;\n\n" + CSV.replace(",", ";").replace(".", ","),
    "jsonl": "".join(
        json.dumps({"anchor": f"a{i}", "azimuth_deg": i / 2}) + "\n" for i in range(9)
    ),
    "wide": "fix,azimuth_A,azimuth_B\n" + "".join(f"{i},{i}.5,-{i}.25\n" for i in range(9)),
}


@pytest.mark.parametrize("size", [1, 7, 64, 10_000])
@pytest.mark.parametrize("text", STREAMS.values(), ids=STREAMS)
def test_pieces_make_the_whole(text, size, here):
    whole = read(text)
    chosen = {name: name for name in ("anchor", "azimuth_deg")}
    live, content, frames = Live("path", "-"), text.encode().rstrip(b"\n"), []
    pieces = [content[i : i + size] for i in range(0, len(content), size)]
    for found in (*map(live.feed, pieces), live.end()):
        if found is not None:
            table = Table.piece(found, "path", "-", chosen)
            places = [table.at(i) for i in range(len(table.frame))]
            frames.append(table.frame.assign(place=places))
    together = pd.concat(frames).reset_index(drop=True)
    expected = whole.frame[list(chosen)].assign(
        place=[whole.at(i) for i in range(len(whole.frame))]
    )
    pd.testing.assert_frame_equal(together, expected.reset_index(drop=True), check_dtype=False)


@pytest.mark.parametrize("size", [1, 7])
def test_a_stream_in_a_declared_encoding(size):
    content = "Zeit;Empf\u00e4nger;Winkel (\u00b0)\n1;T\u00fcr;1,5\n2;Tor;2,5\n".encode("cp1252")
    live, found = Live("path", "-", Reading(encoding="cp1252")), []
    for i in range(0, len(content), size):
        if (rows := live.feed(content[i : i + size])) is not None:
            names = {"anchor": "Empf\u00e4nger", "azimuth": "Winkel (\u00b0)"}
            found += rows.cells(names).to_numpy().tolist()
    assert found == [["T\u00fcr", 1.5], ["Tor", 2.5]]
    with pytest.raises(BadValue, match=r"scenario\.encoding=cp1252"):
        Live("path", "-").feed(content)


def test_a_stream_that_is_no_log():
    live = Live("path", "-")
    assert live.feed(b"x" * (1 << 24)) is None
    with pytest.raises(BadValue, match="its lines do not end"):
        live.feed(b"x")


def test_times_of_day_go_on_after_midnight_from_piece_to_piece():
    live, found = Live("path", "-"), []
    for time in ("23:59:59.5", "00:00:00.5", "10:00:00", "20:00:00", "23:59:59", "00:00:01"):
        found.append(live.feed(f"{time} {LINE}\n".encode()).frame["time_s"].iloc[0])
    day = 86400
    np.testing.assert_allclose(
        found, [day - 0.5, day + 0.5, day + 36000, day + 72000, 2 * day - 1, 2 * day + 1]
    )
