"""Gases that absorb and do not scatter."""

import equinox as eqx
from jaxtyping import Array, Float

from atmofit.constants import LARGEST_OPTICAL_DEPTH
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.profiles import DensityProfile, GaussianLayer
from atmofit.spectrum import Spectrum, at, checked_spectral, spectral
from atmofit.typing import Scalar


class Absorber(eqx.Module):
    """A gas that absorbs.

    Attributes:
        optical_depth: Vertical [-], 0 to 1000; a number or a `Spectrum`.
        profile: How its density depends on altitude, such as `GaussianLayer(22e3, 5e3)`.
    """

    optical_depth: Scalar | Spectrum = eqx.field(converter=spectral)
    profile: DensityProfile

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
)(Absorber)
