"""Notes on what a recording has and its methods do not use."""

import pytest

from aoabench.config.compose import compose_cells

ANCHORS = "id,x_m,y_m,z_m,facing_deg\na,0,0,2,0\nb,6,0,2,90\nc,3,5,2,-90\n"
NAMES = "fix,anchor,azimuth_deg,elevation_deg,rssi_dbm,range_m,range_sigma_m,azimuth_sigma_deg"
ROWS = "0,a,45,-19,-60,3,0.1,2\n0,b,63,-13,-61,4,0.1,2\n0,c,-18,-17,-62,3,0.1,2\n"
STRENGTHS = "signal strengths (scenario.columns.rssi)"
RANGES = "ranges (scenario.columns.range)"
SIGMAS = "deviations of angles (scenario.columns.azimuth_sigma)"
ELEVATIONS = "elevations (scenario.columns.elevation)"


@pytest.fixture
def notes(tmp_path):
    """The notes on unused measurements of a run with the given words."""
    (tmp_path / "anchors.csv").write_text(ANCHORS)
    (tmp_path / "log.csv").write_text(f"{NAMES}\n{ROWS}")
    files = [f"scenario.path={tmp_path}/log.csv", f"scenario.anchors={tmp_path}/anchors.csv"]

    def found(*words):
        (cell,) = compose_cells(["scenario=recorded", *files, "scenario.height_m=1", *words])
        return [note for note in cell.notes if "not used by" in note]

    return found


@pytest.mark.parametrize(
    ("words", "who", "left"),
    [
        (["estimator=[robust_ml]"], "estimator.robust_ml", [STRENGTHS, SIGMAS]),
        (["estimator=[ls_lines]"], "estimator.ls_lines", [RANGES, STRENGTHS]),
        (["estimator=[robust_ml,ls_lines]"], "any of the 2 methods", [STRENGTHS]),
        (["estimator=[rssi_anchor]"], "estimator.rssi_anchor", [RANGES]),
        (
            ["estimator=[robust_ml]", "++estimator.robust_ml.elevation_sigma_deg=null"],
            "estimator.robust_ml",
            [ELEVATIONS, STRENGTHS, SIGMAS],
        ),
        (["filter=[ekf_vmf]", "scenario.dt=1"], "filter.ekf_vmf", [RANGES, STRENGTHS]),
    ],
)
def test_measurements_that_no_method_uses_are_named(notes, words, who, left):
    assert notes(*words) == [f"in the log, and not used by {who}: {', '.join(left)}"]


def test_nothing_is_said_where_all_are_used(notes):
    assert notes("estimator=[rssi_anchor,robust_ml]", "++estimator.robust_ml.stated=true") == []
