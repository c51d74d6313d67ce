"""The fits' extremes: skies that tell nothing, or come in strange units. Slopes are not needed."""

import math

import jax.numpy as jnp
import numpy as np

from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.fit.parameters import PerezPrior, to_coefficients, to_free
from atmofit.fit.single_sky import PerezFit, fit_perez
from atmofit.fit.turbidity import TurbidityEstimate, estimate_turbidity
from atmofit.fit.zenith import ZenithFit, fit_zenith_chromaticity, fit_zenith_luminance
from atmofit.geometry import HORIZON, Directions
from atmofit.observe.observation import Observation
from atmofit.typing import Reals, Scalar

_VIEWS = (0.0, *(math.radians(z) for z in (30, 30, 60, 60, 60, 80, 80, 80, 90)))
_AZIMUTHS = (0.0, 0.0, 3.0, 0.0, 1.5, 3.0, 0.0, 1.5, 3.0, 1.0)
_UNEVEN = 2.0 + np.cos(np.arange(10.0))  # 1e15 of it: the covariance, its square, fits float32


def _fitted(values: Reals, solar_zenith_angle: Scalar) -> PerezFit:
    return fit_perez(Directions(_VIEWS, _AZIMUTHS), solar_zenith_angle, values)


extremes(
    Case("constant", {"values": (1.0,) * 10}),
    Case("tiny values", {"values": 1e-15 * _UNEVEN}),
    Case("huge values", {"values": 1e15 * _UNEVEN}),
    Case("sun overhead", {"values": _UNEVEN, "solar_zenith_angle": 0.0}),
    Case("sun on the horizon", {"values": _UNEVEN, "solar_zenith_angle": HORIZON}),
    Case("one bright direction", {"values": (1.0,) * 9 + (1e6,)}),
    call=_fitted,
    derivative="none",
    heavy=True,
    values=Span((0.1,) * 10, (0.1, 1.0) * 5),
    solar_zenith_angle=Domain(0.0, HORIZON),
)(fit_perez)

_SUNS = (0.0, 0.5, 1.0, 1.3, HORIZON)
_TURBIDITIES = (2.0, 4.0, 6.0)


def _zenith_luminance(values: Reals) -> ZenithFit:
    return fit_zenith_luminance(_TURBIDITIES, _SUNS, values)


def _zenith_chromaticity(values: Reals) -> ZenithFit:
    return fit_zenith_chromaticity(_TURBIDITIES, _SUNS, values)


for _fit, _call in (
    (fit_zenith_luminance, _zenith_luminance),
    (fit_zenith_chromaticity, _zenith_chromaticity),
):
    extremes(
        Case("constant", {"values": np.ones((3, 5))}),
        call=_call,
        derivative="none",
        # One table may hold both ends; many more decades apart the covariance leaves float32.
        values=Span(np.full((3, 5), 1e-2), np.full((3, 5), 1e5)),
    )(_fit)

extremes(
    Case("middle of the prior", {"free": (-0.3, math.log(0.3), 0.0, math.log(2.0), 0.0)}, 0.0),
    call=lambda free: PerezPrior().residuals(free),
    free=Span((-5.0, -9.0, -100.0, -9.0, -10.0), (5.0, 3.0, 100.0, 4.0, 10.0)),
)(PerezPrior)
extremes(
    Case("no gradation", {"free": (0.0, 0.0, 1.0, 0.0, 0.0)}, limit=(0, -1, 1, -1, 0)),
    call=lambda free: to_coefficients(free),
    free=Span((-5.0, -9.0, -100.0, -9.0, -10.0), (5.0, 3.0, 100.0, 4.0, 10.0)),
)(to_coefficients)
extremes(
    Case("there and back", {"coefficients": (0.0, -1.0, 1.0, -1.0, 0.0)}, limit=(0, 0, 1, 0, 0)),
    call=lambda coefficients: to_free(coefficients),
    coefficients=Span((-0.9, -5.0, -100.0, -50.0, -10.0), (10.0, -1e-4, 100.0, -1e-4, 10.0)),
)(to_free)


def _observed(values: Reals, solar_zenith_angle: Scalar, relative_noise: Scalar) -> Observation:
    directions = Directions(_VIEWS, _AZIMUTHS)
    return Observation(directions, values, solar_zenith_angle, relative_noise)


def _estimated(
    values: Reals, solar_zenith_angle: Scalar, relative_noise: Scalar
) -> TurbidityEstimate:
    return estimate_turbidity(_observed(values, solar_zenith_angle, relative_noise))


_BRIGHT = 5e3 * _UNEVEN  # [cd m^-2]
extremes(
    Case("constant", {"values": (1e4,) * 10}),
    Case("far too dark", {"values": 1e-10 * _BRIGHT}),
    Case("far too bright", {"values": 1e10 * _BRIGHT}),
    Case("sun overhead", {"values": _BRIGHT, "solar_zenith_angle": 0.0}),
    Case("tiny noise", {"values": _BRIGHT, "relative_noise": 1e-6}),
    call=_estimated,
    derivative="none",
    heavy=True,
    values=Span(_BRIGHT, 2 * _BRIGHT),
    solar_zenith_angle=Span(0.0, 1.4),
    relative_noise=Span(1e-4, 1.0),
)(estimate_turbidity)
extremes(
    call=lambda values, relative_noise: (
        _observed(values, jnp.ones_like(relative_noise), relative_noise).checked().noise()
    ),
    values=Span(np.full(10, 1e-12), np.full(10, 1e12)),
    relative_noise=Span(1e-6, 1.0),
)(Observation)
