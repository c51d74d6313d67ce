"""The skies that a sky model is fitted to: all orders, ozone, ground, down to twilight."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, refuse_beyond
from atmofit.colour import spectrum_to_XYZ
from atmofit.fit.pieces import Pieces, simulation_key
from atmofit.fit.skies import Clock, Progress
from atmofit.fit.sky_model import PRIOR_STRENGTH, STARTS, SkyModelFit, fit_sky_model
from atmofit.geometry import Directions, dome_343
from atmofit.models.dependence import Basis, Dependence
from atmofit.models.shapes import AUREOLE
from atmofit.models.sky_model import COLOURS, AnyShape, SkyModel
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.continental import continental_air
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import solve_sky
from atmofit.sun import solar_irradiance_spectrum
from atmofit.typing import Reals, Scalar

_COLOUR_NM = np.arange(380.0, 781.0, 10.0)  # at which X, Y and Z are integrated
_SUNS_AT_ONCE = 4


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """All that a training set depends on.

    The air is that of `continental_air`.

    Attributes:
        turbidity: Optical depth of air with haze over that of air alone at 550 nm, 1.001 to 64.
        solar_zenith_angle_deg: 0 to 96 [degree].
        albedo: Of a grey ground, 0 to 1.
        wavelength_nm: Of the spectral channels, 350 to 830 [nm].
        ozone_dobson: Vertical amount of ozone [DU].
        angstrom_exponent, single_scattering_albedo, asymmetry: Of the haze.
        rtol: Promised relative error of the simulation; all orders are simulated.
        dtype: Of the simulation; fits are always in float64.
    """

    turbidity: tuple[float, ...] = (1.2, 1.5, 1.9, 2.5, 3.3, 4.5, 6.5, 10.0)
    solar_zenith_angle_deg: tuple[float, ...] = (
        *(10.0 * k for k in range(7)), 68.0, 75.0, 80.0, 84.0, 87.0, 89.0, 90.0, 91.0, 92.0
    )  # fmt: skip
    albedo: tuple[float, ...] = (0.0, 0.2, 0.8)
    wavelength_nm: tuple[float, ...] = tuple(float(λ) for λ in range(360, 821, 20))
    ozone_dobson: float = 300.0
    angstrom_exponent: float = 1.3
    single_scattering_albedo: float = 0.925
    asymmetry: float = 0.703
    rtol: float = 1e-2
    dtype: str = "float32"

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done."""
        refuse_beyond("turbidity", self.turbidity, 1.001, 64.0)
        refuse_beyond("suns", self.solar_zenith_angle_deg, 0.0, 96.0, "degree")
        refuse_beyond("albedo", self.albedo, 0.0, 1.0)
        refuse_beyond("wavelength_nm", self.wavelength_nm, 350.0, 830.0, "nm")
        refuse_beyond("ozone_dobson", self.ozone_dobson, 0.0, 1e3, "DU")
        refuse_beyond("angstrom_exponent", self.angstrom_exponent, -5.0, 5.0)
        refuse_beyond("single_scattering_albedo", self.single_scattering_albedo, 0.0, 1.0)
        refuse_beyond("asymmetry", self.asymmetry, -0.9, 0.9)
        choice("dtype", self.dtype, ("float32", "float64"))
        for name in ("turbidity", "solar_zenith_angle_deg", "albedo", "wavelength_nm"):
            values = getattr(self, name)
            if not values or list(values) != sorted(set(values)):
                raise ValueError(f"{name} must be an increasing list that is not empty: {values}")

    @property
    def all_wavelength_nm(self) -> np.ndarray:
        """Those of the channels and those that colours need [nm]."""
        return np.unique(np.concatenate([self.wavelength_nm, _COLOUR_NM]))

    def atmosphere(self, turbidity: Scalar, albedo: Scalar) -> Atmosphere:
        """The air of one turbidity over a ground."""
        return continental_air(
            turbidity,
            albedo,
            self.ozone_dobson,
            self.angstrom_exponent,
            self.single_scattering_albedo,
            self.asymmetry,
        )

    def plan(self) -> Plan:
        """How each sky is computed."""
        return plan_sky(
            self.atmosphere(jnp.asarray(self.turbidity[0]), jnp.asarray(self.albedo[0])),
            solar_zenith_angle=np.radians([0.0, self.solar_zenith_angle_deg[-1]]),
            orders="all",
            rtol=self.rtol,
            all_wavelengths=True,
            dtype=self.dtype,
        )

    def radiance(
        self, plan: Plan, directions: Directions, turbidity: Scalar, albedo: Scalar
    ) -> Reals:
        """Over the sun's irradiance, [sun, direction, wavelength of `all_wavelength_nm`], sr^-1."""
        λ = jnp.asarray(self.all_wavelength_nm)
        field = solve_sky(self.atmosphere(turbidity, albedo), λ, plan=plan)
        suns = jnp.radians(jnp.asarray(self.solar_zenith_angle_deg))
        look = lambda sun: field.radiance(sun, directions, 1.0)  # noqa: E731
        return jax.lax.map(look, suns, batch_size=_SUNS_AT_ONCE)

    def XYZ(self, radiance: Reals | np.ndarray) -> Reals:
        """Colours under the standard sun, [..., 3], cd m^-2, of [..., `all_wavelength_nm`]."""
        chosen = radiance[..., np.searchsorted(self.all_wavelength_nm, _COLOUR_NM)].astype(float)
        sun = solar_irradiance_spectrum("standard")(_COLOUR_NM).astype(float)
        return spectrum_to_XYZ(chosen * sun.reshape((1,) * (chosen.ndim - 1) + (-1,)), _COLOUR_NM)

    @property
    def simulated(self) -> dict[str, Any]:
        """The settings, and what they make of the plan."""
        return dataclasses.asdict(self) | {"plan": dataclasses.asdict(self.plan())}


@dataclasses.dataclass(frozen=True)
class TrainingSkies:
    """Skies over a table of turbidities, albedos and suns.

    Attributes:
        settings: What was simulated.
        directions: The dome.
        radiance: Over the sun's irradiance, [turbidity, albedo, sun, direction, wavelength of
            `settings.all_wavelength_nm`], sr^-1.
        seconds: Of the simulation; the first run of a program includes its compilation.
        pieces_read: Pieces that an earlier run had finished.
    """

    settings: TrainingSettings
    directions: Directions
    radiance: np.ndarray
    seconds: float
    pieces_read: int = 0

    @property
    def place(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Turbidity, sun [rad] and albedo of each sky, shape [sky]."""
        s = self.settings
        suns = np.radians(s.solar_zenith_angle_deg)
        T, a, sun = np.meshgrid(s.turbidity, s.albedo, suns, indexing="ij")
        return T.ravel(), sun.ravel(), a.ravel()

    def XYZ(self) -> np.ndarray:
        """Colours under the standard sun, [sky, direction, 3], cd m^-2."""
        XYZ = np.asarray(self.settings.XYZ(self.radiance))
        return XYZ.reshape(-1, *XYZ.shape[-2:])

    def channels(self) -> np.ndarray:
        """What a sky model is fitted to: spectral channels, X, Y, Z; [channel, sky, direction]."""
        λ = self.settings.all_wavelength_nm
        chosen = self.radiance[..., np.searchsorted(λ, self.settings.wavelength_nm)].astype(float)
        chosen = chosen.reshape(-1, *chosen.shape[-2:])
        return np.moveaxis(np.concatenate([chosen, self.XYZ()], axis=-1), -1, 0)


def simulate_training(
    settings: TrainingSettings | None = None,
    clock: Clock | None = None,
    pieces: str | Path | None = None,
) -> TrainingSkies:
    """Simulate the skies of a training set.

    Args:
        settings: What to simulate; None: those of the shipped model.
        clock: Told of each piece.
        pieces: Folder in which every finished piece (one turbidity over one ground) is kept, and
            from which those of an earlier run are taken. None: nothing is written.

    Returns:
        The skies.

    Raises:
        ValueError: The folder of the pieces cannot be made or written.
        OSError: A piece cannot be written.
    """
    settings, clock = settings or TrainingSettings(), clock or Clock(None)
    table = [(i, j) for i in range(len(settings.turbidity)) for j in range(len(settings.albedo))]
    with jax.enable_x64(True), clock.stage("simulation"):
        directions, plan = dome_343(), settings.plan()
        kept = None if pieces is None else Pieces.open(pieces, simulation_key(settings.simulated))
        simulated = jax.jit(lambda *at: settings.radiance(plan, directions, *at))
        done, read = [], 0
        for i, j in table:
            clock.tell(f"piece {len(done) + 1} of {len(table)}")
            name = f"turbidity{i}_albedo{j}"
            values = None if kept is None else kept.read(name)
            if values is None:
                at = (jnp.asarray(settings.turbidity[i]), jnp.asarray(settings.albedo[j]))
                values = np.asarray(simulated(*at))
                if kept is not None:
                    kept.write(name, values)
            else:
                read += 1
            done.append(values)
    shape = (len(settings.turbidity), len(settings.albedo), *done[0].shape)
    seconds = clock.seconds["simulation"]
    return TrainingSkies(settings, directions, np.stack(done).reshape(shape), seconds, read)


@dataclasses.dataclass(frozen=True)
class TrainedModel:
    """A sky model fitted to simulated skies.

    Attributes:
        model: Valid inside the ranges of the settings.
        fit: How well, and how far, the skies determine it.
        skies: What it was fitted to.
        seconds: Of each stage.
    """

    model: SkyModel
    fit: SkyModelFit
    skies: TrainingSkies
    seconds: dict[str, float]


# Chosen by experiments/model_selection.py.
STANDARD_BASES = (Basis("polynomial", 4), Basis("polynomial", 7), Basis("polynomial", 2))


def train(
    settings: TrainingSettings | None = None,
    *,
    skies: TrainingSkies | None = None,
    shape: AnyShape = AUREOLE,
    bases: tuple[Basis, Basis, Basis] = STANDARD_BASES,
    prior_strength: float = PRIOR_STRENGTH,
    starts: int = STARTS,
    pieces: str | Path | None = None,
    progress: Progress | None = None,
) -> TrainedModel:
    """Simulate a training set, or take a given one, and fit a sky model to it.

    Args:
        settings: What to simulate; None: those of the shipped model.
        skies: From `simulate_training`; nothing is simulated then.
        shape: Of the model.
        bases: In turbidity, sun and albedo.
        prior_strength: As in `fit_sky_model`.
        starts: As in `fit_sky_model`.
        pieces: As in `simulate_training`.
        progress: Called with the name of each stage and the number of each piece.

    Returns:
        The model, with its fit.

    Raises:
        ValueError: Settings together with skies, or a folder that cannot be written.
    """
    if skies is not None and settings not in (None, skies.settings):
        raise ValueError(f"settings must be None where skies are given, got {settings}")
    clock = Clock(progress)
    if skies is None:
        skies = simulate_training(settings, clock, pieces)
    s = skies.settings
    dependence = Dependence(
        *bases,
        turbidity_range=(s.turbidity[0], s.turbidity[-1]),
        latest_sun_deg=s.solar_zenith_angle_deg[-1],
        largest_albedo=s.albedo[-1],
    )
    with jax.enable_x64(True), clock.stage("fit"):
        # Colours first: the search from several starts is on the first channel.
        fit = fit_sky_model(
            skies.directions,
            *skies.place,
            np.roll(skies.channels(), len(COLOURS), axis=0),
            shape,
            dependence,
            prior_strength=prior_strength,
            starts=starts,
        )
        by_channel = ("coefficients", "standard_error", "rms", "largest", "converged", "steps")
        ordered = {k: jnp.roll(getattr(fit, k), -len(COLOURS), axis=0) for k in by_channel}
        # NumPy arrays stay float64 whatever JAX's default is.
        fit = jax.tree.map(np.asarray, dataclasses.replace(fit, **ordered))
    model = SkyModel(fit.coefficients, shape, dependence, s.wavelength_nm)
    return TrainedModel(model, fit, skies, clock.seconds)
