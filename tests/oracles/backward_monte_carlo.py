"""Oracle: any order of scattering by backward Monte Carlo, for one direction and one wavelength.

Paths start at the observer and are forced to collide (or to reach the ground): the distance is
drawn from a piecewise linear model of the extinction along the ray, and the weight is the exact
integrand over the drawn density, so the coarseness of the model costs variance and never bias. At
each collision the light that comes straight from the sun is added.

Measured with 200 000 paths and 3 orders on one core: 3 to 8 s; standard errors of orders 1, 2, 3
are 0.01, 0.3, 0.5 % (molecules, sun 60, view 30) and 0.2, 0.4, 0.8 % (with haze 0.1, sun 80, view
60). With 1.2 million paths orders 1 to 4 agree with an independent Monte Carlo within 1.8
standard errors (which are 0.11 and 0.18 % at order 2 in the two cases tried). In deep twilight
(sun 96) the errors are about 5 % with 100 000 paths.
"""

import numpy as np
from numpy.typing import NDArray

from oracles import ATMOSPHERE_TOP, EARTH_RADIUS, Absorber, Constituents, Reals, Scatterer

_PANELS = 64
_BATCH = 20_000
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_PARTS = ((0.0, 0.02), (0.02, 0.08), (0.08, 0.25), (0.25, 1.0))
_EDGES = (1 - np.cos(np.pi * np.arange(_PANELS + 1) / _PANELS)) / 2

Flags = NDArray[np.bool_]


class _Air:
    """Extinction, slant optical depth and phase functions at one wavelength."""

    def __init__(
        self,
        constituents: Constituents,
        wavelength_index: int,
        radius: float,
        top: float,
        spherical: bool,
    ) -> None:
        self.radius, self.top, self.spherical = radius, top, spherical
        at = wavelength_index
        self.index = np.array([at])
        scatterers = [c for c in constituents if isinstance(c, Scatterer)]
        self.absorbers = [c for c in constituents if isinstance(c, Absorber)]
        self.phases = [c.phase_function for c in scatterers]
        self.heights = np.array([c.scale_height for c in scatterers])
        self.depths = np.array([_pick(c.optical_depth, at) for c in scatterers])
        self.albedos = np.array([_pick(c.single_scattering_albedo, at) for c in scatterers])
        self.absorber_factors = [
            _pick(c.optical_depth, at) / _vertical(c, top) for c in self.absorbers
        ]

    def extinction(self, altitude: Reals) -> Reals:
        """Extinction of each scatterer [1/m], [..., scatterer]."""
        return self.depths / self.heights * np.exp(-altitude[..., None] / self.heights)

    def advance(self, position: Reals, direction: Reals, s: Reals) -> Reals:
        """Altitude [path, ...] at distances s [path, ...] along rays."""
        extra = (slice(None),) + (None,) * (s.ndim - 1)
        if not self.spherical:
            return position[:, 2][extra] - self.radius + direction[:, 2][extra] * s
        r = np.linalg.norm(position, axis=1)
        along = (position * direction).sum(axis=1)
        change = (2 * along[extra] + s) * s
        length = np.sqrt(r[extra] ** 2 + change)
        return (r - self.radius)[extra] + change / (length + r[extra])

    def up(self, position: Reals) -> Reals:
        """Local vertical."""
        if not self.spherical:
            return np.broadcast_to(np.array([0.0, 0.0, 1.0]), position.shape)
        return position / np.linalg.norm(position, axis=1, keepdims=True)

    def altitude(self, position: Reals) -> Reals:
        """Height above the ground."""
        r = np.linalg.norm(position, axis=1) if self.spherical else position[:, 2]
        return np.clip(r - self.radius, 0, self.top)

    def end(self, position: Reals, direction: Reals) -> tuple[Reals, Flags]:
        """Distance to where a ray leaves the air, and whether that is at the ground."""
        z = self.altitude(position)
        if not self.spherical:
            mu = direction[:, 2]
            return np.where(mu < 0, -z, self.top - z) / mu, mu < 0
        along = (position * direction).sum(axis=1)
        drop = along**2 - z * (2 * self.radius + z)
        ground = (along < 0) & (drop > 0)
        rise = (self.top - z) * (2 * self.radius + self.top + z)
        to_top = -along + np.sqrt(along**2 + rise)
        to_ground = (
            z * (2 * self.radius + z) / (np.sqrt(np.maximum(drop, 0)) + np.abs(along) + 1e-30)
        )
        return np.where(ground, to_ground, to_top), ground

    def depth(self, position: Reals, direction: Reals, length: Reals) -> Reals:
        """Slant optical depth over a length of each ray, split at the ray's lowest point."""
        lowest = np.zeros_like(length)
        if self.spherical:
            lowest = np.clip(-(position * direction).sum(axis=1), 0, length)
        total = np.zeros_like(length)
        # Each part is integrated from its lower end, where the air is densest, in growing steps.
        for start, end in ((lowest, np.zeros_like(length)), (lowest, length)):
            used = np.flatnonzero(start != end)
            span = (end - start)[used, None]
            for a, b in _PARTS if len(used) else ():
                s = start[used, None] + span * (a + (b - a) * (_NODES + 1) / 2)
                extinction = self._total(self.advance(position[used], direction[used], s))
                total[used] += np.abs(span[:, 0]) * (b - a) / 2 * (extinction @ _WEIGHTS)
        return total

    def _total(self, altitude: Reals) -> Reals:
        """Extinction of everything [1/m]."""
        z = np.maximum(altitude, 0)
        absorption = sum(
            (f * c.density(z) for f, c in zip(self.absorber_factors, self.absorbers, strict=True)),
            np.zeros(1),
        )
        return self.extinction(z).sum(axis=-1) + absorption

    def sunlight(self, position: Reals, sun: Reals) -> Reals:
        """Transmittance toward the sun, 0 in the planet's shadow."""
        direction = np.broadcast_to(sun, position.shape)
        length, dark = self.end(position, direction)
        transmittance = np.zeros(len(position))
        lit = ~dark
        if lit.any():
            depth = self.depth(position[lit], direction[lit], length[lit])
            transmittance[lit] = np.exp(-depth)
        return transmittance

    def phase(self, scatterer: int, cosine: Reals) -> Reals:
        """Phase function of one scatterer [path]."""
        clipped = np.clip(cosine, -1, 1)[:, None]
        values = self.phases[scatterer](clipped, self.index[None, :])
        return np.broadcast_to(values, clipped.shape)[:, 0]

    def mixed_phase(self, shares: Reals, cosine: Reals) -> Reals:
        """Phase function of the mixture with the given shares [path, scatterer]."""
        every = [self.phase(c, cosine) for c in range(len(self.phases))]
        return (shares * np.stack(every, axis=1)).sum(axis=1)


def _pick(value: object, index: int) -> float:
    """The number, or the entry for one wavelength."""
    array = np.asarray(value, float)
    return float(array if array.ndim == 0 else array[index if array.size > 1 else 0])


def _vertical(absorber: Absorber, top: float) -> float:
    """Integral of the absorber's relative density from the ground to the top."""
    edges = np.linspace(0, top, 401)
    z = edges[:-1, None] + (edges[1] - edges[0]) * (_NODES + 1) / 2
    return float((absorber.density(z) @ _WEIGHTS).sum() * (edges[1] - edges[0]) / 2)


class _AngleSampler:
    """Draws cosines from a histogram of each scatterer's phase function."""

    def __init__(self, air: _Air) -> None:
        self.edges = np.cos(np.pi * np.linspace(0, 1, 2001) ** 2)
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        mass = np.stack([air.phase(c, middle) for c in range(len(air.phases))])
        mass *= self.edges[:-1] - self.edges[1:]
        self.cumulative = np.cumsum(mass, axis=1) / mass.sum(axis=1, keepdims=True)
        self.density = mass / mass.sum(axis=1, keepdims=True)
        self.density /= 2 * np.pi * (self.edges[:-1] - self.edges[1:])

    def draw(self, shares: Reals, rng: np.random.Generator) -> tuple[Reals, Reals]:
        """Cosines, and the density per solid angle with which the mixture draws them."""
        chosen = (rng.random((len(shares), 1)) > np.cumsum(shares, axis=1)[:, :-1]).sum(axis=1)
        bins = np.empty(len(shares), int)
        place = rng.random(len(shares))
        for c in range(shares.shape[1]):
            bins[chosen == c] = np.searchsorted(self.cumulative[c], place[chosen == c])
        bins = np.minimum(bins, self.cumulative.shape[1] - 1)
        upper, lower = self.edges[bins], self.edges[bins + 1]
        cosine = lower + (upper - lower) * rng.random(len(shares))
        return cosine, (shares * self.density[:, bins].T).sum(axis=1)


def _turn(direction: Reals, cosine: Reals, rng: np.random.Generator) -> Reals:
    """Unit vectors at the given angle from the directions, at random azimuth."""
    other = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(direction, other)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(direction, across)
    azimuth = 2 * np.pi * rng.random((len(direction), 1))
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))[:, None]
    turned = cosine[:, None] * direction
    turned += sine * (np.cos(azimuth) * across + np.sin(azimuth) * third)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _forced_distance(
    air: _Air, position: Reals, direction: Reals, length: Reals, rng: np.random.Generator
) -> tuple[Reals, Reals, Reals]:
    """Distances drawn from the piecewise linear model of the ray.

    Returns:
        The distance [m], its density [1/m], the model's optical depth of the whole ray.
    """
    edges = length[:, None] * _EDGES
    extinction = air.extinction(air.advance(position, direction, edges).clip(0)).sum(axis=-1)
    steps = np.diff(edges, axis=1)
    means = (extinction[:, 1:] + extinction[:, :-1]) / 2
    depth = np.concatenate([np.zeros((len(length), 1)), np.cumsum(means * steps, axis=1)], axis=1)
    # The forced collision is exponential in the model's depth.
    drawn = -np.log1p(rng.random(len(length)) * np.expm1(-depth[:, -1]))
    panel = np.clip((depth <= drawn[:, None]).sum(axis=1) - 1, 0, _PANELS - 1)
    row = np.arange(len(length))
    here, step = extinction[row, panel], steps[row, panel]
    slope = (extinction[row, panel + 1] - here) / step
    left = np.maximum(drawn - depth[row, panel], 0)
    root = np.sqrt(np.maximum(here**2 + 2 * slope * left, 0))
    part = np.minimum(2 * left / (here + root), step)
    density = (here + slope * part) * np.exp(-drawn) / -np.expm1(-depth[:, -1])
    return edges[row, panel] + part, density, depth[:, -1]


def _sky_batch(
    air: _Air,
    albedo: float,
    sun: Reals,
    view: Reals,
    orders: int,
    count: int,
    rng: np.random.Generator,
) -> Reals:
    """Contributions of each path to each order [path, order]."""
    sampler = _AngleSampler(air)
    position = np.tile([0.0, 0.0, air.radius], (count, 1))
    direction = np.tile(view, (count, 1))
    weight = np.ones(count)
    found = np.zeros((count, orders))
    for order in range(orders):
        length, ground = air.end(position, direction)
        s, density, model_depth = _forced_distance(air, position, direction, length, rng)
        reflected = np.where(ground, albedo * np.exp(-model_depth), 0.0)
        chance = reflected / (reflected - np.expm1(-model_depth))
        landed = rng.random(count) < chance
        s = np.where(landed, length, s)
        weight *= np.exp(-air.depth(position, direction, s))
        position = position + s[:, None] * direction
        scattering = air.extinction(air.altitude(position)) * air.albedos
        total = scattering.sum(axis=1)
        shares = scattering / np.maximum(total, 1e-300)[:, None]
        weight *= np.where(
            landed, albedo / np.maximum(chance, 1e-300), total / density / (1 - chance)
        )
        light = air.sunlight(position, sun)
        up = air.up(position)
        toward_sun = np.where(
            landed, np.maximum(up @ sun, 0) / np.pi, air.mixed_phase(shares, direction @ sun)
        )
        found[:, order] = weight * light * toward_sun
        cosine, drawn = sampler.draw(shares, rng)
        scattered = _turn(direction, cosine, rng)
        weight *= np.where(landed, 1.0, air.mixed_phase(shares, cosine) / drawn)
        # From the ground, light arrives in proportion to the cosine.
        lambertian = _turn(up, np.sqrt(rng.random(count)), rng)
        direction = np.where(landed[:, None], lambertian, scattered)
    return found


def sky_radiance_monte_carlo(
    constituents: Constituents,
    solar_zenith_angle: float,
    view_zenith_angle: float,
    relative_azimuth: float,
    orders: int = 3,
    geometry: str = "spherical",
    albedo: float = 0.0,
    radius: float = EARTH_RADIUS,
    top: float = ATMOSPHERE_TOP,
    paths: int = 200_000,
    seed: int = 0,
    wavelength_index: int = 0,
) -> tuple[Reals, Reals]:
    """Downward radiance at the ground over solar irradiance, with standard errors.

    Args:
        constituents: Scatterers (at least one) and absorbers.
        solar_zenith_angle: [rad].
        view_zenith_angle: [rad], from 0 to pi/2 (flat: below pi/2).
        relative_azimuth: [rad], 0 toward the sun.
        orders: Number of orders, at least 1.
        geometry: "spherical" or "flat".
        albedo: Of the Lambertian ground [-]; a reflection counts as one order.
        radius: Of the planet [m].
        top: Altitude where the atmosphere ends [m].
        paths: Number of paths.
        seed: Of the random numbers.
        wavelength_index: Which entry to take of what varies with wavelength.

    Returns:
        Mean [order] and its standard error [order], sr^-1.

    Raises:
        ValueError: For an unknown geometry.
    """
    if geometry not in ("spherical", "flat"):
        raise ValueError(f"geometry must be 'spherical' or 'flat', got {geometry!r}")
    air = _Air(constituents, wavelength_index, radius, top, geometry == "spherical")
    sun = np.array([np.sin(solar_zenith_angle), 0.0, np.cos(solar_zenith_angle)])
    sine = np.sin(view_zenith_angle)
    view = np.array(
        [
            sine * np.cos(relative_azimuth),
            sine * np.sin(relative_azimuth),
            np.cos(view_zenith_angle),
        ]
    )
    rng = np.random.default_rng(seed)
    batches = [min(_BATCH, paths - first) for first in range(0, paths, _BATCH)]
    found = [_sky_batch(air, albedo, sun, view, orders, count, rng) for count in batches]
    values = np.concatenate(found)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(paths)
