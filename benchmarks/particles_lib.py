"""One lap of the square track in `particles`: a bootstrap filter on its Feynman-Kac models.

The library's own multivariate normal distribution takes twenty times as long as the two classes
here, which it accepts in its place.
"""

from __future__ import annotations

import numpy as np
import particles
from particles import distributions, state_space_models
from particles.collectors import Moments

from aoabench.filters.belief import believed
from aoabench.maths.geometry import Array, in_frames, to_azel, wrap
from aoabench.roles import Scenario
from aoabench.types import Batch


class Particles:
    """The particle filter for one replication's measurements (1, T, B) with a deviation in rad."""

    def __init__(self, scenario: Scenario, batch: Batch, sigma: float, particles: int) -> None:
        belief = believed(batch, scenario)
        self.count = particles
        self.model = _Track(
            mean=belief.mean[0],
            cov=np.asarray(belief.covariance),
            root=np.sqrt(np.diag(belief.at(0)[1])),
            anchors=batch.anchors,
            sigma=sigma,
        )
        self.measured = np.stack([batch.azimuth[0], batch.elevation[0]], axis=1)  # (T, 2, B)

    def particle_filter(self) -> Array:
        """Positions (T, 3) m of the particle filter."""
        bootstrap = state_space_models.Bootstrap(ssm=self.model, data=self.measured)
        filtered = particles.SMC(
            fk=bootstrap,
            N=self.count,
            resampling="systematic",
            ESSrmin=0.1,
            collect=[Moments()],
        )
        filtered.run()
        return np.array([m["mean"] for m in filtered.summaries.moments])


class _Around(distributions.ProbDist):
    """Independent normal steps with deviations `root` (3,) m from positions `loc` (N, 3) m."""

    def __init__(self, loc: Array, root: Array) -> None:
        self.loc, self.root = loc, root

    def rvs(self, size: int | None = None) -> Array:
        return self.loc + self.root * np.random.standard_normal(self.loc.shape)  # noqa: NPY002


class _Seen(distributions.ProbDist):
    """Azimuths and elevations (2, B) rad of positions x (N, 3) m."""

    def __init__(self, x: Array, model: _Track) -> None:
        self.x, self.model = x, model

    def logpdf(self, y: Array) -> Array:
        """Log likelihood (N,), without its constant."""
        anchors = self.model.anchors
        azimuth, elevation = to_azel(*in_frames(self.x[None], anchors.position, anchors.rotation))
        square = wrap(y[0] - azimuth[0]) ** 2 + (y[1] - elevation[0]) ** 2
        found: Array = -0.5 * (square / self.model.sigma**2).sum(axis=-1)
        return found


class _Track(state_space_models.StateSpaceModel):
    """The random walk, its start one step before the first measurement, and the measurements."""

    def PX0(self) -> distributions.ProbDist:
        start = self.cov + np.diag(self.root**2)
        return distributions.MvNormal(loc=self.mean, cov=start)

    def PX(self, t: int, xp: Array) -> distributions.ProbDist:
        return _Around(xp, self.root)

    def PY(self, t: int, xp: Array, x: Array) -> distributions.ProbDist:
        return _Seen(x, self)
