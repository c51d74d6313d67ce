"""Which shape and which bases does a sky model need?

Cross-validated error of luminance against the number of coefficients: skies are left out by turns
(not those at the ends of turbidity and sun), a model is fitted to the others, and its luminance in
those left out is compared. Writes table.md, a picture and result.json; the shipped model follows
from it.
"""

import dataclasses
import time
from pathlib import Path

import jax
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.fit.training import TrainingSkies
from atmofit.render.image import new_figure, png_bytes, save_bytes, style

SHAPES = {
    "Perez (6)": af.PEREZ,
    "Hosek-Wilkie terms (9)": af.EXTENDED,
    "aureole (13)": af.AUREOLE,
}
# Functions in turbidity, sun and albedo; the sun's are polynomials or splines.
BASES = {
    "2 x 5 x 2": ("polynomial", 2, 5, 2),
    "3 x 7 x 2": ("polynomial", 3, 7, 2),
    "4 x 7 x 2": ("polynomial", 4, 7, 2),
    "4 x spline 8 x 2": ("spline", 4, 8, 2),
    "5 x 9 x 2": ("polynomial", 5, 9, 2),
    "4 x 7 x 3": ("polynomial", 4, 7, 3),
}


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    folds: int = 3
    """How many times a part of the skies is left out."""
    seed: int = 0
    """Of the parts."""
    pieces: Path = Path("runs/refit_standard/pieces")
    """Of the simulation; those of `atmofit refit --preset standard` are taken."""
    out: Path = Path("runs/model_selection")


def main(config: Config) -> None:
    """Simulate, fit by turns, compare."""
    config.out.mkdir(parents=True, exist_ok=True)
    skies = af.simulate_training(pieces=config.pieces)
    place = np.stack(skies.place)
    luminance = skies.XYZ()[..., 1]
    # At the ends of turbidity and sun nothing is left out: models are not meant to go beyond.
    inside = np.all([(row > row.min()) & (row < row.max()) for row in place[:2]], axis=0)
    part = np.full(inside.size, -1)
    order = np.random.default_rng(config.seed).permutation(int(inside.sum()))
    part[inside] = order % config.folds
    results = []
    for shape_name, shape in SHAPES.items():
        for basis_name, (kind, turbidity, sun, albedo) in BASES.items():
            dependence = af.Dependence(
                af.Basis("polynomial", turbidity),
                af.Basis(kind, sun),
                af.Basis("polynomial", albedo),
                turbidity_range=(float(place[0].min()), float(place[0].max())),
                latest_sun_deg=float(np.degrees(place[1].max())),
                largest_albedo=float(place[2].max()),
            )
            begin = time.perf_counter()
            seen, unseen = [], []
            for fold in range(config.folds):
                errors = _errors(skies, place, luminance, part != fold, shape, dependence)
                seen.append(errors[part != fold])
                unseen.append(errors[part == fold])
            result = {
                "shape": shape_name,
                "bases": basis_name,
                "coefficients": len(shape.names) * dependence.size,
                "seen": _rms(np.concatenate(seen)),
                "left out": _rms(np.concatenate(unseen)),
                "99th percentile": float(np.percentile(np.abs(np.concatenate(unseen)), 99)),
                "seconds": time.perf_counter() - begin,
            }
            results.append(result)
            print(result, flush=True)
    head = ["shape", "bases", "coefficients", "rms seen", "left out", "99th percentile", "seconds"]
    rows = [
        [
            r["shape"],
            r["bases"],
            str(r["coefficients"]),
            *(f"{100 * r[name]:.1f} %" for name in ("seen", "left out", "99th percentile")),
            f"{r['seconds']:.0f}",
        ]
        for r in results
    ]
    text = markdown(head, rows)
    print(text)
    write_run(config.out, config, {"models": results}, text + "\n")
    with style():
        save_bytes(_picture(results), config.out / "model_selection.png")


def _errors(
    skies: TrainingSkies,
    place: np.ndarray,
    luminance: np.ndarray,
    used: np.ndarray,
    shape: af.Shape,
    dependence: af.Dependence,
) -> np.ndarray:
    """Relative errors of luminance in all skies of a model fitted to some, [sky, direction]."""
    T, sun, albedo = place[:, used]
    fit = af.fit_sky_model(
        skies.directions, T, sun, albedo, luminance[None, used], shape, dependence, starts=1
    )
    tripled = np.repeat(np.asarray(fit.coefficients), 3, axis=0)  # all colours are luminance here
    model = af.SkyModel(tripled, shape, dependence)

    def sky(at: jax.Array) -> jax.Array:
        return model.XYZ(at[0], at[1], skies.directions, at[2])[:, 1]

    modelled = jax.jit(lambda every: jax.lax.map(sky, every))(place.T)
    return np.asarray(modelled) / luminance - 1


def _rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _picture(results: list[dict]) -> bytes:
    """Error of skies left out against the number of coefficients."""
    figure = new_figure(7.0, 4.2)
    axes = figure.subplots()
    for marker, name in zip("osD", SHAPES, strict=True):
        mine = sorted((r for r in results if r["shape"] == name), key=lambda r: r["coefficients"])
        count = [r["coefficients"] for r in mine]
        (line,) = axes.plot(count, [100 * r["left out"] for r in mine], marker, label=name)
        axes.plot(
            count, [100 * r["seen"] for r in mine], marker, mfc="none", color=line.get_color()
        )
        for r in mine:
            axes.annotate(
                r["bases"], (r["coefficients"], 100 * r["left out"]), fontsize=6,
                xytext=(3, 3), textcoords="offset points",
            )  # fmt: skip
    axes.set(
        xlabel="coefficients of a channel",
        ylabel="rms error of luminance [%]",
        xscale="log",
        yscale="log",
        title="filled: skies left out; open: skies fitted",
    )
    axes.set_xticks([125, 250, 500, 1000], ["125", "250", "500", "1000"])
    axes.set_yticks([3, 4, 6, 8, 12], ["3", "4", "6", "8", "12"])
    axes.minorticks_off()
    axes.legend()
    return png_bytes(figure)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
