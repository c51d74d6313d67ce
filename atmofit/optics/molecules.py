"""Air molecules."""

import math

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import in_range
from atmofit.constants import (
    LARGEST_OPTICAL_DEPTH,
    LARGEST_SCALE_HEIGHT,
    MAXIMUM_WAVELENGTH_NM,
    MINIMUM_WAVELENGTH_NM,
    SMALLEST_SCALE_HEIGHT,
)
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.optics.air import (
    LARGEST_PRESSURE,
    STANDARD_PRESSURE,
    air_depolarisation,
    rayleigh_optical_depth,
)
from atmofit.optics.phase import Rayleigh
from atmofit.optics.profiles import DensityProfile, Exponential
from atmofit.optics.standard_atmosphere import standard_density_profile
from atmofit.spectrum import Spectrum, all_smooth, at, checked_spectral, spectral
from atmofit.tables import constant
from atmofit.typing import Reals, RealsLike, Scalar, scalar

# Between these the depolarisation of air is linear: within 1e-4 of it, at 200 nm, else 1e-5.
_DEPOLARISATION_NODES = 60


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

    The defaults are those of the 1999 paper; `Molecules.standard` is real air.

    Attributes:
        optical_depth: Vertical [-], a number or a `Spectrum`; None: that of real air if
            `surface_pressure` is given, else the scattering coefficient of the 1999 paper times
            the scale height, at each wavelength.
        scale_height: Of the exponential density [m], 1 to 30,000.
        profile: Another shape of the density, or None.
        refractive_index: Of air, for the formula; 1.000278 is consistent with the paper's
            optical depth, the 1.0003 that it prints gives 16 % more scattering.
        surface_pressure: At the ground [Pa], 0 to 200,000, from which the optical depth of real
            air follows (`rayleigh_optical_depth`), or None.
        depolarisation: In the phase function [-], a number or a `Spectrum`, 0 to 6/7; None:
            left out, as in the 1999 paper.
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
    surface_pressure: Scalar | None = eqx.field(
        converter=lambda value: None if value is None else scalar(value), default=None
    )
    depolarisation: Scalar | Spectrum | None = eqx.field(
        converter=lambda value: None if value is None else spectral(value), default=None
    )

    def __check_init__(self) -> None:
        """Refuse two answers to one question."""
        if self.optical_depth is not None and self.surface_pressure is not None:
            raise ValueError(
                "optical_depth must be None where surface_pressure is given, which implies it, "
                f"got {self.optical_depth}"
            )

    @classmethod
    def standard(cls, surface_pressure: RealsLike = STANDARD_PRESSURE) -> "Molecules":
        """Real dry air, with the density of the US Standard Atmosphere 1976.

        Args:
            surface_pressure: At the ground [Pa], 0 to 200,000. It sets the optical depth; the
                shape of the density stays that above sea level.

        Raises:
            ValueError: The pressure lies outside.

        References:
            Bodhaine et al. (1999) for scattering and depolarisation, see `atmofit.optics.air`.
        """
        nodes = np.geomspace(MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM, _DEPOLARISATION_NODES)
        nodes[[0, -1]] = MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM  # no rounding at the ends
        return cls(
            profile=standard_density_profile(),
            surface_pressure=in_range(
                "surface_pressure", surface_pressure, 0.0, LARGEST_PRESSURE, "Pa"
            ),
            depolarisation=Spectrum(nodes, air_depolarisation(nodes), smooth=True),
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
            None
            if self.surface_pressure is None
            else in_range("surface_pressure", self.surface_pressure, 0.0, LARGEST_PRESSURE, "Pa"),
            self.phase().checked().depolarisation,
        )

    def phase(self) -> Rayleigh:
        """The phase function."""
        return Rayleigh(self.depolarisation)

    def density_profile(self) -> DensityProfile:
        """How the density falls with altitude."""
        return Exponential(self.scale_height) if self.profile is None else self.profile

    def optical_depth_at(self, wavelength_nm: Float[Array, " w"]) -> Float[Array, " w"]:
        """Vertical optical depth at each wavelength [-]."""
        if self.surface_pressure is not None:
            return rayleigh_optical_depth(wavelength_nm, self.surface_pressure)
        if self.optical_depth is None:
            coefficient = molecular_scattering_coefficient(wavelength_nm, self.refractive_index)
            return coefficient * self.scale_height
        return at(self.optical_depth, wavelength_nm)

    @property
    def is_smooth(self) -> bool:
        """Whether the spectra promise that radiance may be interpolated between wavelengths."""
        return all_smooth(self.optical_depth, self.depolarisation)


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
    least=0.0,
)(Molecules)
extremes(
    Case("none", {"optical_depth": 0.0}, limit=0.0, slope={"optical_depth": 1.0}),
    part="optical_depth",
    call=lambda optical_depth: (
        Molecules(optical_depth).checked().optical_depth_at(optical_depth[None])
    ),
    optical_depth=Domain(0.0, LARGEST_OPTICAL_DEPTH),
    least=0.0,
)(Molecules)
extremes(
    Case("vacuum", {"surface_pressure": 0.0}, limit=0.0),
    part="standard",
    call=lambda surface_pressure, wavelength_nm: (
        Molecules.standard(surface_pressure).checked().optical_depth_at(wavelength_nm[None])
    ),
    surface_pressure=Domain(0.0, LARGEST_PRESSURE),
    wavelength_nm=Domain(MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM),
    least=0.0,
)(Molecules)
