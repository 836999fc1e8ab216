"""`aoabench plot`: files, remarks and mistakes."""

import shlex

import pytest

from aoabench.cli.plot import plot
from aoabench.report.runs.kinds import KINDS


def test_the_default_lies_in_the_folder_of_the_run(call, small_run):
    status, out, err = call("plot", small_run)
    file = small_run / "plots" / "cdf.png"
    assert (status, out) == (0, f"cdf: {file}\n")
    assert err == "aoabench: kind=cdf is drawn; this run can show box, violin, curve, pairs too\n"
    assert file.read_bytes().startswith(b"\x89PNG")
    assert call("plot", small_run, "-q", "--kind", "box") == (0, "", "")
    assert (small_run / "plots" / "box.png").exists()


def test_all_options_reach_the_figure_and_the_page_has_its_command(call, small_run, tmp_path):
    page = tmp_path / "a page.html"
    given = ("--kind", "curve", "--metric", "rmse_xy_m", "--over", "noise")
    more = ("--where", "estimator=ekf_vmf", "--where", "noise=vmf,ae_flip", "-o", page)
    status, out, err = call("plot", small_run, *given, *more)
    assert (status, out, err) == (0, f"curve: {page}\n", "")
    text = page.read_text()
    (command,) = [line for line in text.splitlines() if "aoabench plot" in line]
    command = command.replace("<pre><code>", "").replace("</code></pre>", "").replace("&#39;", "'")
    words = shlex.split(command)
    assert words == ["aoabench", "plot", *map(str, (small_run, *given, *more))]
    before = page.read_bytes()
    assert call(*words[1:])[0] == 0
    assert page.read_bytes() == before


def test_pairs_with_a_baseline_are_a_pdf(call, small_run, tmp_path):
    file = tmp_path / "pairs.pdf"
    assert call("plot", small_run, "--baseline", "ekf_vmf", "-o", file)[0] == 0
    assert file.read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("--kind", "time"),
            "kind=time: it needs the steps; run the same command again with store.",
        ),
        (("--kind", "bar"), "plot: --kind: 'bar' is not allowed; allowed: cdf, box, violin, curve"),
        (("--metric", "rmse_3_m"), "metric=rmse_3_m: no such metric; did you mean 'rmse_3d_m'?"),
        (("--by", "filter"), "by filter: no such column; "),
        (("--where", "noise=vm"), "where noise=vm: no results have it; did you mean 'vmf'?"),
        (("-o", "x.jpg"), "--out='x.jpg' is not allowed; allowed: a file that ends in .png, .pdf"),
        (("--baseline", "ukf"), "baseline=ukf: not among these results"),
    ],
)
def test_a_mistake_is_one_line(call, small_run, words, message):
    status, out, err = call("plot", small_run, *words)
    assert (status, out) == (2, "")
    assert err.startswith(f"aoabench: {message}")
    assert len(err.splitlines()) == 1


def test_a_folder_beside_or_above_a_run_is_told_from_one(call, small_run):
    wrong = small_run.with_name("a sweeep")
    allowed = "allowed: the runner.out folder of a finished run\n"
    for command in ("plot", "compare", "export", "collect", "replay"):
        words = {"export": ["--csv"], "replay": ["--replication", 0, "--estimator", "ekf_vmf"]}.get(
            command, []
        )
        status, _, err = call(command, wrong, *words)
        assert (status, err) == (
            2,
            f"aoabench: {wrong}: no results here; did you mean '{small_run}'? {allowed}",
        )
        status, _, err = call(command, small_run.parent, *words)
        assert (
            err
            == f"aoabench: {small_run.parent}: no results here; it holds the runs a sweep; {allowed}"
        )
    assert status == 2


def test_a_folder_without_results_is_one_line(call, tmp_path):
    for path in (tmp_path, tmp_path / "none"):
        status, _, err = call("plot", path)
        assert (status, err) == (
            2,
            f"aoabench: {path}: no results here; allowed: the runner.out folder of a finished run\n",
        )
    file = tmp_path / "file"
    file.write_text("")
    status, _, err = call("plot", file)
    assert (status, err) == (
        2,
        f"aoabench: {file} is a file; allowed: the runner.out folder of a run\n",
    )


def test_a_folder_that_cannot_be_written_is_one_line(call, small_run, monkeypatch):
    def refuse(*_arguments, **_options):
        raise PermissionError(13, "Permission denied", str(small_run / "plots"))

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    status, _, err = call("plot", small_run, "-q", "--kind", "cdf")
    file = small_run / "plots" / "cdf.png"
    reason = "cannot be written: Permission denied; name another file with -o"
    assert (status, err) == (1, f"aoabench: {file} {reason}\n")


def test_kinds_metrics_and_columns_are_completed(small_run):
    def found(option, incomplete):
        (parameter,) = [p for p in plot.params if p.name == option]
        context = plot.make_context("plot", [str(small_run)])
        items = parameter.shell_complete(context, incomplete)
        return [item.value for item in items]

    assert found("kind", "") == list(KINDS)
    assert found("metric", "cep9") == ["cep90_m", "cep95_m"]
    assert found("by", "") == ["estimator", "noise"]
