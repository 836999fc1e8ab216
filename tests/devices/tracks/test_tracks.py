"""Fixes and tracks from packets: windows, sequence numbers, clocks, tags, silences, and several
packets of an anchor in a fix. Oracles are slow plain rewrites and laws: the order of rows does not
matter, and tags overlaid in one log give the tracks of their own logs.
"""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from aoabench.errors import BadValue
from aoabench.maths.geometry import LIGHT
from aoabench.models.motion import RandomWalk
from aoabench.scenarios.recorded import Columns, Recorded

ANCHORS = "id,x_m,y_m,z_m,facing_deg\na1,0,0,2,0\na2,6,0,2,90\na3,6,6,2,-135\n"
NAN = math.nan


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """The working folder, with anchors.csv."""
    monkeypatch.chdir(tmp_path)
    Path("anchors.csv").write_text(ANCHORS)


def read(log, anchors="anchors.csv", path="log.csv", **changes):
    if isinstance(log, pd.DataFrame):
        log.to_csv(path, index=False)
    else:
        Path(path).write_text(log)
    return Recorded("recorded", path, anchors, **changes)


def azimuths(s):
    return np.rad2deg(s.recorded.azimuth)


def same(first, second):
    """Whether tracks are equal, bit for bit."""
    assert first.tags == second.tags
    np.testing.assert_array_equal(first.counts, second.counts)
    for name in ("time", "fix", "truth", "packets", "columns"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=name)
    for name, array in first.measured.arrays.items():
        np.testing.assert_array_equal(array, second.measured.arrays[name], err_msg=name)


def walk(rng, tag, events=40, packets=1, late_s=0.05):
    """A log of a tag: at each event every anchor gives some packets, or none."""
    rows = []
    for k in range(events):
        for anchor in ("a1", "a2", "a3"):
            for _ in range(packets if rng.random() > 0.2 else 0):
                angles = rng.uniform(-170, 170), rng.uniform(-80, 0)
                at = 10 + 0.5 * k + rng.uniform(0, late_s)
                rows.append([at, k, tag, anchor, *angles, k / 7, k / 3])
    names = ["time_s", "sequence", "tag", "anchor", "azimuth_deg", "elevation_deg", "x_m", "y_m"]
    return pd.DataFrame(rows, columns=names)


# --- a slow plain grouping, and hypothesis -------------------------------------------------------

ROWS = st.lists(
    st.tuples(
        st.integers(0, 400), st.sampled_from(["p", "q"]), st.sampled_from(["a1", "a2", "a3"]),
        st.integers(-170, 170),
    ),
    min_size=1, max_size=40,
)  # fmt: skip


def slow(rows, windows, window, combine):
    """Tag, number of packets, mean time, and per anchor the combined azimuth, of each fix."""
    found = []
    for tag in sorted({row[1] for row in rows}):
        fixes = []
        for t, _, anchor, azimuth in sorted(row for row in rows if row[1] == tag):
            new = not fixes
            if fixes and windows == "grid":
                new = t // window != fixes[-1][-1][0] // window
            elif fixes:
                new = t - fixes[-1][0 if windows == "first" else -1][0] > window
            if new:
                fixes.append([])
            fixes[-1].append((t, anchor, azimuth))
        for fix in fixes:
            each = {}
            for anchor in ("a1", "a2", "a3"):
                mine = sorted((t, azimuth) for t, other, azimuth in fix if other == anchor)
                if mine:
                    each[anchor] = mine[0 if combine == "first" else -1][1]
            found.append((tag, len(fix), np.mean([t for t, _, _ in fix]) / 10, each))
    return found


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    rows=ROWS,
    windows=st.sampled_from(["first", "grid", "chained"]),
    window=st.sampled_from([1, 3, 25]),
    combine=st.sampled_from(["first", "last"]),
    seed=st.integers(0, 9),
)
def test_grouping_against_a_slow_plain_one(rows, windows, window, combine, seed):
    names = ["time_s", "tag", "anchor", "azimuth_deg"]
    log = pd.DataFrame([(t / 10, *rest) for t, *rest in rows], columns=names)
    grouping = {"window_s": window / 10, "windows": windows, "combine": combine}
    t = read(log.sample(frac=1, random_state=seed), **grouping).tracks
    tags = np.repeat(np.array(t.tags, dtype=object), t.counts)
    expected = slow(rows, windows, window, combine)
    assert list(zip(tags, t.packets)) == [one[:2] for one in expected]
    np.testing.assert_allclose(t.time, [one[2] for one in expected], atol=1e-9)
    wanted = [[each.get(a, NAN) for a in ("a1", "a2", "a3")] for *_, each in expected]
    np.testing.assert_allclose(np.rad2deg(t.measured.azimuth), wanted, atol=1e-9)


# --- windows --------------------------------------------------------------------------------------

TIMES = "time_s,anchor,azimuth_deg\n0.4,a1,1\n0.9,a2,2\n1.3,a3,3\n1.6,a1,4\n2.9,a2,5\n"


@pytest.mark.parametrize(("windows", "expected"), [
    ("first", [[1, 2, 3], [4, NAN, NAN], [NAN, 5, NAN]]),
    ("grid", [[1, 2, NAN], [4, NAN, 3], [NAN, 5, NAN]]),
])  # fmt: skip
def test_windows(windows, expected):
    np.testing.assert_allclose(azimuths(read(TIMES, window_s=1, windows=windows)), expected)


def test_a_chain_goes_on_while_gaps_are_short():
    s = read(TIMES.replace("1.6,a1", "1.6,a2"), window_s=0.5, windows="chained", combine="last")
    np.testing.assert_allclose(azimuths(s), [[1, 4, 3], [NAN, 5, NAN]])
    np.testing.assert_allclose(s.tracks.time, [np.mean([0.4, 0.9, 1.3, 1.6]), 2.9])
    assert list(s.tracks.packets) == [4, 1]


@pytest.mark.parametrize("windows", ["first", "chained"])
@pytest.mark.parametrize("start", [0.0, 1.78e9])
def test_windows_against_a_plain_loop(rng, windows, start):
    """Times on a grid of 0.1 s, so that many lie on the edge of a window."""
    time = np.sort(rng.choice(np.arange(300) / 10, 120, replace=False)) + start
    expected, first, last = [], -math.inf, -math.inf
    for t in time:
        if t - (first if windows == "first" else last) > 0.3 + 1e-4:
            expected.append([])
            first = t
        last = t
        expected[-1].append(t - start)
    log = pd.DataFrame({"time_s": time, "anchor": "a1", "azimuth_deg": 1.0})
    s = read(log, window_s=0.3, windows=windows, combine="mean")
    assert list(s.tracks.packets) == [len(one) for one in expected]
    np.testing.assert_allclose(s.tracks.time - start, [np.mean(o) for o in expected], atol=1e-5)


def test_windows_need_times():
    with pytest.raises(BadValue, match=r"window_s=0\.1 .*sequence numbers make the fixes"):
        read("sequence,anchor,azimuth_deg\n1,a1,2\n", window_s=0.1)


# --- tags and rows --------------------------------------------------------------------------------

LAWS = [
    {"window_s": 0.2},
    {"window_s": 0.2, "combine": "mean"},
    {"window_s": 0.5, "windows": "grid", "combine": "median"},
    {"window_s": 0.2, "windows": "chained", "combine": "each"},
    {"combine": "mean"},
    {"gap_s": 0.7, "combine": "each"},
]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_order_of_rows_does_not_matter(rng, law):
    packets = 3 if "combine" in law else 1
    log = pd.concat([walk(rng, tag, packets=packets) for tag in ("T2", "T10")])
    first = read(log, **law).tracks
    assert set(first.tags) == {"T2", "T10"}
    for seed in range(3):
        same(first, read(log.sample(frac=1, random_state=seed), **law).tracks)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_tags_overlaid_are_the_tracks_of_their_own_logs(rng, law):
    packets = 3 if "combine" in law else 1
    logs = {tag: walk(rng, tag, packets=packets) for tag in ("T2", "T10", "a")}
    both = pd.concat(logs.values()).sample(frac=1, random_state=1)
    together = read(both, **law).tracks
    start = 0
    for tag in sorted(logs, key=lambda tag: ("a", "T2", "T10").index(tag)):
        alone = read(logs[tag], **law).tracks
        fixes = slice(start, start + len(alone.time))
        start = fixes.stop
        one = read(both, tags=[tag], **law).tracks
        same(alone, one)
        np.testing.assert_array_equal(together.time[fixes], alone.time)
        np.testing.assert_array_equal(together.fix[fixes], alone.fix)
        np.testing.assert_array_equal(together.truth[fixes], alone.truth)
        for anchor in range(3):
            mine, other = together.columns == anchor, alone.columns == anchor
            found = together.measured.azimuth[fixes][:, mine]
            wanted = alone.measured.azimuth[:, other]
            np.testing.assert_array_equal(found[:, : wanted.shape[1]], wanted)
            assert np.isnan(found[:, wanted.shape[1] :]).all()
    assert start == len(together.time)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_log_may_be_split_into_files(rng, law):
    """By rows, or one file an anchor without a column of anchors."""
    packets = 3 if "combine" in law else 1
    log = pd.concat([walk(rng, tag, packets=packets) for tag in ("T2", "T10")])
    whole = read(log, **law)
    log.iloc[:50].to_csv("part_1.csv", index=False)
    log.iloc[50:].to_parquet("part_2.parquet")
    same(
        whole.tracks,
        Recorded("recorded", ["part_2.parquet", "part_1.csv"], "anchors.csv", **law).tracks,
    )
    same(whole.tracks, Recorded("recorded", "part_*", "anchors.csv", **law).tracks)
    for anchor, rows in log.groupby("anchor"):
        rows.drop(columns="anchor").to_csv(f"{anchor}.csv", index=False)
    s = Recorded("recorded", "a?.csv", "anchors.csv", **law)
    same(whole.tracks, s.tracks)
    assert len(s.files) == 4


def test_each_file_may_be_a_tag():
    for name in ("walk_10", "walk_2"):
        Path(f"{name}.csv").write_text("time_s,anchor,azimuth_deg\n0,a1,1\n0,a2,2\n")
    s = Recorded("recorded", "walk_*.csv", "anchors.csv", columns=Columns(tag="file"))
    assert s.tracks.tags == ("walk_2", "walk_10")


def test_tracks_are_in_natural_order_of_tags():
    rows = "".join(f"{t},{tag},a1,3\n" for t, tag in enumerate(["T10", "T2", "b", "A"]))
    s = read("time_s,tag,anchor,azimuth_deg\n" + rows)
    assert s.tracks.tags == ("A", "b", "T2", "T10")
    assert s.replications == 4
    assert s.notes[0].startswith("log.csv: 4 fixes in 4 tracks of 4 tags, 0 with ground truth")


def test_tags_are_chosen_by_name():
    log = "time_s,tag,anchor,azimuth_deg\n0,T1,a1,1\n0,007,a1,2\n"
    np.testing.assert_allclose(azimuths(read(log, tags=["007"])), [[2, NAN, NAN]])
    with pytest.raises(BadValue, match=r"tags=\['T11'\].*007, T1; did you mean 'T1'"):
        read(log, tags=["T11"])
    with pytest.raises(BadValue, match=r"no tags; scenario\.columns\.tag"):
        read(log.replace("tag", "hue"), tags=["T1"])


def test_a_silence_starts_a_track():
    log = "time_s,anchor,azimuth_deg\n" + "".join(f"{t},a1,1\n" for t in (0, 1, 3, 4, 9))
    assert list(read(log).tracks.counts) == [5]
    s = read(log, gap_s=1.5)
    assert list(s.tracks.counts) == [2, 2, 1]
    assert list(s.tracks.fix) == list("01234")
    assert list(read(log, gap_s=2).tracks.counts) == [4, 1]
    with pytest.raises(BadValue, match=r"gap_s=1 .*without the time"):
        read("fix,anchor,azimuth_deg\n1,a1,2\n", gap_s=1)


# --- identities that nobody reads -----------------------------------------------------------------

TWO = "time_s,{},anchor,azimuth_deg\n0,p,a1,1\n0,q,a2,2\n1,q,a1,3\n"


@pytest.mark.parametrize("name", ["mac", "Tag_ID", "deviceId", "Beacon", "ed_instance_id"])
def test_two_identities_in_a_fix_are_refused(name):
    with pytest.raises(BadValue) as error:
        read(TWO.format(name))
    for word in (
        "columns.tag=None",
        f"{name} of log.csv",
        f"line 2 has {name}='p'",
        f"scenario.columns.tag={name}",
    ):
        assert word in str(error.value)
    s = read(TWO.format(name), columns=Columns(tag=name))
    assert s.tracks.tags == ("p", "q")
    np.testing.assert_array_equal(s.tracks.counts, [1, 2])


def test_two_identities_with_anchors_of_their_own_are_refused():
    log = "sequence,mac,anchor,azimuth_deg\n0,p,a1,1\n0,p,a2,2\n0,q,a3,3\n"
    with pytest.raises(BadValue, match=r"scenario\.columns\.tag=mac"):
        read(log)


def test_an_identity_of_several_fixes_is_noted():
    s = read(TWO.format("mac").replace("0,q", "2,q"))
    assert any(
        "mac has 2 values" in line and "scenario.columns.tag=mac" in line for line in s.notes
    )
    s = read(TWO.format("packet_id"))
    assert any("packet_id differs within a fix" in line for line in s.notes)


@pytest.mark.parametrize("log", [
    TWO.format("mac").replace("q", "p"),
    TWO.format("quality"),
    "time_s,device,anchor,azimuth_deg\n0,p,a1,1\n0,q,a2,2\n1,p,a1,3\n1,q,a2,3\n",  # the anchor's
])  # fmt: skip
def test_what_is_no_identity(log):
    assert not any("scenario.columns.tag" in line for line in read(log).notes)


# --- sequence numbers and clocks ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "times", "said"),
    [
        ([65534, 65535, 0, 1], False, True),
        ([7, 8, 9, 10], False, False),
        ([65534, 65535, 0, 1], True, False),
    ],
)
def test_numbers_that_overflow_without_times_are_said(numbers, times, said):
    rows = [(n, f"a{b}", 10 * b, k) for k, n in enumerate(numbers) for b in (1, 2)]
    log = pd.DataFrame(rows, columns=["sequence", "anchor", "azimuth_deg", "time_s"])
    s = read((log if times else log.drop(columns="time_s")).to_csv(index=False))
    words = "no number is between 1 and 65534, as after an overflow"
    assert any(words in note for note in s.notes) == said
    assert list(s.tracks.fix.astype(int)) == (numbers if times else sorted(numbers))


def test_sequence_numbers_make_fixes_in_their_order():
    s = read("sequence,anchor,azimuth_deg\n10,a1,1\n9,a2,2\n10,a2,3\n9,a1,4\n")
    np.testing.assert_allclose(azimuths(s), [[4, 2, NAN], [1, 3, NAN]])
    assert list(s.tracks.fix) == ["9", "10"]
    assert np.isnan(s.tracks.time).all()
    with pytest.raises(BadValue, match=r"whole numbers in sequence; line 2 has sequence=1\.5"):
        read("sequence,anchor,azimuth_deg\n1.5,a1,1\n")


def boots(rng, offsets, drift=(0, 0, 0), events=600, modulo=256):
    """A log of an 8-bit counter, seen by anchors with clocks of their own, and its true times."""
    rows = []
    for k in range(events):
        for j, (offset, rate) in enumerate(zip(offsets, drift)):
            if rng.random() < 0.7:
                at = 0.1 * k + rng.normal(0, 0.002)
                rows.append([at * (1 + rate) + offset, k % modulo, f"a{j + 1}", 0.1 * k])
    log = pd.DataFrame(rows, columns=["anchor_time_s", "sequence", "anchor", "azimuth_deg"])
    heard = log["azimuth_deg"].nunique()
    return log.assign(azimuth_deg=log["azimuth_deg"]), heard


@pytest.mark.parametrize("offsets", [(0, 51.3, -2000.0), (0, 0, 0), (900, 5, 900.4)])
def test_clocks_from_boot_are_aligned_by_sequence_numbers(rng, offsets):
    """The counter overflows twice, and each fix has packets of one event all the same."""
    log, heard = boots(rng, offsets)
    first = read(log.sample(frac=1, random_state=1))
    event = np.rad2deg(first.recorded.azimuth)
    assert len(event) == heard
    assert np.nanmax(np.nanmax(event, axis=1) - np.nanmin(event, axis=1)) < 1e-9
    mean = np.nanmean(event, axis=1)
    assert np.all(np.diff(mean) > 0)
    np.testing.assert_allclose(np.diff(first.tracks.time), np.diff(mean), atol=0.02)
    told = [line for line in first.notes if "clocks differ" in line]
    assert len(told) == (np.ptp(offsets) > 0)
    same(first.tracks, read(log).tracks)


def test_one_clock_stays_where_a_counter_overflows():
    """More pairs of equal numbers are one overflow apart than at one time."""
    rows = [(k / 10, k % 256, "a1", k / 10) for k in range(600)]
    rows += [(k / 10 + 0.004, k % 256, "a2", k / 10) for k in range(300, 756)]
    log = pd.DataFrame(rows, columns=["time_s", "sequence", "anchor", "azimuth_deg"])
    s = read(log)
    assert len(s.tracks.time) == 756
    event = azimuths(s)[:, :2]
    assert np.nanmax(np.abs(event[:, 0] - event[:, 1])) < 1e-9
    assert len(s.notes) == 1


def test_clocks_that_drift(rng):
    log, heard = boots(rng, (0, 3000.0, -70), (0, 4e-5, -5e-5), 30_000, 65536)
    log["anchor_time_s"] *= 10  # over 8 hours the clocks part by 2.7 s
    log["sequence"] %= 10_000
    log["azimuth_deg"] /= 20
    s = read(log)
    assert len(s.tracks.time) == heard
    event = np.nanmean(np.rad2deg(s.recorded.azimuth), axis=1)
    step = np.diff(s.tracks.time) - 200 * np.diff(event)
    assert np.abs(step).max() < 0.2


def test_known_offsets_of_clocks(rng):
    offsets = (7.0, 51.3, -2000.0)
    log, heard = boots(rng, offsets)
    log = log.drop(columns="sequence")
    with pytest.raises(BadValue, match=r"columns\.sequence=None.*clock_offset_s"):
        read(log, window_s=0.05)
    rows = ANCHORS.splitlines()
    more = [f"{row},{offset}" for row, offset in zip(rows, ("clock_offset_s", *offsets))]
    Path("anchors.csv").write_text("\n".join(more))
    event = np.rad2deg(read(log, window_s=0.05).recorded.azimuth)
    assert len(event) == heard
    assert np.nanmax(np.nanmax(event, axis=1) - np.nanmin(event, axis=1)) < 1e-9


def test_a_counter_that_starts_again_without_times():
    """By the rows of each anchor; a number that comes again at once is no restart."""
    rows = [*range(5, 9), *range(3), 2, *range(3, 7)]
    log = "".join(f"{n},a1,{k}\n" for k, n in enumerate(rows))
    log += "".join(f"{n},a2,{k}\n" for k, n in enumerate(rows) if k != 8)
    s = read("sequence,anchor,azimuth_deg\n" + log, combine="last")
    both = azimuths(s)[:, :2]
    np.testing.assert_allclose(both[~np.isnan(both[:, 1]), 0], both[~np.isnan(both[:, 1]), 1])
    assert len(both) == 11


def test_sequence_numbers_stay_together_where_a_host_stamps_late():
    log = "time_s,sequence,anchor,azimuth_deg\n10.00,1,a1,1\n10.07,1,a2,2\n10.05,2,a1,3\n10.12,2,a2,4\n99,1,a1,5\n"
    s = read(log)
    np.testing.assert_allclose(azimuths(s)[:, :2], [[1, 2], [3, 4], [5, NAN]])
    assert list(s.tracks.fix) == ["1", "2", "1"]


def test_fixes_have_times_that_need_not_compare():
    log = "time_s,anchor,azimuth_deg,fix\n900,a1,1,x\n5,a2,2,x\n,a1,3,w\n6,a2,4,w\n"
    s = read(log)
    assert list(s.tracks.fix) == ["x", "w"]
    by_number = "fix,anchor,azimuth_deg\n10,a1,1\n9,a1,2\n"
    assert list(read(by_number).tracks.fix) == ["9", "10"]
    by_time = "fix,time_s,anchor,azimuth_deg\nb,7,a1,1\na,8,a1,2\n"
    s = read(by_time)
    assert (list(s.tracks.fix), list(s.tracks.time)) == (["b", "a"], [7, 8])


# --- times ----------------------------------------------------------------------------------------


def test_a_window_that_takes_everything_is_noted():
    log = "time_s,anchor,azimuth_deg\n" + "".join(f"{k / 10},a{1 + k % 2},1\n" for k in range(30))
    assert any(
        "all rows of a tag make one fix" in n for n in read(log, window_s=60, combine="mean").notes
    )
    assert len(read(log, window_s=0.1, combine="mean").notes) == 1


def test_dates_are_seconds_since_1970():
    s = read("time_s,anchor,azimuth_deg\n2024-05-01T14:00:00.5+02:00,a1,1\n")
    assert s.tracks.time[0] == pd.Timestamp("2024-05-01T12:00:00.5Z").timestamp()


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_since_1970_in_another_unit_are_refused_with_that_unit(unit, factor):
    log = f"time_s,anchor,azimuth_deg\n{round(1.78e9 * factor)},a1,1\n"
    with pytest.raises(BadValue, match=rf"scenario\.time_unit={unit}; line 2 has"):
        read(log)
    assert read(log, time_unit=unit).tracks.time[0] == pytest.approx(1.78e9, abs=1e-6)
    with pytest.raises(BadValue, match=rf"scenario\.time_unit={unit} reads time_{unit}"):
        read(log.replace("time_s", f"time_{unit}"))


def test_whole_seconds_far_apart_are_doubted():
    log = "time_s,anchor,azimuth_deg\n" + "".join(f"{100 * k},a1,1\n" for k in range(30))
    assert any("typically 100 s apart; if these are milliseconds" in n for n in read(log).notes)
    slow = log.replace("00,a1", "00.5,a1")
    assert len(read(slow).notes) == 1


def test_filters_need_times():
    log = "fix,anchor,azimuth_deg,elevation_deg\n1,a1,2,3\n1,a2,2,3\n2,a1,3,3\n"
    walking = {"motion": RandomWalk()}
    assert "motion" not in read(log, **walking).offers()
    s = read(log, **walking, step_s=0.5)
    assert "motion" in s.offers()
    assert s.dt == 0.5
    timed = log.replace("fix,", "time_s,")
    assert "motion" in read(timed, **walking).offers()
    assert "motion" not in read(timed).offers()


# --- several packets of an anchor -----------------------------------------------------------------

POINT = """fix,anchor,azimuth_deg,elevation_deg,rssi_dbm,azimuth_sigma_deg
1,a1,170,-80,-60,4
1,a1,-176,-70,-62,
1,a1,179,,-64,2
1,a2,30,10,-70,1
"""


@pytest.mark.parametrize(("combine", "expected"), [
    ("first", ([170, 30], [-80, 10], [-60, -70], [4, 1])),
    ("last", ([179, 30], [NAN, 10], [-64, -70], [2, 1])),
    ("median", ([179, 30], [-75, 10], [-62, -70], [3, 1])),
])  # fmt: skip
def test_combinations(combine, expected):
    m = read(POINT.replace("-62,\n", "-62,2\n").replace("-64,2", "-64,2"), combine=combine).recorded
    if combine == "median":
        expected = (*expected[:3], [2, 1])
    for array, wanted in zip(
        (m.azimuth, m.elevation, m.azimuth_sigma), (expected[0], expected[1], expected[3])
    ):
        np.testing.assert_allclose(np.rad2deg(array[0, :2]), wanted)
    np.testing.assert_allclose(m.rssi[0, :2], expected[2])


def test_the_mean_of_angles_is_circular(rng):
    angle = np.deg2rad([170, -176, 179])
    wanted = np.angle(np.mean(np.exp(1j * angle)))
    m = read(POINT.replace("-62,\n", "-62,3\n"), combine="mean").recorded
    assert m.azimuth[0, 0] == pytest.approx(wanted, abs=1e-12)
    assert np.rad2deg(m.elevation[0, 0]) == pytest.approx(-75, abs=1e-9)
    assert m.rssi[0, 0] == pytest.approx(-62)
    assert np.rad2deg(m.azimuth_sigma[0, 0]) == pytest.approx(3)  # not divided by sqrt(3)
    assert (
        m.azimuth[0, 1]
        == read(POINT.replace("-62,\n", "-62,3\n"), combine="first").recorded.azimuth[0, 1]
    )


@pytest.mark.parametrize("combine", ["mean", "median"])
def test_combinations_against_a_plain_loop(rng, combine):
    log = walk(rng, "T", packets=5, late_s=0.2).assign(rssi_dbm=lambda f: -60 - f["elevation_deg"])
    s = read(log, combine=combine)
    for k, name in enumerate(s.tracks.fix):
        for j in range(3):
            rows = log[(log["sequence"] == int(name)) & (log["anchor"] == f"a{j + 1}")]
            if not len(rows):
                assert np.isnan(s.recorded.azimuth[k, j])
                continue
            a = np.deg2rad(rows["azimuth_deg"])
            centre = np.angle(np.exp(1j * a).sum())
            away = np.angle(np.exp(1j * (a - centre)))
            wanted = centre if combine == "mean" else centre + np.median(away)
            assert abs(np.angle(np.exp(1j * (s.recorded.azimuth[k, j] - wanted)))) < 1e-9
            assert s.recorded.rssi[k, j] == pytest.approx(getattr(rows["rssi_dbm"], combine)())


def test_a_packet_alone_keeps_its_bits(rng):
    log = walk(rng, "T", events=300)
    first = read(log, combine="first").tracks
    for combine in ("mean", "median", "each"):
        same(first, read(log, combine=combine).tracks)


def test_a_place_that_stays_keeps_its_bits():
    rows = "".join(f"1,a{j},3,0.1,0.7\n" for j in (1, 2, 3))
    s = read("fix,anchor,azimuth_deg,x_m,y_m\n" + rows)
    assert tuple(s.truth(None)[0, :2]) == (0.1, 0.7)


def test_columns_that_are_not_read_are_named():
    log = "fix,anchor,azimuth_deg,elev,quality\n1,a1,3,4,5\n"
    assert read(log).notes[-1] == "log.csv: columns that are not read: elev, quality"


def test_each_packet_has_a_column():
    m = read(POINT.replace("-62,\n", "-62,3\n") + "2,a3,5,5,-50,1\n", combine="each").tracks
    np.testing.assert_array_equal(m.columns, [0, 0, 0, 1, 2])
    np.testing.assert_array_equal(m.packets, [4, 1])
    degrees = np.rad2deg(m.measured.azimuth)
    assert sorted(degrees[0, :3]) == pytest.approx([-176, 170, 179])
    np.testing.assert_allclose(degrees[1], [NAN, NAN, NAN, NAN, 5])


def test_too_many_packets_for_columns_are_refused(monkeypatch):
    from aoabench.devices.tracks import combining

    monkeypatch.setattr(combining, "MOST_CELLS", 4)
    with pytest.raises(BadValue, match=r"combine='each'.*mean or median"):
        read(POINT.replace("-62,\n", "-62,3\n"), combine="each")


def test_packets_that_are_not_used_are_counted_and_never_advised():
    with pytest.raises(BadValue) as error:
        read(POINT.replace("-62,\n", "-62,3\n"))
    assert "first" not in str(error.value)
    for combine, lost in (("first", 2), ("mean", 0), ("each", 0)):
        notes = read(POINT.replace("-62,\n", "-62,3\n"), combine=combine).notes
        assert any(f"{lost} of 4 rows not used" in line for line in notes) == bool(lost)


def test_moving_truth_is_averaged():
    log = "time_s,anchor,azimuth_deg,x_m,y_m\n0,a1,1,1,5\n0.1,a2,2,2,5\n0.2,a3,3,6,\n5,a1,1,7,8\n"
    s = read(log, window_s=0.3)
    np.testing.assert_allclose(s.truth(None)[:, :2], [[1.5, 5], [7, 8]])
    assert any("differ by up to 1 m" in line for line in s.notes)


# --- ranges ---------------------------------------------------------------------------------------


def test_ranges_are_delays_with_a_deviation():
    log = "fix,anchor,azimuth_deg,range_m,range_sigma_m\n1,a1,1,3,0.1\n1,a2,2,4,0\n1,a3,3,5,\n"
    s = read(log)
    np.testing.assert_allclose(s.recorded.delay * LIGHT, [[3, NAN, NAN]])
    np.testing.assert_allclose(s.recorded.delay_sigma * LIGHT, [[0.1, NAN, NAN]])
    assert any("2 of 3 range_m are not used" in line for line in s.notes)
    s = read(log, range_sigma_m=0.5)
    np.testing.assert_allclose(s.recorded.delay_sigma * LIGHT, [[0.1, 0.5, 0.5]])
    assert "delay" in s.offers()
    zero = read(log.replace("0.1", "0"))
    assert zero.recorded.delay is None
    assert any("scenario.range_sigma_m states one" in line for line in zero.notes)
