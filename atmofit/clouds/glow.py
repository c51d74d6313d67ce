"""What a cloud sends to an eye, as a sum of fields: each a grid with a spectrum of its own.

A cloud is grey: how light goes about in it has no colour. So every source of light, the sun and
some shares of the sky, is solved for once, and its spectrum is multiplied in at the end. The sun's
first order is a field of its own, so that its phase function is exact in every line of sight.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.clouds.converged import ConvergedLight, converged_light
from atmofit.clouds.depths import sunlight_reaching
from atmofit.clouds.ordinates import ordinates
from atmofit.clouds.pattern_light import pattern_light
from atmofit.clouds.sky_light import sky_elements, sky_light
from atmofit.clouds.surroundings import Surroundings
from atmofit.clouds.volume import Vector, VoxelCloud
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import Reals, Scalar

SKY_SOURCES = 3  # wavelengths at which the light of sky and ground is solved for
SKY_MESH = 3  # of the sky's elements for a single scattering: 54 of them

METHODS = ("converged", "pattern")

Eyes = Float[Array, "eye 3"]


class Droplets(eqx.Module):
    """How a cloud scatters.

    Attributes:
        phase: Of one scattering.
        single_scattering_albedo: [-].
        wavelength: Where the phase function is taken [nm].
    """

    phase: PhaseFunction
    single_scattering_albedo: Scalar
    wavelength: Float[Array, "1"]


class Glow(eqx.Module):
    """A cloud's light toward eyes in some directions.

    Attributes:
        cloud: To march through.
        droplets: Of which it consists.
        sun_direction: Unit vector.
        sun_irradiance: [wavelength].
        sunlight: What of the sun's irradiance comes to each voxel unscattered [-].
        later: Source functions of all else, toward each eye, [source, eye, x, y, z].
        sources: Their spectra, [source, wavelength].
    """

    cloud: VoxelCloud
    droplets: Droplets
    sun_direction: Vector
    sun_irradiance: Float[Array, " w"]
    sunlight: Float[Array, "x y z"]
    later: Float[Array, "source eye x y z"]
    sources: Float[Array, "source w"]

    @property
    def fields(self) -> Float[Array, "field x y z"]:
        """All grids to march through."""
        rest = self.later.reshape(-1, *self.sunlight.shape)
        return jnp.concatenate([self.sunlight[None], rest])

    def spectra(
        self, to_eye: Float[Array, "ray 3"], share: Float[Array, "ray eye"]
    ) -> Float[Array, "ray field w"]:
        """What multiplies each field's integral along a ray.

        Args:
            to_eye: Unit vectors from the cloud to the eye.
            share: How much each of the directions that the fields were made for counts for a ray.
        """
        versine = jnp.sum((to_eye + self.sun_direction[None, :]) ** 2, axis=-1) / 2
        angle = 2 * jnp.arcsin(jnp.sqrt(jnp.clip(versine / 2, 0.0, 1.0)))
        drops = self.droplets
        seen = drops.phase.at_wavelengths(angle, drops.wavelength)[:, 0]
        strength = drops.single_scattering_albedo * seen
        first = strength[:, None, None] * self.sun_irradiance[None, None, :]
        if self.later.shape[1] == 1:
            share = jnp.ones_like(share[:, :1])
        rest = share[:, None, :, None] * self.sources[None, :, None, :]
        return jnp.concatenate([first, rest.reshape(share.shape[0], -1, first.shape[-1])], axis=1)


def sky_shares(
    radiance: Float[np.ndarray, "direction w"], count: int = SKY_SOURCES
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance as a sum of a few wavelengths' own.

    Args:
        radiance: Of directions and wavelengths.
        count: How many wavelengths.

    Returns:
        Radiance at those wavelengths, [share, direction], and each share's spectrum, [share,
        wavelength]: their product is nearest to the radiance.
    """
    chosen = np.unique(np.linspace(0, radiance.shape[1] - 1, count).round().astype(int))
    columns = radiance[:, chosen]
    spectra, *_ = np.linalg.lstsq(columns, radiance, rcond=None)
    return columns.T, spectra


def converged_glow(
    cloud: VoxelCloud,
    surroundings: Surroundings,
    eyes: Eyes,
    droplets: Droplets,
    *,
    directions: int,
    rtol: float,
    sources: int = SKY_SOURCES,
) -> Glow:
    """All orders, of the sun if there is any, and of sky and ground, by `converged_light`.

    Args:
        cloud: The grid.
        surroundings: Its light.
        eyes: Unit vectors from the cloud, between which later orders are interpolated.
        droplets: Of which it consists.
        directions: See `converged_light`.
        rtol: Likewise.
        sources: Spectra of which the light of sky and ground is made up.
    """
    dtype = cloud.extinction_coefficient.dtype
    travels, _ = ordinates(directions)
    around = surroundings.radiance(jnp.asarray(-travels, dtype))
    columns, spectra = sky_shares(np.asarray(around, float), sources)
    solve = functools.partial(
        converged_light,
        cloud,
        phase=droplets.phase,
        single_scattering_albedo=droplets.single_scattering_albedo,
        sun_direction=surroundings.sun_direction.astype(dtype),
        directions=directions,
        rtol=rtol,
        wavelength_nm=droplets.wavelength,
    )

    def toward_eyes(light: ConvergedLight) -> Reals:
        scene = light.scene
        return jnp.stack([light.source_function(e) - scene.source_function(e) for e in eyes])

    # One after another: all sources' light at once would not fit into memory.
    later = [
        toward_eyes(solve(sun_irradiance=0.0, incoming=jnp.asarray(column, dtype)))
        for column in columns
    ]
    return _glow(
        cloud,
        surroundings,
        droplets,
        lambda: toward_eyes(solve()),
        jnp.stack(later),
        jnp.asarray(spectra, dtype),
    )


def pattern_glow(
    cloud: VoxelCloud,
    surroundings: Surroundings,
    eyes: Eyes,
    droplets: Droplets,
    *,
    orders: int,
    most: int,
    kept: tuple[int, ...] | None = None,
) -> Glow:
    """One to three orders of the sun and one of sky and ground, as Nishita and others (1996).

    Args:
        cloud: The grid.
        surroundings: Its light.
        eyes: Unit vectors from the cloud; their middle stands for all.
        droplets: Of which it consists.
        orders: See `pattern_light`.
        most: Paths of each order, likewise.
        kept: Numbers of the sky's elements that count; None: all.
    """
    dtype = cloud.extinction_coefficient.dtype
    middle = jnp.sum(eyes, axis=0)
    middle = middle / jnp.linalg.norm(middle)
    elements, _ = sky_elements(SKY_MESH)
    around = surroundings.radiance(jnp.asarray(elements, dtype))
    columns, spectra = sky_shares(np.asarray(around, float))
    skies = sky_light(
        cloud,
        jnp.asarray(columns.T, dtype),
        phase=droplets.phase,
        single_scattering_albedo=droplets.single_scattering_albedo,
        view_direction=middle,
        wavelength_nm=droplets.wavelength,
        elements=kept,
    )

    def sunny() -> Reals:
        light = pattern_light(
            cloud,
            phase=droplets.phase,
            single_scattering_albedo=droplets.single_scattering_albedo,
            sun_direction=surroundings.sun_direction.astype(dtype),
            view_direction=middle,
            orders=orders,
            most=most,
            wavelength_nm=droplets.wavelength,
        )
        return jnp.sum(light.source_function[1:], axis=0)[None]

    later = sunny if orders > 1 else None
    return _glow(cloud, surroundings, droplets, later, skies[:, None], jnp.asarray(spectra, dtype))


def _glow(
    cloud: VoxelCloud,
    surroundings: Surroundings,
    droplets: Droplets,
    sunny: Callable[[], Reals] | None,
    skies: Float[Array, "share eye x y z"],
    spectra: Float[Array, "share w"],
) -> Glow:
    """Put together; without a sun, or its later orders, nothing of them is computed."""
    dtype = cloud.extinction_coefficient.dtype
    sun = jnp.asarray(surroundings.sun_irradiance, dtype)
    direction = surroundings.sun_direction.astype(dtype)
    if not bool(jnp.any(sun > 0)):
        nothing = jnp.zeros_like(cloud.extinction_coefficient)
        return Glow(cloud, droplets, direction, sun, nothing, skies, spectra)
    if sunny is not None:
        skies = jnp.concatenate([sunny()[None], skies])
        spectra = jnp.concatenate([sun[None], spectra])
    lit = sunlight_reaching(cloud, direction)
    return Glow(cloud, droplets, direction, sun, lit, skies, spectra)
