"""Air molecules."""

import math

import equinox as eqx
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.constants import LARGEST_OPTICAL_DEPTH, LARGEST_SCALE_HEIGHT, SMALLEST_SCALE_HEIGHT
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.profiles import DensityProfile, Exponential
from atmofit.spectrum import Spectrum, all_smooth, at, checked_spectral, spectral
from atmofit.tables import constant
from atmofit.typing import Reals, Scalar, scalar


def molecular_scattering_coefficient(
    wavelength_nm: Float[Array, "*s"], refractive_index: Reals
) -> Float[Array, "*s"]:
    """Scattering coefficient of air at the ground.

    Args:
        wavelength_nm: Wavelength [nm].
        refractive_index: Of the air, the same at every wavelength.

    Returns:
        Total scattering coefficient [1/m].

    References:
        Preetham, Shirley and Smits (1999), appendix A.3, with its number density and
        depolarisation factor.
    """
    depolarisation = constant("depolarization_factor")
    king = (6 + 3 * depolarisation) / (6 - 7 * depolarisation)
    # n^2 - 1 as (n - 1)(n + 1), and the powers of ten gathered, keep float32 exact and in range.
    refraction = ((refractive_index - 1) * (refractive_index + 1) * 1e3) ** 2
    scale = 8 * math.pi**3 / 3 * king / constant("number_density") * 1e-6 * 1e36
    return scale * refraction / wavelength_nm**4


class Molecules(eqx.Module):
    """Air molecules, which scatter and do not absorb.

    Attributes:
        optical_depth: Vertical [-], a number or a `Spectrum`; None: scattering coefficient of
            the 1999 paper times the scale height, at each wavelength.
        scale_height: Of the exponential density [m], 1 to 30,000.
        profile: Another shape of the density, or None.
        refractive_index: Of air, for the formula; 1.000278 is consistent with the paper's
            optical depth, the 1.0003 that it prints gives 16 % more scattering.
    """

    optical_depth: Scalar | Spectrum | None = eqx.field(
        converter=lambda value: None if value is None else spectral(value), default=None
    )
    scale_height: Scalar = eqx.field(
        converter=scalar, default_factory=lambda: 1 / constant("molecules_decay")
    )
    profile: DensityProfile | None = None
    refractive_index: Scalar = eqx.field(
        converter=scalar, default_factory=lambda: constant("refractive_index")
    )

    def checked(self) -> "Molecules":
        """Refuse impossible values."""
        return Molecules(
            None
            if self.optical_depth is None
            else checked_spectral("optical_depth", self.optical_depth, 0.0, LARGEST_OPTICAL_DEPTH),
            in_range(
                "scale_height", self.scale_height, SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT, "m"
            ),
            None if self.profile is None else self.profile.checked(),
            in_range("refractive_index", self.refractive_index, 1.0, 1.01),
        )

    def density_profile(self) -> DensityProfile:
        """How the density falls with altitude."""
        return Exponential(self.scale_height) if self.profile is None else self.profile

    def optical_depth_at(self, wavelength_nm: Float[Array, " w"]) -> Float[Array, " w"]:
        """Vertical optical depth at each wavelength [-]."""
        if self.optical_depth is None:
            coefficient = molecular_scattering_coefficient(wavelength_nm, self.refractive_index)
            return coefficient * self.scale_height
        return at(self.optical_depth, wavelength_nm)

    @property
    def is_smooth(self) -> bool:
        """Whether the spectra promise that radiance may be interpolated between wavelengths."""
        return all_smooth(self.optical_depth)


extremes(
    Case("vacuum", {"refractive_index": 1.0}, limit=0.0, slope={"refractive_index": 0.0}),
    call=lambda scale_height, refractive_index, wavelength_nm: (
        Molecules(scale_height=scale_height, refractive_index=refractive_index)
        .checked()
        .optical_depth_at(wavelength_nm[None])
    ),
    scale_height=Domain(SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT),
    refractive_index=Domain(1.0, 1.01),
    wavelength_nm=Span(200.0, 3000.0),
)(Molecules)
extremes(
    Case("none", {"optical_depth": 0.0}, limit=0.0, slope={"optical_depth": 1.0}),
    part="optical_depth",
    call=lambda optical_depth: (
        Molecules(optical_depth).checked().optical_depth_at(optical_depth[None])
    ),
    optical_depth=Domain(0.0, LARGEST_OPTICAL_DEPTH),
)(Molecules)
