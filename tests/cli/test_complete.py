"""Completion, through the protocol that click's scripts for bash, zsh and fish speak."""

import pytest


@pytest.fixture
def complete(call, monkeypatch):
    """The function (words, the last one unfinished) -> list of completions."""

    def complete(*words, shell="bash"):
        monkeypatch.setenv("_AOABENCH_COMPLETE", f"{shell}_complete")
        monkeypatch.setenv("COMP_WORDS", "\n".join(["aoabench", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)) if shell != "fish" else words[-1])
        status, out, err = call()
        monkeypatch.delenv("_AOABENCH_COMPLETE")
        assert (status, err) == (0, "")
        return [line.partition(",")[2] for line in out.splitlines() if line]

    return complete


def test_commands_and_options(complete):
    assert complete("re") == ["replay", "reproduce", "report"]
    assert complete("run", "--w") == ["--worst"]
    assert complete("reproduce", "--scale", "q") == ["quick"]
    assert complete("list", "f") == ["filter"]


def test_names_of_studies_items_metrics_and_estimators(complete, small_run):
    assert complete("reproduce", "n") == ["nurminen2018"]
    assert complete("reproduce", "nurminen2018", "n") == []
    assert complete("reproduce", "le2021", "--only", "fig5") == ["fig5"]
    assert complete("reproduce", "le2021", "--only", "fig4") == [], "no item of this study"
    assert complete("reproduce", "le2021", "--only", "fig5,ta") == ["fig5,table1"]
    assert complete("reproduce", "--only", "fig4,le2021/ta") == ["fig4,le2021/table1"]
    assert complete("compare", "x", "--metric", "fai") == ["failure_rate"]
    assert complete("compare", "x", "--baseline", "pf_v") == ["pf_vmf"], "of all presets"
    run = f"'{small_run}'"
    assert complete("replay", run, "--estimator", "") == ["ekf_ae_nominal", "ekf_vmf"]


def test_overrides_whose_words_stay_whole(complete):
    """zsh, fish and quoted words in bash."""
    assert complete("run", "noi") == ["noise="]
    assert complete("run", "noise=v") == ["noise=vmf"]
    assert complete("run", "reps=2", "scenario.pa") == ["scenario.path="]
    assert complete("run", "'filter=[ekf_vmf_") == ["filter=[ekf_vmf_smoother]"]
    lists = complete("run", "'filter=[ekf_vmf,ekf_")
    assert "filter=[ekf_vmf,ekf_aoa]" in lists
    assert "filter=[ekf_vmf,ekf_vmf]" not in lists


def test_overrides_that_bash_cuts_at_equals(complete):
    assert complete("run", "noise", "=", "v") == ["vmf"]
    assert "vmf" in complete("run", "noise", "=")
    assert complete("run", "reps", "=", "2", "filter", "=", "[pf_v") == ["[pf_vmf]"]


def test_presets_of_your_own(complete, tmp_path):
    (tmp_path / "noise").mkdir()
    (tmp_path / "noise" / "mine.yaml").write_text("# Mine\n")
    assert complete("run", "--config-dir", str(tmp_path), "noise=m") == ["noise=mine"]


def test_a_file_name_is_left_to_the_shell(call, monkeypatch):
    monkeypatch.setenv("_AOABENCH_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "aoabench\nrun\nscenario.path\n=\n/da")
    monkeypatch.setenv("COMP_CWORD", "4")
    assert call() == (0, "file,/da\n", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_scripts_for_the_shells(shell, call, monkeypatch):
    monkeypatch.setenv("_AOABENCH_COMPLETE", f"{shell}_source")
    monkeypatch.setattr("click.shell_completion.BashComplete._check_version", lambda *_: None)
    status, out, err = call()
    assert (status, err) == (0, "")
    assert "_AOABENCH_COMPLETE=" in out
    assert ("compopt -o nospace" in out) == (shell == "bash"), "no space after KEY="
