"""Sky and ground in a cloud, by elements."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.clouds.pattern_light import cloud_phase
from atmofit.clouds.sky_light import refined_sky_light, sky_elements, sky_light, with_ground
from atmofit.clouds.volume import voxel_cloud

PHASE = cloud_phase(0.85)
VIEW = (0.6, 0.0, 0.8)
LOW, HIGH = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
DENSE = voxel_cloud(np.random.default_rng(1).random((3, 3, 3)) * 3, LOW, HIGH)


@pytest.mark.parametrize("mesh", [1, 2, 3, 8])
def test_elements_fill_the_sphere(mesh):
    directions, angles = sky_elements(mesh)
    assert len(directions) == 6 * mesh**2
    assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-13)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-14)
    # Symmetric: what is odd vanishes, and z^2 tends to a third.
    np.testing.assert_allclose(angles @ directions, 0.0, atol=1e-13)
    assert angles @ directions[:, 2] ** 2 == pytest.approx(4 * np.pi / 3, rel=1e-13)


@pytest.mark.parametrize("mesh", [1, 2, 3])
def test_even_sky_in_an_empty_cloud(mesh):
    empty = voxel_cloud(np.zeros((2, 2, 2)), LOW, HIGH)
    sky = jnp.full((6 * mesh**2, 2), 3.0)
    light = sky_light(empty, sky, phase=PHASE, view_direction=VIEW, single_scattering_albedo=0.9)
    # The phase function's shares add to 1.
    np.testing.assert_allclose(light, np.full((2, 2, 2, 2), 2.7), rtol=1e-12)


def test_one_element_counts_by_its_phase_and_its_own_depth():
    grid = np.array([[[1.0, 2.0]]])
    cloud = voxel_cloud(grid, LOW, (1.0, 1.0, 2.0))
    up = jnp.zeros(6).at[5].set(1.0)  # from +z
    light = np.asarray(sky_light(cloud, up, phase=PHASE, view_direction=(0.0, 0.0, 1.0)))[0, 0]
    transmittance = np.array([np.exp(-2) * (1 - np.exp(-1)), (1 - np.exp(-2)) / 2])
    # The phase function over the upper face of a cube, scattered back: by another quadrature.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    x, y = np.meshgrid(nodes, nodes)
    solid = np.outer(weights, weights) * (1 + x**2 + y**2) ** -1.5
    angle = np.pi - np.arctan(np.sqrt(x**2 + y**2))
    face = np.sum(solid * np.asarray(PHASE(jnp.asarray(angle))))
    np.testing.assert_allclose(light, face * transmittance, rtol=2e-3)  # 48 x 48 parts


def test_ground():
    sky = jnp.where(jnp.asarray(sky_elements(4)[0])[:, 2] > 0, 2.0, 99.0)
    kwargs = {"sun_direction": (0.0, 0.6, 0.8), "sun_irradiance": 5.0}
    black, grey, white = (with_ground(sky, albedo, **kwargs) for albedo in (0.0, 0.5, 1.0))
    down = np.asarray(sky_elements(4)[0])[:, 2] < 0
    assert np.all(np.asarray(black)[down] == 0)
    np.testing.assert_allclose(np.asarray(white)[~down], 2.0, rtol=1e-14)
    np.testing.assert_allclose(np.asarray(white)[down], (2 * np.pi + 4) / np.pi, rtol=1e-12)
    np.testing.assert_allclose(grey, (np.asarray(black) + np.asarray(white)) / 2, rtol=1e-12)
    # A face cut by the horizon has half of each.
    coarse = np.asarray(with_ground(jnp.full(6, 2.0), 0.5))
    np.testing.assert_allclose(coarse, [1.5, 1.5, 1.5, 1.5, 1.0, 2.0], rtol=1e-12)


def test_refinement_converges():
    def sky(directions):
        return jnp.exp(3 * directions[:, 2]) + jnp.exp(4 * directions[:, 0])

    rough, fine = (
        refined_sky_light(DENSE, sky, phase=PHASE, view_direction=VIEW, rtol=rtol)
        for rtol in (0.1, 0.03)
    )
    assert rough.elements < fine.elements
    assert rough.change <= 0.1
    largest = float(jnp.max(fine.source_function))
    error = float(jnp.max(jnp.abs(rough.source_function - fine.source_function)))
    # What is left after a step is of the order of its change, for the error falls as 1 / mesh^2.
    assert error < 0.2 * largest
    assert fine.change <= 0.03


def test_slopes_by_the_extinction():
    sky = jnp.linspace(1.0, 2.0, 24)

    def total(scale):
        cloud = voxel_cloud(DENSE.extinction_coefficient * scale, LOW, HIGH)
        return jnp.sum(sky_light(cloud, sky, phase=PHASE, view_direction=VIEW))

    step = 1e-5
    slope = jax.grad(total)(1.0)
    difference = float(total(1 + step) - total(1 - step)) / (2 * step)
    assert float(slope) == pytest.approx(difference, rel=1e-6)


def test_refuses_a_wrong_number_of_elements():
    with pytest.raises(ValueError, match="6 mesh"):
        sky_light(DENSE, jnp.ones(7), phase=PHASE, view_direction=VIEW)
    with pytest.raises(ValueError, match="mesh"):
        sky_elements(0)
