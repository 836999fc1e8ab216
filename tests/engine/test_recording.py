"""Recorded tracks as replications: what a track gives depends on no other track."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize

from aoabench.cell import Cell, RunnerOptions
from aoabench.config.fit import those_that_fit
from aoabench.config.recording import as_recorded
from aoabench.engine import recording, runner
from aoabench.engine.block import run_block
from aoabench.engine.draws import Draws
from aoabench.engine.tiles import tile_of
from aoabench.errors import BadValue, ManyErrors
from aoabench.estimators.anchors import RssiAnchor, SingleAnchor
from aoabench.estimators.lines import LineLeastSquares
from aoabench.estimators.robust import RobustLikelihood
from aoabench.filters.kalman import EKF, UKF
from aoabench.filters.particle import ParticleFilter
from aoabench.maths.intervals import rate_interval
from aoabench.models.motion import ConstantVelocity, RandomWalk
from aoabench.models.unit_vector import UnitVector
from aoabench.noise.recorded import Recorded as RecordedNoise
from aoabench.roles import Estimator, Motion, Scenario
from aoabench.store import fixes, tables
from aoabench.types import Anchors, Estimates, Measurements, Tracks

POSITION = np.array([[0, 3, 2.3], [6, 0, 2.3], [12, 3, 2.3], [6, 6, 2.3]], dtype=float)
ANCHORS = Anchors(POSITION, np.broadcast_to(np.eye(3), (4, 3, 3)))


@dataclass(frozen=True)
class Site(Scenario):
    """A recording of some tracks in a room of four anchors, or of others."""

    own: Tracks
    anchors: Anchors = ANCHORS
    motion: Motion | None = None
    name = "site"
    start_s = None

    @property
    def tracks(self):
        return self.own

    @property
    def true_anchors(self):
        return self.anchors

    @property
    def known_height_m(self):
        return 1.1


@dataclass(frozen=True)
class Normals(Estimator):
    """Positions that are random numbers of the streams."""

    def __call__(self, batch, scenario, streams):
        shape = batch.azimuth.shape[:2]
        found = [
            streams.estimator(i).standard_normal((shape[1], 3)) for i in range(len(batch.azimuth))
        ]
        return Estimates(np.stack(found), None, None, np.zeros(shape, dtype=np.int8))


def seen(truth, rng, noise=0.05):
    """Azimuth and elevation (T, 4) rad of positions (T, 3) m."""
    d = truth[:, None] - POSITION
    off = noise * rng.standard_normal((2, *d.shape[:2])) if noise else np.zeros(2)
    azimuth = np.arctan2(d[..., 1], d[..., 0]) + off[0]
    return azimuth, np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1])) + off[1]


def track(tag, count, start=0.0, dt=0.25):
    """A walk of one tag with a fix every dt s; its data depend on the tag alone."""
    rng = np.random.default_rng(sum(map(ord, tag)))
    s = np.linspace(0, 1, count)
    truth = np.stack([2 + 8 * s, 1.5 + 2 * s, np.full(count, 1.1)], axis=-1)
    measured = Measurements(*seen(truth, rng))
    fix = np.array([f"{tag}-{i}" for i in range(count)], dtype=object)
    time, heard = start + dt * np.arange(count), np.full(count, 4)
    return Tracks((tag,), np.array([count]), time, fix, truth, measured, heard, np.arange(4))


def overlaid(*each):
    """One recording of several tracks."""
    arrays = [one.measured.arrays for one in each]
    measured = {name: np.concatenate([a[name] for a in arrays]) for name in arrays[0]}
    flat = {
        n: np.concatenate([getattr(t, n) for t in each])
        for n in ("time", "fix", "truth", "packets")
    }
    tags = tuple(tag for one in each for tag in one.tags)
    counts = np.concatenate([one.counts for one in each])
    return Tracks(
        tags=tags, counts=counts, measured=Measurements(**measured), columns=np.arange(4), **flat
    )


METHODS = {"lines": LineLeastSquares(), "robust": RobustLikelihood(), "normals": Normals()}


def block(tracks, methods=METHODS, span=None, **kwargs):
    stop = len(tracks.counts)
    return run_block(
        Site(tracks, **kwargs), RecordedNoise(), methods, 1, *(span or (0, stop)), steps=True
    )


def without(rows, *names):
    return {name: list(map(str, value)) for name, value in rows.items() if name not in names}


EACH = [track("T1", 7), track("T2", 12, 3.0), track("T10", 1)]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_overlaid_tags_are_the_single_ones_bit_for_bit(order):
    """Whatever the other tracks are and how long; so are random draws."""
    both = block(overlaid(*(EACH[i] for i in order)))
    for place, i in enumerate(order):
        alone = block(EACH[i])
        for name in METHODS:
            for kind in ("rows", "steps"):
                mine = both[name][kind]["replication"] == place
                found = {k: v[mine] for k, v in both[name][kind].items()}
                assert without(found, "replication") == without(alone[name][kind], "replication")


def test_the_draws_of_tags_differ_and_those_of_a_nameless_one_are_of_its_number():
    steps = block(overlaid(EACH[0], replace(EACH[0], tags=("T7",))))["normals"]["steps"]
    first, second = np.split(steps["x_m"], 2)
    assert not np.isin(first, second).any()
    nameless = overlaid(*(replace(one, tags=("",)) for one in EACH))
    assert [recording.random_number(nameless, i) for i in range(3)] == [0, 1, 2]
    twice = overlaid(EACH[0], EACH[1], EACH[0])
    numbers = [recording.random_number(twice, i) for i in range(3)]
    assert len(set(numbers)) == 3
    assert numbers[2] == numbers[0] + 1


def test_steps_and_replications_name_tag_fix_and_time():
    steps = block(overlaid(*EACH))["lines"]["steps"]
    assert steps["tag"].tolist() == ["T1"] * 7 + ["T2"] * 12 + ["T10"]
    assert steps["fix"].tolist() == [name for one in EACH for name in one.fix]
    assert steps["time_s"].tolist() == [t for one in EACH for t in one.time]
    assert steps["step"].tolist() == [*range(7), *range(12), 0]
    rows = block(overlaid(*EACH))["lines"]["rows"]
    assert rows["tag"].tolist() == ["T1", "T2", "T10"]
    assert rows["n_fixes"].tolist() == [7, 12, 1]
    part = block(overlaid(*EACH), span=(1, 2))["lines"]["steps"]
    assert set(part["tag"]) == {"T2"}
    assert set(part["replication"]) == {1}
    unknown = replace(EACH[0], time=np.full(7, np.nan), tags=("",))
    steps = block(unknown)["lines"]["steps"]
    assert np.isnan(steps["time_s"]).all()
    assert set(steps["tag"]) == {None}


def test_a_batch_has_the_tracks_times_or_none():
    drawn = Draws(Site(overlaid(*EACH)), RecordedNoise(), 0)
    for i, one in enumerate(EACH):
        truth, batch = drawn.tile(i, 1)
        np.testing.assert_array_equal(batch.time[0], one.time)
        np.testing.assert_array_equal(truth[0], one.truth)
    timeless = Site(replace(EACH[0], time=np.full(7, np.nan)))
    assert Draws(timeless, RecordedNoise(), 0).tile(0, 1)[1].time is None
    assert tile_of(LineLeastSquares(), timeless) == 1
    with pytest.raises(ValueError, match="one track"):
        drawn.tile(0, 2)


def doubled(one, times):
    """The track with each packet of anchor 0 measured several times, in further columns."""
    arrays, columns = {}, np.append(np.arange(4), np.zeros(times - 1, dtype=int))
    for name, array in one.measured.arrays.items():
        arrays[name] = array[:, columns]
    return replace(one, measured=Measurements(**arrays), columns=columns)


def test_several_packets_of_an_anchor_are_columns_of_their_own():
    """Three equal packets of anchor 0 weigh three times; the optimum is SciPy's."""
    one = EACH[1]
    thrice = Draws(Site(doubled(one, 3)), RecordedNoise(), 0).tile(0, 1)[1]
    assert thrice.numbers.tolist() == [[[0, 1, 2, 3, 0, 0]]]
    np.testing.assert_array_equal(thrice.anchors.position[0, 0], POSITION[[0, 1, 2, 3, 0, 0]])
    found = RobustLikelihood(loss="normal")(thrice, Site(one), None).position[0]
    weights, m = np.array([3, 1, 1, 1]), one.measured
    for i, start in enumerate(one.truth):

        def loss(xy, i=i):
            azimuth, elevation = seen(np.array([[*xy, 1.1]]), None, 0.0)
            off = np.angle(np.exp(1j * (m.azimuth[i] - azimuth[0]))) / 6
            return weights @ (off**2 + ((m.elevation[i] - elevation[0]) / 12) ** 2)

        best = minimize(loss, start[:2], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 0})
        np.testing.assert_allclose(found[i, :2], best.x, atol=1e-5)


def test_columns_that_only_other_tracks_use_are_left_out():
    """So a track that shares a log with one of more packets is the same as alone."""
    more = doubled(EACH[1], 3)
    pad = {
        n: np.pad(a, ((0, 0), (0, 2)), constant_values=np.nan)
        for n, a in EACH[0].measured.arrays.items()
    }
    fewer = replace(EACH[0], measured=Measurements(**pad), columns=more.columns)
    both = replace(overlaid(fewer, more), columns=more.columns)
    tiles = [Draws(Site(both), RecordedNoise(), 0).tile(i, 1)[1] for i in range(2)]
    assert [batch.azimuth.shape[2] for batch in tiles] == [4, 6]
    found, alone = block(both)["robust"]["steps"], block(EACH[0])["robust"]["steps"]
    mine = found["tag"] == "T1"
    assert without({k: v[mine] for k, v in found.items()}) == without(alone)


def test_an_anchor_is_chosen_by_its_number_whatever_its_column():
    one = EACH[0]
    order = np.array([2, 0, 3, 1])
    arrays = {n: a[:, order] for n, a in one.measured.arrays.items()}
    mixed = replace(one, measured=Measurements(**arrays), columns=order)
    for anchor in (1, 2, 3, 4):
        found, expected = (
            block(t, {"a": SingleAnchor(anchor=anchor)})["a"]["steps"] for t in (mixed, one)
        )
        np.testing.assert_array_equal(found["x_m"], expected["x_m"])


def test_receivers_that_move_have_the_poses_of_the_tracks_own_fixes():
    tracks = overlaid(*EACH)
    F = len(tracks.time)
    drift = np.zeros((1, F, 4, 3))
    drift[..., 0] = np.arange(F)[:, None]
    anchors = Anchors(POSITION + drift, np.broadcast_to(np.eye(3), (1, F, 4, 3, 3)))
    shifted = replace(tracks, truth=tracks.truth + drift[0, :, 0])
    steps, still = (
        block(t, {"l": LineLeastSquares()}, anchors=a)["l"]["steps"]
        for t, a in ((shifted, anchors), (tracks, ANCHORS))
    )
    np.testing.assert_allclose(steps["x_m"] - np.arange(F), still["x_m"], atol=1e-9)
    np.testing.assert_allclose(steps["error_xy_m"], still["error_xy_m"], atol=1e-9)


def cell(tracks, out, methods, **options):
    site = Site(tracks)
    config = {
        "scenario": {},
        "noise": {},
        "filter": None,
        "estimator": {key: {} for key in methods},
    }
    return Cell(
        "site",
        "recorded",
        site,
        RecordedNoise(),
        methods,
        1,
        len(tracks.counts),
        RunnerOptions(str(out), n_jobs=1, **options),
        config,
    )


@pytest.mark.parametrize("places", [True, False])
def test_a_run_of_ragged_tracks_counts_every_fix(tmp_path, monkeypatch, places):
    """Tables against sums over the steps; and the same rows in any chunks. With places of their
    fixes, errors are clustered by position, else, in very long recordings, by track.
    """
    if not places:
        monkeypatch.setattr(recording, "_MOST_PLACES", 0)
    lost = replace(
        EACH[1],
        measured=Measurements(
            *(
                np.where(np.arange(12)[:, None] == 10, np.nan, a)
                for a in EACH[1].measured.arrays.values()
            )
        ),
    )
    tracks = overlaid(EACH[0], lost, EACH[2])
    methods = {"lines": METHODS["lines"], "robust": METHODS["robust"]}
    shown = []
    for chunk in (1, 3):
        out = tmp_path / str(chunk)
        runner.run([cell(tracks, out, methods, chunk=chunk)], progress=False)
        steps = pd.read_parquet(out / "steps.parquet")
        shown.append(steps.drop(columns="cell"))
        mine = steps[steps["estimator"] == "lines"]
        assert len(mine) == 20
        summary = tables.shown(out, "summary")["summary"].set_index("estimator").loc["lines"]
        given = mine[mine["outcome"] == "ok"]["error_xy_m"]
        assert len(given) == 19
        assert summary["availability"] == summary["share_ok"] == pytest.approx(19 / 20)
        assert summary["cep50_m"] == pytest.approx(np.quantile(given, 0.5))
        assert summary["p_within_1m"] == pytest.approx((given <= 1).sum() / 20)
        assert summary["rmse_pooled_xy_m"] == pytest.approx(np.sqrt((given**2).mean()))
        assert summary["se_by"] == ("position" if places else "replication")
        hits = np.array([(one["error_xy_m"] <= 1).sum() for _, one in mine.groupby("replication")])
        if not places:
            share, n = hits.sum() / 20, np.array([7, 12, 1])
            se = np.sqrt(3 / 2 * (((hits - share * n) / 20) ** 2).sum())
            expected = rate_interval(
                share * share * (1 - share) / se**2, share * (1 - share) / se**2
            )
            found = summary["p_within_1m_low"], summary["p_within_1m_high"]
            np.testing.assert_allclose(found, expected)
        assert summary["share_unmeasured"] == pytest.approx(1 / 20)
        assert (mine.loc[mine["n_unmeasured"] == 1, "fix"] == "T2-10").all()
    pd.testing.assert_frame_equal(*shown)


def test_all_tracks_are_run_unless_reps_is_typed():
    plain, choices = {"reps": 100, "scenario": {}}, {"noise": "vmf"}
    site = Site(overlaid(*EACH))
    found, named, notes = as_recorded(plain, choices, site, ())
    assert (found["reps"], named["noise"], notes) == (3, "recorded", ())
    found, _, (note,) = as_recorded({**plain, "reps": 2}, choices, site, ("reps",))
    assert found["reps"] == 2
    assert note == "reps=2: only the first 2 of 3 tracks are run"
    found, _, (note,) = as_recorded(plain, choices, site, ("reps",))
    assert found["reps"] == 3
    assert note == "reps=100 is taken as 3: a recording of 3 tracks are 3 replications"


def test_methods_that_cannot_run_are_left_out_with_their_reason():
    site = Site(EACH[0])
    some = {"estimator.rssi": RssiAnchor(), "estimator.lines": LineLeastSquares()}
    some |= {"estimator.ninth": SingleAnchor(anchor=9)}
    choices = {"scenario": "recorded", "noise": "recorded"}
    fit, lines, _ = those_that_fit(some, site, RecordedNoise(), choices)
    assert list(fit) == ["estimator.lines"]
    assert lines[0].startswith(
        "estimator.rssi does not run: it needs a recording that measures signal"
    )
    assert lines[1].startswith(
        "estimator.ninth does not run: estimator.ninth.anchor=9 is not allowed"
    )
    with pytest.raises(BadValue, match=r"estimator\.ninth\.anchor"):
        those_that_fit(some, site, RecordedNoise(), choices, ("estimator.ninth.anchor",))
    del some["estimator.lines"]
    with pytest.raises(ManyErrors, match=r"(?s)2 mistakes.*ninth.*which estimator\.rssi needs"):
        those_that_fit(some, site, RecordedNoise(), choices)


def test_a_lost_packet_is_not_the_outcome_of_a_track():
    """The commonest outcome; of two that are equally common, the worse."""
    m = {n: a.copy() for n, a in EACH[1].measured.arrays.items()}
    for lost, expected in ((1, "ok"), (5, "ok"), (6, "failed"), (7, "failed")):
        for array in m.values():
            array[:lost] = np.nan
        rows = block(replace(EACH[1], measured=Measurements(**m)))["lines"]["rows"]
        assert rows["outcome"].tolist() == [expected]
        assert rows["n_failed"].tolist() == [lost]


def test_errors_are_clustered_by_true_position_over_all_tracks(tmp_path):
    """Tracks that stand at marks share them; the fixes of each are stored at the places of all."""
    marks = np.array([[3, 2, 1.1], [9, 4, 1.1], [5, 3, 1.1]])
    each = []
    for tag, stops in (("a", [0, 1, 2]), ("b", [2, 0])):
        one = track(tag, 4 * len(stops))
        truth = np.repeat(marks[stops], 4, axis=0)
        m = Measurements(*seen(truth, np.random.default_rng(len(stops))))
        each.append(replace(one, truth=truth, measured=m))
    runner.run(
        [one := cell(overlaid(*each), tmp_path, {"lines": METHODS["lines"]})], progress=False
    )
    found = fixes.fixes(tmp_path, one.id, "lines")
    assert found.place.tolist() == [[*[0] * 4, *[1] * 4, *[2] * 4, *[2] * 4, *[0] * 4]] * 2
    assert (found.outcome >= 0).tolist() == [[True] * 12 + [False] * 8, [False] * 12 + [True] * 8]
    steps = pd.read_parquet(tmp_path / "steps.parquet")
    np.testing.assert_allclose(found.error_xy_m[found.outcome >= 0], steps["error_xy_m"], rtol=1e-6)
    clusters = fixes.clusters(tmp_path, one.id, "lines")
    assert clusters.fixes.tolist() == [8, 4, 8]
    place = np.array([0] * 4 + [1] * 4 + [2] * 8 + [0] * 4)
    sums = np.bincount(place, steps["error_xy_m"] ** 2)
    np.testing.assert_allclose(clusters.totals[1], sums, rtol=1e-6)
    (row,) = tables.shown(tmp_path, "summary")["summary"].to_dict("records")
    assert row["se_by"] == "position"
    hits = (steps["error_xy_m"] <= 1).sum() / 20
    assert row["p_within_1m"] == pytest.approx(hits)
    assert row["availability"] == 1.0


MODEL = UnitVector(kappa=1 / 0.05**2)
FILTERS = {"ekf": EKF(MODEL), "ukf": UKF(MODEL), "pf": ParticleFilter(MODEL, particles=200)}


@pytest.mark.parametrize("motion", [RandomWalk(q_xy=1.0), ConstantVelocity()])
def test_filtered_tags_are_the_single_ones_bit_for_bit_and_nearer_than_their_fixes(motion):
    """Filters start from each track's own first fix; times differ between the tracks."""
    each = [track("T1", 60), track("T22", 35, 3.0), track("T333", 1)]
    both = block(overlaid(*each), FILTERS, motion=motion)
    for place, one in enumerate(each):
        alone = block(one, FILTERS, motion=motion)
        for name in FILTERS:
            steps = both[name]["steps"]
            found = {k: v[steps["replication"] == place] for k, v in steps.items()}
            expected = without(alone[name]["steps"], "replication")
            assert without(found, "replication") == expected
    fixes = block(overlaid(*each))["robust"]["rows"]["rmse_xy_m"]
    for name in FILTERS:
        assert (both[name]["rows"]["rmse_xy_m"][:2] < fixes[:2]).all()


def test_a_filter_uses_the_anchors_that_are_heard():
    """Each counts once, however many packets it sent."""
    m = {n: a.copy() for n, a in doubled(EACH[1], 3).measured.arrays.items()}
    for array in m.values():
        array[2, 1] = array[3] = array[4, [0, 4]] = array[5, [0, 4, 5]] = np.nan
    some = replace(doubled(EACH[1], 3), measured=Measurements(**m))
    steps = block(some, FILTERS, motion=RandomWalk())
    for name in FILTERS:
        used = steps[name]["steps"]["anchors_used"]
        assert used.tolist() == [4, 4, 3, 0, 4, 3, *[4] * 6]


def test_a_filter_sees_the_time_between_fixes():
    """A tag that walked 3 m during a pause of 20 s: the filter follows at once."""
    one = track("T1", 40)
    some = np.r_[0:15, 28:40]
    arrays = {n: a[some] for n, a in one.measured.arrays.items()}
    flat = {n: getattr(one, n)[some] for n in ("fix", "truth", "packets")}
    steady = 0.25 * np.arange(27)
    errors = []
    for time in (np.where(steady > 3.6, steady + 20, steady), steady):
        tracks = replace(
            one, counts=np.array([27]), time=time, measured=Measurements(**arrays), **flat
        )
        steps = block(tracks, {"ekf": EKF(MODEL)}, motion=RandomWalk(q_xy=0.2))["ekf"]["steps"]
        errors.append(steps["error_xy_m"][15])
    assert errors[0] < 0.7 < 1.5 < errors[1]
