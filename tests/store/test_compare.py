"""The comparison of a run's estimators, and the one tidy table that a run ends as."""

import json
import math
import shutil

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import aoabench
from aoabench.cli.main import dispatch, main
from aoabench.columns import REPLICATIONS
from aoabench.maths import intervals, statistics
from aoabench.report.comparison import lines
from aoabench.store import compare, index, manifest, tables
from aoabench.store.clusters import influences, position_sums
from aoabench.store.comparison import Comparison
from aoabench.store.files import write_frame
from aoabench.store.fixes import clusters, fixes, influences_of
from aoabench.store.parts import intact_parts

FILTERS = "filter=[ekf_vmf,ukf_vmf,ekf_ae_fitted]"


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("swept")
    aoabench.run(
        "noise=vmf,ae_flip", "noise.sigma_deg=5,10", FILTERS, "reps=60", "runner.n_jobs=1", out=out
    )
    return out


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    out = tmp_path_factory.mktemp("grid")
    words = ["scenario=bs_grid", "scenario.positions=120", "noise=ae_normal", "noise.sigma_deg=2"]
    aoabench.run(*words, "estimator=[ls,ml_kcorr,ml_atan2]", "reps=12", "runner.n_jobs=1", out=out)
    return out


def doctored(source, out, change):
    """A copy of a run, its replications changed: `change` gets and gives the frame of a cell."""
    shutil.copytree(source, out, dirs_exist_ok=True)
    file = manifest.new_file(out, "tidy")
    cells = [change(rows.copy()) for _, rows in tables.load(out).groupby("cell")]
    write_frame(file, pd.concat(cells), columns=REPLICATIONS)
    manifest.publish(out, {"tidy": file}, manifest.current(out))
    return out


def said(capsys, *words):
    assert dispatch(["compare", *map(str, words)]) == 0
    return capsys.readouterr().out


def test_rows_are_paired_tests_over_replications(swept):
    table = aoabench.compare(swept, baseline="ekf_vmf")
    assert len(table) == 4 * 2
    assert set(table["baseline"]) == {"ekf_vmf"}
    assert set(table["noise.sigma_deg"]) == {5, 10}
    frame = aoabench.load(swept)
    for row in table.to_dict("records"):
        mine = frame[frame["cell"] == row["cell"]].pivot(
            index="replication", columns="estimator", values="rmse_3d_m"
        )
        a, b = mine[row["estimator"]], mine["ekf_vmf"]
        shown = statistics.paired(a, b).percent
        assert (row["change_low"], row["change_high"]) == shown.interval()
        assert row["p"] == shown.p_value(), "the test inverts the interval that is shown"
        student = stats.ttest_rel(a, b).pvalue
        assert (row["p"] < 0.05) == (not row["change_low"] <= 0 <= row["change_high"])
        assert row["p"] == pytest.approx(student, abs=0.1), "skewness moves it"
        assert row["change"] == pytest.approx(100 * (a.mean() / b.mean() - 1))
        assert (row["n"], row["units"], row["by"]) == (60, 60, "replication")
        se, _ = intervals.bootstrap(
            lambda x, y: 100 * (x.mean() / y.mean() - 1), a, b, resamples=500
        )
        assert row["change_high"] - row["change_low"] == pytest.approx(2 * 2.1 * se, rel=0.15)
    assert list(table["p_holm"]) == list(intervals.holm(table["p"]))
    worse = table[table["estimator"] == "ekf_ae_fitted"]
    assert set(worse["verdict"]) == {"worse"}
    assert worse["text"].str.startswith("ekf_ae_fitted is worse than ekf_vmf by ").all()


def test_a_baseline_that_the_data_pick_counts_all_pairs(swept):
    table = aoabench.compare(swept)
    assert (
        table.groupby("cell")["baseline_mean"].first().le(table.groupby("cell")["mean"].min()).all()
    )
    assert table.attrs["comparisons"] == 4 * 3, (
        "three pairs of three estimators in each cell, two of them printed"
    )
    assert (table["p_holm"] >= intervals.holm(table["p"])).all()


def test_the_line_says_better_by_how_much_and_how_surely(swept, tmp_path, capsys):
    rng = np.random.default_rng(1)

    def change(frame):
        common = rng.gamma(10, 0.1, 60)
        values = {"ekf_vmf": common, "ukf_vmf": 0.9 * common * (1 + 0.01 * rng.normal(size=60)),
                  "ekf_ae_fitted": common + 0.03 * rng.normal(size=60)}  # fmt: skip
        frame["rmse_3d_m"] = np.concatenate([values[name] for name in frame["estimator"].unique()])
        return frame

    out = doctored(swept, tmp_path, change)
    text = said(capsys, out, "--baseline", "ekf_vmf")
    assert (
        text.count("ukf_vmf is better than ekf_vmf by 10.")
        + text.count("ukf_vmf is better than ekf_vmf by 9.")
        == 4
    )
    assert text.count("ekf_ae_fitted and ekf_vmf: no difference seen at this N = 60: ") == 4
    assert text.count(" to detect 1 %") == 4
    assert "Holm's method over the 8 comparisons" in text
    kept = pd.read_parquet(out / "compare.parquet")
    pd.testing.assert_frame_equal(kept, aoabench.compare(out, "ekf_vmf"), check_dtype=False)
    undecided = kept[kept["verdict"] == "no difference seen"]
    values = aoabench.load(out).pivot(
        index=["cell", "replication"], columns="estimator", values="rmse_3d_m"
    )
    z = stats.norm.ppf(1 - 0.025 / 8) + stats.norm.ppf(0.8)
    pairs = [values.loc[cell] for cell in undecided["cell"]]
    ses = [statistics.paired(v["ekf_ae_fitted"], v["ekf_vmf"]).percent.se for v in pairs]
    assert list(undecided["needed"]) == pytest.approx([60 * (z * se) ** 2 for se in ses])


def test_shared_positions_cluster_the_interval(grid):
    """Against the bootstrap of whole positions, and wider than over replications by far."""
    table = aoabench.compare(grid, "ml_kcorr").set_index("estimator")
    assert (table["by"] == "position").all()
    assert (table["units"] == 120).all()
    cell = table["cell"].iloc[0]
    f = {name: fixes(grid, cell, name).error_3d_m.astype(float) for name in ("ls", "ml_kcorr")}

    def percent(a, b):
        return 100 * (np.sqrt((a**2).mean(axis=1)).mean() / np.sqrt((b**2).mean(axis=1)).mean() - 1)

    se, _ = intervals.bootstrap(percent, f["ls"], f["ml_kcorr"], axis=1, resamples=1000)
    row = table.loc["ls"]
    assert row["change"] == pytest.approx(percent(f["ls"], f["ml_kcorr"]), rel=1e-5)
    assert row["change_high"] - row["change_low"] == pytest.approx(
        2 * stats.t.ppf(0.975, 119) * se, rel=0.1
    )
    assert "positions" in "\n".join(lines(table.reset_index()))


def test_heavy_tails_are_flagged_and_named(grid, capsys):
    """An estimator without phase-jump correction, one position of which holds most of the squares."""
    summary = tables.shown(grid, "summary")["summary"].set_index("estimator")
    assert list(summary["heavy_tail"]) == [False, False, True]
    assert summary.loc["ml_atan2", "largest_share"] > 0.3
    table = aoabench.compare(grid, "ml_kcorr").set_index("estimator")
    assert dict(table["heavy_tail"]) == {"ls": False, "ml_atan2": True}
    assert not aoabench.compare(grid, "ml_kcorr", "iterations")["heavy_tail"].any()
    text = said(capsys, grid, "--baseline", "ml_kcorr")
    assert "  ml_atan2: the largest position holds " in text
    assert "CEP50" in text
    assert "heavy tails" not in said(capsys, grid, "--metric", "failure_rate")


def test_shared_positions_cluster_iterations_too_but_not_failures(grid):
    table = aoabench.compare(grid, "ml_kcorr", "iterations").set_index("estimator")
    assert table.loc["ml_atan2", "by"] == "position"
    assert table.loc["ls", "verdict"] == "no values"
    assert set(aoabench.compare(grid, "ml_kcorr", "failure_rate")["by"]) == {"replication"}


def test_fixes_that_are_gone_are_said_and_not_done_without(grid, tmp_path):
    shutil.copytree(grid, tmp_path, dirs_exist_ok=True)
    shutil.rmtree(tmp_path / "parts")
    with pytest.raises(aoabench.RunError, match="are missing; run the same command again"):
        dispatch(["compare", str(tmp_path)])
    assert dispatch(["compare", str(tmp_path), "--metric", "failure_rate"]) == 0


def test_clusters_of_some_replications_are_those_of_their_fixes(grid):
    cell = aoabench.load(grid)["cell"].iloc[0]
    f, some = fixes(grid, cell, "ls"), np.array([0, 3, 4])
    found = clusters(grid, cell, "ls", some)
    picked = [getattr(f, name)[some] for name in ("error_3d_m", "error_xy_m", "iterations")]
    expected = position_sums(*picked, f.accepted[some])
    assert found.replications == 3
    assert np.allclose(found.influence, expected.influence)
    assert np.allclose(found.totals, expected.totals, equal_nan=True)
    entry = index.entry_of(grid, cell, "ls")
    parts = intact_parts(grid, entry["key"])
    cells = influences_of(grid, entry, parts, some, "rmse_xy_m")
    assert np.allclose(cells, influences("rmse_xy_m", *picked, f.accepted[some]))
    assert np.allclose(3 * cells.sum(axis=0), expected.influence[1])


def test_failure_rates_are_compared_in_points(swept, tmp_path, capsys):
    def change(frame):
        lost = (frame["estimator"] == "ekf_ae_fitted") & (frame["replication"] % 4 == 0)
        frame["outcome"] = np.where(lost, "diverged", "ok")
        return frame

    out = doctored(swept, tmp_path, change)
    text = said(capsys, out, "--baseline", "ekf_vmf", "--metric", "failure_rate")
    assert "ekf_ae_fitted is worse than ekf_vmf by 25 percentage points [" in text
    assert "about N = " in text
    row = (
        aoabench.compare(out, "ekf_vmf", "failure_rate")
        .set_index("estimator")
        .loc["ekf_ae_fitted"]
        .iloc[0]
    )
    assert row["p"] == pytest.approx(2 * 0.5**15)
    assert row["unit"] == "percentage points"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("metric", compare.METRICS)
def test_metrics_without_any_value_are_said(metric, grid, capsys):
    """No traceback, no warning: least squares has no iterations."""
    text = said(capsys, grid, "--metric", metric)
    assert "nan" not in text
    if metric == "iterations":
        assert f"no {metric} of ls" in text.replace("ml_kcorr and ls", "ls").replace(
            "ml_atan2 and ls", "ls"
        )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("keep", [0, 1, 2])
def test_few_values_are_said(keep, swept, tmp_path, capsys):
    def change(frame):
        frame.loc[frame["replication"] >= keep, "rmse_3d_m"] = math.nan
        return frame

    text = said(capsys, doctored(swept, tmp_path, change), "--baseline", "ekf_vmf")
    assert {0: "no rmse_3d_m of", 1: "too few pairs", 2: "only 2 of 60 replications have both"}[
        keep
    ] in text


def test_equal_estimators_are_said_to_be_equal(swept, tmp_path, capsys):
    def change(frame):
        frame["rmse_3d_m"] = np.tile(np.arange(60.0), 3)
        frame["rmse_z_m"] = 0.0
        return frame

    out = doctored(swept, tmp_path, change)
    assert said(capsys, out).count("is equal to") == 8
    assert said(capsys, out, "--metric", "rmse_z_m").count("is equal to") == 8


def test_a_zero_baseline_is_compared_in_the_metrics_own_unit(swept, tmp_path, capsys):
    def change(frame):
        frame["rmse_z_m"] = np.where(
            frame["estimator"] == "ekf_vmf", 0.0, 1.0 + 0.1 * (frame["replication"] % 7)
        )
        return frame

    text = said(
        capsys, doctored(swept, tmp_path, change), "--baseline", "ekf_vmf", "--metric", "rmse_z_m"
    )
    assert "ukf_vmf is worse than ekf_vmf by 1.2" in text
    assert " m [" in text


def test_one_estimator_is_nothing_to_compare(tmp_path, capsys):
    aoabench.run("filter=[ekf_vmf]", "reps=5", out=tmp_path)
    assert "nothing to compare, ekf_vmf is its only estimator" in said(capsys, tmp_path)
    assert aoabench.compare(tmp_path).empty
    aoabench.run("filter=[ekf_ae_fitted,ukf_vmf]", "noise.sigma_deg=3", "reps=5", out=tmp_path)
    text = said(capsys, tmp_path, "--baseline", "ukf_vmf")
    assert "nothing to compare, ekf_vmf is its only estimator" in text
    assert "than ukf_vmf by" in text or "and ukf_vmf: no difference" in text
    aoabench.run("filter=[ekf_ae_fitted]", "reps=5", out=tmp_path)
    text = said(capsys, tmp_path, "--baseline", "ukf_vmf")
    assert "nothing to compare, ukf_vmf is not among its estimators" in text


@pytest.mark.parametrize(("words", "says"), [
    (["--metric", "rsme_3d_m"], ["metric=rsme_3d_m", "did you mean 'rmse_3d_m'"]),
    (["--metric", "outcome"], ["metric=outcome", "allowed: rmse_3d_m"]),
    (["--baseline", "ekf_vmv"], ["baseline=ekf_vmv", "did you mean 'ekf_vmf'"]),
])  # fmt: skip
def test_mistakes_are_one_line_and_status_2(words, says, swept, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["compare", str(swept), *words])
    err = capsys.readouterr().err
    assert stop.value.code == 2
    assert len(err.strip().splitlines()) == 1
    assert all(word in err for word in says), err


# --- the tidy table -------------------------------------------------------------------------------


def test_a_sweep_ends_as_one_tidy_table(swept):
    tidy = pd.read_parquet(swept / "tidy.parquet")
    assert len(tidy) == 4 * 3 * 60
    assert set(tidy["noise.sigma_deg"]) == {5, 10}
    by = ["cell", "estimator", "replication"]
    a, b = (f.sort_values(by).reset_index(drop=True) for f in (tidy, aoabench.load(swept)))
    pd.testing.assert_frame_equal(a, b)


def test_collect_makes_the_tables_again(swept, tmp_path, capsys):
    out = tmp_path / "run"
    shutil.copytree(swept, out)
    before = {
        name: pd.read_parquet(out / f"{name}.parquet")
        for name in ("tidy", "summary", "cells", "timing")
    }
    for name in ("tidy.parquet", "summary.parquet", "cells.parquet", "timing.parquet"):
        (out / name).unlink()
    shutil.rmtree(out / "replications.parquet")
    assert dispatch(["collect", str(out)]) == 0
    assert "4 cells" in capsys.readouterr().out
    for name, frame in before.items():
        pd.testing.assert_frame_equal(pd.read_parquet(out / f"{name}.parquet"), frame)
    with pytest.raises(aoabench.UserError, match="no results"):
        dispatch(["collect", str(tmp_path / "nowhere")])
    assert not (tmp_path / "nowhere").exists()
    next((out / "parts").rglob("*.rows.*.parquet")).unlink()
    with pytest.raises(aoabench.RunError, match="run the same command again"):
        dispatch(["collect", str(out)])


def test_columns_hold_one_kind_of_value():
    mixed = pd.Series(["auto", 3, None, 0.5], dtype=object)
    assert list(tables.one_kind(mixed).dropna()) == ["auto", "3", "0.5"]
    for same in ([1, 2.5, None], ["a", None], [True, False]):
        values = pd.Series(same)
        assert tables.one_kind(values) is values
    assert json.loads(tables.one_kind(pd.Series([True, 2], dtype=object))[0]) is True


def test_a_comparison_shows_means_change_and_number(rng):
    better = rng.normal(1.0, 0.1, 50)
    worse = better + rng.normal(0.1, 0.02, 50)
    pair = statistics.paired(worse, better)
    made = Comparison("rmse_3d_m", "ls", "ekf_vmf", 50, worse.mean(), better.mean(), pair, "replication")  # fmt: skip
    low, high = pair.percent.interval()
    change = 100 * (worse.mean() / better.mean() - 1)
    assert repr(made) == (
        f"Comparison(rmse_3d_m of ls against ekf_vmf: {worse.mean():.4g} and {better.mean():.4g}, "
        f"{change:+.2f} % [{low:+.2f}, {high:+.2f}], N = 50)"
    )
