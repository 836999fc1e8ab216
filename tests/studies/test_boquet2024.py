"""The Boquet 2024 study: closed forms behind its figures, its errata, and its numbers on made-up
fixes.
"""

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy import integrate, stats

from aoabench import bounds
from aoabench.config.compose import compose_cells
from aoabench.engine.tiles import Draws
from aoabench.estimators.discrepancy import Discrepancy
from aoabench.maths.geometry import to_azel
from aoabench.resources import shipped
from aoabench.store.fixes import Fixes
from aoabench.studies import study
from aoabench.types import Anchors, Batch, Outcome
from tests.helpers import Place

STUDY = study.load("boquet2024")
numbers, figures = STUDY.numbers, STUDY.figures
common = numbers.common
NAN = np.nan


def made(error, rejected=(), score=NAN, used=3.0):
    """Fixes (R, T) with these errors; some of them rejected."""
    e = np.array(error, dtype=float)
    outcome = np.zeros(e.shape, dtype=np.int8)
    for index in rejected:
        e[index], outcome[index] = NAN, Outcome.REJECTED
    full = [np.broadcast_to(np.asarray(v, dtype=float), e.shape).copy() for v in (NAN, score, used)]
    full[2][outcome == Outcome.REJECTED] = 0
    return Fixes(e, e, *full, outcome)


def angles_of(p, s):
    """A batch of one fix: exact angles of p (3,) from upright anchors s (B, 3)."""
    s = np.atleast_2d(s)
    azimuth, elevation = to_azel(*(np.asarray(p) - s).T)
    return Batch(
        azimuth[None, None],
        elevation[None, None],
        Anchors(s[None], np.eye(3)[None, None].repeat(len(s), 1)),
    )


def place(batch, height=0.0):
    return Place(batch.anchors, height)


# --- Figures 2 and 3 ------------------------------------------------------------------------------


def test_gdop_is_that_of_the_printed_jacobian_put_right(rng):
    """(29)-(34) with a gradient in each column, the row of the known z left out, M = J W^-1 J^T:
    errata B6, B7.
    """
    s = np.array([[1.0, 2, 3], [6, 1, 2.5]])
    p = np.array([4.0, 5.0, 0.0])
    M = np.zeros((2, 2))
    for x, y, z in p - s:
        d, rho2 = np.sqrt(x * x + y * y + z * z), x * x + y * y
        root = d**3 * np.sqrt(1 - (z / d) ** 2)
        J = np.array([[-y / rho2, -x * z / root], [x / rho2, -y * z / root]])
        M += J @ J.T
    anchors = Anchors(s[None], np.broadcast_to(np.eye(3), (1, 2, 3, 3)))
    assert bounds.gdop(p, anchors, known_z=True) == pytest.approx(
        np.sqrt(np.trace(np.linalg.inv(M)))
    )
    zeroed = np.zeros((3, 3))
    zeroed[:2, :2] = M
    assert np.linalg.matrix_rank(zeroed) == 2, "a row of zeros has no inverse"


@pytest.fixture(scope="module")
def fig2():
    return numbers.fig2("quick")


def test_the_text_on_one_anchor_holds(fig2):
    """sqrt(h^2) = 3 m below it; sqrt(3) times that where u = rho^2 solves u^2 + 27 u - 162 = 0."""
    values = figures.fig2_values(fig2)
    assert values["fig2/minimum"].value == pytest.approx(3.0, abs=1e-6)
    assert values["fig2/root3"].value == pytest.approx(
        np.sqrt((-27 + np.sqrt(27**2 + 4 * 162)) / 2), abs=1e-6
    )
    assert all(values[f"fig2/{n}/more"].value > 0 for n in ("two", "three", "four"))


def test_percentile_of_the_far_anchor_by_quadrature():
    """P(error of B <= 1.9 m) at (8.5, 3), by integrating over both normals; the samples agree
    within 4 s.e.
    """
    rows = numbers.fig3a("quick").set_index(["kind", "who"])
    q = rows.loc[("unclipped", "B")]
    rho, height = np.hypot(1.0, -2.0), 3.0

    def inside(elevation_error):
        depression = np.maximum(np.arctan2(height, rho) - elevation_error, np.deg2rad(0.1))
        reach = height / np.tan(depression)
        c = (reach**2 + rho**2 - q["q95_m"] ** 2) / (2 * reach * rho)
        half = np.arccos(np.clip(c, -1, 1)) if abs(c) < 1 else (np.pi if c <= -1 else 0.0)
        return stats.norm.pdf(elevation_error, scale=np.deg2rad(10)) * (
            2 * stats.norm.cdf(half, scale=np.deg2rad(10)) - 1
        )

    p = integrate.quad(inside, -1.2, 1.2, limit=400, points=[0.0])[0]
    density = 0.05 / q["q95_m"]  # a lower limit of the density there
    assert p == pytest.approx(
        0.95, abs=4 * max(q["q95_se"] * density * 4, np.sqrt(0.05 * 0.95 / 10_000))
    )


def test_the_rule_of_root_three():
    frame = numbers.rule("quick")
    assert np.all(np.abs(frame["ratio"] - frame["closed"]) < 5 * frame["ratio_se"])
    threshold = figures.rule_values(frame)["rule/threshold"]
    assert threshold.value == pytest.approx(np.sqrt(3), abs=4 * threshold.se)


# --- errata of the filter -------------------------------------------------------------------------


def test_two_pairs_tie_at_three_anchors():
    """B1: the middle ellipse meets both others, which do not meet: the vote ends in two pairs, and
    (19) decides.
    """
    s = np.array([[0.0, 0, 3], [0, 0, 3], [0, 0, 3]])
    x = np.array(
        [4.0, 5.0, 6.4]
    )  # radial places of one direction; the second is nearer to the first
    batch = Batch(
        np.zeros((1, 1, 3)),
        np.arctan2(-3, x)[None, None],
        Anchors(s[None], np.eye(3)[None, None].repeat(3, 1)),
    )
    options = {"r_sigma": 1.0, "azimuth_sigma_deg": 8, "elevation_sigma_deg": 4, "engine": "numpy"}
    first = Discrepancy(ties="first", **options)(batch, place(batch), None)
    area = Discrepancy(ties="area", **options)(batch, place(batch), None)
    swapped = Batch(batch.azimuth, batch.elevation[..., ::-1], batch.anchors)
    turned = Discrepancy(ties="first", **options)(swapped, place(batch), None)
    back = Discrepancy(ties="area", **options)(swapped, place(batch), None)
    assert first.anchors_used[0, 0] == area.anchors_used[0, 0] == 2
    assert abs(first.position[0, 0, 0] - turned.position[0, 0, 0]) > 0.5, (
        "the order of the anchors decides"
    )
    assert area.position[0, 0, 0] == pytest.approx(back.position[0, 0, 0]), (
        "their areas do not know it"
    )


def test_boxes_meet_where_ellipses_do_not():
    """B2: two slim ellipses at a right angle, corner to corner."""
    s = np.array([[0.0, 0, 3], [10, 0, 3]])
    for shift in np.linspace(0, 4, 41):
        p = np.array([[4.0, 4.0 + shift, 0], [6.0 - shift / 3, 4.0, 0]])
        batch = angles_of(p[0], s[0])
        other = angles_of(p[1], s[1])
        batch = Batch(
            np.concatenate([batch.azimuth, other.azimuth], -1), np.concatenate([batch.elevation, other.elevation], -1),
            Anchors(s[None], np.eye(3)[None, None].repeat(2, 1)),
        )  # fmt: skip
        found = [
            Discrepancy(0.4, intersection=kind)(batch, place(batch), None).outcome[0, 0]
            for kind in ("boxes", "exact")
        ]
        if found == [Outcome.OK, Outcome.REJECTED]:
            return
        assert found != [Outcome.REJECTED, Outcome.OK], "what meets, meets in its boxes too"
    raise AssertionError("no such pair found")


def test_the_midpoint_doubles_the_bias():
    """B3: for small sigma, E f(phi + e) - f is f'' sigma^2 / 2, and the midpoint adds as much
    again.
    """
    rng = np.random.default_rng(3)
    s, p, sigma = np.array([[0.0, 0, 3]]), np.array([4.0, 0, 0]), np.deg2rad(3)
    n = 400_000
    exact = angles_of(p, s)
    e = sigma * rng.standard_normal(n)
    batch = Batch(
        np.broadcast_to(exact.azimuth, (1, n, 1)), exact.elevation + e[None, :, None], Anchors(s[None], np.eye(3)[None, None])
    )  # fmt: skip
    bias = {}
    for centre in ("midpoint", "estimate"):
        f = Discrepancy(1.0, elevation_sigma_deg=3, vote=False, centre=centre)
        x = f(batch, place(batch), None).position[0, :, 0] - 4.0
        bias[centre] = x.mean(), x.std() / np.sqrt(n)
    second = (
        3 * np.cos(np.arctan2(3, 4)) / np.sin(np.arctan2(3, 4)) ** 3 * sigma**2
    )  # f'' sigma^2 / 2, f = 3 cot
    assert bias["estimate"][0] == pytest.approx(second, abs=5 * bias["estimate"][1] + 0.1 * second)
    assert bias["midpoint"][0] == pytest.approx(
        2 * second, abs=5 * bias["midpoint"][1] + 0.2 * second
    )


def test_beyond_the_horizon_rays_are_turned_down():
    """B4: elevation plus deviation above the horizon meets no plane; limited, it meets it at h /
    tan(horizon).
    """
    s = np.array([[0.0, 0, 3]])
    batch = Batch(
        np.zeros((1, 1, 1)),
        np.deg2rad(-5.0)[None, None, None] * np.ones((1, 1, 1)),
        Anchors(s[None], np.eye(3)[None, None]),
    )
    f = Discrepancy(1.0, elevation_sigma_deg=11.1, vote=False, horizon_deg=2.0)
    x = f(batch, place(batch), None).position[0, 0, 0]
    reach = [3 / np.tan(np.deg2rad(d)) for d in (2.0, 16.1)]
    assert x == pytest.approx(np.mean(reach))


def test_the_major_axis_points_away_from_the_anchor():
    """B5: alpha counter-clockwise from x, so that the long axis of a far ellipse lies along the
    line of sight.
    """
    for turn in np.deg2rad([0, 30, 100, -140]):
        p = 6 * np.array([np.cos(turn), np.sin(turn), 0])
        batch = angles_of(p, np.array([0.0, 0, 3]))
        P = Discrepancy(1.0, vote=False)(batch, place(batch), None).covariance[0, 0, :2, :2]
        long = np.linalg.eigh(P)[1][:, 1]
        assert abs(long @ p[:2]) == pytest.approx(6, rel=1e-6)


# --- the campaign ---------------------------------------------------------------------------------


def test_as_many_measurements_arrive_as_printed():
    """B8: 292 303 of 3 x 42 x 2400, within five standard deviations of a binomial."""
    cell = compose_cells(
        [
            "scenario=ble_room",
            "scenario.packets=2400",
            "noise=ble_multipath",
            "estimator=[anchor_mean]",
        ]
    )[0]
    _, batch = Draws(cell.scenario, cell.noise, 1).tile(0, 1)
    n, p = batch.azimuth.size, cell.noise.lost
    assert n == 302_400
    assert abs(np.isfinite(batch.azimuth).sum() - 292_303) < 5 * np.sqrt(n * p * (1 - p))


def test_the_grids_are_whole_and_lie_as_printed():
    grids = common.printed_grids()
    points = compose_cells(["scenario=ble_room", "estimator=[anchor_mean]"])[0].scenario.points_m
    for name, grid in grids.items():
        assert grid.shape == (42,), name
        assert np.all((grid > 0.1) & (grid < 3.5))
    at = {tuple(p): i for i, p in enumerate(points)}
    assert grids["single_anchor_2"][at[0.6, 7.85]] == 0.18
    assert grids["vmf_ml"][at[6.6, 0.65]] == 1.51
    near = np.array([np.hypot(x - 1.8, y - 6.9) for x, y in points])
    assert np.corrcoef(near, grids["single_anchor_2"])[0, 1] > 0.7, (
        "A2's errors grow with the distance from anchor 2"
    )


# --- numbers on made-up fixes ---------------------------------------------------------------------


def test_both_readings_of_the_discard_ratio():
    """B9."""
    f = made(np.ones((2, 4)), rejected=[(0, 0), (1, 1)], used=2.0)
    whole = made(np.ones((2, 4)), used=3.0)
    assert common.lost(f).value == pytest.approx(2 / 8)
    assert common.discarded(f, whole).value == pytest.approx(1 - 12 / 24)


def test_shares_count_given_fixes_alone():
    f = made([[0.5, 2.0, 0.5, 3.0], [0.5, 0.5, 0.5, 3.0]], rejected=[(0, 3)])
    assert common.within(common.error(f)).value == pytest.approx(5 / 7)


def test_differences_are_paired(rng):
    """Two methods with the same good and bad campaigns: the paired error is far below the single
    ones.
    """
    bad = rng.random((50, 1)) < 0.5
    a = np.where(bad & (rng.random((50, 100)) < 0.9), 2.0, 0.5)
    b = np.where(rng.random(a.shape) < 0.02, 2.0, a)
    d = numbers.comparisons.difference(a, b)
    assert d.value == pytest.approx((a <= 1).mean() - (b <= 1).mean())
    assert d.se < 0.2 * common.within(a).se
    assert numbers.comparisons.difference(a, a).se == 0


def test_thresholds_keep_the_best_scores_up_to_the_coverage():
    e = np.array([[1.0, 2, 3, 4]])
    f = made(e, score=[[0.4, 0.1, NAN, 0.2]])
    assert np.array_equal(
        np.isfinite(numbers.comparisons.thresholded(f, 0.5)), [[False, True, False, True]]
    )
    assert np.array_equal(
        np.isfinite(numbers.comparisons.thresholded(f, 0.75)), [[True, True, False, True]]
    )
    assert np.all(np.isfinite(numbers.comparisons.thresholded(f, 1.0))), (
        "what cannot tell comes last"
    )


def campaign(rng, R=5, P=42, K=4):
    """Made-up fixes of every estimator of the experiment: DF the better, the fewer it accepts."""
    base = np.abs(rng.normal(0, 0.8, (R, P * K)))
    spec = yaml.safe_load((shipped("configs") / "experiment/boquet2024_methods.yaml").read_text())
    names = [*spec["defaults"][2]["override /estimator"], *spec["estimator"]]
    fixes = {}
    for name in names:
        reject = []
        if name[-2:].isdigit():
            reject = list(zip(*np.nonzero(base > 0.3 + 0.1 * int(name[-2:]))))
        fixes[name] = made(
            base + 0.05 * rng.random(base.shape),
            reject,
            score=base if name in numbers.SCORED else NAN,
        )
    return fixes


def test_every_item_computes_draws_and_tells_its_printed_numbers(rng, fig2):
    import matplotlib.pyplot as plt

    cell = compose_cells(["experiment=boquet2024_methods", "scenario.packets=4", "reps=5"])[0]
    fixes = campaign(rng)
    assert set(fixes) == set(cell.estimators)
    found = {}
    for item in STUDY.items:
        if item.reads == "fixes":
            frame = getattr(numbers, item.name)([(cell, fixes)])
        elif item.name == "speed":
            frame = pd.DataFrame(
                {
                    "method": [*numbers.METHODS, "discrepancy", "discrepancy_exact"],
                    "us_per_fix": 1.0,
                    "us_se": 0.1,
                }
            )
        elif item.name == "fig3b":
            frame = pd.DataFrame(
                {"x_m": [1, 2, 1, 2], "y_m": [1, 1, 2, 2], "single_m": 1.0, "single_se": 0.0, "pair_m": [0.5, 2, 1, 2], "pair_se": 0.0}
            )  # fmt: skip
        elif item.name == "fig2":
            frame = fig2
        else:
            frame = getattr(numbers, item.name)("quick")
        if item.figure:
            plt.close(getattr(figures, item.name)(frame))
        found |= getattr(figures, f"{item.name}_values", lambda frame: {})(frame)
    missing = [e["id"] for e in STUDY.printed if e["id"] not in found]
    assert not missing
    assert found["fig6/lost/least step"].value >= 0
    assert found["ranking/all/single_anchor_1/vmf_ml"].value == pytest.approx(0, abs=10)


def test_figure_7_shows_both_readings(rng):
    """B10."""
    frame = numbers.fig7([(None, campaign(rng))])
    shown = [m for m in frame["method"].unique() if m.startswith("df")]
    assert any("R_sigma = 0.2" in m for m in shown)
    assert any("R_d = 0.2" in m for m in shown)
