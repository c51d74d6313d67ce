"""Clear skies as every radiative-transfer code can be told of them."""

import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

ABSORBER_CENTRE, ABSORBER_WIDTH = 22e3, 5e3  # [m]
JUDGED_SUNS = np.radians([0.0, 40.0, 80.0, 87.0])
JUDGED_STEP = 5  # of 380 to 780 nm by 10 nm both ends are kept
_FINE = 20_001  # altitudes on which edges are sought


@dataclasses.dataclass(frozen=True)
class Scene:
    """A batch of skies over one ground, and where to look; every sun meets every haze load.

    Attributes:
        solar_zenith_angle: [sun], rad, up to π/2, below it in a flat atmosphere.
        view_zenith_angle: [ring], rad, below π/2; the observer stands on the ground and looks up.
        relative_azimuth: [azimuth], rad, 0 toward the sun.
        wavelength_nm: [wavelength].
        molecules_optical_depth: [wavelength]; phase function without depolarisation.
        haze_optical_depth: [load, wavelength].
        absorber_optical_depth: [wavelength]; a Gaussian around 22 km, 5 km wide.
        asymmetry: Of the haze's Henyey-Greenstein phase function.
        single_scattering_albedo: Of the haze.
        ground_albedo: Of a Lambertian ground.
        molecules_scale_height: [m].
        haze_scale_height: [m].
        top: Nothing is above this altitude [m]; the optical depths lie below it.
        radius: Of the planet [m], where a code knows of it.
    """

    solar_zenith_angle: np.ndarray
    view_zenith_angle: np.ndarray
    relative_azimuth: np.ndarray
    wavelength_nm: np.ndarray
    molecules_optical_depth: np.ndarray
    haze_optical_depth: np.ndarray
    absorber_optical_depth: np.ndarray
    asymmetry: float = 0.76
    single_scattering_albedo: float = 1.0
    ground_albedo: float = 0.0
    molecules_scale_height: float = 8.8e3
    haze_scale_height: float = 1.2e3
    top: float = 100e3
    radius: float = 6371e3

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        loads, wavelengths = self.haze_optical_depth.shape
        for name in ("wavelength_nm", "molecules_optical_depth", "absorber_optical_depth"):
            found = getattr(self, name).shape
            if found != (wavelengths,):
                raise ValueError(f"{name} must have shape ({wavelengths},), got {found}")
        if loads < 1:
            raise ValueError("haze_optical_depth must hold at least one load, got 0")

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Of the radiance: suns, loads, rings, azimuths, wavelengths."""
        rings, azimuths = self.view_zenith_angle.size, self.relative_azimuth.size
        loads, wavelengths = self.haze_optical_depth.shape
        return self.solar_zenith_angle.size, loads, rings, azimuths, wavelengths

    @property
    def sky_count(self) -> int:
        """Suns times loads."""
        return self.shape[0] * self.shape[1]

    @property
    def optical_depths(self) -> np.ndarray:
        """Of molecules, haze and absorber, [constituent, load * wavelength]."""
        molecules, absorber = (
            np.broadcast_to(one, self.haze_optical_depth.shape)
            for one in (self.molecules_optical_depth, self.absorber_optical_depth)
        )
        return np.stack([molecules.ravel(), self.haze_optical_depth.ravel(), absorber.ravel()])

    @property
    def absorbs(self) -> bool:
        """Whether there is an absorber."""
        return bool(np.any(self.absorber_optical_depth > 0))

    def moment_count(self, at_least: int) -> int:
        """How many Legendre moments hold the haze's phase function, in its peak, to 1e-9."""
        moments = np.arange(4096.0)
        rest = (2 * moments + 1) * abs(self.asymmetry) ** moments / (1 - abs(self.asymmetry))
        return max(at_least, 3, int(np.argmax(rest < 1e-9)))

    def moments(self, count: int) -> np.ndarray:
        """Legendre moments of molecules and haze, 1 first, [constituent, count]."""
        molecules = np.zeros(count)
        molecules[[0, 2]] = 1.0, 0.1
        return np.stack([molecules, self.asymmetry ** np.arange(count)])

    def column_below(self, altitude: np.ndarray) -> np.ndarray:
        """Share of each constituent's column below some altitudes, [constituent, altitude]."""
        heights = self.molecules_scale_height, self.haze_scale_height
        shares = [np.expm1(-altitude / h) / math.expm1(-self.top / h) for h in heights]
        return np.stack([*shares, _gaussian_share(altitude, self.top)])

    def density(self, altitude: np.ndarray) -> np.ndarray:
        """Slope of `column_below` [1/m], [constituent, altitude]."""
        heights = self.molecules_scale_height, self.haze_scale_height
        shares = [np.exp(-altitude / h) / (-math.expm1(-self.top / h) * h) for h in heights]
        z = (altitude - ABSORBER_CENTRE) / ABSORBER_WIDTH
        whole = _gaussian(self.top) - _gaussian(0.0)
        gaussian = np.exp(-0.5 * z**2) / (math.sqrt(2 * math.pi) * ABSORBER_WIDTH * whole)
        return np.stack([*shares, gaussian])

    def edges(self, count: int, power: float = 1.0) -> np.ndarray:
        """Altitudes that bound so many layers, the ground first [m].

        Args:
            count: Of layers.
            power: Each layer holds the same share, averaged over the constituents that are there,
                of the integral of the density to this power. With 1 all layers are as thick
                optically, with less the upper ones are thinner.
        """
        altitude = np.geomspace(1.0, 1.0 + self.top, _FINE) - 1.0
        present = self.optical_depths.max(axis=1) > 0
        slope = self.density(altitude)[present] ** power
        middle = 0.5 * (slope[:, 1:] + slope[:, :-1]) * np.diff(altitude)
        share = np.cumsum(middle, axis=1)
        share = np.append(0.0, (share / share[:, -1:]).mean(axis=0))
        edges = np.interp(np.linspace(0.0, 1.0, count + 1), share, altitude)
        edges[[0, -1]] = 0.0, self.top
        return edges


@dataclasses.dataclass(frozen=True)
class Skies:
    """What a code found.

    Attributes:
        radiance: Over solar irradiance [1/sr], [sun, load, ring, azimuth, wavelength].
        seconds_per_sky: Wall clock, the setting up included; a sky is one sun over one load.
        compile_seconds: Before the first sky, where a program is compiled; not in the above.
    """

    radiance: np.ndarray
    seconds_per_sky: float
    compile_seconds: float = 0.0


def median_seconds(run: Callable[[], object], repeats: int, patience: float) -> float:
    """Wall clock of a call that has been made before.

    Args:
        run: The call.
        repeats: Calls of which the median is taken, after one that does not count.
        patience: No further call is made once they took so many seconds together; if that is
            after the first already, it counts.
    """
    times: list[float] = []
    while len(times) < 1 + repeats and (not times or sum(times) < patience):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return statistics.median(times[1:] or times)


def reference_batch() -> Scene:
    """60 skies of the comparison: 12 suns, 5 loads, 342 directions, 41 wavelengths."""
    wavelength_nm = np.linspace(380.0, 780.0, 41)
    loads = np.array([0.05, 0.1, 0.2, 0.3, 0.5])  # at 550 nm
    return Scene(
        np.radians([*range(0, 81, 8), 87]),
        np.radians([*range(5, 86, 5), 89]),
        np.radians(np.arange(0, 181, 10)),
        wavelength_nm,
        0.0973 * (550 / wavelength_nm) ** 4,
        loads[:, None] * (550 / wavelength_nm) ** 1.3,
        np.zeros_like(wavelength_nm),
    )


def few_skies(scene: Scene, count: int) -> Scene:
    """About so many skies, with few suns before few loads: a sun's geometry serves all its loads.

    The last sun and the last load are always among them; of several skies two suns.

    Raises:
        ValueError: Fewer than one sky.
    """
    if count < 1:
        raise ValueError(f"skies must be at least 1, got {count}")
    suns, loads = scene.shape[:2]
    wanted_suns = min(suns, max(math.ceil(count / loads), min(count, 2)))
    wanted_loads = min(loads, max(1, round(count / wanted_suns)))
    return some_skies(scene, _spread(suns, wanted_suns), _spread(loads, wanted_loads))


def some_skies(
    scene: Scene,
    suns: Sequence[int],
    loads: Sequence[int],
    wavelengths: Sequence[int] | None = None,
) -> Scene:
    """Some suns over some loads at some or all wavelengths, by their places."""
    kept = slice(None) if wavelengths is None else list(wavelengths)
    return dataclasses.replace(
        scene,
        solar_zenith_angle=scene.solar_zenith_angle[list(suns)],
        wavelength_nm=scene.wavelength_nm[kept],
        molecules_optical_depth=scene.molecules_optical_depth[kept],
        haze_optical_depth=scene.haze_optical_depth[list(loads)][:, kept],
        absorber_optical_depth=scene.absorber_optical_depth[kept],
    )


def judged(scene: Scene) -> tuple[list[int], list[int], list[int]]:
    """Places of the suns, loads and wavelengths that errors are taken in: few, with the extremes.

    The finest settings of some codes take half a minute for a sky at every wavelength.
    """
    suns = scene.solar_zenith_angle
    nearest = {int(np.abs(suns - sun).argmin()) for sun in JUDGED_SUNS}
    wavelengths = range(0, scene.wavelength_nm.size, JUDGED_STEP)
    return sorted(nearest), sorted({0, scene.shape[1] - 1}), list(wavelengths)


def _spread(count: int, wanted: int) -> list[int]:
    """So many of the places below a count, evenly, the last among them."""
    return (count - 1 - np.arange(wanted) * count // wanted)[::-1].tolist()


def _gaussian(altitude: float) -> float:
    return 0.5 * math.erf((altitude - ABSORBER_CENTRE) / (ABSORBER_WIDTH * math.sqrt(2)))


def _gaussian_share(altitude: np.ndarray, top: float) -> np.ndarray:
    below = np.array([_gaussian(z) for z in altitude.tolist()])
    low, high = _gaussian(0.0), _gaussian(top)
    return (below - low) / (high - low)
