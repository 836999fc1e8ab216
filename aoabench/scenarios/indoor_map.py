"""A robot on a route through walled corridors, seen by access nodes (ANs) on the walls [Lu 2019,
V-A].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from aoabench import loaded
from aoabench.devices.anchors import SCHEMA
from aoabench.devices.geodesy import Origin
from aoabench.devices.plans import plan
from aoabench.devices.plans.drawing import UNITS
from aoabench.devices.plans.floor_plan import FloorPlan
from aoabench.devices.plans.routes import Route, waypoints
from aoabench.errors import BadValue
from aoabench.loaded import DataFile
from aoabench.maths.geometry import Array
from aoabench.params import param
from aoabench.roles import Motion, Scenario
from aoabench.scenarios.parameters import least_heard_param, name_param, origin_param
from aoabench.scenarios.route import RoundedRoute, states
from aoabench.types import Anchors

MOST_STEPS = 1_000_000
STATE = "a motion model of position, velocity and acceleration (9 numbers)"


def _prior_sigma(default: float, help: str, unit: str) -> Any:
    return param(default, help, unit=unit, least=1e-9, most=1e6)


@dataclass(frozen=True)
class IndoorMap(Scenario):
    """One trip along a route at constant horizontal speed, with corners rounded to arcs.

    The height is linear along the route. `devices.anchors` and `devices.plans.plan` describe the
    files. An AN on a wall sees into the side that it faces (`devices.plans.sight`). The network
    reports the nearest ANs in line of sight (seen from above), by true distance; their signals are
    the strongest. Filters start from a mean position drawn around the true start, and from velocity
    and acceleration 0. With `truth_from: model` the true states are drawn from the prior at the
    first waypoint and from `motion`, so that the filters' model is exact.
    """

    name: str = name_param()
    anchors: str = param(
        help="file of the ANs: x_m, y_m and, where needed, id, z_m, facing_deg, pitch_deg, "
        "roll_deg",
        allowed=f"an existing file, {SCHEMA}",
    )
    route: Sequence[Sequence[float]] | str = param(
        help="waypoints x, y; or a file, GPX or CSV with x_m, y_m or lat_deg, lon_deg",
        unit="m",
        shape=(None, 2),
    )
    motion: Motion = param(help="motion model that filters assume", kind=Motion, allowed=STATE)
    walls: str | None = param(
        help="file of the walls: GeoJSON, CSV with x0_m, y0_m, x1_m, y1_m, or DXF; null: no walls",
        allowed="an existing file, or null",
    )
    walls_unit: str | None = param(
        None,
        "unit of the walls' coordinates; null: that of a DXF file, else m, refused if doubtful",
        choices=tuple(UNITS),
    )
    walls_crs: str | None = param(
        None,
        "coordinates of the walls: local, lengths in a plane; wgs84, in deg; EPSG:25832 or so "
        "(needs pyproj); null: local, refused if they seem to be in degrees or name another system",
    )
    walls_layers: Sequence[str] | None = param(
        None, "layers of a DXF file, or kinds of GeoJSON features, that are walls; null: all"
    )
    origin_deg: Sequence[float] | None = origin_param()
    corner_radius_m: float = param(
        2.0,
        "radius of the arcs that replace corners; smaller on short legs of a route from a file",
        unit="m",
        least=1e-3,
        most=1e6,
    )
    speed_m_s: float = param(1.1, "horizontal speed", unit="m/s", least=1e-3, most=1e6)
    height_m: tuple[float, float] = param(
        (1.0, 2.0),
        "height at the start and at the end of the route, linear between; not used if the route's "
        "file has heights",
        unit="m",
        shape=(2,),
    )
    dt: float = param(0.1, "time from step to step", unit="s", least=1e-3, most=1e3)
    nearest: int | None = param(
        8,
        "number of ANs that report, the nearest in line of sight; null: all in line of sight",
        least=1,
        most=1_000_000,
    )
    least_heard: float = least_heard_param()
    prior_sigma_xy_m: float = _prior_sigma(
        1.0, "standard deviation in x and in y of the filters' initial mean", "m"
    )
    prior_sigma_z_m: float = _prior_sigma(
        0.1, "standard deviation in z of the filters' initial mean", "m"
    )
    prior_sigma_velocity_m_s: float = _prior_sigma(
        1.0, "standard deviation of the initial velocity, whose mean is 0", "m/s"
    )
    prior_sigma_acceleration_m_s2: float = _prior_sigma(
        0.5, "standard deviation of the initial acceleration, whose mean is 0", "m/s^2"
    )
    truth_from: str = param(
        "route",
        "source of true states: the route, or draws from the prior and the motion model (model)",
        choices=("route", "model"),
    )
    steps: int | None = param(
        None,
        "number of steps, only with truth_from=model; null: the route's number of steps",
        least=1,
        most=MOST_STEPS,
    )

    _files = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.truth_from == "route" and self.steps is not None:
            raise BadValue("steps", self.steps, "null with truth_from=route, which gives it")
        if len(self.motion.matrices(self.dt)[0]) != 9:
            raise BadValue("motion", self.motion, STATE)
        if self.walls is None and self.walls_layers is not None:
            raise BadValue("walls_layers", self.walls_layers, "null without scenario.walls")
        # read the files now, so that mistakes in them are reported at construction
        with loaded.reading() as files:
            _ = plan.find("route", self.route) if isinstance(self.route, str) else self._path
            points = self._waypoints.points
            self._plan.check((self.anchors, self.walls), points, wanders=self.truth_from == "model")
        object.__setattr__(self, "_files", files())
        if not 1 <= self.route_steps <= MOST_STEPS:
            allowed = (
                f"one that cuts the route of {self._path.length:g} m into 1 to {MOST_STEPS} steps"
            )
            raise BadValue("dt", self.dt, allowed)

    # --- the place --------------------------------------------------------------------------------

    @property
    def files(self) -> tuple[DataFile, ...]:
        """The files that the scenario was read from, as they were then."""
        return self._files

    @cached_property
    def true_anchors(self) -> Anchors:
        """The true ANs (1, 1, B, ...); local x points along the array's broadside, and without
        pitch and roll y horizontally to its left, z up.
        """
        return self._plan.known.anchors

    @cached_property
    def _plan(self) -> FloorPlan:
        files = [plan.find("anchors", self.anchors)]
        files += [] if self.walls is None else [plan.find("walls", self.walls)]
        origin = Origin.given(self.origin_deg)
        frame = plan.Frame(self.walls_unit, self.walls_crs, origin, self.walls_layers)
        return FloorPlan.read(files, frame)

    @property
    def wall_segments(self) -> Array | None:
        """Walls (W, 2, 2) m, or None."""
        return self._plan.walls

    @property
    def visited_area_m2(self) -> float | None:
        """Area of the plan's polygon of kind `visited`, or None."""
        return self._plan.area_m2

    def line_of_sight(self, points: Array) -> np.ndarray:
        """Mask (N, B) of the ANs in line of sight of each point (N, 3) m: no wall crosses the
        straight line, seen from above; of a wall that it stands on, an AN sees the side it faces.
        """
        return self._plan.in_sight(points)

    def hears(self, points: Array) -> np.ndarray:
        """Mask (N, B) of the ANs that report a target at each point (N, 3) m: the nearest of the
        ANs in line of sight.
        """
        return self._route_reported if self._is_route(points) else self._reported(points)

    def _reported(self, points: Array) -> np.ndarray:
        if self.nearest is None or self.nearest >= self.true_anchors.count:
            return self._plan.in_sight(points)
        return self._plan.nearest_in_sight(points, self.nearest)

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines about the files, to print."""
        found = (*self._plan.notes, *self._waypoints.notes)
        if self.truth_from == "model":
            return found
        return (*found, *self._plan.crossings(self._route_truth[:, :2]))

    def offers(self) -> frozenset[str]:
        """The offers of all scenarios, less several anchors if only the nearest reports."""
        return super().offers() - (frozenset({"several_anchors"} if self.nearest == 1 else ()))

    def unheard(self) -> BadValue:
        """The error for a trip on which no AN measures."""
        allowed = (
            "a route that sees access nodes; no point of the route sees any access node (on a wall "
            "that they face away from? a route outside the building? walls between?)"
        )
        return BadValue("route", self.route, allowed)

    def _is_route(self, points: Array) -> bool:
        """Whether `points` are the route's points, whose tables are cached because all replications
        have the same route.
        """
        return self.truth_from == "route" and np.array_equal(points, self._route_truth[:, :3])

    @cached_property
    def _route_reported(self) -> np.ndarray:
        return self._reported(self._route_truth[:, :3])

    def __getstate__(self) -> dict[str, Any]:
        """The fields and tables, so that the lines of sight of the route are found once for all
        processes.
        """
        if self.truth_from == "route":
            _ = self._route_reported
        return dict(vars(self))

    # --- the route --------------------------------------------------------------------------------

    @cached_property
    def _waypoints(self) -> Route:
        return waypoints("route", self.route, self._plan.known)

    @property
    def _heights(self) -> Sequence[float] | Array:
        """Heights in m at the start and at the end, or at each waypoint of the route."""
        found = self._waypoints.heights
        return self.height_m if found is None else found

    @cached_property
    def _path(self) -> RoundedRoute:
        if isinstance(self.route, str):
            return RoundedRoute.through(self._waypoints.points, self.corner_radius_m, smaller=True)
        return RoundedRoute.through(self.route, self.corner_radius_m)

    @cached_property
    def route_steps(self) -> int:
        """Number of steps of dt s that fit on the route."""
        return math.floor(self._path.length / (self.speed_m_s * self.dt) + 1e-9)

    @cached_property
    def _route_truth(self) -> Array:
        """Position m, velocity m/s and acceleration m/s^2 (T, 9) on the route after each step."""
        arc: Array = self.speed_m_s * self.dt * np.arange(1.0, self.route_steps + 1)
        return states(self._path, arc, self.speed_m_s, self._heights)

    def truth(self, rng: np.random.Generator) -> Array:
        """True position m, velocity m/s and acceleration m/s^2 (T, 9) after each step."""
        if self.truth_from == "route":
            return self._route_truth.copy()
        F, Q = self.motion.matrices(self.dt)
        scale = np.sqrt(np.diag(Q))  # powers of dt, so that the root is accurate for any dt
        root = scale[:, None] * np.linalg.cholesky(Q / np.outer(scale, scale))
        truth = np.empty((self.steps or self.route_steps, 9))
        state = self._start + self._prior_sigma * rng.standard_normal(9)
        for k, w in enumerate(rng.standard_normal(truth.shape)):
            state = F @ state + root @ w
            truth[k] = state
        return truth

    @cached_property
    def _start(self) -> Array:
        """The state (9,) before the first step: first waypoint, velocity and acceleration 0."""
        return np.array([*self._waypoints.points[0], self._heights[0], 0, 0, 0, 0, 0, 0])

    @cached_property
    def _prior_sigma(self) -> Array:
        v, a = self.prior_sigma_velocity_m_s, self.prior_sigma_acceleration_m_s2
        return np.array([self.prior_sigma_xy_m] * 2 + [self.prior_sigma_z_m] + [v] * 3 + [a] * 3)

    def prior(self, rng: np.random.Generator, truth: Array) -> tuple[Array, Array]:
        """Mean (9,) and covariance (9, 9) of the state before the first step, in m, m/s and m/s^2.

        On the route, the position's mean is drawn around the true start, and the means of velocity
        and acceleration are 0. With `truth_from: model`, the truth varies around a fixed mean.
        """
        mean = self._start.copy()
        if self.truth_from == "route":
            mean[:3] += self._prior_sigma[:3] * rng.standard_normal(3)
        return mean, np.diag(self._prior_sigma**2)
