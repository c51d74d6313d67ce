"""The light of a solved sky, looked at from below."""

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.geometry import DirectionGrid, Directions
from atmofit.numerics import with_slopes_of
from atmofit.optics.medium import Medium
from atmofit.sky.look import (
    LineOfSight,
    diffuse_radiance,
    line_of_sight,
    single_scattering,
)
from atmofit.sky.luminance import luminance_nodes
from atmofit.sky.paths import Paths
from atmofit.sky.plan import ZENITH, Plan
from atmofit.sky.sources import Moments
from atmofit.sky.wavelengths import Samples, log_radiance, to_asked
from atmofit.spectrum import Spectrum
from atmofit.sun import irradiance_at
from atmofit.typing import Reals, RealsLike, Scalar

T = TypeVar("T")

_PAPER_LIMIT = math.radians(70.0)  # below, the 1999 paper takes the Earth as flat
# Worked on at a time, a compromise of memory and speed.
_RINGS_AT_ONCE, _DIRECTIONS_AT_ONCE = 32, 512
HIGHEST_OBSERVER = 1e5  # [m]


class SkyField(eqx.Module):
    """Everything about an atmosphere's light that needs neither sun nor view direction.

    Attributes:
        medium: Optical properties of the computed samples.
        moments: Light that is scattered once more on the way to the observer, everywhere; for
            each geometry one table, or one for each order; empty if one order was asked for.
        samples: Wavelengths that are computed, and those asked for.
        paths: Geometries: one, or flat and spherical for "paper".
        for_slopes: The coarser field whose slopes stand for those of this one, or None.
        plan: How it was computed. Static.
        preset: Source of the sun's spectrum. Static.
    """

    medium: Medium | None
    moments: tuple[tuple[Moments, ...], ...]
    samples: Samples
    paths: tuple[Paths, ...]
    for_slopes: "SkyField | None"
    plan: Plan = eqx.field(static=True)
    preset: str = eqx.field(static=True)

    def radiance(
        self,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        solar_irradiance: RealsLike | Spectrum | None = None,
        observer_altitude: RealsLike = 0.0,
    ) -> Reals:
        """Radiance of the sky.

        Args:
            solar_zenith_angle: At the observer [rad], a number: 0 to 96 degrees if the planet is
                round, else to 90 degrees; within what the plan was made for.
            directions: A list or a grid, down to the horizon.
            solar_irradiance: At the top of the atmosphere [W m^-2 nm^-1], a number, one for each
                wavelength, or a `Spectrum`; 1.0 gives radiance per irradiance [1/sr]; None: the
                spectrum of the atmosphere's preset.
            observer_altitude: 0 to 100,000 [m].

        Returns:
            Radiance [W m^-2 sr^-1 nm^-1], [direction, wavelength] for a list and
            [zenith, azimuth, wavelength] for a grid. The sun's own disk is not in it. The second
            order is held at 0 where interpolation would leave a trace below it (1e-6 of noon's).

        Raises:
            ValueError: Sun or directions lie outside their range.
        """
        by_order = self._by_order(
            solar_zenith_angle, directions, solar_irradiance, observer_altitude
        )
        return by_order.sum(axis=0)

    def radiance_by_order(
        self,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        solar_irradiance: RealsLike | Spectrum | None = None,
        observer_altitude: RealsLike = 0.0,
    ) -> Reals:
        """Radiance of each scattering order, on a new first axis.

        Args:
            solar_zenith_angle: This and all that follows as in `radiance`.
            directions: A list or a grid.
            solar_irradiance: At the top of the atmosphere.
            observer_altitude: [m].

        Raises:
            ValueError: As `radiance`, or the plan was not made with `by_order=True`.
        """
        if not self.plan.by_order:
            raise ValueError("plan must keep the orders apart: plan_sky(..., by_order=True)")
        return self._by_order(solar_zenith_angle, directions, solar_irradiance, observer_altitude)

    def _by_order(
        self,
        solar_zenith_angle: RealsLike,
        directions: Directions | DirectionGrid,
        solar_irradiance: RealsLike | Spectrum | None,
        observer_altitude: RealsLike,
    ) -> Reals:
        """Radiance by order, or with one sum as its first axis."""
        dtype = self.plan.dtype
        sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, *self.plan.suns)
        if sun.ndim != 0:
            raise ValueError(
                f"solar_zenith_angle must be one number (vmap over several), got shape {sun.shape}"
            )
        observer = in_range("observer_altitude", observer_altitude, 0.0, HIGHEST_OBSERVER, "m")
        as_list = directions.as_list() if isinstance(directions, DirectionGrid) else directions
        as_list = as_list.checked()
        if self.plan.zenith_only:
            view = in_range("view_zenith_angle", as_list.view_zenith_angle, 0.0, ZENITH, "rad")
            as_list = Directions(view, as_list.relative_azimuth, as_list.rings)
        irradiance = irradiance_at(self.samples.asked_nm, solar_irradiance, self.preset)
        where = (sun.astype(dtype), cast(as_list, dtype), observer.astype(dtype).reshape(()))
        if self.for_slopes is None:
            values = _radiance(self, *where)
        else:
            held = jax.lax.stop_gradient(where)
            values = with_slopes_of(_radiance(self, *held), _radiance(self.for_slopes, *where))
        values = values * irradiance[None, None, :]
        return values.reshape(values.shape[0], *directions.shape, -1)

    def luminance(
        self, solar_zenith_angle: RealsLike, directions: Directions | DirectionGrid
    ) -> Reals:
        """Luminance of the sky at the ground, under the sun of the atmosphere's preset.

        Args:
            solar_zenith_angle: As in `radiance` [rad], a number.
            directions: A list or a grid, down to the horizon.

        Returns:
            Luminance [cd m^-2] in the shape of the directions: what `spectrum_to_XYZ` makes of
            380 to 780 nm by 10 nm.

        Raises:
            ValueError: Sun or directions lie outside their range, or the field was not solved
                for luminance.
        """
        if self.plan.quantity != "luminance":
            raise ValueError(
                'plan must be made for quantity "luminance" (plan_sky), '
                f"got {self.plan.quantity!r}; spectrum_to_XYZ takes the radiance to luminance"
            )
        nodes = luminance_nodes(self.plan.luminance_nodes, self.preset)
        relative = self.radiance(solar_zenith_angle, directions, 1.0)
        if nodes.interpolation is not None:
            dark, log = log_radiance(relative)
            log = log @ jnp.asarray(nodes.interpolation, relative.dtype).T
            relative = jnp.where(dark.all(-1, keepdims=True), 0.0, jnp.exp(log))
        return relative @ jnp.asarray(nodes.weight, relative.dtype)


def cast(tree: T, dtype: str) -> T:
    """Every array of a tree in one dtype."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if eqx.is_array(leaf) else leaf, tree)


@eqx.filter_jit
def _radiance(
    field: SkyField, sun: Scalar, directions: Directions, observer: Scalar
) -> Float[Array, "order direction wavelength"]:
    """Radiance over solar irradiance [1/sr], by order or with one sum."""
    zenith = directions.view_zenith_angle
    orders = field.plan.orders if field.plan.by_order else 1
    if field.medium is None:
        shape = (orders, zenith.size, field.samples.asked_nm.size)
        return jnp.zeros(shape, field.samples.asked_nm.dtype)
    values = [_radiance_in(field, i, sun, directions, observer) for i in range(len(field.paths))]
    computed = values[0]
    if len(values) > 1:
        low = (zenith < _PAPER_LIMIT) & (sun < _PAPER_LIMIT)
        computed = jnp.where(low[None, :, None], values[0], values[1])
    return to_asked(computed, field.samples)


def _radiance_in(
    field: SkyField, geometry: int, sun: Scalar, directions: Directions, observer: Scalar
) -> Float[Array, "order direction w"]:
    """Radiance in one geometry at the computed wavelengths, ring by ring."""
    medium, plan, paths = field.medium, field.plan, field.paths[geometry]
    moments = field.moments[geometry] if field.moments else ()
    assert medium is not None
    zenith, azimuth, place = _by_ring(directions)

    def of_rings(
        rings: tuple[Float[Array, " ring"], Float[Array, "ring azimuth"]],
    ) -> Float[Array, "ring azimuth order w"]:
        view, azimuths = rings

        def sights(count: int, free_path: bool) -> LineOfSight:
            return jax.vmap(
                lambda one: line_of_sight(medium, paths, observer, one, count, free_path)
            )(view)

        sight = sights(plan.nodes.view, free_path=True)
        single = single_scattering(medium, paths, sight, view, azimuths, sun, plan)
        sight = sights(plan.nodes.view_second, free_path=False)
        diffuse = [
            diffuse_radiance(medium, table, paths, sight, azimuths, sun) for table in moments
        ]
        return _gather_orders(single, diffuse, plan)

    count, widest = azimuth.shape
    most = max(1, min(_RINGS_AT_ONCE, _DIRECTIONS_AT_ONCE // widest))
    batches = -(-count // most)
    each = -(-count // batches)
    # The last batch repeats the last ring where there are not enough.
    rings = np.minimum(np.arange(batches * each), count - 1).reshape(batches, each)
    values = jax.lax.map(jax.checkpoint(of_rings), (zenith[rings], azimuth[rings]))
    values = values.reshape(-1, *values.shape[3:])[place]
    return jnp.moveaxis(values, 1, 0)


def _gather_orders(
    single: tuple[Reals, ...], diffuse: list[Reals], plan: Plan
) -> Float[Array, "ring azimuth order w"]:
    """Orders apart, or their sum."""
    if not plan.by_order:
        parts = [*single, *diffuse]
        return sum(parts[1:], parts[0])[..., None, :]
    orders = [jnp.zeros_like(single[0])] * int(plan.orders)
    for order, part in enumerate(single):
        orders[order] = orders[order] + part
    for order, part in enumerate(diffuse, 1):
        orders[order] = orders[order] + part
    return jnp.stack(orders, axis=-2)


def _by_ring(
    directions: Directions,
) -> tuple[Float[Array, " ring"], Float[Array, "ring azimuth"], np.ndarray]:
    """Zenith angle of each ring, its azimuths (padded), and where each direction is found."""
    counts = directions.rings if directions.rings is not None else (1,) * directions.shape[0]
    starts, widest = directions.ring_starts, max(counts)
    column = np.minimum(np.arange(widest)[None, :], np.asarray(counts)[:, None] - 1)
    order = np.concatenate([np.arange(count) + ring * widest for ring, count in enumerate(counts)])
    azimuth = directions.relative_azimuth[starts[:, None] + column]
    return directions.view_zenith_angle[starts], azimuth, order
