"""What `import aoabench` offers, and how it shows itself."""

import inspect

import pandas as pd

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
