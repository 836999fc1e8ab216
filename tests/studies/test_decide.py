"""More replications for undecided claims: what they need, what the command adds, where it stops."""

import pandas as pd
import pytest
import yaml

from aoabench.errors import UserError
from aoabench.store.files import read_provenance
from aoabench.studies import claims, computing, decide, reproduce, statements, study
from aoabench.studies.places import Places
from aoabench.studies.study import Item, Study

PAPER = 8


def made_up(folder, limits, readings=("mean",), **item):
    """A study with one item, the mean RMSE of least squares on the base station grid, and a claim
    on it for each pair of limits.
    """
    folder.mkdir(exist_ok=True)
    entries = [
        {"id": f"c{i}", "item": "grid", "class": "statement", "what": "w", "where": "p", "quote": "q",
         "readings": [{"of": of, "error": of} for of in readings], "above": float(limit), "chosen": "paper"}
        for i, limit in enumerate(limits)
    ]  # fmt: skip
    (folder / "claims.yaml").write_text(yaml.safe_dump({"claims": entries}))
    (folder / "numbers.py").write_text(
        "import pandas as pd\nfrom aoabench.maths import statistics\n"
        "def grid(runs):\n"
        "    e = statistics.mean(runs['rmse_3d_m'])\n"
        "    return pd.DataFrame([{'value': e.value, 'se': e.se, 'n': len(runs)}])\n"
    )
    (folder / "figures.py").write_text(
        "from aoabench.maths.statistics import Estimate\n"
        "def grid_values(frame):\n"
        "    value, se = frame[['value', 'se']].iloc[0]\n"
        "    return {'mean': Estimate(value, se), 'thrice': Estimate(value, 3 * se)}\n"
    )
    scale = {"quick": ["reps=4"], "paper": [f"reps={PAPER}"]}
    items = (Item("grid", "t", "c", figure=False, experiment="le2021_zones", scale=scale, **item),)
    found = claims.load(folder / "claims.yaml", ["grid"])
    return Study(folder.name, folder, "title", "cite", items, found.claims, ())


@pytest.fixture
def few(monkeypatch):
    """Any experiment becomes four positions of the grid with least squares."""
    compose = computing.compose_cells

    def cells(overrides):
        kept = [o for o in overrides if not o.startswith("experiment")]
        return compose([*kept, "scenario=bs_grid", "scenario.positions=4", "estimator=ls", "noise=ae_normal", "runner.n_jobs=1"])  # fmt: skip

    monkeypatch.setattr(computing, "compose_cells", cells)
    monkeypatch.setattr(reproduce.page, "write", lambda *args: args[2].drawn / "index.html")

    def only(s):
        monkeypatch.setattr(reproduce, "all_studies", lambda: [s.name])
        monkeypatch.setattr(study, "load", lambda _: s)
        return Places.inside(s.folder / "results")

    return only


def stored(s, places):
    path = study.table_path(places.results, s, s.items[0])
    return pd.read_parquet(path).iloc[0], read_provenance(path)


def test_undecided_claims_get_the_replications_that_they_need(few, tmp_path):
    first = made_up(tmp_path / "first", [0.0])
    places = few(first)
    reproduce.reproduce([], "paper", None, places, lambda _: None)
    row, _ = stored(first, places)
    half = 2.968 * row["se"]
    limits = [row["value"] - 3 * half, row["value"] - 0.6 * half, row["value"] - 0.01 * half]
    second = made_up(tmp_path / "first", limits)
    places, said = few(second), []
    before = statements.verdicts([second], places.results).claims
    assert list(before["verdict"]) == ["holds", "undecided", "undecided"]
    need = decide.needs([(second, second.items[0])], places.results)
    assert list(need.left) == ["first c2"]
    assert need.left["first c2"] == "needs N = 80000, beyond ten times the study's"
    (item,) = need.items
    assert item.claims == ("first c1",)
    assert item.reps == pytest.approx(1.15 * PAPER / 0.6**2, abs=2)
    done = reproduce.decide([], None, places, said.append)
    assert done.computed
    row, origin = stored(second, places)
    assert row["n"] == origin["config"]["reps"] > PAPER
    after = done.drawn.verdicts.claims.set_index("id")["verdict"]
    assert after["c1"] != "undecided" or row["n"] > 9 * PAPER
    assert any(line.startswith("first grid: N = ") for line in said)
    again = reproduce.decide([], None, places, said.append)
    assert not again.computed, "nothing is left to decide"


def test_the_budget_is_kept(few, tmp_path):
    s = made_up(tmp_path / "mine", [0.0])
    places = few(s)
    reproduce.reproduce([], "paper", None, places, lambda _: None)
    row, _ = stored(s, places)
    s = made_up(tmp_path / "mine", [row["value"] - 0.6 * 2.968 * row["se"]])
    places, said = few(s), []
    done = reproduce.decide([], None, places, said.append, budget_s=1e-6)
    assert not done.computed
    assert any("beyond --budget" in line for line in said)


def test_units_that_are_not_replications_are_not_added(few, tmp_path):
    s = made_up(tmp_path / "mine", [0.0])
    places = few(s)
    reproduce.reproduce([], "paper", None, places, lambda _: None)
    row, _ = stored(s, places)
    s = made_up(tmp_path / "mine", [row["value"]], counts="positions")
    few(s)
    need = decide.needs([(s, s.items[0])], places.results)
    assert not need.items
    (reason,) = need.left.values()
    assert "their number is the paper's" in reason


def test_the_replications_beyond_reach_are_those_of_the_reading_that_needs_most(few, tmp_path):
    s = made_up(tmp_path / "mine", [0.0])
    places = few(s)
    reproduce.reproduce([], "paper", None, places, lambda _: None)
    row, _ = stored(s, places)
    limit = row["value"] - 0.01 * 2.968 * row["se"]
    s = made_up(tmp_path / "mine", [limit], readings=("thrice", "mean"))
    few(s)
    need = decide.needs([(s, s.items[0])], places.results)
    assert need.left == {"mine c0": "needs N = 720000, beyond ten times the study's"}


def test_an_unknown_item_is_one_line(tmp_path):
    with pytest.raises(UserError, match="--only=fig9"):
        reproduce.decide(["le2021"], "fig9", Places.inside(tmp_path), lambda _: None)
