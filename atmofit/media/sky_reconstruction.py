"""A whole picture of a two-layer sky from a few directions.

Along the line of sight the light depends smoothly on the elevation, on the scale at which the
horizon's haze thins out, and weakly on the azimuth; the phase function, which does not, is known.
So the logarithm of the integral is a polynomial through Chebyshev nodes in both, and a picture's
pixels are two small matrix products and one exponential each.
"""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, is_traced
from atmofit.geometry import HORIZON, DirectionGrid
from atmofit.media.two_layers import TwoLayers, blue_behind, coloured, sky_integral
from atmofit.numerics import chebyshev_basis, chebyshev_nodes, chebyshev_transform
from atmofit.typing import Reals, RealsLike, Scalar, real_array

_LADDER = ((4, 2), (6, 2), (8, 3), (12, 3), (16, 4), (24, 5), (32, 6), (48, 8))
_TRIED = 400
EIGHT_BITS = 1 / 255 / 2  # half a step of the display's largest value


@dataclasses.dataclass(frozen=True)
class ReconstructionPlan:
    """How many directions are computed. Hashable.

    Attributes:
        elevations: Chebyshev nodes in elevation.
        azimuths: Chebyshev nodes in the cosine of the azimuth.
        nodes: Of the quadrature along each line of sight.
        rtol: That was asked for, or None.
        error: Largest relative one that was found in random directions, or None.
    """

    elevations: int = 24
    azimuths: int = 5
    nodes: int = 24
    rtol: float | None = dataclasses.field(default=None, compare=False)
    error: float | None = dataclasses.field(default=None, compare=False)

    def __str__(self) -> str:
        """What is computed."""
        return (
            f"sky from {self.elevations} x {self.azimuths} directions, {self.nodes} nodes each"
            + (f", tolerance {self.rtol:g}" if self.rtol is not None else "")
            + (f", largest error found {self.error:.1e}" if self.error is not None else "")
        )


def plan_layered_sky(
    layers: TwoLayers, solar_zenith_angle: RealsLike, rtol: float = EIGHT_BITS
) -> ReconstructionPlan:
    """The fewest directions whose picture is within a tolerance in 400 random directions.

    Args:
        layers: Known.
        solar_zenith_angle: Known, 0 to pi/2 [rad].
        rtol: Of the haze's light [-], above 0; the default is half a step of 8 bits.

    Raises:
        TypeError: An argument is traced.
        ValueError: A tolerance that 48 x 8 directions miss.
    """
    if is_traced(layers, solar_zenith_angle):
        raise TypeError("the arguments of plan_layered_sky must be known, not traced")
    if not 0 < rtol < math.inf:
        raise ValueError(f"rtol must be above 0, got {rtol}")
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    random = np.random.default_rng(0)
    # Half of them near the horizon, where most changes.
    share = random.random(_TRIED) ** np.where(np.arange(_TRIED) % 2, 1.0, 4.0)
    zenith = jnp.asarray(HORIZON * (1 - share), sun.dtype)
    azimuth = jnp.asarray(random.uniform(0.0, math.pi, _TRIED), sun.dtype)
    exact = np.asarray(sky_integral(layers, sun, zenith, azimuth, True, 96))
    nodes = next(
        n
        for n in (8, 16, 24, 48)
        if _error(sky_integral(layers, sun, zenith, azimuth, True, n), exact) <= rtol / 2 or n == 48
    )
    error = math.inf
    for elevations, azimuths in _LADDER:
        plan = ReconstructionPlan(elevations, azimuths, nodes)
        table = _table(layers, sun, plan)
        up, across = _bases(layers, zenith, azimuth, plan)
        error = _error(jnp.exp(jnp.einsum("pe,pa,eaw->wp", up, across, table)), exact)
        if error <= rtol:
            return ReconstructionPlan(elevations, azimuths, nodes, rtol, error)
    raise ValueError(f"rtol {rtol:g} is missed: 48 x 8 directions are {error:.1e} off")


def _error(found: Reals, exact: np.ndarray) -> float:
    return float(np.max(np.abs(np.asarray(found) / exact - 1)))


def reconstruct_layered_sky(
    layers: TwoLayers,
    solar_zenith_angle: RealsLike,
    directions: DirectionGrid,
    *,
    solar_irradiance: RealsLike = 1.0,
    blue: RealsLike | None = None,
    plan: ReconstructionPlan | None = None,
) -> Float[Array, "zenith azimuth w"]:
    """Like `layered_sky`, by exact geometry, for a picture.

    Args:
        layers: Haze and air.
        solar_zenith_angle: 0 to pi/2 [rad], a number.
        directions: Rows and columns of the picture.
        solar_irradiance: As for `layered_sky`.
        blue: Likewise.
        plan: From `plan_layered_sky`; None: 24 x 5 directions. Static.

    Raises:
        ValueError: A known angle is out of range.
    """
    sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, HORIZON)
    angle_in_range("view_zenith_angle", directions.view_zenith_angle, 0.0, HORIZON)
    found = _picture(
        layers, sun, directions, blue_behind(layers, blue), plan or ReconstructionPlan()
    )
    return found * real_array(solar_irradiance).astype(found.dtype).reshape(1, 1, -1)


@eqx.filter_jit
def _picture(
    layers: TwoLayers,
    sun: Scalar,
    directions: DirectionGrid,
    blue: Float[Array, " w"],
    plan: ReconstructionPlan,
) -> Float[Array, "zenith azimuth w"]:
    zenith, azimuth = directions.view_zenith_angle, directions.relative_azimuth
    table = _table(layers, sun.astype(zenith.dtype), plan)
    up, across = _bases(layers, zenith, azimuth, plan)
    rows = jnp.tensordot(up, table, 1)
    integral = jnp.exp(jnp.einsum("ca,raw->wrc", across, rows))
    every_zenith, every_azimuth = directions.angles()
    flat = integral.reshape(integral.shape[0], -1)
    seen = coloured(layers, sun, every_zenith.ravel(), every_azimuth.ravel(), flat, blue)
    return seen.reshape(*directions.shape, -1)


def _table(
    layers: TwoLayers, sun: Scalar, plan: ReconstructionPlan
) -> Float[Array, "elevation azimuth w"]:
    """Logarithm of the integral at the nodes."""
    scale, whole = _scale(layers, sun)
    unit = jnp.asarray((chebyshev_nodes(plan.elevations) + 1) / 2, sun.dtype)
    zenith = HORIZON - scale * jnp.sinh(whole * unit)
    azimuth = jnp.asarray(np.arccos(np.clip(chebyshev_nodes(plan.azimuths), -1, 1)), sun.dtype)
    z, a = jnp.meshgrid(jnp.clip(zenith, 0.0, HORIZON), azimuth, indexing="ij")
    integral = sky_integral(layers, sun, z.ravel(), a.ravel(), True, plan.nodes)
    # A sky without light, behind thick haze, stays so.
    tiny = float(jnp.finfo(integral.dtype).tiny)
    return jnp.log(jnp.maximum(integral, tiny)).T.reshape(plan.elevations, plan.azimuths, -1)


def _bases(
    layers: TwoLayers, zenith: Reals, azimuth: Reals, plan: ReconstructionPlan
) -> tuple[Float[Array, "p elevation"], Float[Array, "q azimuth"]]:
    """Weights of the nodes at angles."""
    scale, whole = _scale(layers, zenith)
    place = 2 * jnp.arcsinh((HORIZON - zenith) / scale) / whole - 1
    bases = (
        chebyshev_basis(x, count) @ jnp.asarray(chebyshev_transform(count), zenith.dtype)
        for x, count in ((place, plan.elevations), (jnp.cos(azimuth), plan.azimuths))
    )
    up, across = bases
    return up, across


def _scale(layers: TwoLayers, like: Reals) -> tuple[Scalar, Scalar]:
    """Elevation at which a level line of sight would leave the haze, and pi/2 in that measure."""
    scale = jnp.sqrt(2 * layers.haze_top / layers.radius).astype(like.dtype)
    return scale, jnp.arcsinh(HORIZON / scale)
