"""Spherical skies against another quadrature and against a backward Monte Carlo."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from reference.data import directions, groups, needs

import atmofit as af

SINGLE, MONTE_CARLO = "spherical_sky_radiance.csv", "spherical_monte_carlo.csv"
pytestmark = [pytest.mark.reference, pytest.mark.slow]


def _atmosphere(case):
    """Case names hold optical depths and albedo: d_molecules_haze or d_molecules_haze_Aalbedo."""
    parts = case.split("_")
    haze = float(parts[2])
    return af.Atmosphere(
        af.Molecules(float(parts[1]), 8.8e3),
        af.Haze(haze, 0.0, 1.2e3, 1.0, af.HenyeyGreenstein(0.76)) if haze > 0 else None,
        ground=af.Ground(float(parts[3][1:])) if len(parts) > 3 else None,
    )


def _simulate(table, suns, orders, rtol):
    """Radiance of a table's cases at some suns; one solution serves all suns of a case."""

    @eqx.filter_jit
    def solve(atmosphere, suns, dirs):
        field = af.solve_sky(atmosphere, [550.0], orders, rtol)
        return jnp.stack(
            [
                field.radiance(sun, d, solar_irradiance=1.0)[:, 0]
                for sun, d in zip(suns, dirs, strict=True)
            ]
        )

    found = {}
    wanted = {key: value for key, value in groups(table).items() if key[1] in suns}
    for case in {key[0] for key in wanted}:
        keys = [key for key in wanted if key[0] == case]
        angles = [jnp.asarray(np.radians(key[1])) for key in keys]
        dirs = [directions(wanted[key]) for key in keys]
        for key, value in zip(keys, solve(_atmosphere(case), angles, dirs), strict=True):
            found[key] = (np.asarray(value), wanted[key])
    assert found
    return found


@needs(SINGLE)
def test_single_scattering():
    for case, (value, columns) in _simulate(SINGLE, (80.0, 90.0), 1, 5e-4).items():
        error = np.abs(value / columns["own_spherical_SS"] - 1).max()
        assert error < 3e-4, case


@needs(MONTE_CARLO)
def test_second_order_alone():
    suns = (60.0, 80.0)
    one, both = (_simulate(MONTE_CARLO, suns, orders, 1e-3) for orders in (1, 2))
    for case, (value, columns) in both.items():
        reference = columns["order2"]
        room = 3 * columns["order2_stderr"] + 5e-3 * reference
        excess = np.abs(value - one[case][0] - reference) / room
        assert excess.max() < 1, case
