"""The Perez formula: values, and finite slopes at every edge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads

from atmofit.models.perez import perez

COEFFICIENTS = np.array([-1.1056, -0.2833, 5.2797, -2.3359, 0.2363])  # published Y at T = 2


@settings(deadline=None, max_examples=50)
@given(st.floats(0, 1.55), st.floats(0, np.pi))
def test_is_the_papers_formula(view, angle):
    A, B, C, D, E = COEFFICIENTS
    expected = (1 + A * np.exp(B / np.cos(view))) * (
        1 + C * np.exp(D * angle) + E * np.cos(angle) ** 2
    )
    np.testing.assert_allclose(perez(COEFFICIENTS, view, angle), expected, rtol=1e-12)


def test_leading_axes_broadcast():
    view, angle = np.linspace(0, 1.5, 7), np.linspace(0, 3, 7)
    many = np.stack([COEFFICIENTS, 2 * COEFFICIENTS])
    values = perez(many[:, None, :], view, angle)
    assert values.shape == (2, 7)
    np.testing.assert_allclose(values[1], perez(2 * COEFFICIENTS, view, angle))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("view", [0.0, 1.5697, np.pi / 2])
@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi])
@pytest.mark.parametrize("B", [-3.0, -1e-4, 0.0, 0.07, 1.0])
@pytest.mark.parametrize("D", [-20.0, 0.0, 30.0])
def test_value_and_slopes_are_finite(dtype, view, angle, B, D):
    coefficients = jnp.asarray([2.0, B, 5.0, D, 0.2], dtype)
    arguments = coefficients, jnp.asarray(view, dtype), jnp.asarray(angle, dtype)
    value, slopes = jax.value_and_grad(perez, argnums=(0, 1, 2))(*arguments)
    assert value.dtype == dtype
    assert np.isfinite(value)
    for slope in slopes:
        assert np.isfinite(slope).all()


def test_horizon_is_the_limit():
    below_floor = perez(COEFFICIENTS, np.pi / 2, 1.0)
    above_floor = perez(COEFFICIENTS, np.pi / 2 - 0.01, 1.0)
    np.testing.assert_allclose(below_floor, above_floor, rtol=1e-10)


def test_derivatives():
    check_grads(perez, (jnp.asarray(COEFFICIENTS), 1.2, 0.7), order=1, rtol=1e-6)


def test_out_of_range():
    with pytest.raises(ValueError, match=r"view_zenith_angle.*got 1.6"):
        perez(COEFFICIENTS, 1.6, 0.5)
    with pytest.raises(ValueError, match=r"scattering_angle.*got -0.1"):
        perez(COEFFICIENTS, 1.0, -0.1)
    with pytest.raises(ValueError, match=r"shape \[\.\.\., 5\], got \(4,\)"):
        perez(COEFFICIENTS[:4], 1.0, 0.1)
    assert np.isnan(jax.jit(perez)(COEFFICIENTS, 1.6, 0.5))
