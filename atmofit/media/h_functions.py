"""Light from a layer without end: Chandrasekhar's H functions for isotropic scattering."""

import math

import jax
import jax.numpy as jnp

from atmofit.checks import in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.numerics import gauss_nodes
from atmofit.typing import Reals, RealsLike

_NODES = 48
_SERIES_TO = 0.3
# Of 1 - x cot(x) in x^2: 2^(2n) |B_2n| / (2n)!, n from 1.
_SERIES = (
    1 / 3, 1 / 45, 2 / 945, 1 / 4725, 2 / 93555, 1382 / 638512875, 4 / 18243225,
    3617 / 162820783125,
)  # fmt: skip


def h_function(cosine: RealsLike, single_scattering_albedo: RealsLike) -> Reals:
    """Chandrasekhar's H(mu) of a half space that scatters isotropically.

    From the explicit integral ln H = -1/pi int ln(1 - w x cot x) dphi with tan x = tan(phi) / mu,
    phi from 0 to pi/2, by 48 nodes dense at its ends: within 1e-9 to albedo 1 - 1e-6, 1e-6 at 1.

    Args:
        cosine: Of a direction, 0 to 1 [-].
        single_scattering_albedo: 0 to 1 [-]. The two broadcast. At 1 the slope by albedo, which has
            no limit there, is that of the nodes.

    Returns:
        H [-]; 1 at cosine 0.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Chandrasekhar (1960), Radiative Transfer, chapter V; Stibbs and Weir (1959), Mon. Not. R.
        Astron. Soc. 119, 512, for the integral.
    """
    mu = in_range("cosine", cosine, 0.0, 1.0)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    return _h(*jnp.broadcast_arrays(mu, albedo.astype(mu.dtype)))


extremes(
    Case("level", {"cosine": 0.0}, limit=1.0),
    Case("black", {"single_scattering_albedo": 0.0}, limit=1.0),
    Case("white", {"cosine": 1.0, "single_scattering_albedo": 1.0}, limit=2.9078104, rtol=1e-5),
    cosine=Domain(0.0, 1.0),
    single_scattering_albedo=Domain(0.0, 1.0),
    least=0.0,
)(h_function)


def half_space_radiance(
    view_cosine: RealsLike, solar_cosine: RealsLike, single_scattering_albedo: RealsLike
) -> Reals:
    """Radiance of a half space that scatters isotropically, all orders, over the irradiance [1/sr].

    Args:
        view_cosine: Of the angle between normal and observer, 0 to 1 [-].
        solar_cosine: Of that to the sun, 0 to 1 [-].
        single_scattering_albedo: 0 to 1 [-]. The three broadcast.

    Returns:
        w / (4 pi) mu0 / (mu0 + mu) H(mu) H(mu0), over the irradiance across the sun's rays; 0 where
        both cosines are.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Chandrasekhar (1960), Radiative Transfer, chapter III, equation 127.
    """
    mu = in_range("view_cosine", view_cosine, 0.0, 1.0)
    sun = in_range("solar_cosine", solar_cosine, 0.0, 1.0)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    mu, sun, albedo = jnp.broadcast_arrays(mu, sun.astype(mu.dtype), albedo.astype(mu.dtype))
    lit = sun / jnp.maximum(mu + sun, 1e-6)
    return albedo / (4 * math.pi) * lit * _h(mu, albedo) * _h(sun, albedo)


extremes(
    Case("black", {"single_scattering_albedo": 0.0}, limit=0.0),
    Case("both level", {"view_cosine": 0.0, "solar_cosine": 0.0}, limit=0.0),
    view_cosine=Domain(0.0, 1.0),
    solar_cosine=Domain(0.0, 1.0),
    single_scattering_albedo=Domain(0.0, 1.0),
    least=0.0,
)(half_space_radiance)


@jax.jit
def _h(cosine: Reals, albedo: Reals) -> Reals:
    nodes, weights = gauss_nodes(_NODES)
    # u^3 softens the logarithm's end at phi = 0.
    phi = jnp.asarray(math.pi / 2 * nodes**3, cosine.dtype).reshape((1,) * cosine.ndim + (-1,))
    share = jnp.asarray(3 * math.pi / 2 * nodes**2 * weights, cosine.dtype)
    x = jnp.arctan2(jnp.sin(phi), cosine[..., None] * jnp.cos(phi))
    near = x < _SERIES_TO
    small, large = jnp.where(near, x, 0.0), jnp.where(near, 1.0, x)
    series = jnp.zeros_like(x)
    for coefficient in reversed(_SERIES):
        series = (series + coefficient) * small**2
    rest = jnp.where(near, series, 1 - large / jnp.tan(large))  # 1 - x cot x
    left = 1 - albedo[..., None]
    logarithm = jnp.log(left + albedo[..., None] * rest)
    return jnp.exp(-(logarithm @ share) / math.pi)
