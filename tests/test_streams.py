"""Known answers of the random streams, and who draws from which: stored results rest on both."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from aoabench import streams
from aoabench.engine.tiles import Draws, estimate_tile
from aoabench.filters.particle import ParticleFilter
from aoabench.kernels import loading
from aoabench.models.unit_vector import UnitVector
from aoabench.roles import Estimator, Noise, Scenario
from aoabench.streams import ESTIMATOR, PARTICLES, Streams, generator, generators
from aoabench.types import Anchors, Batch, Estimates, Measurements, Outcome

# the first five uniform numbers at seed 1, scenario square_track, replication 7
KNOWN = {
    "truth": [0.32070400305184443, 0.011351121148399312, 0.33104498861051324, 0.2688997007631868, 0.17750898013423988],
    "measurement": [0.4423309176122372, 0.7377886175031173, 0.876371846781197, 0.927944421139019, 0.2365353480942205],
    "anchors": [0.6578889717659074, 0.5323824650503125, 0.25513538652118495, 0.05960887335659926, 0.9203877654875876],
    "prior": [0.7034105548981171, 0.8893571708587068, 0.26305825614544875, 0.3287265850957527, 0.4899816919995128],
    "particles": [0.08830436571488676, 0.4324253581905262, 0.5952296498048886, 0.15597241704262343, 0.6765953359389515],
}  # fmt: skip
ROLES = {
    "truth": (streams.TRUTH, 0),
    "measurement": (streams.MEASUREMENT, 0),
    "anchors": (streams.ANCHORS, 0),
    "prior": (streams.ESTIMATOR, streams.PRIOR),
    "particles": (streams.ESTIMATOR, streams.PARTICLES),
}
PARTICLES_KEY = (3575141870, 3804618394)  # seed 1, square_track


@pytest.mark.parametrize("name", KNOWN)
def test_each_role_draws_its_known_numbers(name):
    found = streams.generator(1, "square_track", 7, *ROLES[name]).random(5)
    assert found.tolist() == KNOWN[name]


@pytest.mark.parametrize(
    ("seed", "scenario", "purpose", "key"),
    [
        (1, "square_track", streams.PARTICLES, PARTICLES_KEY),
        (1, "square_track", streams.PRIOR, (3805560809, 2753028630)),
        (2, "square_track", streams.PARTICLES, (1997847080, 3245334835)),
        (1, "bs_grid", streams.PARTICLES, (4034724905, 77159680)),
    ],
)
def test_counter_based_draws_have_their_known_keys(seed, scenario, purpose, key):
    assert streams.philox_key(seed, scenario, streams.ESTIMATOR, purpose) == key
    assert Streams(seed, scenario, (0, 1)).philox_key(purpose) == key


@dataclass(frozen=True)
class Place(Scenario):
    """A scenario whose truth and prior are the numbers that it draws."""

    shares_positions: bool = False
    name = "square_track"
    true_anchors = Anchors(np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1)))

    def truth(self, rng):
        return np.tile(rng.random(5)[:, None], 3)

    def prior(self, rng, truth):
        return rng.random(5), np.eye(5)


class Drawn(Noise):
    """A noise whose azimuths and anchors are the numbers that it draws."""

    def sample(self, rng, scenario, truth):
        return Measurements(rng.random(5)[:, None], np.zeros((5, 1)))

    def known_anchors(self, rng, scenario):
        position = np.tile(rng.random(5)[:, None], 3)
        return Anchors(position, scenario.true_anchors.rotation)


def draws(**options):
    return Draws(Place(**options), Drawn(), 1)


def test_each_draw_comes_from_the_stream_of_its_role():
    truth, batch = draws().tile(7, 1)
    assert truth[0, :, 0].tolist() == KNOWN["truth"]
    assert batch.azimuth[0, :, 0].tolist() == KNOWN["measurement"]
    assert batch.anchors.position[0, 0, :, 0].tolist() == KNOWN["anchors"]
    assert batch.prior_mean[0].tolist() == KNOWN["prior"]


def test_a_shared_truth_is_that_of_replication_0_and_all_else_is_drawn_anew():
    truth, batch = draws(shares_positions=True).tile(7, 2)
    first, _ = draws().tile(0, 1)
    assert np.array_equal(truth, np.concatenate([first, first]))
    assert batch.azimuth[0, :, 0].tolist() == KNOWN["measurement"]
    assert batch.prior_mean[0].tolist() == KNOWN["prior"]
    assert not np.any(batch.azimuth[0] == batch.azimuth[1])


class Drawing(Estimator):
    """An estimator whose positions are its own random numbers."""

    tile = 4

    def __call__(self, batch, scenario, given):
        found = [given.estimator(i).random(5) for i in range(len(batch.azimuth))]
        position = np.tile(np.array(found)[..., None], 3)
        return Estimates(position, None, None, np.full(position.shape[:2], Outcome.OK, np.int8))


def test_an_estimator_draws_from_its_own_stream():
    _, found = estimate_tile(draws(), Drawing(), 4)
    assert found.position[3, :, 0].tolist() == KNOWN["particles"]


@pytest.mark.parametrize("engine", ["numpy", "auto"])
def test_a_particle_filter_moves_its_particles_by_its_own_stream(engine, track):
    """Nothing is measured, so that the mean is that of the particles that were drawn."""
    N, nothing = 1024, np.full((1, 1, 4), np.nan)
    anchors, mean = track.true_anchors, np.array([[0.5, -1.0, 2.0]])
    batch = Batch(nothing, nothing, anchors, prior_mean=mean, prior_cov=np.diag([1.0, 4.0, 9.0]))
    found = ParticleFilter(UnitVector(kappa=30.0), N, engine=engine)(
        batch, track, Streams(1, "square_track", (7,))
    )
    compiled = loading.load("kernels.particle") if engine == "auto" else None
    if compiled is None:
        rng = streams.generator(1, "square_track", 7, 3, 1)
        normals = [rng.standard_normal((N, 3)) for _ in range(2)]
    else:
        planes = np.empty((2, 3, N), dtype=np.float32)
        for k in range(2):
            compiled.normals(planes[k], k, 7, *PARTICLES_KEY)
        normals = [plane.T.astype(float) for plane in planes]
    F, Q = track.motion.matrices(track.dt)
    x = (mean + normals[0] * [1.0, 2.0, 3.0]) @ F.T + normals[1] @ np.linalg.cholesky(Q).T
    assert np.allclose(found.position[0, 0], x.mean(axis=0), rtol=0, atol=1e-5)


@pytest.mark.parametrize("seed", [0, 7, 2**70])
@pytest.mark.parametrize("numbers", [range(3), range(5, 17), [2, 0, 9, 2**40, 1]])
def test_generators_of_several_replications_are_those_of_each(seed, numbers):
    """In their draws, their children and their copies."""
    together = generators(seed, "place", numbers, ESTIMATOR, PARTICLES)
    for number, one in zip(numbers, together, strict=True):
        alone = generator(seed, "place", number, ESTIMATOR, PARTICLES)
        copied = pickle.loads(pickle.dumps(one))
        assert one.random() == alone.random() == copied.random()
        for _ in range(2):
            (a,), (b,) = one.spawn(1), alone.spawn(1)
            assert a.standard_normal() == b.standard_normal()
        for words, kind in ((3, np.uint64), (2, np.uint32)):
            states = (g.bit_generator.seed_seq.generate_state(words, kind) for g in (one, alone))
            assert np.array_equal(*states)
