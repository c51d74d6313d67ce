"""Where rays meet the surface of metaballs, by Bezier clipping.

Between two places where a ray enters or leaves a ball, the density along it is a polynomial of
degree 6. Its graph lies within the convex hull of 7 control points, so a root can only be where
that hull meets the threshold: the interval is cut down to there, over and over.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from atmofit.checks import in_range, is_traced
from atmofit.clouds.metaballs import Metaballs, fields, metaballs
from atmofit.clouds.volume import LARGEST_LENGTH
from atmofit.extremes import Case, Span, extremes
from atmofit.numerics import safe_divide, safe_sqrt
from atmofit.typing import Reals, RealsLike, Scalar

# Pairs of control points; 32 bits serve both precisions, of which JAX remembers the first.
_FIRST, _SECOND = (one.astype(np.int32) for one in np.triu_indices(7, 1))
_SLACK = 16  # rounding errors by which the level is lowered, so that a touching ray is found
_NARROW = 4  # rounding errors of a distance that count as one place
_HARDLY = 0.8  # a cut that leaves more than this is not worth it: halve instead
_STEPS = 64  # cuts allowed for each interval, on average
_AT_ONCE = 128  # rays worked on together: few wait for the slowest, and all stay in the cache
_SHALLOW = 1e-6  # slope over a ball's radius, in thresholds, below which a ray only touches

Points = Float[Array, "7"]


class SurfaceHit(NamedTuple):
    """Where rays meet a surface.

    Attributes:
        distance: [...], [m]; infinity where a ray meets none.
        normal: [..., 3], outward unit vector; 0 where a ray meets none.
    """

    distance: Reals
    normal: Reals


def surface_hit(balls: Metaballs, origin: RealsLike, direction: RealsLike) -> SurfaceHit:
    """First place ahead where rays cross or touch the surface of metaballs.

    A ray that starts inside finds its way out. Derivatives of the distance are those of the place
    met; they are 0 for a ray that only touches, where they grow beyond bounds.

    Args:
        balls: The balls; there may be none.
        origin: [..., 3], where the rays start [m], to 1e6.
        direction: [..., 3], of any length from 1e-6; both broadcast.

    Returns:
        Distances and normals.

    Raises:
        ValueError: A known value is out of range.

    References:
        Nishita and Nakamae (1994), Computer Graphics Forum 13, c271: the idea. Here each
        interval's control points are made anew from the balls' quadratics, whose products they
        are, so that repeated cutting loses no digits.
    """
    dtype = balls.radii.dtype
    start = in_range("origin", origin, -LARGEST_LENGTH, LARGEST_LENGTH, "m").astype(dtype)
    toward = in_range("direction", direction, -LARGEST_LENGTH, LARGEST_LENGTH).astype(dtype)
    if start.shape[-1:] != (3,) or toward.shape[-1:] != (3,):
        raise ValueError(f"rays need 3 coordinates, got {start.shape} and {toward.shape}")
    shape = np.broadcast_shapes(start.shape, toward.shape)
    start, toward = (jnp.broadcast_to(x, shape).reshape(-1, 3) for x in (start, toward))
    length = in_range("length of direction", _length(toward), 1e-6, 4 * LARGEST_LENGTH)
    balls = balls.checked()
    if not balls.count or not start.size:
        return SurfaceHit(jnp.full(shape[:-1], jnp.inf, dtype), jnp.zeros(shape, dtype))
    found = _hit(balls, start, toward / length[:, None], kept_balls(balls, start, toward))
    return SurfaceHit(found.distance.reshape(shape[:-1]), found.normal.reshape(shape))


extremes(
    Case(
        "away from it",
        {"origin": (-3.0, 0.0, 0.0), "direction": (-1.0, 0.0, 0.0)},
        limit=(-1.0, 0.0, 0.0, 0.0),
    ),
    Case("from its centre", {"origin": (0.0, 0.0, 0.0), "direction": (0.0, 0.0, 1.0)}),
    Case("along its edge", {"origin": (-3.0, 1.0, 0.0), "direction": (1.0, 0.0, 0.0)}),
    Case(
        "touching",
        {"origin": (-3.0, 0.0, 0.0), "direction": (1.0, 0.0, 0.0), "density": 0.125},
    ),
    Case("no density", {"density": 0.0}, limit=(-1.0, 0.0, 0.0, 0.0)),
    call=lambda origin, direction, density: _finite(
        surface_hit(
            metaballs(
                jnp.zeros((2, 3), origin.dtype),
                jnp.ones(2, origin.dtype),
                jnp.stack([density, density]),
            ),
            origin,
            direction,
        )
    ),
    origin=Span((-5.0, -1.0, -1.0), (0.0, 1.0, 1.0)),
    direction=Span((0.5, -0.5, -0.5), (2.0, 0.5, 0.5)),
    density=Span(0.0, 100.0),
    heavy=True,
)(surface_hit)


def _finite(hit: SurfaceHit) -> tuple[Reals, ...]:
    met = jnp.isfinite(hit.distance)
    return jnp.where(met, hit.distance, -1.0), *hit.normal


def kept_balls(balls: Metaballs, start: Reals, toward: Reals) -> int:
    """Most balls that one of the rays crosses, rounded up to a power of two; all if unknown."""
    if is_traced(balls, start, toward):
        return balls.count
    most = int(_most_on_a_ray(balls, start, toward / _length(toward)[:, None]))
    # Powers of two: few programs for many clouds.
    return min(balls.count, 1 << max(most - 1, 0).bit_length())


def _length(vectors: Reals) -> Reals:
    return safe_sqrt(jnp.sum(vectors * vectors, axis=-1))


def _chords(balls: Metaballs, start: Reals, toward: Reals) -> tuple[Reals, Reals]:
    """[ball] distances where a ray enters and leaves each ball; infinite where it misses."""
    offset = balls.centres - start[None, :]
    along = offset @ toward
    # From the nearest point, so that no digits cancel where the ray starts far away.
    aside = offset - along[:, None] * toward[None, :]
    half = safe_sqrt(balls.radii**2 - jnp.sum(aside * aside, axis=-1))
    enter, leave = jnp.maximum(along - half, 0.0), along + half
    met = (half > 0) & (leave > 0)
    return jnp.where(met, enter, jnp.inf), jnp.where(met, leave, jnp.inf)


@eqx.filter_jit
def _most_on_a_ray(balls: Metaballs, start: Reals, toward: Reals) -> Int[Array, ""]:
    def count(ray: tuple[Reals, Reals]) -> Int[Array, ""]:
        return jnp.sum(jnp.isfinite(_chords(balls, *ray)[0]))

    return jnp.max(jax.lax.map(count, (start, toward), batch_size=_AT_ONCE))


@eqx.filter_jit
def _hit(balls: Metaballs, start: Reals, toward: Reals, kept: int) -> SurfaceHit:
    still = jax.lax.stop_gradient((balls, start, toward))
    found = jax.lax.map(
        lambda ray: _first_root(still[0], ray[0], ray[1], kept), still[1:], batch_size=_AT_ONCE
    )
    met = jnp.isfinite(found)
    # NaN stays NaN.
    fixed = jnp.where(found == jnp.inf, 0.0, found)
    here = fields(balls, start + fixed[:, None] * toward)
    # The implicit function theorem: the place moves so that the density stays the threshold.
    slope = jax.lax.stop_gradient(-jnp.sum(here.outward * toward, axis=-1))
    steep = jnp.abs(slope) * jnp.min(still[0].radii) > _SHALLOW * still[0].threshold
    excess = here.density - balls.threshold
    change = excess - jax.lax.stop_gradient(excess)
    moved = fixed - safe_divide(change, jnp.where(steep, slope, 0.0))
    outward = fields(balls, start + moved[:, None] * toward).outward
    outward = jnp.where(met[:, None], outward, 0.0)
    normal = safe_divide(outward, _length(outward)[:, None])
    return SurfaceHit(jnp.where(found == jnp.inf, found, moved), normal)


class _State(NamedTuple):
    """Where the search has come to: [low, high] of the interval [begin, end]."""

    begin: Scalar
    end: Scalar
    low: Scalar
    high: Scalar
    root: Scalar
    steps: Int[Array, ""]


def _first_root(balls: Metaballs, start: Reals, toward: Reals, kept: int) -> Scalar:
    """Distance of one ray that crosses at most `kept` balls; NaN if the search gives up."""
    near, ends = _on_ray(balls, start, toward, kept)
    eps = float(jnp.finfo(ends.dtype).eps)
    level = balls.threshold - _SLACK * eps * (jnp.sum(near.densities) + balls.threshold)
    tolerance = _NARROW * eps
    noise = tolerance * (jnp.sum(near.densities) + balls.threshold)
    least = tolerance * jnp.min(balls.radii)

    def following(place: Scalar) -> Scalar:
        return jnp.min(jnp.where(ends > place, ends, jnp.inf))

    def above(at: _State) -> Points:
        middle = (at.begin + at.end) / 2
        return near.control_points(middle, at.low, at.high) - level

    first = jnp.min(ends)
    state = _State(first, following(first), first, following(first), first + jnp.inf, jnp.array(0))
    inside = above(state)[0] > 0

    def go_on(at: _State) -> Bool[Array, ""]:
        return jnp.isfinite(at.end) & jnp.isinf(at.root) & (at.steps < _STEPS * ends.size)

    def cut(at: _State) -> _State:
        points = above(at)
        # Rounding may have carried `low` over a root: then it has changed sides.
        crossed = (points[0] > 0) != inside
        meets, share, final = _hull_on_axis(points)
        width = at.high - at.low
        place = tolerance * at.high + least
        # Where a ray touches, all of a wider interval is level within rounding, on either side.
        narrow = (meets & (width <= place)) | (jnp.max(jnp.abs(points)) <= noise)
        root = jnp.where(crossed, at.low, jnp.where(narrow, (at.low + at.high) / 2, jnp.inf))
        low = at.low + jnp.maximum(share - 4 * eps, 0.0) * width
        to = at.low + jnp.minimum(final + 4 * eps, 1.0) * width
        to = jnp.where(to - low > _HARDLY * width, (low + to) / 2, to)
        # Not below rounding, or a root could be approached for ever.
        to = jnp.minimum(jnp.maximum(to, low + place / 2), at.high)
        # Without a root here: what is left of the interval, or the next one.
        leave = ~meets & (at.high >= at.end)
        begin = jnp.where(leave, at.end, at.begin)
        end = jnp.where(leave, following(at.end), at.end)
        low, high = jnp.where(meets, low, at.high), jnp.where(meets, to, end)
        return _State(begin, end, low, high, root, at.steps + 1)

    at = jax.lax.while_loop(go_on, cut, state)
    gave_up = jnp.isinf(at.root) & (at.steps >= _STEPS * ends.size)
    bad = gave_up | jnp.isnan(level + jnp.sum(start + toward) + jnp.sum(balls.radii))
    return jnp.where(bad, jnp.nan, at.root)


def _on_ray(
    balls: Metaballs, start: Reals, toward: Reals, kept: int
) -> tuple["_RayBalls", Float[Array, " end"]]:
    """The balls that a ray crosses, and where; infinite for places that are left over."""
    enter, leave = _chords(balls, start, toward)
    # Where the first, second, ... of them stands, by a product: sorting or cumsum take far longer.
    number = jnp.isfinite(enter).astype(enter.dtype) @ jnp.tri(balls.count, dtype=enter.dtype).T
    which = jnp.sum(number[None, :] <= jnp.arange(kept, dtype=enter.dtype)[:, None], axis=1)
    there = which < balls.count
    which = jnp.minimum(which, balls.count - 1)
    ends = jnp.concatenate([jnp.where(there, side[which], jnp.inf) for side in (enter, leave)])
    near = _RayBalls(
        jnp.where(there, balls.densities[which], 0.0),
        (start[None, :] - balls.centres[which]) / balls.radii[which][:, None],
        toward[None, :] / balls.radii[which][:, None],
    )
    return near, ends


class _RayBalls(NamedTuple):
    """The balls near a ray, which is at `offset + distance * step` from each in its radii."""

    densities: Float[Array, " kept"]
    offset: Float[Array, "kept 3"]
    step: Float[Array, "kept 3"]

    def control_points(self, middle: Scalar, low: Scalar, high: Scalar) -> Points:
        """Of the density between two distances, for the balls that hold a third one."""
        at, near, far = (self.offset + s * self.step for s in (middle, low, high))
        held = jnp.sum(at * at, axis=-1) < 1
        a = 1 - jnp.sum(near * near, axis=-1)
        b = 1 - jnp.sum(near * far, axis=-1)
        c = 1 - jnp.sum(far * far, axis=-1)
        return jnp.where(held, self.densities, 0.0) @ bernstein_density(a, b, c)


def bernstein_density(a: Reals, b: Reals, c: Reals) -> Float[Array, "*ball 7"]:
    """Control points of degree 6 of (5 v^2 + 4 v^3) / 9, from the three of the quadratic v."""
    aa, ab, ac, bb, bc, cc = a * a, a * b, a * c, b * b, b * c, c * c
    middle = (ac + 2 * bb) / 3
    square = (
        aa,
        (aa + 2 * ab) / 3,
        (aa + 8 * ab + 6 * middle) / 15,
        (ab + 3 * middle + bc) / 5,
        (cc + 8 * bc + 6 * middle) / 15,
        (cc + 2 * bc) / 3,
        cc,
    )
    cube = (
        aa * a,
        aa * b,
        (aa * c + 4 * a * bb) / 5,
        (3 * ac * b + 2 * bb * b) / 5,
        (a * cc + 4 * bb * c) / 5,
        b * cc,
        cc * c,
    )
    return (5 * jnp.stack(square, -1) + 4 * jnp.stack(cube, -1)) / 9


def _hull_on_axis(points: Points) -> tuple[Bool[Array, ""], Scalar, Scalar]:
    """Whether the hull of 7 evenly spaced points meets 0, and its first and last place in [0, 1].

    The hull's ends on the axis lie on lines between two points on either side of it.
    """
    one, other = points[_FIRST], points[_SECOND]
    apart = (one > 0) != (other > 0)
    share = one / jnp.where(apart, one - other, 1.0)
    first = jnp.asarray(_FIRST / 6, points.dtype)
    place = first + share * jnp.asarray((_SECOND - _FIRST) / 6, points.dtype)
    return (
        jnp.any(apart),
        jnp.min(jnp.where(apart, place, 1.0)),
        jnp.max(jnp.where(apart, place, 0.0)),
    )
