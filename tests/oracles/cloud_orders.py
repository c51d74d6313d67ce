"""Light by orders of scattering from a uniform box of cloud, by a random walk of photons.

Every photon starts at its first collision, and at each collision the chance is counted that it
leaves toward the eye. Shares no code with the library.

Conventions: the box has a corner at the origin; directions are unit vectors, to the sun and to the
eye; the phase function integrates to 1 over the sphere [1/sr] and takes the cosine of the
scattering angle (1 = forward).
"""

from collections.abc import Callable

import numpy as np

from oracles import Reals

_TABLE = 20001


def cloud_orders(
    edges: Reals,
    extinction: float,
    phase: Callable[[Reals], Reals],
    sun: Reals,
    eye: Reals,
    *,
    photons: int,
    orders: int,
    seed: int = 0,
) -> tuple[Reals, Reals]:
    """Radiant intensity toward the eye, for a sun of unit irradiance and albedo 1.

    Args:
        edges: Of the box [m], [3].
        extinction: [1/m].
        phase: [1/sr] by cosine.
        sun: Direction to the sun.
        eye: Direction to the eye.
        photons: To follow.
        orders: Of scattering.
        seed: Of the random numbers.

    Returns:
        Intensity by order from the first [m2/sr], and its standard error.
    """
    random = np.random.default_rng(seed)
    cosine = np.cos(np.pi * np.linspace(1, 0, _TABLE) ** 2)  # dense where it is forward
    middle = phase((cosine[1:] + cosine[:-1]) / 2)
    below = np.concatenate([[0.0], np.cumsum(middle * np.diff(cosine))])
    place = random.random((photons, 3)) * edges
    # All first collisions at even places, weighted by what comes there.
    weight = extinction * np.prod(edges) * np.exp(-extinction * _way(place, sun, edges))
    travel = np.broadcast_to(-sun, place.shape)
    mean, error = np.zeros(orders), np.zeros(orders)
    for order in range(orders):
        seen = weight * phase(travel @ eye) * np.exp(-extinction * _way(place, eye, edges))
        mean[order], error[order] = seen.mean(), seen.std() / np.sqrt(photons)
        drawn = np.interp(random.random(photons) * below[-1], below, cosine)
        travel = _turned(travel, drawn, 2 * np.pi * random.random(photons))
        room = _way(place, travel, edges)
        # The next collision is forced to happen inside; what would have left is taken off.
        inside = -np.expm1(-extinction * room)
        step = -np.log1p(-random.random(photons) * inside) / extinction
        weight, place = weight * inside, place + step[:, None] * travel
    return mean, error


def _way(place: Reals, direction: Reals, edges: Reals) -> Reals:
    """Distance to the outline."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.where(direction > 0, (edges - place) / direction, -place / direction)
    return np.maximum(np.min(np.where(direction == 0, np.inf, ways), axis=-1), 0.0)


def _turned(travel: Reals, cosine: Reals, azimuth: Reals) -> Reals:
    """Directions turned by a scattering angle."""
    helper = np.where(np.abs(travel[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(travel, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(travel, across)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    side = np.cos(azimuth)[:, None] * across + np.sin(azimuth)[:, None] * other
    new = cosine[:, None] * travel + sine[:, None] * side
    return new / np.linalg.norm(new, axis=1, keepdims=True)
