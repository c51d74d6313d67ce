"""What a cloud on a grid of voxels scatters of the sun's rays themselves."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.clouds.depths import Grid, depths_toward, passed, unit_vector, voxel_size
from atmofit.clouds.ordinates import ScaledPhase, legendre
from atmofit.clouds.scatter import versine_between
from atmofit.clouds.volume import Vector, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import safe_sqrt
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import RealsLike, Scalar, real_array

UP = (0.0, 0.0, 1.0)
_PEAK_DEGREES = 96  # Legendre terms of sunlight that the peak has scattered before
_DAMPING, _DAMPING_POWER = 36.0, 6  # so that the series' end does not ring


class Sunlit(eqx.Module):
    """A cloud and the sun.

    Attributes:
        cloud: The voxels.
        phase: Of one scattering.
        wavelength: Where it is taken [nm].
        single_scattering_albedo: [-].
        sun_direction: Unit vector to the sun.
        sun_irradiance: Across the rays.
    """

    cloud: VoxelCloud
    phase: PhaseFunction
    wavelength: Float[Array, "1"]
    single_scattering_albedo: Scalar
    sun_direction: Vector
    sun_irradiance: Scalar

    @property
    def voxel_size(self) -> Vector:
        """Edges of a voxel [m]."""
        return voxel_size(self.cloud)

    def depths(self) -> tuple[Grid, Grid]:
        """Optical depth that the sun's rays have behind them at each voxel, and have in it."""
        return depths_toward(self.cloud, self.sun_direction)

    def source_function(self, direction: Vector) -> Grid:
        """First order, toward an eye."""
        return self._times_irradiance(self._whole(direction) * passed(self.depths(), 1.0))

    def with_peak(self, direction: Vector, parts: ScaledPhase) -> Grid:
        """The same with what the phase function's peak has scattered before.

        Rays that the peak has scattered k times have spread: their k scatterings and the last one
        multiply each Legendre moment, and the sum over k, with the chances of Poisson's
        distribution, is an exponential function. That the bends make the way longer is left out.
        """
        albedo, depths = self.single_scattering_albedo, self.depths()
        once = passed(depths, 1.0)
        first, degree = parts.moments.size, np.arange(_PEAK_DEGREES)
        damping = np.exp(-_DAMPING * (degree / _PEAK_DEGREES) ** _DAMPING_POWER)
        cosine = -jnp.sum(self.sun_direction * direction)
        factor = jnp.asarray((2 * degree + 1) / (4 * np.pi) * damping, cosine.dtype)
        moments = self.phase.moments(_PEAK_DEGREES, self.wavelength)[:, 0].astype(cosine.dtype)
        terms = factor * moments * legendre(cosine, _PEAK_DEGREES)

        def more(total: Grid, one: tuple[Scalar, Scalar]) -> tuple[Grid, None]:
            term, moment = one
            return total + term * (passed(depths, 1 - albedo * moment) - once), None

        # The peak's own first moments are all 1.
        held = jnp.sum(terms[:first]) * (passed(depths, 1 - albedo * parts.peak) - once)
        start = self._whole(direction) * once + held
        total, _ = jax.lax.scan(jax.checkpoint(more), start, (terms[first:], moments[first:]))
        return self._times_irradiance(total)

    def _whole(self, direction: Vector) -> Scalar:
        """Phase function between the sun's rays and a direction [1/sr]."""
        versine = versine_between(-self.sun_direction, direction)
        # The slope at 0 and at pi must stay finite.
        half = jnp.sqrt(jnp.clip(versine / 2, 1e-12, 1.0 - 1e-6))
        return self.phase.at_wavelengths(2 * jnp.arcsin(half), self.wavelength)[..., 0]

    def _times_irradiance(self, grid: Grid) -> Grid:
        return self.sun_irradiance * self.single_scattering_albedo * grid


def sunlit(
    cloud: VoxelCloud,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike,
    sun_direction: RealsLike,
    sun_irradiance: RealsLike,
    wavelength_nm: RealsLike,
) -> Sunlit:
    """All of one dtype, the cloud's; known values that are impossible are refused."""
    cloud, phase = cloud.checked(), phase.checked()
    values = Sunlit(
        cloud,
        phase,
        real_array(wavelength_nm).reshape(1),
        in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0),
        unit_vector("sun_direction", sun_direction),
        in_range("sun_irradiance", sun_irradiance, 0.0, 1e12),
    )
    dtype = cloud.extinction_coefficient.dtype
    return jax.tree.map(lambda leaf: leaf.astype(dtype), values)


def single_scattering(
    cloud: VoxelCloud,
    view_direction: RealsLike,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    sun_direction: RealsLike = UP,
    sun_irradiance: RealsLike = 1.0,
    wavelength_nm: RealsLike = 550.0,
) -> Grid:
    """Source function of the first order alone.

    Args:
        cloud: From `voxel_cloud`.
        view_direction: Unit vector from the cloud to the eye.
        phase: Of one scattering.
        single_scattering_albedo: 0 to 1 [-].
        sun_direction: Unit vector to the sun.
        sun_irradiance: Across the rays, at least 0.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        [x, y, z]: radiance per optical depth, [1/sr] for a sun of unit irradiance.

    Raises:
        ValueError: A known argument is out of range.
    """
    scene = sunlit(
        cloud, phase, single_scattering_albedo, sun_direction, sun_irradiance, wavelength_nm
    )
    direction = unit_vector("view_direction", view_direction)
    return _single(scene, direction.astype(scene.sun_direction.dtype))


@eqx.filter_jit
def _single(scene: Sunlit, direction: Vector) -> Grid:
    return scene.source_function(direction)


extremes(
    Case("nothing", {"extinction": 0.0, "asymmetry": 0.0}, limit=0.5 / (4 * math.pi)),
    Case("black", {"single_scattering_albedo": 0.0}, limit=0.0),
    Case("narrow, into the sun", {"asymmetry": 0.99, "upward": -1.0}),
    Case("narrow, back to the sun", {"asymmetry": 0.99, "upward": 1.0}),
    call=lambda extinction, single_scattering_albedo, asymmetry, upward: single_scattering(
        voxel_cloud(jnp.broadcast_to(extinction, (2, 2, 2)), (-1.0,) * 3, (1.0,) * 3),
        jnp.stack([safe_sqrt(1 - upward**2), 0 * upward, upward]),
        phase=HenyeyGreenstein(asymmetry),
        single_scattering_albedo=single_scattering_albedo,
    )[0, 0],
    extinction=Domain(0.0, 1e6),
    single_scattering_albedo=Domain(0.0, 1.0),
    asymmetry=Domain(-0.999, 0.999),
    upward=Span(-1.0, 1.0),
)(single_scattering)
