"""All orders of scattering in a cloud on a grid of voxels, by discrete ordinates.

What the directions of a quadrature carry through the grid (`sweep`) collides; a share of it, the
albedo, is emitted again into the same directions by the phase function; what is emitted is the
solution of a linear system. No step loses power: a white cloud gives back what it takes, to the
tolerance of the solver. Of the phase function the directions hold the first moments; the peak that
is left over counts as not scattered (delta scaling) until light is looked at: then sunlight has its
whole phase function, and what the peak has made of the sun's rays on their way.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from atmofit.checks import in_range, is_traced
from atmofit.clouds.depths import unit_vector
from atmofit.clouds.first_order import UP, Sunlit, sunlit
from atmofit.clouds.linear_solver import solve_linear
from atmofit.clouds.marching import Viewed, sensor_direction, view
from atmofit.clouds.ordinates import COUNTS, ScaledPhase, legendre, ordinates
from atmofit.clouds.sweeps import Grid, Grids, PerDirection, sweep, sweep_one
from atmofit.clouds.volume import Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import safe_divide
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import RealsLike, Scalar, real_array


class ConvergedLight(eqx.Module):
    """Light of all orders inside a cloud. All is in proportion to the light from outside.

    Attributes:
        scene: Cloud and sun, as given.
        scaled_phase: The phase function without its peak.
        incoming: As given, [direction].
        sunlight: Irradiance in each voxel, across the rays, of what comes straight from the sun,
            the peak's light with it.
        diffuse: Radiance of all else in each voxel, times the direction's solid angle.
        collisions: Power that collides in each voxel, in all orders, the peak's left out.
        received: Power that comes into the grid, also what only passes its empty parts.
        escaped: Power that leaves in each direction, the sun's rays left out.
        escaped_sunlight: Power of the sun's rays that leaves as it came, the peak's with it.
        absorbed: Power that the droplets keep.
        sweeps: In all directions, that the solver has needed.
        residual: Of the solver, relative [-].
        directions: How many; static.
    """

    scene: Sunlit
    scaled_phase: ScaledPhase
    incoming: PerDirection
    sunlight: Grid
    diffuse: Grids
    collisions: Grid
    received: Scalar
    escaped: PerDirection
    escaped_sunlight: Scalar
    absorbed: Scalar
    sweeps: Int[Array, ""]
    residual: Scalar
    directions: int = eqx.field(static=True)

    @property
    def power_error(self) -> Scalar:
        """Power that leaves or stays, over what comes in, less 1 [-]; 0 without light."""
        found = jnp.sum(self.escaped) + self.escaped_sunlight + self.absorbed
        return safe_divide(found - self.received, self.received)

    def source_function(self, view_direction: RealsLike) -> Grid:
        """Radiance that is scattered toward the eye.

        Args:
            view_direction: Unit vector from the cloud to the eye.

        Returns:
            [x, y, z], per optical depth of the cloud, [1/sr] for a sun of unit irradiance; for
            `march` and `view`.

        Raises:
            ValueError: A known direction is not a unit vector.
        """
        direction = unit_vector("view_direction", view_direction)
        return _toward_eye(self, direction.astype(self.sunlight.dtype))

    def view(
        self, *, sun_angle: RealsLike, width: int = 48, extent: RealsLike = 4.0, rays: int = 2
    ) -> Viewed:
        """A picture in front of black, like that of `path_trace`; see `marching.view`."""
        seen = self.source_function(sensor_direction(real_array(sun_angle)))
        cloud = self.scene.cloud
        return view(cloud, seen, sun_angle=sun_angle, width=width, extent=extent, rays=rays)


def converged_light(
    cloud: VoxelCloud,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    sun_direction: RealsLike = UP,
    sun_irradiance: RealsLike = 1.0,
    incoming: RealsLike = 0.0,
    directions: int = 50,
    rtol: float = 1e-4,
    most_iterations: int = 200,
    wavelength_nm: RealsLike = 550.0,
) -> ConvergedLight:
    """Light of all orders of scattering inside a cloud, with derivatives.

    Args:
        cloud: From `voxel_cloud`.
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        sun_direction: Unit vector to the sun.
        sun_irradiance: Across the rays, at least 0; 0: no sun.
        incoming: Radiance from outside that travels in each direction of `ordinates`, at least 0:
            a number, or one for each. Sky and ground.
        directions: How many, one of 14, 26, 38, 50, 86 and 110.
        rtol: Residual at which the solver stops.
        most_iterations: At which it stops too; see `residual` of the result.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The light, and where the power goes. Slopes go by extinction, albedo, phase and light.

    Raises:
        ValueError: A known argument is out of range.
    """
    if directions not in COUNTS:
        raise ValueError(f"directions must be one of {COUNTS}, got {directions}")
    if not 0 < rtol < 1 or most_iterations < 0:
        raise ValueError(
            f"rtol must lie in (0, 1), most_iterations >= 0, got {rtol}, {most_iterations}"
        )
    scene = sunlit(
        cloud, phase, single_scattering_albedo, sun_direction, sun_irradiance, wavelength_nm
    )
    around = in_range("incoming", incoming, 0.0, 1e12).astype(scene.sun_irradiance.dtype)
    around = jnp.broadcast_to(around, (directions,))
    dark = not is_traced(incoming) and not np.any(np.asarray(incoming))
    return _converged(scene, around, directions, _proportions(cloud), (rtol, most_iterations), dark)


def _proportions(cloud: VoxelCloud) -> tuple[float, float, float]:
    """Of a voxel; it is taken as a cube where the box has no known value yet."""
    if is_traced(cloud.low, cloud.high):
        return (1.0, 1.0, 1.0)
    edges = np.asarray(cloud.high, float) - np.asarray(cloud.low, float)
    edges = edges / np.asarray(cloud.extinction_coefficient.shape)
    x, y, z = (float(edge) for edge in np.round(edges / edges.max(), 5))
    return (x, y, z)


@eqx.filter_jit
def _converged(
    scene: Sunlit,
    incoming: PerDirection,
    count: int,
    shape: tuple[float, float, float],
    stop: tuple[float, int],
    dark: bool,
) -> ConvergedLight:
    """The kernel of `converged_light`; if it is dark, no light comes but the sun's."""
    parts = ScaledPhase.of(scene.phase, count, scene.wavelength)
    albedo, extinction = _scaled(scene, parts)
    size, sun = scene.voxel_size, -scene.sun_direction
    weight = jnp.asarray(ordinates(count)[1], extinction.dtype)
    matrix = albedo * parts.matrix(count)

    def scattered(light: Grids) -> Grids:
        return jnp.tensordot(matrix, extinction[None] * light, 1)

    def product(emitted: Grids) -> Grids:
        return emitted - scattered(sweep(extinction, size, emitted, None, count, shape).light)

    nothing, inflow = jnp.zeros_like(extinction), incoming * weight
    direct = sweep_one(extinction, size, nothing, scene.sun_irradiance, sun)
    share = albedo * parts.between(count, sun) * weight
    first = share[:, None, None, None] * extinction[None] * direct.light
    if not dark:
        first = first + scattered(sweep(extinction, size, 0 * first, inflow, count, shape).light)
    emitted, effort = solve_linear(product, first, *stop)
    swept = sweep(extinction, size, emitted, inflow, count, shape)
    volume = jnp.prod(size)
    collisions = extinction * (jnp.sum(swept.light, axis=0) + direct.light[0])
    return ConvergedLight(
        scene=scene,
        scaled_phase=parts,
        incoming=incoming,
        sunlight=direct.light[0] / volume,
        diffuse=swept.light / volume,
        collisions=collisions,
        received=direct.received[0] + jnp.sum(swept.received),
        escaped=swept.escaped,
        escaped_sunlight=direct.escaped[0],
        absorbed=(1 - albedo) * jnp.sum(collisions),
        sweeps=effort.products,
        residual=effort.residual,
        directions=count,
    )


def _scaled(scene: Sunlit, parts: ScaledPhase) -> tuple[Scalar, Grid]:
    """Albedo [-] and extinction [1/m] where the peak counts as not scattered."""
    albedo = scene.single_scattering_albedo
    left = 1 - albedo * parts.peak
    return albedo * (1 - parts.peak) / left, left * scene.cloud.extinction_coefficient


@eqx.filter_jit
def _toward_eye(light: ConvergedLight, direction: Vector) -> Grid:
    """The kernel of `source_function`.

    Droplets scatter what the directions hold by the phase function without its peak; of what
    travels toward the eye already the peak adds a share; and there is sunlight.
    """
    scene, parts, count = light.scene, light.scaled_phase, light.directions
    albedo, volume = scene.single_scattering_albedo, jnp.prod(scene.voxel_size)
    regular = albedo * (1 - parts.peak)
    diffuse = regular * jnp.tensordot(parts.between(count, direction), light.diffuse, 1)
    cosine = -jnp.sum(scene.sun_direction * direction)
    lit = diffuse + regular * parts.value(cosine) * light.sunlight
    power = scene.cloud.extinction_coefficient * lit * volume
    behind = _between_directions(light.incoming, direction, parts.moments.size)
    _, extinction = _scaled(scene, parts)
    passing = sweep_one(extinction, scene.voxel_size, power, behind, direction).light[0] / volume
    return diffuse + albedo * parts.peak * passing + scene.with_peak(direction, parts)


def _between_directions(radiance: PerDirection, direction: Vector, degrees: int) -> Scalar:
    """Radiance in any direction, by the spherical harmonics that the quadrature holds."""
    directions, weight = ordinates(radiance.size)
    table = legendre(jnp.asarray(directions, direction.dtype) @ direction, degrees)
    factor = jnp.asarray((2 * np.arange(degrees) + 1) / (4 * np.pi), table.dtype)
    return table @ factor @ (radiance * jnp.asarray(weight, table.dtype))


def _in_a_cube(
    extinction: Scalar, single_scattering_albedo: Scalar, asymmetry: Scalar, incoming: Scalar
) -> tuple[Grid, Scalar, Scalar]:
    """Few directions and voxels, which break no later than many; the peak is theirs to cut."""
    cloud = voxel_cloud(jnp.broadcast_to(extinction, (2, 2, 2)), (-1.0,) * 3, (1.0,) * 3)
    light = converged_light(
        cloud,
        phase=HenyeyGreenstein(asymmetry),
        single_scattering_albedo=single_scattering_albedo,
        incoming=incoming,
        directions=14,
    )
    seen = light.source_function(jnp.asarray((0.6, 0.0, -0.8), extinction.dtype))
    return seen[0], jnp.sum(light.escaped), light.absorbed


extremes(
    Case("black", {"single_scattering_albedo": 0.0, "incoming": 0.0}),
    Case("nothing", {"extinction": 0.0}),
    Case("thin", {"extinction": 1e-6}),
    Case("thick and white", {"extinction": 1e4, "single_scattering_albedo": 1.0}),
    Case("narrow", {"asymmetry": 0.99}),
    call=_in_a_cube,
    heavy=True,
    extinction=Span(0.0, 1e4),
    single_scattering_albedo=Domain(0.0, 1.0),
    asymmetry=Domain(-0.999, 0.999),
    incoming=Domain(0.0, 1e12),
)(converged_light)
