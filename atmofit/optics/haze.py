"""Haze: the particles that are larger than molecules."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.constants import (
    LARGEST_OPTICAL_DEPTH,
    LARGEST_SCALE_HEIGHT,
    MAXIMUM_TURBIDITY,
    MINIMUM_TURBIDITY,
    REFERENCE_WAVELENGTH_NM,
    SMALLEST_SCALE_HEIGHT,
)
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction, TabulatedPhase
from atmofit.optics.profiles import DensityProfile, Exponential
from atmofit.spectrum import Spectrum, all_smooth, at, checked_spectral, spectral
from atmofit.tables import constant, preetham1999_phase, preetham1999_spectra
from atmofit.typing import RealsLike, Scalar, scalar


class Haze(eqx.Module):
    """Particles with a power-law spectrum.

    Attributes:
        optical_depth: Vertical, at 550 nm [-], 0 to 1000; a `Spectrum` replaces the power law.
        angstrom_exponent: Minus the log-log slope of optical depth against wavelength [-].
        scale_height: Of the exponential density [m], 1 to 30,000.
        single_scattering_albedo: Share of the extinction that is scattering [-], 0 to 1; a
            number or a `Spectrum`.
        phase: Phase function.
        relative_efficiency: Factor on the power law, for spectra that deviate from it, or None.
        profile: Another shape of the density, or None.
    """

    optical_depth: Scalar | Spectrum = eqx.field(converter=spectral)
    angstrom_exponent: Scalar = eqx.field(converter=scalar, default=1.3)
    scale_height: Scalar = eqx.field(
        converter=scalar, default_factory=lambda: 1 / constant("haze_decay")
    )
    single_scattering_albedo: Scalar | Spectrum = eqx.field(converter=spectral, default=1.0)
    phase: PhaseFunction = eqx.field(default_factory=lambda: HenyeyGreenstein(0.76))
    relative_efficiency: Spectrum | None = None
    profile: DensityProfile | None = None

    @classmethod
    def from_turbidity(cls, turbidity: RealsLike) -> "Haze":
        """The haze of the 1999 paper: Junge exponent 4, Bullrich's table of angles.

        Args:
            turbidity: Optical depth of air with haze over that of air alone at 550 nm, 1 to 64.

        Raises:
            ValueError: The turbidity lies outside.

        References:
            Preetham, Shirley and Smits (1999), appendix A.3, with the concentration in SI units.
        """
        value = in_range("turbidity", turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY)
        spectra = preetham1999_spectra()
        at_reference = np.interp(REFERENCE_WAVELENGTH_NM, spectra.wavelength_nm, spectra.K)
        exponent = constant("junge_exponent") - 2
        per_concentration = (
            constant("haze_prefactor")
            * math.pi
            * (2 * math.pi / (REFERENCE_WAVELENGTH_NM * 1e-9)) ** exponent
            * at_reference
            / constant("haze_decay")
        )
        slope = per_concentration * constant("haze_concentration_slope")
        offset = per_concentration * constant("haze_concentration_intercept")
        return cls(
            optical_depth=value * float(slope) + float(offset),
            angstrom_exponent=exponent,
            phase=bullrich_phase(),
            relative_efficiency=Spectrum(
                spectra.wavelength_nm, spectra.K / at_reference, smooth=True
            ),
        )

    def checked(self) -> "Haze":
        """Refuse impossible values."""
        return Haze(
            checked_spectral("optical_depth", self.optical_depth, 0.0, LARGEST_OPTICAL_DEPTH),
            in_range("angstrom_exponent", self.angstrom_exponent, -5.0, 5.0),
            in_range(
                "scale_height", self.scale_height, SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT, "m"
            ),
            checked_spectral("single_scattering_albedo", self.single_scattering_albedo, 0.0, 1.0),
            self.phase.checked(),
            _checked_efficiency(self.relative_efficiency),
            None if self.profile is None else self.profile.checked(),
        )

    def density_profile(self) -> DensityProfile:
        """How the density falls with altitude."""
        return Exponential(self.scale_height) if self.profile is None else self.profile

    def optical_depth_at(self, wavelength_nm: Float[Array, " w"]) -> Float[Array, " w"]:
        """Vertical optical depth at each wavelength [-]."""
        if isinstance(self.optical_depth, Spectrum):
            return at(self.optical_depth, wavelength_nm)
        power = jnp.exp(-self.angstrom_exponent * jnp.log(wavelength_nm / REFERENCE_WAVELENGTH_NM))
        depth = self.optical_depth * power
        if self.relative_efficiency is None:
            return depth
        return depth * at(self.relative_efficiency, wavelength_nm)

    @property
    def is_smooth(self) -> bool:
        """Whether the spectra promise that radiance may be interpolated between wavelengths."""
        asymmetry = getattr(self.phase, "asymmetry", None)
        return all_smooth(
            self.optical_depth, self.single_scattering_albedo, self.relative_efficiency, asymmetry
        )


extremes(
    Case("none", {"optical_depth": 0.0}, limit=0.0),
    Case("at 550 nm", {"optical_depth": 0.3, "wavelength_nm": 550.0}, 0.3, {"optical_depth": 1.0}),
    call=lambda optical_depth, angstrom_exponent, wavelength_nm: (
        Haze(optical_depth, angstrom_exponent).checked().optical_depth_at(wavelength_nm[None])
    ),
    optical_depth=Domain(0.0, LARGEST_OPTICAL_DEPTH),
    angstrom_exponent=Domain(-5.0, 5.0),
    wavelength_nm=Span(200.0, 3000.0),
    least=0.0,
)(Haze)
extremes(
    part="parameters",
    call=lambda scale_height, single_scattering_albedo: Haze(
        0.1, 1.3, scale_height, single_scattering_albedo
    ).checked(),
    scale_height=Domain(SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT),
    single_scattering_albedo=Domain(0.0, 1.0),
    least=0.0,
)(Haze)
extremes(
    part="from_turbidity",
    call=lambda turbidity, wavelength_nm: (
        Haze.from_turbidity(turbidity).checked().optical_depth_at(wavelength_nm[None])
    ),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    wavelength_nm=Domain(380.0, 780.0),
    least=0.0,
)(Haze)


def _checked_efficiency(efficiency: Spectrum | None) -> Spectrum | None:
    if efficiency is None:
        return None
    values = in_range("relative_efficiency", efficiency.values, 0.0, 1e3)
    return Spectrum(efficiency.wavelength_nm, values, efficiency.smooth)


def bullrich_phase() -> TabulatedPhase:
    """Phase function of the paper's Table 1; below 1 degree it keeps its value at 1 degree."""
    table = preetham1999_phase()
    return TabulatedPhase(
        np.concatenate([[0.0], table.scattering_angle]),
        np.concatenate([table.eta[:1], table.eta]),
        table.wavelength_nm,
    )


extremes(
    Case("below the first angle", {"angle": 1e-3}),
    call=lambda angle, wavelength_nm: bullrich_phase()(angle, wavelength_nm),
    angle=Domain(0.0, math.pi),
    wavelength_nm=Span(200.0, 3000.0),
    least=0.0,
)(bullrich_phase)
