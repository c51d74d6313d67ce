"""The experiments on sky models and on the 1999 coefficients, on skies whose answer is known."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sky_model_errors import _errors, paper_form

import atmofit as af
from atmofit.fit.training import TrainingSkies

SETTINGS = af.TrainingSettings(
    turbidity=(1.9, 3.0, 5.0),
    solar_zenith_angle_deg=(10.0, 35.0, 60.0, 80.0),
    albedo=(0.0, 0.2),
)


@pytest.fixture(scope="module")
def skies():
    """Skies of the shipped model, as if they had been simulated."""
    dome, λ = af.dome_343(), SETTINGS.all_wavelength_nm
    T, a, sun = np.meshgrid(
        SETTINGS.turbidity,
        SETTINGS.albedo,
        np.radians(SETTINGS.solar_zenith_angle_deg),
        indexing="ij",
    )

    @jax.jit
    def radiance(T, sun, albedo):
        return af.ATMOFIT_2026.radiance(T, sun, dome, λ, albedo, 1.0)

    places = zip(T.ravel(), sun.ravel(), a.ravel(), strict=True)
    table = np.stack([np.asarray(radiance(*map(jnp.asarray, place))) for place in places])
    return TrainingSkies(SETTINGS, dome, table.reshape(*T.shape, *table.shape[1:]), 0.0)


def test_a_model_is_right_about_its_own_skies(skies):
    errors = _errors(skies, af.ATMOFIT_2026, 92.0)
    assert errors.shape == (24, 343)
    # Y is a channel of its own; the spectral ones, 20 nm apart, give it to the fit's own error.
    assert np.sqrt(np.mean(errors**2)) < 0.03


def test_skies_that_a_model_cannot_have_are_left_out(skies):
    assert _errors(skies, af.PREETHAM_1999, 70.0).shape == (18, 343)
    narrow = dataclasses.replace(af.PREETHAM_1999, turbidity_range=(2.0, 4.0))
    assert _errors(skies, narrow, 92.0).shape == (8, 343)


def test_the_paper_s_form_is_fitted_to_the_ground_that_it_can_have(skies):
    fitted = paper_form(skies)
    refitted, published = (_errors(skies, m, 92.0) for m in (fitted, af.PREETHAM_1999))
    assert np.sqrt(np.mean(refitted**2)) < 0.3 * np.sqrt(np.mean(published**2))
    logs = np.log1p(refitted).reshape(3, 2, 4, 343)
    level = logs.mean(axis=(0, 2, 3))
    # On the ground that it was fitted to; fits of relative errors of size s lie s^2 too low, and
    # pattern and zenith are two.
    assert abs(level[1]) < 2 * np.mean(logs[:, 1] ** 2)
    assert level[0] > level[1]  # a black ground makes darker skies
