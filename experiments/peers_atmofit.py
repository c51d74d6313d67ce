"""The same skies with atmofit: round or flat, one order of scattering or all."""

import functools
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from peers_scene import Scene, Skies, median_seconds

import atmofit as af
from atmofit.sky.plan import Plan

# Optical depths are linear between wavelengths so close: a power law is then within 2e-5.
_STEP_NM = 1.0


def atmofit_sky(
    scene: Scene,
    rung: float = 1e-2,
    orders: int | str = "all",
    geometry: str = "spherical",
    *,
    every_wavelength: bool = True,
    dtype: str = "float32",
    repeats: int = 1,
    patience: float = 60.0,
) -> Skies:
    """Radiance of single scattering, or of all orders, by one program for all skies.

    A load's light is solved for once and serves all suns.

    Args:
        scene: What is computed; nothing in it absorbs but the haze.
        rung: Of the ladder.
        orders: 1 or "all".
        geometry: "spherical" or "flat".
        every_wavelength: Compute each, not a few between which radiance is interpolated.
        dtype: "float32"; or "float64", which needs JAX's 64-bit mode.
        repeats: Hot calls, see `median_seconds`.
        patience: See there.

    Returns:
        Radiance, time of a hot call and of the compilation.

    Raises:
        ValueError: There is an absorber.
    """
    if scene.absorbs:
        raise ValueError("absorber_optical_depth must be 0: atmofit_sky takes no absorber")
    dense, molecules, loads = _dense_depths(scene)
    air = functools.partial(_air, scene, geometry, dense, molecules)
    plan = _plan(scene, air(loads[0]), rung, orders, every_wavelength, dtype)
    given = loads.astype(dtype), scene.wavelength_nm.astype(dtype)
    begin = time.perf_counter()
    compiled = jax.jit(_program(scene, plan, air)).lower(*given).compile()
    compile_seconds = time.perf_counter() - begin
    found: list[np.ndarray] = []
    seconds = median_seconds(
        lambda: found.append(np.asarray(compiled(*given), float)), repeats, patience
    )
    radiance = np.swapaxes(found[-1], 0, 1)
    return Skies(radiance, seconds / scene.sky_count, compile_seconds)


def _program(
    scene: Scene, plan: Plan, air: Callable[[jax.Array], af.Atmosphere]
) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Radiance [load, sun, ring, azimuth, wavelength] of optical depths and wavelengths."""
    suns = jnp.asarray(scene.solar_zenith_angle, plan.dtype)
    grid = af.DirectionGrid(
        jnp.asarray(scene.view_zenith_angle, plan.dtype),
        jnp.asarray(scene.relative_azimuth, plan.dtype),
    )

    def skies(loads: jax.Array, wavelength: jax.Array) -> jax.Array:
        def of_load(load: jax.Array) -> jax.Array:
            field = af.solve_sky(air(load), wavelength, plan=plan)
            return jax.vmap(lambda sun: field.radiance(sun, grid, 1.0))(suns)

        # One load after the other: what belongs to one stays in the processor's cache.
        return jax.lax.map(of_load, loads)

    return skies


def _plan(
    scene: Scene,
    air: af.Atmosphere,
    rung: float,
    orders: int | str,
    every_wavelength: bool,
    dtype: str,
) -> Plan:
    """Of a rung; it knows the suns."""
    return af.plan_sky(
        air,
        solar_zenith_angle=scene.solar_zenith_angle,
        orders=orders,
        rtol=rung,
        dtype=dtype,
        all_wavelengths=every_wavelength,
    )


def _air(
    scene: Scene, geometry: str, dense: np.ndarray, molecules: np.ndarray, load: jax.Array
) -> af.Atmosphere:
    """The scene's air with one haze load."""
    return af.Atmosphere(
        af.Molecules(af.Spectrum(dense, molecules, smooth=True), scene.molecules_scale_height),
        af.Haze(
            af.Spectrum(dense, load, smooth=True),
            scale_height=scene.haze_scale_height,
            single_scattering_albedo=scene.single_scattering_albedo,
            phase=af.HenyeyGreenstein(scene.asymmetry),
        ),
        ground=af.Ground(scene.ground_albedo) if scene.ground_albedo > 0 else None,
        geometry=geometry,
        radius=scene.radius,
    )


def _dense_depths(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavelengths and optical depths of molecules and of each haze load, power laws in between."""
    asked = scene.wavelength_nm
    dense = np.union1d(asked, np.arange(asked[0], asked[-1], _STEP_NM))
    depths = np.stack([scene.molecules_optical_depth, *scene.haze_optical_depth])
    logs = [np.interp(np.log(dense), np.log(asked), log) for log in np.log(depths)]
    molecules, *loads = np.exp(logs)
    return dense, molecules, np.stack(loads)
