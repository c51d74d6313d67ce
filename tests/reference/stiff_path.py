"""Light along a path through layers, as a stiff differential equation. Shares no code with atmofit.

dL/ds = -k(s) L + j(s) from the top of the air to the observer, with the geometry, the density and
the sun's column worked out anew.
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

RADIUS = 6371e3
# A cloud between 1000 and 1501 m whose density is a million times that of the air around it.
ALTITUDE = np.array([0.0, 1000.0, 1001.0, 1500.0, 1501.0, 3000.0])
DENSITY = np.array([1e-6, 1e-6, 1.0, 1.0, 1e-6, 1e-6])
_COLUMN = np.sum(np.diff(ALTITUDE) * (DENSITY[1:] + DENSITY[:-1]) / 2)
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def density(z):
    """Over the vertical column [1/m]."""
    return jnp.interp(z, ALTITUDE, DENSITY) / _COLUMN


def distances(z, cosine, spherical):
    """Along a rising ray from altitude z to each kink above it [m]; 0 to those below."""
    rise = jnp.maximum(ALTITUDE - z, 0.0)
    if not spherical:
        return rise / cosine
    r = RADIUS + z
    square = rise * (2 * r + rise)
    return square / (r * cosine + jnp.sqrt((r * cosine) ** 2 + square))


def altitude(s, cosine, start, spherical):
    """At a distance along a ray that begins at altitude `start` [m]."""
    if not spherical:
        return start + s * cosine
    r, change = RADIUS + start, s * (2 * (RADIUS + start) * cosine + s)
    return start + change / (r + jnp.sqrt(r**2 + change))


def column_to_space(z, cosine, spherical):
    """Share of the vertical column along a rising ray, by Gauss quadrature between the kinks."""
    ends = distances(z, cosine, spherical)
    width = jnp.diff(ends)[:, None]
    s = ends[:-1, None] + width * (_NODES[None, :] + 1) / 2
    return jnp.sum(density(altitude(s, cosine, z, spherical)) * width * _WEIGHTS[None, :] / 2)


def solve(optical_depth, view, azimuth, sun, sunlit, spherical):
    """Radiance at the observer by Kvaerno's fifth-order method, whether it succeeded, statistics.

    Newton's method finds the stages: the solver's own, which keeps an old Jacobian, gets stuck
    in the thin air.

    Args:
        optical_depth: Vertical.
        view, azimuth, sun: [rad].
        sunlit: True: light scattered once, isotropic and conservative, times 4 pi over the
            irradiance. False: a source function exp(-z / 1 km), so that an opaque layer is seen
            from below.
        spherical: Static.
    """
    kinks = distances(0.0, jnp.cos(view), spherical)
    length = kinks[-1]

    def slope(s, radiance, args):
        left = length - s  # still to go to the observer
        z = altitude(left, jnp.cos(view), 0.0, spherical)
        turn = 0.0
        if spherical:
            turn = jnp.arctan2(left * jnp.sin(view), RADIUS + left * jnp.cos(view))
        up = jnp.cos(sun) * jnp.cos(turn) + jnp.sin(sun) * jnp.cos(azimuth) * jnp.sin(turn)
        dimming = jnp.exp(-optical_depth * column_to_space(z, up, spherical))
        source = jnp.where(sunlit, dimming, jnp.exp(-z / 1e3))
        return optical_depth * density(z) * (source - radiance)

    control = diffrax.PIDController(rtol=1e-9, atol=1e-16, dtmax=length / 20)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(slope),
        diffrax.Kvaerno5(root_finder=optx.Newton(rtol=1e-9, atol=1e-16)),
        0.0,
        length,
        1e-6 * length,
        jnp.zeros(()),
        stepsize_controller=diffrax.ClipStepSizeController(
            control, jump_ts=(length - kinks)[1:-1][::-1]
        ),
        max_steps=20_000,
        saveat=diffrax.SaveAt(t1=True),
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys[0], solution.result == diffrax.RESULTS.successful, solution.stats


solve = jax.jit(solve, static_argnames="spherical")
