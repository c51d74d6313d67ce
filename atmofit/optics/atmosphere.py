"""The whole atmosphere, and its optical properties at given wavelengths."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import choice, in_range
from atmofit.constants import EARTH_RADIUS, MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.extremes import Domain, extremes
from atmofit.optics.gases import Absorber
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import Molecules
from atmofit.optics.phase import PhaseFunction, Rayleigh
from atmofit.optics.profiles import DensityProfile
from atmofit.spectrum import Spectrum, all_smooth, at, checked_spectral, spectral
from atmofit.typing import RealsLike, Scalar

GEOMETRIES = ("spherical", "flat", "paper")
PRESETS = ("preetham1999", "standard")


class Ground(eqx.Module):
    """A ground that reflects the same radiance into all directions (Lambert).

    Attributes:
        albedo: Share of the light that is reflected [-], 0 to 1; a number or a `Spectrum`.
    """

    albedo: Scalar | Spectrum = eqx.field(converter=spectral)

    def checked(self) -> "Ground":
        """Refuse impossible values."""
        return Ground(checked_spectral("albedo", self.albedo, 0.0, 1.0))


extremes(
    call=lambda albedo: Ground(albedo).checked().albedo,
    albedo=Domain(0.0, 1.0),
)(Ground)


class Atmosphere(eqx.Module):
    """What lies between the observer and space. What is absent is not computed.

    Attributes:
        molecules: Air, or None.
        haze: Particles, or None.
        absorbers: Gases that absorb.
        ground: A reflecting ground, or None: black.
        geometry: "spherical"; "flat"; or "paper": flat for view and sun below 70 degrees,
            spherical beyond (discontinuous there, only to reproduce the 1999 paper). Static.
        preset: Where unstated spectra come from, "preetham1999" or "standard". Static.
        radius: Of the ground [m]. Static.
    """

    molecules: Molecules | None = None
    haze: Haze | None = None
    absorbers: tuple[Absorber, ...] = ()
    ground: Ground | None = None
    geometry: str = eqx.field(static=True, default="spherical")
    preset: str = eqx.field(static=True, default="preetham1999")
    radius: float = eqx.field(static=True, default=EARTH_RADIUS)

    def __check_init__(self) -> None:
        """Check what shapes the program."""
        choice("geometry", self.geometry, GEOMETRIES)
        choice("preset", self.preset, PRESETS)
        in_range("radius", self.radius, 1e5, 1e9, "m")

    @classmethod
    def from_turbidity(
        cls,
        turbidity: RealsLike,
        geometry: str = "spherical",
    ) -> "Atmosphere":
        """The clear sky of the 1999 paper: molecules and haze over a black ground.

        Args:
            turbidity: 1 (no haze to speak of) to 64.
            geometry: As the attribute.

        Raises:
            ValueError: The turbidity lies outside.
        """
        return cls(Molecules(), Haze.from_turbidity(turbidity), geometry=geometry)

    def checked(self) -> "Atmosphere":
        """Refuse impossible values of every constituent."""
        return Atmosphere(
            None if self.molecules is None else self.molecules.checked(),
            None if self.haze is None else self.haze.checked(),
            tuple(gas.checked() for gas in self.absorbers),
            None if self.ground is None else self.ground.checked(),
            self.geometry,
            self.preset,
            self.radius,
        )

    @property
    def is_smooth(self) -> bool:
        """Whether log radiance may be interpolated between a few wavelengths.

        Every spectrum must promise to be smooth, and nothing may absorb.
        """
        parts = [part for part in (self.molecules, self.haze) if part is not None]
        albedo = None if self.ground is None else self.ground.albedo
        return not self.absorbers and all_smooth(albedo) and all(part.is_smooth for part in parts)


class Medium(eqx.Module):
    """An atmosphere's optical properties at chosen wavelengths; scatterers come first.

    Attributes:
        profiles: Density of each constituent.
        extinction: Vertical optical depth [-], [constituent, wavelength].
        scattering: The part of it that scatters, [scatterer, wavelength].
        phases: Phase function of each scatterer.
        wavelength_nm: [nm].
        ground_albedo: [wavelength], or None: black.
    """

    profiles: tuple[DensityProfile, ...]
    extinction: Float[Array, "constituent w"]
    scattering: Float[Array, "scatterer w"]
    phases: tuple[PhaseFunction, ...]
    wavelength_nm: Float[Array, " w"]
    ground_albedo: Float[Array, " w"] | None

    @property
    def top(self) -> Scalar:
        """Altitude above which nothing scatters [m]."""
        return jnp.stack([p.top for p in self.scattering_profiles]).max()

    @property
    def scale(self) -> Scalar:
        """Altitude over which the densest constituent changes [m]."""
        return jnp.stack([p.scale for p in self.scattering_profiles]).min()

    @property
    def scattering_profiles(self) -> tuple[DensityProfile, ...]:
        """Density of each scatterer."""
        return self.profiles[: len(self.phases)]

    def phase_functions(self, angle: Float[Array, "..."]) -> tuple[Float[Array, "..."], ...]:
        """Scattering optical depth times phase function, [..., wavelength] for each scatterer."""
        return tuple(
            phase.at_wavelengths(angle, self.wavelength_nm) * _last_axis(scattering, angle.ndim)
            for phase, scattering in zip(self.phases, self.scattering, strict=True)
        )

    def moments(self, count: int) -> Float[Array, "scatterer degree w"]:
        """Scattering optical depth times the Legendre moments of each scatterer."""
        return jnp.stack(
            [
                phase.moments(count, self.wavelength_nm) * scattering[None, :]
                for phase, scattering in zip(self.phases, self.scattering, strict=True)
            ]
        )


def optical_properties(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"]) -> Medium:
    """Evaluate every constituent at the wavelengths.

    Args:
        atmosphere: At least one constituent must scatter.
        wavelength_nm: [nm].
    """
    profiles: list[DensityProfile] = []
    extinction, scattering, phases = [], [], []
    if atmosphere.molecules is not None:
        depth = atmosphere.molecules.optical_depth_at(wavelength_nm)
        profiles.append(atmosphere.molecules.density_profile())
        extinction.append(depth)
        scattering.append(depth)
        phases.append(Rayleigh())
    if atmosphere.haze is not None:
        depth = atmosphere.haze.optical_depth_at(wavelength_nm)
        profiles.append(atmosphere.haze.density_profile())
        extinction.append(depth)
        scattering.append(depth * at(atmosphere.haze.single_scattering_albedo, wavelength_nm))
        phases.append(atmosphere.haze.phase)
    for gas in atmosphere.absorbers:
        profiles.append(gas.density_profile())
        extinction.append(gas.optical_depth_at(wavelength_nm))
    ground = atmosphere.ground
    return Medium(
        tuple(profiles),
        jnp.stack(extinction),
        jnp.stack(scattering),
        tuple(phases),
        wavelength_nm,
        None if ground is None else at(ground.albedo, wavelength_nm),
    )


def _last_axis(values: Float[Array, " w"], axes_before: int) -> Float[Array, "..."]:
    return values.reshape((1,) * axes_before + values.shape)


extremes(
    part="from_turbidity",
    call=lambda turbidity, wavelength_nm: (
        optical_properties(
            Atmosphere.from_turbidity(turbidity).checked(), wavelength_nm[None]
        ).scattering
    ),
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    wavelength_nm=Domain(380.0, 780.0),
)(Atmosphere)
