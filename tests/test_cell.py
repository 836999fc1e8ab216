"""Cell ids depend on what is simulated, not on how it is written down."""

from dataclasses import dataclass, make_dataclass, replace

import pytest
import yaml

from aoabench.config.compose import compose_cells, show
from aoabench.config.plugins import construct, spelled_out
from aoabench.config.presets import options
from aoabench.maths.digest import described, digest, flatten
from aoabench.resources import shipped

WORDS = ["noise=vmf", "filter=[ekf_vmf]"]


def cell(*words):
    return compose_cells([*WORDS, *words])[0]


@pytest.mark.parametrize(
    "words",
    [
        ["scenario.side_m=5"],
        ["scenario.side_m=5.0", "scenario.steps=64"],
        ["noise.default_sigma_deg=10", "noise.mounting_yaw_deg=0"],
        ["scenario.motion.q_xy=0.5"],
        ["filter.ekf_vmf.engine=auto", "filter.ekf_vmf.measurement.kappa=null"],
        ["reps=7", "runner.chunk=3", "store.steps=true"],
        ["filter=[ekf_vmf,ukf_vmf]"],
    ],
)
def test_spelled_out_defaults_and_the_way_of_running_leave_the_id_alone(words):
    assert cell(*words).id == cell().id


@pytest.mark.parametrize(
    "words",
    [
        ["scenario.side_m=5.001"],
        ["scenario=square_track_far"],
        ["noise.sigma_deg=10"],
        ["noise.mounting_yaw_deg=1"],
        ["noise=ae_flip"],
        ["seed=2"],
        ["filter.ekf_vmf.measurement.kappa=30"],
        ["scenario.motion.q_z=0.2"],
    ],
)
def test_what_is_simulated_changes_the_id(words):
    assert cell(*words).id != cell().id


@pytest.mark.parametrize("group", ["scenario", "noise"])
def test_thin_presets_build_what_spelled_out_ones_do(group):
    for name in options(group):
        node = yaml.safe_load((shipped("configs") / group / f"{name}.yaml").read_text())
        if "defaults" in node or name == "recorded":
            continue
        whole = spelled_out(node)
        assert described(construct(whole, group)) == described(construct(node, group)), name
        assert set(dict(flatten(node))) <= set(dict(flatten(whole)))


def test_a_new_field_with_a_neutral_default_changes_no_digest():
    old = make_dataclass("Noise", [("sigma", float, 1.0)], frozen=True)
    new = make_dataclass("Noise", [("sigma", float, 1.0), ("tilt", float, 0.0)], frozen=True)
    assert digest(described(old(2.0))) == digest(described(new(2.0)))
    assert digest(described(new(2.0, 0.1))) != digest(described(new(2.0)))
    assert digest(described(new(2))) == digest(described(new(2.0)))


def test_what_cannot_be_described_is_never_the_same():
    @dataclass(frozen=True)
    class Holds:
        thing: object = None

    one = Holds(object())
    assert digest(described(one)) != digest(described(one))
    assert digest(described(replace(one, thing=None))) == digest(described(Holds()))


def test_the_composed_config_shows_every_field():
    text = show(["filter=[pf_vmf]", "noise.kappa=30"])
    node = yaml.safe_load(text)
    assert node["noise"]["mounting_yaw_deg"] == 0.0
    assert node["noise"]["kappa"] == 30
    assert node["filter"]["pf_vmf"]["particles"] == 10_000
    assert node["scenario"]["motion"]["q_z"] == 0.1
    assert cell().config["scenario"]["side_m"] == 5.0


@pytest.mark.parametrize("values", [
    (0, False, None, "", 0.5), (1, True, "1"), (float("nan"), float("inf"), -float("inf")),
])  # fmt: skip
def test_a_default_is_left_out_and_nothing_else(values):
    """Equal by digest, where 1 equals 1.0 but not True, and NaN equals NaN."""
    for default in values:
        cls = make_dataclass("Noise", [("sigma", object, default)], frozen=True)
        found = [value for value in values if not described(cls(value))[1]]
        assert repr(found) == repr([default])
    whole = make_dataclass("Noise", [("sigma", object, 1)], frozen=True)
    assert described(whole(1.0))[1] == {}
    assert described(whole(-1.0))[1] == {"sigma": -1.0}
