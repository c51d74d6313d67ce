"""Which paths bring light to a voxel by two and three scatterings: the reference pattern.

A sample space of some voxels, all with the cloud's average extinction, holds the voxel in whose
light we are interested. Every path from the sun to it by one or two other voxels is followed, and
the fewest that bring a given share of the light are kept, for use all over the real cloud.

References:
    Nishita, Dobashi and Nakamae (1996), SIGGRAPH '96, 379, section 3.4.
"""

import dataclasses
import math

import jax
import numpy as np

from atmofit.checks import in_range
from atmofit.clouds.depths import sunlight_reaching
from atmofit.clouds.form_factors import (
    DIRECTIONS,
    box_shape,
    checked_medium,
    crossings,
    even_directions,
    phase_table,
    scattered,
    unit,
)
from atmofit.clouds.volume import voxel_cloud
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import RealsLike

MOST_VOXELS = 2048  # of a sample space whose paths of two legs are all followed
_SAMPLES = 7  # of a leg, at most, between its ends
_BLOCK = 500  # directions at a time in a large sample space


@dataclasses.dataclass(frozen=True)
class Paths:
    """Ways of the light to a voxel, backward: from it to the voxel before, and so on.

    Attributes:
        voxel_size: [m].
        legs: Voxels from one scattering to the one before, [path, leg, axis].
        factor: Phase functions and solid angles [1/sr], by which `leg_chance` is multiplied.
        contribution: Radiance in the sample space by each path [1/sr], albedo 1; largest first.
        total: By all paths, also those left out.
        possible: Number of all paths.
        scale: What the sum over these paths is multiplied by, to stand for all.
    """

    voxel_size: np.ndarray
    legs: np.ndarray
    factor: np.ndarray
    contribution: np.ndarray
    total: float
    possible: int
    scale: float

    @property
    def share(self) -> float:
        """What these paths bring of the light of all."""
        return float(self.contribution.sum()) / self.total if self.total > 0 else 1.0


@dataclasses.dataclass(frozen=True)
class ReferencePattern:
    """What `reference_pattern` finds.

    Attributes:
        counts: Voxels of the sample space.
        first: Radiance by one scattering in the sample space [1/sr].
        paths: Of the second order, and of the third if it was asked for.
    """

    counts: tuple[int, int, int]
    first: float
    paths: tuple[Paths, ...]

    @property
    def order_shares(self) -> tuple[float, ...]:
        """Of the light at the sample space's voxel, by order from the first."""
        each = np.array([self.first, *(paths.total for paths in self.paths)])
        return tuple(float(share) for share in each / max(each.sum(), 1e-300))


@dataclasses.dataclass(frozen=True)
class _Space:
    """A sample space: its voxels by place and the rays that link them."""

    counts: tuple[int, int, int]
    places: np.ndarray  # [voxel, axis], from the middle one
    lit: np.ndarray  # sunlight's transmittance
    toward_eye: np.ndarray  # share of each ray's light, adds to 1
    from_sun: np.ndarray  # phase function by ray [1/sr]
    rays: np.ndarray


def reference_pattern(
    *,
    phase: PhaseFunction,
    sun_direction: RealsLike,
    view_direction: RealsLike,
    voxel_size: RealsLike,
    extinction_coefficient: RealsLike,
    orders: int = 3,
    counts: tuple[int, int, int] | None = None,
    share: float = 0.9,
    most: int = 2000,
    own_voxel: bool = True,
    directions: int = DIRECTIONS,
    wavelength_nm: RealsLike = 550.0,
) -> ReferencePattern:
    """Find the paths that count, in a sample space of even extinction.

    Args:
        phase: Of one scattering.
        sun_direction: Unit vector to the sun, 3 numbers.
        view_direction: Unit vector from the cloud to the eye.
        voxel_size: Edges of a voxel [m].
        extinction_coefficient: The cloud's average [1/m], 0 to 1e6.
        orders: 2 or 3.
        counts: Voxels of the sample space, at most 2,048 in all; None: 8 x 8 and 16 along the
            axis nearest to the line of sight, as in the paper. See `adaptive_counts`.
        share: Of each order's light that the kept paths bring together, 0 to 1.
        most: Paths kept of each order, at most.
        own_voxel: Whether light may scatter again in the same voxel, which the paper leaves out.
        directions: Of the rays that form factors are made of.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The pattern.

    Raises:
        ValueError: An argument is out of range or traced.
    """
    size, extinction = checked_medium(voxel_size, extinction_coefficient)
    wanted = float(in_range("share", share, 0.0, 1.0))
    view = unit(view_direction)
    counts = counts or along_view(view)
    if orders not in (2, 3) or min(counts) < 1 or math.prod(counts) > MOST_VOXELS or most < 1:
        raise ValueError(
            f"orders must be 2 or 3, counts at most {MOST_VOXELS} in all and most at least 1, "
            f"got {orders}, {counts}, {most}"
        )
    lights = (unit(sun_direction), view)
    space = _space(phase, wavelength_nm, lights, size, extinction, counts, directions)
    reach = (counts[0] - 1, counts[1] - 1, counts[2] - 1)
    table = crossings(size, extinction, reach, space.rays).astype(np.float32)
    near = table[_cell(space.places, reach)] * space.toward_eye[None, :]
    if not own_voxel:
        near[np.all(space.places == 0, 1)] = 0.0
    second = (near @ space.from_sun)[:, None]
    paths = [_kept(space, second, size, extinction, wanted, most, own_voxel)]
    if orders == 3:
        arriving = (near @ scattered(phase, wavelength_nm, space.rays, space.rays)) * space.from_sun
        links = space.places[None, :, :] - space.places[:, None, :]
        third = np.take_along_axis(arriving @ table.T, _cell(links, reach), 1)
        if not own_voxel:
            np.fill_diagonal(third, 0.0)
        paths.append(_kept(space, third, size, extinction, wanted, most, own_voxel))
    cosine = np.array([-lights[0] @ view], np.float32)
    first = float(phase_table(phase, wavelength_nm, cosine)[0])
    here = float(space.lit[np.all(space.places == 0, 1)][0])
    return ReferencePattern(counts, first * here, tuple(paths))


def along_view(view: np.ndarray) -> tuple[int, int, int]:
    """8 x 8 voxels, and 16 along the axis nearest to the line of sight."""
    x, y, z = (16 if axis == np.argmax(np.abs(view)) else 8 for axis in range(3))
    return x, y, z


def adaptive_counts(
    *,
    phase: PhaseFunction,
    sun_direction: RealsLike,
    view_direction: RealsLike,
    voxel_size: RealsLike,
    extinction_coefficient: RealsLike,
    largest: tuple[int, int, int] = (30, 30, 30),
    share: float = 0.9,
    directions: int = 1500,
    wavelength_nm: RealsLike = 550.0,
) -> tuple[int, int, int]:
    """Size of the sample space that the paths need, from a large one.

    Args:
        phase: Of one scattering.
        sun_direction: Unit vector to the sun, 3 numbers.
        view_direction: Unit vector from the cloud to the eye.
        voxel_size: Edges of a voxel [m].
        extinction_coefficient: The cloud's average [1/m], 0 to 1e6.
        largest: Voxels of the large sample space.
        share: Of the light of two scatterings that the voxels bring together, 0 to 1.
        directions: Of the rays that form factors are made of.
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        Voxels of a box about the middle that holds the fewest voxels that bring the share.

    Raises:
        ValueError: An argument is out of range or traced.
    """
    size, extinction = checked_medium(voxel_size, extinction_coefficient)
    wanted = float(in_range("share", share, 0.0, 1.0))
    lights = (unit(sun_direction), unit(view_direction))
    space = _space(phase, wavelength_nm, lights, size, extinction, largest, directions)
    middle = np.array(largest) // 2
    reach = (int(middle[0]), int(middle[1]), int(middle[2]))
    weights, found = space.toward_eye * space.from_sun, np.zeros(math.prod(box_shape(reach)))
    for first in range(0, directions, _BLOCK):
        rays = slice(first, first + _BLOCK)
        found += crossings(size, extinction, reach, space.rays[rays]) @ weights[rays]
    light = found[_cell(space.places, reach)] * space.lit
    kept = space.places[_largest(light, wanted, light.size)]
    half = np.max(np.abs(kept), axis=0) if kept.size else np.zeros(3, int)
    x, y, z = (int(2 * n + 1) for n in half)
    return x, y, z


def random_paths(pattern: ReferencePattern, chance: float, seed: int) -> ReferencePattern:
    """Some of the pattern's paths, drawn at random, that stand for all.

    With n1 of n2 paths that bring the share r, the sum I over those drawn is I n2 / (n1 r). The
    paper prints I r n2 / n1.

    Args:
        pattern: From `reference_pattern`.
        chance: Share of the paths that is kept, above 0, to 1.
        seed: Of the random numbers.

    Returns:
        The pattern with fewer paths of each order, at least one; its mean over many seeds is right.

    Raises:
        ValueError: An argument is out of range.
    """
    part = float(in_range("chance", chance, 1e-9, 1.0))
    random = np.random.default_rng(seed)

    def drawn(paths: Paths) -> Paths:
        kept = len(paths.factor)
        if kept == 0:
            return paths
        count = max(1, round(part * kept))
        which = np.sort(random.choice(kept, count, replace=False))
        return dataclasses.replace(
            paths,
            legs=paths.legs[which],
            factor=paths.factor[which],
            contribution=paths.contribution[which],
            scale=paths.scale * kept / count,
        )

    return dataclasses.replace(pattern, paths=tuple(drawn(paths) for paths in pattern.paths))


def leg_samples(legs: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the extinction along legs is looked up, and the ways that it stands for.

    Args:
        legs: Voxels from one end to the other, [..., axis].
        size: Edges of a voxel [m].

    Returns:
        Voxels from the first end to the samples between, [..., sample, axis]; the way of each
        sample [m], [..., 1 + sample], of which the first is that in the first voxel; the way in the
        last voxel [m].
    """
    steps = np.max(np.abs(legs), axis=-1)
    parts = np.clip(steps, 1, _SAMPLES + 1)
    length = np.linalg.norm(legs * size, axis=-1)
    most = int(parts.max(initial=1)) - 1
    number = np.arange(1, most + 1)
    between = number < parts[..., None]
    place = number / parts[..., None]
    samples = np.rint(place[..., None] * legs[..., None, :]) * between[..., None]
    ways = between * (length / parts)[..., None]
    start = (length / parts / 2)[..., None]
    own = np.mean(size) / 2
    chord = np.where(steps > 0, length / np.maximum(steps, 1), own)
    return samples.astype(np.int32), np.concatenate([start, ways], -1), chord


def leg_chance(legs: np.ndarray, size: np.ndarray, extinction: float) -> np.ndarray:
    """That light crosses a leg and collides in its last voxel, straight between the middles [-]."""
    _, ways, chord = leg_samples(legs, size)
    return np.exp(-extinction * ways.sum(-1)) * -np.expm1(-extinction * chord)


def _space(
    phase: PhaseFunction,
    wavelength_nm: RealsLike,
    lights: tuple[np.ndarray, np.ndarray],
    size: np.ndarray,
    extinction: float,
    counts: tuple[int, int, int],
    directions: int,
) -> _Space:
    """A sample space; `lights` are the directions to sun and eye."""
    sun, view = lights
    rays = even_directions(directions)  # backward: from a voxel to those that it has light from
    eye, lamp = (scattered(phase, wavelength_nm, -to[None], rays)[0] for to in (view, -sun))
    places = np.indices(counts).reshape(3, -1).T - np.array(counts) // 2
    with jax.ensure_compile_time_eval():
        even = voxel_cloud(np.full(counts, extinction), (0.0, 0.0, 0.0), counts * size)
        lit = np.asarray(sunlight_reaching(even, sun), np.float64).reshape(-1)
    return _Space(counts, places, lit, eye, lamp * (directions / (4 * math.pi)), rays)


def _cell(places: np.ndarray, reach: tuple[int, ...]) -> np.ndarray:
    """Number of the voxel in a box of `crossings`, by place from the middle."""
    x, y, z = np.moveaxis(places, -1, 0)
    return ((x + reach[0]) * (2 * reach[1] + 1) + y + reach[1]) * (2 * reach[2] + 1) + z + reach[2]


def _largest(values: np.ndarray, share: float, most: int) -> np.ndarray:
    """Numbers of the fewest values that add to a share of all, the largest first."""
    order = np.argsort(values)[::-1]
    summed = np.cumsum(values[order])
    if not summed[-1] > 0:
        return order[:0]
    return order[: min(int(np.searchsorted(summed, share * summed[-1])) + 1, most, values.size)]


def _kept(
    space: _Space,
    chance: np.ndarray,
    size: np.ndarray,
    extinction: float,
    share: float,
    most: int,
    own_voxel: bool,
) -> Paths:
    """The strongest paths of an order by first voxel before, [voxel], or by two, [voxel, voxel]."""
    voxels, legs = len(space.places), 1 if chance.shape[1] == 1 else 2
    light = (chance * (space.lit[:, None] if legs == 1 else space.lit[None, :])).reshape(-1)
    which = _largest(light, share, most)
    first = space.places[which // chance.shape[1]]
    ways = first[:, None, :]
    if legs == 2:
        last = space.places[which % voxels]
        ways = np.stack([first, last - first], 1)
    even = np.prod(leg_chance(ways, size, extinction), axis=1)
    factor = np.divide(chance.reshape(-1)[which], even, out=np.zeros(len(which)), where=even > 0)
    total = float(light.sum(dtype=float))
    brought = float(light[which].sum(dtype=float)) / total if total > 0 else 1.0
    possible = (voxels - (0 if own_voxel else 1)) ** legs
    return Paths(size, ways, factor, light[which], total, possible, 1 / max(brought, 1e-12))
