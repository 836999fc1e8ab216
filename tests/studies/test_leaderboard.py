"""Who takes part in the leaderboards."""

import pytest

from aoabench.config import catalogue
from aoabench.config.compose import compose_cells
from aoabench.studies import study

BOARD = study.load("leaderboard")


@pytest.mark.parametrize(
    ("item", "setting"),
    [
        ("square_track", "noise=vmf"),
        ("bs_grid", "noise.sigma_deg=1"),
        ("indoor_map", "noise.an_sigma_m=0"),
        ("ble_room", "seed=1"),
    ],
)
def test_every_estimator_that_fits_takes_part_or_is_named_as_left_out(item, setting):
    """So that "best" says of which."""
    text = (BOARD.folder / "README.md").read_text(encoding="utf-8")
    part = text[text.index("**Who takes part:**") : text.index("**RMSE**")]
    (cell,) = compose_cells([f"experiment=leaderboard_{item}", setting])
    fits = catalogue.fitting_estimators(cell.scenario, cell.noise)
    left_out = {name for names in fits.values() for name in names} - set(cell.estimators)
    assert {name for name in left_out if f"`{name}`" not in part} == set()
    assert bool(left_out) == (item in ("indoor_map", "ble_room"))
