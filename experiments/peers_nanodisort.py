"""The same skies by discrete ordinates in a flat atmosphere, with nanodisort."""

import math
import time

import nanodisort
import numpy as np
from peers_scene import Scene, Skies

# Without any absorption an eigenvalue is 0, and one problem in hundreds gave NaN with 48 streams.
# What this absorbs changes radiances by less than 1e-9.
LARGEST_ALBEDO = 1 - 1e-10


def nanodisort_sky(
    scene: Scene,
    streams: int = 16,
    layers: int = 30,
    *,
    accuracy: float = 0.0,
    threads: int = 2,
) -> Skies:
    """Radiance of a flat atmosphere, all orders.

    Once scattered light has the whole phase function, not `streams` moments of it (Nakajima and
    Tanaka 1988, J. Quant. Spectrosc. Radiat. Transfer 40, 51).

    Args:
        scene: What is computed; all loads and wavelengths of a sun are one batch.
        streams: Even.
        layers: Homogeneous, cut from the continuous profiles.
        accuracy: Where the azimuthal series ends, relative; 0 takes as many terms as streams.
        threads: At work at once.

    Returns:
        Radiance and time.
    """
    start = time.perf_counter()
    suns, loads, rings, azimuths, wavelengths = scene.shape
    solver = _solver(scene, streams, layers, threads)
    solver.accur = accuracy
    thickness, albedo, moments = _layers(scene, layers, solver.nmom + 1)
    batch = loads * wavelengths
    radiance = np.empty(scene.shape)
    for sun in range(suns):
        solver.umu0 = math.cos(scene.solar_zenith_angle[sun])
        solver.allocate(batch)
        solver.set_dtauc(thickness)
        solver.set_ssalb(albedo)
        solver.set_pmom(moments)
        solver.set_fbeam(np.ones(batch))
        solver.set_albedo(np.full(batch, scene.ground_albedo))
        # The solver adds the layers up one by one, and so does cumsum: the last bit agrees.
        solver.set_utau_batched(np.cumsum(thickness, axis=1)[:, -1:].copy())
        solver.solve()
        found = solver.uu[:, :, 0].reshape(loads, wavelengths, rings, azimuths)
        radiance[sun] = np.moveaxis(found, 1, -1)
    return Skies(radiance, (time.perf_counter() - start) / scene.sky_count)


def _solver(scene: Scene, streams: int, layers: int, threads: int) -> nanodisort.BatchSolver:
    """A solver that knows the directions."""
    if np.any(np.diff(scene.view_zenith_angle) <= 0):
        raise ValueError(f"view_zenith_angle must rise, got {scene.view_zenith_angle}")
    if streams % 2 or streams < 4:
        raise ValueError(f"streams must be even and at least 4, got {streams}")
    solver = nanodisort.BatchSolver(nthreads=threads)
    solver.nstr, solver.nlyr, solver.ntau = streams, layers, 1
    solver.nmom = scene.moment_count(streams + 1) - 1
    solver.numu, solver.nphi = scene.view_zenith_angle.size, scene.relative_azimuth.size
    solver.usrtau = solver.usrang = solver.lamber = solver.quiet = True
    solver.onlyfl = solver.planck = solver.spher = False
    solver.phi0 = 0.0
    # The newer correction needs a table of the phase function, which a batch cannot be given.
    solver.intensity_correction = solver.old_intensity_correction = True
    # Directions are those in which light travels, so downward is negative; they must rise.
    solver.set_umu(-np.cos(scene.view_zenith_angle))
    solver.set_phi(np.degrees(scene.relative_azimuth))
    return solver


def _layers(scene: Scene, count: int, moments: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Optical depth, albedo [batch, layer], Legendre moments [moment, layer, batch]; top down."""
    edges = scene.edges(count)[::-1]
    share = -np.diff(scene.column_below(edges), axis=1)
    parts = scene.optical_depths[:, :, None] * share[:, None, :]  # [constituent, batch, layer]
    scattering = parts[:2] * np.array([1.0, scene.single_scattering_albedo])[:, None, None]
    thickness = parts.sum(axis=0)
    total = scattering.sum(axis=0)
    mixture = scattering / np.where(total > 0, total, 1.0)
    phase = np.einsum("cbl,cm->mlb", mixture, scene.moments(moments))
    phase[0] = 1.0
    # A layer without any matter scatters nothing.
    albedo = np.minimum(total / np.where(thickness > 0, thickness, 1.0), LARGEST_ALBEDO)
    return thickness, albedo, np.asfortranarray(phase)
