"""From spectral radiance to colour: XYZ, xyY and linear sRGB."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from atmofit import tables
from atmofit.checks import in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import gauss_nodes
from atmofit.spectrum import check_wavelengths
from atmofit.typing import Reals, RealsLike, real_array

LUMINOUS_EFFICACY = 683.0  # [lm W^-1]
WHITE = 1 / 3  # x and y of a black spectrum: the chromaticity of equal energy

# IEC 61966-2-1 (1999), inverse of the matrix made from its primaries and white point.
_SRGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
# Y of one unit of linear R, G and B.
LUMINANCE_OF_SRGB = np.linalg.inv(_SRGB_FROM_XYZ)[1]


def spectrum_to_XYZ(radiance: RealsLike, wavelength_nm: RealsLike) -> Reals:
    """Tristimulus values of a spectral radiance, CIE 1931 2 degree observer, absolute.

    The radiance is taken as linear between its wavelengths and as absent outside them; the colour
    matching functions as linear between the 1 nm steps of their table. The integral of that
    product is within 1e-5 of the exact one for evenly spaced wavelengths.

    Args:
        radiance: [W m^-2 sr^-1 nm^-1], shape [..., wavelength].
        wavelength_nm: At least two, increasing, 380 to 780 [nm]. Traced: other values compile
            nothing new.

    Returns:
        X, Y, Z on a last axis of 3, in the dtype of `radiance`; Y is the luminance [cd m^-2]. An
        irradiance instead of the radiance gives an illuminance [lx]. NaN where a traced
        wavelength is out of range.

    Raises:
        ValueError: Shapes that do not fit, or wavelengths out of range or order.

    References:
        CIE 015:2018.
    """
    radiance = real_array(radiance)
    curves = tables.cie1931_2deg()
    low, high = curves.wavelength_nm[0], curves.wavelength_nm[-1]
    wavelength = in_range("wavelength_nm", wavelength_nm, low, high, "nm")
    if wavelength.ndim != 1 or wavelength.size < 2 or radiance.shape[-1:] != wavelength.shape:
        raise ValueError(
            "wavelength_nm must be a list of at least two, as long as the last axis of radiance, "
            f"got shapes {wavelength.shape} and {radiance.shape}"
        )
    if not is_traced(wavelength):
        check_wavelengths(np.asarray(wavelength))
    return _integrate(radiance, wavelength.astype(radiance.dtype))


extremes(
    Case("black", {"radiance": (0.0, 0.0, 0.0)}, limit=0.0),
    call=lambda radiance, wavelength_nm: spectrum_to_XYZ(radiance, wavelength_nm),
    radiance=Span((-1e30,) * 3, (1e30,) * 3),
    wavelength_nm=Domain((380.0, 500.0, 700.0), (400.0, 600.0, 780.0)),
)(spectrum_to_XYZ)


@jax.jit
def _integrate(radiance: Reals, wavelength_nm: Reals) -> Reals:
    weights = LUMINOUS_EFFICACY * _weights(wavelength_nm)
    return jnp.tensordot(radiance, weights, 1)


def _weights(wavelength_nm: Reals) -> Reals:
    """Integrals of the colour matching functions times each node's hat function [nm]."""
    curves = tables.cie1931_2deg()
    first = float(curves.wavelength_nm[0])
    # The fewer the intervals, the more points in each, so that every curve stays resolved.
    nodes, shares = gauss_nodes(
        max(4, math.ceil(2 * curves.wavelength_nm.size / wavelength_nm.size))
    )
    upper = jnp.asarray(nodes, wavelength_nm.dtype)
    share = jnp.asarray(shares, wavelength_nm.dtype)
    width = jnp.diff(wavelength_nm)
    points = wavelength_nm[:-1, None] + width[:, None] * upper[None, :]
    position = points - first  # the table has steps of 1 nm
    # NaN wavelengths must not reach the index; they come back through the fraction.
    index = jnp.clip(jnp.nan_to_num(position).astype(int), 0, curves.wavelength_nm.size - 2)
    fraction = (position - index.astype(position.dtype))[..., None]
    xyz = jnp.asarray(curves.xyz, wavelength_nm.dtype)
    at_points = xyz[index] * (1 - fraction) + xyz[index + 1] * fraction
    at_points = at_points * width[:, None, None]
    right = jnp.tensordot(share * upper, at_points, axes=(0, 1))
    left = jnp.tensordot(share * (1 - upper), at_points, axes=(0, 1))
    return jnp.pad(left, ((0, 1), (0, 0))) + jnp.pad(right, ((1, 0), (0, 0)))


def spectrum_to_xyY(radiance: RealsLike, wavelength_nm: RealsLike) -> Reals:
    """Chromaticity x, y and luminance Y [cd m^-2] on a last axis of 3; see `spectrum_to_XYZ`.

    A black spectrum has x = y = 1/3, with slope 0.
    """
    return XYZ_to_xyY(spectrum_to_XYZ(radiance, wavelength_nm))


extremes(
    Case("black", {"radiance": (0.0, 0.0, 0.0)}, limit=(1 / 3, 1 / 3, 0.0)),
    call=lambda radiance: spectrum_to_xyY(radiance, (400.0, 550.0, 700.0)),
    radiance=Span((0.0,) * 3, (1e15,) * 3),
)(spectrum_to_xyY)


@extremes(
    Case("black", {"XYZ": (0.0, 0.0, 0.0)}, limit=(WHITE, WHITE, 0.0)),
    Case("dim", {"XYZ": (1e-15, 1e-15, 2e-15)}, limit=(0.25, 0.25, 1e-15)),
    Case("negative", {"XYZ": (-1.0, -1.0, -2.0)}, limit=(0.25, 0.25, -1.0)),
    Case("adds to zero", {"XYZ": (1.0, 1.0, -2.0)}, limit=(WHITE, WHITE, 1.0)),
    XYZ=Span((-1e15,) * 3, (1e15,) * 3),
)
def XYZ_to_xyY(XYZ: RealsLike) -> Reals:
    """Chromaticity and luminance from tristimulus values.

    Args:
        XYZ: Shape [..., 3].

    Returns:
        x, y, Y; black (no sum of X, Y and Z to speak of) has x = y = 1/3 with slope 0.

    Raises:
        ValueError: A last axis that is not 3 long.
    """
    XYZ = _colour("XYZ", XYZ)
    total = XYZ.sum(axis=-1, keepdims=True)
    black = jnp.abs(total) <= math.sqrt(jnp.finfo(total.dtype).tiny)
    # Written so that NaN is not black.
    chromaticity = XYZ[..., :2] / jnp.where(black, 1.0, total)
    chromaticity = jnp.where(black, WHITE, chromaticity)
    return jnp.concatenate([chromaticity, XYZ[..., 1:2]], axis=-1)


@extremes(
    Case("black", {"xyY": (0.25, 0.25, 0.0)}, limit=0.0),
    Case("no blue", {"xyY": (0.5, 0.5, 1.0)}, limit=(1.0, 1.0, 0.0)),
    xyY=Span((0.0, 1e-3, 0.0), (1.0, 1.0, 1e15)),
)
def xyY_to_XYZ(xyY: RealsLike) -> Reals:
    """Tristimulus values from chromaticity and luminance.

    Args:
        xyY: Shape [..., 3], y not 0.

    Returns:
        X, Y, Z; not finite where y is 0.

    Raises:
        ValueError: A last axis that is not 3 long.
    """
    x, y, Y = jnp.moveaxis(_colour("xyY", xyY), -1, 0)
    return jnp.stack([x * Y / y, Y, (1 - x - y) * Y / y], axis=-1)


@extremes(
    Case("black", {"XYZ": (0.0, 0.0, 0.0)}, limit=0.0),
    XYZ=Span((-1e30,) * 3, (1e30,) * 3),
)
def XYZ_to_linear_sRGB(XYZ: RealsLike) -> Reals:
    """Linear sRGB from tristimulus values, in the same unit (white has the Y of XYZ).

    Args:
        XYZ: Shape [..., 3].

    Returns:
        R, G, B; negative outside the gamut, never clipped.

    Raises:
        ValueError: A last axis that is not 3 long.

    References:
        IEC 61966-2-1:1999.
    """
    XYZ = _colour("XYZ", XYZ)
    return jnp.tensordot(XYZ, jnp.asarray(_SRGB_FROM_XYZ.T, XYZ.dtype), 1)


@extremes(
    Case("black", {"linear": 0.0}, limit=0.0, slope={"linear": 12.92}),
    Case("end of the straight part", {"linear": 0.0031308}, limit=12.92 * 0.0031308),
    Case("white", {"linear": 1.0}, limit=1.0, slope={"linear": 1.055 / 2.4}),
    Case("mirrored", {"linear": -1.0}, limit=-1.0, slope={"linear": 1.055 / 2.4}),
    linear=Span(-1e30, 1e30),
)
def linear_sRGB_to_sRGB(linear: RealsLike) -> Reals:
    """The encoding ("gamma") of sRGB.

    Args:
        linear: Any shape, 1 is white; values above 1 are kept, negative ones mirrored.

    Returns:
        Encoded values, 0 to 1 for an input from 0 to 1; continuous to 1e-7, slope finite.

    References:
        IEC 61966-2-1:1999.
    """
    linear = real_array(linear)
    size = jnp.abs(linear)
    dark = size <= 0.0031308
    bright = 1.055 * jnp.where(dark, 1.0, size) ** (1 / 2.4) - 0.055
    return jnp.where(dark, 12.92 * linear, jnp.sign(linear) * bright)


def _colour(name: str, value: RealsLike) -> Reals:
    array = real_array(value)
    if array.shape[-1:] != (3,):
        raise ValueError(f"{name} must have shape [..., 3], got {array.shape}")
    return array
