"""`locate` on a stream: the fixes of the file, whatever the pieces; when fixes close; bounds."""

import gzip
import os
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from aoabench.deployment import located, numbering, recursion, stream, windows
from aoabench.deployment.request import Request
from aoabench.deployment.streaming import Run
from aoabench.errors import UserError
from tests.deployment.conftest import ANCHORS, POINTS, angles, rows_of

LONG = "time_s,tag,anchor,azimuth_deg,elevation_deg"


def noisy_rows(rng, steps=30, tags=("T1", "T2"), every=0.5, spread=0.02):
    """Rows of two tags in order of their times, each anchor at a time of its own, with noise."""
    rows = []
    for k in range(steps):
        for n, tag in enumerate(tags):
            point = POINTS[(k + n) % 4] + rng.normal(0, 0.2, 3)
            for anchor in ANCHORS:
                a, e = angles(point, anchor) + rng.normal(0, 3, 2)
                at = every * k + rng.uniform(0, spread)
                rows.append((at, f"{at:.6f},{tag},{anchor},{a:.6f},{e:.6f}"))
    return [row for _, row in sorted(rows)]


def run_of(room, *settings, **more):
    said = []
    return Run(
        Request("-", str(room / "anchors.csv"), settings=settings, **more), None, said.append
    ), said


def streamed(run, text, cuts, step_s=0.002):
    """The fixes of a text that comes in pieces of whole lines, one every `step_s`."""
    lines = text.encode().splitlines(keepends=True)
    found, now = [], 0.0
    for some in np.split(np.arange(len(lines)), cuts):
        now += step_s
        found += run.table(b"".join(lines[i] for i in some), now)
    found += run.table(b"", now, ended=True)
    return pd.concat(map(pd.DataFrame, found), ignore_index=True)


def same(stream, file):
    """Whether both tables hold the same fixes."""
    both = [f.sort_values(["tag", "time_s", "fix"]).reset_index(drop=True) for f in (stream, file)]
    pd.testing.assert_frame_equal(*both, check_dtype=False, rtol=1e-9, atol=1e-9)
    return True


@pytest.mark.parametrize("settings", [
    ("scenario.window_s=0.1",),
    ("scenario.window_s=0.1", "scenario.windows=chained"),
    ("scenario.window_s=0.5", "scenario.windows=grid"),
    ("scenario.window_s=1.2", "scenario.combine=mean"),
    ("scenario.window_s=1.2", "scenario.combine=each"),
    ("scenario.window_s=0.1", "scenario.gap_s=0.4"),
    ("scenario.window_s=0.1", "scenario.tags=[T2]"),
])  # fmt: skip
@pytest.mark.parametrize("pieces", [2, 40])
def test_a_stream_gives_the_fixes_of_the_file(room, log, rng, settings, pieces):
    rows = noisy_rows(rng)
    path = log(rows, LONG)
    file = located.locate(
        Request(str(path), str(room / "anchors.csv"), settings=settings).asked()
    ).frame
    run, _ = run_of(room, *settings)
    cuts = np.sort(rng.choice(np.arange(3, len(rows)), pieces, replace=False))
    assert same(streamed(run, path.read_text(), cuts).assign(track=0), file.assign(track=0))
    assert run.live.late.count == 0
    assert run.live.open is None


@pytest.mark.parametrize("column", ["fix", "sequence"])
def test_numbered_fixes_are_those_of_the_file(room, log, rng, column):
    rows = rows_of(np.tile(POINTS, (8, 1)))
    path = log(rows, f"{column},anchor,azimuth_deg,elevation_deg")
    file = located.locate(Request(str(path), str(room / "anchors.csv")).asked()).frame
    run, _ = run_of(room)
    found = streamed(run, path.read_text(), np.arange(3, len(rows), 5), step_s=0.02)
    assert found["time_s"].notna().all()
    assert found["fix"].tolist() == file["fix"].tolist()
    assert same(found.assign(time_s=0.0), file.assign(time_s=0.0))


def ublox(rows, boot_s=(0.0, 51.234, 0.1, 900.0)):
    """u-blox lines of exact angles; each anchor counts from its own start."""
    lines = []
    for k, point in enumerate(rows):
        for n, anchor in enumerate(ANCHORS):
            a, e = angles(point, anchor)
            ms = round(1e3 * (k + boot_s[n]))
            lines.append(f'+UUDF:C0FFEE000000,-61,{-a:.0f},{e:.0f},0,37,"{anchor}","",{ms},{k}\r\n')
    return lines


def test_ublox_lines_with_a_clock_for_each_anchor(room):
    run, _ = run_of(room, format="ublox")
    lines = ublox(np.tile(POINTS, (5, 1)))
    text = "".join(lines[:30] + ["OK\r\n", "+UUDFP:C0FFEE000000,0201\r\n"] + lines[30:])
    found = streamed(run, text, np.arange(2, len(lines), 3), step_s=0.25)
    assert (found["anchors_heard"] == 4).all()
    assert np.allclose(np.diff(found["time_s"]), 1.0, atol=1e-6)
    assert np.allclose(found[["x_m", "y_m"]], np.tile(POINTS[:, :2], (5, 1)), atol=0.15)
    assert (found["tag"] == "C0FFEE000000").all()


def test_a_fix_closes_after_its_window_or_in_silence(room):
    run, _ = run_of(room, "scenario.window_s=0.1")
    first = [LONG, *rows_of(POINTS[:1], "T1", times=[0.0])]
    assert not list(run.table("\n".join(first + [""]).encode(), 10.0))
    assert not list(run.table(b"", 10.0 + 0.1))
    assert run.live.wait_s() is not None
    (closed,) = run.table(b"", 10.0 + 0.1 + windows.HOLD_S + 1e-6)
    assert closed["anchors_heard"].tolist() == [4]
    assert run.live.wait_s() is None
    later = "\n".join(
        rows_of(POINTS[:1], "T1", times=[1.0]) + rows_of(POINTS[1:2], "T1", times=[2.0]) + [""]
    )
    assert not list(run.table(later.encode(), 20.0))
    (closed,) = run.table(b"", 20.0 + windows.HOLD_S + 1e-6)
    assert closed["time_s"].tolist() == [1.0]
    assert closed["fix"].tolist() == ["1"]


@pytest.mark.parametrize("settings", [(), ("scenario.combine=error",)])
@pytest.mark.parametrize("cut", [6, 9])
def test_packets_that_differ_are_all_used_and_equal_ones_once(room, settings, cut):
    rows = rows_of(POINTS, "T1")
    other = rows[8].rsplit(",", 1)[0] + ",-20"
    lines = [LONG, *rows[:4], rows[0], *rows[4:9], other, rows[8], *rows[9:]]
    tables = []
    for more in ((), ("scenario.combine=each",)):
        run, said = run_of(room, "scenario.window_s=0.1", *(more or settings))
        tables.append(streamed(run, "\n".join([*lines, ""]), [cut, cut + 3], step_s=0.2))
        assert sum("differ; all of them are used" in line for line in said) == (not more)
    each = streamed(run_of(room, "scenario.window_s=0.1", "scenario.combine=each")[0],
                    "\n".join([LONG, *rows[:9], other, *rows[9:], ""]), [cut])  # fmt: skip
    assert tables[0]["packets"].tolist() == [5, 4, 6, 4]
    same(tables[0].drop(columns="packets"), each.drop(columns="packets"))
    assert not np.allclose(tables[0]["sigma_major_m"], tables[1]["sigma_major_m"], atol=1e-9)


def test_packets_after_the_end_are_counted_and_a_clock_may_start_again(room):
    run, _ = run_of(room, "scenario.window_s=0.1")
    rows = rows_of(POINTS, "T1", times=[50.0, 51.0, 52.0, 53.0])
    list(run.table("\n".join([LONG, *rows[:7], *rows[8:], ""]).encode(), 1.0))
    (closed,) = run.table(b"", 2.0)
    assert closed["anchors_heard"].tolist() == [4, 3, 4, 4]
    assert not list(run.table(f"{rows[7]}\n".encode(), 3.0))
    assert run.live.late.count == 1
    assert "1 packets came after" in "\n".join(run.lines())
    again = "\n".join(rows_of(POINTS[:1], "T1", times=[0.0]) + [""])
    (closed,) = [
        f for now in (4.0, 5.0) for f in run.table(again.encode() if now == 4.0 else b"", now)
    ]
    assert closed["time_s"].tolist() == [0.0]


def test_what_is_remembered_does_not_grow(room, monkeypatch):
    for module in (windows, numbering):
        monkeypatch.setattr(module, "MOST_TAGS", 5)
    run, _ = run_of(room, "scenario.window_s=0.1")
    now = 1.0
    list(run.table(f"{LONG}\n{rows_of(POINTS[:1], 'first', times=[0.0])[0]}\n".encode(), now))
    for k in range(40):
        now += 1.0
        list(
            run.table(
                "\n".join(rows_of(POINTS[:1], f"tag {k}", times=[float(k)]) + [""]).encode(), now
            )
        )
    state = run.live
    assert run.fixes == 40
    assert state.open.tags == ("tag 39",)
    assert len(state.numbering.known) == len(state.late.ends) == 5
    assert len(state.arrival) == 4


def test_a_beginning_too_short_for_the_method_waits_for_more(room):
    run, _ = run_of(room, "scenario.window_s=0.1", estimator="ls_lines")
    rows = rows_of(POINTS[:1], "T1", times=[0.0])
    assert not list(run.table(f"{LONG}\n{rows[0]}\n".encode(), 1.0))
    assert not list(run.table("\n".join([*rows[1:], ""]).encode(), 1.01))
    (closed,) = run.table(b"", 2.0)
    assert closed["anchors_heard"].tolist() == [4]


def test_a_stream_without_measurements_and_with_mistakes(room):
    run, _ = run_of(room)
    with pytest.raises(UserError, match="ended without a measurement"):
        list(run.rest())
    run, _ = run_of(room, "scenario.window_s=0.1")
    with pytest.raises(UserError, match=r"scenario.path='-'.*'A9'") as caught:
        [
            list(run.table(text, now))
            for text, now in [(f"{LONG}\n0,T1,A9,0,0\n".encode(), 1.0), (b"", 2.1)]
        ]
    assert "/tmp" not in str(caught.value)
    list(run_of(room)[0].table(b"\n\n", 1.0))


MOTION = "scenario.motion={_target_: aoabench.models.motion.ConstantVelocity}"


@pytest.mark.parametrize("name", ["ekf_vmf", "ukf_ae_nominal"])
def test_a_kalman_filter_goes_on_from_piece_to_piece(room, log, rng, name):
    rows = noisy_rows(rng, every=0.3)
    rows[50:50] = [row.replace(row.split(",")[0], "3.05") for row in noisy_rows(rng, 1)[:4]]
    settings = ("scenario.window_s=0.1", "scenario.combine=mean", "scenario.gap_s=5", MOTION)
    path = log(rows, LONG)
    request = Request(str(path), str(room / "anchors.csv"), filter=name, settings=settings)
    file = located.locate(request.asked()).frame
    run, _ = run_of(room, *settings, filter=name)
    found = streamed(run, path.read_text(), np.arange(12, len(rows), 7), step_s=0.02)
    assert same(found.assign(track=0), file.assign(track=0))


def test_outcomes_of_a_filter_see_across_pieces(room, log):
    """Five steps of impossible innovations in a row are diverged, wherever the pieces end."""
    points = np.concatenate([np.tile(POINTS[:1], (4, 1)), np.tile([[11.0, 5.5, 1.1]], (9, 1))])
    rows = rows_of(points, "T1", times=np.arange(13.0).tolist())
    settings = ("scenario.window_s=0.1", "scenario.motion={_target_: aoabench.models.motion.RandomWalk, q_xy: 1e-4, q_z: 1e-4}",
                "scenario.start_sigma_m=0.01", "filter.ekf_ae_nominal.measurement.sigma_deg=0.5")  # fmt: skip
    path = log(rows, LONG)
    request = Request(
        str(path), str(room / "anchors.csv"), filter="ekf_ae_nominal", settings=settings
    )
    file = located.locate(request.asked()).frame
    assert (file["reason"] == "innovations").any()
    run, _ = run_of(room, *settings, filter="ekf_ae_nominal")
    assert same(streamed(run, path.read_text(), np.arange(4, len(rows), 4)), file)


@pytest.mark.parametrize("name", ["ekf_vmf_smoother", "pf_vmf"])
def test_methods_that_do_not_run_on_a_stream(room, name):
    run, _ = run_of(room, "scenario.window_s=0.1", MOTION, filter=name)
    text = "\n".join([LONG, *rows_of(POINTS, "T1"), ""])
    with pytest.raises(UserError, match="does not run on a stream"):
        list(run.table(text.encode(), 1.0))


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        with suppress(OSError):
            os.close(end)


def test_pieces_come_as_written_and_silence_is_told(pipe):
    source, sink = pipe
    found = stream.pieces(source, lambda: 0.01)
    assert next(found).text == b""
    os.write(sink, b"one\ntw")
    assert next(found).text == b"one\ntw"
    assert next(found).text == b""
    os.close(sink)
    assert not any(piece.text for piece in found)


@pytest.mark.parametrize("end", ["\n", ""])
def test_rows_may_be_cut_anywhere(room, log, rng, end):
    rows = noisy_rows(rng, steps=6)
    path = log(rows, LONG)
    file = located.locate(
        Request(str(path), str(room / "anchors.csv"), settings=("scenario.window_s=0.1",)).asked()
    )
    run, _ = run_of(room, "scenario.window_s=0.1")
    text = (path.read_text().rstrip() + end).encode()
    cuts = [0, *np.sort(rng.choice(np.arange(1, len(text)), 50, replace=False)), len(text)]
    found = [f for a, b in pairwise(cuts) for f in run.table(text[a:b], 1e-5 * a)]
    found += run.table(b"", 10.0, ended=True)
    assert same(pd.concat(map(pd.DataFrame, found)), file.frame)


@pytest.mark.parametrize("end", ["\r", "\r\n", "\r\r\n"])
@pytest.mark.parametrize("size", [1, 5, 61, 10_000])
def test_lines_of_a_stream_may_end_with_cr(room, end, size):
    text = "".join(line.strip() + end for line in ublox(POINTS)).encode()
    run, _ = run_of(room)
    found = [f for k in range(0, len(text), size) for f in run.table(text[k : k + size], 1e-6 * k)]
    found += run.table(b"", 10.0, ended=True)
    fixes = pd.concat(map(pd.DataFrame, found)).astype({"fix": int}).sort_values("fix")
    assert fixes["fix"].tolist() == [0, 1, 2, 3]
    assert (fixes["anchors_used"] == 4).all()
    np.testing.assert_allclose(fixes[["x_m", "y_m"]], POINTS[:, :2], rtol=0, atol=0.15)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (gzip.compress(b"a"), "gzip -cd"),
        (b"PAR1", "Parquet"),
        (b"PK\x03\x04", "Excel"),
        ("a,b\n".encode("utf-16"), "iconv"),
    ],
)
def test_what_is_read_in_a_file_alone_is_refused(room, start, words):
    with pytest.raises(UserError, match=f"LOG='-' is not allowed.*{words}"):
        list(run_of(room)[0].table(start + bytes(30), 1.0))


def test_a_line_without_end_is_refused(room):
    with pytest.raises(UserError, match="longer than"):
        list(run_of(room)[0].table(b"x" * 2**21, 1.0))


@pytest.mark.parametrize("name", ["ekf_vmf", "ukf_ae_adaptive_augmented", "ekf_toa_aoa"])
def test_tags_of_any_number_of_fixes_in_a_piece(room, log, rng, name, monkeypatch):
    """Tags that go on are filtered together, also where one has more fixes than another."""
    tags = [f"T{i}" for i in range(5)]
    kept = rng.uniform(size=(24, 5)) < [0.3, 0.4, 0.6, 0.8, 1.0]
    rows = []
    for row in noisy_rows(rng, 24, tags, every=0.4):
        time, tag, _ = row.split(",", 2)
        if kept[int(float(time) / 0.4), int(tag[1:])]:
            rows.append(row + ",7.5,0.2" * (name == "ekf_toa_aoa"))
    head = LONG + ",range_m,range_sigma_m" * (name == "ekf_toa_aoa")
    settings = ("scenario.window_s=0.1", "scenario.combine=mean", MOTION)
    path = log(rows, head)
    request = Request(str(path), str(room / "anchors.csv"), filter=name, settings=settings)
    file = located.locate(request.asked()).frame
    sizes, first = [], recursion.resumed
    monkeypatch.setattr(
        recursion, "resumed", lambda *given: sizes.append(len(given[4])) or first(*given)
    )
    run, _ = run_of(room, *settings, filter=name)
    found = streamed(run, path.read_text(), np.arange(60, len(rows), 61), step_s=0.02)
    assert same(found.assign(track=0), file.assign(track=0))
    assert max(sizes) >= 4


def test_a_filter_follows_receivers_that_move(room, log):
    """The anchors of earlier pieces are not kept; fixes are judged by those of this piece."""
    rows = []
    for row in rows_of(np.tile(POINTS, (3, 1)), "T1", times=np.arange(12.0).tolist()):
        pose = ANCHORS[row.split(",")[2]]
        rows.append(f"{row},{pose[0]},{pose[1]},{pose[2]},{pose[3]}")
    head = LONG + ",anchor_x_m,anchor_y_m,anchor_z_m,anchor_facing_deg"
    settings = ("scenario.window_s=0.1", MOTION, "filter.ekf_vmf.extent_factor=1")
    path = log(rows, head)
    file = located.locate(Request(str(path), None, filter="ekf_vmf", settings=settings).asked())
    run = Run(Request("-", None, filter="ekf_vmf", settings=settings), None, print)
    found = streamed(run, path.read_text(), np.arange(9, len(rows), 5), step_s=0.02)
    assert same(found, file.frame)
