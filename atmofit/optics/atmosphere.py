"""The whole atmosphere, and its optical properties at given wavelengths."""

import math

import equinox as eqx

from atmofit.checks import choice, in_range
from atmofit.constants import EARTH_RADIUS
from atmofit.extremes import Domain, extremes
from atmofit.optics.air import STANDARD_PRESSURE
from atmofit.optics.gases import Absorber
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import Molecules
from atmofit.spectrum import Spectrum, all_smooth, checked_spectral, spectral
from atmofit.typing import RealsLike, Scalar

GEOMETRIES = ("spherical", "pseudo-spherical", "flat", "paper")
LATEST_SUN = math.radians(96.0)  # civil twilight, where the planet is round
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


extremes(call=lambda albedo: Ground(albedo).checked().albedo, albedo=Domain(0.0, 1.0), least=0.0)(
    Ground
)


class Atmosphere(eqx.Module):
    """What lies between the observer and space. What is absent is not computed.

    Attributes:
        molecules: Air, or None.
        haze: Particles, or None.
        absorbers: Gases that absorb.
        ground: A reflecting ground, or None: black.
        geometry: "spherical"; "pseudo-spherical": only for sunlight; "flat"; or "paper": flat for
            view and sun below 70 degrees, spherical beyond (discontinuous there, only to
            reproduce the 1999 paper). Static.
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

    @classmethod
    def standard(
        cls,
        haze: Haze | None = None,
        ground: Ground | None = None,
        surface_pressure: RealsLike = STANDARD_PRESSURE,
        ozone_dobson: RealsLike | None = 300.0,
        geometry: str = "spherical",
    ) -> "Atmosphere":
        """Real air with ozone, under the sun of ASTM G-173.

        Args:
            haze: Particles, or None.
            ground: A reflecting ground, or None: black.
            surface_pressure: At the ground [Pa], 0 to 200,000.
            ozone_dobson: Vertical amount of ozone [Dobson units], 0 to 1000. It confines the
                wavelengths to 380 to 780 nm, and every one of them is computed unless the plan says
                otherwise; None: no ozone, 200 to 3000 nm, interpolated between a few nodes where
                all else is smooth.
            geometry: As the attribute.

        Raises:
            ValueError: A value lies outside its range.
        """
        return cls(
            Molecules.standard(surface_pressure),
            haze,
            () if ozone_dobson is None else (Absorber.ozone(ozone_dobson),),
            ground,
            geometry=geometry,
            preset="standard",
        )

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
    def latest_sun(self) -> float:
        """Largest solar zenith angle that the geometry serves [rad]."""
        round_planet = self.geometry in ("spherical", "pseudo-spherical")
        return LATEST_SUN if round_planet else math.pi / 2

    @property
    def is_smooth(self) -> bool:
        """Whether log radiance may be interpolated between a few wavelengths.

        Every spectrum must promise to be smooth, and nothing may absorb.
        """
        parts = [part for part in (self.molecules, self.haze) if part is not None]
        albedo = None if self.ground is None else self.ground.albedo
        return not self.absorbers and all_smooth(albedo) and all(part.is_smooth for part in parts)
