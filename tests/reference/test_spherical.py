"""Spherical skies against another quadrature and against a backward Monte Carlo."""

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
    found = {}
    wanted = {key: value for key, value in groups(table).items() if key[1] in suns}
    for case in {key[0] for key in wanted}:
        field = af.solve_sky(_atmosphere(case), [550.0], orders, rtol)
        for key, columns in wanted.items():
            if key[0] == case:
                sky = field.radiance(np.radians(key[1]), directions(columns), 1.0)
                found[key] = (np.asarray(sky)[:, 0], columns)
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
