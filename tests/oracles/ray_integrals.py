"""Single scattering along straight rays, for the quadrature oracle.

Every integral along a ray is split at the ray's lowest point and at the edges of the planet's
shadow, and its Gauss nodes are stretched so that they crowd where the air is densest.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oracles import Absorber, Constituents, Reals, Scatterer
from oracles.slant_columns import (
    TINY,
    density_column,
    exponential_column,
    flat_exponential_column,
    gauss_legendre,
)

_STRETCH = np.linspace(1e-3, 40.0, 1000)
_LOG_STRETCH_SLOPE = np.log(_STRETCH / np.expm1(_STRETCH))
_SPACING = 10.0

Mask = NDArray[np.bool_]
Segment = tuple[Reals, Reals]


def stretched(start: Reals, end: Reals, scale: Reals, count: int) -> tuple[Reals, Reals]:
    """Nodes and positive weights from start to end [..., node], crowded toward start."""
    length = np.abs(end - start)
    slope = np.clip(_SPACING * scale / np.maximum(length, TINY), 1e-14, 0.999)
    # Any stretch is a valid change of variable, so a rough inverse is good enough.
    k = np.interp(-np.log(slope), -_LOG_STRETCH_SLOPE, _STRETCH)[..., None]
    x, w = gauss_legendre(count)
    nodes = start[..., None] + (end - start)[..., None] * np.expm1(k * x) / np.expm1(k)
    return nodes, length[..., None] * w * k * np.exp(k * x) / np.expm1(k)


@dataclasses.dataclass(frozen=True)
class Rays:
    """Straight rays and the sun, seen from their starting points; every field is [ray]."""

    altitude: Reals
    cos_zenith: Reals
    sun_cos_zenith: Reals
    cos_to_sun: Reals

    def __getitem__(self, mask: Mask) -> "Rays":
        return Rays(*(getattr(self, f.name)[mask] for f in dataclasses.fields(self)))


class Sky:
    """An atmosphere with its columns, and the integrals through it."""

    def __init__(
        self,
        constituents: Constituents,
        albedo: ArrayLike,
        radius: float,
        top: float,
        spherical: bool,
    ) -> None:
        self.radius, self.top, self.spherical = radius, top, spherical
        self.scatterers = [c for c in constituents if isinstance(c, Scatterer)]
        absorbers = [c for c in constituents if isinstance(c, Absorber)]
        depths = [np.asarray(c.optical_depth, float) for c in [*self.scatterers, *absorbers]]
        albedos = [np.asarray(c.single_scattering_albedo, float) for c in self.scatterers]
        shape = np.broadcast_shapes((1,), np.shape(albedo), *(a.shape for a in [*depths, *albedos]))
        self.wavelengths = np.arange(shape[0])
        self.depth = np.stack([np.broadcast_to(d, shape) for d in depths])
        self.scattering_depth = np.stack(
            [d * np.broadcast_to(a, shape) for d, a in zip(self.depth, albedos, strict=False)]
        )
        self.albedo = np.broadcast_to(np.asarray(albedo, float), shape)
        heights = [c.scale_height for c in self.scatterers]
        self.least_height = min(heights)
        self.heights = np.array(heights)
        exponential = (
            [exponential_column(h, radius, top) for h in heights]
            if spherical
            else [flat_exponential_column(h, top) for h in heights]
        )
        self.columns = exponential + [
            density_column(c.density, radius, top, spherical=spherical) for c in absorbers
        ]

    def upward_columns(self, altitude: Reals, cos_zenith: Reals) -> Reals:
        """Columns above of every constituent [..., constituent]."""
        return np.stack([column(altitude, cos_zenith) for column in self.columns], axis=-1)

    def columns_along(self, altitude: Reals, cos_zenith: Reals) -> Reals:
        """Columns from a point along a ray that misses the ground to the top [..., constituent]."""
        found = self.upward_columns(altitude, np.abs(cos_zenith))
        falling = cos_zenith < 0
        if self.spherical and falling.any():
            z, mu = altitude[falling], cos_zenith[falling]
            found[falling] = 2 * self._columns_at_tangent(z, mu) - found[falling]
        return found

    def _columns_at_tangent(self, altitude: Reals, cos_zenith: Reals) -> Reals:
        tangent = np.maximum(self._tangent(altitude, cos_zenith), 0)
        return self.upward_columns(tangent, np.zeros_like(tangent))

    def _tangent(self, altitude: Reals, cos_zenith: Reals) -> Reals:
        """Lowest altitude of the straight line through a point."""
        r = self.radius + altitude
        return altitude - r * cos_zenith**2 / (1 + np.sqrt(np.maximum(1 - cos_zenith**2, 0)))

    def advance(self, rays: Rays, s: Reals) -> tuple[Reals, Reals, Reals]:
        """Altitude, zenith cosine of the ray and of the sun at distances s [ray, node]."""
        z, mu, sun, g = (a[:, None] for a in dataclasses.astuple(rays))
        if not self.spherical:
            return z + mu * s, np.broadcast_to(mu, s.shape), np.broadcast_to(sun, s.shape)
        r0 = self.radius + z
        change = (2 * r0 * mu + s) * s
        r = np.sqrt(r0**2 + change)
        altitude = np.clip(z + change / (r + r0), 0, self.top)
        return altitude, np.clip((r0 * mu + s) / r, -1, 1), np.clip((r0 * sun + s * g) / r, -1, 1)

    def local_extinction(self, altitude: Reals) -> Reals:
        """Largest extinction coefficient of the wavelengths, without absorbers [1/m]."""
        density = np.exp(-altitude[:, None] / self.heights) / self.heights
        return density @ self.depth[: len(self.scatterers)].max(axis=1)

    def local_scale(self, altitude: Reals, cos_zenith: Reals) -> Reals:
        """Distance over which the radiance along a ray changes near a point [m]."""
        h = self.least_height
        slope = np.abs(cos_zenith) + (np.sqrt(h / (2 * self.radius)) if self.spherical else 0.0)
        return 1 / (slope / h + self.local_extinction(altitude))

    def hits_ground(self, rays: Rays) -> Mask:
        """Whether rays that start above the ground end there."""
        if not self.spherical:
            return rays.cos_zenith < 0
        return (rays.cos_zenith < 0) & (self._tangent(rays.altitude, rays.cos_zenith) < 0)

    def segments(self, rays: Rays, ground: Mask) -> list[Segment]:
        """Pieces of each ray with monotonic altitude: distances of the lower and the higher end."""
        z, mu = rays.altitude, rays.cos_zenith
        if not self.spherical:
            length = np.where(ground, -z / mu, (self.top - z) / mu)
            return [(np.where(ground, length, 0.0), np.where(ground, 0.0, length))]
        r = self.radius + z
        to_tangent = np.where((mu < 0) & ~ground, -r * mu, 0.0)
        vertical = (r * mu) ** 2
        to_ground = (vertical - z * (2 * self.radius + z)).clip(0)
        below = z * (2 * self.radius + z) / (np.abs(r * mu) + np.sqrt(to_ground) + TINY)
        rise = (self.top - z) * (2 * self.radius + self.top + z)
        to_top = rise / (np.sqrt(vertical + rise) + np.abs(r * mu) + TINY)
        to_top = np.where(mu < 0, 2 * np.abs(r * mu) + to_top, to_top)
        return [
            (np.where(ground, below, to_tangent), np.where(ground, 0.0, to_top)),
            (to_tangent, np.zeros_like(z)),
        ]

    def shadow(self, rays: Rays) -> Segment:
        """Distances where each ray enters and leaves the planet's shadow (equal: it does not)."""
        nowhere = np.zeros_like(rays.altitude)
        if not self.spherical:
            return nowhere, nowhere
        r, mu, sun, g = self.radius + rays.altitude, *dataclasses.astuple(rays)[1:]
        a, b = np.maximum(1 - g**2, 1e-12), r * (mu - sun * g)
        c = rays.altitude * (2 * self.radius + rays.altitude) - (r * sun) ** 2
        root = np.sqrt(np.maximum(b**2 - a * c, 0))
        enter, leave = (-b - root) / a, (-b + root) / a
        # Only the half of the cylinder that lies behind the planet is dark.
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = -r * sun / g
        enter = np.where(g < 0, np.maximum(enter, plane), enter).clip(0)
        leave = np.where(g > 0, np.minimum(leave, plane), leave)
        dark = (b**2 > a * c) & (leave > enter) & ((g != 0) | (sun < 0))
        return np.where(dark, enter, 0.0), np.where(dark, leave, 0.0)

    def emission(self, rays: Rays, nodes: int) -> Reals:
        """Sunlight scattered once into each ray, its phase function left out.

        Returns:
            Integral of scattering coefficient and both transmittances [ray, scatterer, wavelength].
        """
        shape = (len(rays.altitude), len(self.scatterers), len(self.wavelengths))
        total = np.zeros(shape)
        ground = self.hits_ground(rays)
        enter, leave = self.shadow(rays)
        shaded = leave > enter
        for low, high in self.segments(rays, ground):
            # Clipping leaves pieces of no length where a ray is not cut.
            far = np.maximum(low, high)
            first = np.where(shaded, enter, far)
            after = np.where(shaded, leave, far)
            pieces = [
                (np.minimum(low, first), np.minimum(high, first)),
                (np.maximum(low, after), np.maximum(high, after)),
            ]
            for start, end in pieces:
                # Where a falling ray is opaque, its near end matters as much as its lower end.
                altitude = self.advance(rays, start[:, None])[0][:, 0]
                opaque = (end < start) & (self.local_extinction(altitude) * (start - end) > 1)
                middle = np.where(opaque, (start + end) / 2, end)
                for piece in ((start, middle), (end, middle)):
                    used = np.abs(piece[1] - piece[0]) > 1e-3
                    if used.any():
                        part = (piece[0][used], piece[1][used])
                        total[used] += self._piece_emission(rays[used], ground[used], part, nodes)
        return total * self.scattering_depth[: shape[1]]

    def _piece_emission(self, rays: Rays, ground: Mask, piece: Segment, nodes: int) -> Reals:
        start, end = piece
        z, mu, _ = self.advance(rays, start[:, None])
        s, weights = stretched(start, end, self.local_scale(z[:, 0], mu[:, 0]), nodes)
        optical_depth, z = self.two_way_depth(rays, ground, s)
        transmittance = np.exp(-optical_depth, out=optical_depth)
        density = np.exp(-z[:, None, :] / self.heights[:, None]) / self.heights[:, None]
        return (density * weights[:, None, :]) @ transmittance

    def depth_to(self, rays: Rays, ground: Mask, z: Reals, mu: Reals) -> Reals:
        """Columns from the start of each ray to points on it [ray, node, constituent]."""
        from_start = self._ray_columns(rays.altitude[:, None], rays.cos_zenith[:, None], ground)
        return from_start - self._ray_columns(z, mu, ground)

    def _ray_columns(self, z: Reals, mu: Reals, ground: Mask) -> Reals:
        """Columns from points on rays to the far end, up to a constant for rays into the ground."""
        found = self.upward_columns(z, np.abs(mu))
        found[ground] *= -1
        turning = (mu < 0) & ~ground[:, None]
        if turning.any():
            found[turning] = 2 * self._columns_at_tangent(z[turning], mu[turning]) - found[turning]
        return found

    def two_way_depth(self, rays: Rays, ground: Mask, s: Reals) -> tuple[Reals, Reals]:
        """Optical depth start -> point -> sun [ray, node, wavelength], and the points' altitude."""
        z, mu, sun = self.advance(rays, s)
        columns = self.depth_to(rays, ground, z, mu) + self.columns_along(z, sun)
        return columns @ self.depth, z

    def phases(self, cosine: Reals) -> Reals:
        """Phase functions [scatterer, direction, wavelength] at cosines [direction]."""
        shape = (len(cosine), len(self.wavelengths))
        clipped = np.clip(cosine, -1, 1)[:, None]
        values = [c.phase_function(clipped, self.wavelengths[None, :]) for c in self.scatterers]
        return np.stack([np.broadcast_to(v, shape) for v in values])

    def single_scattering(self, rays: Rays, nodes: int) -> Reals:
        """Radiance of order 1 [ray, wavelength]."""
        channels = self.channels(rays, nodes)
        phases = np.moveaxis(self.phases(rays.cos_to_sun), 0, 1)
        return (channels[:, :-1] * phases).sum(axis=1) + channels[:, -1]

    def channels(self, rays: Rays, nodes: int) -> Reals:
        """Light from every scatterer without its phase function, and light from the ground.

        Returns:
            [ray, scatterers and then the ground, wavelength].
        """
        emission = self.emission(rays, nodes)
        reflected = np.zeros((len(rays.altitude), 1, len(self.wavelengths)))
        ground = self.hits_ground(rays)
        if self.albedo.any() and ground.any():
            reflected[ground, 0] = self._ground_radiance(rays[ground])
        return np.concatenate([emission, reflected], axis=1)

    def _ground_radiance(self, rays: Rays) -> Reals:
        """Sunlight reflected by the ground, seen through the air [ray, wavelength]."""
        every = np.ones(len(rays.altitude), bool)
        length = self.segments(rays, every)[0][0][:, None]
        _, mu, sun = self.advance(rays, length)
        sunlit = np.maximum(sun, 1e-9)
        floor = np.zeros_like(sun)
        columns = self.depth_to(rays, every, floor, mu) + self.upward_columns(floor, sunlit)
        transmittance = np.exp(-(columns @ self.depth)[:, 0])
        return self.albedo / np.pi * np.maximum(sun, 0) * transmittance
