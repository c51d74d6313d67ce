"""Fits are differentiable: their slopes are those of refits to changed skies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af

DOME = af.dome_343()
SUN, T, STEP = 1.0, 3.0, 1e-3
RTOL = 0.01  # of the issue; seen: 2e-5, from the differences


def _sky(turbidity, sun=SUN):
    return af.ATMOFIT_2026.XYZ(turbidity, sun, DOME)[:, 1]


def _single(turbidity):
    fit = af.fit_perez(DOME, SUN, _sky(turbidity))
    return jnp.append(fit.coefficients, jnp.log(fit.scale))


@pytest.fixture(scope="module")
def differences():
    return (_single(T + STEP) - _single(T - STEP)) / (2 * STEP)


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_five_parameters_follow_the_air(mode, differences):
    slopes = jax.jit(mode(_single))(T)
    np.testing.assert_allclose(slopes, differences, RTOL)
    assert np.abs(differences).min() > 1e-4


def test_the_fit_itself_is_not_changed():
    """Exact skies come back exactly: the slope adds nothing to the value."""
    known = jnp.asarray([-0.9, -0.3, 4.0, -2.5, 0.4])
    view, azimuth = DOME.angles()
    sky = 2.5 * af.perez(known, view, af.scattering_angle(view, azimuth, SUN))
    fit = af.fit_perez(DOME, SUN, sky, prior=af.PerezPrior(strength=1e-6))
    np.testing.assert_allclose(fit.coefficients, known, rtol=1e-6)
    np.testing.assert_allclose(fit.scale, 2.5, rtol=1e-6)


def test_the_joint_fit_follows_the_air():
    """All turbidities raised by a factor: slopes of the ten coefficients."""
    turbidity, suns = jnp.asarray([2.0, 3.5, 5.0]), jnp.asarray([0.3, 0.8, 1.2, 1.4])

    def matrix(factor):
        skies = jax.vmap(lambda T: jax.vmap(lambda s: _sky(T, s))(suns))(factor * turbidity)
        fit = af.fit_distribution(DOME, suns, turbidity, skies, zenith_value=skies[:, :, 0])
        return fit.matrix

    slopes = jax.jit(jax.jacfwd(matrix))(1.0)
    differences = (matrix(1.001) - matrix(0.999)) / 0.002
    np.testing.assert_allclose(slopes, differences, RTOL, atol=1e-3 * np.abs(differences).max())


def test_five_parameters_follow_the_simulator():
    """Optical depth and scale height of haze, through simulator and fit."""
    plan = af.plan_sky(af.Atmosphere.from_turbidity(3.0), quantity="luminance", orders=1, rtol=0.1)

    def coefficients(at):
        haze = af.Haze(at[0], scale_height=1e3 * at[1])
        air = af.Atmosphere(af.Molecules(), haze)
        luminance = af.simulate_luminance(air, SUN, DOME, plan=plan)
        return af.fit_perez(DOME, SUN, luminance.astype(float)).coefficients

    at, run = jnp.asarray([0.2, 1.25]), jax.jit(coefficients)
    slopes = jax.jit(jax.jacfwd(coefficients))(at)
    for k, step in enumerate(1e-4 * np.eye(2)):
        difference = (run(at + step) - run(at - step)) / 2e-4
        # Slopes near 0 are compared with the largest: scale height hardly moves a flat sky.
        size = np.abs(difference).max()
        np.testing.assert_allclose(slopes[:, k], difference, RTOL, atol=RTOL * size)
