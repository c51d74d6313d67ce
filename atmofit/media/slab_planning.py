"""The fewest streams and modes that meet a tolerance, found by trying."""

import itertools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from atmofit.checks import is_traced
from atmofit.geometry import DirectionGrid
from atmofit.media.doubling import doublings_for
from atmofit.media.slab_plan import SlabPlan
from atmofit.media.slab_solution import Slabs, checked_slabs, solve_slab
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import RealsLike

_LADDER = (8, 16, 32, 64, 128)
_FLOOR = 1e-12  # radiance over irradiance that counts for nothing
# Where a plan is tried: away from its sun and toward it, steep and grazing, both sides.
_ZENITHS = np.radians([5.0, 30.0, 55.0, 75.0, 85.0, 95.0, 105.0, 125.0, 150.0, 175.0])
_AZIMUTHS = np.radians([0.0, 20.0, 60.0, 120.0, 180.0])


def plan_slab(
    *,
    optical_depth: RealsLike,
    single_scattering_albedo: RealsLike,
    phase: PhaseFunction | tuple[PhaseFunction, ...],
    solar_zenith_angle: RealsLike,
    ground_albedo: RealsLike | None = None,
    rtol: float = 1e-2,
) -> SlabPlan:
    """Plan for one slab whose values are known.

    Streams are doubled from 8 to 64 until twice as many change no radiance in 50 directions (to 85
    degrees from the normal) by more than `rtol`; then azimuthal modes are left out whose terms
    together are below a tenth of that. An error found by trying, not a bound.

    Args:
        optical_depth: As for `solve_slab`, known.
        single_scattering_albedo: Likewise.
        phase: Likewise.
        solar_zenith_angle: Likewise.
        ground_albedo: Likewise.
        rtol: Largest relative change, above 0 [-].

    Returns:
        The plan, with the changes that were found and what is left out.

    Raises:
        TypeError: An argument is traced.
        ValueError: An argument is out of range, or 64 streams miss the tolerance.
    """
    slabs = checked_slabs(optical_depth, single_scattering_albedo, phase, ground_albedo)
    if is_traced(slabs, solar_zenith_angle):
        raise TypeError("the arguments of plan_slab must be known, not traced")
    if not 0 < rtol < math.inf:
        raise ValueError(f"rtol must be above 0, got {rtol}")
    sun = np.atleast_1d(np.asarray(solar_zenith_angle, float))
    thickest = float(np.max(np.asarray(slabs.optical_depth)))
    errors: list[tuple[int, float]] = []
    coarse = _radiance(slabs, sun, _plan(thickest, _LADDER[0]))
    for streams, finer in itertools.pairwise(_LADDER):
        fine = _radiance(slabs, sun, _plan(thickest, finer))
        errors.append((streams, _change(coarse, fine)))
        if errors[-1][1] <= rtol:
            return _fewest_modes(slabs, sun, thickest, streams, fine, rtol, tuple(errors))
        coarse = fine
    raise ValueError(f"rtol of plan_slab is not met by 64 streams, which leave {errors[-1][1]:.1e}")


def _plan(optical_depth: float, streams: int, modes: int | None = None, **words: Any) -> SlabPlan:
    doublings = doublings_for(optical_depth, streams)
    return SlabPlan(streams, modes or streams, doublings, **words)


def _radiance(slabs: Slabs, sun: np.ndarray, plan: SlabPlan) -> np.ndarray:
    solved = solve_slab(
        optical_depth=slabs.optical_depth,
        single_scattering_albedo=slabs.single_scattering_albedo,
        phase=slabs.phases,
        solar_zenith_angle=jnp.asarray(sun),
        ground_albedo=slabs.ground_albedo,
        plan=plan,
    )
    return np.asarray(solved.radiance(DirectionGrid(_ZENITHS, _AZIMUTHS)))


def _change(found: np.ndarray, other: np.ndarray) -> float:
    return float(np.max(np.abs(found - other) / np.maximum(np.abs(other), _FLOOR)))


def _fewest_modes(
    slabs: Slabs,
    sun: np.ndarray,
    thickest: float,
    streams: int,
    fine: np.ndarray,
    rtol: float,
    errors: tuple[tuple[int, float], ...],
) -> SlabPlan:
    """Halve the modes while that keeps the tolerance."""
    modes = streams
    while modes > 1:
        fewer = modes // 2
        if _change(_radiance(slabs, sun, _plan(thickest, streams, fewer)), fine) > rtol:
            break
        modes = fewer
    words = []
    if modes < streams:
        words.append(
            f"azimuthal modes from {modes} on, within the tolerance in all directions tried"
        )
    if slabs.ground_albedo is None:
        words.append("a ground, for there is none")
    return _plan(thickest, streams, modes, rtol=rtol, errors=errors, left_out=tuple(words))
