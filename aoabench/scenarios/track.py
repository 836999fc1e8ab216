"""A target that moves along a track from a file, past anchors from a file or a layout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from aoabench import loaded
from aoabench.devices.anchors import SCHEMA, AnchorsFile, read_anchors
from aoabench.devices.geodesy import Origin
from aoabench.devices.plans import plan
from aoabench.devices.readers.columns import header
from aoabench.devices.tracks.truth import Truth, read_truth
from aoabench.errors import BadValue, check_array, listed
from aoabench.loaded import DataFile
from aoabench.maths.geometry import Array
from aoabench.models.motion import NAMED, motion_of
from aoabench.params import param
from aoabench.roles import Motion, Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.parameters import bounds_param, dt_param, name_param, origin_param
from aoabench.types import Anchors

TRACK = (
    "an existing file with the columns x_m, y_m and, where known, z_m and time_s, a row for each "
    "step of one target in the order of time"
)


@dataclass(frozen=True)
class Track(Scenario):
    """The same trip in each replication: a row of the file is a step, and nothing is interpolated.

    Measurements are simulated by the noise at each row. The time between rows may vary: filters
    predict over the time that has passed. They start at the first row from a mean position drawn
    around the true one, and from 0 in further components of the state (see Motion.start).
    `devices.truth` describes the file of the track, `devices.anchors` that of the anchors. Raises
    BadValue for files of another form and for times that do not increase.
    """

    name: str = name_param()
    path: str = param(
        help="file of the true positions: x_m, y_m and, where known, z_m, time_s",
        allowed=TRACK,
    )
    anchors: AnchorLayout | str = param(
        help="file of the anchors: x_m, y_m and, where needed, id, z_m, facing_deg, pitch_deg, "
        "roll_deg; or an AnchorLayout",
        kind=AnchorLayout,
        allowed=f"an existing file, {SCHEMA}; or an AnchorLayout",
    )
    motion: Motion | None = param(
        None,
        "motion model that filters assume: a name with the defaults, of a walking person, or one "
        "with parameters; null: fixes are independent",
        kind=Motion,
        also=tuple(NAMED),
    )
    dt: float = dt_param(1.0)
    prior_sigma_m: float = param(
        1.0,
        "standard deviation of the filters' initial mean position, which they know",
        unit="m",
        least=1e-6,
        most=1e6,
    )
    height_m: float | None = param(
        None,
        "known height of the target, for methods in the plane; null: unknown, and 0 in a file "
        "without z_m",
        unit="m",
    )
    bounds_m: Sequence[Sequence[float]] | None = bounds_param()
    origin_deg: Sequence[float] | None = origin_param()
    start_s = None  # filters start at the first row

    _files = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "motion", motion_of(self.motion))
        with loaded.reading() as files:  # now, so that mistakes are reported at construction
            _ = self._track
        object.__setattr__(self, "_files", files())
        self._check_bounds()

    def _check_bounds(self) -> None:
        """Raise BadValue for bounds that are not in order or do not hold the track."""
        if self.bounds_m is None:
            return
        low, high = check_array("bounds_m", self.bounds_m, (2, 2))
        points = self._track[0][:, :2]
        if not np.all(low < high) or np.any(points < low) or np.any(points > high):
            span = [points.min(axis=0).round(3).tolist(), points.max(axis=0).round(3).tolist()]
            allowed = f"lower and upper corner of an area that holds the track: {span}; or null"
            raise BadValue("bounds_m", self.bounds_m, allowed)

    @property
    def files(self) -> tuple[DataFile, ...]:
        """The files that the scenario was read from, as they were then."""
        return self._files

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the files, to print."""
        table = self._file.table
        names = header("path", str(table.path))
        left = [name for name in names if name and name not in table.names.values()]
        unread = (f"{table.path}: columns that are not read: {listed(left)}",) if left else ()
        return (*self._anchors.notes, *table.notes, *unread)

    @cached_property
    def true_anchors(self) -> Anchors:
        """The true anchors (1, 1, B, ...)."""
        return self._anchors.anchors

    @property
    def known_height_m(self) -> float | None:
        """`height_m`, which estimators know."""
        return self.height_m

    def truth(self, rng: np.random.Generator) -> Array:
        """True positions (T, 3) m, a row for each of the file."""
        return self._track[0].copy()

    def times(self, steps: int) -> Array:
        """The time (T,) s of each step: that of the file, or steps of dt from 0."""
        return self._track[1][:steps]

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array] | None:
        """Mean (n,) drawn around the true start and 0, and covariance (n, n), of position in m and
        what else the motion model has; None without one.
        """
        if self.motion is None:
            return None
        sigma = np.concatenate([np.full(3, self.prior_sigma_m), self.motion.start()])
        mean = np.zeros(len(sigma))
        mean[:3] = truth[0, :3] + self.prior_sigma_m * rng.standard_normal(3)
        return mean, np.diag(sigma**2)

    @cached_property
    def _anchors(self) -> AnchorsFile:
        if isinstance(self.anchors, AnchorLayout):
            ids = [str(i + 1) for i in range(len(self.anchors.position_m))]
            return AnchorsFile(ids, self.anchors.known, None, ())
        file = str(plan.find("anchors", self.anchors))
        return read_anchors("anchors", file, Origin.given(self.origin_deg))

    @cached_property
    def _file(self) -> Truth:
        path = str(plan.find("path", self.path))
        return read_truth("path", path, "s", self._anchors, timed=False)

    @cached_property
    def _track(self) -> tuple[Array, Array]:
        """Positions (T, 3) m and times (T,) s of the rows."""
        file = self._file
        if file.tag is not None and len(set(file.tag)) > 1:
            raise file.table.bad(f"{TRACK}; it has the tags {', '.join(sorted(set(file.tag))[:3])}")
        height = 0.0 if self.height_m is None else self.height_m
        position = np.where(np.isnan(file.position), height, file.position)
        if file.start is None:
            return position, self.dt * np.arange(float(len(position)))
        early = np.diff(file.start, prepend=-np.inf) <= 0
        column = "start" if "start" in file.table.names else "time"
        file.table.check(column, early, "times that increase from row to row")
        return position, file.start
