"""`locate` on recordings: positions, deviations, residuals, files and what it says."""

import io
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.deployment import files, fixes, located, plans, summary
from aoabench.deployment.request import Request
from aoabench.deployment.solving import Residuals
from aoabench.devices.geodesy import Origin
from aoabench.errors import UserError
from aoabench.roles import PlainEstimator
from tests.deployment.conftest import ANCHORS, POINTS, angles, rows_of


def located_in(log, room, *settings, max_sigma_m=None, **more):
    request = Request(str(log), str(room / "anchors.csv"), settings=settings, **more)
    return located.locate(request.asked(), max_sigma_m)


def test_exact_angles_give_the_points(room, log):
    found = located_in(log(rows_of(POINTS)), room)
    frame = found.frame
    assert list(frame) == list(fixes.COLUMNS)
    assert np.allclose(frame[["x_m", "y_m", "z_m"]], POINTS, atol=1e-4)
    assert (frame["outcome"] == "ok").all()
    assert (frame["anchors_heard"] == 4).all()
    assert frame["residual_azimuth_deg"].max() < 1e-3
    assert not found.with_truth


def test_ellipses_are_the_eigenvalues_of_the_covariance(room, log, rng):
    noisy = [angles(p, a) for p in POINTS for a in ANCHORS] + rng.normal(0, 4, (16, 2))
    rows = [f"{i // 4},{list(ANCHORS)[i % 4]},{a},{e}" for i, (a, e) in enumerate(noisy)]
    frame = located_in(log(rows), room).frame
    for row in frame.to_dict("records"):
        P = np.array([[row["cov_xx_m2"], row["cov_xy_m2"]], [row["cov_xy_m2"], row["cov_yy_m2"]]])
        spread, axes = np.linalg.eigh(P)
        assert np.allclose(
            [row["sigma_minor_m"], row["sigma_major_m"]], np.sqrt(spread), rtol=1e-9, atol=0
        )
        along = np.radians(row["ellipse_deg"])
        assert abs(axes[:, 1] @ [np.cos(along), np.sin(along)]) == pytest.approx(1, abs=1e-9)


def test_residuals_are_measured_less_expected(room, log, rng):
    noise = rng.normal(0, 3, (16, 2))
    exact = np.array([angles(p, a) for p in POINTS for a in ANCHORS])
    rows = [f"{i // 4},{list(ANCHORS)[i % 4]},{a},{e}" for i, (a, e) in enumerate(exact + noise)]
    found = located_in(log(rows), room)
    at = found.frame[["x_m", "y_m", "z_m"]].to_numpy()
    for k, anchor, azimuth, elevation in zip(*vars(found.residuals).values()):
        i = 4 * k + anchor
        a, e = exact[i] + noise[i] - angles(at[k], list(ANCHORS)[anchor])
        assert np.degrees(azimuth) == pytest.approx((a + 180) % 360 - 180, abs=1e-6)
        assert np.degrees(elevation) == pytest.approx(e, abs=1e-6)
    rms = np.sqrt(pd.Series(found.residuals.azimuth**2).groupby(found.residuals.fix).mean())
    assert np.allclose(np.radians(found.frame["residual_azimuth_deg"]), rms, rtol=1e-9, atol=0)


def test_a_lost_packet_is_one_fix_and_a_reason(room, log):
    rows = rows_of(POINTS)
    found = located_in(
        log([rows[0], *rows[4:]]), room, "scenario.height_m=1.1", estimator="ls_lines"
    )
    outcome = found.frame["outcome"].tolist()
    assert outcome == ["failed", "ok", "ok", "ok"]
    text = "\n".join(summary.lines(found.frame, "ls_lines"))
    assert "4 fixes, 3 with a position (75 %)" in text
    assert "1 failed (25 %): fewer anchors measured" in text
    assert "nan" not in text


def test_max_sigma_rejects_and_keeps_the_place_for_the_map(room, log):
    path = log(rows_of(POINTS))
    every = located_in(path, room).frame
    limit = every["sigma_major_m"].median()
    found = located_in(path, room, max_sigma_m=limit)
    away = every["sigma_major_m"] > limit
    assert 0 < away.sum() < len(away)
    assert (found.frame["outcome"] == np.where(away, "rejected", "ok")).all()
    assert found.frame["x_m"].isna().equals(away)
    assert (found.frame["reason"][away] == fixes.MAX_SIGMA).all()
    assert np.allclose(found.rejected, every[away][["x_m", "y_m"]], atol=1e-12)
    asked = Request(str(path), str(room / "anchors.csv")).asked()
    bare = PlainEstimator(lambda batch, *rest: replace(asked.method(batch, *rest), covariance=None))
    with pytest.raises(UserError, match="states no deviations"):
        located.locate(replace(asked, method=bare), 1.0)


def test_truth_gives_the_errors(room, log, rng):
    off = rng.normal(0, 1, (40, 2))
    points = np.tile(POINTS, (10, 1))
    truth = points[:, :2] + off
    rows = [
        f"{row},{x!r},{y!r}"
        for row, (x, y) in zip(rows_of(points), np.repeat(truth, 4, axis=0).tolist())
    ]
    rows[4:8] = [f"1,A1,0,0,{truth[1, 0]},{truth[1, 1]}"]
    found = located_in(log(rows, "fix,anchor,azimuth_deg,elevation_deg,x_m,y_m"), room, "scenario.height_m=1.1",
                       estimator="ls_lines")  # fmt: skip
    error = np.hypot(*off.T)
    error[1] = np.nan
    got = summary.accuracy(found.frame)
    given = error[np.isfinite(error)]
    assert got["fixes"] == 40
    assert got["coverage"] == 39 / 40
    for limit in (1, 2, 5):
        assert got[f"p_within_{limit}m"] == (error <= limit).mean()
    assert got["rmse_xy_m"] == pytest.approx(np.sqrt((given**2).mean()), rel=1e-5)
    for q in (50, 90, 95):
        assert got[f"cep{q}_m"] == pytest.approx(np.percentile(given, q), rel=1e-5)
    assert "coverage 97.5 %" in next(summary.accuracy_lines(got))


def test_each_mark_counts_alike_if_asked(room, log):
    counts, off = (9, 1), (0.5, 3.0)
    points = np.repeat(POINTS[:2], counts, axis=0)
    truth = points[:, :2] + np.repeat([[o, 0.0] for o in off], counts, axis=0)
    rows = [
        f"{row},{x!r},{y!r}"
        for row, (x, y) in zip(rows_of(points), np.repeat(truth, 4, axis=0).tolist())
    ]
    found = located_in(log(rows, "fix,anchor,azimuth_deg,elevation_deg,x_m,y_m"), room, "scenario.height_m=1.1",
                       estimator="ls_lines")  # fmt: skip
    plain, by_mark = (summary.accuracy(found.frame, by) for by in (False, True))
    assert plain["p_within_1m"] == pytest.approx(0.9)
    assert by_mark["p_within_1m"] == pytest.approx(0.5)
    assert plain["rmse_xy_m"] == pytest.approx(np.sqrt(0.9 * 0.25 + 0.1 * 9), rel=1e-4)
    assert by_mark["rmse_xy_m"] == pytest.approx(np.sqrt((0.25 + 9) / 2), rel=1e-4)
    assert by_mark["cep95_m"] == pytest.approx(3.0, rel=1e-4)


def test_geojson_of_anchors_in_degrees_is_in_degrees(room, log):
    origin = Origin(60.0, 24.0)
    lines = ["id,lat_deg,lon_deg,height_m,facing_deg"]
    for name, (x, y, z, facing) in ANCHORS.items():
        lat, lon, height = origin.geodetic(np.array([[x, y, z]]))[0].tolist()
        lines.append(f"{name},{lat!r},{lon!r},{height!r},{facing}")
    (room / "anchors.csv").write_text("\n".join(lines) + "\n")
    found = located_in(log(rows_of(POINTS)), room, "scenario.origin_deg=[60.0,24.0]")
    files.write(found.frame, room / "out.geojson", origin=found.asked.scenario.anchors_file.origin)
    document = json.loads((room / "out.geojson").read_text())
    assert "units" not in document
    for feature, point in zip(document["features"], POINTS):
        lon, lat, height = feature["geometry"]["coordinates"]
        assert np.allclose(origin.local(lat, lon, height), point, atol=1e-3)


def test_a_plan_in_degrees_needs_an_origin(room, log):
    origin = Origin(60.0, 24.0)
    corners = np.array([[0, 0, 0], [12, 0, 0], [12, 6, 0], [0, 6, 0], [0, 0, 0.0]])
    ring = origin.geodetic(corners)[:, [1, 0]].tolist()
    feature = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    path = room / "plan.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    request = Request(
        str(log(rows_of(POINTS))), str(room / "anchors.csv"), settings=("scenario.walls_crs=wgs84",)
    )
    with pytest.raises(UserError, match="origin_deg"):
        plans.plan(str(path), request.asked(), request.frame)
    request = replace(request, settings=(*request.settings, "scenario.origin_deg=[60.0,24.0]"))
    walls = plans.plan(str(path), request.asked(), request.frame).walls
    assert np.allclose(walls[:, 0], corners[:-1, :2], atol=1e-3)
    with pytest.raises(UserError, match="did you mean 'walls_crs'"):
        plans.plan(str(path), request.asked(), {"walls_csr": "wgs84"})


@pytest.mark.parametrize(
    ("scale", "shift", "words"),
    [
        (1000, 0, r"--plan=.*walls of the size of anchors; walls span 12000 m.*walls_unit=mm\?"),
        (1, 6_671_000, r"--plan=.*walls in the coordinates of anchors; walls lie within x 6671000"),
    ],
)
def test_a_plan_that_is_not_where_the_anchors_are(room, log, scale, shift, words):
    corners = (scale * np.array([[0, 0], [12, 0], [12, 6]]) + shift).tolist()
    path = room / "plan.geojson"
    path.write_text(json.dumps({"type": "LineString", "coordinates": corners}))
    asked = Request(str(log(rows_of(POINTS))), str(room / "anchors.csv")).asked()
    with pytest.raises(UserError, match=words):
        plans.plan(str(path), asked, {})
    if scale > 1:
        found = plans.plan(str(path), asked, {"walls_unit": "mm"})
        assert np.ptp(found.walls[..., 0]) == 12
    with pytest.raises(UserError, match=r"--plan='none\.dxf' .*an existing file"):
        plans.plan("none.dxf", asked, {})


def test_a_filter_needs_no_further_setting(room, log):
    rows = [row.split(",", 1) for row in rows_of(np.repeat(POINTS[:1], 9, axis=0))]
    path = log(
        [f"{float(k)},{rest}" for k, rest in rows], "time_s,anchor,azimuth_deg,elevation_deg"
    )
    for name in ("ekf_vmf", "ekf_vmf_smoother", "pf_ae_fitted"):
        frame = located_in(path, room, filter=name).frame
        assert (frame["outcome"] == "ok").all()
        assert np.allclose(frame[["x_m", "y_m"]].iloc[-1], POINTS[0, :2], atol=0.2)
        assert (frame["anchors_used"] == 4).all()


def test_files_hold_the_same_numbers(room, log):
    found = located_in(log(rows_of(POINTS)), room, max_sigma_m=0.45)
    for kind in files.KINDS:
        files.write(found.frame, room / f"out{kind}")
    whole = pd.read_parquet(room / "out.parquet")
    pd.testing.assert_frame_equal(whole, found.frame, check_dtype=False)
    text = pd.read_csv(room / "out.csv", dtype={"fix": str})
    assert np.allclose(text["x_m"], whole["x_m"], atol=1e-6, equal_nan=True)
    document = json.loads((room / "out.geojson").read_text(), parse_constant=pytest.fail)
    assert document["units"] == "m"
    for feature, row in zip(document["features"], whole.to_dict("records")):
        assert feature["properties"]["outcome"] == row["outcome"]
        if row["outcome"] == "rejected":
            assert feature["geometry"] is None
        else:
            place = feature["geometry"]["coordinates"]
            assert place == pytest.approx([row["x_m"], row["y_m"], row["z_m"]], abs=1e-6)


def test_geojson_has_each_cell_of_the_table(room, log):
    frame = located_in(log(rows_of(POINTS)), room).frame.assign(tag=['a"%s', None, "\n", "ü"])
    frame.loc[2, "x_m"], frame.loc[3, "z_m"], frame.loc[0, "sigma_z_m"] = np.nan, np.nan, np.inf
    files.write(frame, room / "out.geojson")
    features = json.loads((room / "out.geojson").read_text(), parse_constant=pytest.fail)[
        "features"
    ]
    assert [len(f["geometry"]["coordinates"]) if f["geometry"] else 0 for f in features] == [
        3,
        3,
        0,
        2,
    ]
    for (_, row), feature in zip(frame.iterrows(), features, strict=True):
        found = feature["properties"]
        assert list(found) == list(frame)
        for name, value in row.items():
            known = isinstance(value, str) or (value is not None and np.isfinite(value))
            value = value if known else None
            close = pytest.approx(value, abs=1e-6) if isinstance(value, float) else value
            assert found[name] == close, name


@pytest.mark.parametrize(
    ("turned", "named"), [({"A2": 90.0}, "A2"), ({}, None), (dict.fromkeys(ANCHORS, 90.0), "")]
)
def test_large_residuals_are_said(room, log, turned, named):
    rows = rows_of(POINTS, turned=turned)
    found = located_in(
        log(rows), room, "estimator.robust_ml.loss=truncated", "scenario.height_m=1.1"
    )
    lines = list(summary.residual_lines(found.residuals, list(ANCHORS), "counterclockwise"))
    large = [line for line in lines if line.startswith("large residuals")]
    if named is None:
        assert not large
    elif named:
        (line,) = large
        assert "anchor A2" in line
        assert "-90 deg" in line
    else:
        assert large
        assert "scenario.azimuth_sense" in large[-1]


def student(point, fix):
    """The cost of a point with the default loss of robust_ml, of all rows of a fix."""
    total = 0.0
    for row in fix.itertuples():
        azimuth, elevation = angles(point, row.anchor)
        da = (row.azimuth_deg - azimuth + 180) % 360 - 180
        squares = (da / 6) ** 2, ((row.elevation_deg - elevation) / 12) ** 2
        total += sum(2 * np.log(1 + square / 3) for square in squares)
    return total


def test_a_wrong_facing_is_left_out_by_the_loss_truncated_alone(room, log):
    """The least cost of the default loss is elsewhere than at the tag: no fault of the search."""
    path = log(rows_of(POINTS, turned={"A2": 90.0}))
    rows = pd.read_csv(path)
    exact = located_in(path, room, "estimator.robust_ml.loss=truncated").frame
    np.testing.assert_allclose(exact[["x_m", "y_m", "z_m"]], POINTS, rtol=0, atol=1e-3)
    assert set(exact["anchors_used"]) == {3}
    found = located_in(path, room).frame
    for (_, fix), point, true in zip(
        rows.groupby("fix"), found[["x_m", "y_m", "z_m"]].to_numpy(), POINTS
    ):
        assert student(point, fix) < student(true, fix) - 0.01


def test_an_azimuth_at_a_pole_is_no_residual(room, log):
    """Under A1, the azimuth that it states is any; its others are right."""
    points = [(0, 3, 1.1), (0, 3, 1.1), (5, 3, 1.1), (7, 2, 1.1)]
    rows = [row.replace("A1,0.000000000,-90", "A1,120,-90") for row in rows_of(points)]
    assert sum("A1,120,-90" in row for row in rows) == 2
    found = located_in(log(rows), room, estimator="ls_lines").residuals
    at_pole = (found.anchor == 0) & (found.fix < 2)
    np.testing.assert_array_equal(np.isnan(found.azimuth), at_pole)
    lines = list(summary.residual_lines(found, list(ANCHORS), "counterclockwise"))
    assert len(lines) == 1


def test_one_odd_anchor_among_few_may_mean_another_convention():
    """Where one anchor's azimuths are those of a mirrored frame, the fixes follow the others."""
    azimuth = np.radians(np.tile([178.0, 40.0, -50.0], 10))
    rest = np.repeat(np.arange(10), 3), np.tile([0, 1, 2], 10)
    found = Residuals(*rest, azimuth, np.full(30, np.nan))
    lines = list(summary.residual_lines(found, ["A", "B", "C"], "clockwise"))
    assert "anchor A: its azimuths differ by 178 deg" in lines[1]
    assert "now clockwise, else counterclockwise" in lines[-1]
    few = Residuals(*rest, azimuth * np.tile([1, 0.1, 0.1], 10), np.full(30, np.nan))
    assert len(list(summary.residual_lines(few, ["A", "B", "C"], "clockwise"))) == 2


def test_the_first_rows_count_anchors_in_whole_numbers(room, log):
    frame = located_in(log(rows_of(POINTS)), room).frame
    assert list(summary.head(frame, 2))[1].split()[-2:] == ["4", "ok"]
    frame.loc[0, "anchors_used"] = None
    assert len(list(summary.head(frame, 2))) == 4


def test_mistakes_are_one_line(room, log):
    path = log(rows_of(POINTS))
    for words, match in [
        ({"estimator": "ls_lines", "filter": "ekf_vmf"}, "one of them"),
        ({"settings": ("estimator=[ls]",)}, "--estimator"),
        ({"estimator": "robust_mll"}, "did you mean"),
    ]:
        with pytest.raises(UserError, match=match):
            located_in(path, room, *words.pop("settings", ()), **words)
    with pytest.raises(UserError, match="--anchors is missing"):
        Request(str(path)).asked()
    for out in ("fixes.xls", "log.csv"):
        with pytest.raises(UserError, match="-o="):
            files.check_out(room / out, [str(path)])
    (room / "loop.csv").symlink_to("loop.csv")
    files.check_out(room / "fixes.csv", [str(room / "loop.csv")])  # told where it is read


def test_a_csv_with_any_names_reads_back(room, log):
    found = located_in(log(rows_of(POINTS)), room).frame
    for tag in ("a,b", 'say "x"', "two\nlines", "ü", None, "plain"):
        frame = found.assign(tag=tag)
        columns = {name: frame[name].to_numpy() for name in frame}
        read = pd.read_csv(
            io.BytesIO(files.csv_text(columns)), dtype={"tag": object, "fix": object}
        )
        assert list(read) == list(fixes.COLUMNS)
        assert read["tag"].replace({np.nan: None}).tolist() == [tag] * 4
        assert np.allclose(read["sigma_major_m"], frame["sigma_major_m"], atol=1e-6)
        assert files.csv_text(columns, header=False) == files.csv_text(columns).partition(b"\n")[2]


def test_from_python(room, log):
    path = log(rows_of(POINTS))
    frame = aoabench.locate(
        path, room / "anchors.csv", "scenario.height_m=1.1", estimator="ls_lines"
    )
    assert np.allclose(frame[["x_m", "y_m"]], POINTS[:, :2], atol=1e-5)
