"""Where reproduce, report, the bench and the animation write, and what git sees of it."""

import subprocess
from pathlib import Path

import pytest

from aoabench.resources import output_folder
from aoabench.studies import places
from aoabench.studies.places import Places

ROOT = Path(__file__).parents[2]
R = Path("results")


def test_each_scale_has_folders_of_its_own_and_both_share_the_replications():
    quick, paper = places.of_scale("quick"), places.of_scale("paper")
    assert quick == Places(R / "quick", R / "quick", R / "raw", R / "bench")
    assert paper == Places(R, R, R / "raw", R / "bench")


def test_a_folder_of_the_user_is_used_as_it_is(tmp_path):
    inside = Places(tmp_path, tmp_path, tmp_path / "raw", tmp_path / "bench")
    for scale in ("quick", "paper"):
        assert places.of_scale(scale, tmp_path) == inside
        assert places.of_report(scale, tmp_path) == inside


@pytest.mark.parametrize(("commit", "drawn"), [(None, "results/draft"), ("", "results/draft"), ("0", "results/draft"), ("1", "results")])  # fmt: skip
def test_committed_places_are_written_with_commit_only(commit, drawn, monkeypatch):
    if commit is None:
        monkeypatch.delenv("COMMIT", raising=False)
    else:
        monkeypatch.setenv("COMMIT", commit)
    assert output_folder() == Path(drawn)
    assert places.of_report("paper") == Places(R, Path(drawn), R / "raw", R / "bench")
    assert places.of_report("quick") == places.of_scale("quick")


def test_advice_names_the_options_that_write_the_same_tables(tmp_path):
    assert places.of_scale("quick").options == ""
    assert places.of_report("paper").options == places.of_scale("paper").options == " --scale paper"
    assert Places.inside(Path("my results")).options == " --results 'my results'"


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout")
@pytest.mark.parametrize(
    "folder", ["raw/le2021", "quick/tables", "quick/report", "draft/figures", "draft/bench"]
)
def test_git_ignores_what_commands_write(folder):
    path = f"results/{folder}/x.parquet"
    assert subprocess.run(["git", "check-ignore", "-q", path], cwd=ROOT).returncode == 0


def test_bench_and_animation_write_the_same_place(monkeypatch, tmp_path):
    import pandas as pd

    import benchmarks.__main__ as bench
    from aoabench.report import animation

    monkeypatch.delenv("COMMIT", raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["benchmarks", "--only", "start"])
    monkeypatch.setattr(bench, "measured", lambda *_: pd.DataFrame({"part": ["start"]}))
    for drawing in (bench.show, bench.cost):
        monkeypatch.setattr(drawing, "draw", lambda _, path: path.touch())
    page = tmp_path / "docs" / "reference" / "benchmarks.md"
    page.parent.mkdir(parents=True)
    page.write_text("as it was")
    bench.main()
    assert (tmp_path / "results" / "draft" / "bench" / "bench.parquet").exists()
    assert page.read_text() == "as it was"
    traces = sorted((ROOT / "results" / "tables").glob("track-*.parquet"))
    monkeypatch.setattr(animation, "write", lambda _traces, _anchors, path: written(path))
    animation.main([str(path) for path in traces])
    assert (tmp_path / "results" / "draft" / "figures" / "track.gif").exists()
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == ["draft"]


def written(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path
