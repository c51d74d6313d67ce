"""Spherical skies against another quadrature and against a backward Monte Carlo."""

import numpy as np
import pytest
from reference.data import directions, groups, needs

import atmofit as af

SINGLE, MONTE_CARLO = "spherical_sky_radiance.csv", "spherical_monte_carlo.csv"
DAY = (60.0, 80.0, 88.0)
pytestmark = [pytest.mark.reference, pytest.mark.slow]


def _atmosphere(case):
    """Case names hold optical depths and albedo: d_molecules_haze or d_molecules_haze_Aalbedo.

    Under haze there is always a ground, be it black: such cases share their compiled programs.
    """
    parts = case.split("_")
    molecules, haze = af.Molecules(float(parts[1]), 8.8e3), float(parts[2])
    if haze == 0:
        return af.Atmosphere(molecules)
    albedo = float(parts[3][1:]) if len(parts) > 3 else 0.0
    hazy = af.Haze(haze, 0.0, 1.2e3, 1.0, af.HenyeyGreenstein(0.76))
    return af.Atmosphere(molecules, hazy, ground=af.Ground(albedo))


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


@pytest.fixture(scope="module")
def orders_apart():
    """Four orders of each case and sun by day; the first order is exact, see above."""
    found = {}
    for key, columns in groups(MONTE_CARLO).items():
        if key[1] in DAY and key[0] in ("d_0.1_0.1", "d_0.1_0.1_A0.3"):
            found[key] = columns
    skies = {}
    for case in sorted({key[0] for key in found}):
        air = _atmosphere(case)
        plan = af.plan_sky(
            air, solar_zenith_angle=np.radians(DAY), orders=4, rtol=5e-4, by_order=True
        )
        field = af.solve_sky(air, [550.0], plan=plan)
        for key, columns in found.items():
            if key[0] == case:
                sky = field.radiance_by_order(np.radians(key[1]), directions(columns), 1.0)
                skies[key] = (np.asarray(sky)[:, :, 0], columns)
    return skies


@needs(MONTE_CARLO)
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_each_order_by_day(orders_apart, order):
    for key, (values, columns) in orders_apart.items():
        reference, noise = columns[f"order{order}"], columns[f"order{order}_stderr"]
        excess = np.abs(values[order - 1] - reference) / (3 * noise + 5e-3 * reference)
        assert excess.max() < 1, key


@needs(MONTE_CARLO)
def test_all_orders_to_civil_twilight():
    skies = _simulate(MONTE_CARLO, (*DAY, 92.0, 96.0), "all", 2e-3)
    assert len(skies) == 20
    for key, (value, columns) in skies.items():
        reference = columns["total"]
        room = 5e-3 if key[1] <= 88 else 3.5e-2
        excess = np.abs(value - reference) / (3 * columns["total_stderr"] + room * reference)
        assert excess.max() < 1, key
