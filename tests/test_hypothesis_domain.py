"""Hunts over the whole stated domain: values and slopes are finite, shares stay shares."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import atmofit as af
from atmofit.numerics import gauss_nodes
from atmofit.sky.extremes import _sky

HUNT = settings(max_examples=40, deadline=None, derandomize=True)
ANGLE = st.floats(0, math.pi / 2)
SHARE = st.floats(0, 1)
DEPTH = st.one_of(st.floats(0, 1e3), st.floats(-35, 3).map(lambda power: 10.0**power))
HEIGHT = st.floats(0, math.log10(3e4)).map(lambda power: min(10.0**power, 3e4))
AIR = st.fixed_dictionaries(
    {
        "air_depth": DEPTH,
        "air_height": HEIGHT,
        "haze_depth": DEPTH,
        "haze_height": HEIGHT,
        "haze_albedo": SHARE,
        "asymmetry": st.floats(-0.999, 0.999),
        "solar_zenith_angle": ANGLE,
        "view_zenith_angle": ANGLE,
        "azimuth": st.floats(-math.pi, math.pi),
    }
)


@functools.cache
def _compiled(dtype):
    def sky(at, along):
        return jax.jvp(lambda at: _sky(**at, geometry="spherical"), (at,), (along,))

    return jax.jit(jax.vmap(sky, in_axes=(None, 0)))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@HUNT
@given(AIR)
def test_radiance_is_finite_and_not_negative_with_finite_slopes(dtype, air):
    at = {name: jnp.asarray(value, dtype) for name, value in air.items()}
    units = np.eye(len(at), dtype=dtype)
    along = {name: jnp.asarray(unit) for name, unit in zip(at, units, strict=True)}
    value, slopes = _compiled(dtype)(at, along)
    assert np.isfinite(value).all()
    assert (np.asarray(value) >= 0).all()
    assert np.isfinite(slopes).all()


@functools.cache
def _preetham():
    def sky(T, sun, view, azimuth):
        return af.PREETHAM_1999(T, sun, af.Directions(view[None], azimuth[None])).sum()

    return jax.jit(jax.value_and_grad(sky, argnums=(0, 1, 2, 3)))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@HUNT
@given(st.floats(1.7, 10), ANGLE, ANGLE, st.floats(-4, 4))
def test_the_published_model_is_finite(dtype, turbidity, sun, view, azimuth):
    at = (jnp.asarray(x, dtype) for x in (turbidity, sun, view, azimuth))
    value, slopes = _preetham()(*at)
    assert np.isfinite(value)
    assert all(np.isfinite(slope) for slope in slopes)


NODES, WEIGHTS = gauss_nodes(200)


@jax.jit
def _sphere_integral(g):
    """Of both phase functions; half angles from 0, dense in a forward peak of width 1 - |g|."""
    width = 1 - jnp.abs(g)
    top = jnp.log1p(math.pi / width)
    angle = jnp.minimum(width * jnp.expm1(top * NODES), math.pi)
    slope = width * jnp.exp(top * NODES) * top
    angle = jnp.where(g < 0, math.pi - angle, angle)
    area = 2 * math.pi * jnp.sin(angle) * slope * WEIGHTS
    phases = (af.HenyeyGreenstein(g), af.CornetteShanks(g))
    return jnp.stack([jnp.sum(phase(angle) * area) for phase in phases])


@HUNT
@given(st.floats(-0.999, 0.999))
def test_phase_functions_stay_normalised(asymmetry):
    np.testing.assert_allclose(_sphere_integral(jnp.asarray(asymmetry)), 1.0, rtol=1e-9)


@jax.jit
def _columns(scale_height, altitude, cosine):
    profile = af.Exponential(scale_height)
    return jax.vmap(lambda z, mu: profile.rising_column(z, mu, 6371e3))(altitude, cosine)


@HUNT
@given(HEIGHT, st.floats(0, 10), SHARE, st.floats(1e-6, 1), SHARE)
def test_columns_fall_with_altitude_and_cosine(scale_height, altitude, cosine, up, aside):
    z = altitude * scale_height * np.array([1.0, 1.0, 1.0]) + up * scale_height * np.array(
        [0, 1, 0]
    )
    mu = np.minimum(cosine + np.array([0.0, 0.0, 1e-6 + aside]), 1.0)
    low, higher, steeper = np.asarray(_columns(jnp.asarray(scale_height), z, mu))
    assert low > higher > 0
    assert steeper <= low * (1 + 1e-12)
