"""Klassen's sky of 1987: how wrong, how dear, and what do its parameters do?

His geometry against the exact one; pixel by pixel with reuse against all at once and against a
reconstruction, at the six sizes of his Table I; colour by wavelengths against colour by three
numbers; a small picture enlarged; a picture stored by runs. Writes result.json, table.md and a
picture.
"""

import dataclasses
import math
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run
from two_layer_pictures import draw

import atmofit as af
from atmofit.media.adaptive_sky import adaptive_sky
from atmofit.media.sky_reconstruction import plan_layered_sky, reconstruct_layered_sky
from atmofit.media.two_layers import (
    TwoLayers,
    blue_behind,
    coloured,
    layered_sky,
    sky_integral,
    two_layers,
)
from atmofit.render.film import on_film

# Klassen (1987), Table I: seconds of a VAX 8600.
TABLE = {
    "noon": {131072: 153, 32768: 60, 8192: 25, 2048: 11, 512: 5, 128: 3},
    "sunset": {131072: 654, 32768: 309, 8192: 144, 2048: 64, 512: 31, 128: 13},
}
WIDTHS = (16, 32, 64, 128, 256, 512)
EXACT_NODES = 48


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    noon: float = 20.0
    """Zenith angle of the sun [degree]."""
    sunset: float = 89.0
    """Likewise."""
    repeats: int = 5
    """Hot runs, of which the quickest counts."""
    out: Path = Path("runs/two_layer_sky")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    result: dict[str, Any] = {"speed": speed(config), "costs": {}, "slopes": {}}
    for case in TABLE:
        sun = math.radians(getattr(config, case))
        result["costs"][case] = [cost(sun, width) for width in WIDTHS]
        result["slopes"][case] = slopes(case, result["costs"][case])
        result[f"resize_{case}"] = resized(sun)
    result["three_numbers"] = three_numbers()
    text = tables(result)
    print(text)
    config.out.mkdir(parents=True, exist_ok=True)
    print(draw(config.out / "two_layer_sky.png"))
    write_run(config.out, config, result, text)


def grid(width: int) -> af.DirectionGrid:
    """Half the horizon across, the horizon to the zenith down."""
    rows = width // 2
    return af.DirectionGrid(
        np.pi / 2 * (np.arange(rows) + 0.5) / rows,
        np.pi * ((np.arange(width) + 0.5) / width - 0.5),
    )


def camera(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles of a camera's pixels, a right angle across, the horizon at its lower edge."""
    across, up = np.meshgrid(
        (np.arange(width) + 0.5) / width * 2 - 1, 1 - (np.arange(width // 2) + 0.5) / (width // 2)
    )
    zenith = np.arccos(up / np.sqrt(1 + across**2 + up**2))
    return zenith.ravel(), np.arctan2(across, 1.0).ravel()


def shown(layers: TwoLayers, radiance: Any, white: float | None = None) -> tuple[Any, float]:
    """Values of sRGB times 255, and the exposure."""
    irradiance = np.asarray(af.solar_irradiance_spectrum("standard")(layers.wavelength_nm))
    xyY = np.asarray(af.spectrum_to_xyY(np.asarray(radiance) * irradiance, layers.wavelength_nm))
    white = float(np.percentile(xyY[..., 2], 80)) if white is None else white
    return 255 * on_film(xyY, white), white


def bands(found: Any, exact: Any) -> float:
    """Largest second difference along rows and columns beyond the exact picture's [1/255]."""
    excess = [
        np.abs(np.diff(found, 2, axis)) - np.abs(np.diff(exact, 2, axis)).max() for axis in (0, 1)
    ]
    return float(max(x.max() for x in excess))


def cost(sun: float, width: int) -> dict[str, float]:
    """One picture by reuse, and its error at 8 bits."""
    layers, (zenith, azimuth) = two_layers(), camera(width)
    begin = time.perf_counter()
    found = adaptive_sky(layers, sun, zenith, azimuth)
    seconds = time.perf_counter() - begin
    at = (jnp.asarray(sun), jnp.asarray(zenith), jnp.asarray(azimuth))
    exact = sky_integral(layers, *at, True, EXACT_NODES)
    blue, shape = blue_behind(layers, None), (width // 2, width, 3)
    truth, white = shown(layers, coloured(layers, *at, exact, blue))
    seen, _ = shown(layers, coloured(layers, *at, jnp.asarray(found.integral.T), blue), white)
    return {
        "pixels": zenith.size,
        "integrals": found.integrals,
        "evaluations": found.evaluations,
        "seconds": seconds,
        "largest_error_255": float(np.abs(seen - truth).max()),
        "bands_255": bands(seen.reshape(shape), truth.reshape(shape)),
    }


def slopes(case: str, costs: list[dict[str, float]]) -> dict[str, float]:
    """Powers of the number of pixels."""
    pixels = np.log([c["pixels"] for c in costs])
    found = {
        what: float(np.polyfit(pixels, np.log([c[what] for c in costs]), 1)[0])
        for what in ("integrals", "evaluations", "seconds")
    }
    size, seconds = np.log(list(TABLE[case].items())).T
    return found | {"paper": float(np.polyfit(size, seconds, 1)[0])}


def speed(config: Config) -> dict[str, dict[str, float]]:
    """512 x 256 at 33 wavelengths in single precision: all pixels, and the reconstruction."""
    layers = jax.tree.map(lambda x: x.astype(np.float32), two_layers())
    directions = jax.tree.map(lambda x: x.astype(np.float32), grid(512))
    found = {}
    for case in TABLE:
        sun = np.float32(math.radians(getattr(config, case)))
        begin = time.perf_counter()
        plan = plan_layered_sky(two_layers(), float(sun))
        planning = time.perf_counter() - begin
        truth = layered_sky(two_layers(), float(sun), grid(512), nodes=EXACT_NODES)
        exact, white = shown(two_layers(), truth)
        for name, run in {
            "all pixels, 24 nodes": lambda sun=sun: layered_sky(layers, sun, directions, nodes=24),
            str(plan): lambda sun=sun, plan=plan: reconstruct_layered_sky(
                layers, sun, directions, plan=plan
            ),
        }.items():
            seen, _ = shown(two_layers(), run(), white)
            found[f"{case}: {name}"] = timed(config, run) | {
                "planning_s": planning,
                "largest_error_255": float(np.abs(seen - exact).max()),
                "bands_255": bands(seen, exact),
                "relative_error": float(np.max(np.abs(np.asarray(run()) / np.asarray(truth) - 1))),
            }
    return found


def timed(config: Config, run: Callable[[], Any]) -> dict[str, float]:
    """First call with nothing compiled, the next one, the quickest, and the memory at its peak."""
    jax.clear_caches()
    seconds = []
    for _ in range(2 + config.repeats):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        seconds.append(time.perf_counter() - begin)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    return {"first_s": seconds[0], "hot_s": min(seconds[1:]), "peak_MiB": peak}


def resized(sun: float) -> dict[str, float]:
    """Small pictures enlarged to 512 x 256 by cubic B-splines, and a picture stored by runs."""
    from scipy.ndimage import zoom

    layers = two_layers()
    full, white = shown(layers, layered_sky(layers, sun, grid(512), nodes=EXACT_NODES))
    found = {}
    for width in (32, 64, 128, 256):
        small, _ = shown(layers, layered_sky(layers, sun, grid(width), nodes=EXACT_NODES), white)
        factor = 512 // width
        large = zoom(small, (factor, factor, 1), order=3, mode="nearest", grid_mode=True)
        off = np.abs(large - full).max(axis=(1, 2))
        found[f"largest_error_255_from_{width}"] = float(off.max())
        # The lowest rows lie beyond the last small pixel's middle.
        found[f"above_the_horizon_255_from_{width}"] = float(off[: -2 * factor].max())
        found[f"bands_255_from_{width}"] = bands(large, full)
    pixels = np.round(full).astype(np.uint8).reshape(-1, 3)
    lengths, colours = runs(pixels)
    assert (np.repeat(colours, lengths, axis=0) == pixels).all()
    return found | {"run_length_share": 4 * len(lengths) / pixels.size}


def runs(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of runs of one colour, at most 255, and their colours."""
    starts = np.flatnonzero(np.r_[True, (pixels[1:] != pixels[:-1]).any(axis=1)])
    ends = np.r_[starts[1:], len(pixels)]
    cut = np.concatenate([np.arange(a, b, 255) for a, b in zip(starts, ends, strict=True)])
    return np.diff(np.r_[cut, len(pixels)]), pixels[cut]


def three_numbers() -> dict[str, Any]:
    """Colours of light that air scatters in and lets through, by wavelengths, sRGB and XYZ."""
    layers = two_layers()
    wavelength, b = np.asarray(layers.wavelength_nm), np.asarray(layers.molecular_extinction)

    def XYZ(spectrum: np.ndarray) -> np.ndarray:
        return np.asarray(af.spectrum_to_XYZ(spectrum, wavelength))

    def sRGB(spectrum: np.ndarray) -> np.ndarray:
        return np.asarray(af.XYZ_to_linear_sRGB(XYZ(spectrum)))

    one, found = np.ones_like(b), {}
    b_sRGB, b_XYZ = sRGB(b) / sRGB(one), XYZ(b) / XYZ(one)
    for kilometres in (30.0, 100.0, 300.0, 400.0):
        length = 1e3 * kilometres
        for name, light in {
            "scattered in": lambda b, length=length: 1 - np.exp(-b * length),
            "let through": lambda b, length=length: np.exp(-b * length),
        }.items():
            by_XYZ = np.asarray(af.XYZ_to_linear_sRGB(XYZ(one) * light(b_XYZ)))
            found[f"{name}, {kilometres:g} km"] = {
                "spectral": (sRGB(light(b)) / sRGB(one)).tolist(),
                "error_sRGB": (sRGB(one) * light(b_sRGB) / sRGB(light(b)) - 1).tolist(),
                "error_XYZ": (by_XYZ / sRGB(light(b)) - 1).tolist(),
            }
    return found | {"coefficients_sRGB_per_km": (1e3 * b_sRGB).tolist()}


def tables(result: dict[str, Any]) -> str:
    """What is printed."""
    parts = []
    for case, costs in result["costs"].items():
        head = ["pixels", *list(costs[0])[1:], "VAX 8600 [s]"]
        rows = [[f"{v:.4g}" for v in c.values()] + [str(TABLE[case][c["pixels"]])] for c in costs]
        parts += [f"{case}: {result['slopes'][case]}", markdown(head, rows)]
        parts.append(f"resize {case}: {result[f'resize_{case}']}")
    speeds = result["speed"]
    head = ["512 x 256 x 33, float32", *next(iter(speeds.values()))]
    parts.append(
        markdown(head, [[n, *(f"{v:.3g}" for v in s.values())] for n, s in speeds.items()])
    )
    parts += [f"{name}: {found}" for name, found in result["three_numbers"].items()]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
