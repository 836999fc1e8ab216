"""Every parameter of every plug-in says what it means and refuses what does not fit."""

import dataclasses
import importlib
import math
import pkgutil
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from aoabench.config.plugins import PLUG_INS, construct
from aoabench.errors import BadValue, UserError
from aoabench.models.azel import AzEl
from aoabench.models.motion import ConstantAcceleration, RandomWalk
from aoabench.params import CheckedParams, key_of, param
from aoabench.scenarios.layout import AnchorLayout
from aoabench.scenarios.square_track import SquareTrack

# what plug-ins make for themselves, and a base class
INNER = {"RoundedRoute", "KernelDraws", "Links", "_Place", "LogParameters"}

# values of the parameters without default; those of a class go before those of all
LAYOUT = AnchorLayout([[0.0, 0.0, 1.0]])
GIVEN = {
    "name": "own",
    "anchors": LAYOUT,
    "points_m": [[1.0, 1.0]],
    "motion": RandomWalk(),
    "measurement": AzEl(),
    "position_m": [[0.0, 0.0, 1.0]],
    "path": "log.csv",
    "route": [[0.0, 0.0], [9.0, 0.0]],
    "walls": None,
    "q": 1.0,
    "IndoorMap.anchors": "anchors.csv",
    "IndoorMap.motion": ConstantAcceleration(1.0),
}

# parameters that differ from those of the same name in the same package, because they are others
OTHERS = {
    "BsGrid.motion": "there is none",
    "Room.motion": "there is none",
    "IndoorMap.anchors": "a file",
    "Recorded.anchors": "a file or a layout",
    "Recorded.path": "several files",
    "Track.anchors": "a file or a layout",
    "Recorded.motion": "null where fixes are independent",
    "Track.motion": "by its name, or null where fixes are independent",
    "IndoorMap.dt": "the route is cut into at most a million steps",
    "IndoorMap.height_m": "at the start and at the end",
    "Room.height_m": "in the room",
    "IndoorMap.steps": "null where the route decides",
    "GaussNewton.as_printed": "one erratum of several",
    "VmfLikelihood.height_m": "free",
    "RobustLikelihood.height_m": "free",
    "RobustLikelihood.azimuth_sigma_deg": "another default",
    "RobustLikelihood.elevation_sigma_deg": "null where only azimuths are used",
    "ConstantVelocity.q_xy": "of a velocity",
    "ConstantVelocity.q_z": "of a velocity",
    "ParticleFilter.engine": "double",
}


def plug_ins():
    """The dataclasses that the packages of plug-ins define, private ones too."""
    for package in PLUG_INS:
        for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
            module = importlib.import_module(f"{package}.{module.name}")
            for cls in vars(module).values():
                mine = isinstance(cls, type) and cls.__module__ == module.__name__
                if mine and dataclasses.is_dataclass(cls) and cls.__name__ not in INNER:
                    yield cls


CLASSES = sorted(plug_ins(), key=lambda cls: cls.__name__)
FIELDS = [(cls, f) for cls in CLASSES for f in dataclasses.fields(cls)]
NAMES = [f"{cls.__name__}.{f.name}" for cls, f in FIELDS]


def chosen(kind):
    """The fields that `kind` admits, each as a parameter of a test."""
    return [pytest.param(c, f, id=n) for (c, f), n in zip(FIELDS, NAMES) if kind(f, rule(f))]


def rule(field):
    return field.metadata["param"]


def base(field):
    return field.type.removesuffix(" | None")


def refused(cls, field, value):
    """The complaint about a value; it names the field."""
    required = [f.name for f in dataclasses.fields(cls) if f.default is dataclasses.MISSING]
    given = {n: GIVEN.get(f"{cls.__name__}.{n}", GIVEN.get(n)) for n in required}
    with pytest.raises(BadValue) as error:
        cls(**{**given, field.name: value})
    assert error.value.key == key_of(field)
    assert str(error.value).startswith(f"{key_of(field)}=")
    assert " is not allowed; allowed: " in str(error.value)
    return error.value.allowed


def outside(known, integer=False):
    """Values just outside the limits."""
    if known.above > -math.inf:
        yield known.above
    if known.least > -math.inf:
        yield known.least - 1 if integer else math.nextafter(known.least, -math.inf)
    if known.most < math.inf:
        yield known.most + 1 if integer else math.nextafter(known.most, math.inf)


def array_of(shape, first):
    """Nested lists of ones with this shape (None: 2), and `first` in front."""
    cells = np.ones([2 if n is None else n for n in shape], dtype=object)
    cells.flat[0] = first
    return cells.tolist()


def test_every_plug_in_is_checked():
    assert len(CLASSES) > 25
    assert all(issubclass(cls, CheckedParams) for cls in CLASSES)


@pytest.mark.parametrize(("cls", "field"), chosen(lambda f, known: True))
def test_every_parameter_has_a_meaning_and_an_allowed_default(cls, field):
    known = rule(field)
    assert len(known.help) > 3
    assert known.help == known.help.strip().rstrip(".")
    if field.default is not dataclasses.MISSING:
        known.check(field.name, field.default, field.type)


def test_every_kind_of_parameter_is_tried_below():
    kinds = (numeric, is_array, is_list, is_bool, has_choices, is_text, is_object, is_nothing)
    for (_, field), name in zip(FIELDS, NAMES):
        assert any(kind(field, rule(field)) for kind in kinds), name


def numeric(field, known):
    return base(field).split(" | ")[0] in ("int", "float")


@pytest.mark.parametrize(("cls", "field"), chosen(numeric))
def test_numbers(cls, field):
    known, integer = rule(field), base(field) == "int"
    bad = [True, "ten", math.nan, math.inf, -math.inf, np.float32("inf"), [1.0], 1j]
    bad += [2.5] if integer else [10**400]
    bad += [] if field.type.endswith("None") else [None]
    for value in (*bad, *outside(known, integer)):
        allowed = refused(cls, field, value)
        assert "an integer" in allowed if integer else "a number" in allowed
        for limit in (known.above, known.least, known.most):
            assert not math.isfinite(limit) or f"{limit:g}" in allowed
        assert all(f"or {one}" in allowed for one in known.also)


def is_array(field, known):
    return bool(known.shape)


@pytest.mark.parametrize(("cls", "field"), chosen(is_array))
def test_arrays(cls, field):
    known = rule(field)
    known.check(field.name, array_of(known.shape, 1.0), field.type)
    known.check(field.name, np.array(array_of(known.shape, 1.0), dtype=float), field.type)
    cells = [True, "1", math.nan, math.inf, -math.inf, None, *outside(known)]
    for value in (1.0, "ones", [], [1.0] * 7, *(array_of(known.shape, cell) for cell in cells)):
        if known.shape != (None,) or value != [1.0] * 7:
            refused(cls, field, value)


def is_list(field, known):
    return base(field).startswith("Sequence[") and not known.shape


@pytest.mark.parametrize(("cls", "field"), chosen(is_list))
def test_lists(cls, field):
    elements = {"str": [5, "nonsense"], "int": [2.5, "1", True, 0], "Any": []}
    elements["float"] = ["1", True, math.nan, math.inf, None]
    known, of = rule(field), base(field)[len("Sequence[") :].partition("]")[0]
    texts = [] if "str" in field.type.split(" | ") else ["text"]
    for value in (5, *texts, *([one] for one in elements[of])):
        allowed = refused(cls, field, value)
        assert all(choice in allowed for choice in known.choices)


def is_bool(field, known):
    return base(field) == "bool"


@pytest.mark.parametrize(("cls", "field"), chosen(is_bool))
def test_flags(cls, field):
    for value in (5, 0, 1, 1.0, "true", None, []):
        assert refused(cls, field, value) == "true or false"


def has_choices(field, known):
    return bool(known.choices)


@pytest.mark.parametrize(("cls", "field"), chosen(has_choices))
def test_choices(cls, field):
    one = "nonsense" if base(field) == "str" else ["nonsense"]
    for value in (one, 5, "", True):
        allowed = refused(cls, field, value)
        assert all(choice in allowed for choice in rule(field).choices)


def is_text(field, known):
    return base(field) == "str" and not known.choices


@pytest.mark.parametrize(("cls", "field"), chosen(is_text))
def test_texts(cls, field):
    for value in (5, "", " ", True, ["a"]):
        refused(cls, field, value)


def is_object(field, known):
    return known.kind is not None


@pytest.mark.parametrize(("cls", "field"), chosen(is_object))
def test_objects(cls, field):
    known = rule(field)
    assert known.kind.__name__ in field.type.split(" | ")
    for value in (5, "" if "str" in field.type else "text", object(), known.kind):
        allowed = refused(cls, field, value)
        assert (
            known.allowed
            or f"must derive from aoabench.{known.kind.__name__}" in allowed
            or (f"must derive from {known.kind.__module__}.{known.kind.__name__}" in allowed)
        )


def is_nothing(field, known):
    return field.type == "None"


@pytest.mark.parametrize(("cls", "field"), chosen(is_nothing))
def test_what_is_never_there(cls, field):
    assert refused(cls, field, RandomWalk()) == "null"


def test_sister_plug_ins_have_the_same_rule():
    found, used = defaultdict(dict), set()
    for (cls, field), name in zip(FIELDS, NAMES):
        if name in OTHERS:
            used.add(name)
            continue
        known = dataclasses.replace(rule(field), help="", allowed="")
        found[cls.__module__.split(".")[1], field.name][name] = (field.type, known)
    for rules in found.values():
        assert len({repr(one) for one in rules.values()}) == 1, rules
    assert used == set(OTHERS)


def test_the_config_names_the_whole_path():
    layout = {"_target_": "aoabench.scenarios.layout.AnchorLayout", "position_m": [[0, 0, 1]]}
    node = {"_target_": "aoabench.scenarios.room.Room", "name": "own", "anchors": layout}
    with pytest.raises(UserError, match=r"^scenario\.points_m: missing, Room needs it$"):
        construct(node, "scenario")
    node["points_m"] = [[1, 1]]
    assert construct(node, "scenario").points_m == [[1, 1]]
    for key, value, named in (
        ("size_m", [0, 1, 1], "size_m=[0, 1, 1]"),
        ("points_m", [[9, 1]], "points_m[0]=[9.0, 1.0]"),
        ("anchors", 3, "anchors=3"),
        ("anchors", {**layout, "position_m": [[0, 0, "up"]]}, "anchors.position_m=[[0, 0, 'up']]"),
    ):
        with pytest.raises(BadValue) as error:
            construct({**node, key: value}, "scenario")
        assert str(error.value).startswith(f"scenario.{named} is not allowed; allowed: ")


def test_a_motion_model_has_the_state_of_the_scenario():
    for motion in (ConstantAcceleration(1.0), None):
        with pytest.raises(BadValue, match=r"^motion=.* is not allowed"):
            SquareTrack("own", LAYOUT, motion)
    assert SquareTrack("own", LAYOUT, RandomWalk()).steps == 64


# --- the mechanism --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "annotation",
    ["dict[str, float]", "complex", "np.ndarray", "Path | None", "Sequence[Sequence[float]]", list],
)
def test_a_type_without_a_check_cannot_be_declared(annotation):
    body = {"__annotations__": {"x": annotation}, "x": param(None, "anything")}
    with pytest.raises(TypeError, match="no check"):
        type("Odd", (CheckedParams,), body)


def test_an_object_must_be_of_the_annotated_class():
    body = {"__annotations__": {"x": "Noise | None"}, "x": param(None, "anything", kind=AzEl)}
    with pytest.raises(TypeError, match="no check"):
        type("Odd", (CheckedParams,), body)


@dataclass(frozen=True)
class Own(CheckedParams):
    """Its annotations are types, not texts."""

    width: float | None = param(None, "how wide", above=0)
    flags: Sequence[bool] = param((), "which")
    names: Sequence[str] = param((), "of what", choices=("a", "b"))
    free: float | str = param(1.0, "or free", least=0, also=("free",))
    other: dict | None = None  # of no concern here


def test_annotations_may_be_types():
    assert Own(width=1, flags=[True], names=["a"], free="free").width == 1
    for key, value, words in (
        ("width", 0, "width=0 is not allowed; allowed: a number > 0, or null"),
        ("flags", [True, 1], "flags=1 is not allowed; allowed: true or false"),
        ("names", "a", "names='a' is not allowed; allowed: a list of a, b"),
        ("names", ["c"], "names='c' is not allowed; allowed: one of a, b"),
        ("free", -1, "free=-1 is not allowed; allowed: a number >= 0, or free"),
        ("free", "bound", "free='bound' is not allowed; allowed: a number >= 0, or free"),
        (
            "free",
            np.array(["free"] * 2),
            "free=array(['free', 'free'], dtype='<U4') is not allowed; allowed: a number >= 0, or free",
        ),
        (
            "names",
            [np.array(["a"] * 2)],
            "names=array(['a', 'a'], dtype='<U1') is not allowed; allowed: one of a, b",
        ),
    ):
        with pytest.raises(BadValue) as error:
            Own(**{key: value})
        assert str(error.value) == words


def test_a_rule_does_not_change_what_a_dataclass_does():
    one = RandomWalk()
    assert one == RandomWalk(0.5, 0.1)
    assert hash(one) == hash(RandomWalk(0.5, 0.1))
    assert dataclasses.replace(one, q_z=0.2) == RandomWalk(0.5, 0.2)
    with pytest.raises(BadValue, match="q_z=0"):
        dataclasses.replace(one, q_z=0)
    with pytest.raises(TypeError, match="q"):
        ConstantAcceleration()
