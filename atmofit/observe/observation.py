"""What was measured of a sky, and with what noise."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from atmofit.checks import angle_in_range, choice, in_range, is_traced
from atmofit.colour import LUMINANCE_OF_SRGB
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.observe.channels import Channels, checked_channels, names, weights
from atmofit.spectrum import check_wavelengths
from atmofit.typing import Reals, Scalar, real_array, scalar

EXPOSURES = ("known", "unknown", "each channel")


def _wavelengths(value: Any) -> tuple[float, ...] | None:
    return None if value is None else tuple(float(λ) for λ in np.asarray(value, float).ravel())


def _mask(value: Any) -> Bool[Array, "..."]:
    return jnp.asarray(value, bool)


class Observation(eqx.Module):
    """One sky, seen in many directions.

    Structure is checked when it is made, values by `checked`, which every fit calls. A stack of
    observations of one structure may be vmapped over.

    Attributes:
        directions: Where it was looked; on or above the horizon.
        values: Of each direction, [direction axes]: luminance [cd m^-2]; or [direction axes,
            channel]: spectral radiance [W m^-2 sr^-1 nm^-1] at `wavelength_nm`, else what
            `channels` says. Positive where the mask is set.
        solar_zenith_angle: 0 to pi/2 [rad].
        relative_noise: Standard deviation of each value over the value [-], above 0; a number or
            one for each value. The noise of one value is independent of every other's.
        wavelength_nm: Of spectral radiances, increasing [nm], or None. Static.
        channels: Without wavelengths: "luminance", "XYZ", "linear_sRGB", or a `Camera`. Static.
        noise_floor: Standard deviation that comes on top, in the unit of the values.
        mask: Which directions are used, [direction axes]; those with cloud, sun or dirt are not.
        exposure: "known": the values have their unit; "unknown": all of them times one positive
            number; "each channel": each channel times one of its own (white balance). Static.
    """

    directions: Directions | DirectionGrid
    values: Reals = eqx.field(converter=real_array)
    solar_zenith_angle: Scalar = eqx.field(converter=scalar)
    relative_noise: Reals = eqx.field(converter=real_array)
    wavelength_nm: tuple[float, ...] | None = eqx.field(
        static=True, converter=_wavelengths, default=None
    )
    channels: Channels = eqx.field(static=True, default="luminance")
    noise_floor: Reals = eqx.field(converter=real_array, default=0.0)
    mask: Bool[Array, "..."] = eqx.field(converter=_mask, default=True)
    exposure: str = eqx.field(static=True, default="known")

    def __check_init__(self) -> None:
        """Check that the shapes belong together."""
        checked_channels(self.channels)
        choice("exposure", self.exposure, EXPOSURES)
        shape, axes = self.directions.shape, "direction axes"
        if self.wavelength_nm is not None:
            if not self.wavelength_nm:
                raise ValueError("wavelength_nm must hold at least one wavelength, got none")
            check_wavelengths(np.asarray(self.wavelength_nm))
            shape, axes = (*shape, len(self.wavelength_nm)), "direction axes, wavelength"
        elif self.channels != "luminance":
            shape, axes = (*shape, len(names(self.channels))), "direction axes, channel"
        if self.values.shape != shape:
            raise ValueError(f"values must have shape [{axes}] = {shape}, got {self.values.shape}")
        for name in ("relative_noise", "noise_floor"):
            given = getattr(self, name)
            if given.shape not in ((), shape):
                raise ValueError(
                    f"{name} must be a number or have the shape of the values, {shape}, "
                    f"got {given.shape}"
                )
        if self.mask.shape not in ((), self.directions.shape):
            raise ValueError(
                f"mask must have the shape of the directions, {self.directions.shape}, "
                f"got {self.mask.shape}"
            )
        if self.solar_zenith_angle.ndim != 0:
            raise ValueError(
                f"solar_zenith_angle must be one number, got shape {self.solar_zenith_angle.shape}"
            )

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Of the channels, for tables and pictures."""
        if self.wavelength_nm is not None:
            return tuple(f"{λ:g} nm" for λ in self.wavelength_nm)
        return names(self.channels)

    @property
    def by_channel(self) -> Reals:
        """Values with a last axis of channels, which luminance has one of."""
        one = self.wavelength_nm is None and self.channels == "luminance"
        return self.values[..., None] if one else self.values

    @property
    def used(self) -> Bool[Array, "..."]:
        """Which directions are used, of the shape of the directions."""
        return jnp.broadcast_to(self.mask, self.directions.shape)

    def checked(self) -> "Observation":
        """Refuse impossible values.

        Raises:
            ValueError: A known value that is used is not finite, not positive or out of range, or
                the mask leaves nothing.
        """
        directions = self.directions
        if not is_traced(self.mask) and not np.asarray(self.mask).any():
            raise ValueError("mask must leave at least one direction, got none")
        return eqx.tree_at(
            lambda o: (
                o.directions, o.values, o.solar_zenith_angle, o.relative_noise, o.noise_floor
            ),
            self,
            (
                directions.checked()
                if isinstance(directions, Directions)
                else _checked_grid(directions),
                self._positive("values", self.values),
                angle_in_range("solar_zenith_angle", self.solar_zenith_angle, 0.0, HORIZON),
                self._positive("relative_noise", self.relative_noise),
                in_range("noise_floor", self.noise_floor, 0.0, math.inf),
            ),
        )  # fmt: skip

    def noise(self) -> Reals:
        """Relative noise of every value, [direction axes, channel]; infinite where masked."""
        values = self.by_channel
        shape = self.values.shape
        relative = jnp.broadcast_to(self.relative_noise, shape).reshape(values.shape)
        floor = jnp.broadcast_to(self.noise_floor, shape).reshape(values.shape)
        used = self.used[..., None]
        floor = floor.astype(values.dtype) / jnp.where(used, values, jnp.ones_like(values))
        total = jnp.sqrt(relative.astype(values.dtype) ** 2 + floor**2)
        return jnp.where(used, total, jnp.inf)

    def to_luminance(self) -> "Observation":
        """The same sky as luminances [cd m^-2], with the noise that they then have.

        Spectra are integrated as linear between their wavelengths; beyond their ends, which may
        lie up to 10 nm inside 380 and 780 nm, they are constant. Of XYZ the Y is taken, and
        linear sRGB is weighted.

        Raises:
            ValueError: Spectra that do not cover 380 to 780 nm or have gaps above 20 nm, a
                camera of unknown luminance, or channels of different exposure.
        """
        if self.wavelength_nm is None and self.channels == "luminance":
            return self
        if self.exposure == "each channel":
            raise ValueError('exposure must be the same in all channels, got "each channel"')
        share = self._luminance_weights().astype(self.values.dtype)
        luminance = jnp.tensordot(self.values, share, 1)
        absolute = self.noise() * self.values
        variance = jnp.tensordot(jnp.where(self.used[..., None], absolute, 0.0) ** 2, share**2, 1)
        used = self.used & (luminance > 0)
        relative = jnp.sqrt(variance) / jnp.where(used, luminance, 1.0)
        return Observation(
            self.directions,
            luminance,
            self.solar_zenith_angle,
            jnp.where(used & (relative > 0), relative, 1.0),
            mask=used,
            exposure=self.exposure,
        )

    def _luminance_weights(self) -> Reals:
        """What each channel adds to the luminance."""
        if self.wavelength_nm is not None:
            return jnp.asarray(weights("luminance", self.wavelength_nm)[0])
        if self.channels == "XYZ":
            return jnp.asarray([0.0, 1.0, 0.0])
        if self.channels == "linear_sRGB":
            return jnp.asarray(LUMINANCE_OF_SRGB)
        raise ValueError("channels must have a known luminance, got a camera")

    def _positive(self, name: str, values: Reals) -> Reals:
        """Refuse values that are used and not finite or not above 0; the others become 1."""
        used = jnp.broadcast_to(self.mask, self.directions.shape)
        used = used.reshape(used.shape + (1,) * (self.values.ndim - used.ndim))
        if values.ndim:
            values = jnp.where(used, values, jnp.ones_like(values))
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
