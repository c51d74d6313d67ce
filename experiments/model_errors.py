"""How wrong are models of the sky at the right turbidity, and in which patterns over the dome?

Real skies differ from a model in haze, ground, ozone and all that the model leaves out. Random
skies over a continent, all orders of scattering, stand for them; every model is asked for the same
turbidity and sun, and the logarithm of model over sky is put together from the patterns of
`atmofit.fit.model_error`. Mean and covariance of their amplitudes, and what the patterns leave, are
the model error with which turbidity is estimated. Writes table.md and result.json; with --store
also the file that the package keeps.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.files import replace_file
from atmofit.fit.candidates import skies
from atmofit.fit.model_error import PATTERNS, amplitudes_design, features
from atmofit.fit.unknowns import UNKNOWNS

STORED = Path(af.__file__).parent / "fit" / "model_errors.json"
# 81 directions: 9 rings of 9 azimuths over the full circle.
DIRECTIONS = af.DirectionGrid(
    np.radians(np.arange(5.0, 86.0, 10.0)), np.radians(np.arange(0.0, 321.0, 40.0))
)
# Ranges of the random skies. Haze: from clean to polluted continental air of the OPAC collection,
# with mineral dust left out; ozone: middle latitudes; ground: from water to dry grass and sand.
RANGES = {
    "turbidity": (1.25, 10.0),
    "solar_zenith_angle": (np.radians(5.0), np.radians(85.0)),
    "albedo": (0.0, 0.4),
    "ozone_dobson": (250.0, 400.0),
    "angstrom_exponent": (0.8, 1.8),
    "single_scattering_albedo": (0.86, 1.0),
    "asymmetry": (0.62, 0.78),
    "scale_height": (800.0, 2000.0),
}
NOISE, ROUNDS = 0.01, 3
MODELS: dict[str, af.SkyModel | af.SimulatorModel | str] = {
    "atmofit_2026": af.ATMOFIT_2026,
    "preetham": "preetham",
    "simulator": af.SimulatorModel(rtol=5e-2),
    "simulator all": af.SimulatorModel(orders="all", rtol=5e-2),
    "continental all": af.SimulatorModel("continental", orders="all", rtol=5e-2),
}
# Its estimates take so long to compile that the stretch of the model most like it is taken.
LIKE = {"continental all": "simulator all"}


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    skies: int = 120
    """Random ones."""
    seed: int = 5
    """Of the skies; turbidity_study.py draws others."""
    rtol: float = 1e-2
    """Rung on which they are simulated."""
    store: bool = False
    """Replace the file that the package keeps."""
    out: Path = Path("runs/model_errors")


def main(config: Config) -> None:
    """Simulate, compare, print and write."""
    places = draw(config.skies, config.seed)
    truth = simulate(places, af.SimulatorModel("continental", orders="all", rtol=config.rtol))
    models, rows = {}, []
    for name, model in MODELS.items():
        low = 1.7 if name == "preetham" else 1.25
        used = places["turbidity"] >= low
        chosen = {key: values[used] for key, values in places.items()}
        usual = {key: np.full(used.sum(), u.start) for key, u in UNKNOWNS.items()}
        usual |= {key: chosen[key] for key in ("turbidity", "solar_zenith_angle")}
        error = np.log(simulate(usual, model) / truth[used])
        found = summary(error, chosen)
        factor = models[LIKE[name]]["stretch"] if name in LIKE else None
        found = stretched(found, factor or stretch(found, name, chosen, truth[used]))
        models[name] = found
        level = np.sqrt(np.diag(np.asarray(found["covariance"])))[:3]
        cells = (np.mean(error), *level, found["rough"], np.sqrt(np.mean(error**2)))
        rows.append([name, str(used.sum()), *(f"{100 * x:.1f} %" for x in cells)])
        rows[-1].append(f"{found['stretch']:.2f}")
        print(rows[-1], flush=True)
        if config.store:
            _store(config, models)
    head = ["model", "skies", "mean level", "level ±", "gradient ±", "horizon ±", "rough", "rms",
            "stretch"]  # fmt: skip
    text = markdown(head, rows)
    print(text)
    result = {"patterns": PATTERNS, "models": models}
    write_run(config.out, config, result, text + "\n")


def _store(config: Config, models: dict[str, Any]) -> None:
    """Replace the package's file."""
    made = {"skies": config.skies, "seed": config.seed, "rtol": config.rtol}
    text = json.dumps({"made": made, "patterns": PATTERNS, "models": models}, indent=1)

    def write(path: Path) -> None:
        path.write_text(text + "\n", encoding="utf-8")

    replace_file(STORED, write)


def draw(count: int, seed: int) -> dict[str, np.ndarray]:
    """Random skies: turbidity in even ratios, all else evenly."""
    random = np.random.default_rng(seed)
    places = {}
    for name, (low, high) in RANGES.items():
        share = random.random(count)
        even = low + (high - low) * share
        places[name] = low * (high / low) ** share if name == "turbidity" else even
    return places | {"solar_azimuth": np.zeros(count)}


def simulate(places: dict[str, np.ndarray], model: Any) -> np.ndarray:
    """X, Y and Z of skies, [sky, direction axes, 3]."""
    shape = (*DIRECTIONS.shape, 3)
    empty = af.Observation(DIRECTIONS, np.ones(shape), 0.5, 0.01, channels="XYZ")
    sky, _ = skies(model, empty)

    @jax.jit
    def all_skies(places: dict[str, jax.Array]) -> jax.Array:
        return jax.lax.map(lambda values: sky(values, DIRECTIONS), places)

    return np.asarray(all_skies({k: jnp.asarray(v) for k, v in places.items()}), float)


def summary(error: np.ndarray, places: dict[str, np.ndarray]) -> dict[str, Any]:
    """Amplitudes of the patterns in ln(model / sky), their means and covariance."""
    amplitudes, left = [], []
    suns = places["solar_zenith_angle"]
    for each, sun in zip(error, suns, strict=True):
        empty = af.Observation(DIRECTIONS, np.ones(each.shape), sun, 0.01, channels="XYZ")
        design = np.asarray(amplitudes_design(empty)).reshape(each.size, -1)
        # A weak ridge, so that patterns that are alike under some suns share what they explain.
        ridge = 1e-2 * np.eye(design.shape[1])
        rows = np.concatenate([design, ridge])
        found, *_ = np.linalg.lstsq(rows, np.append(each.ravel(), np.zeros(len(ridge))))
        amplitudes.append(found)
        left.append(each.ravel() - design @ found)
    table = np.asarray(amplitudes)
    at = np.asarray(jax.vmap(features)(jnp.asarray(places["turbidity"]), jnp.asarray(suns)))
    mean, *_ = np.linalg.lstsq(at, table)
    around = table - at @ mean
    return {
        "mean": mean.round(5).tolist(),
        "covariance": (around.T @ around / (len(table) - at.shape[1])).tolist(),
        "rough": float(np.sqrt(np.mean(np.square(left)))),
    }


def stretched(found: dict[str, Any], factor: float) -> dict[str, Any]:
    """The model error with amplitudes and rest so many times as large."""
    return {
        "mean": found["mean"],
        "covariance": (np.asarray(found["covariance"]) * factor**2).round(8).tolist(),
        "rough": round(factor * found["rough"], 5),
        "stretch": round(factor, 3),
    }


def stretch(
    found: dict[str, Any], name: str, places: dict[str, np.ndarray], truth: np.ndarray
) -> float:
    """How many times as large the model error must be for 95 % of the intervals to hold."""
    view, azimuth = DIRECTIONS.angles()
    directions = af.Directions(view.ravel(), azimuth.ravel(), (9,) * 9)
    luminance = truth[..., 1].reshape(len(truth), -1)

    @jax.jit
    def many(factor: jax.Array) -> tuple[jax.Array, jax.Array]:
        covariance = jnp.asarray(found["covariance"]) * factor**2
        error = af.ModelError(found["mean"], covariance, factor * found["rough"])

        def one(sky: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            observation = af.Observation(directions, *sky, NOISE)
            estimate = af.estimate_turbidity(observation, MODELS[name], model_error=error)
            return estimate.value, estimate.standard_error

        return jax.lax.map(one, (jnp.asarray(luminance), jnp.asarray(suns)))

    suns = places["solar_zenith_angle"]
    factor = 1.0
    for _ in range(ROUNDS):
        value, error = (np.asarray(each) for each in many(jnp.asarray(factor)))
        pull = np.abs(value - places["turbidity"]) / error
        factor = max(1.0, factor * float(np.quantile(pull, 0.95)) / 1.96)
    return factor


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
