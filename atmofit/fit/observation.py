"""What was measured of a sky, and with what noise."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.colour import spectrum_to_XYZ
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.spectrum import check_wavelengths
from atmofit.typing import Reals, Scalar, real_array, scalar

VISIBLE_NM = (380.0, 780.0)
# A spectrum held constant over its last 10 nm misses 1e-4 of the luminance; one sampled every
# 20 nm and linear in between misses 1e-3.
_SHORTFALL_NM, _WIDEST_GAP_NM = 10.0, 20.0
_SLACK_NM = 1e-3  # the rounding of float32


class Observation(eqx.Module):
    """One sky, seen in many directions.

    Structure is checked when it is made, values by `checked`, which every fit calls.

    Attributes:
        directions: Where it was looked; on or above the horizon.
        values: Spectral radiance [W m^-2 sr^-1 nm^-1], [direction axes, wavelength]; without
            wavelengths, luminance [cd m^-2], [direction axes]. Positive.
        solar_zenith_angle: 0 to pi/2 [rad].
        relative_noise: Standard deviation of each value over the value [-], above 0; a number or
            one for each value. The noise of one value is independent of every other's.
        wavelength_nm: Increasing [nm], or None: the values are luminances.
    """

    directions: Directions | DirectionGrid
    values: Reals = eqx.field(converter=real_array)
    solar_zenith_angle: Scalar = eqx.field(converter=scalar)
    relative_noise: Reals = eqx.field(converter=real_array)
    wavelength_nm: Float[Array, " wavelength"] | None = eqx.field(
        converter=lambda value: None if value is None else real_array(value), default=None
    )

    def __check_init__(self) -> None:
        """Check that the shapes belong together."""
        shape, axes = self.directions.shape, "direction axes"
        if self.wavelength_nm is not None:
            if self.wavelength_nm.ndim != 1:
                raise ValueError(
                    f"wavelength_nm must be a list, got shape {self.wavelength_nm.shape}"
                )
            shape, axes = (*shape, self.wavelength_nm.size), "direction axes, wavelength"
        if self.values.shape != shape:
            raise ValueError(f"values must have shape [{axes}] = {shape}, got {self.values.shape}")
        if self.relative_noise.shape not in ((), shape):
            raise ValueError(
                f"relative_noise must be a number or have the shape of the values, {shape}, "
                f"got {self.relative_noise.shape}"
            )
        if self.solar_zenith_angle.ndim != 0:
            raise ValueError(
                f"solar_zenith_angle must be one number, got shape {self.solar_zenith_angle.shape}"
            )

    def checked(self) -> "Observation":
        """Refuse impossible values.

        Raises:
            ValueError: A known value is not finite, not positive or out of range.
        """
        wavelength = self.wavelength_nm
        if wavelength is not None and not is_traced(wavelength):
            check_wavelengths(np.asarray(wavelength))
        directions = self.directions
        return Observation(
            directions=directions.checked()
            if isinstance(directions, Directions)
            else _checked_grid(directions),
            values=_positive("values", self.values),
            solar_zenith_angle=angle_in_range(
                "solar_zenith_angle", self.solar_zenith_angle, 0.0, HORIZON
            ),
            relative_noise=_positive("relative_noise", self.relative_noise),
            wavelength_nm=wavelength,
        )

    def luminance(self) -> tuple[Reals, Reals]:
        """Luminance [cd m^-2] and its relative noise [-], both [direction axes].

        A spectrum is integrated as linear between its wavelengths; beyond its ends, which may lie
        up to 10 nm inside 380 and 780 nm, it is constant.

        Raises:
            ValueError: The spectrum does not cover 380 to 780 nm, or has gaps above 20 nm.
            TypeError: The wavelengths are traced.
        """
        noise = jnp.broadcast_to(self.relative_noise, self.values.shape)
        noise = noise.astype(self.values.dtype)
        if self.wavelength_nm is None:
            return self.values, noise
        if is_traced(self.wavelength_nm):
            raise TypeError("wavelength_nm of an observation must be known, got a tracer")
        weights = jnp.asarray(
            _luminance_weights(np.asarray(self.wavelength_nm, float)), self.values.dtype
        )
        luminance = jnp.tensordot(self.values, weights, 1)
        variance = jnp.tensordot((self.values * noise) ** 2, weights**2, 1)
        return luminance, jnp.sqrt(variance) / luminance


def _positive(name: str, values: Reals) -> Reals:
    """Refuse values that are not finite or not above 0."""
    array = in_range(name, values, -np.inf, np.inf)
    if is_traced(array):
        return jnp.where(array > 0, array, jnp.nan)
    known = np.asarray(array)
    if known.size and known.min() <= 0:
        count = int((known <= 0).sum())
        of = f" ({count} of {known.size} values)" if known.size > 1 else ""
        raise ValueError(f"{name} must be above 0, got {known.min():.6g}{of}")
    return array


def _checked_grid(grid: DirectionGrid) -> DirectionGrid:
    return DirectionGrid(
        angle_in_range("view_zenith_angle", grid.view_zenith_angle, 0.0, HORIZON),
        in_range("relative_azimuth", grid.relative_azimuth, -np.inf, np.inf),
    )


def _luminance_weights(wavelength_nm: np.ndarray) -> np.ndarray:
    """What each wavelength's radiance adds to the luminance [cd m^-2 per W m^-2 sr^-1 nm^-1]."""
    low, high = VISIBLE_NM
    first, last = wavelength_nm[0], wavelength_nm[-1]
    room = _SHORTFALL_NM + _SLACK_NM
    if first > low + room or last < high - room:
        raise ValueError(
            f"wavelength_nm must cover {low:g} to {high:g} nm (up to {_SHORTFALL_NM:g} nm may be "
            f"missing at either end) to give a luminance, got {first:.6g} to {last:.6g} nm"
        )
    inside = wavelength_nm[(wavelength_nm > low) & (wavelength_nm < high)]
    points = np.concatenate([[low], inside, [high]])
    gap = np.diff(wavelength_nm[(wavelength_nm > low - room) & (wavelength_nm < high + room)])
    if gap.max(initial=0.0) > _WIDEST_GAP_NM + _SLACK_NM:
        raise ValueError(
            f"wavelength_nm must have gaps of at most {_WIDEST_GAP_NM:g} nm to give a luminance, "
            f"got {gap.max():.6g} nm"
        )
    hats = np.array([np.interp(points, wavelength_nm, row) for row in np.eye(wavelength_nm.size)])
    return hats @ np.asarray(spectrum_to_XYZ(np.eye(points.size), points))[:, 1]
