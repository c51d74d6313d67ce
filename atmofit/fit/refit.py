"""The paper's work done again: simulate many skies, fit the sky model to them, compare.

One call of `refit` goes the whole way; `compare` holds any model against the simulated skies.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, in_range
from atmofit.colour import spectrum_to_xyY
from atmofit.constants import MAXIMUM_TURBIDITY, MINIMUM_TURBIDITY
from atmofit.fit.distribution import DistributionFit, PerezFit, fit_distribution, fit_perez
from atmofit.fit.zenith import ZenithFit, fit_zenith_chromaticity, fit_zenith_luminance
from atmofit.geometry import Directions, dome_343
from atmofit.models.preetham import PREETHAM_1999, PreethamModel
from atmofit.optics.atmosphere import GEOMETRIES, Atmosphere
from atmofit.sky.plan import Plan, plan_sky
from atmofit.sky.simulate import solve_sky

if TYPE_CHECKING:
    import xarray

QUANTITIES = ("x", "y", "Y")
_Fit = TypeVar("_Fit")
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


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A model against simulated skies; every array is [turbidity, sun].

    NaN where the model is not valid.

    Attributes:
        name: Of the model.
        luminance_ratio: Mean over the dome of model / simulation.
        luminance_rms: Root mean square of model / simulation - 1.
        zenith_luminance_ratio: Model / simulation at the zenith.
        x_mean, x_rms: Mean and root mean square of model - simulation.
        y_mean, y_rms: Likewise.
    """

    name: str
    luminance_ratio: np.ndarray
    luminance_rms: np.ndarray
    zenith_luminance_ratio: np.ndarray
    x_mean: np.ndarray
    x_rms: np.ndarray
    y_mean: np.ndarray
    y_rms: np.ndarray

    def summary(self) -> dict[str, float]:
        """Every array over its valid cells: the ratios' means, the rms of the others."""
        out = {}
        for field in dataclasses.fields(self)[1:]:
            values = getattr(self, field.name)
            valid = values[np.isfinite(values)]
            mean = valid.mean() if valid.size else math.nan
            rms = np.sqrt((valid**2).mean()) if valid.size else math.nan
            out[field.name] = float(rms if field.name.endswith("rms") else mean)
        return out


@dataclasses.dataclass(frozen=True)
class RefitResult:
    """A sky model fitted to simulated skies.

    Attributes:
        model: The regenerated model, valid inside the turbidities of the settings.
        skies: What it was fitted to.
        distributions: Joint fits of "x", "y" and "Y".
        zeniths: Fits of the zenith values of "x", "y" and "Y".
        single_skies: Perez fits to each sky alone, [turbidity, sun].
        comparisons: Of the published and of the regenerated model.
        seconds: Of each stage.
    """

    model: PreethamModel
    skies: SimulatedSkies
    distributions: Mapping[str, DistributionFit]
    zeniths: Mapping[str, ZenithFit]
    single_skies: Mapping[str, PerezFit]
    comparisons: tuple[Comparison, ...]
    seconds: dict[str, float]

    @property
    def residuals(self) -> np.ndarray:
        """Model minus simulation, x, y and Y [cd m^-2], [turbidity, sun, direction, 3]."""
        return predict(self.model, self.skies) - self.skies.xyY

    @property
    def covariance(self) -> dict[str, np.ndarray]:
        """Covariance of each joint fit's ten coefficients, row by row."""
        return {q: np.asarray(fit.covariance) for q, fit in self.distributions.items()}

    @property
    def converged(self) -> bool:
        """Whether every fit did."""
        fits = [*self.distributions.values(), *self.single_skies.values()]
        return all(bool(np.all(np.asarray(fit.converged))) for fit in fits)

    @property
    def dataset(self) -> "xarray.Dataset":
        """Simulated skies, residuals and units as an xarray dataset."""
        from atmofit.io import to_dataset

        return to_dataset(self)


def refit(
    settings: RefitSettings | None = None, *, progress: Progress | None = None, **changes: Any
) -> RefitResult:
    """Simulate skies and fit the model of the 1999 paper to them.

    Args:
        settings: What to do; None: the reference job.
        progress: Called with the name of each stage as it begins.
        **changes: Settings by name that differ from `settings`.

    Returns:
        The model, its fits with standard errors, the skies and the comparisons.

    Raises:
        ValueError: A setting lies outside its range.
    """
    settings = dataclasses.replace(settings or RefitSettings(), **changes)
    with jax.enable_x64(True):
        clock = _Clock(progress)
        skies = simulate_skies(settings, clock)
        return _fit(skies, clock)


def simulate_skies(
    settings: RefitSettings | None = None, clock: "_Clock | None" = None
) -> SimulatedSkies:
    """Simulate the skies of a refit."""
    settings = settings or RefitSettings()
    clock = clock or _Clock(None)
    directions = dome_343()
    with jax.enable_x64(True):
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


def _fit(skies: SimulatedSkies, clock: "_Clock") -> RefitResult:
    """All fits and both comparisons."""
    s = skies.settings
    axes = (skies.directions, s.solar_zenith_angle, np.asarray(s.turbidity))
    weighting = {"x": "absolute", "y": "absolute", "Y": s.weighting}
    with clock.stage("joint fits"):
        joint = {
            q: fit_distribution(*axes, skies.quantity(q), weighting=weighting[q])
            for q in QUANTITIES
        }
        joint = _to_numpy(joint)
    with clock.stage("zenith fits"):
        table = (axes[2], axes[1])
        zeniths = {
            "x": fit_zenith_chromaticity(*table, skies.zenith[..., 0], weighting="absolute"),
            "y": fit_zenith_chromaticity(*table, skies.zenith[..., 1], weighting="absolute"),
            "Y": fit_zenith_luminance(*table, skies.zenith[..., 2]),
        }
        zeniths = _to_numpy(zeniths)
    with clock.stage("single skies"):
        single = {
            q: fit_perez(axes[0], axes[1], skies.quantity(q), weighting=weighting[q])
            for q in QUANTITIES
        }
        single = _to_numpy(single)
    model = PreethamModel(
        x_distribution=joint["x"].matrix,
        y_distribution=joint["y"].matrix,
        luminance_distribution=joint["Y"].matrix,
        zenith_x=zeniths["x"].coefficients,
        zenith_y=zeniths["y"].coefficients,
        zenith_luminance=zeniths["Y"].coefficients,
        turbidity_range=(min(s.turbidity), max(s.turbidity)),
    )
    with clock.stage("comparison"):
        comparisons = (
            compare(PREETHAM_1999, skies, "published"),
            compare(model, skies, "regenerated"),
        )
    return RefitResult(model, skies, joint, zeniths, single, comparisons, dict(clock.seconds))


def _to_numpy(fits: dict[str, _Fit]) -> dict[str, _Fit]:
    """The fits with NumPy arrays, which stay float64 whatever JAX's default is."""
    return jax.tree.map(np.asarray, fits)


def predict(model: PreethamModel, skies: SimulatedSkies) -> np.ndarray:
    """What a model says of the simulated skies, x, y and Y; NaN outside its turbidities.

    Returns:
        [turbidity, sun, direction, 3], Y in cd m^-2.
    """
    turbidity, suns = (
        jnp.asarray(axis, float)
        for axis in (skies.settings.turbidity, skies.settings.solar_zenith_angle)
    )
    return np.asarray(_predict(model, turbidity, suns, skies.directions))


@eqx.filter_jit
def _predict(
    model: PreethamModel, turbidity: jax.Array, suns: jax.Array, directions: Directions
) -> jax.Array:
    over_suns = jax.vmap(lambda T, sun: model(T, sun, directions), (None, 0))
    return jax.vmap(over_suns, (0, None))(turbidity, suns)


def compare(model: PreethamModel, skies: SimulatedSkies, name: str) -> Comparison:
    """Hold a model against simulated skies."""
    with jax.enable_x64(True):
        difference = predict(model, skies)
    ratio = difference[..., 2] / skies.quantity("Y")
    x, y = (difference[..., k] - skies.xyY[..., k] for k in range(2))

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt((values**2).mean(-1))

    return Comparison(
        name, ratio.mean(-1), rms(ratio - 1), ratio[..., 0], x.mean(-1), rms(x), y.mean(-1), rms(y)
    )


class _Clock:
    """Seconds of each stage, told to a progress bar as it begins."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    def stage(self, name: str) -> "_Stage":
        if self._progress is not None:
            self._progress(name)
        return _Stage(self, name)


class _Stage:
    """Context in which a stage runs."""

    def __init__(self, clock: _Clock, name: str) -> None:
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._clock.seconds[self._name] = time.perf_counter() - self._begin
