"""What an instrument makes of a spectrum: luminance, tristimulus values, a camera's channels."""

import dataclasses
import functools

import jax
import numpy as np
from numpy.typing import NDArray

from atmofit.checks import choice
from atmofit.colour import XYZ_to_linear_sRGB, spectrum_to_XYZ
from atmofit.spectrum import check_wavelengths

COLOURS = ("luminance", "XYZ", "linear_sRGB")
VISIBLE_NM = (380.0, 780.0)
# A spectrum held constant over its last 10 nm misses 1e-4 of the luminance; one sampled every
# 20 nm and linear in between misses 1e-3.
_SHORTFALL_NM, _WIDEST_GAP_NM = 10.0, 20.0
_SLACK_NM = 1e-3  # the rounding of float32


@dataclasses.dataclass(frozen=True)
class Camera:
    """Linear channels with their spectral sensitivities.

    A channel's value is the integral of sensitivity times radiance, both linear between their
    wavelengths.

    Attributes:
        wavelength_nm: Increasing, 380 to 780 [nm].
        sensitivity: Of each channel at these wavelengths, not negative; any unit.
    """

    wavelength_nm: tuple[float, ...]
    sensitivity: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        """Refuse what is no set of sensitivities."""
        check_wavelengths(np.asarray(self.wavelength_nm))
        low, high = VISIBLE_NM
        if not low <= self.wavelength_nm[0] < self.wavelength_nm[-1] <= high:
            raise ValueError(
                f"wavelength_nm must lie in {low:g} to {high:g} nm, got {self.wavelength_nm[0]:g} "
                f"to {self.wavelength_nm[-1]:g}"
            )
        rows = [np.asarray(row, float) for row in self.sensitivity]
        if not rows or any(row.shape != (len(self.wavelength_nm),) for row in rows):
            raise ValueError(
                f"sensitivity must hold {len(self.wavelength_nm)} values for each channel, got "
                f"{[row.size for row in rows]}"
            )
        for row in rows:
            if not (np.isfinite(row).all() and (row >= 0).all() and row.any()):
                raise ValueError(f"sensitivity must be finite, not negative and not all 0: {row}")


Channels = str | Camera


def checked_channels(channels: Channels) -> Channels:
    """Refuse an unknown word."""
    return channels if isinstance(channels, Camera) else choice("channels", channels, COLOURS)


def names(channels: Channels) -> tuple[str, ...]:
    """Of the channels, for tables and pictures."""
    if isinstance(channels, Camera):
        return tuple(f"channel {k + 1}" for k in range(len(channels.sensitivity)))
    return {"luminance": ("Y",), "XYZ": ("X", "Y", "Z"), "linear_sRGB": ("R", "G", "B")}[channels]


@functools.lru_cache(maxsize=64)
def weights(channels: Channels, wavelength_nm: tuple[float, ...]) -> NDArray[np.float64]:
    """What radiance at each wavelength adds to each channel, [channel, wavelength].

    A spectrum is linear between its wavelengths; beyond its ends, which may lie up to 10 nm
    inside 380 and 780 nm, it is constant.

    Args:
        channels: "luminance" [cd m^-2], "XYZ" or "linear_sRGB" (of the same unit), or a camera.
        wavelength_nm: Of the spectrum.

    Raises:
        ValueError: The wavelengths do not cover the visible, or have gaps above 20 nm.
    """
    λ = np.asarray(wavelength_nm)
    low, high = VISIBLE_NM
    _check_covered(λ)
    points = np.unique(np.concatenate([[low], λ[(λ > low) & (λ < high)], [high]]))
    hats = np.array([np.interp(points, λ, row) for row in np.eye(λ.size)])
    if isinstance(channels, Camera):
        return _camera_weights(channels, λ)
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        XYZ = spectrum_to_XYZ(np.eye(points.size), points)
        found = XYZ_to_linear_sRGB(XYZ) if channels == "linear_sRGB" else XYZ
        found = np.asarray(found, float)
    return (hats @ (found[:, 1:2] if channels == "luminance" else found)).T


def effective_wavelengths(channels: Channels) -> NDArray[np.float64]:
    """Of each channel, its centre under an even spectrum [nm]."""
    λ = np.arange(380.0, 781.0, 10.0)
    size = np.abs(weights(channels, tuple(λ.tolist())))
    return (size @ λ) / size.sum(axis=1)


def _camera_weights(camera: Camera, wavelength_nm: np.ndarray) -> NDArray[np.float64]:
    """Integrals of sensitivity times each wavelength's hat function."""
    low, high = VISIBLE_NM
    points = np.arange(low, high + 0.25, 0.5)
    hats = np.array([np.interp(points, wavelength_nm, row) for row in np.eye(wavelength_nm.size)])
    curves = [
        np.interp(points, camera.wavelength_nm, row, left=0.0, right=0.0)
        for row in camera.sensitivity
    ]
    products = np.asarray(curves)[:, None, :] * hats[None]
    return np.asarray(np.trapezoid(products, points, axis=2))


def _check_covered(wavelength_nm: np.ndarray) -> None:
    low, high = VISIBLE_NM
    room = _SHORTFALL_NM + _SLACK_NM
    if wavelength_nm[0] > low + room or wavelength_nm[-1] < high - room:
        raise ValueError(
            f"wavelength_nm must cover {low:g} to {high:g} nm (up to {_SHORTFALL_NM:g} nm may be "
            f"missing at either end) to give a luminance or colour, got {wavelength_nm[0]:.6g} to "
            f"{wavelength_nm[-1]:.6g} nm"
        )
    seen = (wavelength_nm > low - room) & (wavelength_nm < high + room)
    gap = np.diff(wavelength_nm[seen]).max(initial=0.0)
    if gap > _WIDEST_GAP_NM + _SLACK_NM:
        raise ValueError(
            f"wavelength_nm must have gaps of at most {_WIDEST_GAP_NM:g} nm to give a luminance "
            f"or colour, got {gap:.6g} nm"
        )
