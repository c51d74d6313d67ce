"""What aerial perspective was before: fog that fades all alike, and a constant ambient light.

Both are fitted to given in-scattered light as well as their form allows, so that what remains is
the form's own error.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.numerics import safe_divide
from atmofit.typing import Reals, RealsLike, real_array


class DepthFog(eqx.Module):
    """L = L0 (1 - f) + C f: a share f that only distance sets, and a colour C that nothing changes.

    Attributes:
        share: f of each distance [-], [distance].
        colour: C [W m^-2 sr^-1 nm^-1], [wavelength].
    """

    share: Float[Array, " distance"]
    colour: Float[Array, " w"]

    def __call__(self, radiance: RealsLike) -> Reals:
        """Radiance at the eye of something at each distance, [direction, distance, wavelength]."""
        f = self.share[None, :, None]
        return jnp.asarray(radiance) * (1 - f) + self.colour[None, None, :] * f


class WardLarson(eqx.Module):
    """L = L0 tau + A (1 - tau): true extinction, and an ambient light that is alike all around.

    Attributes:
        ambient: A [W m^-2 sr^-1 nm^-1], [wavelength].
    """

    ambient: Float[Array, " w"]

    def __call__(self, radiance: RealsLike, transmittance: RealsLike) -> Reals:
        """Radiance at the eye, [direction, distance, wavelength]."""
        passing = jnp.asarray(transmittance)
        return jnp.asarray(radiance) * passing + self.ambient[None, None, :] * (1 - passing)


def fit_depth_fog(in_scattered: RealsLike, rounds: int = 50) -> DepthFog:
    """The fog nearest to given in-scattered light, with the best share at each distance.

    Black objects; least squares over all directions, distances and wavelengths, by turns. The
    largest share is 1.

    Args:
        in_scattered: [W m^-2 sr^-1 nm^-1], [direction, distance, wavelength].
        rounds: Of the alternation, which converges as the ratio of the two largest singular values
            of the mean over directions. Static.

    Raises:
        ValueError: Not three axes.
    """
    light = _three_axes(in_scattered)
    mean = jnp.mean(light, axis=0)
    share = jnp.ones_like(mean[:, 0])
    colour = mean[-1]
    for _ in range(rounds):
        colour = safe_divide(share @ mean, jnp.sum(share**2))
        share = safe_divide(mean @ colour, jnp.sum(colour**2))
    largest = jnp.max(share)
    return DepthFog(safe_divide(share, largest), colour * largest)


def fit_ward_larson(in_scattered: RealsLike, transmittance: RealsLike) -> WardLarson:
    """The constant ambient light nearest to given in-scattered light, by least squares.

    Args:
        in_scattered: [W m^-2 sr^-1 nm^-1], [direction, distance, wavelength].
        transmittance: Of the same paths.

    Raises:
        ValueError: Not three axes.

    References:
        Ward Larson and Shakespeare (1998), Rendering with Radiance, the "mist" of chapter 12, as
        Preetham, Shirley and Smits (1999) describe it.
    """
    light, faded = _three_axes(in_scattered), 1 - _three_axes(transmittance)
    return WardLarson(
        safe_divide(jnp.sum(light * faded, axis=(0, 1)), jnp.sum(faded**2, axis=(0, 1)))
    )


def _three_axes(values: RealsLike) -> Float[Array, "direction distance w"]:
    array = real_array(values)
    if array.ndim != 3:
        raise ValueError(
            "in_scattered and transmittance must be [direction, distance, wavelength], got shape "
            f"{array.shape}"
        )
    return array
