"""True positions in a file of their own, against numpy.interp and by hand."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aoabench.config.compose import compose_cells
from aoabench.errors import BadValue
from aoabench.scenarios.recorded import Columns, Recorded

NAN = math.nan


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The working folder, with anchors.csv."""
    monkeypatch.chdir(tmp_path)
    Path("anchors.csv").write_text("id,x_m,y_m,z_m\na1,0,0,2\na2,6,0,2\n")


def read(truth, times=(0.0, 1.0, 2.0, 3.0, 4.0), log=None, **changes):
    """A fix at each time, and the truth of a file."""
    rows = "".join(f"{t!r},a1,1\n" for t in times)
    Path("log.csv").write_text("time_s,anchor,azimuth_deg\n" + rows if log is None else log)
    Path("truth.csv").write_text(truth)
    return Recorded("recorded", "log.csv", "anchors.csv", truth_file="truth.csv", **changes)


def positions(*given, **changes):
    return read(*given, **changes).truth(None)


def test_instants_are_interpolated_linearly(rng):
    known = np.sort(rng.uniform(0, 20, 60))
    track = pd.DataFrame(rng.uniform(0, 9, (60, 3)), columns=["x_m", "y_m", "z_m"])
    track.insert(0, "time_s", known)
    text = track.sample(frac=1, random_state=1).to_csv(index=False)
    times = np.sort(rng.uniform(-1, 21, 300))
    found = positions(text, times.tolist(), truth_gap_s=0.4)
    after = np.searchsorted(known, times)
    inside = (after > 0) & (after < len(known))
    gap = np.diff(known)[np.clip(after - 1, 0, len(known) - 2)]
    for axis, name in enumerate(("x_m", "y_m", "z_m")):
        wanted = np.interp(times, known, track[name])
        wanted[~inside | (gap > 0.4)] = NAN
        np.testing.assert_allclose(found[:, axis], wanted, rtol=0, atol=1e-12)
    assert 0.2 < np.isfinite(found[:, 0]).mean() < 0.95


def test_the_largest_gap_is_inclusive_and_an_instant_counts_across_no_gap():
    text = "time_s,x_m,y_m\n0,0,0\n1,2,4\n3,6,8\n"
    found = positions(text, (0.5, 1.0, 2.0, 3.0, 3.1))
    np.testing.assert_allclose(found[:, 0], [1, 2, NAN, 6, NAN])
    np.testing.assert_allclose(positions(text, (2.0,), truth_gap_s=2)[0, :2], [4, 6])


def test_a_place_that_stays_is_known_across_a_gap():
    text = "time_s,x_m,y_m\n0,3,3\n60,3,3\n120,9,9\n"
    found = positions(text, (30.0, 90.0))
    np.testing.assert_allclose(found[:, 0], [3, NAN])
    s = read(text, (30.0, 90.0))
    assert any("true positions at 1 of 2 rows" in line for line in s.notes)


def test_true_positions_come_from_one_place():
    log = "time_s,anchor,azimuth_deg,x_m,y_m\n0,a1,1,3,4\n"
    with pytest.raises(
        BadValue, match=r"truth='truth\.csv' .*positions of its own; it has x_m, y_m"
    ):
        read("time_s,x_m,y_m\n0,1,1\n", log=log)


def test_truth_in_degrees_needs_an_origin():
    text = "time_s,latitude,longitude\n0,60.0001,24.0002\n4,60.0001,24.0002\n"
    with pytest.raises(BadValue, match=r"origin_deg=None .*truth\.csv is in degrees"):
        read(text)
    found = positions(text, origin_deg=[60.0, 24.0])
    np.testing.assert_allclose(found[:, :2], np.tile([11.16, 11.14], (5, 1)), atol=0.01)
    assert np.isnan(found[:, 2]).all()


def test_a_gpx_track_is_that_of_a_table_without_its_heights():
    lat, lon = 60.00003, 24.00005
    steps = [(lat, lon, 0), (lat + 1e-5, lon, 2), (lat, lon - 2e-5, 4)]
    days = [f"2026-03-01T12:00:0{t}Z" for _, _, t in steps]
    text = "time,lat_deg,lon_deg\n" + "".join(
        f"{day},{a!r},{b!r}\n" for (a, b, _), day in zip(steps, days)
    )
    gpx = '<?xml version="1.0"?>\n<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
    for (a, b, _), day in zip(steps, days):
        gpx += f'<trkpt lat="{a!r}" lon="{b!r}"><ele>40</ele><time>{day}</time></trkpt>'
    log = "time_s,anchor,azimuth_deg\n" + "".join(
        f"2026-03-01T12:00:0{t}Z,a1,1\n" for t in range(5)
    )
    given = {"log": log, "origin_deg": [60.0, 24.0], "truth_gap_s": 2}
    found = read(gpx + "</trkseg></trk></gpx>", **given)
    assert "truth.csv: heights (ele) are not read, because they count from the sea" in found.notes
    np.testing.assert_array_equal(found.truth(None), positions(text, **given))
    assert np.isfinite(found.truth(None)[:, :2]).all()
    assert np.isnan(found.truth(None)[:, 2]).all()


def test_truth_in_degrees_in_the_log_is_that_of_a_file():
    log = "time_s,anchor,azimuth_deg,truth_lat_deg,truth_lon_deg,truth_height_m\n"
    log += "0,a1,1,60.0001,24.0002,1.5\n1,a1,1,60.0003,24.0001,\n2,a1,1,,,\n"
    Path("log.csv").write_text(log)
    origin = {"origin_deg": [60.0, 24.0]}
    found = Recorded("recorded", "log.csv", "anchors.csv", **origin).truth(None)
    text = "time_s,latitude,longitude,height_m\n0,60.0001,24.0002,1.5\n1,60.0003,24.0001,\n"
    wanted = positions(text, (0.0, 1.0, 2.0), **origin)
    np.testing.assert_array_equal(found, wanted)
    assert np.isfinite(found[0]).all()
    Path("log.csv").write_text(log)
    with pytest.raises(BadValue, match=r"origin_deg=None .*log\.csv is in degrees"):
        Recorded("recorded", "log.csv", "anchors.csv")


@pytest.mark.parametrize(("log", "words"), [
    ("truth_lat_deg,height\n0,a1,1,60,1\n", r"columns\.truth_lon=None .*truth_lon_deg, because .* has truth_lat_deg"),
    ("truth_height_m\n0,a1,1,60\n", r"columns\.truth_lat=None"),
    ("x_m,y_m,truth_lat_deg,truth_lon_deg\n0,a1,1,2,2,60,24\n", r"one of x_m and truth_lat_deg; .* has both"),
    ("truth_lat_deg,truth_lon_deg\n0,a1,1,24,160\n", r"log\.csv"),
])  # fmt: skip
def test_truth_in_degrees_in_the_log_that_is_wrong(log, words):
    Path("log.csv").write_text(f"time_s,anchor,azimuth_deg,{log}")
    with pytest.raises(BadValue, match=words):
        Recorded("recorded", "log.csv", "anchors.csv", origin_deg=[60.0, 24.0])


def test_marks_are_numbered():
    text = "start_s,end_s,x_m,y_m\n0,1,3,2\n2,2.5,5,6\n3,4,3,2\n"
    assert list(read(text).marks) == [0, 0, 1, 0, 0]
    assert list(read(text, (0.0, 1.5, 2.1)).marks) == [0, -1, 1]


def test_packets_of_a_window_are_averaged():
    text = "time_s,x_m,y_m\n0,0,0\n1,10,0\n"
    log = "time_s,anchor,azimuth_deg\n0.1,a1,1\n0.3,a2,1\n"
    s = read(text, log=log, window_s=0.5)
    np.testing.assert_allclose(s.truth(None)[:, 0], [2])
    np.testing.assert_allclose(s.tracks.time, [0.2])


def test_the_clock_of_the_truth_may_be_shifted_and_in_other_units():
    text = "timestamp_ms,X_cm,Y_cm\n1000,100,200\n2000,300,200\n"
    np.testing.assert_allclose(positions(text, (1.5,))[0], [2, 2, NAN])
    np.testing.assert_allclose(positions(text, (11.5,), truth_offset_s=10)[0], [2, 2, NAN])
    with pytest.raises(BadValue, match=r"it has times from 1 to 2 s, the log has times from 11\.5"):
        read(text, (11.5,))


def test_dates_on_both_sides():
    log = "time_s,anchor,azimuth_deg\n2024-05-01T12:00:00.5Z,a1,1\n"
    text = "time,x,y\n2024-05-01T14:00:00+02:00,1,2\n2024-05-01T14:00:01+02:00,3,2\n"
    np.testing.assert_allclose(positions(text, log=log)[0], [2, 2, NAN])


def test_marks_hold_from_start_to_end():
    text = "start_s,end_s,x_cm,y_cm,z_cm\n2,3,500,600,100\n0,1,300,200,100\n"
    found = positions(text, (0.0, 0.5, 1.0, 1.5, 2.5, 3.5))
    np.testing.assert_allclose(found[:, 0], [3, 3, 3, NAN, 5, NAN])
    np.testing.assert_array_equal(found[:2, 2], 1.0)
    with pytest.raises(BadValue, match=r"an end after its start; line 2 has end_s=1"):
        read("start_s,end_s,x,y\n2,1,5,6\n")


def test_marks_may_be_instants():
    text = "start,end,x,y\n0,,0,0\n1,,4,0\n2,3,9,9\n"
    found = positions(text, (0.5, 1.0, 2.5))
    np.testing.assert_allclose(found[:, 0], [2, 4, 9])


def test_truth_of_each_tag():
    log = "time_s,tag,anchor,azimuth_deg\n0,p,a1,1\n0,q,a1,1\n0,r,a1,1\n"
    text = "time_s,tag,x_m,y_m\n0,q,1,1\n0,p,2,2\n1,q,5,5\n1,p,5,5\n"
    s = read(text, log=log)
    np.testing.assert_allclose(s.truth(None)[:, 0], [2, 1, NAN])


@pytest.mark.parametrize("column", ["fix", "sequence"])
def test_truth_of_numbered_fixes(column):
    log = f"{column},anchor,azimuth_deg\n10,a1,1\n9,a1,1\n11,a1,1\n"
    found = positions(f"{column},x_m,y_m\n9,1,2\n10,3,4\n", log=log)
    np.testing.assert_allclose(found[:, 0], [1, 3, NAN])
    with pytest.raises(BadValue, match="no fix of the log occurs in it"):
        read(f"{column},x_m,y_m\n90,1,2\n", log=log)
    with pytest.raises(BadValue, match="with the column fix or sequence"):
        read("time_s,x_m,y_m\n90,1,2\n", log=log)


@pytest.mark.parametrize(("text", "words"), [
    ("time_s,x_m\n0,1\n", ["x_m, y_m", "it has time_s, x_m"]),
    ("x_m,y_m,when\n0,1,2\n", ["time_s", "start_s", "it has x_m, y_m, when"]),
    ("time_s,time_ms,x_m,y_m\n0,0,1,1\n", ["which is time?"]),
    ("time_s,x_m,y_m\n0,1,\n", ["at least one true position"]),
    ("time_s,x_m,y_m\n0,1,a\n", ["line 2 has y_m='a'"]),
    ("time_s,x_m,y_m\n1780000000000,1,1\n", ["milliseconds", "line 2"]),
])  # fmt: skip
def test_mistakes_name_the_file_and_the_row(text, words):
    with pytest.raises(BadValue) as error:
        read(text)
    for word in ("truth='truth.csv'", *words):
        assert word in str(error.value), str(error.value)


def test_the_key_in_a_config_is_truth():
    log = "time_s,anchor,azimuth_deg,elevation_deg\n0,a1,3,-20\n0,a2,3,-20\n"
    read("time_s,x_m,y_m\n0,1,1\n", log=log)
    words = ["scenario=recorded", "scenario.path=log.csv", "scenario.anchors=anchors.csv"]
    (cell,) = compose_cells(
        [*words, "scenario.truth=truth.csv", "estimator=[anchor_mean]", "scenario.height_m=1"]
    )
    assert cell.scenario.truth_file == "truth.csv"
    assert [file.path.name for file in cell.scenario.files] == [
        "anchors.csv",
        "log.csv",
        "truth.csv",
    ]
    with pytest.raises(BadValue, match=r"scenario\.truth='7' "):
        compose_cells([*words, "scenario.truth=7", "estimator=[anchor_mean]"])


def test_columns_have_the_names_that_the_log_declares():
    log = "Zeit,Geraet,anchor,azimuth_deg\n0,T1,a1,1\n1,T1,a1,1\n1,T2,a1,1\n"
    declared = Columns(time="Zeit", tag="Geraet")
    truth = "Zeit,Geraet,x_m,y_m\n0,T1,1,2\n1,T1,3,4\n1,T2,5,6\n"
    s = read(truth, log=log, columns=declared)
    np.testing.assert_allclose(s.truth(None)[:, :2], [[1, 2], [3, 4], [5, 6]])
    again = read(truth.replace("Zeit,Geraet", "time_s,tag"), log=log, columns=declared)
    np.testing.assert_array_equal(again.truth(None), s.truth(None))
    with pytest.raises(BadValue, match="or with the log's names of these columns; it has Uhr, "):
        read(truth.replace("Zeit", "Uhr"), log=log, columns=declared)
