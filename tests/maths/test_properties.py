"""Laws that hold for every input: angles and rotations, concentration, digests."""

import json

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from aoabench.maths.digest import described, digest, flatten
from aoabench.maths.directional import flip, kappa_from_sigma, sigma_from_kappa
from aoabench.maths.geometry import euler, euler_of, facing, to_azel, to_unit, wrap
from aoabench.models.motion import RandomWalk

angles = st.floats(-1e4, 1e4)
turns = st.floats(-np.pi, np.pi)
coordinates = st.tuples(*[st.floats(-1e3, 1e3)] * 3)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**6), 10**6) | st.floats(-1e6, 1e6) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)
thorough = settings(deadline=None, max_examples=300)


@thorough
@given(st.floats(-1e9, 1e9))
def test_wrapped_angles_lie_in_the_half_open_interval(angle):
    wrapped = float(wrap(angle))
    assert -np.pi < wrapped <= np.pi
    whole = (angle - wrapped) / (2 * np.pi)
    assert abs(whole - round(whole)) < 1e-6


@given(st.integers(-10_000, 10_000))
def test_odd_multiples_of_pi_wrap_to_at_most_pi(turns_):
    wrapped = float(wrap((2 * turns_ + 1) * np.pi))
    assert -np.pi < wrapped <= np.pi
    assert np.pi - abs(wrapped) < 1e-10 * (1 + abs(turns_))


@thorough
@given(angles, angles)
def test_flipped_angles_point_in_the_same_direction(azimuth, elevation):
    a, e = flip(azimuth, elevation)
    assert -np.pi < a <= np.pi
    assert abs(e) <= np.pi / 2
    assert np.allclose(to_unit(a, e), to_unit(azimuth, elevation), rtol=0, atol=1e-11)


@thorough
@given(turns, st.floats(-np.pi / 2 + 1e-6, np.pi / 2 - 1e-6))
def test_directions_survive_the_way_to_vectors_and_back(azimuth, elevation):
    a, e = to_azel(*np.moveaxis(to_unit(azimuth, elevation), -1, 0))
    assert abs(wrap(a - azimuth)) * np.cos(elevation) < 1e-14
    assert abs(e - elevation) < 1e-8


@thorough
@given(turns, turns, turns)
def test_euler_angles_make_rotations_and_come_back(roll, pitch, yaw):
    R = euler(np.array([roll, pitch, yaw]))
    assert np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-14)
    assert abs(np.linalg.det(R) - 1.0) < 1e-14
    assert np.allclose(euler(np.array(euler_of(R))), R, rtol=0, atol=1e-7)


@thorough
@given(coordinates.filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_anchor_frames_are_right_handed_and_look_where_they_should(direction):
    R = facing(np.array(direction))
    assert np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-12)
    assert np.linalg.det(R) > 0
    ahead = R @ np.array(direction)
    assert np.allclose(ahead, [0, 0, np.linalg.norm(direction)], rtol=0, atol=1e-9)


@given(st.floats(1e-6, 1e12))
def test_concentration_and_deviation_are_inverse(kappa):
    back = float(kappa_from_sigma(sigma_from_kappa(kappa)))
    assert abs(back / kappa - 1) < 1e-12


@given(plain)
def test_digests_do_not_depend_on_how_numbers_and_mappings_are_written(value):
    again = json.loads(json.dumps(value))
    assert digest(again) == digest(value)
    if isinstance(value, dict):
        assert digest(dict(reversed(value.items()))) == digest(value)


@given(plain, plain)
def test_different_contents_have_different_digests(one, other):
    def canonical(value):
        if isinstance(value, dict):
            return {"d": sorted((k, json.dumps(canonical(v))) for k, v in value.items())}
        if isinstance(value, list):
            return {"l": [canonical(v) for v in value]}
        if isinstance(value, float) and value.is_integer():
            return int(value)
        return value

    same = json.dumps(canonical(one), sort_keys=True) == json.dumps(
        canonical(other), sort_keys=True
    )
    assert (digest(one) == digest(other)) == same


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_described_objects_hold_what_differs_from_the_defaults(q_xy, q_z):
    name, found = described(RandomWalk(q_xy, q_z))
    assert name == "models.RandomWalk"
    expected = {"q_xy": q_xy} if q_xy != 0.5 else {}
    assert found == expected | ({"q_z": q_z} if q_z != 0.1 else {})


@given(st.dictionaries(st.text("ab", min_size=1), st.integers() | st.lists(st.integers())))
def test_flattened_mappings_keep_every_leaf(node):
    assert dict(flatten({"x": node})) == ({f"x.{k}": v for k, v in node.items()} or {"x": {}})
