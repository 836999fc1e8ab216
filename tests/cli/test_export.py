"""`aoabench export`: the numbers of summary.parquet in each format."""

import json
import re
import shlex
from io import StringIO

import numpy as np
import pandas as pd
import pytest

import aoabench
from aoabench.report.exported import Exported, Metric, by_value
from aoabench.report.latex import escaped, latex
from aoabench.store import tables

NAME = "rmse_mean_3d_m"


@pytest.fixture(scope="module")
def summary(small_run):
    return tables.shown(small_run, "summary")["summary"]


def tabular(text):
    """The cells of each line of a tabular, with the number of columns that it declares; \\multicolumn
    counts as many cells as it spans.
    """
    assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    head = re.search(r"\\begin{tabular}{(.*)}\n", text)[1]
    kinds = re.sub(r"@{.*?}|\[.*?\]", "", head)
    assert set(kinds) <= set("lrS"), kinds
    lines = [line for line in text.splitlines() if line.endswith(r"\\")]
    for line in lines:
        spans = [int(n) for n in re.findall(r"\\multicolumn{(\d+)}", line)]
        cells = len(re.split(r"(?<!\\)&", line)) + sum(spans) - len(spans)
        assert cells == len(kinds), line
    return head, [[c.strip() for c in re.split(r"(?<!\\)&", line[:-2])] for line in lines]


def test_csv_and_json_hold_the_numbers_of_the_summary(small_run, summary, call):
    status, out, err = call("export", small_run, "--csv", "--metric", "all")
    assert (status, err) == (0, "")
    read = pd.read_csv(StringIO(out), dtype=str)
    numbers = [c for c in read.columns if c in summary and summary[c].dtype.kind == "f"]
    read[numbers] = read[numbers].map(float)  # all digits, unlike read_csv
    assert len(numbers) > 60
    assert {NAME, f"{NAME}_low", "cep95_m_high", "availability"} <= set(numbers)
    pd.testing.assert_frame_equal(read[numbers], summary[numbers], check_exact=True)
    assert list(read["noise"]) == list(summary["noise"])
    assert (read["seed"] == "1").all()
    timing = tables.shown(small_run, "timing")["timing"].set_index(["cell", "estimator"])
    for row in read.itertuples():
        assert (
            float(row.seconds_per_step) == timing.loc[(row.cell, row.estimator), "seconds_per_step"]
        )
    found = json.loads(call("export", small_run, "--json")[1])
    assert found["schema"] == 1
    assert [row[NAME] for row in found["rows"]] == list(summary[NAME])
    assert found["varied"] == ["noise", "estimator"]
    assert found["fixed"]["scenario"] == "square_track"


def test_a_missing_number_is_null_in_json_and_empty_in_csv(small_run, summary, call):
    assert summary["cep95_m"].isna().all(), "no steps are stored"
    found = json.loads(call("export", small_run, "--json", "--metric", "cep95_m")[1])
    assert {row["cep95_m"] for row in found["rows"]} == {None}
    assert call("export", small_run, "--csv", "--metric", "cep95_m")[1].endswith(",,,\n")
    text = call("export", small_run, "--latex", "--metric", "cep95_m")[1]
    assert [row[2] for row in tabular(text)[1][1:]] == ["{--}"] * 4


def test_latex_rounds_to_the_interval_as_run_does(small_run, summary, call):
    status, out, err = call("export", small_run, "--latex")
    assert (status, err) == (0, "")
    _, rows = tabular(out)
    assert rows[0][:2] == ["noise", "estimator"]
    shown = {(noise, name.replace("\\", "")): rest for noise, name, *rest in rows[1:]}
    for row in summary.itertuples():
        value, interval = shown[(row.noise.replace("_", r"\_"), row.estimator)][:2]
        half = (row.rmse_mean_3d_m_high - row.rmse_mean_3d_m_low) / 2
        places = len(value.partition(".")[2])
        assert float(value) == round(row.rmse_mean_3d_m, places)
        assert 10 <= half * 10**places < 100, "two digits of the half-width"
        assert (
            interval
            == f"[{row.rmse_mean_3d_m_low:.{places}f}, {row.rmse_mean_3d_m_high:.{places}f}]"
        )
    one = call("export", small_run, "--latex", "--digits", 1)[1]
    assert len(tabular(one)[1][1][2]) == len(tabular(out)[1][1][2]) - 1
    comments = [line for line in out.splitlines() if line.startswith("%")]
    assert "3 replications" in comments[1]
    assert "seed 1" in comments[1]
    assert "aoabench export" in comments[2]
    assert "booktabs" in comments[3]


def test_by_makes_a_group_of_columns_for_each_value(small_run, summary, call):
    words = ["export", small_run, "--by", "noise", "--metric", NAME]
    head, *rows = tabular(call(*words, "--latex")[1])[1]
    assert head == ["", r"\multicolumn{2}{c}{noise = ae\_flip}", r"\multicolumn{2}{c}{noise = vmf}"]
    assert [row[0] for row in rows] == ["estimator", r"ekf\_vmf", r"ekf\_ae\_nominal"]
    of = summary.set_index(["noise", "estimator"])[NAME]
    for column, noise in ((1, "ae_flip"), (3, "vmf")):
        places = len(rows[1][column].partition(".")[2])
        assert float(rows[1][column]) == round(of[noise, "ekf_vmf"], places)
    text = call(*words, "--markdown")[1]
    command = text.partition("aoabench export ")[2].partition(" -->\n")[0]
    assert shlex.split(command)[1:] == ["--markdown", f"--metric={NAME}", "--by=noise"]
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.replace(r"\|", "").count("|") for line in table}) == 1
    assert "mean RMSE 3-D [m], noise = vmf" in table[0].replace("\\", "")
    assert len(table) == 4


def made(**columns):
    """A table with these columns, of one metric."""
    frame = pd.DataFrame(columns)
    frame["replications"], frame["causal"] = 5, True
    keys = [c for c in columns if not c.startswith("cep95_m")]
    return Exported("run", frame, keys, keys, [Metric.of("cep95_m", frame.columns)])


def test_names_cannot_break_a_table():
    nasty = ["a_b & c%", r"[x]\y", "{~^}#$", "a | b\nc"]
    table = made(estimator=nasty, cep95_m=[1.0, 123456.0, 2e-7, np.nan])
    _, rows = tabular(latex(table, ["100 %\nof x"]))
    assert len(rows) == 5
    assert rows[2][0] == r"{[}x]\textbackslash{}y"
    assert [row[1] for row in rows[1:]] == ["1", "1.235e+05", "2e-07", "{--}"]
    assert "S[table-format=1.3e-10]" in latex(table, [])
    assert escaped("a_b") == r"a\_b"
    assert latex(table, ["100 %\nof x"]).startswith("% 100 % of x\n")


def test_a_combination_that_the_run_lacks_is_empty():
    table = made(noise=["a", "a", "b"], estimator=["x", "y", "y"], cep95_m=[1.0, 2.0, 3.0])
    groups = dict(by_value(table, "noise"))
    assert list(groups["a"]["cep95_m"]) == [1.0, 2.0]
    assert np.isnan(groups["b"]["cep95_m"][0])
    assert groups["b"]["cep95_m"][1] == 3.0
    _, rows = tabular(latex(table, [], by="noise"))
    assert rows[-2:] == [["x", "1", "{--}"], ["y", "2", "3"]]


def test_a_file_has_the_format_of_its_ending(small_run, tmp_path, call):
    for ending, flag in (
        (".tex", "--latex"),
        (".md", "--markdown"),
        (".csv", "--csv"),
        (".json", "--json"),
    ):
        file = tmp_path / "new folder" / f"table{ending}"
        assert call("export", small_run, "-o", file) == (0, "", "")
        assert file.read_text(encoding="utf-8") == call("export", small_run, flag)[1]


@pytest.mark.parametrize(
    ("words", "needed"),
    [
        ([], ["--latex", "--xarray", ".nc"]),
        (["-o", "table.pdf"], ["--latex", ".tex"]),
        (["--latex", "--csv"], ["one format"]),
        (["--xarray"], ["-o FILE.nc"]),
        (["--csv", "--by", "noise"], ["--by=noise", "--latex"]),
        (["--latex", "--by", "nois"], ["--by=nois", "did you mean 'noise'"]),
        (["--latex", "--by", "scenario"], ["--by=scenario", "allowed: noise, estimator"]),
        (["--csv", "--metric", "rmse_mean_3d"], ["--metric=rmse_mean_3d", "'rmse_mean_3d_m'"]),
        (["--latex", "--digits", "0"], ["--digits=0", ">= 1"]),
        (["--csv", "--replications"], ["--replications", "--xarray"]),
        (["--csv", "-o", "."], ["-o .", "folder"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(words, needed, small_run, call):
    status, out, err = call("export", small_run, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    for text in needed:
        assert text in err


def test_xarray_has_a_dimension_for_each_key(small_run, summary, tmp_path, call):
    xarray = pytest.importorskip("xarray", reason="the extra xarray is not installed")
    pytest.importorskip("netCDF4", reason="the extra xarray is not installed")
    file = tmp_path / "run.nc"
    assert call("export", small_run, "-o", file, "--replications") == (0, "", "")
    with xarray.open_dataset(file) as found:
        assert dict(found.sizes) == {"noise": 2, "estimator": 2, "replication": 3}
        for row in summary.itertuples():
            at = found.sel(noise=row.noise, estimator=row.estimator)
            assert float(at[NAME]) == row.rmse_mean_3d_m
            assert float(at[f"{NAME}_low"]) == row.rmse_mean_3d_m_low
            assert float(at["rmse_3d_m"].mean()) == pytest.approx(
                row.rmse_mean_3d_m, rel=1e-12, abs=0
            )
        assert found[NAME].attrs == {"units": "m", "long_name": "mean RMSE 3-D"}
        assert found.attrs["scenario"] == "square_track"
        assert found["causal"].values.all()


def test_xarray_without_the_library_says_what_to_install(small_run, monkeypatch, call):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    status, _, err = call("export", small_run, "-o", "run.nc")
    assert (status, "pip install 'aoabench[xarray]'" in err) == (2, True)


def test_from_python(small_run, call):
    assert aoabench.export(small_run, "csv") == call("export", small_run, "--csv")[1]
    assert aoabench.export(small_run, "json")["rows"][0][NAME] > 0
    one = aoabench.export(small_run, "csv", metrics="rmse_pooled_3d_m")
    assert one == aoabench.export(small_run, "csv", metrics=["rmse_pooled_3d_m"])
    with pytest.raises(aoabench.UserError, match="form='pdf'"):
        aoabench.export(small_run, "pdf")
