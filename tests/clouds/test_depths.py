"""Optical depths by sweeping: exact where they should be, of second order elsewhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.clouds.depths import optical_depth_toward, sunlight_reaching
from atmofit.clouds.volume import voxel_cloud

LOW, HIGH = (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)
RANDOM = np.random.default_rng(0)
SLANTED = np.array([0.5, 0.3, -0.81]) / np.linalg.norm([0.5, 0.3, -0.81])


def smooth(x, y, z):
    """Extinction that fades out before the box does, with two continuous derivatives."""
    r2 = x**2 + 1.3 * y**2 + 0.8 * z**2 + 0.4 * x * y
    return np.clip(1 - r2 / 0.8, 0.0, None) ** 3 * (1 + 0.5 * np.sin(2 * x + z))


def centres(n):
    place = (np.arange(n) + 0.5) / n * 2 - 1
    return np.stack(np.meshgrid(place, place, place, indexing="ij"), -1)


def depth_by_walls(grid, place, direction):
    """From one voxel's centre in voxel units, by the crossings of all walls: exact."""
    walls = [
        (wall - place[a]) / direction[a]
        for a in range(3)
        if direction[a] != 0
        for wall in range(grid.shape[a] + 1)
    ]
    marks = np.sort([0.0, *(t for t in walls if t > 0)])
    middle = place + (marks[1:, None] + marks[:-1, None]) / 2 * direction
    inside = np.all((middle > 0) & (middle < grid.shape), axis=1)
    cell = np.floor(middle[inside]).astype(int)
    return np.sum(np.diff(marks)[inside] * grid[tuple(cell.T)])


@pytest.mark.parametrize(
    "direction",
    [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0), (0, -1, 1), (1, 1, 1), (-1, 1, -1)],
)
def test_axes_and_diagonals_are_exact(direction):
    grid = RANDOM.random((5, 6, 7))
    unit = np.array(direction) / np.linalg.norm(direction)
    cloud = voxel_cloud(grid, (0.0, 0.0, 0.0), (5.0, 6.0, 7.0))
    depth = np.asarray(optical_depth_toward(cloud, unit))
    for place in [(0, 0, 0), (4, 5, 6), (2, 3, 3), (1, 4, 6)]:
        exact = depth_by_walls(grid, np.array(place) + 0.5, unit)
        assert depth[place] == pytest.approx(exact, rel=1e-12)


def test_second_order_in_the_voxels():
    nodes, weights = np.polynomial.legendre.leggauss(200)
    ways, errors, counts = (nodes + 1) * 1.75, [], np.array([8, 16, 32])
    for n in counts:
        middle = centres(n)
        depth = optical_depth_toward(
            voxel_cloud(smooth(*np.moveaxis(middle, -1, 0)), LOW, HIGH), SLANTED
        )
        which = RANDOM.integers(0, n, (300, 3))
        place = middle[tuple(which.T)][:, None] + ways[None, :, None] * SLANTED
        exact = smooth(*np.moveaxis(place, -1, 0)) @ (weights * 1.75)
        errors.append(np.sqrt(np.mean((np.asarray(depth)[tuple(which.T)] - exact) ** 2)))
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.15)
    assert errors[-1] < 3e-3  # the whole depth is about 0.9


def test_other_shapes_of_voxels_and_directions_keep_the_same_depth():
    # A slab's depth is the way to its face, whatever the slant, far from the sides.
    cloud = voxel_cloud(np.ones((40, 40, 6)), (0.0, 0.0, 0.0), (80.0, 60.0, 6.0))
    direction = np.array([0.3, -0.2, 0.9]) / np.linalg.norm([0.3, -0.2, 0.9])
    depth = np.asarray(optical_depth_toward(cloud, direction))[20, 20]
    np.testing.assert_allclose(depth, (5.5 - np.arange(6)) / direction[2], rtol=1e-12)


def test_depths_are_differentiable():
    grid, turn = jnp.asarray(RANDOM.random((4, 3, 5))), jnp.asarray(RANDOM.random((4, 3, 5)))

    @jax.jit
    def total(step):
        direction = jnp.stack([jnp.sin(0.3 + step), 0 * step, jnp.cos(0.3 + step)])
        cloud = voxel_cloud(grid + step * turn, LOW, HIGH)
        return jnp.sum(optical_depth_toward(cloud, direction) ** 2)

    step = 1e-5
    difference = float(total(step) - total(-step)) / (2 * step)
    assert float(jax.grad(total)(0.0)) == pytest.approx(difference, rel=1e-7)


def test_paper_s_quotient_of_transmittances_fails_where_depths_do_not():
    # From a voxel to the one behind: difference of depths, quotient of transmittances (erratum 18).
    cloud = voxel_cloud(np.full((1, 1, 4), 1e3, np.float32), (0.0, 0.0, 0.0), (1.0, 1.0, 4.0))
    depth = np.asarray(optical_depth_toward(cloud, (0.0, 0.0, 1.0)))[0, 0]
    assert depth[0] - depth[1] == 1e3
    with np.errstate(invalid="ignore", divide="ignore"):
        assert np.isnan(np.exp(-depth)[0] / np.exp(-depth)[1])
    thin = np.exp(-depth / 1e4)
    assert thin[1] / thin[0] > 1 > thin[0] / thin[1]  # as printed, as corrected


def test_sunlight_is_the_mean_over_a_voxel():
    cloud = voxel_cloud(np.array([[[1.0, 2.0]]]), (0.0, 0.0, 0.0), (1.0, 1.0, 2.0))
    light = np.asarray(sunlight_reaching(cloud, (0.0, 0.0, 1.0)))[0, 0]
    upper = (1 - np.exp(-2)) / 2
    np.testing.assert_allclose(light, [np.exp(-2) * (1 - np.exp(-1)), upper], rtol=1e-12)


def test_refuses_what_is_no_direction():
    cloud = voxel_cloud(np.ones((1, 1, 1)), LOW, HIGH)
    with pytest.raises(ValueError, match="direction"):
        optical_depth_toward(cloud, (0.0, 0.0, 2.0))
    with pytest.raises(ValueError, match="3 components"):
        optical_depth_toward(cloud, (0.0, 1.0))
    traced = jax.jit(lambda d: optical_depth_toward(cloud, d))(jnp.asarray((0.0, 0.0, 2.0)))
    assert np.isnan(np.asarray(traced)).all()
