"""What `import aoabench` offers, and how it shows itself."""

import inspect

import pandas as pd
import pytest

import aoabench


def test_dir_lists_the_public_names_alone():
    assert dir(aoabench) == sorted([*aoabench.__all__, "__version__"])


def test_every_public_function_explains_itself():
    """Each parameter, what is returned and what is raised."""
    for name in aoabench.__all__:
        one = getattr(aoabench, name)
        text = inspect.getdoc(one)
        assert text, name
        if inspect.isfunction(one):
            words = text.lower().replace("`", " ").replace(":", " ").replace(",", " ").split()
            lacking = [p for p in inspect.signature(one).parameters if p not in words]
            assert not lacking, (name, lacking)


def test_a_frame_knows_its_folder_cells_and_units(tmp_path):
    words = ["noise=vmf", "estimator=[ls]", "scenario.steps=2", "reps=2", "runner.n_jobs=1"]
    one = aoabench.run(*words, "noise.sigma_deg=2,5", out=tmp_path)
    other = aoabench.run(*words, "noise.sigma_deg=9", out=tmp_path)
    whole = aoabench.load(tmp_path)
    assert {frame.attrs["folder"] for frame in (one, other, whole)} == {str(tmp_path)}
    assert one.attrs["cells"] == one["cell"].unique().tolist()
    assert other.attrs["cells"] == other["cell"].unique().tolist()
    assert set(whole.attrs["cells"]) == {*one.attrs["cells"], *other.attrs["cells"]}
    units = whole.attrs["units"]
    assert units == {
        "noise.sigma_deg": "deg",
        "rmse_3d_m": "m",
        "rmse_xy_m": "m",
        "rmse_z_m": "m",
    }
    whole.to_parquet(tmp_path / "copy.parquet")  # which takes attributes of plain values alone
    assert pd.read_parquet(tmp_path / "copy.parquet").attrs == whole.attrs


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: aoabench.run(["noise=vmf"]), "a list is not allowed as an override"),
        (lambda: aoabench.run({"noise": "vmf"}), "a dict is not allowed as an override"),
        (lambda: aoabench.run(estimators=[object()]), "estimators=.*allowed: a dict"),
        (lambda: aoabench.run(out=3), "out: a int is not allowed; allowed: the folder of a run"),
        (lambda: aoabench.load(None), "out: a NoneType is not allowed"),
        (lambda: aoabench.compare(pd.DataFrame()), r"run: a DataFrame .*frame.attrs\['folder'\]"),
        (lambda: aoabench.export(pd.DataFrame()), "run: a DataFrame is not allowed"),
        (lambda: aoabench.plot(3), "source: a int .* or a frame of `load`"),
        (lambda: aoabench.locate(pd.DataFrame(), "a.csv"), "log: a DataFrame .*to_csv"),
        (lambda: aoabench.locate("l.csv", 3), "anchors: a int is not allowed"),
        (lambda: aoabench.locate("l.csv", "a.csv", ["x=1"]), "a list is not allowed"),
    ],
)
def test_arguments_of_another_kind_are_one_line(call, message):
    with pytest.raises(aoabench.UserError, match=message) as found:
        call()
    assert "\n" not in str(found.value)
