"""Spectra of daylight from colours, by the CIE's daylight components."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from atmofit.checks import in_range
from atmofit.colour import spectrum_to_XYZ
from atmofit.extremes import Case, Span, extremes
from atmofit.tables import preetham1999_spectra
from atmofit.typing import Reals, RealsLike

_DENOMINATOR = (0.0241, 0.2562, -0.7341)  # of 1, x and y
_FIRST, _SECOND = (-1.3515, -1.7703, 5.9114), (0.0300, -31.4424, 30.0717)
_LEAST = 1e-3  # of the denominator: it is 0 on a line far from daylight's colours


class DaylightSpectrum(eqx.Module):
    """A spectrum that has a colour.

    Attributes:
        radiance: At 380, 390, ..., 780 nm [W m^-2 sr^-1 nm^-1 if Y is in cd m^-2], [..., 41], at
            least 0.
        negative: Whether the components' sum fell below 0 somewhere, so that it was set to 0 there
            and the colour is not quite met.
    """

    radiance: Float[Array, "*s 41"]
    negative: Bool[Array, "*s"]


def daylight_spectrum(xyY: RealsLike) -> DaylightSpectrum:
    """Spectrum of a D illuminant with a chromaticity, scaled to a luminance.

    The daylight components serve chromaticities near the daylight locus. Toward yellow and red,
    as near a low sun, their sum turns negative at short wavelengths; what is below 0 is cut, and
    luminance, not chromaticity, is kept. Count `negative` to know how often.

    Args:
        xyY: x and y, 0 to 1, and Y [cd m^-2], on a last axis.

    Returns:
        The spectrum. Where the components give no light at all it is 0.

    Raises:
        ValueError: The last axis is not 3 long, or a known value is out of range.

    References:
        Preetham, Shirley and Smits (1999), appendix A.5, after Wyszecki and Stiles (1982).
    """
    colour = in_range("xyY", xyY, 0.0, math.inf)
    if colour.shape[-1:] != (3,):
        raise ValueError(f"xyY must have x, y and Y on its last axis, got shape {colour.shape}")
    x, y, Y = colour[..., 0], colour[..., 1], colour[..., 2]

    def of_chromaticity(factors: tuple[float, float, float]) -> Reals:
        return factors[0] + factors[1] * x + factors[2] * y

    below = of_chromaticity(_DENOMINATOR)
    far = jnp.abs(below) < _LEAST
    below = jnp.where(far, jnp.where(below < 0, -_LEAST, _LEAST), below)
    table = preetham1999_spectra()
    S0, S1, S2 = (jnp.asarray(column, x.dtype) for column in (table.S0, table.S1, table.S2))
    weights = jnp.stack(
        [jnp.ones_like(x), of_chromaticity(_FIRST) / below, of_chromaticity(_SECOND) / below], -1
    )
    whole = weights @ jnp.stack([S0, S1, S2])
    negative = jnp.any(whole < 0, axis=-1)
    shape = jnp.maximum(whole, 0.0)
    luminance = spectrum_to_XYZ(shape, table.wavelength_nm)[..., 1]
    dark = luminance <= 0
    level = jnp.where(dark, 0.0, Y / jnp.where(dark, 1.0, luminance))
    return DaylightSpectrum(shape * level[..., None], negative)


extremes(
    Case("equal energy", {"x": 1 / 3, "y": 1 / 3}),
    Case("where the formula divides by zero", {"x": 0.3, "y": 0.1375296}),
    Case("dark", {"Y": 0.0}),
    call=lambda x, y, Y: daylight_spectrum(jnp.stack([x, y, Y], axis=-1)).radiance,
    x=Span(0.0, 0.75),
    y=Span(0.0, 0.85),
    Y=Span(0.0, 1e6),
    least=0.0,
)(daylight_spectrum)
