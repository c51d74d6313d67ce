"""Reflection and transmission of a homogeneous layer, by doubling in terms of admittances.

Light that goes up and down through a layer is split into sum s and difference f of the two, scaled
by the root of the quadrature's weights times their cosines. They obey s' = A f, f' = B s with A and
B symmetric and positive: a network of resistors. Of a layer with equal light from both sides only
the half matters, with its middle open or shorted; the two admittances of a half of depth h are

    beta = tanh(h sqrt(B A)) sqrt(B A) A^-1,    alpha = coth(h sqrt(B A)) sqrt(B A) A^-1,

and a layer of twice the depth has their arithmetic and their harmonic mean. With h divided out,
alpha = P / h and beta = h Q, nothing is singular however thin the layer is:

    P' = P + h^2 Q,    Q' = Q - h^2 Q (P + h^2 Q)^-1 Q.

One symmetric matrix is inverted for each doubling, where the usual form (Hansen and Travis 1974)
needs a general inverse and two products more. Reflection and transmission follow at the end.
Directions without weight and suns stand in the border, so that nothing is singular where the sun
stands in a node or opposite a view.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.media.bordered import Bordered
from atmofit.numerics import gauss_nodes, harmonics, safe_sqrt
from atmofit.typing import Reals, Scalar

SMALLEST_COSINE = 1e-4  # of a sun or a view
_FADING = 6  # last doublings, in which what passes is followed apart: by then it may be tiny


class Fan(NamedTuple):
    """Cosines of the directions that a layer is solved for, and the functions of their angle.

    Attributes:
        cosine: Of nodes, views and suns [-].
        weight: 2 pi times the nodes' weights [sr].
        even: Normalised Legendre functions Y_lm of nodes and views, and of the suns, l + m even.
        odd: The same, l + m odd.
    """

    cosine: tuple[Reals, Reals, Reals]
    weight: Reals
    even: tuple[Float[Array, "mode row l"], Float[Array, "mode sun l"]]
    odd: tuple[Float[Array, "mode row l"], Float[Array, "mode sun l"]]


class Layer(NamedTuple):
    """What comes back from a layer, and what goes through it, from above and from below.

    Attributes:
        reflection: Of light from above.
        transmission: Likewise.
        reflection_below: Of light from below.
        transmission_below: Likewise.
    """

    reflection: Bordered
    transmission: Bordered
    reflection_below: Bordered
    transmission_below: Bordered


def fan(streams: int, modes: int, view_cosine: Reals, solar_cosine: Reals) -> Fan:
    """Directions: half the streams in each hemisphere, at double Gauss nodes.

    Args:
        streams: Even. Static.
        modes: Azimuthal ones, at most `streams`. Static.
        view_cosine: [view].
        solar_cosine: [sun].
    """
    dtype = jnp.result_type(view_cosine, solar_cosine)
    nodes, weights = (jnp.asarray(x, dtype) for x in gauss_nodes(streams // 2))
    views, suns = (
        jnp.maximum(x.astype(dtype), SMALLEST_COSINE) for x in (view_cosine, solar_cosine)
    )
    rows = jnp.concatenate([nodes, views])
    degree, mode = np.arange(streams)[None, :], np.arange(modes)[:, None]
    parity = (degree + mode) % 2

    def functions(cosine: Reals, wanted: int) -> Reals:
        values = harmonics(cosine, safe_sqrt(1 - cosine**2), streams, modes)
        chosen = jnp.asarray(parity == wanted, dtype)
        return jnp.moveaxis(values, -1, 0) * chosen[:, None, :]

    return Fan(
        (nodes, views, suns),
        2 * math.pi * weights,
        (functions(rows, 0), functions(suns, 0)),
        (functions(rows, 1), functions(suns, 1)),
    )


def double(
    directions: Fan,
    optical_depth: Scalar,
    single_scattering_albedo: Scalar,
    moments: Float[Array, " l"],
    doublings: int,
) -> Layer:
    """A homogeneous layer.

    Args:
        directions: Those it is solved for.
        optical_depth: Vertical [-].
        single_scattering_albedo: [-].
        moments: Legendre moments of the phase function, the 0th is 1 [-].
        doublings: So many that the first layer's depth over the smallest node is about 1. Static.
    """
    depths = optical_depth * jnp.asarray(0.5 ** np.arange(doublings + 1, -1, -1), moments.dtype)
    scattering = single_scattering_albedo * moments
    a, b = (
        _generator(directions, functions, scattering)
        for functions in (directions.odd, directions.even)
    )
    # tanh(x) = x / (1 + x^2 / 3), coth(x) = 1 / x + x / 3: off by x^4 / 45, in layers so thin that
    # this is nothing for light that gets far; of the rest doubling forgets it.
    once = a.inverse()
    p, q, _, power = _doubled(once, b, depths[0] ** 2 / 3, _power(directions, scattering[0]))

    def step(three: tuple[Bordered, Bordered, _Power], h: Scalar) -> tuple[Any, None]:
        p, q, power = three
        p, q, _, power = _doubled(p, q, h**2, power)
        return (p, q, power), None

    def last_step(four: tuple[Bordered, Bordered, _Power, Bordered], h: Scalar) -> tuple[Any, None]:
        p, q, power, apart = four
        p, q, between, power = _doubled(p, q, h**2, power)
        return (p, q, power, apart @ between @ apart), None

    fading = min(_FADING, doublings)
    (p, q, power), _ = jax.lax.scan(step, (p, q, power), depths[: doublings - fading])
    h = depths[doublings - fading]
    four = (p, q, power, p - q * h**2)
    (p, q, _, apart), _ = jax.lax.scan(last_step, four, depths[doublings - fading : doublings])
    h = depths[doublings]
    # 1 / (1 + beta), and 1 / (1 + alpha) over h.
    opened, shorted = (q * h).plus(1.0).inverse(), p.plus(h).inverse()
    reflection = (shorted - q @ opened) * h
    # In a thin layer the second loses what is scattered beside what passes, in a thick one the
    # first loses all that passes.
    thin = optical_depth < 1
    transmission = jax.tree.map(
        lambda first, second: jnp.where(thin, first, second),
        opened - shorted * h,
        opened @ apart @ shorted,
    )
    return Layer(reflection, transmission, reflection, transmission)


class _Power(NamedTuple):
    """What a matrix makes of light that is alike in all directions, and of its power.

    The least of what Q does, where little is absorbed, and so the first to drown in rounding.

    Attributes:
        even: Light alike in all directions, [node].
        lost: What Q makes of it, [node], and [view].
        seen: Likewise.
        from_suns: Power that Q takes from each sun's light.
        suns: Cosine of each.
    """

    even: Float[Array, " node"]
    lost: Float[Array, " node"]
    seen: Float[Array, " view"]
    from_suns: Float[Array, " sun"]
    suns: Float[Array, " sun"]


def _power(directions: Fan, albedo: Scalar) -> _Power:
    """Of the generator: all that is lost is absorbed."""
    nodes, views, suns = directions.cosine
    absorbed = 1 - albedo
    even = jnp.sqrt(directions.weight * nodes)
    return _Power(even, absorbed * even / nodes, absorbed / views, absorbed + 0 * suns, suns)


@jax.custom_jvp
def _doubled(
    p: Bordered, q: Bordered, square: Scalar, power: _Power
) -> tuple[Bordered, Bordered, Bordered, _Power]:
    """P' and Q' of the module, and the inverse of P'; rounding takes no power from Q'."""
    both = p + q * square
    between = both.inverse()
    left, right = (q @ between) * square, (between @ q) * square
    even, lost, seen, from_suns, suns = power
    seen = seen - (left.below[0] @ lost + left.views * seen)
    from_suns = from_suns - (lost @ right.beside[0] + right.suns * from_suns)
    lost = lost - left.nodes[0] @ lost
    found = q - left @ q
    unit = even / jnp.sum(even**2)
    nodes = lost - found.nodes[0] @ even
    nodes = jnp.outer(nodes - unit * (nodes @ even) / 2, unit)
    below = jnp.outer(seen - found.views - found.below[0] @ even, unit)
    beside = jnp.outer(unit, from_suns - suns * found.suns - even @ found.beside[0])
    found = Bordered(
        found.nodes.at[0].add(nodes + nodes.T),
        found.below.at[0].add(below),
        found.beside.at[0].add(beside),
        found.corner,
        found.views,
        found.suns,
    )
    return both, found, between, _Power(even, lost, seen, from_suns, suns)


@_doubled.defjvp
def _slope_of_doubled(values: tuple[Any, ...], slopes: tuple[Any, ...]) -> tuple[Any, Any]:
    """By half the products that slopes of each factor and of the inverse would take.

    The power only takes rounding away, and has no slope.
    """
    (_, q, square, _), (dp, dq, dsquare, _) = values, slopes
    both, found, between, power = _doubled(*values)
    left, right = q @ between, between @ q
    dboth = dp + dq * square + q * dsquare
    change = dq @ right + left @ (dq - dboth @ right)
    dfound = dq - (q @ right) * dsquare - change * square
    still = jax.tree.map(jnp.zeros_like, power)
    dbetween = (between @ dboth @ between) * -1.0
    return (both, found, between, power), (dboth, dfound, dbetween, still)


def _generator(directions: Fan, functions: tuple[Reals, Reals], scattering: Reals) -> Bordered:
    """A or B: how fast sum and difference change with optical depth, see the module."""
    nodes, views, suns = directions.cosine
    n = nodes.size
    rows, of_suns = functions
    to_nodes = jnp.sqrt(directions.weight / nodes)[None, :, None]
    of_nodes = rows[:, :n] * to_nodes
    # Twice, since what goes up and what goes down count alike in sums and in differences.
    weighted = -2 * scattering[None, None, :]
    to_views = rows[:, n:] / views[None, :, None] * weighted
    from_nodes, from_suns = (jnp.swapaxes(x, 1, 2) for x in (of_nodes, of_suns))
    return Bordered(
        jnp.diag(1 / nodes)[None] + (of_nodes * weighted) @ from_nodes,
        to_views @ from_nodes,
        (of_nodes * weighted) @ from_suns,
        to_views @ from_suns,
        1 / views,
        1 / suns,
    )


def add(above: Layer, below: Layer) -> Layer:
    """One layer upon another (Hansen and Travis 1974, section 3)."""
    down = echoes(above.reflection_below, below.reflection) @ above.transmission
    up = echoes(below.reflection, above.reflection_below) @ below.transmission_below
    return Layer(
        above.reflection + above.transmission_below @ below.reflection @ down,
        below.transmission @ down,
        below.reflection_below + below.transmission @ above.reflection_below @ up,
        above.transmission_below @ up,
    )


def echoes(first: Bordered, second: Bordered) -> Bordered:
    """All orders of light going to and fro."""
    return ((first @ second) * -1.0).plus(1.0).inverse(definite=False)


def lambert_ground(directions: Fan, albedo: Scalar) -> Layer:
    """A ground that reflects alike in all directions; nothing comes through it."""
    nodes, views, suns = directions.cosine
    modes = directions.even[0].shape[0]
    dtype = nodes.dtype
    first = (jnp.arange(modes) == 0).astype(dtype)[:, None, None] * albedo / math.pi
    of_nodes, one = jnp.sqrt(directions.weight * nodes), jnp.ones_like(views)

    def block(to: Reals, source: Reals) -> Float[Array, "mode row column"]:
        return first * (to[:, None] * source[None, :])[None]

    reflection = Bordered(
        block(of_nodes, of_nodes),
        block(one, of_nodes),
        block(of_nodes, suns),
        block(one, suns),
        jnp.zeros_like(views),
        jnp.zeros_like(suns),
    )
    nothing = reflection * jnp.zeros((), dtype)
    return Layer(reflection, nothing, nothing, nothing)


def doublings_for(optical_depth: float, streams: int) -> int:
    """How many make the first layer of a slab about as thick as its smallest node's cosine."""
    smallest = float(gauss_nodes(streams // 2)[0].min())
    wanted = math.log2(max(optical_depth, 1e-30) / (2 * smallest))
    # With fewer than 8 the series of the first layer is not good to 1e-7 for light that gets far.
    return max(8, math.ceil(wanted))
