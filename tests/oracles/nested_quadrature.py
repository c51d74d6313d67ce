"""Oracle: single and double scattering by direct nested quadrature, for one direction.

Order 1 is an integral along the view ray. Order 2 is an integral along the view ray, over all incoming
directions, of the single-scattered radiance there, which is again an integral along a ray. Nothing is
interpolated but the slant columns (splines of columns that were integrated numerically).
"""

import dataclasses
import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oracles import ATMOSPHERE_TOP, EARTH_RADIUS, Absorber, Constituents, Reals, Scatterer
from oracles.slant_columns import (
    density_column,
    exponential_column,
    flat_exponential_column,
    gauss_legendre,
)

_STRETCH = np.linspace(1e-3, 40.0, 1000)
_LOG_STRETCH_SLOPE = np.log(_STRETCH / np.expm1(_STRETCH))
_TINY = 1e-300
_NEAR_HORIZON = 0.1
_SPACING = 10.0

Mask = NDArray[np.bool_]
_Segment = tuple[Reals, Reals]


def _stretched(start: Reals, end: Reals, scale: Reals, count: int) -> tuple[Reals, Reals]:
    """Nodes and positive weights from start to end [..., node], spaced as `scale` asks for near start."""
    length = np.abs(end - start)
    slope = np.clip(_SPACING * scale / np.maximum(length, _TINY), 1e-14, 0.999)
    # Any stretch is a valid change of variable, so a rough inverse is good enough.
    k = np.interp(-np.log(slope), -_LOG_STRETCH_SLOPE, _STRETCH)[..., None]
    x, w = gauss_legendre(count)
    nodes = start[..., None] + (end - start)[..., None] * np.expm1(k * x) / np.expm1(k)
    return nodes, length[..., None] * w * k * np.exp(k * x) / np.expm1(k)


def _half_circle(count: int) -> Reals:
    """Midpoints of equal steps from 0 to pi."""
    return (np.arange(count) + 0.5) * np.pi / count


def _split_half_circle(at: float, count: int) -> tuple[Reals, Reals]:
    """Gauss nodes and weights from 0 to pi in two panels that meet at a forward peak."""
    edges = [0.0, at, np.pi] if 0.02 < at < np.pi - 0.02 else [0.0, np.pi]
    x, w = gauss_legendre(count if len(edges) == 3 else 2 * count)
    panels = list(itertools.pairwise(edges))
    nodes = np.concatenate([a + (b - a) * x for a, b in panels])
    return nodes, np.concatenate([(b - a) * w for a, b in panels])


def _cosine_series(count: int, azimuth: Reals) -> Reals:
    """Matrix that takes an even function of azimuth from `count` midpoints to other azimuths."""
    order = np.arange(count)
    at_nodes = np.cos(order[:, None] * _half_circle(count)) * np.where(order == 0, 1, 2)[:, None]
    return np.cos(azimuth[:, None] * order) @ at_nodes / count


@dataclasses.dataclass(frozen=True)
class _Rays:
    """Straight rays and the sun, seen from their starting points; every field is [ray]."""

    altitude: Reals
    cos_zenith: Reals
    sun_cos_zenith: Reals
    cos_to_sun: Reals

    def __getitem__(self, mask: Mask) -> "_Rays":
        return _Rays(*(getattr(self, f.name)[mask] for f in dataclasses.fields(self)))


@dataclasses.dataclass(frozen=True)
class _Nodes:
    """Node counts of the quadratures."""

    view: int
    ray: int
    near: int
    panel: int
    upward: int
    limb: int
    downward: int
    azimuth: int

    @classmethod
    def at(cls, resolution: float) -> "_Nodes":
        counts = {
            "view": 20,
            "ray": 24,
            "near": 10,
            "panel": 6,
            "upward": 16,
            "limb": 8,
            "downward": 14,
            "azimuth": 12,
        }
        return cls(**{name: max(4, round(n * resolution)) for name, n in counts.items()})


class _Sky:
    """An atmosphere with its columns, and the integrals through it."""

    def __init__(
        self, constituents: Constituents, albedo: ArrayLike, radius: float, top: float, spherical: bool
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

    def advance(self, rays: _Rays, s: Reals) -> tuple[Reals, Reals, Reals]:
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

    def hits_ground(self, rays: _Rays) -> Mask:
        """Whether rays that start above the ground end there."""
        if not self.spherical:
            return rays.cos_zenith < 0
        return (rays.cos_zenith < 0) & (self._tangent(rays.altitude, rays.cos_zenith) < 0)

    def segments(self, rays: _Rays, ground: Mask) -> list[_Segment]:
        """Pieces of each ray with monotonic altitude: distances of the lower and the higher end."""
        z, mu = rays.altitude, rays.cos_zenith
        if not self.spherical:
            length = np.where(ground, -z / mu, (self.top - z) / mu)
            return [(np.where(ground, length, 0.0), np.where(ground, 0.0, length))]
        r = self.radius + z
        to_tangent = np.where((mu < 0) & ~ground, -r * mu, 0.0)
        vertical = (r * mu) ** 2
        to_ground = (vertical - z * (2 * self.radius + z)).clip(0)
        below = z * (2 * self.radius + z) / (np.abs(r * mu) + np.sqrt(to_ground) + _TINY)
        rise = (self.top - z) * (2 * self.radius + self.top + z)
        to_top = rise / (np.sqrt(vertical + rise) + np.abs(r * mu) + _TINY)
        to_top = np.where(mu < 0, 2 * np.abs(r * mu) + to_top, to_top)
        return [
            (np.where(ground, below, to_tangent), np.where(ground, 0.0, to_top)),
            (to_tangent, np.zeros_like(z)),
        ]

    def shadow(self, rays: _Rays) -> _Segment:
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

    def emission(self, rays: _Rays, nodes: int) -> Reals:
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

    def _piece_emission(self, rays: _Rays, ground: Mask, piece: _Segment, nodes: int) -> Reals:
        start, end = piece
        z, mu, _ = self.advance(rays, start[:, None])
        s, weights = _stretched(start, end, self.local_scale(z[:, 0], mu[:, 0]), nodes)
        optical_depth, z = self.two_way_depth(rays, ground, s)
        transmittance = np.exp(-optical_depth, out=optical_depth)
        density = np.exp(-z[:, None, :] / self.heights[:, None]) / self.heights[:, None]
        return (density * weights[:, None, :]) @ transmittance

    def depth_to(self, rays: _Rays, ground: Mask, z: Reals, mu: Reals) -> Reals:
        """Columns from the start of each ray to points on it [ray, node, constituent]."""
        from_start = self._ray_columns(rays.altitude[:, None], rays.cos_zenith[:, None], ground)
        return from_start - self._ray_columns(z, mu, ground)

    def _ray_columns(self, z: Reals, mu: Reals, ground: Mask) -> Reals:
        """Columns from points on rays to the rays' far end, up to a constant for rays into the ground."""
        found = self.upward_columns(z, np.abs(mu))
        found[ground] *= -1
        turning = (mu < 0) & ~ground[:, None]
        if turning.any():
            found[turning] = 2 * self._columns_at_tangent(z[turning], mu[turning]) - found[turning]
        return found

    def two_way_depth(self, rays: _Rays, ground: Mask, s: Reals) -> tuple[Reals, Reals]:
        """Optical depth start -> point -> sun [ray, node, wavelength], and the points' altitude."""
        z, mu, sun = self.advance(rays, s)
        columns = self.depth_to(rays, ground, z, mu) + self.columns_along(z, sun)
        return columns @ self.depth, z

    def phases(self, cosine: Reals) -> Reals:
        """Phase function of every scatterer [scatterer, direction, wavelength] at cosines [direction]."""
        shape = (len(cosine), len(self.wavelengths))
        clipped = np.clip(cosine, -1, 1)[:, None]
        values = [c.phase_function(clipped, self.wavelengths[None, :]) for c in self.scatterers]
        return np.stack([np.broadcast_to(v, shape) for v in values])

    def single_scattering(self, rays: _Rays, nodes: int) -> Reals:
        """Radiance of order 1 [ray, wavelength]."""
        channels = self.channels(rays, nodes)
        phases = np.moveaxis(self.phases(rays.cos_to_sun), 0, 1)
        return (channels[:, :-1] * phases).sum(axis=1) + channels[:, -1]

    def channels(self, rays: _Rays, nodes: int) -> Reals:
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

    def _ground_radiance(self, rays: _Rays) -> Reals:
        """Sunlight reflected by the ground, seen through the air [ray, wavelength]."""
        every = np.ones(len(rays.altitude), bool)
        length = self.segments(rays, every)[0][0][:, None]
        _, mu, sun = self.advance(rays, length)
        sunlit = np.maximum(sun, 1e-9)
        floor = np.zeros_like(sun)
        columns = self.depth_to(rays, every, floor, mu) + self.upward_columns(floor, sunlit)
        transmittance = np.exp(-(columns @ self.depth)[:, 0])
        return self.albedo / np.pi * np.maximum(sun, 0) * transmittance

    def cosines(self, altitude: float, peaks: list[float], nodes: _Nodes) -> tuple[Reals, Reals]:
        """Zenith cosines of incoming directions and weights.

        The panels, in zenith angle, meet at the horizontal, at the point's own horizon and at the
        forward peaks (given by zenith cosines); the nodes crowd toward the horizon.
        """
        level, dip, scale = np.pi / 2, 0.0, 1e-4
        if self.spherical:
            below = altitude * (2 * self.radius + altitude)
            dip = np.arctan2(np.sqrt(below), self.radius)
            scale = np.sqrt(self.least_height / (2 * self.radius))
        near = level - _NEAR_HORIZON
        inner = sorted((a for a in np.arccos(peaks) if 0.03 < a < near - 0.03), reverse=True)
        edges = [near, *inner, 0.0]
        panels = [(level + dip, np.pi, scale, nodes.downward), (level, near, scale, nodes.near)]
        if dip > 0:
            panels.append((level, level + dip, scale, nodes.limb))
        for start, end in zip(edges[:-1], edges[1:], strict=True):
            count = nodes.panel + round((start - end) / level * nodes.upward)
            panels.append((start, end, 1.0, count))
        parts = [
            _stretched(np.array([start]), np.array([end]), np.array([width]), count)
            for start, end, width, count in panels
        ]
        angle, weight = (np.concatenate([p[i][0] for p in parts]) for i in (0, 1))
        return np.cos(angle), weight * np.sin(angle)

    def scattered_source(self, view: _Rays, nodes: _Nodes) -> Reals:
        """Sum over incoming directions of single-scattered radiance and phase function, one point.

        Returns:
            Per unit of each scatterer's scattering coefficient [scatterer, wavelength].
        """
        mu_view, mu_sun, view_to_sun = (
            float(a[0]) for a in (view.cos_zenith, view.sun_cos_zenith, view.cos_to_sun)
        )
        mu, weight = self.cosines(float(view.altitude[0]), [mu_view, mu_sun], nodes)
        sine, sine_view, sine_sun = (np.sqrt(1 - c**2) for c in (mu, mu_view, mu_sun))
        between = (view_to_sun - mu_view * mu_sun) / max(sine_view * sine_sun, _TINY)
        view_azimuth = np.arccos(np.clip(between, -1, 1))
        coarse = _half_circle(nodes.azimuth)
        fine, fine_weight = _split_half_circle(float(view_azimuth), 2 * nodes.azimuth)
        to_sun = mu[:, None] * mu_sun + sine[:, None] * sine_sun * np.cos(coarse)
        count = to_sun.size
        incoming = _Rays(
            np.full(count, view.altitude[0]),
            np.repeat(mu, nodes.azimuth),
            np.full(count, mu_sun),
            to_sun.ravel(),
        )
        # What the phase functions multiply is smooth in azimuth: a cosine series takes it to finer
        # nodes, where the phase functions are exact.
        channels = self.channels(incoming, nodes.ray).reshape(len(mu), nodes.azimuth, -1)
        channels = _cosine_series(nodes.azimuth, fine) @ channels
        channels = channels.reshape(len(mu) * len(fine), -1, len(self.wavelengths))
        to_sun = mu[:, None] * mu_sun + sine[:, None] * sine_sun * np.cos(fine)
        radiance = channels[:, -1] + np.einsum(
            "cdw,dcw->dw", self.phases(to_sun.ravel()), channels[:, :-1]
        )
        radiance *= np.outer(weight, fine_weight).reshape(-1, 1)
        # The radiance is symmetric about the sun's azimuth: fold the phase function instead.
        source = np.zeros((len(self.scatterers), len(self.wavelengths)))
        for side in (-1, 1):
            turn = np.cos(fine - side * view_azimuth)
            to_view = mu[:, None] * mu_view + sine[:, None] * sine_view * turn
            source += np.einsum("cdw,dw->cw", self.phases(to_view.ravel()), radiance)
        return source

    def second_order(self, view: _Rays, nodes: _Nodes) -> Reals:
        """Radiance of order 2 along one ray from the ground upward [wavelength]."""
        ground = np.zeros(1, bool)
        start, end = self.segments(view, ground)[0]
        scale = self.local_scale(view.altitude, view.cos_zenith)
        s, weights = _stretched(start, end, scale, nodes.view)
        z, mu, sun = self.advance(view, s)
        transmittance = np.exp(-(self.depth_to(view, ground, z, mu) @ self.depth)[0])
        total = np.zeros(len(self.wavelengths))
        for i in range(s.shape[1]):
            point = _Rays(z[0, i : i + 1], mu[0, i : i + 1], sun[0, i : i + 1], view.cos_to_sun)
            density = np.exp(-z[0, i] / self.heights) / self.heights
            source = self.scattered_source(point, nodes) * density[:, None] * self.scattering_depth
            total += weights[0, i] * transmittance[i] * source.sum(axis=0)
        return total


def sky_radiance(
    constituents: Constituents,
    solar_zenith_angle: float,
    view_zenith_angle: float,
    relative_azimuth: float,
    orders: int = 2,
    geometry: str = "spherical",
    albedo: ArrayLike = 0.0,
    radius: float = EARTH_RADIUS,
    top: float = ATMOSPHERE_TOP,
    resolution: float = 1.0,
) -> Reals:
    """Downward radiance at the ground over solar irradiance, order by order.

    Args:
        constituents: Scatterers (at least one) and absorbers; number or [wavelength] inside.
        solar_zenith_angle: [rad]; beyond pi/2 only where the geometry is spherical.
        view_zenith_angle: [rad], from 0 to pi/2 (flat: below pi/2).
        relative_azimuth: [rad], 0 toward the sun.
        orders: 1 or 2.
        geometry: "spherical" or "flat".
        albedo: Of the Lambertian ground [-], number or [wavelength]; a reflection counts as one order.
        radius: Of the planet [m].
        top: Altitude where the atmosphere ends [m].
        resolution: Factor on all node counts.

    Returns:
        Radiance [order, wavelength] in sr^-1.

    Raises:
        ValueError: For an unknown geometry or number of orders, or a direction outside its range.
    """
    if geometry not in ("spherical", "flat"):
        raise ValueError(f"geometry must be 'spherical' or 'flat', got {geometry!r}")
    if orders not in (1, 2):
        raise ValueError(f"orders must be 1 or 2, got {orders}")
    spherical = geometry == "spherical"
    if not 0 <= view_zenith_angle <= np.pi / 2 - (0 if spherical else 1e-9):
        raise ValueError(f"view_zenith_angle must be from 0 to pi/2, got {view_zenith_angle}")
    if not spherical and not 0 <= solar_zenith_angle < np.pi / 2:
        raise ValueError(f"solar_zenith_angle must be below pi/2 where flat, got {solar_zenith_angle}")
    sky, nodes = _Sky(constituents, albedo, radius, top, spherical), _Nodes.at(resolution)
    cos_view, cos_sun = np.cos(view_zenith_angle), np.cos(solar_zenith_angle)
    sines = np.sin(view_zenith_angle) * np.sin(solar_zenith_angle)
    cos_to_sun = cos_view * cos_sun + sines * np.cos(relative_azimuth)
    view = _Rays(*(np.array([float(v)]) for v in (0.0, max(cos_view, 0.0), cos_sun, cos_to_sun)))
    found = [sky.single_scattering(view, 6 * nodes.ray)[0]]
    if orders == 2:
        found.append(sky.second_order(view, nodes))
    return np.stack(found)
