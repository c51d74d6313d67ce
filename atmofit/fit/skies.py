"""The skies that a sky model is fitted to: a table over turbidity and sun, simulated."""

import dataclasses
import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, in_range
from atmofit.colour import spectrum_to_xyY
from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.geometry import Directions, dome_343
from atmofit.optics.atmosphere import GEOMETRIES, Atmosphere
from atmofit.sky.plan import Plan, plan_sky
from atmofit.sky.simulate import solve_sky

QUANTITIES = ("x", "y", "Y")
Progress = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class RefitSettings:
    """All that a refit depends on.

    Attributes:
        turbidity: At least three different values, 1 to 64.
        solar_zenith_angle_deg: At least four different values, 0 to 90 [degree].
        wavelength_nm: 380 to 780 [nm].
        orders: Scattering orders simulated.
        rtol: Promised relative error of the simulation.
        geometry: Of the atmosphere.
        dtype: Of the simulation; the fits are always in float64.
        weighting: Of luminance in the fits; chromaticities are weighted absolutely.
    """

    turbidity: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0)
    solar_zenith_angle_deg: tuple[float, ...] = (*(8.0 * k for k in range(11)), 87.0)
    wavelength_nm: tuple[float, ...] = tuple(float(λ) for λ in range(380, 781, 10))
    orders: int = 2
    rtol: float = 1e-2
    geometry: str = "spherical"
    dtype: str = "float32"
    weighting: str = "relative"

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done."""
        in_range("turbidity", self.turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY)
        in_range("suns", self.solar_zenith_angle_deg, 0.0, 90.0, "degree")
        in_range("wavelength_nm", self.wavelength_nm, 380.0, 780.0, "nm")
        for name, values, least in (
            ("turbidity", self.turbidity, 3),
            ("suns", self.solar_zenith_angle_deg, 4),
            ("wavelength_nm", self.wavelength_nm, 2),
        ):
            if len(set(values)) < max(least, len(values)):
                raise ValueError(
                    f"{name} must hold at least {least} values, all different, got {values}"
                )
        choice("geometry", self.geometry, GEOMETRIES)
        choice("dtype", self.dtype, ("float32", "float64"))
        choice("weighting", self.weighting, ("relative", "absolute", "log"))
        self.plan()

    def plan(self) -> Plan:
        """How each sky is computed."""
        atmosphere = Atmosphere.from_turbidity(self.turbidity[0], self.geometry)
        return plan_sky(atmosphere, orders=self.orders, rtol=self.rtol, dtype=self.dtype)

    @property
    def solar_zenith_angle(self) -> np.ndarray:
        """The suns [rad]."""
        return np.radians(self.solar_zenith_angle_deg)


@dataclasses.dataclass(frozen=True)
class SimulatedSkies:
    """Skies over a table of turbidities and suns.

    Attributes:
        settings: What was simulated.
        directions: The dome.
        radiance: [turbidity, sun, direction, wavelength], W m^-2 sr^-1 nm^-1.
        xyY: [turbidity, sun, direction, 3]; Y in cd m^-2.
        seconds: Of each stage; the first run of a program includes its compilation.
    """

    settings: RefitSettings
    directions: Directions
    radiance: np.ndarray
    xyY: np.ndarray
    seconds: dict[str, float]

    def quantity(self, name: str) -> np.ndarray:
        """One of x, y and Y, [turbidity, sun, direction]."""
        return self.xyY[..., QUANTITIES.index(name)]

    @property
    def zenith(self) -> np.ndarray:
        """x, y and Y at the zenith, [turbidity, sun, 3]; the dome's first direction is it."""
        return self.xyY[:, :, 0]


class Clock:
    """Seconds of each stage, told to a progress bar as it begins."""

    def __init__(self, progress: Progress | None) -> None:
        """Begin with no stage timed; `progress` is called with each stage's name."""
        self.seconds: dict[str, float] = {}
        self._progress = progress

    def stage(self, name: str) -> "_Stage":
        """A context in which the named stage runs."""
        if self._progress is not None:
            self._progress(name)
        return _Stage(self, name)


class _Stage:
    """Context in which a stage runs."""

    def __init__(self, clock: Clock, name: str) -> None:
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._clock.seconds[self._name] = time.perf_counter() - self._begin


def simulate_skies(
    settings: RefitSettings | None = None, clock: Clock | None = None
) -> SimulatedSkies:
    """Simulate the skies of a refit."""
    settings = settings or RefitSettings()
    clock = clock or Clock(None)
    with jax.enable_x64(True):
        directions = dome_343()
        arguments = (
            jnp.asarray(settings.turbidity),
            jnp.asarray(settings.solar_zenith_angle),
            jnp.asarray(settings.wavelength_nm),
        )
        with clock.stage("simulation"):
            radiance = _simulate(*arguments, directions, settings.plan(), settings.geometry)
            radiance.block_until_ready()
        with clock.stage("colour"):
            xyY = spectrum_to_xyY(radiance.astype(float), arguments[2])
            xyY.block_until_ready()
    return SimulatedSkies(
        settings, directions, np.asarray(radiance), np.asarray(xyY), dict(clock.seconds)
    )


@eqx.filter_jit
def _simulate(
    turbidity: jax.Array,
    suns: jax.Array,
    wavelength_nm: jax.Array,
    directions: Directions,
    plan: Plan,
    geometry: str,
) -> jax.Array:
    """Radiance, [turbidity, sun, direction, wavelength]."""

    def of_turbidity(T: jax.Array) -> jax.Array:
        field = solve_sky(Atmosphere.from_turbidity(T, geometry), wavelength_nm, plan=plan)
        return jax.vmap(lambda sun: field.radiance(sun, directions))(suns)

    return jax.vmap(of_turbidity)(turbidity)
