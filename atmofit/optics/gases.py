"""Gases that absorb and do not scatter."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.constants import LARGEST_OPTICAL_DEPTH
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.air import LARGEST_PRESSURE, STANDARD_PRESSURE
from atmofit.optics.profiles import DensityProfile, Exponential, GaussianLayer
from atmofit.optics.standard_atmosphere import standard_density_profile
from atmofit.spectrum import Spectrum, at, checked_spectral, spectral
from atmofit.tables import constant, preetham1999_spectra
from atmofit.typing import Reals, RealsLike, Scalar

LARGEST_OZONE_DOBSON = 1e3
LARGEST_WATER_KG_M2 = 1e2
_METRE_OF_OZONE_DOBSON = 1e5
_WATER_DENSITY = 1e3  # [kg/m^3]
_OZONE_ALTITUDE, _OZONE_WIDTH = 22.3e3, 7.9e3  # [m]
_WATER_SCALE_HEIGHT = 2e3  # [m]
_AIRMASS = 1.5  # where Beer's law meets the band formula
_LARGEST_AIRMASS = 40.0


class Absorber(eqx.Module):
    """A gas that absorbs.

    Attributes:
        optical_depth: Vertical [-], 0 to 1000; a number or a `Spectrum`.
        profile: How its density depends on altitude, such as `GaussianLayer(22e3, 5e3)`.
    """

    optical_depth: Scalar | Spectrum = eqx.field(converter=spectral)
    profile: DensityProfile

    @classmethod
    def ozone(cls, column_dobson: RealsLike = 300.0) -> "Absorber":
        """Ozone in visible light (its Chappuis band), 380 to 780 nm.

        The layer is the Gaussian nearest to the mid-latitude ozone model of the US Standard
        Atmosphere 1976 (Krueger and Minzner 1976, J. Geophys. Res. 81, 4477), around 22.3 km with
        a standard deviation of 7.9 km; the share of ozone above an altitude is within 3 % of the
        whole. The table's cross section near the maximum at 600 nm, 4.65e-25 m^2, is a tenth
        below what laboratories measure today. Other wavelengths are refused: the table ends
        there, though ozone absorbs below (its Huggins band).

        Args:
            column_dobson: Vertical amount [Dobson units, 1e-5 m at 0 degrees Celsius and
                1013 hPa], 0 to 1000.

        Raises:
            ValueError: The amount lies outside.

        References:
            Coefficients: Preetham, Shirley and Smits (1999), table 2, after Leckner (1978).
        """
        amount = in_range("column_dobson", column_dobson, 0.0, LARGEST_OZONE_DOBSON, "DU")
        depth = _table(preetham1999_spectra().k_ozone, amount / _METRE_OF_OZONE_DOBSON)
        return cls(_visible(depth), GaussianLayer(_OZONE_ALTITUDE, _OZONE_WIDTH))

    @classmethod
    def water_vapour(
        cls,
        column_kg_m2: RealsLike = 20.0,
        scale_height: RealsLike = _WATER_SCALE_HEIGHT,
        airmass: RealsLike = _AIRMASS,
    ) -> "Absorber":
        """Water vapour in visible light, 380 to 780 nm; it absorbs beyond 680 nm.

        Its lines saturate: absorption within a band grows more slowly than the path, which no
        single optical depth can follow. This one absorbs as much as the band formula does along a
        path of the given air mass. At 720 nm, where it absorbs most, and for 20 kg/m^2, the
        optical depth along the path is 16 % too small at air mass 1, 14 % too large at 2, 71 %
        at 5 and 133 % at 10 (for 1.5).

        Args:
            column_kg_m2: Vertical amount, which is millimetres of water [kg/m^2], 0 to 100.
            scale_height: Of its exponential density [m].
            airmass: Of the path along which the formula is met [-], 1 to 40.

        Raises:
            ValueError: An argument lies outside its range.

        References:
            Leckner (1978), Solar Energy 20, 143, with the coefficients of Preetham, Shirley and
            Smits (1999), table 2 and appendix A.1.
        """
        amount = in_range("column_kg_m2", column_kg_m2, 0.0, LARGEST_WATER_KG_M2, "kg/m^2")
        amount = _table(preetham1999_spectra().k_water, amount / _WATER_DENSITY)
        depth = _band_optical_depth("water", amount, airmass)
        return cls(_visible(depth), Exponential(scale_height).checked())

    @classmethod
    def mixed_gases(
        cls, surface_pressure: RealsLike = STANDARD_PRESSURE, airmass: RealsLike = _AIRMASS
    ) -> "Absorber":
        """Gases mixed evenly into the air, mostly oxygen, 380 to 780 nm.

        They absorb from 750 to 780 nm, in the oxygen A band; the B band at 690 nm is not in the
        table. Saturation is treated as for `water_vapour`: at 760 nm the optical depth along the
        path is 17 % too small at air mass 1, 14 % too large at 2, 72 % at 5 and 135 % at 10.

        Args:
            surface_pressure: At the ground [Pa], 0 to 200,000; their amount goes with it.
            airmass: Of the path along which the band formula is met [-], 1 to 40.

        Raises:
            ValueError: An argument lies outside its range.

        References:
            As `water_vapour`.
        """
        pressure = in_range("surface_pressure", surface_pressure, 0.0, LARGEST_PRESSURE, "Pa")
        amount = _table(preetham1999_spectra().k_gas, pressure / STANDARD_PRESSURE)
        return cls(
            _visible(_band_optical_depth("gas", amount, airmass)), standard_density_profile()
        )

    def checked(self) -> "Absorber":
        """Refuse impossible values."""
        depth = checked_spectral("optical_depth", self.optical_depth, 0.0, LARGEST_OPTICAL_DEPTH)
        return Absorber(depth, self.profile.checked())

    def density_profile(self) -> DensityProfile:
        """How the density depends on altitude."""
        return self.profile

    def optical_depth_at(self, wavelength_nm: Float[Array, " w"]) -> Float[Array, " w"]:
        """Vertical optical depth at each wavelength [-]."""
        return at(self.optical_depth, wavelength_nm)


extremes(
    Case("none", {"optical_depth": 0.0}, limit=0.0, slope={"optical_depth": 1.0}),
    call=lambda optical_depth, wavelength_nm: (
        Absorber(optical_depth, GaussianLayer(22e3, 5e3))
        .checked()
        .optical_depth_at(wavelength_nm[None])
    ),
    optical_depth=Domain(0.0, LARGEST_OPTICAL_DEPTH),
    wavelength_nm=Span(200.0, 3000.0),
    least=0.0,
)(Absorber)
extremes(
    Case("none", {"column_dobson": 0.0}, limit=0.0),
    # 12.5 per metre of ozone at 600 nm.
    Case(
        "600 nm",
        {"column_dobson": 300.0, "wavelength_nm": 600.0},
        limit=12.5 * 3e-3,
        slope={"column_dobson": 12.5e-5},
    ),
    part="ozone",
    call=lambda column_dobson, wavelength_nm: (
        Absorber.ozone(column_dobson).checked().optical_depth_at(wavelength_nm[None])
    ),
    column_dobson=Domain(0.0, LARGEST_OZONE_DOBSON),
    wavelength_nm=Domain(380.0, 780.0),
    least=0.0,
)(Absorber)
extremes(
    Case("none", {"column_kg_m2": 0.0}, limit=0.0),
    part="water_vapour",
    call=lambda column_kg_m2, airmass, wavelength_nm: (
        Absorber.water_vapour(column_kg_m2, airmass=airmass)
        .checked()
        .optical_depth_at(wavelength_nm[None])
    ),
    column_kg_m2=Domain(0.0, LARGEST_WATER_KG_M2),
    airmass=Domain(1.0, _LARGEST_AIRMASS),
    wavelength_nm=Domain(380.0, 780.0),
    least=0.0,
)(Absorber)
extremes(
    Case("vacuum", {"surface_pressure": 0.0}, limit=0.0),
    part="mixed_gases",
    call=lambda surface_pressure, airmass, wavelength_nm: (
        Absorber.mixed_gases(surface_pressure, airmass)
        .checked()
        .optical_depth_at(wavelength_nm[None])
    ),
    surface_pressure=Domain(0.0, LARGEST_PRESSURE),
    airmass=Domain(1.0, _LARGEST_AIRMASS),
    wavelength_nm=Domain(380.0, 780.0),
    least=0.0,
)(Absorber)


def _table(values: np.ndarray, amount: Reals) -> Float[Array, " wavelength"]:
    """A column of the paper's table 2 times an amount."""
    return jnp.asarray(values, amount.dtype) * amount


def _visible(depth: Float[Array, " wavelength"]) -> Spectrum:
    """An optical depth at the wavelengths of the paper's table 2."""
    return Spectrum(preetham1999_spectra().wavelength_nm, depth)


def _band_optical_depth(
    name: str, amount: Float[Array, " wavelength"], airmass: RealsLike
) -> Float[Array, " wavelength"]:
    """The band formula's optical depth along a path, over the air mass of the path."""
    m = in_range("airmass", airmass, 1.0, _LARGEST_AIRMASS).astype(amount.dtype)
    saturated = 1 + constant(f"{name}_saturation") * amount * m
    return constant(f"{name}_factor") * amount / saturated ** constant(f"{name}_exponent")
