"""A simulated track from a file of true positions."""

from dataclasses import replace
from pathlib import Path
from pickle import dumps, loads

import numpy as np
import pytest

from aoabench import UserError
from aoabench.config.compose import compose_cells
from aoabench.engine.draws import Draws
from aoabench.errors import BadValue
from aoabench.filters.belief import believed
from aoabench.models.motion import ConstantVelocity
from aoabench.scenarios.track import Track

ANCHORS = "id,x_m,y_m,z_m\na,0,0,2.5\nb,6,0,2.5\nc,3,5,2.5\n"


@pytest.fixture
def files(tmp_path):
    """Writes files: (name=text, ...) -> the scenario of track.csv and anchors.csv."""

    def made(track, **parameters):
        (tmp_path / "track.csv").write_text(track)
        (tmp_path / "anchors.csv").write_text(ANCHORS)
        paths = (str(tmp_path / "track.csv"), str(tmp_path / "anchors.csv"))
        return Track("mine", *paths, **parameters)

    return made


def test_a_row_is_a_step_and_its_time_that_of_the_filter(files, rng):
    place = files("x_m,y_m,z_m,time_s\n1,1,1,10\n2,1,1,10.5\n2,3,1.5,13\n", motion="random_walk")
    assert place.truth(rng).tolist() == [[1, 1, 1], [2, 1, 1], [2, 3, 1.5]]
    assert place.times(3).tolist() == [10, 10.5, 13]
    _, batch = Draws(place, compose_cells(["filter=[ekf_vmf]"])[0].noise, 1).tile(0, 2)
    Q = believed(batch, place).Q[0]
    assert np.allclose(Q[:, 0, 0], 0.25 * np.array([0, 0.5, 2.5]), rtol=1e-12, atol=0)


def test_without_times_and_heights(files, rng):
    place = files("x_m,y_m\n1,1\n2,1\n", dt=0.2, height_m=1.5)
    assert place.truth(rng).tolist() == [[1, 1, 1.5], [2, 1, 1.5]]
    assert place.times(2).tolist() == [0, 0.2]
    assert place.prior(rng, place.truth(rng)) is None
    assert "motion" not in place.offers()
    assert "height" in place.offers()


def test_the_prior_is_around_the_first_row(files):
    place = files("x_m,y_m\n3,4\n5,4\n", motion=ConstantVelocity(), prior_sigma_m=0.5)
    truth = place.truth(None)
    draws = np.array([place.prior(np.random.default_rng(i), truth)[0] for i in range(2000)])
    assert draws.shape == (2000, 6)
    assert np.array_equal(draws[:, 3:], np.zeros((2000, 3)))
    # 5 standard errors of a mean and of a deviation: a false alarm in 3 components is below 1e-5
    assert np.abs(draws[:, :3].mean(0) - [3, 4, 0]).max() < 5 * 0.5 / np.sqrt(2000)
    assert np.abs(draws[:, :3].std(0) - 0.5).max() < 5 * 0.5 / np.sqrt(4000)
    P = place.prior(np.random.default_rng(0), truth)[1]
    assert np.allclose(np.diag(P), [0.25, 0.25, 0.25, 1, 1, 0.01], rtol=1e-12, atol=0)


def test_rows_without_a_position_are_a_longer_step(files):
    place = files("time_s,x_m,y_m\n0,1,1\n1,,\n2,3,1\n")
    assert place.times(2).tolist() == [0, 2]
    assert len(place.truth(None)) == 2


@pytest.mark.parametrize(
    ("track", "parameters", "words"),
    [
        ("x_m,y_m,time_s\n1,1,0\n2,2,0\n", {}, "increase from row to row; line 3 has time_s=0"),
        ("x_m,y_m,time_s\n1,1,3\n2,2,1\n", {}, "increase from row to row; line 3 has time_s=1"),
        ("x_m,y_m\n1,here\n", {}, "finite numbers in y_m"),
        ("x_m,height\n1,1\n", {}, "x_m, y_m"),
        ("x_m,y_m,tag\n1,1,a\n2,1,b\n", {}, "one target .* it has the tags a, b"),
        ("x_m,y_m\n1,1\n", {"bounds_m": [[2, 0], [5, 5]]}, r"bounds_m.*\[\[1.0, 1.0\], \[1.0, 1.0\]\]"),
        ("x_m,y_m\n1,1\n", {"motion": "brisk"}, "motion='brisk'.*random_walk"),
        ("lat_deg,lon_deg\n60.1,24.9\n", {}, "origin_deg=None"),
    ],
)  # fmt: skip
def test_mistakes_in_the_file_are_one_line(files, track, parameters, words):
    with pytest.raises(BadValue, match=words):
        files(track, **parameters)


def test_the_preset_takes_files_from_the_command_line(tmp_path, call, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.csv").write_text(
        "x_m,y_m,z_m\n" + "".join(f"{i / 4},1,1\n" for i in range(16))
    )
    (tmp_path / "anchors.csv").write_text(ANCHORS)
    words = ["run", "scenario=track", "scenario.path=mine.csv", "scenario.anchors=anchors.csv"]
    words += ["runner.n_jobs=1"]
    code, out, err = call(*words, "scenario.motion=constant_velocity", "filter=[ekf_vmf]",
                          "estimator=[ls_lines]", "reps=4", f"runner.out={tmp_path}/out")  # fmt: skip
    assert code == 0, err
    assert "ls_lines" in out
    code, _, err = call(*words, "scenario.path=your.csv", "estimator=[ls_lines]")
    assert code == 2
    assert "scenario.path='your.csv' is not allowed; allowed: an existing file" in err


def test_its_files_belong_to_the_key_and_it_pickles():
    place = compose_cells(["scenario=track", "filter=[ekf_vmf]"])[0].scenario
    assert [file.path.name for file in place.files] == ["track_anchors.csv", "track.csv"]
    again = loads(dumps(place))
    assert again == place
    assert np.array_equal(again.times(5), place.times(5))
    assert replace(place, dt=2.0).times(3).tolist() == place.times(3).tolist()


def test_the_file_of_a_missing_scenario_is_named():
    with pytest.raises(UserError, match=r"scenario\.anchors='no\.csv' is not allowed"):
        compose_cells(["scenario=track", "scenario.anchors=no.csv", "filter=[ekf_vmf]"])


def test_columns_that_are_not_read_are_named(tmp_path, monkeypatch):
    """A log in place of a track is a mistake that a run would not show."""
    monkeypatch.chdir(tmp_path)
    words = ["scenario=track", "estimator=[ls_lines]"]
    Path("log.csv").write_text("fix,anchor,azimuth_deg,x_m,y_m\n1,a,46,2,2\n2,a,15,4,1\n")
    (cell,) = compose_cells([*words, "scenario.path=log.csv"])
    assert any(
        n.endswith("log.csv: columns that are not read: anchor, azimuth_deg") for n in cell.notes
    )
    (cell,) = compose_cells(words)
    assert not [line for line in cell.notes if "not read" in line]
