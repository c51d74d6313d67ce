"""Density, asymmetry and albedo of a cloud from pictures of it."""

import numpy as np
import pytest

import atmofit as af
from atmofit.clouds.converged import converged_light
from atmofit.fit.cloud import CloudFit, fit_cloud

COUNT, WIDTH, ANGLES, EXTENT = 8, 8, np.array([0.5, 2.4]), 2.6
DIRECTIONS = 14
TRUTH = {"density_scale": 1.25, "asymmetry": 0.75, "single_scattering_albedo": 0.96}
GRID = np.meshgrid(*[(np.arange(COUNT) + 0.5) / COUNT * 2 - 1] * 3, indexing="ij")
DENSITY = np.clip((1 - np.sqrt(sum(axis**2 for axis in GRID))) * COUNT / 2 + 0.5, 0.0, 1.0)


def cloud(extinction):
    return af.clouds.voxel_cloud(extinction * DENSITY, (-1.0,) * 3, (1.0,) * 3)


@pytest.fixture(scope="module")
def clean():
    light = converged_light(
        cloud(4.0 * TRUTH["density_scale"]),
        phase=af.HenyeyGreenstein(TRUTH["asymmetry"]),
        single_scattering_albedo=TRUTH["single_scattering_albedo"],
        directions=DIRECTIONS,
    )
    return np.stack(
        [
            np.asarray(light.view(sun_angle=angle, width=WIDTH, extent=EXTENT).radiance)
            for angle in ANGLES
        ]
    )


def fit(pictures, noise, **keywords):
    keywords = {"sun_angle": ANGLES, "extent": EXTENT, "directions": DIRECTIONS} | keywords
    return fit_cloud(cloud(4.0), pictures, noise, **keywords)


@pytest.mark.slow
def test_the_truth_is_found_within_its_errors(clean):
    noise = 0.02 * clean.mean()
    random = np.random.default_rng(5)
    off, chi_square = [], []
    for _ in range(8):
        found = fit(clean + noise * random.normal(size=clean.shape), noise)
        assert found.converged
        assert found.undetermined == ()
        chi_square.append(float(found.reduced_chi_square))
        assert "density_scale" in str(found)
        off.append((found.values - np.array([*TRUTH.values()])) / found.standard_error)
    # 24 deviations of a unit normal: chi-square within its 99.9 % interval, none beyond 4.
    off = np.array(off)
    assert 7.5 < (off**2).sum() < 53.0
    assert np.abs(off).max() < 4
    # 125 degrees of freedom each.
    assert all(0.6 < value < 1.5 for value in chi_square)


@pytest.mark.slow
def test_without_noise_the_truth_is_found_to_the_solvers_tolerance(clean):
    found = fit(clean, 1e-3 * clean.mean())
    for name in CloudFit.NAMES:
        assert float(found[name]) == pytest.approx(TRUTH[name], rel=5e-3)


def test_impossible_requests_are_refused(clean):
    with pytest.raises(ValueError, match="must be \\[picture, up, right\\], square"):
        fit(clean[:, 1:], 1.0)
    with pytest.raises(ValueError, match="must fit the pictures"):
        fit(clean, 1.0, sun_angle=np.zeros(3))
    with pytest.raises(ValueError, match="noise must be between"):
        fit(clean, 0.0)
    with pytest.raises(ValueError, match="known must leave a parameter"):
        fit(clean, 1.0, known=TRUTH)
    with pytest.raises(ValueError, match="a name in start must be one of"):
        fit(clean, 1.0, start={"thickness": 1.0})
