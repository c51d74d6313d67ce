"""The cheapest solver that integrates along given paths to within a tolerance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range, is_traced
from atmofit.media.low_air import LowAir
from atmofit.media.path_plan import NODES, PathPlan
from atmofit.media.transfer import LOWEST, Path, Ray, along, by_quadrature
from atmofit.numerics import gauss_nodes
from atmofit.typing import Reals, RealsLike, Scalar

# From cheap to dear, as measured (experiments/path_transfer.py).
LADDER = (
    PathPlan("constant", 0),
    PathPlan("horizontal", 0),
    *(PathPlan("gauss", nodes) for nodes in (2, 3, 4, 6, 8)),
    PathPlan("hermite", 0),
    *(PathPlan("gauss", nodes) for nodes in (12, 16, 24, 32)),
)
_FINEST_NODES = NODES[-1]
_LEAST_RTOL = 1e-9
_MARGIN = 1.3  # between the paths of a sample the error may be that much larger
_DISTANCES, _ANGLES, _ALTITUDES = 12, 17, 3


def plan_path(
    air: LowAir,
    distance: tuple[RealsLike, RealsLike],
    view_zenith_angle: tuple[RealsLike, RealsLike],
    observer_altitude: tuple[RealsLike, RealsLike] = (0.0, 0.0),
    rtol: float = 1e-3,
) -> PathPlan:
    """Choose the cheapest solver for all paths within some ranges.

    Every solver is tried on paths that span the ranges, and compared with 64 nodes. The error is
    the largest relative one of an integral, or the largest absolute one of a transmittance, over
    paths, scatterers and wavelengths, in double precision: single adds about 1e-6. The paper's
    Hermite form is among the solvers, and is refused where it is wrong as any other.

    Args:
        air: Its thickest wavelengths matter most.
        distance: Shortest and longest [m].
        view_zenith_angle: Least and largest [rad]; from high up to the way down.
        observer_altitude: Lowest and highest [m].
        rtol: Tolerance, 1e-9 to 1.

    Returns:
        The plan, with the errors of all solvers, from cheap to dear.

    Raises:
        TypeError: A range or the air is a tracer.
        ValueError: A range is empty or outside `Path`'s, the tolerance is out of range, or no
            solver meets it.
    """
    ranges = {
        "distance": distance,
        "view_zenith_angle": view_zenith_angle,
        "observer_altitude": observer_altitude,
    }
    for name, ends in (*ranges.items(), ("air", jax.tree.leaves(air))):
        if is_traced(*ends):
            raise TypeError(f"{name} of plan_path must be known, got a tracer")
    for name, (low, high) in ranges.items():
        if not np.asarray(low) <= np.asarray(high):
            raise ValueError(f"{name} must be a least and a largest value, got {(low, high)}")
    in_range("rtol", rtol, _LEAST_RTOL, 1.0)
    with jax.enable_x64(True):
        known = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, float)), air)
        paths = _sample(*(np.asarray(ends, float) for ends in ranges.values()))
        errors = [_MARGIN * float(error) for error in _errors(known, paths)]
    named = tuple((plan.name, error) for plan, error in zip(LADDER, errors, strict=True))
    for plan, error in zip(LADDER, errors, strict=True):
        if error <= rtol:
            return PathPlan(plan.solver, plan.nodes, rtol, named)
    raise ValueError(
        f"rtol must be at least {errors[-1]:.1e} on these paths, the error of the finest "
        f"solver, got {rtol:g}"
    )


def _sample(
    distance: np.ndarray, view_zenith_angle: np.ndarray, observer_altitude: np.ndarray
) -> Path:
    """Paths that span the ranges, each cut where it meets the ground."""
    low, high = distance
    share = np.linspace(0.0, 1.0, _DISTANCES)
    floor = max(low, 1e-3 * high, 1e-6)
    lengths = np.append(low, floor * (max(high, floor) / floor) ** share)
    angles = np.linspace(view_zenith_angle[0], view_zenith_angle[1], _ANGLES)
    altitudes = np.unique(np.linspace(observer_altitude[0], observer_altitude[1], _ALTITUDES))
    s, z, h = (x.ravel() for x in np.meshgrid(lengths, angles, altitudes, indexing="ij"))
    down = -np.minimum(np.cos(z), 0.0)
    to_ground = np.where(down > 0, (h - LOWEST) / np.where(down > 0, down, 1.0), np.inf)
    path = Path(np.minimum(s, to_ground), z, h)
    return path.checked()


@eqx.filter_jit
def _errors(air: LowAir, path: Path) -> list[Scalar]:
    """Of every solver of the ladder; all quadratures are one program."""
    ray = Ray.of(air, path)
    counts = [plan.nodes for plan in LADDER if plan.nodes] + [_FINEST_NODES]
    rules = np.zeros((2, len(counts), _FINEST_NODES))
    for k, count in enumerate(counts):
        rules[:, k, :count] = gauss_nodes(count)
    quadratures = jax.lax.map(lambda rule: by_quadrature(ray, *rule), tuple(jnp.asarray(rules)))
    passing, exact = jnp.exp(-ray.depth(ray.distance)), quadratures[-1]
    found, number = [], 0
    for plan in LADDER:
        if plan.nodes:
            found.append(_largest(quadratures[number], exact))
            number += 1
        else:
            transmittance, integrals = along(air, path, plan)
            off = jnp.max(jnp.abs(transmittance - passing))
            found.append(jnp.maximum(off, _largest(integrals, exact)))
    return found


def _largest(integrals: Reals, exact: Reals) -> Scalar:
    """Relative error; infinite where something overflows."""
    there = exact > 0
    relative = jnp.where(there, integrals / jnp.where(there, exact, 1.0) - 1, 0.0)
    return jnp.nan_to_num(jnp.max(jnp.abs(relative)), nan=jnp.inf)
