"""Where a cloud is, and how much it takes from a ray: spheres, boxes and grids of voxels."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from atmofit.checks import in_range, is_traced
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.numerics import safe_sqrt
from atmofit.typing import RealsLike, Scalar, real_array, scalar

LARGEST_LENGTH = 1e6
LARGEST_EXTINCTION = 1e6
_LEVEL = 1e-30  # stands for a direction's component of 0

Vector = Float[Array, "3"]


class Cloud(eqx.Module):
    """Droplets inside a convex outline.

    Lengths are in m, or in any other unit with the extinction in its inverse. The methods are for
    one ray; vmap them.
    """

    @abc.abstractmethod
    def crossing(self, origin: Vector, direction: Vector) -> tuple[Scalar, Scalar]:
        """Distances to where a straight line enters and leaves the outline.

        Either may be negative; a line that misses leaves before, or where, it enters.
        """

    @abc.abstractmethod
    def inside(self, position: Vector) -> Bool[Array, ""]:
        """Whether a place is within the outline."""

    @abc.abstractmethod
    def largest_extinction(self) -> Scalar:
        """No place has more [1/m]."""

    @abc.abstractmethod
    def filling(self, position: Vector) -> Scalar:
        """Extinction over the largest [-], of a place inside."""

    @abc.abstractmethod
    def light_step(
        self, position: Vector, direction: Vector, number: Scalar
    ) -> tuple[Vector, Scalar, Bool[Array, ""]]:
        """One step of a ray of light from a place inside to the outline.

        Args:
            position: Where the ray has come to [m].
            direction: Unit vector.
            number: Random, 0 to 1.

        Returns:
            The next place [m]; a factor [-]; whether the ray has left. The mean of the product
            of all steps' factors is the transmittance.
        """

    @abc.abstractmethod
    def checked(self) -> "Cloud":
        """Refuse impossible values."""


class UniformCloud(Cloud):
    """The same extinction everywhere, so that one step is the whole way to the outline.

    Attributes:
        extinction_coefficient: [1/m].
    """

    extinction_coefficient: eqx.AbstractVar[Scalar]

    def largest_extinction(self) -> Scalar:
        """The extinction itself [1/m]."""
        return self.extinction_coefficient

    def filling(self, position: Vector) -> Scalar:
        """1, whatever the place."""
        return jnp.ones_like(position[0])

    def light_step(
        self, position: Vector, direction: Vector, number: Scalar
    ) -> tuple[Vector, Scalar, Bool[Array, ""]]:
        """All the way at once; takes no chance."""
        del number
        _, far = self.crossing(position, direction)
        # Rounding can put a place on the outline a little beyond it.
        transmittance = jnp.exp(-self.extinction_coefficient * jnp.maximum(far, 0.0))
        return position, transmittance, jnp.asarray(True)


class SphereCloud(UniformCloud):
    """A sphere about the origin.

    Attributes:
        radius: [m], above 0.
        extinction_coefficient: [1/m].
    """

    radius: Scalar = eqx.field(converter=scalar)
    extinction_coefficient: Scalar = eqx.field(converter=scalar)

    def crossing(self, origin: Vector, direction: Vector) -> tuple[Scalar, Scalar]:
        """Distances [m] along the line; the nearest point twice if it misses."""
        middle = -jnp.sum(origin * direction)
        # From the nearest point, so that no digits cancel where the origin is far away.
        nearest = origin + middle * direction
        half = safe_sqrt(self.radius**2 - jnp.sum(nearest**2))
        return middle - half, middle + half

    def inside(self, position: Vector) -> Bool[Array, ""]:
        """Within the radius."""
        return jnp.sum(position**2) < self.radius**2

    def checked(self) -> "SphereCloud":
        """Refuse radii and extinctions that no cloud has."""
        return SphereCloud(
            in_range("radius", self.radius, 1e-6, LARGEST_LENGTH, "m"),
            in_range(
                "extinction_coefficient", self.extinction_coefficient, 0.0, LARGEST_EXTINCTION
            ),
        )


class _Boxed(Cloud):
    """What lies in a box with edges along the axes.

    Attributes:
        low: Corner with the smallest coordinates [m].
        high: Opposite corner [m].
    """

    low: eqx.AbstractVar[Vector]
    high: eqx.AbstractVar[Vector]

    def crossing(self, origin: Vector, direction: Vector) -> tuple[Scalar, Scalar]:
        """Distances [m] to where the line is first between all three pairs of faces, and last."""
        moving = jnp.where(jnp.abs(direction) < _LEVEL, _LEVEL, direction)
        one, other = (self.low - origin) / moving, (self.high - origin) / moving
        return jnp.max(jnp.minimum(one, other)), jnp.min(jnp.maximum(one, other))

    def inside(self, position: Vector) -> Bool[Array, ""]:
        """Between all three pairs of faces."""
        return jnp.all((position > self.low) & (position < self.high))


class BoxCloud(_Boxed, UniformCloud):
    """A box with edges along the axes.

    Attributes:
        low: Corner with the smallest coordinates [m].
        high: Opposite corner [m].
        extinction_coefficient: [1/m].
    """

    low: Vector = eqx.field(converter=real_array)
    high: Vector = eqx.field(converter=real_array)
    extinction_coefficient: Scalar = eqx.field(converter=scalar)

    def checked(self) -> "BoxCloud":
        """Refuse extinctions and places that no cloud has."""
        return BoxCloud(
            in_range("low", self.low, -LARGEST_LENGTH, LARGEST_LENGTH, "m"),
            in_range("high", self.high, -LARGEST_LENGTH, LARGEST_LENGTH, "m"),
            in_range(
                "extinction_coefficient", self.extinction_coefficient, 0.0, LARGEST_EXTINCTION
            ),
        )


class VoxelCloud(_Boxed):
    """A box cut into equal voxels, each with its own extinction.

    Attributes:
        extinction_coefficient: [1/m], [x, y, z], of each voxel.
        low: Corner with the smallest coordinates [m].
        high: Opposite corner [m].
    """

    extinction_coefficient: Float[Array, "x y z"] = eqx.field(converter=real_array)
    low: Vector = eqx.field(converter=real_array)
    high: Vector = eqx.field(converter=real_array)

    def largest_extinction(self) -> Scalar:
        """Of the densest voxel [1/m]."""
        return jnp.max(self.extinction_coefficient)

    def filling(self, position: Vector) -> Scalar:
        """Extinction of the voxel there over the largest [-]; 0 in a cloud of nothing."""
        count = self.extinction_coefficient.shape
        size = jnp.asarray(count, position.dtype)
        place = jnp.floor((position - self.low) / (self.high - self.low) * size).astype(int)
        x, y, z = (jnp.clip(place[axis], 0, count[axis] - 1) for axis in range(3))
        largest = self.largest_extinction()
        return self.extinction_coefficient[x, y, z] / jnp.where(largest > 0, largest, 1.0)

    def light_step(
        self, position: Vector, direction: Vector, number: Scalar
    ) -> tuple[Vector, Scalar, Bool[Array, ""]]:
        """To the next of random places as dense as the largest extinction; its share is let by.

        References:
            Ratio tracking: Novak, Selle and Jarosz (2014), ACM Trans. Graph. 33, 179.
        """
        largest = self.largest_extinction()
        step = -jnp.log1p(-number) / jnp.where(largest > 0, largest, 1.0)
        there = position + step * direction
        left = ~self.inside(there) | ~(largest > 0)
        return there, jnp.where(left, 1.0, 1 - self.filling(there)), left

    def checked(self) -> "VoxelCloud":
        """Refuse extinctions and places that no cloud has."""
        return VoxelCloud(
            in_range(
                "extinction_coefficient", self.extinction_coefficient, 0.0, LARGEST_EXTINCTION
            ),
            in_range("low", self.low, -LARGEST_LENGTH, LARGEST_LENGTH, "m"),
            in_range("high", self.high, -LARGEST_LENGTH, LARGEST_LENGTH, "m"),
        )


def homogeneous_sphere(*, radius: RealsLike, extinction_coefficient: RealsLike) -> SphereCloud:
    """A sphere about the origin with the same extinction everywhere.

    Args:
        radius: [m], 1e-6 to 1e6.
        extinction_coefficient: [1/m], 0 to 1e6.

    Returns:
        The cloud.

    Raises:
        ValueError: A known argument is out of range.
    """
    return SphereCloud(radius, extinction_coefficient).checked()


extremes(
    Case("nothing", {"extinction_coefficient": 0.0}, limit=1.0),
    Case(
        "through the centre",
        {"radius": 1.0, "extinction_coefficient": 1.0, "offset": 0.0},
        limit=math.exp(-2),
    ),
    Case("tangent", {"radius": 1.0, "offset": 1.0}, limit=1.0),
    call=lambda radius, extinction_coefficient, offset: _transmittance(
        homogeneous_sphere(radius=radius, extinction_coefficient=extinction_coefficient), offset
    ),
    radius=Domain(1e-6, LARGEST_LENGTH),
    extinction_coefficient=Domain(0.0, LARGEST_EXTINCTION),
    offset=Span(0.0, 10.0),
    least=0.0,
)(homogeneous_sphere)


def homogeneous_cube(*, edge: RealsLike, extinction_coefficient: RealsLike) -> BoxCloud:
    """A cube about the origin, edges along the axes, with the same extinction everywhere.

    Args:
        edge: [m], 1e-6 to 1e6.
        extinction_coefficient: [1/m], 0 to 1e6.

    Returns:
        The cloud.

    Raises:
        ValueError: A known argument is out of range.
    """
    half = in_range("edge", edge, 1e-6, LARGEST_LENGTH, "m") / 2
    corner = jnp.broadcast_to(half, (3,))
    return BoxCloud(-corner, corner, extinction_coefficient).checked()


extremes(
    Case("nothing", {"extinction_coefficient": 0.0}, limit=1.0),
    Case("through", {"edge": 2.0, "extinction_coefficient": 1.0, "offset": 0.5}, math.exp(-2)),
    call=lambda edge, extinction_coefficient, offset: _transmittance(
        homogeneous_cube(edge=edge, extinction_coefficient=extinction_coefficient), offset
    ),
    edge=Domain(1e-6, LARGEST_LENGTH),
    extinction_coefficient=Domain(0.0, LARGEST_EXTINCTION),
    offset=Span(0.0, 10.0),
    least=0.0,
)(homogeneous_cube)


def voxel_cloud(extinction_coefficient: RealsLike, low: RealsLike, high: RealsLike) -> VoxelCloud:
    """A cloud on a grid of equal voxels, constant within each.

    Args:
        extinction_coefficient: [1/m], [x, y, z], 0 to 1e6.
        low: Corner of the grid with the smallest coordinates [m], 3 numbers.
        high: Opposite corner [m].

    Returns:
        The cloud.

    Raises:
        ValueError: A known argument is out of range, or the box has no volume, or the grid has
            not three axes.
    """
    grid = real_array(extinction_coefficient)
    if grid.ndim != 3 or grid.size == 0:
        raise ValueError(f"extinction_coefficient must be [x, y, z], got the shape {grid.shape}")
    corners = [real_array(corner).astype(grid.dtype) for corner in (low, high)]
    if not is_traced(corners) and not np.all(np.asarray(corners[0]) < np.asarray(corners[1])):
        raise ValueError(f"low must lie below high on every axis, got {low} and {high}")
    return VoxelCloud(grid, *corners).checked()


extremes(
    Case("nothing", {"extinction_coefficient": (0.0, 0.0)}, limit=(0.0, 1.0)),
    Case("half", {"extinction_coefficient": (1.0, 2.0)}, limit=(0.5, 0.5)),
    call=lambda extinction_coefficient: _lower_voxel(extinction_coefficient),
    extinction_coefficient=Domain((0.0, 0.0), (LARGEST_EXTINCTION, LARGEST_EXTINCTION)),
    derivative="none",
    least=0.0,
)(voxel_cloud)


def _transmittance(cloud: Cloud, offset: Scalar) -> Scalar:
    """Along a line parallel to z."""
    origin = jnp.stack([offset, 0 * offset, 0 * offset])
    near, far = cloud.crossing(origin, jnp.asarray((0.0, 0.0, 1.0), offset.dtype))
    return jnp.exp(-cloud.largest_extinction() * jnp.maximum(far - near, 0.0))


def _lower_voxel(extinction_coefficient: Float[Array, "2"]) -> tuple[Scalar, Scalar]:
    """Filling of the lower of two voxels, and what a ray that starts there is let by."""
    cloud = voxel_cloud(extinction_coefficient[None, None, :], (0.0, 0.0, 0.0), (1.0, 1.0, 1e6))
    dtype = extinction_coefficient.dtype
    place, up = (jnp.asarray((0.5, 0.5, 0.5), dtype), jnp.asarray((0.0, 0.0, 1.0), dtype))
    _, factor, _ = cloud.light_step(place, up, jnp.asarray(0.5, dtype))
    return cloud.filling(place), factor
