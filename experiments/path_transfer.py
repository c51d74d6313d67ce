"""How wrong is each way to integrate along a path through air, and what does it cost?

All solvers of `path_transfer` on the same random paths, 1 m to 300 km, up, level and down, through
air of turbidity 1 to 30, at nine wavelengths; beside them an adaptive quadrature (quadax) and a
stiff solver of the differential equation (diffrax). Maps of where the two closed forms of 1999
fail. Writes result.json, table.md and a picture.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.files import replace_file
from atmofit.media.path_planning import LADDER

EXACT = af.PathPlan("gauss", 64)
WAVELENGTHS_NM = np.linspace(400.0, 700.0, 9)
PALETTE = ("#1f5fa8", "#c8553d", "#5a9367", "#8c6bb1")


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    paths: int = 20_000
    """Of every turbidity, for solvers."""
    few: int = 64
    """Likewise, for the adaptive quadrature and the differential equation."""
    turbidity: tuple[float, ...] = (1.0, 2.0, 6.0, 30.0)
    repeats: int = 5
    """Hot runs, of which the quickest counts."""
    seed: int = 1
    out: Path = Path("runs/path_transfer")


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    random = np.random.default_rng(config.seed)
    paths = random_paths(random, config.paths)
    rows, results = [], {}
    for plan in LADDER:
        results[plan.name] = solver(config, plan, paths)
    for name, oracle in (("adaptive, quadax", adaptive), ("ODE, diffrax", differential)):
        results[name] = by_oracle(config, oracle, random_paths(random, config.few))
    for name, found in results.items():
        rows.append(
            [
                name,
                f"{found['compile_s']:.1f}",
                f"{found['per_path_us']:.2g}",
                f"{found['median']:.1e}",
                f"{found['p99']:.1e}",
                f"{found['largest']:.1e}",
            ]
        )
    head = [
        "solver",
        "first call [s]",
        "hot [us/path]",
        "median error",
        "99th percentile",
        "largest",
    ]
    text = markdown(head, rows)
    print(text)
    config.out.mkdir(parents=True, exist_ok=True)
    print(draw(config.out / "path_transfer.png", results))
    write_run(config.out, config, {"solvers": results}, text + "\n")


def random_paths(random: np.random.Generator, count: int) -> af.Path:
    """That end above the ground."""
    distance = 10 ** random.uniform(0, math.log10(3e5), count)
    zenith = np.concatenate(
        [
            random.uniform(0.0, math.pi, count - count // 3),
            math.pi / 2 + random.uniform(-0.03, 0.03, count // 3),
        ]
    )
    altitude = np.maximum(-distance * np.cos(zenith), 0.0) + 10 ** random.uniform(0, 3.5, count)
    too_high = altitude > 9e4
    distance = np.where(too_high, distance * 8e4 / np.maximum(altitude, 1.0), distance)
    altitude = np.maximum(-distance * np.cos(zenith), 0.0) + 10.0
    return af.Path(distance, zenith, altitude)


def air_of(turbidity: float) -> af.LowAir:
    """The paper's air."""
    return af.low_air(af.Atmosphere.from_turbidity(turbidity), WAVELENGTHS_NM)


def solver(config: Config, plan: af.PathPlan, paths: af.Path) -> dict[str, Any]:
    """Errors over all turbidities in double, time of one in single precision."""
    small = jax.tree.map(lambda leaf: leaf.astype(np.float32), (air_of(2.0), paths))
    time_of = timed(
        config, lambda: af.path_transfer(*small, source=1.0, plan=plan).in_scattered, config.paths
    )
    errors = []
    for turbidity in config.turbidity:
        air = air_of(turbidity)
        found, exact = (af.path_transfer(air, paths, 1.0, p).integrals for p in (plan, EXACT))
        errors.append(relative(found, exact))
    return statistics(np.concatenate(errors)) | time_of


def relative(found: Any, exact: Any) -> np.ndarray:
    """Largest relative error of each path."""
    return np.abs(np.asarray(found / exact) - 1).reshape(found.shape[0], -1).max(axis=1)


def statistics(error: np.ndarray) -> dict[str, float]:
    """Of many paths."""
    return {
        "median": float(np.median(error)),
        "p99": float(np.quantile(error, 0.99)),
        "largest": float(error.max()),
    }


def timed(config: Config, run: Callable[[], Any], count: int) -> dict[str, float]:
    """First call, and the quickest hot one for each path."""
    begin = time.perf_counter()
    jax.block_until_ready(run())
    first, hot = time.perf_counter() - begin, math.inf
    for _ in range(config.repeats):
        begin = time.perf_counter()
        jax.block_until_ready(run())
        hot = min(hot, time.perf_counter() - begin)
    return {"compile_s": first, "per_path_us": 1e6 * hot / count}


def local(air: af.LowAir, path: Any, x: Any) -> tuple[Any, Any]:
    """Densities and extinction coefficients at a distance, written anew."""
    s, zenith, altitude = path
    height = altitude + x * s * jnp.cos(zenith)
    density = jnp.exp(-air.decay * height)
    return density, density[:, None] * air.extinction


def adaptive(air: af.LowAir, path: Any) -> Any:
    """Gauss-Kronrod quadrature of density times transmittance, over even parts of the path."""
    import quadax

    s, zenith, altitude = path

    def depth(x: Any) -> Any:
        rise = air.decay * jnp.cos(zenith) * x * s
        level = jnp.abs(rise) < 1e-8
        mean = jnp.where(level, 1 - rise / 2, -jnp.expm1(-rise) / jnp.where(level, 1.0, rise))
        return air.extinction.T @ (jnp.exp(-air.decay * altitude) * x * s * mean)

    def integrand(x: Any) -> Any:
        density, _ = local(air, path, x)
        return s * density[:, None] * jnp.exp(-depth(x))[None, :]

    parts = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-4, 1.0, 8)])
    value, _ = quadax.quadgk(integrand, parts, epsabs=0.0, epsrel=1e-10, max_ninter=200)
    return value


def differential(air: af.LowAir, path: Any) -> Any:
    """The equation of transfer from the far end to the eye, for each scatterer's source alone."""
    import diffrax

    s = path[0]

    def slope(t: Any, light: Any, _: Any) -> Any:
        density, extinction = local(air, path, 1 - t)
        return s * (density[:, None] - jnp.sum(extinction, axis=0)[None, :] * light)

    solved = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),
        diffrax.Kvaerno5(),
        0.0,
        1.0,
        1e-4,
        jnp.zeros(air.scattering.shape),
        stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-10),
        max_steps=4096,
        throw=False,
    )
    return jnp.asarray(solved.ys)[0]


def by_oracle(config: Config, oracle: Callable[..., Any], paths: af.Path) -> dict[str, Any]:
    """As `solver`, path by path."""
    columns = (paths.distance, paths.view_zenith_angle, paths.observer_altitude)
    every = jax.jit(lambda air: jax.lax.map(lambda path: oracle(air, path), columns))
    time_of = timed(config, lambda: every(air_of(2.0)), config.few)
    errors = [
        relative(every(air_of(T)), af.path_transfer(air_of(T), paths, 1.0, EXACT).integrals)
        for T in config.turbidity
    ]
    return statistics(np.concatenate(errors)) | time_of


def draw(path: Path, results: dict[str, dict[str, float]]) -> Path:
    """Error against time, and two maps of failure."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 4.1), layout="constrained")
    ax, *maps = figure.subplots(1, 3, width_ratios=[1.25, 1, 1])
    kinds = {"gauss": PALETTE[0], "adaptive": PALETTE[3], "ODE": PALETTE[3]}
    for name, found in results.items():
        color = kinds.get(name.split()[0].strip(","), PALETTE[1])
        seen = (found["per_path_us"], min(max(found["p99"], 1e-16), 1e3))
        ax.plot(*seen, "o", color=color)
        short = name.removeprefix("gauss ")
        ax.annotate(short, seen, xytext=(5, 3), textcoords="offset points", fontsize=8)
    ax.set(xscale="log", yscale="log", ylim=(1e-17, 1e5))
    ax.set(
        xlabel="time of a path, 9 wavelengths [µs]", ylabel="relative error, 99th percentile [-]"
    )
    ax.set_title("numbers: nodes of the quadrature")
    zenith, distance = np.radians(np.linspace(0, 89.9, 91)), np.geomspace(10, 3e5, 90)
    z, s = np.meshgrid(zenith, distance)
    ways = af.Path(s, z)
    images = []
    for panel, name in zip(maps, ("horizontal", "hermite"), strict=True):
        found, exact = (
            af.path_transfer(air_of(2.0), ways, 1.0, p).integrals
            for p in (af.PathPlan(name, 0), EXACT)
        )
        error = np.abs(np.asarray(found / exact) - 1).max(axis=(2, 3))
        shown = (np.degrees(zenith), distance / 1e3, np.clip(error, 1e-6, 1e2))
        images.append(panel.pcolormesh(*shown, norm=LogNorm(1e-6, 1e2), cmap="cividis"))
        lines = panel.contour(np.degrees(zenith), distance / 1e3, error, [1e-2], colors="w")
        panel.clabel(lines, fmt={1e-2: "1 %"}, fontsize=8)
        panel.set(yscale="log", xlabel="view zenith angle [°]", ylabel="distance [km]")
        panel.set_title(f"{name}, turbidity 2, from the ground")
    figure.colorbar(images[0], ax=maps, label="relative error [-], cut at 100")
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
