"""All orders of scattering in a flat slab by a random walk of photons, with standard errors.

A photon's next collision depends on nothing but where it is and where it goes: a Markov chain. The
walk is that of a slab that absorbs nothing; after n collisions a photon counts albedo^n, so that
one walk serves every albedo, and tells the orders apart. Shares no code with the library.

Conventions: directions are those looked in, against the light's, so that the sun's is the first;
the third axis points up, the first has the sun's azimuth, and optical depth counts from the top.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from oracles import Reals


@dataclasses.dataclass(frozen=True)
class SlabWalk:
    """Where photons went, as shares or radiances of a slab that absorbs nothing.

    Attributes:
        up: Share that left by the top, [batch, order].
        down: Share that left below, [batch, order].
        seen: Radiance over the irradiance across the sun's rays [1/sr], [batch, order, view].
        left: Share that was still inside after the last order.
    """

    up: Reals
    down: Reals
    seen: Reals
    left: float

    def reflectance(self, albedo: float) -> tuple[Reals, Reals]:
        """Share that comes back, and its standard error."""
        return _of_orders(self.up[..., None], albedo)

    def diffuse_transmittance(self, albedo: float) -> tuple[Reals, Reals]:
        """Share that arrives below after one collision or more, and its standard error."""
        return _of_orders(self.down[..., None], albedo, first=1)

    def direct_transmittance(self) -> tuple[Reals, Reals]:
        """Share that arrives below without collision, and its standard error."""
        return _mean(self.down[:, :1])

    def radiance(self, albedo: float) -> tuple[Reals, Reals]:
        """Radiance by view [1/sr], and its standard error."""
        return _of_orders(self.seen, albedo)

    def by_order(self) -> tuple[tuple[Reals, Reals], tuple[Reals, Reals]]:
        """Shares up and down by order from 0, albedo 1, with their standard errors."""
        return _mean(self.up), _mean(self.down)


def walk_slab(
    optical_depth: float,
    asymmetry: float,
    solar_zenith_angle: float,
    *,
    views: Sequence[tuple[float, float]] = (),
    photons: int = 100_000,
    batches: int = 25,
    orders: int = 400,
    seed: int = 1,
) -> SlabWalk:
    """Send photons through a homogeneous slab that scatters after Henyey and Greenstein.

    Args:
        optical_depth: Vertical [-].
        asymmetry: Mean cosine of the scattering angle [-].
        solar_zenith_angle: Below pi/2 [rad].
        views: View zenith angle (under pi/2: from below, looking up) and relative azimuth [rad];
            each collision sends there what it would (next-event estimation).
        photons: In all batches together.
        batches: Parts whose scatter gives the standard errors.
        orders: Collisions after which a walk is given up.
        seed: Of the random numbers.
    """
    random = np.random.default_rng(seed)
    sun = _direction(solar_zenith_angle, 0.0)
    toward = np.array([_direction(*view) for view in views]).reshape(-1, 3)
    each = photons // batches
    up, down = np.zeros((2, batches, orders + 1))
    seen = np.zeros((batches, orders + 1, len(toward)))
    left = 0
    for batch in range(batches):
        direction = np.tile(sun, (each, 1))
        depth = np.zeros(each)
        for order in range(orders + 1):
            depth = depth + random.standard_exponential(depth.size) * direction[:, 2]
            above, below = depth < 0, depth > optical_depth
            up[batch, order], down[batch, order] = above.sum() / each, below.sum() / each
            inside = ~(above | below)
            depth, direction = depth[inside], direction[inside]
            if not depth.size or order == orders:
                break
            sent = _sent(depth, direction, toward, optical_depth, asymmetry)
            seen[batch, order + 1] = sun[2] / each * sent
            direction = _scattered(random, direction, asymmetry)
        left += depth.size
    return SlabWalk(up, down, seen, left / (each * batches))


def _direction(zenith: float, azimuth: float) -> Reals:
    across = np.sin(zenith)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(zenith)])


def _sent(
    depth: Reals, direction: Reals, toward: Reals, optical_depth: float, asymmetry: float
) -> Reals:
    """Sum over the photons of what their next collision sends to each view."""
    total = np.zeros(len(toward))
    for k, view in enumerate(toward):
        way = (optical_depth - depth if view[2] > 0 else depth) / abs(view[2])
        spread = 1 + asymmetry**2 - 2 * asymmetry * (direction @ view)
        phase = (1 - asymmetry**2) / (4 * np.pi * spread**1.5)
        total[k] = np.sum(phase * np.exp(-way)) / abs(view[2])
    return total


def _scattered(random: np.random.Generator, direction: Reals, asymmetry: float) -> Reals:
    """New directions: the inverse of the cumulated phase function, about the old ones."""
    chance, turn = random.uniform(size=(2, len(direction)))
    if abs(asymmetry) < 1e-6:
        cosine = 2 * chance - 1
    else:
        part = (1 - asymmetry**2) / (1 - asymmetry + 2 * asymmetry * chance)
        cosine = (1 + asymmetry**2 - part**2) / (2 * asymmetry)
    cosine = np.clip(cosine, -1, 1)
    sine, azimuth = np.sqrt(1 - cosine**2), 2 * np.pi * turn
    # An axis across each direction that is never parallel to it.
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(direction, first)
    across = np.cos(azimuth)[:, None] * first + np.sin(azimuth)[:, None] * second
    found = cosine[:, None] * direction + sine[:, None] * across
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def _of_orders(tally: Reals, albedo: float, first: int = 0) -> tuple[Reals, Reals]:
    weight = albedo ** np.arange(tally.shape[1])
    weight[:first] = 0
    return _mean(np.einsum("n,bnv->bv", weight, tally))


def _mean(tally: Reals) -> tuple[Reals, Reals]:
    """Mean over the batches, and its standard error."""
    return tally.mean(axis=0), tally.std(axis=0, ddof=1) / np.sqrt(len(tally))
