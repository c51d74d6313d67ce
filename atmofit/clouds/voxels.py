"""Metaballs on a grid of voxels, what of the grid is empty, and a plain file of voxels."""

import dataclasses
import itertools
import json
import zipfile
import zlib
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range, is_traced
from atmofit.clouds.metaballs import Metaballs, fields, metaballs
from atmofit.clouds.volume import LARGEST_EXTINCTION, LARGEST_LENGTH, VoxelCloud, voxel_cloud
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.files import readable_arrays, replace_file
from atmofit.typing import Reals, RealsLike, real_array

LARGEST_COUNT = 1024  # voxels along an axis
_SLAB = 2_000_000  # places worked on together on the host
_FORMAT = "atmofit voxels 1"
_UNITS = {"extinction_coefficient": "1/m", "low": "m", "high": "m"}


def voxelise(
    shape: Metaballs,
    counts: tuple[int, int, int],
    *,
    extinction_coefficient: RealsLike,
    low: RealsLike | None = None,
    high: RealsLike | None = None,
    samples: int = 2,
) -> VoxelCloud:
    """A cloud of the balls: extinction in proportion to density, and none below the threshold.

    Each voxel has the mean over its sub-voxels' centres. Known balls are worked on one by one, each
    only where it is; traced ones everywhere, with derivatives of the densities but not of the
    surface's place.

    Args:
        shape: The balls; there may be none if the box is given.
        counts: Voxels along x, y and z, 1 to 1024 each.
        extinction_coefficient: Where the density is 1 [1/m], 0 to 1e6; may be traced.
        low: Corner of the grid with the smallest coordinates [m], 3 numbers. None: such that the
            box just holds the balls; needs known balls.
        high: Opposite corner [m].
        samples: Sub-voxels along each edge of a voxel, 1 to 8.

    Returns:
        The cloud.

    Raises:
        ValueError: A known argument is out of range, or there are no balls and no box.
    """
    counts = _checked_counts(counts)
    in_range("samples", samples, 1.0, 8.0)
    balls = shape.checked()
    dtype = balls.radii.dtype
    scale = in_range("extinction_coefficient", extinction_coefficient, 0.0, LARGEST_EXTINCTION)
    if low is None or high is None:
        around = box_around(balls)
        low, high = (
            given if given is not None else a for given, a in zip((low, high), around, strict=True)
        )
    corners = real_array(low).astype(dtype), real_array(high).astype(dtype)
    if is_traced(balls, corners):
        filled = _by_samples(balls, counts, *corners, samples)
    else:
        filled = jnp.asarray(_by_balls(balls, counts, *corners, samples), dtype)
    return voxel_cloud(scale.astype(dtype) * filled, *corners)


extremes(
    Case("nothing", {"extinction_coefficient": 0.0}, limit=0.0, slope={"density": 0.0}),
    Case("of no density", {"density": 0.0}, limit=0.0),
    call=lambda extinction_coefficient, density, radius: jnp.sum(
        voxelise(
            metaballs(jnp.zeros((1, 3), radius.dtype), radius[None], density[None]),
            (3, 4, 5),
            extinction_coefficient=extinction_coefficient,
            low=(-1.0, -1.0, -1.0),
            high=(1.0, 1.0, 1.0),
        ).extinction_coefficient
    ),
    extinction_coefficient=Span(0.0, 1e3),
    density=Span(0.0, 100.0),
    radius=Domain(1e-3, LARGEST_LENGTH),
    least=0.0,
)(voxelise)


def _checked_counts(counts: tuple[int, int, int]) -> tuple[int, int, int]:
    if len(counts) != 3 or not all(1 <= count <= LARGEST_COUNT for count in counts):
        raise ValueError(f"counts must be three from 1 to {LARGEST_COUNT}, got {counts}")
    return counts


def box_around(balls: Metaballs) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the smallest box that holds all balls [m]; needs known balls.

    Raises:
        ValueError: There are no balls, or they are traced.
    """
    if is_traced(balls) or not balls.count:
        raise ValueError("low and high must be given where balls are traced or there are none")
    centres, radii = np.asarray(balls.centres), np.asarray(balls.radii)[:, None]
    return (centres - radii).min(axis=0), (centres + radii).max(axis=0)


def _places(
    counts: tuple[int, int, int], low: Reals, high: Reals, samples: int
) -> list[np.ndarray]:
    """Coordinates of sub-voxel centres along each axis [m]."""
    return [
        float(a) + (np.arange(n * samples) + 0.5) * (float(b) - float(a)) / (n * samples)
        for n, a, b in zip(counts, low, high, strict=True)
    ]


def _by_balls(
    balls: Metaballs, counts: tuple[int, int, int], low: Reals, high: Reals, samples: int
) -> np.ndarray:
    """Mean density of each voxel, on the host, some layers of x at a time."""
    places = _places(counts, low, high, samples)
    threshold = float(balls.threshold)
    layers = max(1, _SLAB // (samples * places[1].size * places[2].size))
    found = np.zeros(counts, np.float32 if balls.radii.dtype == jnp.float32 else float)
    for first in range(0, counts[0], layers):
        slab = slice(first * samples, (first + layers) * samples)
        density = _slab_density(balls, [places[0][slab], *places[1:]])
        density = np.where(density >= threshold, density, 0.0)
        parts = [size for n in density.shape for size in (n // samples, samples)]
        found[first : first + layers] = density.reshape(parts).mean(axis=(1, 3, 5))
    return found


def _slab_density(balls: Metaballs, places: list[np.ndarray]) -> np.ndarray:
    """Density at [x, y, z]; every ball is added to the block of places that it reaches."""
    density = np.zeros([axis.size for axis in places])
    known = (np.asarray(x, float) for x in (balls.centres, balls.radii, balls.densities))
    for centre, radius, weight in zip(*known, strict=True):
        ends = [
            np.searchsorted(x, (c - radius, c + radius))
            for x, c in zip(places, centre, strict=True)
        ]
        block = tuple(slice(*end) for end in ends)
        x, y, z = (
            ((axis[b] - c) / radius) ** 2 for axis, b, c in zip(places, block, centre, strict=True)
        )
        v = np.maximum((1 - x)[:, None, None] - y[None, :, None] - z[None, None, :], 0.0)
        density[block] += weight / 9 * v * v * (5 + 4 * v)
    return density


@eqx.filter_jit
def _by_samples(
    balls: Metaballs, counts: tuple[int, int, int], low: Reals, high: Reals, samples: int
) -> Reals:
    """Mean density of each voxel, every ball everywhere."""
    size = (high - low) / jnp.asarray(counts, low.dtype)
    first = [low[k] + (jnp.arange(counts[k], dtype=low.dtype) + 0.5) * size[k] for k in range(3)]
    centres = jnp.stack(jnp.meshgrid(*first, indexing="ij"), axis=-1)
    total = jnp.zeros(counts, low.dtype)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    for offset in itertools.product(offsets, repeat=3):
        move = jnp.asarray(offset, low.dtype) * size
        density = fields(balls, centres + move[None, None, None, :]).density
        # NaN, of refused balls, is kept.
        total = total + jnp.where(density < balls.threshold, 0.0, density)
    return total / samples**3


@dataclasses.dataclass(frozen=True)
class OccupiedBlocks:
    """Which blocks of voxels hold anything.

    Attributes:
        filled: [x, y, z] of blocks.
        block: Voxels along a block's edge; the last blocks of an axis may be cut.
        saved: Share of the voxels that lie in empty blocks [-].
    """

    filled: np.ndarray
    block: int
    saved: float


def occupied_blocks(cloud: VoxelCloud, block: int = 8) -> OccupiedBlocks:
    """Find the blocks that can be left out.

    Args:
        cloud: With known values.
        block: Voxels along a block's edge, at least 1.

    Returns:
        The blocks, on the host.

    Raises:
        ValueError: The block is too small, or the cloud is traced.
    """
    if block < 1 or is_traced(cloud):
        raise ValueError(f"needs a known cloud and a block of at least 1 voxel, got {block}")
    full = np.asarray(cloud.extinction_coefficient) > 0
    pad = [(0, -count % block) for count in full.shape]
    parts = [
        size
        for n, (_, more) in zip(full.shape, pad, strict=True)
        for size in ((n + more) // block, block)
    ]
    filled = np.asarray(np.pad(full, pad).reshape(parts).any(axis=(1, 3, 5)))
    sizes = [np.minimum(block, n - block * np.arange(-(-n // block))) for n in full.shape]
    kept = np.einsum("xyz,x,y,z->", filled.astype(float), *sizes)
    return OccupiedBlocks(filled, block, 1 - float(kept) / full.size)


def write_voxels(path: Path | str, cloud: VoxelCloud) -> Path:
    """Write a cloud as a compressed .npz of plain arrays, whole or not at all.

    Args:
        path: The file, with the ending .npz; its folder exists.
        cloud: With known values.

    Returns:
        The path.

    Raises:
        ValueError: The file's name has another ending, or the cloud is traced.
        OSError: It cannot be written.
    """
    path = Path(path)
    if path.suffix != ".npz" or is_traced(cloud):
        raise ValueError(f"needs a known cloud and a name that ends in .npz, got {path.name!r}")
    header = {
        "format": _FORMAT,
        "axes": "extinction_coefficient[x, y, z], z upward",
        "units": _UNITS,
    }
    arrays = {name: np.asarray(getattr(cloud, name)) for name in _UNITS}
    arrays["header"] = np.array(json.dumps(header))

    def write(name: Path) -> None:
        with name.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)

    return replace_file(path, write)


def read_voxels(path: Path | str, *, largest_bytes: int = 2**31) -> VoxelCloud:
    """Read a cloud that `write_voxels` wrote.

    Args:
        path: The file.
        largest_bytes: Refuse what would be larger in memory [bytes].

    Returns:
        The cloud.

    Raises:
        ValueError: The file is absent, none of ours, damaged or too large, or its values are
            impossible.
        OSError: It cannot be read.
    """
    path = Path(path)
    try:
        with np.load(readable_arrays(path, largest_bytes), allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            arrays = [file[name] for name in _UNITS]
        if not isinstance(header, dict) or header.get("format") != _FORMAT:
            raise ValueError(f"the format is not {_FORMAT!r}")
        if header.get("units") != _UNITS:
            raise ValueError(f"units must be {_UNITS}, got {header.get('units')}")
        if any(array.dtype.kind != "f" for array in arrays) or arrays[1].shape != (3,):
            raise ValueError("arrays must hold floating-point numbers, and corners three of them")
        return voxel_cloud(*arrays)
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path} is no usable file of voxels: {error}") from error
