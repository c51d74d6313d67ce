"""One slab by every method: doubling, discrete ordinates, successive orders, a random walk."""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import nanodisort
import numpy as np

import atmofit as af
from atmofit.media.doubling import doublings_for
from atmofit.media.scattering_orders import scattering_orders

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.slab_random_walk import walk_slab

DEPTH, ASYMMETRY, SUN = 10.0, 0.85, math.pi / 3
STEEP = np.radians(np.linspace(5.0, 85.0, 5))
ZENITHS = np.concatenate([STEEP, math.pi - STEEP[::-1]])
AZIMUTHS = np.linspace(0.0, math.pi, 5)
MOMENTS = 128  # for nanodisort: it corrects the first order by all that it is given
DTYPES = ("float32", "float64")


def solved(
    depth: Any,
    albedo: Any,
    asymmetry: Any,
    streams: int,
    dtype: str,
    zeniths: np.ndarray = ZENITHS,
) -> tuple[Any, Any]:
    """Reflectance and radiance in 10 x 5 directions by doubling."""
    found = af.solve_slab(
        optical_depth=jnp.asarray(depth, dtype),
        single_scattering_albedo=jnp.asarray(albedo, dtype),
        phase=af.HenyeyGreenstein(jnp.asarray(asymmetry, dtype)),
        solar_zenith_angle=jnp.asarray(SUN, dtype),
        plan=af.SlabPlan(streams, streams, doublings_for(DEPTH, streams)),
    )
    grid = af.DirectionGrid(jnp.asarray(zeniths, dtype), jnp.asarray(AZIMUTHS, dtype))
    return found.reflectance, found.radiance(grid)


def ordinates(albedo: np.ndarray, streams: int) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """The same by nanodisort, 2 threads, in double precision: a call that solves all slabs."""
    count = albedo.size
    solver = nanodisort.BatchSolver(nthreads=2)
    solver.nstr, solver.nlyr, solver.ntau, solver.nmom = streams, 1, 2, MOMENTS
    solver.numu, solver.nphi = ZENITHS.size, AZIMUTHS.size
    solver.usrtau = solver.usrang = solver.lamber = solver.quiet = True
    solver.onlyfl = solver.planck = solver.spher = False
    solver.intensity_correction = solver.old_intensity_correction = True
    solver.phi0, solver.accur, solver.umu0 = 0.0, 0.0, math.cos(SUN)
    # Directions of light's travel, rising.
    solver.set_umu(-np.cos(ZENITHS))
    solver.set_phi(np.degrees(AZIMUTHS))
    solver.allocate(count)
    solver.set_dtauc(np.full((count, 1), DEPTH))
    solver.set_ssalb(np.minimum(albedo, 1 - 1e-10)[:, None])
    moments = ASYMMETRY ** np.arange(MOMENTS + 1)
    solver.set_pmom(np.asfortranarray(np.tile(moments[:, None, None], (1, 1, count))))
    solver.set_fbeam(np.ones(count))
    solver.set_albedo(np.zeros(count))
    solver.set_utau_batched(np.tile([[0.0, DEPTH]], (count, 1)))

    def solve() -> tuple[np.ndarray, np.ndarray]:
        solver.solve()
        field = np.asarray(solver.uu)  # [slab, zenith, depth, azimuth]
        below = (np.cos(ZENITHS) > 0)[None, :, None]
        radiance = np.where(below, field[:, :, 1], field[:, :, 0])
        return np.asarray(solver.flup)[:, 0] / math.cos(SUN), radiance

    return solve


def ways(albedo: float, photons: int) -> list[tuple[str, str, Callable[[], Any]]]:
    """Names, precision and calls of all methods, for one albedo."""
    found: list[tuple[str, str, Callable[[], Any]]] = []
    for count in (1, 3, 10, 30, 100, 300):
        name = "single scattering" if count == 1 else f"{count} orders"
        found.append((name, "float64", lambda count=count: (by_orders(albedo, count).sum(), None)))
    for dtype in DTYPES:
        for streams in (8, 16, 32, 64):
            doubling = jax.jit(solved, static_argnums=(3, 4))
            name = f"doubling, {streams} streams, {dtype}"
            found.append(
                (
                    name,
                    dtype,
                    lambda d=doubling, s=streams, t=dtype: d(DEPTH, albedo, ASYMMETRY, s, t),
                )
            )
    for streams in (8, 16, 32):
        solve = ordinates(np.array([albedo]), streams)
        name = f"nanodisort, {streams} streams"
        found.append((name, "float64", lambda solve=solve: [x[0] for x in solve()]))
    views = [(zenith, azimuth) for zenith in ZENITHS for azimuth in AZIMUTHS]
    found.append(
        (f"random walk, {photons} photons", "float64", lambda: _walked(albedo, views, photons))
    )
    return found


def by_orders(albedo: float, count: int, asymmetry: float = ASYMMETRY) -> jax.Array:
    """Reflectance by order, 32 streams."""
    return scattering_orders(
        optical_depth=DEPTH,
        single_scattering_albedo=albedo,
        phase=af.HenyeyGreenstein(asymmetry),
        solar_zenith_angle=SUN,
        orders=count,
        streams=32,
    ).reflectance


def _walked(albedo: float, views: list[tuple[float, float]], photons: int) -> Any:
    walk = walk_slab(DEPTH, ASYMMETRY, SUN, views=views, photons=photons)
    return walk.reflectance(albedo)[0][0], walk.radiance(albedo)[0].reshape(10, 5)
