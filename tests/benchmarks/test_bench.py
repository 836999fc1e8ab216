"""The bench: what is shown is what was measured, and libraries that are missing are left out."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aoabench.engine.draws import Draws
from benchmarks import cost, filters, harness, kernels, peers, show, snapshots
from benchmarks.__main__ import BEFORE, COMMITTED, PAGE, PARTS, merged
from benchmarks.timing import Laps, both_engines, cell_of, in_turn

ROOT = Path(__file__).parents[2]
FRAME = pd.read_parquet(ROOT / COMMITTED)
BEFORE_IT = pd.read_parquet(ROOT / BEFORE)


def test_the_page_holds_the_committed_table():
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    assert f"<!-- bench -->\n{show.markdown(FRAME, BEFORE_IT)}\n<!-- /bench -->" in text
    rows = show.markdown(FRAME).splitlines()[2:]
    assert all(" in " not in row.split("|")[1] for row in rows)
    assert any("fixes per second" in row for row in rows)


def test_a_table_replaces_the_one_between_the_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- bench -->\nold\nrows\n<!-- /bench -->\nafter\n")
    show.write_into(page, "| \\new |")
    assert page.read_text() == "before\n<!-- bench -->\n| \\new |\n<!-- /bench -->\nafter\n"


def test_new_rows_of_a_part_replace_its_old_ones_in_the_order_of_the_parts():
    old = pd.DataFrame({"part": ["kalman", "room", "room", "gone"], "value": [1.0, 2.0, 3.0, 9.0]})
    new = pd.DataFrame({"part": ["room"], "value": [4.0]})
    assert merged(old, "room", new)["value"].tolist() == [1.0, 4.0]
    assert merged(old, "memory", new.assign(part="memory"))["value"].tolist() == [
        1.0,
        2.0,
        3.0,
        4.0,
    ]
    assert merged(old, "room", new[:0])["value"].tolist() == [1.0], "nothing could be measured"
    assert merged(pd.DataFrame({"part": []}), "room", new)["value"].tolist() == [4.0]
    assert set(FRAME["part"]) == set(PARTS)


def test_actions_run_in_turn_and_the_first_call_is_not_counted(monkeypatch):
    calls, now = [], iter(np.arange(100.0))

    def action(name):
        return lambda: calls.append(name)

    monkeypatch.setattr("benchmarks.timing.time.perf_counter", lambda: next(now))
    found = in_turn({"a": action("a"), "b": action("b")}, repeats=2)
    assert "".join(calls) == "ababab"
    assert found == {"a": 1.0, "b": 1.0}


def test_the_pieces_of_a_particle_step_run(monkeypatch):
    pytest.importorskip("numba")
    monkeypatch.setattr(kernels, "CALLS", 1)
    for action in kernels.pieces().values():
        action()


@pytest.mark.parametrize("part", ["kalman", "particle", "snapshot", "room", "access_nodes"])
def test_each_part_that_times_estimators_gives_its_rows(part, monkeypatch):
    pytest.importorskip("numba")
    timed = []

    def once(actions, repeats):
        timed.extend(actions)
        return dict.fromkeys(actions, 1.0)

    for module in (filters, snapshots):
        monkeypatch.setattr(module, "in_turn", once)
    rows = list(PARTS[part](1))
    assert timed
    assert len(rows) >= 4
    assert all(np.isfinite(row.value) for row in rows)
    expected = FRAME[FRAME["part"] == part]["what"]
    assert {row.what for row in rows} <= set(expected)


def test_laps_of_both_engines_are_the_same_work():
    cell = cell_of("noise=vmf", filters=["ekf_vmf"])
    laps = both_engines(cell, ["ekf_vmf"], tiles=1, numpy_tiles=1)
    fast, slow = laps["ekf_vmf"], laps["ekf_vmf numpy"]
    assert fast.steps == slow.steps == 128 * 64
    assert (fast.estimator.engine, slow.estimator.engine) == ("auto", "numpy")
    assert np.array_equal(fast.batches[0].azimuth, slow.batches[0].azimuth)
    fast()
    slow()


def test_libraries_that_are_not_installed_are_left_out(monkeypatch):
    monkeypatch.setattr(peers, "version", lambda name: None)
    assert peers.available(None, None, 0.1, 10) == {}


@pytest.mark.parametrize("name", ["stonesoup", "filterpy", "particles", "jax"])
def test_other_libraries_do_the_same_work(name):
    """EKF: our positions. UKF: our RMSE within 1 %. PF: within four of its own deviations, 0.13 m."""
    pytest.importorskip(name)
    kinds = {kind: f"{kind.lower()}_ae_nominal" for kind in ("EKF", "UKF", "PF")}
    cell = cell_of("noise=vmf", filters=list(kinds.values()))
    truth, batch = Draws(cell.scenario, cell.noise, cell.seed).tile(0, 1)
    found = peers.available(cell.scenario, batch, np.deg2rad(10), 3000)
    (theirs,) = (laps for n, laps in found.items() if n.lower().replace(" ", "").startswith(name))
    np.random.seed(0)  # noqa: NPY002  what the libraries draw from

    def rmse(position):
        return np.sqrt(np.mean(np.sum((position - truth[0, :, :3]) ** 2, axis=-1)))

    for kind, estimator in kinds.items():
        if kind not in theirs:
            continue
        lap = Laps(cell, estimator, tiles=1)
        ours = lap.estimator(lap.batches[0], cell.scenario, lap.streams[0]).position[0]
        position = theirs[kind]()
        if kind == "EKF":
            assert np.allclose(position, ours, atol=1e-6)
        tolerance = 4 * 0.13 if kind == "PF" else 0.01 * rmse(ours)
        assert rmse(position) == pytest.approx(rmse(ours), abs=tolerance), kind


@pytest.mark.parametrize("power", [1.0, 0.5, 2.0])
def test_a_slope_is_the_power_of_the_upper_half(power):
    sizes = np.array([1.0, 10.0, 100.0, 1000.0])
    values = 3 * sizes**power
    values[0] = 50.0  # a fixed cost hides the smallest size
    assert cost.slope_of(sizes, values) == pytest.approx(power)


def test_the_cost_over_the_number_of_particles_has_a_row_for_each_size(monkeypatch, tmp_path):
    pytest.importorskip("numba")
    monkeypatch.setattr(cost, "PARTICLES", (10, 20, 40))
    rows = list(cost._sizes("particles", cost._particles(), "how"))
    sizes = [row for row in rows if row.what.endswith("in sizes")]
    assert [row.detail for row in sizes[:3]] == ["pf_vmf, 10", "pf_vmf, 20", "pf_vmf, 40"]
    assert len(rows) == len(sizes) + 2
    cost.draw(pd.DataFrame([asdict(row) for row in rows]), tmp_path / "cost.png")
    assert (tmp_path / "cost.png").stat().st_size > 1000


def test_the_harness_names_the_functions_that_cost_most():
    cell = cell_of("noise=vmf", own={"own": harness.nothing})
    text = harness._most(harness._block(cell, 2))
    assert text.count("%") == harness.SHOWN
    shares = [int(part.split()[-2]) for part in text.split(", ")]
    assert shares == sorted(shares, reverse=True)
    assert sum(shares) <= 100


def test_a_row_stands_beside_its_value_before():
    def of(value):
        columns = {"what": "a", "detail": "b", "value": value, "unit": "s", "target": "", "how": ""}
        return pd.DataFrame([columns])

    assert show.markdown(of(1.0), of(2.0)).splitlines()[-1] == "| a | b | 2 s | 1 s |  |  |"
    assert show.markdown(of(1.0)).splitlines()[-1] == "| a | b |  | 1 s |  |  |"
