"""The dot plot of a claim: a reader who measures it with its own axis reads the numbers."""

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from aoabench.studies import dots, page, statements, study
from aoabench.studies.axis import axis, tick_text
from aoabench.studies.claims import Limits
from aoabench.studies.dots import Dot
from aoabench.studies.places import of_scale

NAN, INF = math.nan, math.inf


def plot(values, limits, words="", unit="", verdict="holds", printed=None):
    """The drawn element of readings given as (value, low, high)."""
    given = [Dot(f"reading {i}", *v, verdict, "good") for i, v in enumerate(values)]
    return ElementTree.fromstring(dots.svg(given, limits, printed, words, unit))


def measured(svg, x):
    """The value at a place, read from the ticks alone as a ruler would: between two of them."""
    ticks = [e.get("d") for e in svg.iter("path") if e.get("class") == "axis"][1:]
    places = [float(re.match(r"M([\d.]+) ", d)[1]) for d in ticks]
    texts = {float(e.get("x")): e.text for e in svg.iter("text") if e.get("class") == "soft"}
    labelled = [(p, float(texts[p].replace("\N{MINUS SIGN}", "-"))) for p in places if p in texts]
    assert len(labelled) >= 2
    p, v = np.array(labelled).T
    words = " ".join(texts.values())
    if "logarithmic" in words:
        return 10 ** np.polyval(np.polyfit(p, np.log10(v), 1), x)
    return np.polyval(np.polyfit(p, v, 1), x)


def circles(svg):
    return [float(e.get("cx")) for e in svg.iter("circle")]


@pytest.mark.parametrize(
    ("values", "limits"),
    [
        ([1.0, 2.5, 7.25], Limits(low=0.0)),
        ([-3.0, 4.0], Limits(high=0.0)),
        ([95.74, 70.14, 98.42], Limits(94.5, 95.5)),
        ([0.008, 0.3, 5.0], Limits(0.1, 8.0)),
        ([3.67, 993.0], Limits(high=10.0)),
        ([0.31, 0.33], Limits(0.325, 0.335)),
        ([2.0, 2.0], Limits(2.0, 2.0)),
    ],
)
def test_numbers_intervals_and_limits_are_read_back_from_the_axis(values, limits):
    svg = plot([(v, v * 0.9, v * 1.2) for v in values], limits)
    span = max(map(abs, values)) * 0.015  # a place is rounded to a tenth of a unit
    for x, value in zip(circles(svg), values, strict=True):
        assert measured(svg, x) == pytest.approx(value, rel=0.02, abs=span / 10)
    bars = [e.get("d") for e in svg.iter("path") if "v6" in e.get("d")]
    for bar, value in zip(bars, values, strict=True):
        low, high = (float(n) for n in re.match(r"M([\d.]+) [\d.]+H([\d.]+)M", bar).groups())
        assert measured(svg, low) == pytest.approx(value * 0.9, rel=0.02, abs=span / 10)
        assert measured(svg, high) == pytest.approx(value * 1.2, rel=0.02, abs=span / 10)
    lines = [
        float(e.get("d")[1:].split()[0]) for e in svg.iter("path") if e.get("class") == "limit"
    ]
    finite = [end for end in (limits.low, limits.high) if math.isfinite(end)]
    assert [measured(svg, x) for x in lines] == pytest.approx(finite, rel=0.02, abs=span)
    (shade,) = (e for e in svg.iter("rect"))
    left, width = float(shade.get("x")), float(shade.get("width"))
    if math.isfinite(limits.low):
        assert left == lines[0]
    else:
        assert left == dots.LEFT
    if math.isfinite(limits.high):
        assert left + width == pytest.approx(max(lines[-1], left + 0.5))
    else:
        assert left + width == pytest.approx(dots.RIGHT)


def test_the_shade_of_a_printed_number_is_its_rounding_about_one_line():
    svg = plot([(95.7, 95.5, 95.9), (70.0, 69.0, 71.0)], Limits(94.5, 95.5), "printed 95 %", "%",
               printed=95.0)  # fmt: skip
    (line,) = (e for e in svg.iter("path") if e.get("class") == "limit")
    at = float(line.get("d")[1:].split()[0])
    assert measured(svg, at) == pytest.approx(95, abs=0.1)
    (shade,) = svg.iter("rect")
    assert measured(svg, float(shade.get("x"))) == pytest.approx(94.5, abs=0.1)
    assert at - float(shade.get("x")) == pytest.approx(float(shade.get("width")) / 2, abs=0.11)
    assert "printed 95 %" in [e.text for e in svg.iter("text")]


def test_without_limits_nothing_is_shaded():
    svg = plot([(1.0, 0.5, 1.5), (2.0, 1.5, 2.5)], Limits(), verdict="not judged")
    assert not list(svg.iter("rect"))
    assert not [e for e in svg.iter("path") if e.get("class") == "limit"]


def test_a_reading_without_number_says_so_and_has_no_mark():
    svg = plot([(NAN, NAN, NAN), (2.0, NAN, NAN), (3.0, -INF, INF)], Limits(low=1.0))
    assert len(circles(svg)) == 2
    assert [e.text for e in svg.iter("text")].count(dots.WITHOUT_NUMBER) == 1
    arrows = [e.get("d") for e in svg.iter("path") if "L" in e.get("d")]
    assert len(arrows) == 1, "no bar for an unknown interval, arrows for an endless one"
    assert arrows[0].startswith(f"M{dots.LEFT:g} ")
    assert "nan" not in ElementTree.tostring(svg, encoding="unicode").lower()
    nothing = plot([(NAN, NAN, NAN), (NAN, NAN, NAN)], Limits())
    assert not circles(nothing)


def test_each_verdict_has_a_mark_and_a_word_of_its_own():
    shapes = {}
    for verdict in ("holds", "fails", "undecided", "not judged"):
        svg = plot([(1.0, 1.0, 1.0)], Limits(), verdict=verdict)
        group = svg.find("g")
        assert verdict in [e.text for e in group.findall("text")]
        mark = group[-2]
        shapes[verdict] = (mark.tag, mark.get("class"))
    assert len(set(shapes.values())) == 4, shapes


def test_readings_for_robustness_stand_apart():
    given = [Dot("a", 1, 0, 2, "holds"), Dot("b", 3, 2, 4, "fails", robustness=True)]
    texts = [e.text for e in ElementTree.fromstring(dots.svg(given, Limits())).iter("text")]
    assert texts.index("a") < texts.index("robustness, not counted:") < texts.index("b")
    given = [Dot("a", 1, 0, 2, "holds"), Dot("b", 3, 2, 4, "fails")]
    assert "robustness" not in dots.svg(given, Limits())


def test_names_are_escaped_and_wrapped():
    long = 'sigma < 2 & "quoted" ' + "word " * 12
    given = [Dot(long, 1.0, 0.5, 1.5, "holds", 'x" onload="', "1 <m>"), Dot("b", 2, 1, 3, "holds")]
    text = dots.svg(given, Limits(low=0), None, "claimed > 0", "<m>")
    svg = ElementTree.fromstring(text)
    assert svg.find("g").get("class") == 'x" onload="'
    names = [e.text for e in svg.iter("text") if e.get("class") == "name"]
    assert " ".join(names[:-1]) == long.strip()
    assert max(map(len, names)) <= 21
    heights = [float(e.get("y")) for e in svg.iter("text")]
    assert max(heights) < float(svg.get("viewBox").split()[3])


def test_the_text_for_readers_of_screens_counts_the_verdicts():
    given = [
        Dot(str(v), v, v - 1, v + 1, w) for v, w in ((70, "fails"), (95, "holds"), (98, "fails"))
    ]
    text = dots.described(given, "printed 95 %", "%")
    assert (
        text
        == "Dot plot of 3 readings, our numbers from 70 to 98 %; printed 95 %: 2 fails, 1 holds"
    )
    svg = ElementTree.fromstring(dots.svg(given, Limits(94.5, 95.5), 95, "printed 95 %", "%"))
    assert (svg.get("role"), svg.get("aria-label")) == ("img", text)


def test_the_axis_is_logarithmic_where_positive_numbers_span_decades():
    assert axis([1, 30], [0.9]).kind == "log"
    assert axis([1, 15], [0.9]).kind == "linear"
    assert axis([1, 30], [0.0]).kind == "linear", "a limit of 0 is on no logarithmic axis"
    assert axis([0.045, 65], [-36, 296, 0]).kind == "both"
    both = axis([0.045, 65], [-36, 296, 0])
    places = [both.place(v) for v in (-100, -10, -1, 0, 1, 10, 100)]
    assert places == sorted(places)
    assert 0 < both.place(-36) < both.place(296) < 1
    # symmetric about 0, and a decade is a decade far from it
    assert both.place(10) - both.place(0) == pytest.approx(both.place(0) - both.place(-10))
    assert both.place(100) - both.place(10) == pytest.approx(
        both.place(10) - both.place(1), rel=1e-3
    )


@pytest.mark.parametrize(
    ("numbers", "others"),
    [
        ([1e-9, 2e-9], [1.5e-9]), ([1e6, 3e9], []), ([-5.0], [INF, NAN]), ([0.0], [0.0]), ([], []),
        ([273.0, 2.33e5], [1.0]), ([4.0, 4.5], [4.2]), ([12.0, 80.0], [3.0]), ([-1e5, 1e-3], []),
        ([99.91, 99.92], [99.0]),
    ],
)  # fmt: skip
def test_ticks_are_few_round_and_within_the_axis(numbers, others):
    scale = axis(numbers, others)
    ticks = scale.ticks()
    assert 2 <= len(ticks) <= 8
    assert ticks == sorted(ticks)
    assert all(scale.low <= tick <= scale.high for tick in ticks)
    for value in [v for v in numbers + others if math.isfinite(v)]:
        assert 0 < scale.place(value) < 1
    for tick in ticks:
        shown = float(tick_text(tick).replace("\N{MINUS SIGN}", "-"))
        assert math.isclose(shown, tick, rel_tol=1e-5)


def test_every_claim_with_several_readings_has_its_plot_on_the_page():
    results = Path(__file__).parents[2] / "results"
    everything = [study.load(name) for name in study.names()]
    rows = page._rows(
        everything, statements.verdicts(everything, results), of_scale("paper", results)
    )
    assert {row["command"].partition(" --scale ")[2] for row in rows} == {"paper"}, "as stored"
    several = [row for row in rows if len(row["readings_of"]) > 1]
    assert len(several) > 50
    for row in rows:
        assert bool(row["plot"]) == (len(row["readings_of"]) > 1)
    for row in several:
        svg = ElementTree.fromstring(row["plot"])
        assert len(svg.findall("g")) == len(row["readings_of"])
        assert "nan" not in row["plot"].lower().replace("dominant", "")
        _, _, _, height = map(float, svg.get("viewBox").split())
        for text in svg.iter("text"):
            wide = 5.5 * len(text.text)
            x = float(text.get("x"))
            left = x - wide / 2 if text.get("text-anchor") else x
            assert left > -10, text.text
            assert left + wide < dots.WIDTH + 10, text.text
            assert 0 < float(text.get("y")) < height
