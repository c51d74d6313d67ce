"""How far are sky models from the simulation, also in skies that they were not fitted to?

Luminance of the shipped model, of the published one of 1999, and of the 1999 form fitted to the
same training skies (those that it can have: sun above the horizon, one ground), against simulated
skies of other turbidities, suns and grounds than the training set's.
"""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.fit.training import TrainingSkies

HEAD = ["model", "skies", "rms", "99th percentile", "largest", "model over simulation"]
PAPER_TURBIDITY = (1.9, 10.0)  # of the skies to which the 1999 form is fitted
PAPER_LATEST_SUN_DEG = 89.0
PAPER_GROUND = 1  # place of the albedo in the training set's list


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    turbidity: tuple[float, ...] = (1.35, 2.2, 3.9, 8.0)
    """None of them in the training set."""
    suns_deg: tuple[float, ...] = (5.0, 35.0, 64.0, 78.0, 86.0, 88.5, 91.5)
    """Solar zenith angles [degree], likewise."""
    albedo: tuple[float, ...] = (0.1, 0.5)
    """Likewise."""
    pieces: Path = Path("runs/refit_standard/pieces")
    """Of the simulations; those of `atmofit refit --preset standard` are taken."""
    out: Path = Path("runs/sky_model_errors")


def main(config: Config) -> None:
    """Simulate, compare, print and write."""
    config.out.mkdir(parents=True, exist_ok=True)
    others = af.TrainingSettings(
        turbidity=config.turbidity, solar_zenith_angle_deg=config.suns_deg, albedo=config.albedo
    )
    trained = af.simulate_training(pieces=config.pieces)
    new = af.simulate_training(others, pieces=config.pieces)
    refitted = paper_form(trained)
    rows, numbers = [], {}
    for name, skies in (("fitted to", trained), ("new", new)):
        for label, model, latest in (
            ("ATMOFIT_2026", af.ATMOFIT_2026, 92.0),
            ("1999 form, refitted", refitted, PAPER_LATEST_SUN_DEG),
            ("1999, published", af.PREETHAM_1999, PAPER_LATEST_SUN_DEG),
        ):
            errors = _errors(skies, model, latest)
            size = np.abs(errors)
            found = {
                "skies": int(errors.shape[0]),
                "rms": float(np.sqrt(np.mean(errors**2))),
                "99th percentile": float(np.percentile(size, 99)),
                "largest": float(size.max()),
                "level": float(np.exp(np.mean(np.log1p(errors)))),
            }
            numbers[f"{label}, {name}"] = found
            cells = (found[key] for key in ("rms", "99th percentile", "largest"))
            rows.append(
                [f"{label}, {name}", str(found["skies"]), *(f"{100 * x:.1f} %" for x in cells),
                 f"{found['level']:.2f}"]
            )  # fmt: skip
    text = markdown(HEAD, rows)
    print(text)
    write_run(config.out, config, {"models": numbers}, text + "\n")


def paper_form(skies: TrainingSkies) -> af.PreethamModel:
    """The form of 1999 fitted to the luminance of those training skies that it can have."""
    s = skies.settings
    table = skies.XYZ()[..., 1].reshape(
        len(s.turbidity), len(s.albedo), len(s.solar_zenith_angle_deg), -1
    )
    low, high = PAPER_TURBIDITY
    airs = [k for k, T in enumerate(s.turbidity) if low <= T <= high]
    suns = [k for k, sun in enumerate(s.solar_zenith_angle_deg) if sun <= PAPER_LATEST_SUN_DEG]
    luminance = table[airs][:, PAPER_GROUND][:, suns]
    turbidity = np.asarray(s.turbidity)[airs]
    sun = np.radians(np.asarray(s.solar_zenith_angle_deg)[suns])
    joint = af.fit_distribution(skies.directions, sun, turbidity, luminance)
    zenith = af.fit_zenith_luminance(turbidity, sun, luminance[:, :, 0])
    return dataclasses.replace(
        af.PREETHAM_1999,
        luminance_distribution=np.asarray(joint.matrix),
        zenith_luminance=np.asarray(zenith.coefficients),
        turbidity_range=PAPER_TURBIDITY,
    )


def _errors(
    skies: TrainingSkies, model: af.SkyModel | af.PreethamModel, latest_sun_deg: float
) -> np.ndarray:
    """Model over simulated luminance less 1 in the skies that the model can have."""
    low, high = model.turbidity_range
    errors = []
    for T, sun, albedo, simulated in zip(*skies.place, skies.XYZ()[..., 1], strict=True):
        if not low <= T <= high or np.degrees(sun) > latest_sun_deg:
            continue
        if isinstance(model, af.SkyModel):
            modelled = model(T, sun, skies.directions, albedo)
        else:
            modelled = model(T, sun, skies.directions)
        errors.append(np.asarray(modelled)[:, 2] / simulated - 1)
    return np.stack(errors)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
