"""Along a line of sight: how much light of each order arrives at the observer."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.geometry import scattering_angle
from atmofit.numerics import chebyshev_basis, gauss_nodes, harmonics, safe_divide, safe_sqrt
from atmofit.optics.medium import Medium
from atmofit.optics.profiles import LayeredProfile
from atmofit.sky.paths import Paths, Point, stretched, unstretched
from atmofit.sky.plan import Plan
from atmofit.sky.sources import Moments, forward_factors, sun_place, twilight
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
    start = jnp.broadcast_to(observer, distance.shape)
    across = (start, jnp.full_like(start, cosine), jnp.full_like(start, sine))
    points = paths.advance(*across, distance)
    columns = [paths.column_between(p, *across, points) for p in medium.profiles]
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


def local_sun(points: Point, azimuth: Scalar, sun: Scalar) -> tuple[Reals, Reals, Reals]:
    """The sun seen from the points of a ray.

    Args:
        points: Of the ray.
        azimuth: Of the ray, 0 toward the sun [rad].
        sun: Solar zenith angle at the observer [rad].

    Returns:
        Cosine of the local solar zenith angle, its sine times the cosine of the local relative
        azimuth, and its sine times the sine of it; all [step].
    """
    ahead = jnp.sin(sun) * jnp.cos(azimuth)
    up = jnp.cos(sun) * points.turn_cosine + ahead * points.turn_sine
    along = ahead * points.turn_cosine - jnp.cos(sun) * points.turn_sine
    return up, along, jnp.full_like(along, jnp.sin(sun) * jnp.sin(azimuth))


def single_scattering(
    medium: Medium,
    paths: Paths,
    sight: LineOfSight,
    view: Scalar,
    azimuth: Scalar,
    sun: Scalar,
    plan: Plan,
) -> tuple[Float[Array, " w"], ...]:
    """Radiance of sunlight scattered once with the exact phase function [1/sr].

    Over solar irradiance; one for each term of `forward_factors`, which belongs to one more order.
    """
    sun_cosine, _, _ = local_sun(sight.points, azimuth, sun)
    columns, up = [], jnp.ones_like(sun_cosine)
    for profile in medium.profiles:
        column, up = paths.sun_column(profile, sight.points.altitude, sun_cosine)
        columns.append(column)
    toward_sun = jnp.stack(columns, axis=-1)
    columns = toward_sun + sight.columns
    sunlight = jnp.exp(-(columns @ medium.extinction)) * up[:, None]
    angle = scattering_angle(view, azimuth, sun)
    weights = [p.density(sight.points.altitude) * sight.length for p in medium.scattering_profiles]

    def scattered(phases: tuple[Reals, ...], light: Reals) -> Float[Array, " w"]:
        parts = [phase * (weight @ light) for phase, weight in zip(phases, weights, strict=True)]
        return sum(parts[1:], parts[0])

    exact = medium.phase_functions(angle)
    deflected = medium.deflected(columns)
    if deflected is None:
        return (scattered(exact, sunlight),)
    between = medium.deflected_phase_functions(angle, plan.nodes.degrees)
    if not plan.counts_peaks:
        # The extinction leaves the peaks out: those that meet none, and all others.
        met = -jnp.expm1(-deflected)
        return (scattered(exact, sunlight * (1 - met)) + scattered(between, sunlight * met),)
    first, *others = forward_factors(deflected, plan.arriving_orders + 1)
    return (
        scattered(exact, sunlight * first),
        *(scattered(between, sunlight * factor) for factor in others),
    )


def diffuse_sources(
    medium: Medium, moments: Moments, sight: LineOfSight
) -> Float[Array, "step m sun w"]:
    """What each step of a ray sends to the observer after another scattering, for every sun.

    Over `twilight`, as coefficients in the sun.
    """
    altitudes, modes, degrees, _, _ = moments.coefficients.shape
    z = sight.points.altitude
    place = 2 * unstretched(z, moments.top, moments.scale) - 1
    basis = chebyshev_basis(jnp.clip(place, -1.0, 1.0), altitudes)
    brightness = jnp.exp(basis @ moments.log_brightness)
    arriving = jnp.tensordot(basis, moments.coefficients, 1)
    density = jnp.stack([profile.density(z) for profile in medium.scattering_profiles])
    scattered = jnp.tensordot(density.T, medium.moments(degrees, moments.whole), 1)
    dimming = jnp.exp(-sight.columns @ medium.extinction) * sight.length[:, None]
    strength = scattered * (dimming * brightness)[:, None, :]
    y = harmonics(sight.points.cosine, sight.points.sine, degrees, modes)
    twice = jnp.where(jnp.arange(modes) > 0, 2.0, 1.0).astype(y.dtype)
    y = y * twice[None, None, :]
    return jnp.einsum("qmlsw,qlm,qlw->qmsw", arriving, y, strength)


def diffuse_radiance(
    sources: Float[Array, "step m sun w"],
    moments: Moments,
    paths: Paths,
    points: Point,
    azimuth: Scalar,
    sun: Scalar,
) -> Float[Array, " w"]:
    """Radiance of light scattered once more, over solar irradiance [1/sr]."""
    _, modes, suns, _ = sources.shape
    up, along, aside = local_sun(points, azimuth, sun)
    sine = safe_sqrt(along**2 + aside**2)
    angle = jnp.arctan2(sine, up)
    of_sun = chebyshev_basis(sun_place(angle, moments.local_suns), suns)
    of_mode = chebyshev_basis(safe_divide(along, sine), modes)
    # One after the other: on a CPU five times as fast as with the product of both bases.
    at_sun = jnp.einsum("qu,qmuw->qmw", of_sun, sources)
    dimming = twilight(paths, points.altitude, jnp.clip(angle, *moments.local_suns))
    radiance = jnp.einsum("qm,qmw->w", of_mode * dimming[:, None], at_sun)
    # Where the sun gives no light, interpolation may leave -1e-6 of what it gives by day.
    return jnp.maximum(radiance, 0.0)
