"""The room's estimators and its noise: closed forms, scipy's optimiser, likelihoods, and the
channel's symptoms.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import minimize

from aoabench.config.compose import compose_cells
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.errors import BadValue, UserError
from aoabench.estimators.anchors import AnchorMean, BestAnchor, RssiAnchor, SingleAnchor
from aoabench.estimators.lines import AnchorDiscarding, LineLeastSquares
from aoabench.estimators.plane import on_plane
from aoabench.estimators.vmf_likelihood import VmfLikelihood
from aoabench.maths.geometry import euler, facing, in_frames, to_azel, wrap
from aoabench.noise.multipath import BleMultipath
from aoabench.types import Anchors, Batch, Outcome
from tests.helpers import Place, directions


def room(*words, noise="ae_normal", estimator="anchor_mean"):
    return compose_cells(
        ["scenario=ble_room", f"noise={noise}", f"estimator=[{estimator}]", *words]
    )[0]


def seen(points, anchors, error=0.0):
    """A batch (1, T, B) of the angles of points (T, 3), with errors (2, T, B) rad."""
    azimuth, elevation = (
        a for a in to_azel(*in_frames(points[None], anchors.position, anchors.rotation))
    )
    error = np.broadcast_to(error, (2, *azimuth.shape[1:]))
    return Batch(wrap(azimuth + error[0]), elevation + error[1], anchors)


def place(batch):
    """A scenario that knows no more than its anchors."""
    return Place(batch.anchors)


@pytest.fixture
def tilted(rng):
    """Five anchors above the plane z = 1 in arbitrary frames, and points on it."""
    s = np.column_stack([rng.uniform(0, 8, (5, 2)), rng.uniform(2, 4, 5)])
    points = np.column_stack([rng.uniform(0, 8, (40, 2)), np.ones(40)])
    return Anchors(s[None], facing(rng.normal(size=(5, 3)))[None]), points


# --- estimators -----------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", [
    SingleAnchor(1.0, horizon_deg=0.01, anchor=3), RssiAnchor(1.0, horizon_deg=0.01), AnchorMean(1.0, horizon_deg=0.01),
    AnchorMean(1.0, horizon_deg=0.01, anchors=[2, 5]), LineLeastSquares(), AnchorDiscarding(), VmfLikelihood(1.0),
    VmfLikelihood("free"),
], ids=lambda e: type(e).__name__)  # fmt: skip
def test_exact_angles_give_the_exact_position_in_any_frame(estimator, tilted, rng):
    anchors, points = tilted
    batch = replace(seen(points, anchors), rssi=rng.normal(size=(1, 40, 5)))
    found = estimator(batch, place(batch), None)
    assert np.all(found.outcome == Outcome.OK)
    assert np.allclose(found.position[0, :, :2], points[:, :2], atol=1e-5)


def test_a_ray_meets_the_plane_where_trigonometry_says():
    anchors = Anchors(np.array([[[1.0, 2.0, 3.0]]]), np.eye(3)[None, None])
    azimuth, depression = (
        np.deg2rad([30.0, -120.0, 10.0, 77.0]),
        np.deg2rad([45.0, 60.0, 0.5, -20.0]),
    )
    batch = Batch(azimuth[None, :, None], -depression[None, :, None], anchors)
    xy = on_plane(directions(batch), anchors, 0.5, np.deg2rad(2.0))[0, :, 0]
    reach = 2.5 / np.tan(
        np.maximum(depression, np.deg2rad(2.0))
    )  # the third is nearly level, the fourth looks up
    assert np.allclose(
        xy, np.array([1, 2]) + reach[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    )
    down = Batch(np.zeros((1, 1, 1)), np.full((1, 1, 1), -np.pi / 2), anchors)
    assert np.allclose(on_plane(directions(down), anchors, 0.5, 0.01), [1, 2])


def test_turning_the_world_turns_the_estimates(tilted, rng):
    anchors, points = tilted
    batch = seen(points, anchors, 0.05 * rng.standard_normal((2, 40, 5)))
    G = euler([0, 0, 0.7])
    turned = replace(batch, anchors=Anchors(anchors.position @ G.T, anchors.rotation @ G.T))
    for e in (
        SingleAnchor(1.0),
        AnchorMean(1.0),
        LineLeastSquares(),
        AnchorDiscarding(0.05),
        VmfLikelihood(1.0),
    ):
        a, b = (np.nan_to_num(e(x, place(x), None).position[0], nan=1.0) for x in (batch, turned))
        assert np.allclose(a @ G.T, b, atol=1e-4), type(e)


def test_line_least_squares_minimises_the_distances(tilted, rng):
    anchors, points = tilted
    batch = seen(points, anchors, 0.1 * rng.standard_normal((2, 40, 5)))
    u, s = directions(batch)[0], anchors.position[0, 0]
    found = LineLeastSquares()(batch, place(batch), None)

    def square(p, k):
        d = p - s
        return np.sum(d**2) - np.sum((d * u[k]).sum(-1) ** 2)

    for k in range(5):
        best = minimize(square, points[k], args=(k,), tol=1e-10)
        assert np.allclose(found.position[0, k], best.x, atol=1e-4)
        assert found.score[0, k] == pytest.approx(np.sqrt(best.fun / 5), rel=1e-6)


def test_azimuths_alone_are_bearing_lines_in_the_plane(rng):
    s = np.column_stack([rng.uniform(0, 6, (4, 2)), rng.uniform(1, 3, 4)])
    anchors = Anchors(s[None], np.broadcast_to(np.eye(3), (1, 4, 3, 3)))
    points = np.column_stack([rng.uniform(0, 6, (20, 2)), np.zeros(20)])
    batch = seen(points, anchors, 0.02 * rng.standard_normal((2, 20, 4)))
    batch = replace(batch, elevation=np.full_like(batch.elevation, np.nan))
    found = LineLeastSquares()(batch, place(batch), None)
    assert np.all(np.isnan(found.position[..., 2]))
    for k in range(20):
        n = np.column_stack([-np.sin(batch.azimuth[0, k]), np.cos(batch.azimuth[0, k])])
        best = np.linalg.lstsq(n, (n * s[:, :2]).sum(1), rcond=None)[0]
        assert np.allclose(found.position[0, k, :2], best)


def test_lines_that_determine_nothing_fail():
    one = Anchors(np.zeros((1, 2, 3)), np.broadcast_to(np.eye(3), (1, 2, 3, 3)))
    parallel = Batch(np.full((1, 1, 2), 0.3), np.full((1, 1, 2), -0.2), one)
    nothing = Batch(np.full((1, 1, 2), np.nan), np.full((1, 1, 2), np.nan), one)
    for batch in (parallel, nothing):
        for e in (LineLeastSquares(), AnchorDiscarding(), VmfLikelihood("free")):
            assert e(batch, place(batch), None).outcome[0, 0] == Outcome.FAILED
    for e in (SingleAnchor(1.0), AnchorMean(1.0), RssiAnchor(1.0)):
        assert (
            e(replace(nothing, rssi=np.zeros((1, 1, 2))), place(nothing), None).outcome[0, 0]
            == Outcome.FAILED
        )


def test_discarding_finds_the_one_wrong_anchor(tilted):
    anchors, points = tilted
    error = np.zeros((2, 40, 5))
    error[:, np.arange(40), np.arange(40) % 5] = 0.4
    batch = seen(points, anchors, error)
    found, kept = (
        AnchorDiscarding(1e-3)(batch, place(batch), None),
        LineLeastSquares()(batch, place(batch), None),
    )
    hit = np.linalg.norm(found.position[0] - points, axis=-1) < 1e-6
    assert hit.mean() > 0.8  # an outlier next to its anchor hides among the distances
    assert np.all(found.anchors_used[0, hit] == 4)
    assert np.linalg.norm(kept.position[0] - points, axis=-1).min() > 1e-3
    assert np.all(AnchorDiscarding(0.0)(batch, place(batch), None).anchors_used >= 2)


@pytest.mark.parametrize("free", [False, True])
def test_vmf_likelihood_is_what_scipy_maximises(free, tilted, rng):
    anchors, points = tilted
    batch = seen(points, anchors, 0.15 * rng.standard_normal((2, 40, 5)))
    batch = replace(
        batch, azimuth_sigma=np.broadcast_to(rng.uniform(0.05, 0.3, 5), batch.azimuth.shape)
    )
    found = VmfLikelihood("free" if free else 1.0, tolerance_m=1e-7)(batch, place(batch), None)
    u, s, kappa = directions(batch)[0], anchors.position[0, 0], 1 / batch.azimuth_sigma[0, 0] ** 2

    def minus_log(p, k):
        x = p if free else np.append(p, 1.0)
        d = (x - s) / np.linalg.norm(x - s, axis=-1, keepdims=True)
        return -sum(stats.vonmises_fisher(u[k, j], kappa[j]).logpdf(d[j]) for j in range(5))

    for k in range(6):
        at = found.position[0, k] if free else found.position[0, k, :2]
        best = minimize(
            minus_log, at, args=(k,), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10}
        )
        assert np.allclose(at, best.x, atol=1e-4)


def test_selectors_select(rng):
    cell = room(
        "scenario.packets=10",
        noise="ble_multipath",
        estimator="single_anchor_1,single_anchor_2,single_anchor_3",
    )
    truth, batch = Draws(cell.scenario, cell.noise, 1).tile(0, 2)
    single = np.stack(
        [e(batch, cell.scenario, None).position[..., :2] for e in cell.estimators.values()], axis=2
    )
    e = np.hypot(*np.moveaxis(single - truth[:, :, None, :2], -1, 0))
    best = BestAnchor()(batch, cell.scenario, None, truth)
    assert np.allclose(
        np.hypot(*np.moveaxis(best.position[..., :2] - truth[..., :2], -1, 0)), np.nanmin(e, axis=2)
    )
    strongest = np.nanargmax(np.where(np.isfinite(batch.rssi), batch.rssi, -1e9), axis=-1)
    chosen = np.take_along_axis(single, strongest[..., None, None], axis=2)[:, :, 0]
    assert np.allclose(RssiAnchor()(batch, cell.scenario, None).position[..., :2], chosen)
    mean = AnchorMean()(batch, cell.scenario, None)
    assert np.allclose(mean.position[..., :2], np.nanmean(single, axis=2))
    with pytest.raises(UserError, match="signal strengths"):
        RssiAnchor()(replace(batch, rssi=None), cell.scenario, None)


def test_clipping_is_a_flag():
    words = ("noise.sigma_deg=25", "scenario.packets=20")
    names = ("single_anchor_1", "anchor_mean", "ls_lines", "vmf_ml", "discrepancy")
    inside = {}
    for clip in ("true", "false"):
        clips = [f"estimator.{name}.clip={clip}" for name in names]
        cell = room(*words, *clips, estimator=",".join(names))
        _, batch = Draws(cell.scenario, cell.noise, 1).tile(0, 1)
        for name in names:
            xy = cell.estimators[name](batch, cell.scenario, None).position[..., :2]
            inside[name, clip] = np.all((xy >= 0) & (xy <= [7.2, 8.5]) | np.isnan(xy))
    for name in names:
        assert inside[name, "true"], name
        if name != "discrepancy":  # its far ellipses seldom agree
            assert not inside[name, "false"], name


@pytest.mark.parametrize(("words", "says"), [
    (["estimator=[anchor_mean]", "scenario=bs_grid"], r"scenario='bs_grid' .* a known height, or a height_m .* estimator.anchor_mean needs"),
    (["estimator=[anchor_mean]", "estimator.anchor_mean.height_m=2.8"], r"height_m=2.8 .*other than that of anchor 1"),
    (["estimator=[single_anchor_1]", "estimator.single_anchor_1.anchor=4"], r"anchor=4 .* <= 3"),
    (["estimator=[anchor_mean]", "estimator.anchor_mean.anchors=[1,1]"], r"anchors=\[1, 1\]"),
    (["estimator=[anchor_mean]", "estimator.anchor_mean.anchors=[7]"], r"anchors=7"),
    (["estimator=[vmf_ml]", "estimator.vmf_ml.height_m=low"], r"height_m='low' .* or free"),
    (["estimator=[anchor_mean]", "noise.pull=[-1]"], r"noise.pull=.* numbers >= 0"),
    (["estimator=[anchor_mean]", "noise.disturbed=[0.2,1.5]"], r"noise.disturbed=.* shares from 0 to 1"),
    (["estimator=[anchor_mean]", "noise.correlation_m=0"], r"noise.correlation_m=0"),
    (["estimator=[anchor_mean]", "scenario.days=3", "scenario.packets=2"], r"scenario.days=3"),
    (["estimator=[anchor_mean]", "scenario.points_m=[[9,1]]"], r"points_m\[0\]=\[9.0, 1.0\]"),
])  # fmt: skip
def test_what_does_not_fit_is_told_before_the_run(words, says):
    with pytest.raises((BadValue, UserError), match=says):
        compose_cells(["scenario=ble_room", "noise=ble_multipath", *words])


# --- noise ----------------------------------------------------------------------------------------


def quiet(**more):
    """The noise model with everything at zero, but for what is given."""
    return BleMultipath(**({
        "azimuth_noise_deg": 1e-9, "elevation_noise_deg": 1e-9, "steep_deg": 0, "azimuth_bias_deg": 0, "elevation_bias_deg": 0,
        "azimuth_day_deg": 0, "elevation_day_deg": 0, "disturbed": (0, 0), "outliers": 0, "lost": 0, "shadowing_db": 0,
        "fading_db": 0,
    } | more))  # fmt: skip


def errors(noise, *words, reps=4):
    """Angle errors (2, R, T, B) deg, the batch and the scenario."""
    cell = room(*words)
    truth, batch = Draws(cell.scenario, noise, 1).tile(0, reps)
    true = to_azel(*in_frames(truth[..., :3], batch.anchors.position, batch.anchors.rotation))
    return (
        np.rad2deg([wrap(batch.azimuth - true[0]), batch.elevation - true[1]]),
        batch,
        cell.scenario,
        true,
    )


def test_without_its_parts_the_noise_is_none():
    e, batch, scenario, _ = errors(quiet(), "scenario.packets=4")
    assert np.abs(e).max() < 1e-6
    d = np.linalg.norm(
        scenario.truth(None)[:, None, :3] - scenario.true_anchors.position[0, 0], axis=-1
    )
    assert np.allclose(batch.rssi, -45 - 20 * np.log10(d))


def test_far_elevations_are_too_steep_by_the_stated_amount():
    e, _, _, true = errors(quiet(steep_deg=12, steep_power=2), "scenario.packets=2")
    flat = 1 - np.abs(np.rad2deg(true[1])) / 90
    assert np.allclose(e[1], -12 * flat**2)
    assert np.allclose(e[0], 0, atol=1e-6)


def test_noise_grows_towards_the_pole():
    """Deviation within 5 %: 4 x 42 x 400 draws, the chance of a false alarm is below 1e-6 per
    group.
    """
    e, _, _, true = errors(
        quiet(azimuth_noise_deg=2, elevation_noise_deg=3), "scenario.packets=400"
    )
    c = np.maximum(np.cos(true[1]), 0.3)
    assert np.std(e[0] * c) == pytest.approx(2, rel=0.03)
    assert np.std(e[0][c < 0.5]) > 1.5 * np.std(e[0][c > 0.9])
    assert np.std(e[1]) == pytest.approx(3, rel=0.02)


def test_fields_have_the_stated_deviation_and_correlation(rng):
    """300 fields at 2 points: |rho - exp(-d^2 / 2 l^2)| < 0.25 is four standard errors, a false
    alarm 1e-4.
    """
    noise = BleMultipath(correlation_m=1.5)
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [9.0, 0, 0]])
    f = np.concatenate(
        [noise._fields(rng, points, (10, 10)).reshape(3, -1) for _ in range(3)], axis=1
    )
    assert np.allclose(f.std(axis=1), 1, atol=0.2)
    assert np.corrcoef(f)[0, 1] == pytest.approx(np.exp(-1 / 4.5), abs=0.25)
    assert abs(np.corrcoef(f)[0, 2]) < 0.25


def test_biases_belong_to_the_campaign_and_the_place():
    e, _, scenario, _ = errors(
        quiet(azimuth_bias_deg=5, bias_scale=(1.0, 0.0, 2.0)), "scenario.packets=6"
    )
    by_point = e[0].reshape(4, 42, 6, 3)
    assert np.allclose(by_point, by_point[:, :, :1], atol=1e-6)
    assert np.all(np.std(by_point[:, :, 0, 0], axis=0) > 0.1), "another campaign, another channel"
    assert np.allclose(by_point[..., 1], 0, atol=1e-6)
    day, _, _, _ = errors(quiet(elevation_day_deg=4), "scenario.packets=6")
    each = day[1].reshape(4, 42, 2, 3, 3)
    assert np.allclose(each, each[:, :1, :, :1], atol=1e-6)
    assert np.abs(each[:, 0, 0, 0] - each[:, 0, 1, 0]).min() > 0.01
    assert scenario.day_of(len(scenario.truth(None))).reshape(42, 2, 3).std(axis=(0, 2)).max() == 0


def test_disturbed_packets_are_pulled_at_all_anchors_at_once():
    """A share of 0.25 of 4 x 42 x 200 packets: five standard errors are 0.012."""
    e, _, _, _ = errors(quiet(disturbed=(0.25, 0.0), pull=(0.5,)), "scenario.packets=400")
    moved = (np.hypot(*e) > 1e-7).reshape(4, 42, 2, 200, 3)
    assert not moved[:, :, 1].any()
    assert np.all(moved.all(-1) == moved.any(-1))
    assert moved[:, :, 0].any(-1).mean() == pytest.approx(0.25, abs=0.012)


def test_a_full_pull_points_at_a_wall_image():
    e, batch, scenario, _ = errors(
        quiet(disturbed=(1, 1), pull=(1e9,), pull_spread=0), "scenario.packets=2", reps=1
    )
    p, s = scenario.truth(None)[:, :3], scenario.true_anchors.position[0, 0]
    images = np.stack(
        [p * [-1, 1, 1], p * [-1, 1, 1] + [14.4, 0, 0], p * [1, -1, 1], p * [1, -1, 1] + [0, 17, 0]]
    )
    azimuth = np.arctan2(*np.moveaxis(images[:, :, None, :2] - s[:, :2], -1, 0)[::-1])
    off = np.abs(wrap(batch.azimuth[0] - azimuth)).min(axis=0)
    assert off.max() < 1e-6


def test_outliers_losses_and_strength():
    """Shares within five standard errors of 4 x 4200 x 3 draws."""
    e, batch, _, _ = errors(quiet(outliers=0.1, outlier_deg=20, lost=0.05))
    there = np.isfinite(batch.azimuth)
    n = there.size
    assert 1 - there.mean() == pytest.approx(0.05, abs=5 * np.sqrt(0.05 * 0.95 / n))
    assert np.array_equal(there, np.isfinite(batch.rssi))
    out = np.abs(e[1][there]) > 1e-5
    assert out.mean() == pytest.approx(0.1, abs=5 * np.sqrt(0.09 / there.sum()))


def test_the_same_draws_whatever_the_parameters(rng):
    cell = room("scenario.packets=3")
    others = quiet(azimuth_noise_deg=1.0, elevation_bias_deg=5, outlier_deg=3, fading_db=2)
    a, b = (
        Draws(cell.scenario, noise, 1).tile(0, 1)[1]
        for noise in (quiet(azimuth_noise_deg=1.0), others)
    )
    assert np.array_equal(a.azimuth, b.azimuth)


def test_a_campaign_is_reproducible_and_tiles_do_not_matter():
    cell = room(noise="ble_multipath", estimator="anchor_mean,discrepancy,vmf_ml")
    whole = run_block(cell.scenario, cell.noise, cell.estimators, 1, 0, 3)
    part = run_block(cell.scenario, cell.noise, cell.estimators, 1, 2, 3)
    for name, block in whole.items():
        assert np.array_equal(
            block["fixes"]["error_xy_m"][2], part[name]["fixes"]["error_xy_m"][0], equal_nan=True
        )
        assert np.allclose(
            block["rows"]["rmse_3d_m"], block["rows"]["rmse_xy_m"], rtol=1e-12, atol=0
        ), "a method in the plane"
        assert np.all(np.isnan(block["rows"]["rmse_z_m"]))
