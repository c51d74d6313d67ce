"""Slabs against photons: our random walk, and another code's radiances."""

import math

import jax
import numpy as np
import pytest
from measured_data import data_folder
from oracles.slab_random_walk import walk_slab
from reference.data import needs

import atmofit as af

# Both sides, toward the sun and away, steep and slanting; none looks into the peak.
VIEWS = [(0.3, 1.0), (1.3, 3.0), (2.5, 2.0), (math.pi - 1.3, 0.2)]
CASES = [(1.0, 0.0, 0.6, (0.3, 1.0)), (2.0, -0.4, 1.2, (0.9,)), (10.0, 0.85, 1.0, (0.9, 0.99, 1.0))]


@jax.jit
def solved(depth, albedo, asymmetry, sun, views):
    found = af.solve_slab(
        optical_depth=depth, single_scattering_albedo=albedo, phase=af.HenyeyGreenstein(asymmetry),
        solar_zenith_angle=sun, plan=af.SlabPlan(32, 32, 14),
    )  # fmt: skip
    return found, found.radiance(views)


@pytest.mark.parametrize(("depth", "asymmetry", "sun", "albedos"), CASES)
def test_solve_slab_agrees_with_a_random_walk(depth, asymmetry, sun, albedos):
    """Shares and radiances within 3 standard errors of 1e5 photons: .2 to .5 % and .2 to 2.5 %."""
    walk = walk_slab(depth, asymmetry, sun, views=VIEWS)
    assert walk.left < 1e-5
    views = af.Directions(*np.transpose(VIEWS))
    for albedo in albedos:
        found, radiance = solved(depth, albedo, asymmetry, sun, views)
        pairs = [
            (walk.reflectance(albedo), found.reflectance, 0.01),
            (walk.diffuse_transmittance(albedo), found.diffuse_transmittance, 0.02),
            (walk.radiance(albedo), radiance, 0.05),
        ]
        for (mean, error), exact, tight in pairs:
            assert np.all(error < tight * mean)  # else agreement would tell nothing
            assert np.all(np.abs(mean - np.asarray(exact)) < 3 * error)


def test_photons_that_meet_nothing_follow_beer():
    mean, error = walk_slab(2.0, 0.5, 1.2).direct_transmittance()
    assert abs(mean[0] - math.exp(-2 / math.cos(1.2))) < 3 * error[0]


def test_thin_slab_scatters_once():
    """By the closed form of one order: what a slab of depth 1e-3 sends is off by its depth."""
    walk = walk_slab(1e-3, 0.5, 0.6, views=VIEWS, photons=400_000)
    zenith, azimuth = np.transpose(VIEWS)
    cosine = np.cos(zenith) * np.cos(0.6) + np.sin(zenith) * np.sin(0.6) * np.cos(azimuth)
    phase = 0.75 / (4 * np.pi * (1.25 - cosine) ** 1.5)
    mean, error = walk.radiance(1.0)
    np.testing.assert_array_less(
        np.abs(mean - phase * 1e-3 / np.abs(np.cos(zenith))), 3 * error + 5e-3 * mean
    )


@pytest.mark.reference
@needs("slab_radiance_pathtraced.csv")
def test_path_traced_radiances():
    """Mitsuba's radiances, depth 1 and HG .85, two albedos, two suns.

    The table's azimuth for light that comes back (R) is that of the opposite of the way one looks,
    as its other column, of discrete ordinates, tells.
    """
    path = data_folder() / "reference" / "slab_radiance_pathtraced.csv"
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    zenith, azimuth = np.radians(table["view_zenith"]), np.radians(table["rel_azimuth"])
    back = table["kind"] == "R"
    views = np.where(back, np.pi - zenith, zenith), np.where(back, np.pi - azimuth, azimuth)
    solve_64 = jax.jit(
        lambda depth, albedo, sun, views: af.solve_slab(
            optical_depth=depth, single_scattering_albedo=albedo, phase=af.HenyeyGreenstein(0.85),
            solar_zenith_angle=sun, plan=af.SlabPlan(64, 64, 12),
        ).radiance(views)
    )  # fmt: skip
    found = np.empty(table.size)
    for six in np.split(np.arange(table.size), 4):  # one slab and sun each
        depth, albedo, sun = (float(table[name][six[0]]) for name in ("tau", "ssa", "sun_zenith"))
        seen = af.Directions(views[0][six], views[1][six])
        found[six] = solve_64(depth, albedo, math.radians(sun), seen)
    np.testing.assert_allclose(found, table["nanodisort_I_over_F0"], rtol=1e-6)  # 2.1e-7 seen
    apart = (found - table["mitsuba_I_over_F0"]) / table["mitsuba_stderr"]
    # 24 values: the largest is 2.76; their squares' sum 30.8 is exceeded once in six times.
    assert np.abs(apart).max() < 3
    assert np.sum(apart**2) < 43  # once in a hundred
