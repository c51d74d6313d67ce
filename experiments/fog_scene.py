"""Balls and posts on a plain in fog: Figures 15 to 18 of Klassen (1987) staged."""

import dataclasses
import math
from typing import Any

import numpy as np

import atmofit as af
from atmofit.media.fog import fog_transfer
from atmofit.media.fog_medium import FogLayer, fog_layer
from atmofit.media.fog_object import fog_object
from atmofit.numerics import gauss_nodes
from atmofit.optics.mie import mie_optics
from atmofit.optics.sizes import modified_gamma_sizes
from atmofit.render.film import on_film

MIE_NM = np.linspace(400.0, 700.0, 13)
SUN = math.radians(25)  # elevation in the picture
EYE, TOP = 2.5, 14.0  # [m]
CAMERA = np.array([0.0, 0.0, EYE])
SIDES = {"from the front": 155.0, "from behind": 22.0}  # azimuth of the sun [degrees]
HALF_WIDTH = math.tan(math.radians(28))  # of the picture, at distance 1
WAVELENGTHS_NM = np.arange(400.0, 701.0, 20.0)
WHITE = 9e3  # [cd m^-2], of the film
# Balls: x to the right, y ahead, radius [m], and albedo in red, green and blue.
BALLS = np.array(
    [
        [-1.9, 15.0, 1.3, 0.55, 0.10, 0.06],
        [2.4, 22.0, 1.9, 0.60, 0.42, 0.10],
        [-2.2, 38.0, 2.4, 0.08, 0.30, 0.38],
        [11.5, 58.0, 5.0, 0.62, 0.60, 0.56],
        [-17.0, 84.0, 9.0, 0.45, 0.16, 0.22],
    ]
)
# Posts along a way: x, y, radius and height [m].
POSTS = np.array([[x, y, 0.28, 5.0] for y in range(12, 150, 8) for x in (-5.5, 5.5)])
POST_ALBEDO = (0.20, 0.14, 0.10)
TILES = ((0.34, 0.32, 0.24), (0.15, 0.17, 0.11))
TILE = 3.0  # [m]


@dataclasses.dataclass(frozen=True)
class View:
    """What each ray of the camera meets.

    Attributes:
        ray: Unit vectors [ray, 3]; y is ahead.
        distance: [m], infinity for the sky.
        normal: Outward, 0 for the sky.
        albedo: [ray, wavelength].
    """

    ray: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray


def stage(width: int, samples: int) -> tuple[list[tuple[str, np.ndarray]], dict[str, float]]:
    """Figures 15 to 18, and how bright the fog is at the horizon from both sides."""
    droplets = mie_optics(modified_gamma_sizes(4e-6, 6.0), 1.333, MIE_NM[::3], radius_count=400)
    fog = dataclasses.replace(
        fog_layer("thin", TOP, WAVELENGTHS_NM), phase=droplets.haze(smooth=True).phase
    )
    clear = dataclasses.replace(fog, extinction=0 * fog.extinction, scattering=0 * fog.scattering)
    light = np.asarray(af.solar_irradiance_spectrum("standard")(WAVELENGTHS_NM))
    view = look(width, samples)
    scenes, looks = [], {}
    for side, degrees in SIDES.items():
        azimuth = math.radians(degrees)
        sunlit = sunlit_share(view, azimuth)
        for name, layer in (("without fog", clear), ("with fog", fog)):
            radiance = seen(view, sunlit, layer, azimuth, light)
            scenes.append((f"lit {side}, {name}", develop(radiance, width, samples)))
        level = fog_transfer(fog, math.inf, math.pi / 2, azimuth, math.pi / 2 - SUN, EYE)
        looks[f"fog at the horizon, lit {side} [1/sr]"] = float(level.in_scattered[8])
    front, back = looks.values()
    return scenes, looks | {"fog lit from behind / from the front": back / front}


def look(columns: int, samples: int) -> View:
    """Through a camera with a level axis."""
    width, height = samples * columns, samples * (columns * 9 // 16)
    across = HALF_WIDTH * (2 * (np.arange(width) + 0.5) / width - 1)
    upward = HALF_WIDTH * 9 / 16 * (1.24 - 2 * (np.arange(height) + 0.5) / height)
    x, z = np.meshgrid(across, upward)
    ray = np.stack([x, np.ones_like(x), z], axis=-1).reshape(-1, 3)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    return View(ray, *cast(CAMERA, ray))


def sunlit_share(view: View, azimuth: float) -> np.ndarray:
    """Cosine of incidence where the sun shines, else 0; its azimuth counts to the right."""
    level = math.cos(SUN)
    to_sun = np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(SUN)])
    cosine = np.maximum(view.normal @ to_sun, 0.0)
    facing = cosine > 0
    place = CAMERA + view.distance[facing, None] * view.ray[facing] + 1e-3 * view.normal[facing]
    hidden = cast(place, np.broadcast_to(to_sun, place.shape), False)[0]
    cosine[facing] *= np.isinf(hidden)
    return cosine


def seen(
    view: View, sunlit: np.ndarray, fog: FogLayer, azimuth: float, light: np.ndarray
) -> np.ndarray:
    """Radiance [ray, wavelength]: Lambert's law by the sun, the sky and the ground, then fog."""
    solid = np.isfinite(view.distance)
    zenith, turned = np.arccos(view.ray[:, 2]), np.arctan2(view.ray[:, 0], view.ray[:, 1])
    sky, ground = surroundings(fog, light)
    upward = view.normal[:, 2:]
    diffuse = (1 + upward) / 2 * sky + (1 - upward) / 2 * ground
    objects = fog_object(
        fog,
        sunlit[:, None] * view.albedo / math.pi,
        np.where(solid, view.distance, 1.0),
        zenith,
        math.pi / 2 - SUN,
        EYE,
        irradiance=light,
        ambient=view.albedo / math.pi * diffuse,
    )
    over = fog_transfer(
        fog, view.distance, zenith, turned - azimuth, math.pi / 2 - SUN, EYE, light
    ).in_scattered
    return np.where(solid[:, None], objects, 0.0) + np.asarray(over)


def develop(radiance: np.ndarray, width: int, samples: int) -> np.ndarray:
    """Mean over the rays of each pixel, in sRGB."""
    n = samples
    pixels = radiance.reshape(width * 9 // 16, n, width, n, -1).mean(axis=(1, 3))
    return on_film(af.spectrum_to_xyY(pixels, WAVELENGTHS_NM), WHITE)


def surroundings(fog: FogLayer, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance of a plane on the ground by the sky, and by a ground that faces it."""
    nodes, weights = gauss_nodes(48)
    azimuth = 2 * math.pi * (np.arange(96) + 0.5) / 96
    view = np.arccos(nodes)[:, None]
    sky = fog_transfer(fog, math.inf, view, azimuth[None, :], math.pi / 2 - SUN, 0.0, light)
    shares = 2 * math.pi * weights * nodes
    diffuse = shares @ np.asarray(sky.in_scattered).mean(axis=1)
    direct = math.pi * np.asarray(
        fog_object(fog, math.sin(SUN) / math.pi, 0.0, 1.0, math.pi / 2 - SUN, 0.0, irradiance=light)
    )
    return diffuse, (diffuse + direct) * spectra_of(np.mean(TILES, axis=0))


def spectra_of(colour: Any) -> np.ndarray:
    """Albedos of red, green and blue as smooth spectra [..., wavelength]."""
    blue, red = (
        1 / (1 + np.exp(s * (WAVELENGTHS_NM - edge) / 12)) for s, edge in ((1, 495), (-1, 585))
    )
    return np.asarray(colour) @ np.stack([red, 1 - red - blue, blue])


def cast(origin: np.ndarray, ray: np.ndarray, ground: bool = True) -> tuple[np.ndarray, ...]:
    """Distance, outward normal and albedo of what rays meet first; infinity for the sky."""
    distance = np.full(len(ray), np.inf)
    normal, colour = np.zeros_like(ray), np.zeros_like(ray)
    origin = np.broadcast_to(origin, ray.shape)

    def meet(found: np.ndarray, upright: Any, tint: Any) -> None:
        nearer = found < distance
        place = (origin + np.where(nearer, found, 0.0)[:, None] * ray)[nearer]
        distance[nearer] = found[nearer]
        normal[nearer], colour[nearer] = upright(place), tint(place)

    if ground:
        down = ray[:, 2] < -1e-9
        found = np.where(down, -origin[:, 2] / np.where(down, ray[:, 2], 1.0), np.inf)
        meet(found, lambda place: np.array([0.0, 0.0, 1.0]), tiles)
    for x, y, radius, *albedo in BALLS:
        centre = np.array([x, y, radius])
        found = enter(origin - centre, ray, radius)
        meet(found, lambda p, c=centre, r=radius: (p - c) / r, lambda p, a=albedo: np.array(a))
    flat = np.array([1.0, 1.0, 0.0])
    for x, y, radius, height in POSTS:
        centre = np.array([x, y, 0.0])
        found = enter((origin - centre) * flat, ray * flat, radius)
        above = origin[:, 2] + np.where(np.isfinite(found), found, 0.0) * ray[:, 2]
        found = np.where((above > 0) & (above < height), found, np.inf)
        meet(
            found, lambda p, c=centre, r=radius: (p - c) * flat / r, lambda p: np.array(POST_ALBEDO)
        )
    return distance, normal, spectra_of(colour)


def enter(offset: np.ndarray, ray: np.ndarray, radius: float) -> np.ndarray:
    """Distance at which rays enter a ball, or a post if both are flattened; infinity if never."""
    square = np.sum(ray * ray, axis=1)
    along = np.sum(offset * ray, axis=1)
    inside = along**2 - square * (np.sum(offset * offset, axis=1) - radius**2)
    hit = (inside > 0) & (along < 0)
    found = (-along - np.sqrt(np.where(hit, inside, 0.0))) / np.maximum(square, 1e-12)
    return np.where(hit & (found > 0), found, np.inf)


def tiles(place: np.ndarray) -> np.ndarray:
    """A checkered plain, whose tiles merge where they are smaller than a pixel."""
    pattern = np.prod(np.sin(math.pi * (place[:, :2] / TILE + 0.25)), axis=1)
    far = np.hypot(place[:, 0], place[:, 1])
    contrast = np.exp(-((far / 70) ** 2))
    share = 0.5 + 0.5 * np.sign(pattern) * contrast
    first, second = np.array(TILES)
    return share[:, None] * first + (1 - share)[:, None] * second
