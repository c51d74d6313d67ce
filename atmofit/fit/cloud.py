"""How dense a cloud is and how its droplets scatter, from pictures of it.

The shape is known; extinction, asymmetry and albedo are found by least squares through light of
all orders and its derivatives.
"""

from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.clouds.converged import converged_light
from atmofit.clouds.volume import VoxelCloud
from atmofit.fit import few_parameters
from atmofit.fit.ranges import RangedFit, Ranges, Values
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Reals, RealsLike, Scalar, real_array

RANGES = Ranges(
    (
        ("density_scale", 0.02, 50.0),
        ("asymmetry", 0.0, 0.95),
        ("single_scattering_albedo", 0.0, 1.0),
    ),
    logarithmic=("density_scale",),
)
MAX_STEPS = 40


class CloudFit(RangedFit):
    """What `fit_cloud` found.

    The values are what the shape's extinction is multiplied by, asymmetry and single-scattering
    albedo; the residuals (model - measured) / noise, [picture, up, right].
    """

    NAMES = RANGES.names


def fit_cloud(
    cloud: VoxelCloud,
    radiance: RealsLike,
    noise: RealsLike,
    *,
    sun_angle: RealsLike,
    extent: RealsLike,
    known: Mapping[str, RealsLike] | None = None,
    start: Mapping[str, RealsLike] | None = None,
    phase: Callable[[Scalar], PhaseFunction] = HenyeyGreenstein,
    directions: int = 50,
    rtol: float = 1e-4,
    max_steps: int = MAX_STEPS,
) -> CloudFit:
    """Fit density, asymmetry and albedo of a cloud of known shape to pictures of it.

    Least squares by Levenberg-Marquardt in free variables; each step takes the derivatives of the
    light of all orders. Standard errors come from the noise as given: right where grid and
    directions are fine enough for it.

    Args:
        cloud: The shape: extinction up to a factor.
        radiance: Of square pictures in front of black, under a sun of unit irradiance, as
            `path_trace` makes them, [picture, up, right] or [up, right] [1/sr].
        noise: Standard deviation of the pixels, above 0 [1/sr], a number or in the same shape.
        sun_angle: Of each picture, 0 to pi [rad]: a number or [picture].
        extent: Width of the pictures [m].
        known: Values by name (`density_scale` .02 to 50, `asymmetry` 0 to .95,
            `single_scattering_albedo` 0 to 1) that are not sought. The names are static.
        start: First values by name; else 1, .8 and .9.
        phase: Phase function from the asymmetry. Static.
        directions: See `converged_light`. Static.
        rtol: Likewise.
        max_steps: Of the search. Static.

    Returns:
        The fit; nothing is raised if the search fails, see `converged`.

    Raises:
        ValueError: A known argument is out of range, an unknown name, or arrays that do not fit.
    """
    in_range("max_steps", max_steps, 1.0, 1e6)
    measured = in_range("radiance", radiance, -1e30, 1e30, "1/sr")
    measured = measured[None] if measured.ndim == 2 else measured
    if measured.ndim != 3 or measured.shape[1] != measured.shape[2]:
        raise ValueError(f"radiance must be [picture, up, right], square, got {measured.shape}")
    sigma = in_range("noise", noise, 1e-30, 1e30, "1/sr")
    angle = jnp.atleast_1d(angle_in_range("sun_angle", sun_angle, 0.0, np.pi))
    if sigma.ndim == 2:
        sigma = sigma[None]
    if sigma.shape not in ((), measured.shape) or angle.shape != measured.shape[:1]:
        raise ValueError(
            f"noise and sun_angle must fit the pictures {measured.shape}, got shapes "
            f"{sigma.shape} and {angle.shape}"
        )
    given = RANGES.checked(known)
    begin = {"density_scale": 1.0, "asymmetry": 0.8, "single_scattering_albedo": 0.9}
    begin = RANGES.places(begin | dict(start or {}), RANGES.free(given))
    dtype = jnp.result_type(float)
    cloud, measured, sigma, angle, size, given, begin = jax.tree.map(
        lambda leaf: real_array(leaf).astype(dtype),
        (cloud.checked(), measured, sigma, angle, real_array(extent), given, begin),
    )
    found = _fit(
        cloud, measured, sigma, angle, size, given, begin, phase, directions, rtol, max_steps
    )
    return CloudFit(**found, free=RANGES.free(given))


@eqx.filter_jit
def _fit(
    cloud: VoxelCloud,
    measured: Float[Array, "picture up right"],
    noise: Reals,
    sun_angle: Float[Array, " picture"],
    extent: Scalar,
    known: Values,
    start: Float[Array, " free"],
    phase: Callable[[Scalar], PhaseFunction],
    directions: int,
    rtol: float,
    max_steps: int,
) -> dict[str, Array]:
    """The kernel of `fit_cloud`."""

    def residuals(place: Reals) -> Reals:
        values = RANGES.at(place, known)
        denser = eqx.tree_at(
            lambda c: c.extinction_coefficient,
            cloud,
            values["density_scale"] * cloud.extinction_coefficient,
        )
        light = converged_light(
            denser,
            phase=phase(values["asymmetry"]),
            single_scattering_albedo=values["single_scattering_albedo"],
            directions=directions,
            rtol=rtol,
        )
        seen = [
            light.view(sun_angle=angle, width=measured.shape[-1], extent=extent).radiance
            for angle in sun_angle
        ]
        return ((jnp.stack(seen) - measured) / noise).ravel()

    weight = jnp.sqrt(jnp.sum(jnp.broadcast_to(measured / noise, measured.shape) ** 2))
    rounding = few_parameters.rounding_of(weight, float(jnp.finfo(measured.dtype).eps)) + (
        rtol * weight
    )
    size = jnp.full(start.size, weight)
    end, converged, steps = few_parameters.descend(
        residuals, start, size, rounding, max_steps, False
    )
    found = RANGES.worth(end, known)
    found["residuals"] = found["residuals"].reshape(measured.shape)
    return found | {"converged": converged, "steps": steps}
