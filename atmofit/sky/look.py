"""Along a line of sight: how much light of each order arrives at the observer."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.geometry import scattering_angle
from atmofit.numerics import (
    batched_product,
    chebyshev_basis,
    gauss_nodes,
    harmonics,
    safe_divide,
    safe_sqrt,
)
from atmofit.optics.medium import Medium
from atmofit.optics.profiles import LayeredProfile
from atmofit.sky.paths import Paths, Point, stretched, unstretched
from atmofit.sky.plan import Plan
from atmofit.sky.sources import ModeBlock, Moments, sun_place, twilight
from atmofit.sky.sunlight import path_integrals, sun_columns
from atmofit.typing import Reals, Scalar

_HALF_PANEL_STEPS = 3  # at least so many from a kink of a tabulated density to midway


class LineOfSight(eqx.Module):
    """The steps along one view ray.

    Attributes:
        points: Where the steps are; every field is [step].
        length: Weight of each step in an integral over distance [m], [step].
        columns: From the observer to each step, over vertical columns [-], [step, constituent].
    """

    points: Point
    length: Float[Array, " step"]
    columns: Float[Array, "step constituent"]


def line_of_sight(
    medium: Medium, paths: Paths, observer: Scalar, view: Scalar, count: int, free_path: bool
) -> LineOfSight:
    """Steps along a view ray, dense where the scattered light comes from.

    Args:
        medium: Optical properties.
        paths: The geometry.
        observer: Altitude of the observer [m].
        view: View zenith angle [rad].
        count: Number of steps. Static.
        free_path: Whether steps follow the free path where it is shorter than the way to thinner
            air. If not, they depend on the density profiles only, and atmospheres that differ in
            optical depth share them. Static.
    """
    dtype = view.dtype
    # The float32 nearest to pi / 2 lies below the horizon.
    cosine, sine = jnp.maximum(jnp.cos(view), 0.0), jnp.sin(view)
    length = paths.length_up(observer, cosine, jnp.maximum(medium.top, observer))
    near = paths.length_up(observer, cosine, observer + medium.scale)
    if free_path:
        near = _within_free_path(medium, near, observer)
    edges = _edges(medium, paths, observer, cosine, length)
    if edges.size == 2:
        u, w = (jnp.asarray(x, dtype) for x in gauss_nodes(count))
        distance, slope = stretched(u, length, near)
        weight = slope * w
    else:
        middle = (edges[1:] + edges[:-1]) / 2
        altitude = paths.advance(observer, cosine, sine, middle).altitude
        fine = _within_free_path(medium, near, altitude) if free_path else near
        distance, weight = _in_panels(edges, jnp.broadcast_to(fine, middle.shape), count)
    start, across = observer[None], (cosine[None], sine[None])
    points = paths.advance(start, *across, distance)
    columns = [paths.column_up(p, start, cosine[None], points) for p in medium.profiles]
    return LineOfSight(points, weight, jnp.stack(columns, axis=-1))


def _within_free_path(medium: Medium, near: Scalar, altitude: Reals) -> Reals:
    """A distance, or the free path at an altitude and the most opaque wavelength if shorter."""
    density = jnp.stack([profile.density(altitude) for profile in medium.profiles], axis=-1)
    opaque = (density @ medium.extinction).max(axis=-1)
    return near / jnp.maximum(near * opaque, 1.0)


def _in_panels(
    edges: Float[Array, " edge"], near: Float[Array, " panel"], count: int
) -> tuple[Float[Array, " step"], Float[Array, " step"]]:
    """Steps between kinks, dense at both ends of every panel on its own free path.

    Light may come from either end of an opaque panel: from the near one if the view is the way
    out, from the far one if the sun's is.

    Returns:
        Distances and their weights [m].
    """
    panels = near.size
    each = max(_HALF_PANEL_STEPS, 5 * count // (2 * panels))
    u, w = (jnp.asarray(x, edges.dtype)[None, :] for x in gauss_nodes(each))
    inside, slope = stretched(u, jnp.diff(edges)[:, None] / 2, near[:, None])
    distance = jnp.concatenate([edges[:-1, None] + inside, edges[1:, None] - inside], axis=1)
    return distance.ravel(), jnp.tile(slope * w, (1, 2)).ravel()


def _edges(
    medium: Medium, paths: Paths, observer: Scalar, cosine: Scalar, length: Scalar
) -> Float[Array, " edge"]:
    """Distances at which a ray from the observer meets kinks of the scatterers' densities."""
    ends = jnp.stack([jnp.zeros_like(length), length])
    layered = [p for p in medium.scattering_profiles if isinstance(p, LayeredProfile)]
    if not layered:
        return ends
    levels = jnp.concatenate([profile.breakpoints() for profile in layered])
    here = jnp.broadcast_to(observer, levels.shape)
    inner = paths.length_up(here, cosine, jnp.clip(levels, observer, jnp.maximum(medium.top, here)))
    return jnp.sort(jnp.concatenate([ends, jnp.clip(inner, 0.0, length)]))


def local_sun(
    points: Point, azimuth: Float[Array, "ring azimuth"], sun: Scalar
) -> tuple[Reals, Reals, Reals]:
    """The sun seen from the points of some rays.

    Args:
        points: Of the rays, [ring, step].
        azimuth: Of the rays, 0 toward the sun [rad].
        sun: Solar zenith angle at the observer [rad].

    Returns:
        Cosine of the local solar zenith angle, its sine times the cosine of the local relative
        azimuth, and its sine times the sine of it; all [ring, azimuth, step].
    """
    ahead, aside = ((jnp.sin(sun) * f(azimuth))[..., None] for f in (jnp.cos, jnp.sin))
    turn_cosine, turn_sine = points.turn_cosine[:, None], points.turn_sine[:, None]
    up = jnp.cos(sun) * turn_cosine + ahead * turn_sine
    along = ahead * turn_cosine - jnp.cos(sun) * turn_sine
    return up, along, jnp.broadcast_to(aside, along.shape)


def single_scattering(
    medium: Medium,
    paths: Paths,
    sight: LineOfSight,
    view: Float[Array, " ring"],
    azimuth: Float[Array, "ring azimuth"],
    sun: Scalar,
    plan: Plan,
) -> tuple[Float[Array, "ring azimuth w"], ...]:
    """Radiance of sunlight scattered once with the exact phase function [1/sr].

    Over solar irradiance; one for each term of `forward_factors`, which belongs to one more order.
    The lines of sight are those of all rings.
    """
    # Where the sun is at the same place everywhere, one azimuth's light stands for all.
    distinct = azimuth if paths.curved else azimuth[:, :1]
    z = sight.points.altitude.T
    sun_cosine = jnp.moveaxis(local_sun(sight.points, distinct, sun)[0], -1, 0)
    toward_sun, up = sun_columns(medium, paths, z[..., None], sun_cosine)
    columns = toward_sun + jnp.transpose(sight.columns, (1, 2, 0))[..., None]
    density = jnp.stack([p.density(z) * sight.length.T for p in medium.scattering_profiles], axis=1)
    weight = density[..., None] * up[:, None]
    # All directions share an axis: long loops are fast ones.
    columns, weight = (values.reshape(*values.shape[:2], -1) for values in (columns, weight))
    angle = scattering_angle(jnp.broadcast_to(view[:, None], azimuth.shape), azimuth, sun)
    exact = medium.phase_functions(angle)

    def scattered(phases: tuple[Reals, ...], light: Reals) -> Float[Array, "ring azimuth w"]:
        light = jnp.moveaxis(light.reshape(*light.shape[:2], *distinct.shape), 1, -1)
        parts = [phase * part for phase, part in zip(phases, light, strict=True)]
        return functools.reduce(jnp.add, parts)

    if medium.peaks is None:
        return (scattered(exact, path_integrals(medium, columns, weight)[0]),)
    between = medium.deflected_phase_functions(angle, plan.nodes.degrees)
    if not plan.counts_peaks:
        # The extinction leaves the peaks out: light that met none, and all.
        none, every = path_integrals(medium, columns, weight, peaks="met or not")
        return (scattered(exact, none) + scattered(between, every - none),)
    terms = path_integrals(medium, columns, weight, peaks=plan.arriving_orders + 1)
    return (scattered(exact, terms[0]), *(scattered(between, term) for term in terms[1:]))


def sources_per_mode(
    medium: Medium, moments: Moments, sight: LineOfSight
) -> tuple[Float[Array, "m ring step w sun"], ...]:
    """What each step of some rays sends to the observer after another scattering, for every sun.

    Over `twilight`, as coefficients in the sun, for each block of modes. The lines of sight are
    those of all rings.
    """
    z = sight.points.altitude
    place = 2 * unstretched(z, moments.top, moments.scale) - 1
    basis = chebyshev_basis(jnp.clip(place, -1.0, 1.0), moments.log_brightness.shape[0])
    brightness = jnp.exp(basis @ moments.log_brightness)
    dimming = jnp.exp(-sight.columns @ medium.extinction) * sight.length[..., None] * brightness
    density = [profile.density(z) for profile in medium.scattering_profiles]
    y = harmonics(sight.points.cosine, sight.points.sine, moments.degrees, moments.modes)
    twice = jnp.where(jnp.arange(moments.modes) > 0, 2.0, 1.0).astype(y.dtype)
    y = y * twice[None, None, None, :]

    def of_block(block: ModeBlock) -> Float[Array, "m ring step w sun"]:
        modes = slice(block.first, block.first + block.sources.shape[0])
        parts = [
            y[:, :, block.first : degrees, modes] * dense[..., None, None]
            for degrees, dense in zip(block.degrees, density, strict=True)
            if degrees > block.first
        ]
        each = jnp.transpose(jnp.concatenate(parts, axis=2), (3, 0, 1, 2))
        each = basis[None, ..., None] * each[..., None, :]
        sent = batched_product(each.reshape(each.shape[0], z.size, -1), block.sources, 1)
        return sent.reshape(*each.shape[:3], *sent.shape[2:]) * dimming[None, ..., None]

    return tuple(of_block(block) for block in moments.blocks)


def diffuse_radiance(
    medium: Medium,
    moments: Moments,
    paths: Paths,
    sight: LineOfSight,
    azimuth: Float[Array, "ring azimuth"],
    sun: Scalar,
) -> Float[Array, "ring azimuth w"]:
    """Radiance of light scattered once more, over solar irradiance [1/sr].

    The lines of sight are those of all rings.
    """
    sources, points = sources_per_mode(medium, moments, sight), sight.points
    if not paths.curved:
        # The sun is at the same place everywhere, and twilight too.
        sources = tuple(block.sum(axis=2, keepdims=True) for block in sources)
        points = jax.tree.map(lambda values: values[:, :1], points)
    suns = sources[0].shape[-1]
    up, along, aside = local_sun(points, azimuth, sun)
    sine = safe_sqrt(along**2 + aside**2)
    angle = jnp.arctan2(sine, up)
    of_sun = chebyshev_basis(sun_place(angle, moments.local_suns), suns)
    altitude = points.altitude[:, None]
    of_sun = of_sun * twilight(paths, altitude, jnp.clip(angle, *moments.local_suns))[..., None]
    of_mode = jnp.moveaxis(chebyshev_basis(safe_divide(along, sine), moments.modes), -1, 2)
    total = jnp.zeros_like(of_sun[..., 0, :1])
    for block, part in zip(moments.blocks, sources, strict=True):
        of_block = of_mode[:, :, block.first : block.first + part.shape[0]]
        weight = of_block[..., None] * of_sun[:, :, None]
        total = total + jnp.einsum("ramqs,mrqws->raw", weight, part)
    # Where the sun gives no light, interpolation may leave -1e-6 of what it gives by day.
    return jnp.maximum(total, 0.0)
