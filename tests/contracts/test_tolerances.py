"""Comparisons that cannot fail are refused."""

import numpy as np
import pytest


@pytest.mark.parametrize(
    ("expected", "rel"),
    [
        (3.1e-13, None),
        (0.0, None),
        ([1.0, 1e-9], None),
        ({"a": 1.0, "b": -1e-7}, None),
        (np.array([[1.0, 0.0]]), None),
        (9.8e-26, 1e-3),
        (0.05, 1e-11),
    ],
)
def test_an_absolute_tolerance_that_would_decide_has_to_be_stated(expected, rel):
    """pytest's default of 1e-12 exceeds the relative tolerance of each of these."""
    with pytest.raises(ValueError, match="state rel and abs=0"):
        pytest.approx(expected, rel=rel)
    assert expected == pytest.approx(expected, rel=rel or 1e-6, abs=0)


def test_exact_equality_is_not_written_as_an_approximation():
    with pytest.raises(ValueError, match="use =="):
        pytest.approx(3.1e-13, abs=0)


def test_a_stated_tolerance_and_ordinary_numbers_pass_through():
    assert pytest.approx(3.1e-13, abs=1e-15) == 3.1e-13
    assert pytest.approx(3.1e-13, rel=1e-6, abs=0) != 0.0
    assert pytest.approx([1.0, np.inf]) == [1.0, np.inf]
    assert pytest.approx({"a": 2.0, "b": "text"}) == {"a": 2.0, "b": "text"}
    assert pytest.approx((np.nan, 1.0), nan_ok=True) == (np.nan, 1.0)
    assert pytest.approx(1e-6) == 1e-6 * (1 + 9e-7)


@pytest.mark.parametrize("close", [np.allclose, np.isclose])
@pytest.mark.parametrize(("expected", "rtol"), [(0.0, 1e-5), ([1e-9, 1e-4], 1e-5), (50.0, 1e-10)])
def test_an_atol_that_would_decide_everywhere_has_to_be_stated(close, expected, rtol):
    with pytest.raises(ValueError, match="state atol"):
        close(expected, expected, rtol)
    assert np.all(close(expected, expected, rtol, 0))
    assert np.all(close(expected, expected, rtol=rtol, atol=1e-12))


def test_ordinary_arrays_pass_through():
    assert np.allclose([0.0, 1.0], [1e-9, 1.0])
    assert not np.allclose(1.0, 1.1)
    assert np.isclose([1.0, np.nan], [1.0, np.nan], equal_nan=True).all()
    assert np.allclose([np.nan], [np.nan], equal_nan=True)
