"""Layers a million times as dense as the air around them, against a stiff solver (Kvaerno5).

Optical depths to 1000 (slant 115,000). The tolerance is the promise of each rung of the ladder;
the solver's own is 1e-9, and its absolute one (1e-16) sets which radiances may be compared.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.stiff_path import ALTITUDE, DENSITY, RADIUS, solve

from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.haze import Haze
from atmofit.optics.medium import optical_properties
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.optics.profiles import Profile
from atmofit.sky.ladder import LADDER
from atmofit.sky.look import line_of_sight, single_scattering
from atmofit.sky.paths import FlatPaths, SphericalPaths
from atmofit.sky.planning import plan_sky

pytestmark = pytest.mark.reference
AZIMUTH = 0.5
# Optical depth, view and sun [degrees].
SUN = [
    (0.1, 0.0, 30.0),
    (0.1, 90.0, 90.0),
    (1.0, 60.0, 80.0),
    (1.0, 89.5, 60.0),
    (1.0, 90.0, 60.0),
    (10.0, 0.0, 80.0),
    (10.0, 60.0, 0.0),
    (10.0, 60.0, 80.0),
    (10.0, 85.0, 60.0),
    (10.0, 89.5, 60.0),
    (10.0, 90.0, 60.0),
]
GLOW = [
    (10.0, 89.5, 0.0),
    (30.0, 85.0, 0.0),
    (30.0, 90.0, 0.0),
    (1e3, 0.0, 0.0),
    (1e3, 60.0, 0.0),
    (1e3, 85.0, 0.0),
    (1e3, 89.5, 0.0),
    (1e3, 90.0, 0.0),
]
CASES = [(True, *case) for case in SUN] + [(False, *case) for case in GLOW]
RUNGS = (1e-2, 2e-3)
PLAN = plan_sky(Atmosphere(), orders=1)
GEOMETRIES = {"flat": FlatPaths(), "spherical": SphericalPaths(RADIUS)}


@functools.partial(jax.jit, static_argnames=("geometry", "count"))
def ours(optical_depth, view, sun, sunlit, geometry, count):
    """What `stiff_path.solve` finds, and its slope by optical depth."""
    paths = GEOMETRIES[geometry]

    def radiance(optical_depth):
        profile = Profile(ALTITUDE, DENSITY)
        cloud = Haze(optical_depth, 0.0, profile=profile, phase=HenyeyGreenstein(0.0))
        medium = optical_properties(Atmosphere(haze=cloud), jnp.array([550.0]))
        sight = line_of_sight(medium, paths, jnp.zeros(()), view, count, free_path=True)
        one_ring = jax.tree.map(lambda values: values[None], sight)
        azimuth = jnp.full((1, 1), AZIMUTH)
        once = single_scattering(medium, paths, one_ring, view[None], azimuth, sun, PLAN)
        once = once[0][0, 0, 0]
        z = sight.points.altitude
        reaching = jnp.exp(-(sight.columns @ medium.extinction)[:, 0])
        source = optical_depth * medium.profiles[0].density(z) * jnp.exp(-z / 1e3)
        glow = jnp.sum(reaching * sight.length * source)
        return jnp.where(sunlit, 4 * np.pi * once, glow)

    return jax.jvp(radiance, (optical_depth,), (jnp.ones(()),))


def _arguments(sunlit, optical_depth, view, sun):
    angles = (jnp.radians(angle) for angle in (view, sun))
    return jnp.asarray(optical_depth), *angles, jnp.asarray(sunlit)


def _exact(case, geometry, change=0.0):
    optical_depth, view, sun, sunlit = _arguments(*case)
    radiance, success, _ = solve(
        optical_depth * (1 + change), view, jnp.asarray(AZIMUTH), sun, sunlit, geometry != "flat"
    )
    assert success
    return float(radiance)


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_radiance_and_slope_are_those_of_the_stiff_solver(geometry):
    errors = {}
    for case in CASES:
        if geometry == "flat" and max(case[2:]) >= 90:
            continue  # a level ray has no end there
        exact = _exact(case, geometry)
        step = 1e-3
        slope = (_exact(case, geometry, step) - _exact(case, geometry, -step)) / (2 * step)
        for rtol in RUNGS:
            value, found = ours(*_arguments(*case), geometry, LADDER[rtol].view)
            errors[case, rtol, "value"] = abs(value - exact) / rtol / abs(exact)
            # Relative to the larger of value and slope by log optical depth, which may cross 0.
            size = max(abs(slope), abs(exact))
            errors[case, rtol, "slope"] = abs(found * case[1] - slope) / rtol / size
    bad = {key: float(error) for key, error in errors.items() if not error <= 1}
    assert not bad


@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_an_opaque_layer_lets_no_light_through(geometry):
    for view in (0.0, 60.0, 89.0):
        value, slope = ours(*_arguments(True, 1e3, view, 30.0), geometry, LADDER[1e-2].view)
        assert value == 0
        assert slope == 0


@jax.jit
def _overhead():
    cloud = Haze(1.0, 0.0, profile=Profile(ALTITUDE, DENSITY))
    medium = optical_properties(Atmosphere(haze=cloud), jnp.array([550.0]))
    return line_of_sight(
        medium, FlatPaths(), jnp.asarray(0.0), jnp.asarray(0.0), 32, free_path=True
    )


def test_kinks_are_edges_of_panels():
    sight = _overhead()
    z, length = sight.points.altitude, sight.length
    for low, high in itertools.pairwise(ALTITUDE):
        inside = (z > low) & (z < high)
        assert int(inside.sum()) >= 6
        np.testing.assert_allclose(length[inside].sum(), high - low, rtol=1e-9)
