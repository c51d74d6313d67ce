"""The scenes of `slab_pictures.py`: planets seen from far away, each pixel one parallel ray."""

import dataclasses
import math

import numpy as np

from atmofit.media.dust import hapke_irvine, over_background, slab_brightness, slab_transparency
from atmofit.media.rings import (
    SATURN_RADIUS,
    in_sphere_shadow,
    ring_brightness,
    synthetic_ring_profile,
)
from atmofit.optics.particle_phases import Isotropic

PLANET_ALBEDO = 0.17  # of Lambert's ball within the rings; darker than Saturn, to show them
_SHARP = 2  # rays per pixel, each way
_EDGE = 1e-4  # smallest cosine of a view, at a planet's limb
_RING_PARTS = {"C ring": 85e6, "B ring": 110e6, "Cassini division": 119.5e6, "A ring": 130e6}


@dataclasses.dataclass(frozen=True)
class RingScene:
    """A picture of rings: brightness, which pixels are ring, extent [m], and figures of it."""

    brightness: np.ndarray
    ring: np.ndarray
    extent: tuple[float, float, float, float]
    phase_angle: float
    parts: dict[str, float]


def saturn(rows: int, solar_elevation: float, view_elevation: float) -> RingScene:
    """Rings and a Lambert sphere with the shadows of each on the other.

    Args:
        rows: Of the picture; columns are 2.2 times as many.
        solar_elevation: Of the sun over the rings' near side [deg]; below 0 the far side is lit.
        view_elevation: Of the observer over the rings [deg].
    """
    view, side, up = camera(math.radians(view_elevation))
    low, azimuth = math.radians(solar_elevation), math.radians(35.0)
    sun = np.array(
        [math.cos(low) * math.cos(azimuth), math.cos(low) * math.sin(azimuth), math.sin(low)]
    )
    phase = math.acos(float(view @ sun))
    width, height = 145e6, 145e6 / 2.2
    lines, columns = _SHARP * rows, _SHARP * round(2.2 * rows)
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * width
    y = (1 - (np.arange(lines) + 0.5) / lines * 2) * height
    plane = x[None, :, None] * side + y[:, None, None] * up
    ring_place = plane - (plane[..., 2] / view[2])[..., None] * view
    # The planet's near half, and how far it stands before the ring plane along the view.
    square = SATURN_RADIUS**2 - x[None, :] ** 2 - y[:, None] ** 2
    planet = square > 0
    ahead = np.sqrt(np.maximum(square, 0.0))
    surface = plane + ahead[..., None] * view
    ring_ahead = (ring_place - plane) @ view
    # B of Lambert's ball: 4 pi times albedo x cosine / pi.
    lit = np.where(planet, np.maximum(surface @ sun, 0.0) / SATURN_RADIUS, 0.0)
    body = 4 * PLANET_ALBEDO * lit * ring_shade(surface, sun)
    profile = synthetic_ring_profile()
    radius = np.linalg.norm(ring_place, axis=-1)
    bright, through = map(
        np.asarray, ring_brightness(profile, radius, view[2], float(sun[2]), phase)
    )
    bright = np.where(np.asarray(in_sphere_shadow(ring_place, sun, SATURN_RADIUS)), 0.0, bright)
    over = np.asarray(over_background(bright, through, body))
    behind = planet & (ring_ahead < ahead)
    ring = (through < 1) & ~behind
    parts = {
        name: float(ring_brightness(profile, r, view[2], float(sun[2]), phase)[0])
        for name, r in _RING_PARTS.items()
    }
    extent = (-width, width, -height, height)
    picture = smoothed(np.where(behind, body, over))
    return RingScene(picture, smoothed(ring.astype(float)) == 1, extent, phase, parts)


def smoothed(picture: np.ndarray) -> np.ndarray:
    """Means over the rays of each pixel."""
    rows, columns = (size // _SHARP for size in picture.shape)
    return picture.reshape(rows, _SHARP, columns, _SHARP).mean(axis=(1, 3))


def ring_shade(surface: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Share of sunlight that reaches points of the planet through the rings."""
    way = -surface[..., 2] / sun[2]
    radius = np.linalg.norm(surface + way[..., None] * sun, axis=-1)
    _, through = ring_brightness(synthetic_ring_profile(), radius, abs(sun[2]), 0.5, 0.0)
    return np.where(way > 0, through, 1.0)


def camera(elevation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors toward the observer, to the right and up, from an elevation over the plane."""
    view = np.array([math.cos(elevation), 0.0, math.sin(elevation)])
    up = np.array([-math.sin(elevation), 0.0, math.cos(elevation)])
    return view, np.array([0.0, 1.0, 0.0]), up


@dataclasses.dataclass(frozen=True)
class CloudScene:
    """Three pictures [row, column, RGB] and figures of the limb."""

    surface: np.ndarray
    layer: np.ndarray
    both: np.ndarray
    limb: dict[str, float]


def cloudy_planet(rows: int, seed: int) -> CloudScene:
    """A ball of coloured squares under a layer of clouds, lit from the left."""
    random = np.random.default_rng(seed)
    normal, disc = ball(rows)
    longitude = np.arctan2(normal[..., 0], normal[..., 2])
    latitude = np.arcsin(normal[..., 1])
    sun = np.array([-math.sin(1.0), 0.15, math.cos(1.0)])
    sun /= np.linalg.norm(sun)
    seen, lit = np.maximum(normal[..., 2], _EDGE), normal @ sun
    colours = random.uniform(0.05, 0.9, (12, 24, 3))
    cells = (
        np.floor((latitude / math.pi + 0.5) * 11.99).astype(int),
        np.floor((longitude / (2 * math.pi) + 0.5) * 23.99).astype(int),
    )
    surface = colours[cells] * np.maximum(lit, 0.0)[..., None]
    depth = np.where(disc, 0.22 * np.exp(1.3 * texture(random, normal)), 0.0)
    phase = math.acos(float(sun[2]))
    bright = np.where(disc & (lit > 0), cloud(depth, seen, lit, phase), 0.0)
    through = np.where(disc, np.asarray(slab_transparency(depth, seen)), 1.0)
    backdrop = np.array([0.05, 0.1, 0.35])
    layer = over(bright, through, np.broadcast_to(backdrop, surface.shape))
    both = over(bright, through, np.where(disc[..., None], surface, 0.0))
    # On an even layer, lit and seen from above: what the limb has over the centre.
    even, mu = 0.3, np.array([1.0, 0.1])
    centre, edge = cloud(np.full(2, even), mu, np.full(2, 0.5), phase)
    clear = np.asarray(slab_transparency(even, mu))
    return CloudScene(
        np.where(disc[..., None], surface, 0.0),
        np.where(disc[..., None], layer, 0.0),
        both,
        {
            "even layer, depth 0.3, mu0 0.5: B at mu 0.1 over B at mu 1": float(edge / centre),
            "its opacity at mu 1": float(1 - clear[0]),
            "its opacity at mu 0.1": float(1 - clear[1]),
            "textured layer: mean B where mu < 0.2 over where mu > 0.6, 0.4 < mu0 < 0.8": float(
                bright[disc & (seen < 0.2) & (lit > 0.4) & (lit < 0.8)].mean()
                / bright[disc & (seen > 0.6) & (lit > 0.4) & (lit < 0.8)].mean()
            ),
        },
    )


def cloud(depth: np.ndarray, seen: np.ndarray, lit: np.ndarray, phase: float) -> np.ndarray:
    """Brightness of white isotropic clouds; B itself, as Blinn shows it."""
    return np.asarray(
        slab_brightness(depth, seen, lit, phase, single_scattering_albedo=1.0, phase=Isotropic())
    )


def over(bright: np.ndarray, through: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Grey clouds over a coloured background."""
    return np.asarray(over_background(bright[..., None], through[..., None], background))


def full_moon(rows: int, law: str, phase_angle: float) -> np.ndarray:
    """Brightness of a ball of "dust" or of "Lambert"; NaN around it."""
    normal, disc = ball(rows)
    sun = np.array([math.sin(phase_angle), 0.0, math.cos(phase_angle)])
    lit, seen = normal @ sun, np.maximum(normal[..., 2], _EDGE)
    lit = np.where(phase_angle == 0.0, seen, np.clip(lit, -1.0, 1.0))
    picture = np.asarray(hapke_irvine(seen, lit)) if law == "dust" else np.maximum(lit, 0.0)
    return np.where(disc, picture, np.nan)


def ball(rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals of a unit sphere, seen along the third axis, and which pixels it covers."""
    x = (np.arange(rows) + 0.5) * 2 / rows - 1
    across, up = np.meshgrid(x, -x)
    square = 1 - across**2 - up**2
    depth = np.sqrt(np.maximum(square, 0.0))
    length = np.maximum(np.sqrt(across**2 + up**2 + depth**2), 1.0)
    return np.stack([across, up, depth], axis=-1) / length[..., None], square > 0


def texture(random: np.random.Generator, place: np.ndarray) -> np.ndarray:
    """Smooth noise on the sphere: waves in random directions, weaker the shorter; variance 1."""
    total, variance = np.zeros(place.shape[:-1]), 0.0
    for octave in range(6):
        size = 0.65**octave
        for _ in range(24):
            wave = random.standard_normal(3)
            wave *= 5.0 * 1.9**octave * random.uniform(0.7, 1.4) / np.linalg.norm(wave)
            total += size * np.cos(place @ wave + random.uniform(0, 2 * math.pi))
            variance += size**2 / 2
    return total / math.sqrt(variance)
