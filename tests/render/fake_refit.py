"""A small result of a refit without simulation and without fits."""

import functools

import jax.numpy as jnp
import numpy as np

from atmofit.fit.comparison import compare
from atmofit.fit.distribution import DistributionFit
from atmofit.fit.refit import RefitResult
from atmofit.fit.single_sky import PerezFit
from atmofit.fit.skies import QUANTITIES, RefitSettings, SimulatedSkies
from atmofit.fit.zenith import ZenithFit
from atmofit.geometry import Directions
from atmofit.models.preetham import PREETHAM_1999, PreethamModel

TURBIDITY, SUNS_DEG = (11.0, 3.0, 4.0), (10.0, 40.0, 60.0, 80.0)  # 11: not valid as published
RINGS_DEG = (20.0, 50.0, 80.0)


def small_dome():
    """The zenith and three rings of five azimuths on the half circle."""
    zenith, azimuth = np.radians(RINGS_DEG), np.linspace(0, np.pi, 5)
    return Directions(
        np.append(0.0, np.repeat(zenith, 5)), np.append(0.0, np.tile(azimuth, 3)), (1, 5, 5, 5)
    )


def _model(factor):
    p = PREETHAM_1999
    return PreethamModel(
        factor * p.x_distribution,
        factor * p.y_distribution,
        factor * p.luminance_distribution,
        p.zenith_x,
        p.zenith_y,
        p.zenith_luminance * factor,
        turbidity_range=(2.0, 12.0),
    )


def _distribution(matrix):
    shape = (len(TURBIDITY), len(SUNS_DEG))
    return DistributionFit(
        matrix=jnp.asarray(matrix),
        standard_error=0.0123 * jnp.abs(jnp.asarray(matrix)),
        robust_standard_error=0.0456 * jnp.abs(jnp.asarray(matrix)),
        covariance=jnp.eye(10),
        condition_number=jnp.asarray(321.0),
        rms=jnp.asarray(0.0456),
        largest=jnp.asarray(0.789),
        rms_per_sky=jnp.ones(shape),
        converged=jnp.asarray(True),
        steps=jnp.asarray(17),
    )


def _single(converged):
    shape = (len(TURBIDITY), len(SUNS_DEG))
    return PerezFit(
        coefficients=jnp.ones((*shape, 5)),
        scale=jnp.ones(shape),
        standard_error=jnp.ones((*shape, 6)),
        covariance=jnp.ones((*shape, 6, 6)),
        condition_number=jnp.full(shape, 99.0),
        rms=jnp.full(shape, 0.03),
        largest=jnp.full(shape, 0.1),
        converged=jnp.full(shape, converged),
        steps=jnp.full(shape, 5),
    )


def _zenith(coefficients):
    size = np.size(coefficients)
    return ZenithFit(
        coefficients=jnp.asarray(coefficients),
        standard_error=jnp.full(np.shape(coefficients), 0.00314),
        robust_standard_error=jnp.full(np.shape(coefficients), 0.00628),
        covariance=jnp.eye(size),
        condition_number=jnp.asarray(12.0),
        column_norm=jnp.ones(size),
        weakest_direction=jnp.full(size, size**-0.5),
        weakest_change=jnp.asarray(0.1),
        rms=jnp.asarray(0.02),
        largest=jnp.asarray(0.05),
        residuals=jnp.zeros((len(TURBIDITY), len(SUNS_DEG))),
    )


@functools.cache
def fake_result(converged=True):
    """A refit whose skies are those of a model close to the published one."""
    settings = RefitSettings(TURBIDITY, SUNS_DEG)
    dome, truth = small_dome(), _model(0.9)
    xyY = np.array(
        [[truth(T, sun, dome) for sun in settings.solar_zenith_angle] for T in TURBIDITY]
    )
    radiance = np.zeros((*xyY.shape[:-1], len(settings.wavelength_nm)))
    skies = SimulatedSkies(settings, dome, radiance, xyY, {})
    model = _model(0.95)
    matrices = (model.x_distribution, model.y_distribution, model.luminance_distribution)
    zeniths = (model.zenith_x, model.zenith_y, model.zenith_luminance)
    return RefitResult(
        model,
        skies,
        dict(zip(QUANTITIES, map(_distribution, matrices), strict=True)),
        dict(zip(QUANTITIES, map(_zenith, zeniths), strict=True)),
        {q: _single(converged) for q in QUANTITIES},
        (compare(PREETHAM_1999, skies, "published"), compare(model, skies, "regenerated")),
        {},
        {"simulation": 1.25, "joint fits": 2.5},
    )
