"""Loading a study: its YAML files and its modules."""

import numpy as np

from aoabench.studies import computing, study


def made_up(folder):
    return study.Study("made_up", folder, "", "", (), (), ())


def test_numbers_and_figures_may_be_modules_or_packages(tmp_path):
    (tmp_path / "numbers").mkdir()
    (tmp_path / "numbers" / "__init__.py").write_text("from .inner import fig1\n")
    (tmp_path / "numbers" / "inner.py").write_text(
        "from .common import SEVEN\n\ndef fig1(scale):\n    return SEVEN\n"
    )
    (tmp_path / "numbers" / "common.py").write_text("SEVEN = 7\n")
    (tmp_path / "figures.py").write_text("def fig1_values(frame):\n    return {'a': frame}\n")
    s = made_up(tmp_path)
    assert s.numbers.fig1("quick") == 7
    assert s.figures.fig1_values(1) == {"a": 1}
    assert s.numbers is s.numbers, "loaded once"


def test_studies_with_modules_of_one_name_do_not_share_them(tmp_path):
    for name, value in (("one", 1), ("two", 2)):
        package = tmp_path / name / "numbers"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("from .inner import fig1\n")
        (package / "inner.py").write_text(f"def fig1(scale):\n    return {value}\n")
    assert [made_up(tmp_path / name).numbers.fig1("quick") for name in ("one", "two")] == [1, 2]


def computed(s, item, runs):
    """The table of an item at quick scale, and the config that it came from."""
    ran = computing.run(s, item, "quick", runs)
    return computing.reduce(s, item, "quick", runs.folder(s), ran)


def test_provenance_names_the_file_that_computes(tmp_path):
    (tmp_path / "numbers").mkdir()
    (tmp_path / "numbers" / "__init__.py").write_text("from .inner import fig1\n")
    (tmp_path / "numbers" / "inner.py").write_text("def fig1(scale):\n    return scale\n")
    item = study.Item("fig1", "", "")
    frame, origin = computed(made_up(tmp_path), item, computing.Runs(tmp_path))
    assert frame == "quick"
    assert origin["function"] == "experiments/made_up/numbers/inner.py:fig1"


def test_every_item_of_every_study_has_its_functions():
    for name in study.names():
        s = study.load(name)
        for item in s.items:
            assert callable(getattr(s.numbers, item.name)), f"{name} {item.name}"
            if item.figure:
                assert callable(getattr(s.figures, item.name)), f"{name} {item.name}"


def test_an_item_without_a_count_has_the_replications_that_its_precision_takes(tmp_path):
    """Every mean as precise as asked; more replications that lie in the folder do not count."""
    goal = ["until.metric=rmse_3d_m", "until.relative_se=0.03", "until.min_reps=10"]
    few = ["noise=vmf", "filter=[ekf_vmf,ukf_vmf]", "estimator=[]", "runner.n_jobs=1"]
    (tmp_path / "numbers.py").write_text("def kept(frame):\n    return frame\n")

    def kept(*words):
        scale = {"quick": [*few, *words]}
        item = study.Item("kept", "t", "c", experiment="nurminen2018_adaptivity", scale=scale)
        made = made_up(tmp_path)
        return computed(made, item, computing.Runs(tmp_path / "raw"))

    frame, origin = kept("scenario=square_track", *goal)
    each = frame.groupby("estimator")["rmse_3d_m"].agg(["mean", "std", "size"])
    assert (each["std"] / np.sqrt(each["size"]) <= 0.03 * each["mean"]).all()
    assert set(each["size"]) == {origin["reps"]} < set(range(10, 20_000))
    more, _ = kept("scenario=square_track", "reps=200")
    assert len(more) == 400
    again, origin = kept("scenario=square_track", *goal)
    assert len(again) == len(frame) == 2 * origin["reps"]
