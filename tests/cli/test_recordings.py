"""What `aoabench run` and `replay` say of a recording: its tags, with and without ground truth."""

import json
import math

import numpy as np
import pandas as pd
import pytest

from aoabench.report import recording

POSITION = np.array([[0, 3, 2.3], [6, 0, 2.3], [12, 3, 2.3], [6, 6, 2.3]])
ANCHORS = pd.DataFrame({"id": list("abcd"), **dict(zip(("x_m", "y_m", "z_m"), POSITION.T))})
WORDS = ("scenario=recorded", "runner.n_jobs=1")


def log(counts, seed=1):
    """Rows of tags that walk at once, with noise of 2 deg and their true positions."""
    rng, rows = np.random.default_rng(seed), []
    for k, (tag, count) in enumerate(counts.items()):
        s = np.linspace(0, 1, count)
        truth = np.stack([2 + 8 * s, 1.5 + k + s, np.full(count, 1.1)], axis=-1)
        d = truth[:, None] - POSITION
        azimuth = np.degrees(np.arctan2(d[..., 1], d[..., 0]))
        elevation = np.degrees(np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1])))
        for i in range(count):
            off = rng.normal(0, 2, (2, 4))
            rows += [
                (0.1 * i, tag, "abcd"[b], azimuth[i, b] + off[0, b], elevation[i, b] + off[1, b])
                + tuple(truth[i])
                for b in range(4)
            ]
    names = ["time_s", "tag", "anchor", "azimuth_deg", "elevation_deg", "x_m", "y_m", "z_m"]
    frame = pd.DataFrame(rows, columns=names)
    frame["azimuth_deg"] = (frame["azimuth_deg"] + 180) % 360 - 180
    return frame.sort_values("time_s", kind="stable")


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A function that writes a log and its anchors and returns the words of a run."""
    monkeypatch.chdir(tmp_path)

    def write(frame):
        frame.to_csv("log.csv", index=False)
        ANCHORS.to_csv("anchors.csv", index=False)
        return (*WORDS, "scenario.path=log.csv", "scenario.anchors=anchors.csv", "runner.out=out")

    return write


def lost(frame, tag, row):
    """The log in which the fix at one row of a tag has no angles."""
    one = frame[frame["tag"] == tag]["time_s"].unique()[row]
    empty = (frame["tag"] == tag) & (frame["time_s"] == one)
    return frame.assign(**{n: frame[n].mask(empty) for n in ("azimuth_deg", "elevation_deg")})


def test_a_recording_without_truth_tells_what_it_gives(call, files):
    """Neither nan nor a failure of all for one lost fix; the numbers are those of the steps."""
    words = files(lost(log({"T1": 30, "T2": 20}), "T2", 7).drop(columns=["x_m", "y_m", "z_m"]))
    status, out, _ = call("run", *words, "estimator=[robust_ml,ls_lines]")
    assert status == 0
    assert "nan" not in out.lower()
    assert "RMSE" not in out
    lines = [line.split() for line in out.splitlines() if " T1 " in line or " T2 " in line]
    assert [line[:4] for line in lines[:2]] == [
        ["robust_ml", "T1", "30", "30"],
        ["robust_ml", "T2", "20", "19"],
    ]
    assert "(95 %)" in out
    assert "(100 %)" in out
    assert "fixes that are not ok" in out
    _, text, _ = call("run", *words, "estimator=[robust_ml,ls_lines]", "--json")
    found = json.loads(text)
    assert found["summary"][0]["failure_rate"] == 0
    steps = pd.read_parquet("out/steps.parquet")
    assert len(found["tags"]) == 4
    for row in found["tags"]:
        mine = steps[(steps["estimator"] == row["estimator"]) & (steps["tag"] == row["tag"])]
        given = mine[mine["x_m"].notna()]
        assert (row["fixes"], row["given"], row["ok"]) == (len(mine), len(given), len(given))
        assert row["rmse_xy_m"] is None
        assert row["score"] == pytest.approx(given["score"].median())
        sigma = np.hypot(given["sigma_x_m"], given["sigma_y_m"]).median()
        assert row["sigma_xy_m"] == pytest.approx(sigma)
    (figure,) = found["figures"]
    assert figure.endswith("-positions.png")


def test_tags_have_errors_of_their_own(call, files):
    words = files(log({"T1": 30, "T2": 20}))
    _, out, _ = call("run", *words, "estimator=[ls_lines]")
    assert "pooled RMSE" in out
    _, text, _ = call("run", *words, "estimator=[ls_lines]", "--json")
    steps = pd.read_parquet("out/steps.parquet")
    for row in json.loads(text)["tags"]:
        error = steps[steps["tag"] == row["tag"]]["error_xy_m"]
        assert row["rmse_xy_m"] == pytest.approx(math.sqrt((error**2).mean()))
        assert f"{row['rmse_xy_m']:.4g}" in out
    rows = pd.read_parquet("out/replications.parquet")
    assert rows["tag"].tolist() == ["T1", "T2"]
    files(log({"T1": 30}))
    _, out, _ = call("run", *words, "estimator=[ls_lines]", "runner.out=one")
    assert "T1" not in out


def test_a_method_that_a_recording_does_not_suit_is_left_out(call, files):
    words = files(log({"T1": 5}).drop(columns=["x_m", "y_m", "z_m"]))
    status, out, err = call("run", *words, "estimator=[rssi_anchor,ls_lines]", "filter=[ekf_vmf]")
    assert status == 0
    assert "estimator.rssi_anchor does not run: it needs a recording" in err
    assert "filter.ekf_vmf does not run: it needs a recording with a motion model" in err
    assert "ls_lines" in out
    assert set(pd.read_parquet("out/summary.parquet")["estimator"]) == {"ls_lines"}
    status, _, err = call("run", *words, "estimator=[rssi_anchor]")
    assert status == 2
    assert "which estimator.rssi_anchor needs" in err


@pytest.mark.parametrize("known", [True, False])
def test_a_replayed_track_has_its_names_and_is_read_again(call, files, known):
    frame = log({"T1": 9, "T2": 6})
    words = files(frame if known else frame.drop(columns=["x_m", "y_m", "z_m"]))
    call("run", *words, "estimator=[robust_ml]")
    status, out, _ = call(
        "replay", "out", "--replication", "1", "--estimator", "robust_ml", "--export", "csv"
    )
    assert status == 0
    assert "(tag T2)" in out
    assert ("as stored" in out) == known
    assert ("6 of 6 fixes have a position, no ground truth" in out) == (not known)
    path = next(line.removeprefix("trace: ") for line in out.splitlines() if "trace: " in line)
    trace = pd.read_parquet(path)
    steps = pd.read_parquet("out/steps.parquet")
    mine = steps[steps["tag"] == "T2"].reset_index(drop=True)
    same = ["tag", "fix", "time_s", "x_m", "y_m", "outcome", "score", "anchors_used"]
    pd.testing.assert_frame_equal(trace[same], mine[same])
    again = pd.read_csv(path.replace(".parquet", "-measurements.csv"), dtype={"fix": str})
    assert set(again["tag"]) == {"T2"}
    assert again["time_s"].unique().tolist() == mine["time_s"].tolist()
    stem = path.removesuffix(".parquet")
    call("run", *WORDS, f"scenario.path={stem}-measurements.csv", f"scenario.anchors={stem}-anchors.csv",
         "estimator=[robust_ml]", "runner.out=again")  # fmt: skip
    found = pd.read_parquet("again/steps.parquet")
    np.testing.assert_allclose(found[["x_m", "y_m"]], mine[["x_m", "y_m"]], atol=1e-9)
    assert found["fix"].tolist() == mine["fix"].tolist()


def test_the_map_of_positions_has_every_fix_of_every_tag():
    rng = np.random.default_rng(0)
    xy = rng.uniform(1, 5, (50, 2))
    xy[3] = np.nan
    xy[4] = 1e6
    figure = recording.positions({"one": xy}, {0: "T1", 30: "T2"}, POSITION[:, :2])
    axis = figure.axes[0]
    drawn = {line.get_label(): line.get_xydata() for line in axis.lines}
    assert set(drawn) == {"tag T1", "tag T2"}
    np.testing.assert_array_equal(np.concatenate(list(drawn.values())), np.delete(xy, 3, axis=0))
    assert axis.get_title() == "one: 49 of 50 fixes, 1 beyond"
    assert axis.get_xlim()[1] < 20
