"""The public simulator: from an atmosphere to the radiance of its sky."""

import math
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range, is_traced
from atmofit.constants import MAXIMUM_WAVELENGTH_NM, MINIMUM_WAVELENGTH_NM
from atmofit.geometry import DirectionGrid, Directions
from atmofit.numerics import chebyshev_basis, chebyshev_nodes, chebyshev_transform
from atmofit.optics.atmosphere import Atmosphere, Medium, optical_properties
from atmofit.sky.look import (
    LineOfSight,
    diffuse_radiance,
    diffuse_sources,
    line_of_sight,
    single_scattering,
)
from atmofit.sky.luminance import LuminanceNodes, luminance_nodes
from atmofit.sky.paths import FlatPaths, Paths, PseudoSphericalPaths, SphericalPaths
from atmofit.sky.plan import ZENITH, Plan, plan_sky
from atmofit.sky.sources import Moments, light_everywhere
from atmofit.spectrum import Spectrum, at, check_wavelengths
from atmofit.sun import solar_irradiance_spectrum
from atmofit.typing import Reals, RealsLike, Scalar

T = TypeVar("T")

_PAPER_LIMIT = math.radians(70.0)  # below, the 1999 paper takes the Earth as flat
_RING_BATCH = 16  # directions worked on at a time, a compromise of memory and speed
_NARROWEST_NM = 1.0  # of the interval on which wavelength nodes are laid
HIGHEST_OBSERVER = 1e5  # [m]


class SkyField(eqx.Module):
    """Everything about an atmosphere's light that needs neither sun nor view direction.

    Attributes:
        medium: Optical properties at the computed wavelengths.
        moments: Light that is scattered once more on the way to the observer, everywhere; for
            each geometry one table, or one for each order; empty if one order was asked for.
        wavelength_nm: The wavelengths asked for [nm].
        paths: Geometries: one, or flat and spherical for "paper".
        plan: How it was computed. Static.
        preset: Source of the sun's spectrum. Static.
    """

    medium: Medium | None
    moments: tuple[tuple[Moments, ...], ...]
    wavelength_nm: Float[Array, " wavelength"]
    paths: tuple[Paths, ...]
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
                round and the plan does not leave twilight out, else to 90 degrees.
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
        sun = angle_in_range("solar_zenith_angle", solar_zenith_angle, 0.0, self.plan.latest_sun)
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
        irradiance = self._irradiance(solar_irradiance)
        values = _radiance(
            self, sun.astype(dtype), _cast(as_list, dtype), observer.astype(dtype).reshape(())
        )
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
        nodes = _luminance_nodes(self.plan, self.preset)
        relative = self.radiance(solar_zenith_angle, directions, 1.0)
        if nodes.interpolation is not None:
            relative = _interpolate_log(relative, jnp.asarray(nodes.interpolation, relative.dtype))
        return relative @ jnp.asarray(nodes.weight, relative.dtype)

    def _irradiance(self, given: RealsLike | Spectrum | None) -> Float[Array, " wavelength"]:
        """Solar irradiance at the wavelengths asked for."""
        if given is None:
            given = solar_irradiance_spectrum(self.preset)
        if isinstance(given, Spectrum):
            return at(given, self.wavelength_nm)
        values = in_range("solar_irradiance", given, 0.0, math.inf, "W m^-2 nm^-1")
        if values.shape not in ((), self.wavelength_nm.shape):
            raise ValueError(
                "solar_irradiance must be a number or one for each wavelength "
                f"{self.wavelength_nm.shape}, got shape {values.shape}"
            )
        return jnp.broadcast_to(values.astype(self.plan.dtype), self.wavelength_nm.shape)


def solve_sky(
    atmosphere: Atmosphere,
    wavelength_nm: RealsLike | None,
    orders: int | str = 2,
    rtol: float = 1e-2,
    plan: Plan | None = None,
) -> SkyField:
    """Solve for the light inside an atmosphere, for all suns at once.

    Args:
        atmosphere: What the air is made of.
        wavelength_nm: Wavelengths [nm], a number or an increasing list, 200 to 3000. None with a
            plan for luminance, which brings its own.
        orders: Scattering orders to sum, 1 to 20, or "all". Static.
        rtol: Promised relative error of luminance, 5e-4 to 1. Static.
        plan: From `plan_sky`; replaces `orders` and `rtol`. Static.

    Returns:
        A field whose `radiance` (or `luminance`) method takes sun and directions.

    Raises:
        ValueError: An argument lies outside its range.
    """
    checked = atmosphere.checked()
    if plan is None:
        plan = plan_sky(checked, orders=orders, rtol=rtol)
    wavelength = jnp.atleast_1d(
        in_range(
            "wavelength_nm",
            _planned_wavelengths(wavelength_nm, plan, checked.preset),
            MINIMUM_WAVELENGTH_NM,
            MAXIMUM_WAVELENGTH_NM,
            "nm",
        )
    )
    if wavelength.ndim != 1 or wavelength.size == 0:
        raise ValueError(f"wavelength_nm must be a list, got shape {wavelength.shape}")
    if not is_traced(wavelength):
        check_wavelengths(np.asarray(wavelength))
    _check_spectra(checked, wavelength)
    return _solve(_cast(checked, plan.dtype), wavelength.astype(plan.dtype), plan)


def simulate_sky(
    atmosphere: Atmosphere,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    wavelength_nm: RealsLike,
    orders: int | str = 2,
    rtol: float = 1e-2,
    solar_irradiance: RealsLike | Spectrum | None = None,
    plan: Plan | None = None,
) -> Reals:
    """Radiance of the sky at the ground: `solve_sky`, then `SkyField.radiance`.

    For several suns over one atmosphere, call `solve_sky` once and vmap `radiance`.
    """
    field = solve_sky(atmosphere, wavelength_nm, orders, rtol, plan)
    return field.radiance(solar_zenith_angle, directions, solar_irradiance)


def simulate_luminance(
    atmosphere: Atmosphere,
    solar_zenith_angle: RealsLike,
    directions: Directions | DirectionGrid,
    orders: int | str = 2,
    rtol: float = 1e-2,
    plan: Plan | None = None,
) -> Reals:
    """Luminance of the sky [cd m^-2]: `solve_sky` for luminance, then `SkyField.luminance`.

    Chromaticity and spectrum are left out, so that few wavelengths take the place of 41. For
    several suns over one atmosphere, call `solve_sky` once and vmap `luminance`.
    """
    if plan is None:
        plan = plan_sky(atmosphere, quantity="luminance", orders=orders, rtol=rtol)
    return solve_sky(atmosphere, None, plan=plan).luminance(solar_zenith_angle, directions)


def _planned_wavelengths(given: RealsLike | None, plan: Plan, preset: str) -> RealsLike:
    """The wavelengths asked for, or those that a plan for luminance brings."""
    if plan.quantity != "luminance":
        if given is None:
            raise ValueError('wavelength_nm may be None only with a plan for quantity "luminance"')
        return given
    if given is not None:
        raise ValueError(
            'wavelength_nm must be None with a plan for quantity "luminance", which brings its own'
        )
    return _luminance_nodes(plan, preset).wavelength_nm


def _luminance_nodes(plan: Plan, preset: str) -> LuminanceNodes:
    return luminance_nodes(plan.luminance_nodes, preset)


@eqx.filter_jit
def _solve(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"], plan: Plan) -> SkyField:
    """The jitted kernel of `solve_sky`."""
    paths = _paths(atmosphere)
    medium, moments = None, ()
    if atmosphere.molecules is not None or atmosphere.haze is not None:
        medium = optical_properties(atmosphere, _computed_wavelengths(wavelength_nm, plan))
        if plan.orders != 1:
            medium = medium.peaks_apart(plan.nodes.degrees, unscattered=not plan.counts_peaks)
            moments = tuple(light_everywhere(medium, p, plan) for p in paths)
    return SkyField(medium, moments, wavelength_nm, paths, plan, atmosphere.preset)


@eqx.filter_jit
def _radiance(
    field: SkyField, sun: Scalar, directions: Directions, observer: Scalar
) -> Float[Array, "order direction wavelength"]:
    """Radiance over solar irradiance [1/sr], by order or with one sum."""
    zenith = directions.view_zenith_angle
    orders = field.plan.orders if field.plan.by_order else 1
    if field.medium is None:
        shape = (orders, zenith.size, field.wavelength_nm.size)
        return jnp.zeros(shape, field.wavelength_nm.dtype)
    values = [_radiance_in(field, i, sun, directions, observer) for i in range(len(field.paths))]
    computed = values[0]
    if len(values) > 1:
        low = (zenith < _PAPER_LIMIT) & (sun < _PAPER_LIMIT)
        computed = jnp.where(low[None, :, None], values[0], values[1])
    return _to_asked_wavelengths(computed, field.medium.wavelength_nm, field.wavelength_nm)


def _radiance_in(
    field: SkyField, geometry: int, sun: Scalar, directions: Directions, observer: Scalar
) -> Float[Array, "order direction w"]:
    """Radiance in one geometry at the computed wavelengths, ring by ring."""
    medium, plan, paths = field.medium, field.plan, field.paths[geometry]
    moments = field.moments[geometry] if field.moments else ()
    assert medium is not None
    zenith, azimuth, place = _by_ring(directions)

    def of_ring(ring: tuple[Scalar, Float[Array, " azimuth"]]) -> Float[Array, "azimuth order w"]:
        view, azimuths = ring
        count = plan.nodes.view
        sight = line_of_sight(medium, paths, observer, view, count, free_path=True)
        single = jax.vmap(lambda a: single_scattering(medium, paths, sight, view, a, sun, plan))(
            azimuths
        )
        count = plan.nodes.view_second
        sight = line_of_sight(medium, paths, observer, view, count, free_path=False)
        diffuse = [_diffuse(medium, paths, table, sight, azimuths, sun) for table in moments]
        return _gather_orders(single, diffuse, plan)

    batch = max(1, _RING_BATCH // azimuth.shape[1])
    values = jax.lax.map(of_ring, (zenith, azimuth), batch_size=batch)
    values = values.reshape(-1, *values.shape[2:])[place]
    return jnp.moveaxis(values, 1, 0)


def _diffuse(
    medium: Medium, paths: Paths, table: Moments, sight: LineOfSight, azimuths: Reals, sun: Scalar
) -> Float[Array, "azimuth w"]:
    """Radiance from one table of moments along one ring."""
    sources = diffuse_sources(medium, table, sight)
    return jax.vmap(lambda a: diffuse_radiance(sources, table, paths, sight.points, a, sun))(
        azimuths
    )


def _gather_orders(
    single: tuple[Reals, ...], diffuse: list[Reals], plan: Plan
) -> Float[Array, "azimuth order w"]:
    """Orders apart, or their sum."""
    if not plan.by_order:
        parts = [*single, *diffuse]
        return sum(parts[1:], parts[0])[:, None]
    orders = [jnp.zeros_like(single[0])] * int(plan.orders)
    for order, part in enumerate(single):
        orders[order] = orders[order] + part
    for order, part in enumerate(diffuse, 1):
        orders[order] = orders[order] + part
    return jnp.stack(orders, axis=1)


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


def _computed_wavelengths(wavelength_nm: Float[Array, " w"], plan: Plan) -> Float[Array, " n"]:
    """The wavelengths asked for, or the fewer nodes between which radiance is interpolated."""
    every = plan.all_wavelengths or plan.quantity == "luminance"
    if every or wavelength_nm.size <= plan.nodes.wavelength:
        return wavelength_nm
    dtype = wavelength_nm.dtype
    short, long = _interval(wavelength_nm)
    unit = jnp.asarray((chebyshev_nodes(plan.nodes.wavelength) + 1) / 2, dtype)
    return 1 / jnp.sqrt(short + (long - short) * unit)


def _interval(wavelength_nm: Float[Array, " w"]) -> tuple[Scalar, Scalar]:
    """Ends of the wavelength range in 1 / wavelength^2, never the same."""
    low = wavelength_nm.min()
    high = jnp.maximum(wavelength_nm.max(), low + _NARROWEST_NM)
    return 1 / high**2, 1 / low**2


def _to_asked_wavelengths(
    computed: Float[Array, "order direction n"],
    nodes_nm: Float[Array, " n"],
    wavelength_nm: Float[Array, " w"],
) -> Float[Array, "order direction w"]:
    """Interpolate log radiance by the polynomial in wavelength^-2 through the nodes."""
    if nodes_nm.size == wavelength_nm.size:
        return computed
    low, high = _interval(wavelength_nm)
    place = jnp.clip(2 * (1 / wavelength_nm**2 - low) / (high - low) - 1, -1.0, 1.0)
    transform = jnp.asarray(chebyshev_transform(nodes_nm.size), computed.dtype)
    return _interpolate_log(computed, chebyshev_basis(place, nodes_nm.size) @ transform)


def _interpolate_log(computed: Reals, matrix: Float[Array, "w n"]) -> Reals:
    """Radiance [..., n] taken to [..., w] by a matrix that interpolates its logarithm."""
    tiny = jnp.finfo(computed.dtype).tiny
    dark = computed <= tiny  # not NaN, which stays NaN
    log = jnp.log(jnp.where(dark, tiny, computed))
    return jnp.where(dark.all(-1, keepdims=True), 0.0, jnp.exp(log @ matrix.T))


def _paths(atmosphere: Atmosphere) -> tuple[Paths, ...]:
    """One geometry, or for "paper" flat and spherical."""
    flat, sphere = FlatPaths(), SphericalPaths(atmosphere.radius)
    if atmosphere.geometry == "paper":
        return (flat, sphere)
    pseudo = PseudoSphericalPaths(sphere)
    return ({"flat": flat, "spherical": sphere, "pseudo-spherical": pseudo}[atmosphere.geometry],)


def _check_spectra(atmosphere: Atmosphere, wavelength_nm: Float[Array, " w"]) -> None:
    """Refuse wavelengths outside a constituent's spectra, before the kernel."""
    for leaf in jax.tree.leaves(atmosphere, is_leaf=lambda node: isinstance(node, Spectrum)):
        if isinstance(leaf, Spectrum) and not is_traced(leaf, wavelength_nm):
            leaf(wavelength_nm)


def _cast(tree: T, dtype: str) -> T:
    """Every array of a tree in one dtype."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if eqx.is_array(leaf) else leaf, tree)
