"""The end of reproduce and report: one screen, and the list of all claims."""

import math

import pandas as pd
import pytest

from aoabench.studies import claims, screen, study
from aoabench.studies.claims import Claim, Limits, Reading
from aoabench.studies.statements import JUDGED, READ, Verdicts

LONG = "the root mean square error of the first method is well below that of the second one " * 3


def made_up(words, counts=True):
    """Studies and verdicts with one claim "> 0" a word; the k-th number lies k s.e. from 0."""
    rows, readings, found = [], [], {}
    for k, (name, word) in enumerate(words, 1):
        claim = Claim(f"c{k}", "item", "statement", LONG, (Reading(("x",), {}),), above=0.0)
        found.setdefault(name, []).append(claim)
        number = {"ours": -0.5 * k, "se": 0.5, "low": -1.0, "high": 1.0, "unit": "m"}
        common = {"study": name, "item": "item", "id": claim.id, "verdict": word, **number}
        rows.append({**dict.fromkeys(JUDGED, ""), **common, "what": LONG, "printed": "> 0 m", "counts": counts})  # fmt: skip
        readings.append({**dict.fromkeys(READ, ""), **common, "robustness": False})
    studies = [study.Study(n, None, "", "", (), tuple(c), ()) for n, c in found.items()]
    frames = (pd.DataFrame(rows, columns=list(JUDGED)), pd.DataFrame(readings, columns=list(READ)))
    return Verdicts(*frames), studies


WORDS = [(f"study{i % 4}", ("holds", "fails", "undecided", "depends")[i % 3]) for i in range(60)]


def test_one_screen_has_at_most_20_lines_of_100_columns():
    text = screen.screen(*made_up(WORDS))
    lines = text.splitlines()
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 100
    assert lines[1].split() == ["study0", "5", "0", "5", "5", "0"]
    assert lines[5].split() == ["all", "20", "0", "20", "20", "0"]


def test_each_study_is_named_in_turn_failures_and_far_ones_first():
    verdicts, studies = made_up([("a", "fails"), ("a", "fails"), ("a", "holds"), ("b", "holds"), ("b", "undecided")])  # fmt: skip
    rows = screen._interesting(verdicts, studies)
    assert [r["id"] for r in rows] == ["c2", "c1", "c5", "c4", "c3"]
    many, studies = made_up([("a", "fails")] * 9 + [("b", "holds")])
    rows = screen._interesting(many, studies)
    assert [r["id"] for r in rows] == ["c9", "c8", "c7", "c6", "c10"], "b has its turn"


def test_what_does_not_count_is_not_named():
    assert screen.screen(*made_up(WORDS, counts=False)) == "no claims that can fail"
    verdicts, studies = made_up([("a", "not judged")])
    assert screen.screen(verdicts, studies).splitlines()[1].split() == [
        "a",
        "0",
        "0",
        "0",
        "0",
        "1",
    ]
    assert "interesting" not in screen.screen(verdicts, studies)


@pytest.mark.parametrize(
    ("limits", "value", "se", "away"),
    [
        (Limits(low=1.0), 3.0, 0.5, 4.0),
        (Limits(1.0, 2.0), 2.5, 0.5, 1.0),
        (Limits(low=1.0), 3.0, 0.0, math.inf),
        (Limits(low=1.0), 1.0, 0.0, 0.0),
        (Limits(low=1.0), 3.0, math.nan, 0.0),
        (Limits(), 3.0, 1.0, 0.0),
    ],
)
def test_the_distance_is_in_standard_errors(limits, value, se, away):
    assert screen.distance(limits, value, se) == away


def test_the_list_of_all_claims_is_wrapped():
    verdicts, _ = made_up(WORDS)
    lines = screen.everything(verdicts.claims).splitlines()
    assert max(map(len, lines)) <= 100
    assert sum(line.startswith(("holds", "fails", "undecided")) for line in lines) == 60
    assert sum("claimed > 0 m, ours" in line for line in lines) == 60


def test_the_screen_of_the_shipped_studies_fits(tmp_path):
    from aoabench.studies import statements

    studies = [study.load(name) for name in study.names()]
    lines = screen.screen(statements.verdicts(studies, tmp_path), studies).splitlines()
    assert len(lines) <= 20
    assert claims.CLASSES.keys() >= {"number", "statement"}


def test_a_study_without_claims_has_a_screen(tmp_path):
    from aoabench.studies import statements

    mine = [study.load("leaderboard")]
    verdicts = statements.verdicts(mine, tmp_path)
    assert screen.screen(verdicts, mine) == "no claims that can fail"
    assert screen.everything(verdicts.claims).startswith("of 0 statements")


def test_readings_belong_to_their_study(tmp_path):
    from aoabench.studies import statements

    verdicts = statements.verdicts([study.load("lu2019")], tmp_path)
    assert set(verdicts.readings["study"]) == {"lu2019"}
    some = verdicts.of({("lu2019", "fig3")})
    assert set(some.claims["item"]) == set(some.readings["item"]) == {"fig3"}
