"""The skies that a sky model is fitted to: a table over turbidity and sun, simulated."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, in_range
from atmofit.colour import spectrum_to_xyY
from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.fit.pieces import Pieces, simulation_key
from atmofit.geometry import HORIZON, Directions, dome_343
from atmofit.optics.atmosphere import GEOMETRIES, Atmosphere
from atmofit.sky.field import SkyField
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import solve_sky

QUANTITIES = ("x", "y", "Y")
FIT_SETTINGS = ("weighting", "starts", "seed")  # the simulation does not depend on them
SUNS_IN_BLOCK = 4
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
        starts: Random starts from which each fit is searched for again, see
            `identify_distribution`; 0: none, and identifiability is not looked at.
        seed: Of the random starts.
    """

    turbidity: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0)
    solar_zenith_angle_deg: tuple[float, ...] = (*(8.0 * k for k in range(11)), 87.0)
    wavelength_nm: tuple[float, ...] = tuple(float(λ) for λ in range(380, 781, 10))
    orders: int = 2
    rtol: float = 1e-2
    geometry: str = "spherical"
    dtype: str = "float32"
    weighting: str = "relative"
    starts: int = 64
    seed: int = 0

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
        in_range("starts", self.starts, 0.0, 1e4)
        in_range("seed", self.seed, 0.0, 2.0**31)
        self.plan()

    def plan(self) -> Plan:
        """How each sky is computed."""
        atmosphere = Atmosphere.from_turbidity(self.turbidity[0], self.geometry)
        # For all suns by day, so that no sky depends on which others are asked for.
        return plan_sky(
            atmosphere,
            solar_zenith_angle=np.append([0.0, HORIZON], self.solar_zenith_angle),
            orders=self.orders,
            rtol=self.rtol,
            dtype=self.dtype,
        )

    @property
    def solar_zenith_angle(self) -> np.ndarray:
        """The suns [rad]."""
        return np.radians(self.solar_zenith_angle_deg)

    @property
    def simulated(self) -> dict[str, Any]:
        """The settings on which the simulation depends, and what they make of its plan."""
        plan = {"plan": dataclasses.asdict(self.plan())}
        every = dataclasses.asdict(self)
        return {k: v for k, v in every.items() if k not in FIT_SETTINGS} | plan

    @property
    def sun_blocks(self) -> list[np.ndarray]:
        """Which suns are simulated together; those that fill up the last block are repeated."""
        count = len(self.solar_zenith_angle_deg)
        starts = range(0, count, SUNS_IN_BLOCK)
        return [np.minimum(np.arange(i, i + SUNS_IN_BLOCK), count - 1) for i in starts]

    @property
    def piece_count(self) -> int:
        """How many pieces the simulation has: each is one turbidity and one block of suns."""
        return len(self.turbidity) * len(self.sun_blocks)

    def weighting_of(self, quantity: str) -> str:
        """How x, y or Y is weighted in the fits."""
        return self.weighting if quantity == "Y" else "absolute"


@dataclasses.dataclass(frozen=True)
class SimulatedSkies:
    """Skies over a table of turbidities and suns.

    Attributes:
        settings: What was simulated.
        directions: The dome.
        radiance: [turbidity, sun, direction, wavelength], W m^-2 sr^-1 nm^-1.
        xyY: [turbidity, sun, direction, 3]; Y in cd m^-2.
        seconds: Of each stage; the first run of a program includes its compilation.
        pieces_read: Pieces that an earlier run had finished.
    """

    settings: RefitSettings
    directions: Directions
    radiance: np.ndarray
    xyY: np.ndarray
    seconds: dict[str, float]
    pieces_read: int = 0

    def quantity(self, name: str) -> np.ndarray:
        """One of x, y and Y, [turbidity, sun, direction]."""
        return self.xyY[..., QUANTITIES.index(name)]

    @property
    def zenith(self) -> np.ndarray:
        """x, y and Y at the zenith, [turbidity, sun, 3]; the dome's first direction is it."""
        return self.xyY[:, :, 0]

    def under(self, settings: RefitSettings) -> "SimulatedSkies":
        """The same skies under settings that differ in the fits only.

        Raises:
            ValueError: A setting differs from what was simulated.
        """
        for field in dataclasses.fields(settings):
            simulated, asked = (getattr(s, field.name) for s in (self.settings, settings))
            if field.name not in FIT_SETTINGS and simulated != asked:
                raise ValueError(
                    f"{field.name} must be that of the given skies, {simulated!r}, got {asked!r}"
                )
        return dataclasses.replace(self, settings=settings)


class Clock:
    """Seconds of each stage, told to a progress bar as it begins."""

    def __init__(self, progress: Progress | None) -> None:
        """Begin with no stage timed; `progress` is called with each stage's name."""
        self.seconds: dict[str, float] = {}
        self._progress = progress

    def stage(self, name: str) -> "_Stage":
        """A context in which the named stage runs."""
        self.tell(name)
        return _Stage(self, name)

    def tell(self, text: str) -> None:
        """Let the progress bar show a text."""
        if self._progress is not None:
            self._progress(text)


class _Stage:
    """Context in which a stage runs."""

    def __init__(self, clock: Clock, name: str) -> None:
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._clock.seconds[self._name] = time.perf_counter() - self._begin


def simulate_skies(
    settings: RefitSettings | None = None,
    clock: Clock | None = None,
    pieces: str | Path | None = None,
) -> SimulatedSkies:
    """Simulate the skies of a refit.

    Args:
        settings: What to simulate; None: the reference job.
        clock: Told of each stage and each piece.
        pieces: Folder in which every finished piece (one turbidity, a block of suns) is kept, and
            from which those of an earlier run are taken; the result is the same to the last bit.
            A damaged piece is named in a warning and computed again. None: nothing is written.

    Returns:
        The skies.

    Raises:
        ValueError: The folder of the pieces cannot be made or written.
        OSError: A piece cannot be written.
    """
    settings = settings or RefitSettings()
    clock = clock or Clock(None)
    with jax.enable_x64(True):
        directions = dome_343()
        kept = None if pieces is None else Pieces.open(pieces, simulation_key(settings.simulated))
        with clock.stage("simulation"):
            radiance, read = _simulate(settings, directions, kept, clock)
        with clock.stage("colour"):
            wavelength_nm = np.asarray(settings.wavelength_nm)
            xyY = np.asarray(spectrum_to_xyY(radiance.astype(float), wavelength_nm))
    return SimulatedSkies(settings, directions, radiance, xyY, dict(clock.seconds), read)


def _simulate(
    settings: RefitSettings, directions: Directions, kept: Pieces | None, clock: Clock
) -> tuple[np.ndarray, int]:
    """Radiance [turbidity, sun, direction, wavelength], and how many pieces were read."""
    blocks, total = settings.sun_blocks, settings.piece_count
    done = {} if kept is None else _finished(settings, kept, clock)
    read = len(done)
    wavelength_nm = jnp.asarray(settings.wavelength_nm)
    for i, T in enumerate(settings.turbidity):
        missing = [j for j in range(len(blocks)) if (i, j) not in done]
        if not missing:
            continue
        # Of all suns; done once for the blocks of a turbidity.
        field = _solve(jnp.asarray(T), wavelength_nm, settings.plan(), settings.geometry)
        for j in missing:
            clock.tell(f"piece {len(done) + 1} of {total}")
            suns = jnp.asarray(settings.solar_zenith_angle[blocks[j]])
            done[i, j] = np.asarray(_look(field, suns, directions))
            if kept is not None:
                kept.write(_piece_name(i, j), done[i, j])
    rows = [
        np.concatenate([done[i, j] for j in range(len(blocks))])
        for i in range(len(settings.turbidity))
    ]
    return np.stack(rows)[:, : len(settings.solar_zenith_angle_deg)], read


def _finished(
    settings: RefitSettings, kept: Pieces, clock: Clock
) -> dict[tuple[int, int], np.ndarray]:
    """The pieces that an earlier run finished, by turbidity and block of suns."""
    found: dict[tuple[int, int], np.ndarray] = {}
    for i in range(len(settings.turbidity)):
        for j in range(len(settings.sun_blocks)):
            values = kept.read(_piece_name(i, j))
            if values is not None:
                found[i, j] = values
                clock.tell(f"piece {len(found)} found")
    return found


def _piece_name(turbidity: int, block: int) -> str:
    return f"turbidity{turbidity}-suns{block}"


@eqx.filter_jit
def _solve(T: jax.Array, wavelength_nm: jax.Array, plan: Plan, geometry: str) -> SkyField:
    """The light inside the air of one turbidity."""
    return solve_sky(Atmosphere.from_turbidity(T, geometry), wavelength_nm, plan=plan)


@eqx.filter_jit
def _look(field: SkyField, suns: jax.Array, directions: Directions) -> jax.Array:
    """Radiance, [sun, direction, wavelength]."""
    return jax.vmap(lambda sun: field.radiance(sun, directions))(suns)
