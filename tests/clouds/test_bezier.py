"""Bezier clipping against polynomial roots, interval by interval, in NumPy."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import polynomial, polyutils
from scipy.interpolate import BPoly

from atmofit.clouds.bezier import bernstein_density, surface_hit
from atmofit.clouds.metaballs import metaballs

THRESHOLD, COUNT = 0.3, 24
RANDOM = np.random.default_rng(5)
CENTRES, RADII = RANDOM.uniform(-1, 1, (COUNT, 3)), RANDOM.uniform(0.2, 0.7, COUNT)
DENSITIES = np.concatenate([RANDOM.uniform(0.2, 1.0, COUNT - 2), [0.0, 1e-12]])
BALLS = metaballs(CENTRES, RADII, DENSITIES, THRESHOLD)


def random_rays(random, count):
    """From outside and, one in ten, from within; unit directions."""
    start = random.normal(size=(count, 3))
    start *= 4 / np.linalg.norm(start, axis=1)[:, None]
    start[::10] = random.uniform(-1, 1, (len(start[::10]), 3))
    toward = random.uniform(-1.3, 1.3, (count, 3)) - start
    return start, toward / np.linalg.norm(toward, axis=1)[:, None]


def pieces(start, toward):
    """Intervals between a ray's events, and the density's polynomial about each one's middle."""
    offset = start - CENTRES
    middle = -offset @ toward
    half2 = RADII**2 - np.sum((offset + middle[:, None] * toward) ** 2, axis=1)
    half = np.sqrt(np.maximum(half2, 0))
    met = (half2 > 0) & (middle + half > 0)
    ends = np.unique(np.maximum(np.concatenate([(middle - half)[met], (middle + half)[met]]), 0))
    for low, high in itertools.pairwise(ends):
        s = (low + high) / 2
        total = np.zeros(7)
        for k in np.flatnonzero(met & (np.abs(s - middle) < half)):
            v = (
                np.array([half2[k] - (s - middle[k]) ** 2, -2 * (s - middle[k]), -1])
                / RADII[k] ** 2
            )
            v2 = polynomial.polymul(v, v)
            total += DENSITIES[k] / 9 * (np.pad(5 * v2, (0, 2)) + 4 * polynomial.polymul(v2, v))
        yield low, high, total


def first_root(start, toward):
    """By the eigenvalues of a companion matrix; and the largest density on the ray."""
    largest, place, found = 0.0, np.nan, np.inf
    for low, high, poly in pieces(start, toward):
        middle, half = (low + high) / 2, (high - low) / 2
        tops = polynomial.polyroots(polyutils.trimcoef(polynomial.polyder(poly)))
        tops = np.clip(np.concatenate([tops.real, [-half, half]]), -half, half)
        values = polynomial.polyval(tops, poly)
        if values.max() > largest:
            largest, place = values.max(), middle + tops[values.argmax()]
        if np.isfinite(found) or not values.min() <= THRESHOLD <= values.max():
            continue
        # Between neighbouring extremes there is one root: halve, as it is exact to rounding.
        tops = np.unique(tops)
        over = polynomial.polyval(tops, poly) > THRESHOLD
        for a, b, one, other in zip(tops[:-1], tops[1:], over[:-1], over[1:], strict=True):
            if one != other:
                for _ in range(60):
                    c = (a + b) / 2
                    a, b = (c, b) if (polynomial.polyval(c, poly) > THRESHOLD) == one else (a, c)
                found = middle + a
                break
    return found, largest, place


def both_ways(count):
    start, toward = random_rays(np.random.default_rng(8), count)
    hit = surface_hit(BALLS, start, toward)
    plain = np.array([first_root(*ray) for ray in zip(start, toward, strict=True)])
    return start, toward, hit, plain


@pytest.fixture(scope="module")
def hits():
    return both_ways(2_000)


def assert_same_roots(hits):
    _, _, hit, (found, largest, _) = *hits[:3], hits[3].T
    # Within 1e-12 of touching, rounding decides.
    clear = np.abs(largest / THRESHOLD - 1) > 1e-12
    assert clear.sum() > 0.999 * clear.size
    np.testing.assert_array_equal(np.isfinite(hit.distance)[clear], np.isfinite(found)[clear])
    np.testing.assert_allclose(hit.distance[clear], found[clear], rtol=0, atol=1e-6)


def test_first_root_equals_brute_force(hits):
    assert_same_roots(hits)


@pytest.mark.slow
def test_first_root_equals_brute_force_for_ten_thousand_rays():
    assert_same_roots(both_ways(10_000))


def test_normal_is_outward_and_of_length_1(hits):
    start, toward, hit, _ = hits
    met = np.isfinite(hit.distance)
    np.testing.assert_allclose(np.linalg.norm(hit.normal, axis=1), met, atol=1e-14)
    place = start[met] + np.asarray(hit.distance)[met, None] * toward[met]
    step = 1e-5 * np.asarray(hit.normal)[met]
    assert np.all(BALLS.density(place + step) < BALLS.density(place - step))


@pytest.mark.parametrize("over", [-1e-7, 0.0, 1e-7])
def test_touching_rays(hits, over):
    """Densities are scaled so that each ray's largest one is the threshold, or nearly."""
    start, toward, _, (_, largest, place) = *hits[:3], hits[3].T
    some = np.flatnonzero(largest > 0.05)[1:1500:15]

    def one(scale, a, b):
        balls = metaballs(CENTRES, RADII, scale * jnp.asarray(DENSITIES), THRESHOLD)
        return surface_hit(balls, a, b).distance

    scale = THRESHOLD * (1 + over) / largest[some]
    found = np.asarray(jax.jit(jax.vmap(one))(scale, start[some], toward[some]))
    if over < 0:
        assert np.all(np.isinf(found))
    else:
        assert np.all(np.isfinite(found))
    if over == 0:
        # Rounding of the level, some 1e-15, is squared in the place.
        np.testing.assert_allclose(found, place[some], rtol=0, atol=1e-6)


def test_rays_that_touch_one_ball():
    """Past a lone ball at its surface's radius: closed form."""
    v = 0.6
    ball = metaballs(np.zeros((1, 3)), [2.0], [1.0], (5 * v**2 + 4 * v**3) / 9)
    radius = 2.0 * np.sqrt(1 - v)
    aside = radius * (1 + np.array([-1e-3, -1e-9, 0.0, 1e-9, 1e-3]))
    start = np.stack([np.full(5, -7.0), aside, np.zeros(5)], -1)
    found = surface_hit(ball, start, [1.0, 0.0, 0.0]).distance
    exact = 7 - np.sqrt(np.maximum(radius**2 - aside**2, 0))
    np.testing.assert_allclose(found[:3], exact[:3], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(np.isinf(found[3:]), True)


def test_control_points_of_a_chord():
    """The whole chord of a ball of the paper's form: v = 4 b t (1 - t), a number b."""
    b = 0.7
    points = np.asarray(bernstein_density(jnp.zeros(()), jnp.asarray(2 * b), jnp.zeros(())))
    d2, d3 = 16 / 27 * b**2, 8 / 9 * b**2 + 64 / 45 * b**3
    np.testing.assert_allclose(points, [0, 0, d2, d3, d2, 0, 0], atol=1e-15)


def test_control_points_of_any_quadratic():
    a, b, c = 0.3, -0.8, 1.7
    points = np.asarray(bernstein_density(*(jnp.asarray(x) for x in (a, b, c))))
    t = np.linspace(0, 1, 11)
    v = a * (1 - t) ** 2 + 2 * b * t * (1 - t) + c * t**2
    exact = (5 * v**2 + 4 * v**3) / 9
    np.testing.assert_allclose(BPoly(points[:, None], [0, 1])(t), exact, atol=1e-14)


def test_slopes_of_the_distance(hits):
    start, toward, hit, _ = hits
    k = int(np.flatnonzero(np.isfinite(hit.distance))[3])

    def distance(radii, origin):
        return surface_hit(
            metaballs(CENTRES, radii, DENSITIES, THRESHOLD), origin, toward[k]
        ).distance

    slopes = jax.grad(distance, (0, 1))(jnp.asarray(RADII), jnp.asarray(start[k]))
    step = 1e-5
    for which, point in enumerate((RADII, start[k])):
        for axis in range(3):
            ends = []
            for sign in (1, -1):
                both = [RADII.copy(), start[k].copy()]
                both[which] = point.copy()
                both[which][axis] += sign * step
                ends.append(float(distance(*both)))
            # The step squared times a third derivative, some 1e2 of them.
            expected = (ends[0] - ends[1]) / (2 * step)
            assert slopes[which][axis] == pytest.approx(expected, abs=1e-6, rel=1e-6)


def test_nothing_to_hit():
    hit = surface_hit(metaballs([], [], []), np.zeros((4, 3)), [0.0, 0.0, 1.0])
    assert np.all(np.isinf(hit.distance))
    assert not np.any(hit.normal)


def test_rays_are_checked():
    with pytest.raises(ValueError, match="length of direction"):
        surface_hit(BALLS, np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="3 coordinates"):
        surface_hit(BALLS, np.zeros(2), np.zeros(3))
