"""Multiple scattering in a slab: what do the methods cost, and when do later orders matter?

Error against run time of successive orders, doubling, discrete ordinates and a random walk in one
slab; slabs per second of many at once beside nanodisort, with derivatives; how much of the light
was scattered more than once. Writes result.json, table.md and a picture.
"""

import dataclasses
import functools
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
from slab_methods import (
    ASYMMETRY,
    DEPTH,
    DTYPES,
    by_orders,
    ordinates,
    solved,
    ways,
)

from atmofit.files import replace_file

ALBEDOS = (0.9, 0.99, 1.0)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    slabs: int = 1000
    """Solved at once."""
    repeats: int = 4
    """Hot runs, of which the quickest counts."""
    photons: int = 100_000
    blocks: tuple[int, ...] = (2, 4, 8)
    """Slabs that are vmapped at a time; all at once is tried too."""
    out: Path = Path("runs/slab")
    picture: Path | None = None


def main(config: Config) -> None:
    """Measure, draw, print and write."""
    result = {"speed": speed(config), "methods": methods(config), "orders": orders_by_albedo()}
    text = report(result)
    print(text)
    write_run(config.out, config, result, text)
    draw(config.picture or config.out / "slab.png", result)


def quickest(call: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """Result and seconds of the best of some hot runs."""
    found = jax.block_until_ready(call())
    seconds = math.inf
    for _ in range(repeats):
        start = time.perf_counter()
        found = jax.block_until_ready(call())
        seconds = min(seconds, time.perf_counter() - start)
    return found, seconds


def methods(config: Config) -> list[dict[str, Any]]:
    """Error and time of one slab by every method; the truth has 128 streams."""
    rows = []
    for albedo in ALBEDOS:
        with jax.enable_x64(True):
            truth = [np.asarray(x) for x in solved(DEPTH, albedo, ASYMMETRY, 128, "float64")]
        for name, dtype, call in ways(albedo, config.photons):
            with jax.enable_x64(dtype == "float64"):
                once = name.startswith("random")
                found, seconds = quickest(call, 1 if once else 4 * config.repeats)
            back, radiance = (None if x is None else np.asarray(x, float) for x in found)
            rows.append(
                {
                    "method": name,
                    "albedo": albedo,
                    "seconds": seconds,
                    "error of reflectance": float(abs(back / truth[0] - 1)),
                    "error of radiance": None
                    if radiance is None
                    else float(np.max(np.abs(radiance / truth[1] - 1))),
                }
            )
    return rows


def speed(config: Config) -> list[dict[str, Any]]:
    """Milliseconds per slab of many at 32 streams and modes, nanodisort in turn with the others."""
    albedo = np.linspace(0.9, 0.99, config.slabs)
    disort = ordinates(albedo, 32)
    _, reference = disort()
    rows = []
    for dtype in DTYPES:
        with jax.enable_x64(dtype == "float64"):
            numbers = [
                jnp.full(config.slabs, DEPTH, dtype),
                jnp.asarray(albedo, dtype),
                jnp.full(config.slabs, ASYMMETRY, dtype),
            ]
            compiled, entries = {}, {}
            for name, program in programs(dtype, config.blocks).items():
                start = time.perf_counter()
                compiled[name] = jax.jit(program).lower(*numbers).compile()
                ready = time.perf_counter()
                found = jax.tree.leaves(jax.block_until_ready(compiled[name](*numbers)))
                entries[name] = {
                    "program": name,
                    "dtype": dtype,
                    "compile [s]": ready - start,
                    "first [s]": time.perf_counter() - ready,
                    "hot [ms/slab]": math.inf,
                    "nanodisort [ms/slab]": math.inf,
                    "memory [MB]": compiled[name].memory_analysis().temp_size_in_bytes / 1e6,
                }
                if name.startswith("radiance"):
                    apart = np.abs(np.asarray(found[0], float) / reference - 1)
                    entries[name]["from nanodisort"] = float(apart.max())
            for _ in range(config.repeats):
                for name, entry in entries.items():
                    ours = functools.partial(compiled[name], *numbers)
                    for call, key in ((ours, "hot [ms/slab]"), (disort, "nanodisort [ms/slab]")):
                        start = time.perf_counter()
                        jax.block_until_ready(call())
                        each = 1e3 * (time.perf_counter() - start) / config.slabs
                        entry[key] = min(entry[key], each)
            rows += entries.values()
    return rows


def programs(dtype: str, blocks: tuple[int, ...]) -> dict[str, Callable[..., Any]]:
    """Radiance in blocks and all at once; with its slopes by depth, albedo and asymmetry."""

    def radiance(*numbers: Any) -> Any:
        depth, albedo, asymmetry = numbers
        return solved(depth, albedo, asymmetry, 32, dtype)[1]

    def reverse(*numbers: Any) -> Any:
        return jax.value_and_grad(lambda *x: radiance(*x).sum(), (0, 1, 2))(*numbers)

    def forward(*numbers: Any) -> Any:
        return radiance(*numbers), jax.jacfwd(radiance, (0, 1, 2))(*numbers)

    def in_blocks(call: Callable[..., Any], size: int) -> Callable[..., Any]:
        return lambda *numbers: jax.lax.map(lambda x: call(*x), numbers, batch_size=size)

    found = {f"radiance, blocks of {size}": in_blocks(radiance, size) for size in blocks}
    return {
        **found,
        "radiance, vmap of all": jax.vmap(radiance),
        "reverse, blocks of 4": in_blocks(reverse, 4),
        "forward, blocks of 4": in_blocks(forward, 4),
    }


def orders_by_albedo() -> list[dict[str, Any]]:
    """Share of the reflected light that was scattered more than once, twice and 10 times."""
    rows = []
    with jax.enable_x64(True):
        for name, asymmetry in (("isotropic", 0.0), ("haze", ASYMMETRY)):
            for albedo in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99):
                share = np.asarray(by_orders(albedo, 300, asymmetry))
                share = share / share.sum()
                beyond = {str(n): float(share[n:].sum()) for n in (1, 2, 10)}
                rows.append({"phase": name, "albedo": albedo, "beyond": beyond})
    return rows


def report(result: dict[str, Any]) -> str:
    """Three tables."""
    best = {
        dtype: min(
            row["hot [ms/slab]"]
            for row in result["speed"]
            if row["dtype"] == dtype and row["program"].startswith("radiance, blocks")
        )
        for dtype in DTYPES
    }
    keys = ("hot [ms/slab]", "nanodisort [ms/slab]", "first [s]", "compile [s]", "memory [MB]")
    lines = [
        [
            row["dtype"],
            row["program"],
            *(f"{row[key]:.3g}" for key in keys),
            f"{row[keys[0]] / best[row['dtype']]:.2f}",
        ]
        for row in result["speed"]
    ]
    tables = [markdown(["precision", "program", *keys, "times the best radiance"], lines)]
    lines = [
        [
            row["method"],
            f"{row['albedo']:g}",
            f"{1e3 * row['seconds']:.3g}",
            f"{row['error of reflectance']:.1e}",
            "" if row["error of radiance"] is None else f"{row['error of radiance']:.1e}",
        ]
        for row in result["methods"]
    ]
    head = ["method", "albedo", "ms", "error of reflectance", "largest error of radiance"]
    tables.append(markdown(head, lines))
    lines = [
        [row["phase"], f"{row['albedo']:g}", *(f"{share:.1%}" for share in row["beyond"].values())]
        for row in result["orders"]
    ]
    tables.append(markdown(["phase", "albedo", "beyond once", "twice", "10 times"], lines))
    return "\n\n".join(tables) + "\n"


def draw(path: Path, result: dict[str, Any]) -> None:
    """Error against time, error of radiance by streams, orders by albedo."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    kinds = (
        ("orders", "o-", "orders of scattering, 1 to 300"),
        ("float32", "s-", "doubling, 8 to 64 streams, single"),
        ("float64", "D-", "doubling, double precision"),
        ("nanodisort", "^-", "nanodisort, 8 to 32 streams"),
        ("random", "*", "random walk"),
    )
    for kind, style, label in kinds:
        some = [
            row
            for row in result["methods"]
            if row["albedo"] == 0.99
            and (kind in row["method"] or (kind == "orders" and "single" in row["method"]))
        ]
        times, errors = ([row[key] for row in some] for key in ("seconds", "error of reflectance"))
        left.loglog(1e3 * np.asarray(times), errors, style, label=label)
    left.set(xlabel="time of one slab [ms]", ylabel="relative error of the reflectance [-]")
    left.set_title("albedo .99, depth 10, asymmetry .85", fontsize=10)
    left.set_ylim(1e-13, 3.0)
    left.legend(fontsize=8, loc="lower left")
    zenith = np.radians(np.linspace(91.0, 179.0, 90))
    with jax.enable_x64(True):
        radiance = {
            streams: np.asarray(solved(DEPTH, 0.99, ASYMMETRY, streams, "float64", zenith)[1])
            for streams in (4, 8, 16, 32, 64)
        }
    for streams, color in ((4, "0.6"), (8, "C2"), (16, "C1"), (32, "C0")):
        error = np.abs(radiance[streams] / radiance[64] - 1).max(axis=1)
        middle.semilogy(180 - np.degrees(zenith), error, color=color, label=f"{streams} streams")
    middle.set(
        xlabel="angle from the normal [°]",
        ylabel="largest relative error over azimuth [-]",
        title="reflected radiance, same slab",
    )
    middle.title.set_fontsize(10)
    middle.legend(fontsize=8)
    for phase, style in (("isotropic", "-"), ("haze", "--")):
        rows = [row for row in result["orders"] if row["phase"] == phase]
        for n, color in (("1", "C0"), ("2", "C1"), ("10", "C3")):
            times = {"1": "once", "2": "twice", "10": "10 times"}[n]
            shares = [100 * row["beyond"][n] for row in rows]
            label = f"more than {times}, {phase}"
            right.plot([row["albedo"] for row in rows], shares, style, color=color, label=label)
    right.set(xlabel="single scattering albedo [-]", ylabel="share of the reflected light [%]")
    right.set_title("depth 10, sun at 60°; haze: asymmetry .85", fontsize=10)
    right.legend(fontsize=8)
    replace_file(path, lambda name: figure.savefig(name, dpi=110))


if __name__ == "__main__":
    main(tyro.cli(Config))
