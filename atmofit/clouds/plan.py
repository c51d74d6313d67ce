"""What of a cloud's picture need not be computed, and what leaving it out costs."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import choice, in_range, is_traced
from atmofit.clouds.depths import reaching, voxel_size
from atmofit.clouds.glow import METHODS, SKY_MESH, SKY_SOURCES, sky_shares
from atmofit.clouds.ordinates import ordinates
from atmofit.clouds.pattern_light import occupied
from atmofit.clouds.sky_light import element_shares, sky_elements
from atmofit.clouds.surroundings import Surroundings
from atmofit.clouds.volume import Vector, VoxelCloud
from atmofit.landscape.view import View
from atmofit.optics.phase import PhaseFunction
from atmofit.typing import RealsLike, real_array

_COARSE = 16  # voxels along an edge, at most, of the grid on which the sky's elements are weighed
_SOME = 6  # elements are kept by so many, so that few numbers of them make few programs


@dataclasses.dataclass(frozen=True)
class CloudPlan:
    """What is computed of a cloud's picture.

    Attributes:
        box: First voxel and the one after the last, along each axis.
        orders: Of the sun's light, to count; 0: there is no sun. The method "converged" has all
            if there is one.
        elements: Numbers of those of `sky_elements` that count; the method "pattern" uses them.
        sources: Spectra of which the light of sky and ground is made up; the method "converged"
            solves for each.
        left_out: What is not computed, why, and what it costs; takes no part in comparisons.
    """

    box: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
    orders: int
    elements: tuple[int, ...]
    sources: int
    left_out: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    def cropped(self, cloud: VoxelCloud) -> VoxelCloud:
        """The part of the cloud that holds anything.

        Args:
            cloud: That of the plan, or one on as many voxels.

        Raises:
            ValueError: It has fewer voxels than the plan's box.
        """
        shape = cloud.extinction_coefficient.shape
        if any(last > n for (_, last), n in zip(self.box, shape, strict=True)):
            raise ValueError(f"the plan's box {self.box} does not lie in a grid of {shape} voxels")
        first, last = (jnp.asarray(ends, cloud.low.dtype) for ends in np.transpose(self.box))
        size = voxel_size(cloud)
        part = tuple(slice(a, b) for a, b in self.box)
        corners = cloud.low + first * size, cloud.low + last * size
        return VoxelCloud(cloud.extinction_coefficient[part], *corners)

    def __str__(self) -> str:
        """Line by line."""
        x, y, z = (last - first for first, last in self.box)
        return "\n".join([f"computed: {x} x {y} x {z} voxels", *self.left_out])


def plan_cloud(
    cloud: VoxelCloud,
    view: View,
    surroundings: Surroundings,
    *,
    phase: PhaseFunction,
    single_scattering_albedo: RealsLike = 1.0,
    method: str = "converged",
    orders: int = 3,
    rtol: float = 3e-3,
    wavelength_nm: RealsLike = 550.0,
) -> CloudPlan:
    """Leave out what a picture does not need: empty voxels, faint orders, hidden parts of the sky.

    Empty voxels cost nothing. Of the rest each omission alone stays within the tolerance, of the
    cloud's light as a whole; a single place, at the rim, may miss a few times as much. An order's
    power is bounded by the longest way through the cloud; the sky's elements are weighed by what
    the eye gets from them through a coarser cloud; spectra of the sky by what fewer leave of them.

    Args:
        cloud: As for `render_cloud`, and the following likewise.
        view: The camera.
        surroundings: Sun, sky and ground.
        phase: Of the droplets.
        single_scattering_albedo: 0 to 1 [-].
        method: "converged" or "pattern".
        orders: Of the sun's light, 1 to 3, at most; of the method "pattern".
        rtol: Largest share of the scattered light that may be left out, 0 to 0.5 [-].
        wavelength_nm: Where the phase function is taken [nm].

    Returns:
        The plan, with `left_out` in words.

    Raises:
        ValueError: An argument is out of range.
        TypeError: The cloud or its surroundings are traced: what to leave out follows from values.
    """
    choice("method", method, METHODS)
    in_range("rtol", rtol, 0.0, 0.5)
    for name, tree in (("cloud", cloud), ("surroundings", surroundings)):
        if is_traced(*jax.tree.leaves(tree)):
            raise TypeError(f"{name} must be known, not traced: plan outside of jit, grad and vmap")
    cloud, phase = cloud.checked(), phase.checked()
    said: list[str] = []
    grid = cloud.extinction_coefficient
    ends = [part.indices(n) for part, n in zip(occupied(grid), grid.shape, strict=True)]
    x, y, z = ((first, last) for first, last, _ in ends)
    kept = math.prod(last - first for first, last in (x, y, z)) / grid.size
    if kept < 1:
        said.append(f"{1 - kept:.0%} of the voxels: empty")
    albedo = float(in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0))
    dark = not np.any(np.asarray(surroundings.sun_irradiance) > 0)
    if dark:
        orders = 0
        said.append("the sun: it does not shine")
    elif method == "pattern":
        orders = _orders(cloud, albedo, orders, rtol, said)
    sources, elements = SKY_SOURCES, tuple(range(6 * SKY_MESH**2))
    if method == "converged":
        sources = _sources(surroundings, rtol, said)
    else:
        wavelength = real_array(wavelength_nm).astype(grid.dtype).reshape(1)
        eye = np.array([view.east, view.north, view.above_ground], float)
        away = eye - (np.asarray(cloud.low, float) + np.asarray(cloud.high, float)) / 2
        toward = jnp.asarray(away / max(np.linalg.norm(away), 1e-9), grid.dtype)
        light = _light_of_elements(cloud, surroundings, phase, wavelength, toward)
        elements = _elements(np.asarray(light, float), rtol, said)
    return CloudPlan((x, y, z), orders, elements, sources, tuple(said))


def _orders(cloud: VoxelCloud, albedo: float, orders: int, rtol: float, said: list[str]) -> int:
    """Orders whose power may exceed the tolerance."""
    again = albedo * -math.expm1(-_longest_depth(cloud))
    for order in range(2, orders + 1):
        if again ** (order - 1) <= rtol:
            share = again ** (order - 1)
            said.append(f"orders {order} to {orders}: at most {share:.1g} of the first's power")
            return order - 1
    return orders


def _longest_depth(cloud: VoxelCloud) -> float:
    """No straight line through the cloud is optically deeper.

    A line passes each slice across the axis that it follows most by a voxel's diagonal at most.
    """
    grid = np.asarray(cloud.extinction_coefficient, float)
    diagonal = float(np.linalg.norm(np.asarray(voxel_size(cloud), float)))
    deepest = (grid.max(axis=tuple(b for b in range(3) if b != axis)).sum() for axis in range(3))
    return diagonal * float(max(deepest))


def _sources(surroundings: Surroundings, rtol: float, said: list[str]) -> int:
    """The fewest spectra that make up the light of sky and ground."""
    travels, _ = ordinates(110)
    around = np.asarray(surroundings.radiance(jnp.asarray(-travels)), float)
    error = 0.0
    for count in range(1, SKY_SOURCES):
        columns, spectra = sky_shares(around, count)
        error = float(np.max(np.abs(columns.T @ spectra - around) / around.max(axis=0)[None, :]))
        if error <= rtol:
            left = SKY_SOURCES - count
            said.append(f"{left} of {SKY_SOURCES} solves for sky and ground: {error:.1g} of them")
            return count
    return SKY_SOURCES


@eqx.filter_jit
def _light_of_elements(
    cloud: VoxelCloud,
    surroundings: Surroundings,
    phase: PhaseFunction,
    wavelength: Float[Array, "1"],
    to_eye: Vector,
) -> Float[Array, "element w"]:
    """What each element of the sky sends to the eye after one scattering, on a coarser grid."""
    coarse = _coarser(cloud)
    dtype = coarse.extinction_coefficient.dtype
    directions = jnp.asarray(sky_elements(SKY_MESH)[0], dtype)
    radiance = surroundings.radiance(directions)
    share = element_shares(phase, wavelength, to_eye, SKY_MESH)
    seen = coarse.extinction_coefficient * reaching(coarse, to_eye)
    reached = jax.lax.map(lambda one: jnp.sum(seen * reaching(coarse, one)), directions)
    return radiance * (share * reached)[:, None]


def _coarser(cloud: VoxelCloud) -> VoxelCloud:
    """Of a few voxels along each axis, with the mean extinction of those that they replace."""
    grid, corner = cloud.extinction_coefficient, cloud.high
    for axis, n in enumerate(grid.shape):
        block = -(-n // _COARSE)
        more = -n % block
        grid = jnp.pad(grid, [(0, more if a == axis else 0) for a in range(3)])
        shape = (*grid.shape[:axis], (n + more) // block, block, *grid.shape[axis + 1 :])
        grid = jnp.mean(grid.reshape(shape), axis=axis + 1)
        corner = corner.at[axis].add(voxel_size(cloud)[axis] * more)
    return VoxelCloud(grid, cloud.low, corner)


def _elements(
    light: Float[np.ndarray, "element w"], rtol: float, said: list[str]
) -> tuple[int, ...]:
    """The fewest elements that leave no wavelength more than the tolerance short."""
    total = light.sum(axis=0)
    share = np.max(light / np.where(total > 0, total, 1.0)[None, :], axis=1)
    order = np.argsort(share, kind="stable")
    faint = int(np.searchsorted(np.cumsum(share[order]), rtol, side="right"))
    faint -= faint % _SOME
    if faint:
        lost = float(share[order[:faint]].sum())
        said.append(
            f"{faint} of {len(order)} elements of sky and ground: {lost:.1g} of their light"
        )
    return tuple(sorted(int(number) for number in order[faint:]))
