"""A slab's light order by order of scattering: the Neumann series, in the azimuthal mean."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON
from atmofit.media.doubling import SMALLEST_COSINE
from atmofit.media.slab import lit_and_seen
from atmofit.numerics import gauss_nodes, legendre_table, mean_decay
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import RealsLike, Scalar

THICKEST = 100.0
_MOST = 1000  # orders, streams and steps


class ScatteringOrders(eqx.Module):
    """What becomes of light that falls on a slab, by how often it was scattered, from once.

    Attributes:
        reflectance: Share of the light that comes back [-].
        diffuse_transmittance: Share that arrives below [-].
    """

    reflectance: Float[Array, " order"]
    diffuse_transmittance: Float[Array, " order"]


def scattering_orders(
    *,
    optical_depth: RealsLike,
    single_scattering_albedo: RealsLike,
    phase: PhaseFunction,
    solar_zenith_angle: RealsLike,
    orders: int = 20,
    streams: int = 16,
    steps: int = 128,
    wavelength_nm: RealsLike = 550.0,
) -> ScatteringOrders:
    """Follow the light of a slab through one order of scattering after another.

    The first order is exact in depth; of the later ones the source is linear between depths that
    crowd at both faces, which is second order in the step. The phase function is cut after as many
    moments as streams. The orders' sum is what `solve_slab` finds at once, by the defaults within
    .2 % (asymmetry .85, depth 10); in thick bright slabs it takes hundreds of them.

    Args:
        optical_depth: Vertical, 0 to 100 [-].
        single_scattering_albedo: 0 to 1 [-].
        phase: Phase function.
        solar_zenith_angle: 0 to pi/2 [rad].
        orders: At least 1. Static.
        streams: Even, 4 to 1000; half of them go up. Static.
        steps: In depth, at least 2. Static.
        wavelength_nm: At which the phase function is taken [nm].

    Returns:
        Shares by order. NaN where a traced argument is out of range.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Hansen and Travis (1974), Space Sci. Rev. 16, 527, section 3.3: successive orders.
    """
    counts = {"orders": (orders, 1), "streams": (streams, 4), "steps": (steps, 2)}
    for name, (count, least) in counts.items():
        if not least <= count <= _MOST:
            raise ValueError(f"{name} must be between {least} and {_MOST}, got {count}")
    if streams % 2:
        raise ValueError(f"streams must be even, got {streams}")
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST)
    albedo = in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0)
    zenith = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    wavelength = in_range("wavelength_nm", wavelength_nm, 1.0, np.inf).astype(depth.dtype)
    moments = phase.checked().moments(streams, wavelength.reshape(1))[:, 0].astype(depth.dtype)
    sun = jnp.maximum(jnp.cos(zenith), SMALLEST_COSINE).astype(depth.dtype)
    return _orders(depth, albedo.astype(depth.dtype) * moments, sun, orders, steps)


@eqx.filter_jit
def _orders(
    optical_depth: Scalar,
    scattering: Float[Array, " l"],
    solar_cosine: Scalar,
    orders: int,
    steps: int,
) -> ScatteringOrders:
    """One order after another; `scattering` is albedo times the moments of the phase function."""
    dtype, streams = optical_depth.dtype, scattering.size
    nodes, weights = gauss_nodes(streams // 2)
    mu, to_flux = jnp.asarray(nodes, dtype), jnp.asarray(2 * math.pi * nodes * weights, dtype)
    depth = optical_depth * jnp.asarray(
        (1 - np.cos(np.pi * np.arange(steps + 1) / steps)) / 2, dtype
    )
    transport = _transport(depth, mu)
    degree = np.arange(streams)
    of_nodes = jnp.asarray(legendre_table(nodes, streams), dtype)
    from_nodes = (
        jnp.asarray((legendre_table(nodes, streams) * weights[:, None]).T, dtype) * 2 * math.pi
    )
    # Of light that goes on in its hemisphere, and of light that changes it.
    scattering = scattering * jnp.asarray((2 * degree + 1) / (4 * math.pi), dtype)
    both = (scattering, scattering * jnp.asarray((-1.0) ** degree, dtype))
    on, back = ((of_nodes * some[None, :]) @ from_nodes for some in both)
    on_sun, back_sun = (of_nodes @ (some * _legendre(solar_cosine, streams)) for some in both)

    # Depths of light that goes up count from below, so that it has the same transport.
    dimmed = jnp.exp(-(optical_depth - depth) / solar_cosine)
    above = lit_and_seen(depth[None, :], mu[:, None], -solar_cosine)
    below = lit_and_seen(depth[None, :], mu[:, None], solar_cosine)
    down, up = on_sun[:, None] * above, back_sun[:, None] * below * dimmed[None, :]

    def next_order(
        field: tuple[Array, Array], _: None
    ) -> tuple[tuple[Array, Array], tuple[Scalar, Scalar]]:
        down, up = field
        shares = to_flux @ up[:, -1] / solar_cosine, to_flux @ down[:, -1] / solar_cosine
        sources = on @ down + back @ up[:, ::-1], on @ up + back @ down[:, ::-1]
        down, up = (jnp.einsum("ijk,ik->ij", transport, source) for source in sources)
        return (down, up), shares

    _, (reflected, transmitted) = jax.lax.scan(next_order, (down, up), length=orders)
    return ScatteringOrders(reflected, transmitted)


def _transport(
    depth: Float[Array, " depth"], cosine: Float[Array, " node"]
) -> Float[Array, "node depth depth"]:
    """Radiance at each depth from the source at each, linear between them and nothing at first."""
    crossed = jnp.diff(depth)[None, :] / cosine[:, None]
    mean, slope = jax.jvp(mean_decay, (crossed,), (jnp.ones_like(crossed),))
    # Of a source that falls from 1 to 0 across a step, and of one that rises: no digit is lost.
    near, far = -crossed * slope, crossed * (mean + slope)
    place = np.arange(depth.size)
    passed = jnp.asarray(place[:, None] > place[None, :-1])  # depth i lies behind step k
    way = jnp.where(passed, depth[:, None] - depth[None, 1:], 0.0)
    kept = jnp.exp(-way[None] / cosine[:, None, None]) * passed[None].astype(depth.dtype)
    nothing = ((0, 0), (0, 0))
    begin = jnp.pad(kept * near[:, None, :], (*nothing, (0, 1)))
    return begin + jnp.pad(kept * far[:, None, :], (*nothing, (1, 0)))


def _legendre(cosine: Scalar, count: int) -> Float[Array, " l"]:
    """Legendre polynomials of a traced cosine."""

    def climb(pair: tuple[Scalar, Scalar], degree: Scalar) -> tuple[tuple[Scalar, Scalar], Scalar]:
        before, value = pair
        after = ((2 * degree + 1) * cosine * value - degree * before) / (degree + 1)
        return (value, after), value

    start = (jnp.zeros_like(cosine), jnp.ones_like(cosine))
    return jax.lax.scan(climb, start, jnp.arange(count, dtype=cosine.dtype))[1]


def _extreme(optical_depth: Scalar, albedo: Scalar, asymmetry: Scalar, sun: Scalar) -> Any:
    found = scattering_orders(
        optical_depth=optical_depth,
        single_scattering_albedo=albedo,
        phase=HenyeyGreenstein(asymmetry),
        solar_zenith_angle=sun,
        orders=4,
        streams=8,
        steps=16,
    )
    return *found.reflectance, *found.diffuse_transmittance


extremes(
    Case("no slab", {"optical_depth": 0.0}, (0.0,) * 8),
    Case("black", {"albedo": 0.0}, (0.0,) * 8),
    Case("white and thick", {"albedo": 1.0, "optical_depth": THICKEST}),
    Case("level sun", {"sun": np.pi / 2}),
    Case("sharp peak", {"asymmetry": 0.99}),
    call=_extreme,
    optical_depth=Domain(0.0, THICKEST),
    albedo=Domain(0.0, 1.0),
    asymmetry=Domain(-0.999, 0.999),
    sun=Domain(0.0, HORIZON),
)(scattering_orders)
