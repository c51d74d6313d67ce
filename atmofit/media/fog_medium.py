"""A layer of even fog under even air, and the paper's fogs: Klassen (1987), section 10."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import choice, in_range
from atmofit.constants import MAXIMUM_WAVELENGTH_NM, MINIMUM_WAVELENGTH_NM
from atmofit.extremes import Case, Domain, extremes
from atmofit.media.fog_geometry import sun_distance
from atmofit.optics.air import rayleigh_optical_depth
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Reals, RealsLike, Scalar, real_array, scalar

HIGHEST, HIGHEST_TOP = 1e5, 8e3  # [m]
LARGEST_EXTINCTION = 10.0  # [1/m]
EXTINCTION = {"thin": 15e-3, "dense": 40e-3}  # [1/m], the ends of the paper's range
AIR_TOP = 8.4e3  # [m], of air with the ground's density
ASYMMETRY = 0.85  # of the presets' droplets


class FogLayer(eqx.Module):
    """Fog from altitude 0 to its top, and air up to another.

    Attributes:
        top: Of the fog [m], 0 to 8000.
        extinction: Of the droplets [1/m], by wavelength, 0 to 10.
        scattering: Of the droplets [1/m], 0 to `extinction`.
        molecular_extinction: Of the air, all of it scattering [1/m], 0 to 0.01.
        wavelength_nm: [nm].
        phase: Of the droplets.
        air_top: Altitude at which the even air ends [m], `top` to 100,000.
    """

    top: Scalar = eqx.field(converter=scalar)
    extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    scattering: Float[Array, " w"] = eqx.field(converter=real_array)
    molecular_extinction: Float[Array, " w"] = eqx.field(converter=real_array)
    wavelength_nm: Float[Array, " w"] = eqx.field(converter=real_array)
    phase: PhaseFunction
    air_top: Scalar = eqx.field(converter=scalar, default=AIR_TOP)

    def __check_init__(self) -> None:
        """Every spectrum is as long as the wavelengths."""
        shape = self.wavelength_nm.shape
        for name in ("extinction", "scattering", "molecular_extinction"):
            found = getattr(self, name).shape
            if found != shape or len(shape) != 1:
                raise ValueError(f"{name} must have the shape [wavelength] = {shape}, got {found}")

    def checked(self) -> "FogLayer":
        """Refuse impossible values; traced ones become NaN."""
        top = in_range("top", self.top, 0.0, HIGHEST_TOP, "m")
        drops = in_range("extinction", self.extinction, 0.0, LARGEST_EXTINCTION, "1/m")
        absorbed = drops - self.scattering.astype(drops.dtype)
        absorbed = in_range("extinction - scattering", absorbed, 0.0, LARGEST_EXTINCTION, "1/m")
        wavelength = in_range(
            "wavelength_nm",
            self.wavelength_nm,
            MINIMUM_WAVELENGTH_NM,
            MAXIMUM_WAVELENGTH_NM,
            "nm",
        )
        return FogLayer(
            top,
            drops,
            in_range("scattering", drops - absorbed, 0.0, LARGEST_EXTINCTION, "1/m"),
            in_range("molecular_extinction", self.molecular_extinction, 0.0, 0.01, "1/m"),
            wavelength,
            self.phase.checked(),
            in_range("air_top - top", self.air_top - top, 0.0, HIGHEST, "m") + top,
        )

    def in_dtype(self, dtype: Any) -> "FogLayer":
        """The same in the precision of a computation."""
        return jax.tree.map(lambda leaf: leaf.astype(dtype), self)

    def over(self, like: Reals) -> tuple[Reals, Reals]:
        """Extinction of air and of droplets, to go with an array and wavelengths behind it."""
        spectra = (self.molecular_extinction, self.extinction)
        air, drops = (spectrum_over(x, like) for x in spectra)
        return air, drops

    def sun_depth(self, altitude: Reals, sine: Reals, curved: bool) -> Reals:
        """Optical depth of the way to the sun, [..., wavelength]: the exponent of equation 40."""
        air, drops = self.over(altitude)
        shells = (self.air_top, self.top)
        in_air, in_fog = (sun_distance(shell, altitude, sine, curved) for shell in shells)
        return air * in_air[..., None] + drops * in_fog[..., None]


def spectrum_over(spectrum: Array, like: Reals) -> Reals:
    """A number or a spectrum in the dtype of an array, with axes to go with it in front."""
    return spectrum.astype(like.dtype).reshape((1,) * like.ndim + (spectrum.size,))


def fog_layer(density: str, top: RealsLike, wavelength_nm: RealsLike = (550.0,)) -> FogLayer:
    """Fog with the paper's constants, the same at all wavelengths, and pure air at sea level.

    Args:
        density: "thin" (15 per km) or "dense" (40 per km).
        top: Altitude [m], 0 to 8000.
        wavelength_nm: List [nm].

    Returns:
        The layer; its droplets absorb nothing and scatter with asymmetry 0.85, which is ours.

    Raises:
        ValueError: Another word, or a value out of range.
    """
    extinction = EXTINCTION[choice("density", density, tuple(EXTINCTION))]
    wavelength = real_array(wavelength_nm)
    air = rayleigh_optical_depth(wavelength) / AIR_TOP
    even = jnp.full_like(wavelength, extinction)
    return FogLayer(top, even, even, air, wavelength, HenyeyGreenstein(ASYMMETRY)).checked()


extremes(
    Case("no height", {"top": 0.0}),
    call=lambda top, wavelength_nm: fog_layer("dense", top, wavelength_nm),
    top=Domain(0.0, HIGHEST_TOP),
    wavelength_nm=Domain((MINIMUM_WAVELENGTH_NM,), (MAXIMUM_WAVELENGTH_NM,)),
)(fog_layer)
