"""Tables of runs that mix what does not look alike."""

import math

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.maths import intervals, statistics
from aoabench.report.tails import heavy_tails, heavy_tails_text
from aoabench.store import fixes as fixes_module
from aoabench.store import manifest, recorded, tables
from aoabench.store.files import write_frame
from aoabench.store.fixes import clusters
from aoabench.store.swept import cell_names
from aoabench.types import Estimates, Outcome
from tests.store import made


def test_a_parameter_may_be_a_number_in_one_scenario_and_a_list_in_another(tmp_path):
    for scenario, noise, estimator in (
        ("ble_room", "ble_multipath", "estimator=[rssi_anchor]"),
        ("indoor_map", "ofdm_crlb", "filter=[ekf_aoa]"),
    ):
        short = {"ble_room": "packets=2", "indoor_map": "route=[[17.5,24.5],[25,24.5]]"}[scenario]
        given = (f"scenario={scenario}", f"scenario.{short}", f"noise={noise}", estimator)
        aoabench.run(*given, "reps=2", out=tmp_path)
    cells = pd.read_parquet(tmp_path / "cells.parquet").set_index("scenario")
    assert cells.loc["ble_room", "scenario.height_m"] == "1.0"
    assert cells.loc["indoor_map", "scenario.height_m"] == "[1.0, 2.0]"
    assert len(aoabench.load(tmp_path)) == 4


class Choosy:
    """Answers the middle of the room, and rejects every third packet without hiding its position."""

    def __call__(self, batch, scenario, streams):
        position = np.full((*batch.azimuth.shape[:2], 3), [3.6, 4.25, 1.0])
        outcome = np.zeros(position.shape[:2], dtype=np.int8)
        outcome[:, ::3] = Outcome.REJECTED
        return Estimates(position, None, None, outcome)


def test_packets_of_one_position_are_one_cluster_in_the_summary(tmp_path):
    """Three packets at each of the room's 42 points: 42 clusters, and errors to match."""
    words = ["scenario=ble_room", "noise=ble_multipath", "scenario.packets=3"]
    frame = aoabench.run(
        *words, "estimator=[anchor_mean]", "reps=4", out=tmp_path, estimators={"choosy": Choosy()}
    )
    cell = frame["cell"].iloc[0]
    fixes = fixes_module.fixes(tmp_path, cell, "anchor_mean")
    assert fixes.place.shape == (4, 126)
    found = clusters(tmp_path, cell, "anchor_mean")
    assert len(found.fixes) == fixes.place.max() + 1 == 42
    square = np.bincount(fixes.place.ravel(), (fixes.error_xy_m.astype(float) ** 2).ravel())
    assert np.allclose(found.totals[1], square)
    summary = (
        pd.read_parquet(tmp_path / "summary.parquet").set_index("estimator").loc["anchor_mean"]
    )
    rmse = np.sqrt(square / found.fixes)
    assert summary["se_by"] == "position"
    by_position = statistics.pooled_rmse(rmse, found.fixes).se
    assert by_position <= summary["rmse_pooled_xy_m_se"] < 2 * by_position
    errors = np.where(fixes.accepted, fixes.error_xy_m, np.nan)
    known = errors[np.isfinite(errors)]
    for probability, name in ((0.5, "cep50_m"), (0.9, "cep90_m")):
        ends = intervals.cep_interval(errors, probability, fixes.place[0])
        assert summary[name] == pytest.approx(np.quantile(known, probability))
        assert (summary[f"{name}_low"], summary[f"{name}_high"]) == pytest.approx(ends)
        assert ends[0] < summary[name] < ends[1]
    for limit in (1, 2, 5):
        assert summary[f"p_within_{limit}m"] == (errors <= limit).mean()
    square = found.totals[0]
    assert summary["largest_share"] == pytest.approx(square.max() / square.sum())
    read = []

    def reader(name):
        read.append(name)
        return recorded.fixes(tmp_path, cell, name, 3)

    lazy = fixes_module.Read(reader, ["anchor_mean", "choosy"])
    assert list(lazy) == ["anchor_mean", "choosy"]
    assert "absent" not in lazy
    assert read == []
    assert np.array_equal(lazy["choosy"].outcome, lazy["choosy"].outcome[:3])
    assert np.array_equal(lazy["anchor_mean"].error_xy_m, fixes.error_xy_m[:3])
    assert read == ["choosy", "anchor_mean"]
    some = clusters(tmp_path, cell, "anchor_mean", [0, 2])
    assert some.replications == 2
    assert np.array_equal(some.fixes, np.full(42, 6.0))
    assert clusters(tmp_path, cell, "choosy").fixes.sum() == 4 * 126 * 2 / 3


def test_a_summary_with_many_swept_parameters_warns_of_nothing(tmp_path, recwarn):
    """pandas warns of a frame whose columns come one by one from the hundredth on."""
    for cell, value in (("a", 1.0), ("b", 2.0)):
        made.cell(tmp_path, cell, ["ls"], **{f"parameter_{i}": value for i in range(120)})
    tables.collect(tmp_path)
    summary = pd.read_parquet(tmp_path / "summary.parquet").set_index("cell")
    assert list(summary["noise.parameter_119"]) == [1.0, 2.0]
    assert not [str(w.message) for w in recwarn.list]


def test_stored_steps_fill_what_counts_fixes(tmp_path):
    words = ["noise=vmf", "filter=[ekf_ae_nominal]", "reps=6", "store.steps=true"]
    aoabench.run(*words, "runner.n_jobs=1", out=tmp_path)
    row = pd.read_parquet(tmp_path / "summary.parquet").iloc[0]
    steps = pd.read_parquet(tmp_path / "steps.parquet")
    assert row["cep50_m"] == pytest.approx(steps["error_xy_m"].median())
    assert row["error_z_q95_m"] == pytest.approx(steps["error_z_m"].abs().quantile(0.95))
    assert row["p_within_2m"] == pytest.approx((steps["error_xy_m"] <= 2).mean())
    assert row["availability"] == row["share_ok"] == (steps["outcome"] == "ok").mean()
    for name in ("cep50_m", "error_z_q95_m", "p_within_2m", "availability"):
        assert row[f"{name}_low"] < row[name] < row[f"{name}_high"]


def test_a_summary_of_an_earlier_version_is_made_again(tmp_path):
    """Without the columns that have been added since; nothing is computed again."""
    words = ["noise=vmf", "filter=[ekf_vmf]", "reps=4", "runner.n_jobs=1"]
    aoabench.run(*words, out=tmp_path)
    made = tables.shown(tmp_path, "summary")["summary"]
    old = made.drop(columns=["heavy_tail", "largest_share", "p_within_1m", "rmse_q50_3d_m_low"])
    file = manifest.new_file(tmp_path, "summary")
    write_frame(file, old, columns={})
    manifest.publish(tmp_path, {"summary": file}, manifest.current(tmp_path))
    assert "heavy_tail" not in tables.shown(tmp_path, "summary")["summary"]
    assert heavy_tails(old) == []
    aoabench.run(*words, out=tmp_path)
    pd.testing.assert_frame_equal(tables.shown(tmp_path, "summary")["summary"], made)


def test_heavy_tails_are_named_with_their_medians():
    rows = pd.DataFrame({
        "cell": [f"c{i}" for i in range(12)], "estimator": "ls", "heavy_tail": True,
        "largest_share": np.linspace(0.9, 0.3, 12), "se_by": ["position"] + 11 * ["replication"],
        "cep50_m": [2.0] + 11 * [math.nan], "cep50_m_low": 1.8, "cep50_m_high": 2.3,
        "rmse_q50_3d_m": 5.0, "rmse_q50_3d_m_low": 4.0, "rmse_q50_3d_m_high": 7.0,
    })  # fmt: skip
    rows.loc[11, "heavy_tail"] = False
    names = {f"c{i}": f"vmf noise.sigma_deg={i}" for i in range(12)}
    lines = list(heavy_tails_text(heavy_tails(rows.sample(frac=1, random_state=1)), names))
    assert lines[0].endswith("use the median:")
    first = "  vmf noise.sigma_deg=0 ls: the largest position holds 90 % of the sum of squares; "
    assert lines[1] == first + "CEP50 2.00 [1.80, 2.30] m"
    assert lines[2].endswith("the largest replication holds 84.5 % of the sum of squares; median "
                             "RMSE 3-D 5.0 [4.0, 7.0] m")  # fmt: skip
    assert lines[-1] == "  and 1 more, see heavy_tail in summary.parquet"
    assert list(heavy_tails_text(heavy_tails(rows[11:]), {})) == []


def test_cells_are_named_by_what_differs():
    rows = pd.DataFrame({
        "cell": ["a", "a", "b", "c", "d"], "scenario": "square_track", "noise": 4 * ["vmf"] + ["ae_flip"],
        "noise.sigma_deg": [2, 2, 5, 5, None], "scenario.steps": 4,
    })  # fmt: skip
    assert cell_names(rows[:2]) == {}
    assert cell_names(rows[:3]) == {"a": "noise.sigma_deg=2.0", "b": "noise.sigma_deg=5.0"}
    names = cell_names(rows)
    assert (names["a"], names["d"]) == ("vmf noise.sigma_deg=2.0", "ae_flip")
    assert (names["b"], names["c"]) == ("cell b", "cell c")
