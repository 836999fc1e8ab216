"""claims.yaml: its schema, the rows that come of it, and that it leaves nothing out."""

import os
import re
import tempfile
import warnings
from pathlib import Path

import pandas as pd
import pytest
import yaml

from aoabench.errors import UserError
from aoabench.store.files import write_frame
from aoabench.studies import claims, statements, stored, study
from aoabench.studies.study import Item, Study

RESULTS = Path(__file__).parents[2] / "results"
NUMBER = {"id": "a", "item": "i", "class": "number", "what": "w", "where": "p. 1", "quote": "is 1.0", "printed": 1.0, "rounding": 0.05}  # fmt: skip
STATEMENT = {"id": "a", "item": "i", "class": "statement", "what": "w", "where": "p. 1", "quote": "more", "above": 0, "chosen": "paper"}  # fmt: skip


def read(tmp_path, *entries, unclaimed=None):
    path = tmp_path / "claims.yaml"
    path.write_text(yaml.safe_dump({"claims": list(entries), "not judged": unclaimed or {}}))
    return claims.load(path, ["i"])


def without(entry, key):
    return {k: v for k, v in entry.items() if k != key}


@pytest.mark.parametrize(("entry", "fault"), [
    (NUMBER | {"class": "guess"}, "class 'guess'; allowed: number, statement"),
    (without(NUMBER, "class"), "class None"),
    (NUMBER | {"ourz": 1}, "unknown key 'ourz'"),
    (NUMBER | {"tolerence": 1}, "did you mean 'tolerance'"),
    (NUMBER | {"kind": "number"}, "unknown key 'kind'"),
    (without(NUMBER, "what"), "what missing"),
    (NUMBER | {"item": "j"}, "item 'j' is not in study.yaml"),
    (without(NUMBER, "quote"), "where and quote: needed"),
    (without(STATEMENT, "where"), "where and quote: needed"),
    (NUMBER | {"quote": "one two three four five six seven eight nine ten eleven twelve thirteen"}, "13 words; allowed: at most 12"),
    (without(NUMBER, "printed"), "printed: needed"),
    (NUMBER | {"above": 1, "chosen": "paper"}, "no limits beside it"),
    (without(STATEMENT, "above"), "limits: one of above, at_least, below, at_most"),
    (without(STATEMENT, "chosen"), "chosen '': who set the limits; allowed: paper, before, after"),
    (STATEMENT | {"at_least": 1}, "above excludes at_least"),
    (STATEMENT | {"quantifier": "often"}, "quantifier 'often'; allowed: for all, exists, typical"),
    (NUMBER | {"class": "fitted"}, "tolerance: needed for a target of the fit"),
    (NUMBER | {"readings": [{"of": "x"}, {"of": "y"}]}, "two have the same columns"),
    (NUMBER | {"readings": [{"layout": "x"}]}, "a reading needs `of`"),
    (NUMBER | {"of": "x", "readings": [{"of": "y"}]}, "of: belongs into readings"),
])  # fmt: skip
def test_a_claim_that_cannot_be_is_one_line(entry, fault, tmp_path):
    with pytest.raises(UserError) as caught:
        read(tmp_path, entry)
    text = str(caught.value)
    assert fault in text
    assert text.startswith(f"{tmp_path / 'claims.yaml'}: a: ")
    assert "\n" not in text


def test_an_id_occurs_once(tmp_path):
    with pytest.raises(UserError, match="occurs twice"):
        read(tmp_path, NUMBER, STATEMENT)


def judged(tmp_path, entries, numbers, scale="paper", item=None):
    """The verdicts on entries of a made-up study with our numbers, {id: (value, se)}."""
    folder = Path(tempfile.mkdtemp(dir=tmp_path))
    found = read(folder, *entries)
    folder.joinpath("figures.py").write_text(
        "from math import inf, nan\nfrom aoabench.maths.statistics import Estimate\n"
        f"def i_values(frame): return {{k: Estimate(*v) for k, v in {numbers!r}.items()}}\n"
    )
    items = (item or Item("i", "title", "caption"),)
    mine = Study(folder.name, folder, "title", "cite", items, found.claims, ())
    config = {"reps": 200}
    write_frame(
        study.table_path(folder, mine, items[0]),
        pd.DataFrame({"x": [1.0]}),
        {"scale": scale, "config": config},
    )
    return statements.verdicts([mine], folder)


def test_the_row_of_a_number(tmp_path):
    row = judged(tmp_path, [NUMBER], {"a": (1.02, 0.005)}).claims.iloc[0]
    assert (row["verdict"], row["printed"], row["ours"]) == ("holds", "1.0", 1.02)
    assert row["low"] == pytest.approx(1.02 - 2.968 * 0.005, abs=1e-5)
    assert (row["reason"], row["readings"], row["flips"]) == ("", "", "")
    assert row["shows"] == pytest.approx((2.968 + 0.842) * 0.005, abs=1e-5)


def test_the_prints_own_error_widens_its_interval_whatever_ours(tmp_path):
    entry = NUMBER | {"printed_se": 0.02}
    for se, word in ((0.001, "holds"), (0.01, "undecided"), (0.1, "undecided")):
        row = judged(tmp_path, [entry], {"a": (1.1, se)}).claims.iloc[0]
        assert row["verdict"] == word


def test_an_undecided_number_says_what_would_decide_it(tmp_path):
    row = judged(tmp_path, [NUMBER], {"a": (1.03, 0.01)}).claims.iloc[0]
    assert row["verdict"] == "undecided"
    times = (2.968 * 0.01 / 0.02) ** 2
    assert row["needed"] == pytest.approx(200 * times, rel=1e-3)
    assert row["reason"] == f"{times:.2g} times the replications would decide, N = 440"
    far = judged(tmp_path, [NUMBER], {"a": (1.049, 0.01)}).claims.iloc[0]
    assert far["reason"].endswith("beyond ten times the study's")
    assert far["reason"].startswith(f"{round((2.968 * 0.01 / 0.001) ** 2, -1):.0f} times the")
    none = judged(tmp_path, [NUMBER], {"a": (1.0, float("nan"))}).claims.iloc[0]
    assert (none["verdict"], none["reason"]) == ("undecided", "too few cases for a standard error")


def test_quantifiers_take_all_numbers_that_match(tmp_path):
    entry = STATEMENT | {"of": "at/*", "unit": "%"}
    numbers = {"at/1": (5.0, 0.1), "at/2": (-1.0, 0.1), "elsewhere": (-9.0, 0.1)}
    row = judged(tmp_path, [entry], numbers).claims.iloc[0]
    assert (row["verdict"], row["ours"], row["printed"]) == ("fails", -1.0, "> 0 %")
    row = judged(tmp_path, [entry | {"quantifier": "exists"}], numbers).claims.iloc[0]
    assert (row["verdict"], row["ours"]) == ("holds", 5.0)
    reading = judged(tmp_path, [entry], numbers).readings.iloc[0]
    assert (reading["number"], reading["numbers"]) == ("at/2", 2)


READINGS = STATEMENT | {
    "reason": "why it depends",
    "readings": [{"of": "one", "errors": "independent"}, {"of": "two", "errors": "common"}],
    "robustness": [{"of": "three", "layout": "far"}],
}


@pytest.mark.parametrize(("one", "two", "verdict"), [
    (5, 5, "holds"), (5, -5, "depends"), (-5, -5, "fails"), (5, 0, "undecided"),
])  # fmt: skip
def test_readings_and_robustness(one, two, verdict, tmp_path):
    numbers = {"one": (one, 1.0), "two": (two, 1.0), "three": (-9.0, 1.0)}
    found = judged(tmp_path, [READINGS], numbers)
    row = found.claims.iloc[0]
    assert (row["verdict"], row["ours"]) == (verdict, one)
    assert row["robustness"] == "fails in 1 of 1: far", "shown, and not counted"
    assert ("why it depends" in row["reason"]) == (verdict in ("depends", "fails"))
    assert len(found.readings) == 3
    if verdict == "depends":
        assert row["readings"] == "holds in 1 of 2: independent; fails in 1 of 2: common"


def test_limits_that_we_set_say_where_the_verdict_flips(tmp_path):
    entry = without(STATEMENT, "above") | {"below": 5, "chosen": "after", "unit": "%"}
    row = judged(tmp_path, [entry], {"a": (4.0, 0.1)}).claims.iloc[0]
    assert row["flips"] == "holds for any limit above 4.3 %"
    assert row["chosen"] == "after"
    both = judged(tmp_path, [entry | {"above": -5}], {"a": (4.0, 0.1)}).claims.iloc[0]
    assert both["flips"] == "holds for any limits around 3.7 % to 4.3 %"
    paper = judged(tmp_path, [entry | {"chosen": "paper"}], {"a": (4.0, 0.1)}).claims.iloc[0]
    assert paper["flips"] == ""


def test_with_several_readings_it_flips_where_the_last_of_them_does(tmp_path):
    """The limit of a claim that depends is not the one that its first reading would bear."""
    entry = READINGS | {"above": 3, "chosen": "after", "unit": "%"}
    numbers = {"one": (5.0, 0.1), "two": (1.0, 0.1), "three": (-9.0, 0.1)}
    found = judged(tmp_path, [entry], numbers)
    row, one, two = found.claims.iloc[0], *found.readings["flips"][:2]
    assert row["verdict"] == "depends"
    assert row["flips"] == "would hold in every reading for any limit below 0.703 %"
    assert one == "holds for any limit below 4.7 %"
    assert two == "would hold for any limit below 0.703 %"
    entry = without(entry, "above") | {"below": 9, "above": 0}
    row = judged(tmp_path, [entry], numbers).claims.iloc[0]
    assert row["flips"] == "holds in every reading for any limits around 0.703 % to 5.3 %"
    assert "ends" not in found.readings


@pytest.mark.parametrize(("kind", "more", "reason"), [
    ("input", {}, "an input of the simulation"),
    ("identity", {}, "holds by construction"),
    ("own", {"reason": "figure lost"}, "figure lost"),
    ("fitted", {"tolerance": 0.1}, "a target of our fit, missed by 3 tolerances"),
    ("number", {"not_judged": "its mean has no variance"}, "its mean has no variance"),
])  # fmt: skip
def test_what_cannot_fail_is_shown_and_not_counted(kind, more, reason, tmp_path):
    row = judged(tmp_path, [NUMBER | {"class": kind} | more], {"a": (1.3, 0.0)}).claims.iloc[0]
    assert (row["verdict"], row["reason"], row["ours"]) == ("not judged", reason, 1.3)
    assert not row["counts"]


def test_tables_of_another_scale_are_not_judged(tmp_path):
    row = judged(tmp_path, [NUMBER], {"a": (1.0, 0.0)}, "quick").claims.iloc[0]
    assert (row["verdict"], row["reason"], row["ours"]) == ("not judged", "not judged at this scale", 1.0)  # fmt: skip
    assert row["counts"]
    item = Item("i", "title", "caption", judged_at="any")
    row = judged(tmp_path, [NUMBER], {"a": (1.0, 0.0)}, "quick", item).claims.iloc[0]
    assert row["verdict"] == "holds"


def test_a_reading_with_a_pattern_that_matches_nothing_is_not_computed(tmp_path):
    entry = STATEMENT | {"of": ["one", "two/*"]}
    row = judged(tmp_path, [entry], {"one": (5.0, 0.1)}).claims.iloc[0]
    assert (row["verdict"], row["reason"]) == ("not judged", "not computed")


def test_a_claim_without_its_number_is_not_computed(tmp_path):
    row = judged(tmp_path, [NUMBER], {"b": (1.0, 0.0)}).claims.iloc[0]
    assert (row["verdict"], row["reason"]) == ("not judged", "not computed")


def test_the_headline_counts_what_can_fail(tmp_path):
    entries = [
        NUMBER,
        STATEMENT | {"id": "b"},
        NUMBER | {"id": "c", "class": "input"},
        READINGS | {"id": "d"},
    ]
    numbers = {"a": (1.0, 0.0), "b": (-1.0, 0.1), "c": (1.0, 0.0), "one": (1.0, 0.0), "two": (-1.0, 0.0)}  # fmt: skip
    text = statements.headline(judged(tmp_path, entries, numbers).claims)
    assert text == (
        "of 3 statements that can fail, 1 holds in every reading, "
        "1 depends on what the paper leaves open and 1 fails"
    )


# --- the shipped claims ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", study.names())
def test_every_number_of_ours_is_in_a_claim_or_says_why_not(name):
    """No level of a table is left out of the claims without a reason."""
    s = study.load(name)
    found = [i for item in s.items for i in stored.read(s, item, RESULTS).values]
    readings = [r for c in s.claims for r in c.readings]
    claimed = {i for r in readings for i in r.ids(found)}
    excused = {i for p in s.unclaimed for i in claims.Reading((p,), {}).ids(found)}
    assert not [i for i in found if i not in claimed and i not in excused]
    assert not [r.of for r in readings if not r.ids(found)], "claims without a number"


@pytest.mark.parametrize("name", study.names())
def test_no_reason_is_given_for_nothing(name):
    s = study.load(name)
    found = [i for item in s.items for i in stored.read(s, item, RESULTS).values]
    for pattern in s.unclaimed:
        of_a_level = re.match(r"\w+ \w+=", pattern)
        assert of_a_level or claims.Reading((pattern,), {}).ids(found), pattern


LEVELS = [(name, item.name) for name in study.names() for item in study.load(name).items]


@pytest.mark.parametrize(("name", "item"), LEVELS, ids=["/".join(pair) for pair in LEVELS])
def test_every_level_of_a_table_is_behind_a_number(name, item):
    """Without the rows of a level (an estimator, a noise, a kind) some number is missing or another
    one, unless `not judged` says of `ITEM COLUMN=LEVEL` why not.
    """
    s = study.load(name)
    chosen = next(i for i in s.items if i.name == item)
    values = getattr(s.figures, f"{item}_values", None)
    frame = stored.table(RESULTS, s, chosen)
    if values is None or not s.claims:
        pytest.skip("no claims on it")

    def numbers(rows):
        try:
            with warnings.catch_warnings(action="ignore"):
                return {key: str(found) for key, found in values(rows).items()}
        except (LookupError, ValueError, TypeError, ZeroDivisionError):
            return None

    whole = numbers(frame)
    idle = set()
    for column in frame.select_dtypes(["object", "string"]):
        for level in frame[column].dropna().unique():
            rest = frame[frame[column] != level]
            if len(rest) and numbers(rest) == whole:
                idle.add(f"{item} {column}={level}")
    assert idle == {k for k in s.unclaimed if k.startswith(f"{item} ")}


def papers():
    folder = os.environ.get("AOABENCH_PAPERS")
    if not folder:
        pytest.skip("AOABENCH_PAPERS does not name the folder of the papers' texts")
    return {p: plain(p.read_text(encoding="utf-8")) for p in sorted(Path(folder).glob("*.txt"))}


def plain(text):
    """A text without marks of typesetting, in lower case, so that a quotation is found in it."""
    text = text.translate(str.maketrans("–—−’‘“”", "---''\"\"")).replace("√", "sqrt")
    text = re.sub(r"</?[a-z]+[^<>]*>|[*_$\\{}|]|-\s*\n\s*", "", text)
    return " ".join(text.lower().split())


@pytest.mark.parametrize("name", [n for n in study.names() if study.load(n).claims])
def test_every_quotation_and_printed_number_is_in_the_paper(name):
    """The quotation occurs in the paper, and the digits of a printed number within 400 characters
    of it.
    """
    s = study.load(name)
    texts = [t for t in papers().values() if plain(s.title) in t]
    assert texts, "the paper is not in the folder"
    missing = []
    for c in s.claims:
        if not c.quote:
            continue
        quote = plain(c.quote)
        near = [t[max(m.start() - 400, 0) : m.end() + 400] for t in texts for m in re.finditer(re.escape(quote), t)]  # fmt: skip
        digits = plain(c.printed_text).lstrip("-")
        if not any(re.search(rf"(?<![\d]){re.escape(digits)}(?!\d)", t) or not digits for t in near):  # fmt: skip
            missing.append((c.id, c.quote, digits))
    assert not missing
