"""Small balls on the surface of a cloud of balls, and smaller ones on theirs."""

import math
from typing import NamedTuple

import numpy as np

from atmofit.checks import in_range, is_traced
from atmofit.clouds.metaballs import Metaballs, metaballs
from atmofit.clouds.voxels import box_around, voxelise

MOST = 10_000  # balls
_LONGEST = 256  # cells of the surface along its longest edge


class Surface(NamedTuple):
    """Triangles of an isosurface.

    Attributes:
        corners: [triangle, 3, 3], corner and coordinate [m].
        normals: [triangle, 3], outward unit vectors.
        areas: [triangle], [m²].
    """

    corners: np.ndarray
    normals: np.ndarray
    areas: np.ndarray


def triangulate(balls: Metaballs, cells: int = 48) -> Surface:
    """Cut the surface of metaballs into triangles by marching cubes.

    Args:
        balls: With known values; there may be none.
        cells: Along the longest edge of the box around the balls, 4 to 256.

    Returns:
        The triangles; none where no density reaches the threshold.

    Raises:
        ValueError: A value is out of range or traced.
    """
    from skimage.measure import marching_cubes

    in_range("cells", cells, 4.0, float(_LONGEST))
    none = Surface(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0))
    if not balls.count and not is_traced(balls):
        return none
    low, high = (corner.astype(float) for corner in box_around(balls.checked()))
    size = float((high - low).max()) / cells
    # One empty cell around, so that the surface closes.
    low = low - size
    counts = [int(n) for n in np.ceil((high + size - low) / size)]
    grid = _densities(balls, low, size, counts)
    level = float(balls.threshold)
    if not grid.max() > level:
        return none
    points, faces, _, _ = marching_cubes(grid, level)
    corners = (low + (points + 0.5) * size)[faces]
    # In this order they point outward.
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
    twice = np.linalg.norm(across, axis=1)
    kept = twice > 1e-12 * size**2  # marching cubes may leave triangles without area
    return Surface(
        corners[kept], (across / np.maximum(twice, 1e-300)[:, None])[kept], twice[kept] / 2
    )


def _densities(balls: Metaballs, low: np.ndarray, size: float, counts: list[int]) -> np.ndarray:
    """In the centres of cells."""
    smooth = metaballs(balls.centres, balls.radii, balls.densities, 1e-6)
    x, y, z = counts
    high = low + size * np.asarray(counts)
    cloud = voxelise(smooth, (x, y, z), extinction_coefficient=1.0, low=low, high=high, samples=1)
    return np.asarray(cloud.extinction_coefficient, float)


def grow(
    balls: Metaballs,
    *,
    generations: int = 2,
    most: int = 340,
    shrink: float = 0.5,
    outward: float = 0.5,
    lowest_normal: float = -0.1,
    seed: int = 0,
    cells: int = 48,
) -> Metaballs:
    """Set small balls on the surface of balls, then smaller ones on the new surface, and so on.

    Each generation doubles as far as `most` allows. Places are even over the surface's area and
    random; radii shrink from one generation to the next, and with the distance from the middle.
    None is set where the surface looks down, and none reaches below the surface's lowest place,
    so that the bottom stays flat.

    Args:
        balls: To start from, with known values; there may be none.
        generations: How many times, 0 to 8.
        most: Balls in the end, to 10000, unless there are more at the start.
        shrink: Radius of a generation over the one before [-], 0.1 to 1; the first compares with
            the mean of the balls given.
        outward: Share by which radii at the farthest place are smaller than in the middle [-],
            0 to 0.9.
        lowest_normal: Smallest upward part of a normal that carries balls [-], -1 to 1.
        seed: The same seed, the same balls.
        cells: See `triangulate`.

    Returns:
        The balls given, then the new ones in the order in which they were set.

    Raises:
        ValueError: A value is out of range or traced.

    References:
        Nishita, Dobashi and Nakamae (1996), section 4: the idea; the numbers are ours.
    """
    for name, value, low, high in (
        ("generations", generations, 0.0, 8.0),
        ("most", most, 0.0, float(MOST)),
        ("shrink", shrink, 0.1, 1.0),
        ("outward", outward, 0.0, 0.9),
        ("lowest_normal", lowest_normal, -1.0, 1.0),
    ):
        in_range(name, value, low, high)
    if is_traced(balls):
        raise ValueError("balls to grow must have known values, got traced ones")
    random = np.random.default_rng(seed)
    grown = balls.checked()
    for generation in range(1, generations + 1):
        wanted = _share(most - grown.count, generations - generation + 1)
        surface = triangulate(grown, cells)
        where = surface.normals[:, 2] > lowest_normal
        if wanted < 1 or not where.any():
            break
        radius = float(np.mean(np.asarray(balls.radii))) * shrink**generation
        new = _new_balls(surface, where, wanted, radius, outward, random)
        grown = _joined(grown, *new)
    return grown


def _share(left: int, generations: int) -> int:
    """How many balls of those left are this generation's: every next one has twice as many."""
    return math.ceil(left / (2**generations - 1))


def _new_balls(
    surface: Surface,
    where: np.ndarray,
    count: int,
    radius: float,
    outward: float,
    random: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of balls on some of a surface's triangles."""
    share = np.where(where, surface.areas, 0.0)
    triangle = random.choice(share.size, count, p=share / share.sum())
    # Even over a triangle: two numbers, folded into its half of the parallelogram.
    a, b = random.random((2, count))
    a, b = np.where(a + b > 1, (1 - a, 1 - b), (a, b))
    corner = surface.corners[triangle]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    centres = corner[:, 0] + a[:, None] * first + b[:, None] * second
    lowest, highest = surface.corners.min(axis=(0, 1)), surface.corners.max(axis=(0, 1))
    away = np.linalg.norm((centres - (lowest + highest) / 2) / (highest - lowest), axis=1)
    away = np.minimum(away / math.sqrt(0.75), 1.0)
    radii = radius * (1 - outward * away) * random.uniform(0.7, 1.3, count)
    centres[:, 2] = np.maximum(centres[:, 2], lowest[2] + radii)
    return centres, radii


def _joined(balls: Metaballs, centres: np.ndarray, radii: np.ndarray) -> Metaballs:
    """With new balls as dense as the old ones are on average."""
    old = [np.asarray(x) for x in (balls.centres, balls.radii, balls.densities)]
    new = (centres, radii, np.full(radii.size, old[2].mean()))
    both = [np.concatenate([a, b.astype(a.dtype)]) for a, b in zip(old, new, strict=True)]
    return metaballs(both[0], both[1], both[2], balls.threshold)
