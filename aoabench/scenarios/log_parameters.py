"""Parameters of a recording: its files, and the declared conventions of their numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from aoabench.devices.readers.columns import EXISTING
from aoabench.devices.readers.formats import FORMATS
from aoabench.devices.readers.reading import ANCHOR, Reading
from aoabench.devices.tracks import log
from aoabench.devices.tracks.combining import COMBINE
from aoabench.devices.tracks.grouping import WINDOWS
from aoabench.devices.tracks.moments import SECONDS
from aoabench.models.motion import NAMED
from aoabench.params import param
from aoabench.roles import Motion, Scenario
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.log_columns import Columns
from aoabench.scenarios.parameters import bounds_param, least_heard_param, name_param, origin_param
from aoabench.types import Tracks


@dataclass(frozen=True)
class LogParameters(Scenario, ABC):
    """Parameters of a recorded scenario."""

    name: str = name_param()
    path: Sequence[Any] | str = param(
        help="log: a file, a list of files or a pattern such as logs/*.csv, read as one",
        allowed=f"an {EXISTING}, a list of such files, or a pattern",
    )
    anchors: AnchorLayout | str | None = param(
        None,
        "file of the anchors, or a layout; null: the log has the positions of its receivers",
        kind=AnchorLayout,
        allowed=f"an {EXISTING}, an AnchorLayout, or null",
    )
    format: str = param(
        "auto",
        "format of the log: a table, u-blox lines (+UUDF) or Silicon Labs angles; auto: recognised",
        choices=FORMATS,
    )
    header: Sequence[Any] | None = param(
        None, "names of the columns of a table without a header; null: from the table"
    )
    separator: str | None = param(
        None, "character between a table's cells, tab or space; null: recognised"
    )
    decimal: str | None = param(None, "decimal mark of a table's numbers; null: recognised")
    encoding: str | None = param(
        None, "encoding of a text, such as cp1252; null: UTF-8, or UTF-16 by its mark"
    )
    columns: Columns = param(
        Columns(),
        "names of the file's columns",
        kind=Columns,
        allowed="the names of columns, see Columns",
    )
    anchor_ids: Sequence[Any] | None = param(
        None, "ids in the recording of a layout's anchors; null: numbers from 1"
    )
    unknown_anchors: str = param(
        "error",
        "treatment of rows of anchors that are not listed: an error, or left out (ignore)",
        choices=("error", "ignore"),
    )
    tags: Sequence[Any] | None = param(None, "tags that are used; null: all of the log")
    window_s: float = param(
        0.0,
        "length of the windows that make fixes of rows; 0: rows of one sequence number, or else of "
        "equal time. Not used where the log numbers its fixes",
        unit="s",
        least=0,
        most=1e9,
    )
    windows: str = param(
        "first",
        "rows of a window: first, those up to window_s after the first one; grid, those in one "
        "cell of a clock grid; chained, those at most window_s after the one before",
        choices=WINDOWS,
    )
    combine: str = param(
        "error",
        "treatment of several rows of an anchor in a fix: an error if they differ; each, all are "
        "used side by side; the first or last is used; the median or mean, circular for angles",
        choices=COMBINE,
    )
    gap_s: float | None = param(
        None, "a longer silence of a tag starts a new track; null: none does", unit="s", above=0
    )
    time_unit: str = param("s", "unit of times that are numbers", choices=tuple(SECONDS))
    azimuth_unit: str = param("deg", "unit of azimuths", choices=tuple(log.TURN))
    azimuth_sense: str = param(
        "counterclockwise",
        "sense of azimuths, seen from above (from the +z of the frame)",
        choices=("counterclockwise", "clockwise"),
    )
    azimuth_zero_deg: float = param(
        0.0,
        "direction of azimuth 0, counter-clockwise from the +x of the frame",
        unit="deg",
        least=-360,
        most=360,
    )
    elevation_unit: str = param("deg", "unit of elevations", choices=tuple(log.TURN))
    elevation_kind: str = param(
        "elevation",
        "elevation: up from the horizontal; depression: down from it; zenith: from straight up; "
        "none: not used",
        choices=("elevation", "depression", "zenith", "none"),
    )
    elevation_limit_deg: float = param(
        90.0,
        "largest valid elevation; simulated elevations not folded at the poles need 180",
        unit="deg",
        above=0,
        most=180,
    )
    negative_sigma: str = param(
        "error",
        "treatment of a negative deviation: an error; absent, the angle was not measured (no line "
        "of sight); absolute, its absolute value is used",
        choices=log.SIGMAS,
    )
    rssi_absent: Sequence[float] = param(
        (127, -128),
        "signal strengths that mean not available, as devices write them; some write 0",
        unit="dBm",
    )
    range_sigma_m: float | None = param(
        None,
        "standard deviation of ranges without a stated one above 0; null: those are not used",
        unit="m",
        above=0,
    )
    frame: str = param(
        "own",
        "axes of the angles: own, those of the device that measured (mobile: x ahead); or global",
        choices=("own", "global"),
    )
    measured_by: str = param(
        "anchor",
        "device that measured: anchor, the mobile's direction; or mobile, the anchors' directions",
        choices=("anchor", "mobile"),
    )
    heading_deg: float | None = param(
        None,
        "direction of the mobile's +x, counter-clockwise from the global +x, if the mobile "
        "measured in its own frame; null: from the column of headings",
        unit="deg",
        least=-360,
        most=360,
    )
    height_m: float | None = param(
        None,
        "known height of the target, for methods in the plane; null: unknown",
        unit="m",
    )
    bounds_m: Sequence[Sequence[float]] | None = bounds_param()
    truth_file: str | None = param(
        None,
        "file of true positions: instants (time), marks (start, end), or fixes (fix or sequence)",
        key="truth",
    )
    truth_gap_s: float = param(
        1.0,
        "longest gap between two instants across which true positions are interpolated",
        unit="s",
        least=0,
    )
    truth_offset_s: float = param(
        0.0, "what is added to the times of true positions", unit="s", least=-1e12, most=1e12
    )
    step_s: float | None = param(
        None,
        "time from fix to fix, for filters on a log without times; null: they do not run on it",
        unit="s",
        least=1e-6,
        most=1e6,
        key="dt",
    )
    motion: Motion | None = param(
        None,
        "motion model that filters assume: a name with the defaults, of a walking person, or one "
        "with parameters; null: fixes are independent",
        kind=Motion,
        also=tuple(NAMED),
    )
    start_sigma_m: float = param(
        1.0, "standard deviation of the position at which filters start", unit="m", above=0
    )
    weight: str = param(
        "fix",
        "what counts alike in errors: each fix, or each true position (mark) however long the stop",
        choices=("fix", "mark"),
    )
    origin_deg: Sequence[float] | None = origin_param()
    least_heard: float = least_heard_param()

    @property
    def reading(self) -> Reading:
        """How the log is read."""
        named = [name for name in asdict(self.columns).values() if name and ANCHOR in name]
        header = None if self.header is None else tuple(map(str, self.header))
        marks = self.separator, self.decimal
        return Reading(self.format, header, *marks, tuple(named), self.encoding)

    @property
    def turns(self) -> bool:
        """Whether the angles are in axes that turn with the anchors."""
        return self.frame == "own" and self.measured_by == "anchor"

    def declared(self, stated: Mapping[str, Any]) -> dict[str, Any]:
        """The parameters by name; those with their default value as the log's format has them."""
        defaults = {f.name: f.default for f in fields(self)}
        own = {name: getattr(self, name) for name in defaults}
        return own | {n: value for n, value in stated.items() if own[n] == defaults[n]}

    @property
    @abstractmethod
    def tracks(self) -> Tracks:
        """The recorded tracks, one after the other."""
