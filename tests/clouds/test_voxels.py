"""Metaballs on grids, and their files."""

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from atmofit.clouds.metaballs import metaballs
from atmofit.clouds.volume import voxel_cloud
from atmofit.clouds.voxels import occupied_blocks, read_voxels, voxelise, write_voxels

RANDOM = np.random.default_rng(2)
CENTRES, RADII = RANDOM.uniform(-1, 1, (9, 3)), RANDOM.uniform(0.2, 0.8, 9)
BALLS = metaballs(CENTRES, RADII, RANDOM.uniform(0.3, 1.0, 9), 0.3)
BOX: Any = {"low": (-1.0, -1.2, -0.9), "high": (1.1, 1.0, 1.3)}
COUNTS = (7, 5, 6)


def test_mean_of_densities_above_the_threshold():
    cloud = voxelise(BALLS, COUNTS, extinction_coefficient=4.0, samples=3, **BOX)
    axes = [
        a + (np.arange(3 * n) + 0.5) * (b - a) / (3 * n)
        for n, a, b in zip(COUNTS, *BOX.values(), strict=True)
    ]
    density = np.array(BALLS.density(np.stack(np.meshgrid(*axes, indexing="ij"), -1)))
    density[density < 0.3] = 0
    mean = density.reshape(7, 3, 5, 3, 6, 3).mean(axis=(1, 3, 5))
    np.testing.assert_allclose(cloud.extinction_coefficient, 4 * mean, rtol=0, atol=1e-13)


def test_traced_balls_give_the_same_and_slopes():
    def total(radii, extinction):
        balls = metaballs(CENTRES, radii, BALLS.densities, 0.3)
        cloud = voxelise(balls, COUNTS, extinction_coefficient=extinction, **BOX)
        return jnp.sum(cloud.extinction_coefficient)

    known = total(RADII, 2.0)
    value, slopes = jax.value_and_grad(total, (0, 1))(jnp.asarray(RADII), jnp.asarray(2.0))
    assert float(value) == pytest.approx(float(known), rel=1e-12)
    assert float(slopes[1]) == pytest.approx(float(known) / 2, rel=1e-12)
    assert np.all(slopes[0] > 0)


def test_many_layers_at_a_time_or_few(monkeypatch):
    whole = voxelise(BALLS, COUNTS, extinction_coefficient=1.0)
    monkeypatch.setattr("atmofit.clouds.voxels._SLAB", 1)
    layers = voxelise(BALLS, COUNTS, extinction_coefficient=1.0)
    np.testing.assert_array_equal(whole.extinction_coefficient, layers.extinction_coefficient)


def test_optical_depth_through_a_ball_is_the_integral():
    ball = metaballs(np.zeros((1, 3)), [1.0], [1.0], 1e-6)
    cloud = voxelise(
        ball,
        (1, 1, 60),
        extinction_coefficient=3.0,
        low=(-1e-4,) * 2 + (-1.0,),
        high=(1e-4,) * 2 + (1.0,),
    )
    depth = float(jnp.sum(cloud.extinction_coefficient)) * 2 / 60
    # Of 1 - 22/9 x^2 + 17/9 x^4 - 4/9 x^6 from -1 to 1; midpoints of 1/60 are wrong by its square.
    assert depth == pytest.approx(3 * 2 * (1 - 22 / 27 + 17 / 45 - 4 / 63), abs=1e-4)


def test_occupied_blocks():
    ball = metaballs([[0.5, 0.5, 0.5]], [0.5], [1.0])
    cloud = voxelise(ball, (10, 10, 9), extinction_coefficient=1.0, low=(0.0,) * 3, high=(3.0,) * 3)
    blocks = occupied_blocks(cloud, 4)
    assert blocks.filled.shape == (3, 3, 3)
    assert blocks.filled.sum() == blocks.filled[0, 0, 0] == 1
    assert blocks.saved == pytest.approx(1 - 64 / 900)
    nothing = voxelise(ball, (2, 2, 2), extinction_coefficient=0.0)
    assert occupied_blocks(nothing).saved == 1


def test_impossible_grids_are_refused():
    with pytest.raises(ValueError, match="counts must be three from 1 to"):
        voxelise(BALLS, (0, 1, 1), extinction_coefficient=1.0)
    with pytest.raises(ValueError, match="samples must be"):
        voxelise(BALLS, COUNTS, extinction_coefficient=1.0, samples=99)
    with pytest.raises(ValueError, match="low and high must be given"):
        voxelise(metaballs([], [], []), COUNTS, extinction_coefficient=1.0)
    with pytest.raises(ValueError, match="extinction_coefficient must be"):
        voxelise(BALLS, COUNTS, extinction_coefficient=-1.0)
    with pytest.raises(ValueError, match="at least 1 voxel"):
        occupied_blocks(voxelise(BALLS, COUNTS, extinction_coefficient=1.0), 0)


def test_no_balls_in_a_box():
    cloud = voxelise(metaballs([], [], []), COUNTS, extinction_coefficient=1.0, **BOX)
    assert not np.any(cloud.extinction_coefficient)


@pytest.fixture
def written(tmp_path):
    cloud = voxelise(BALLS, COUNTS, extinction_coefficient=0.1, **BOX)
    return cloud, write_voxels(tmp_path / "cloud.npz", cloud)


def test_files_come_back_as_they_were(written):
    cloud, path = written
    again = read_voxels(path)
    for name in ("extinction_coefficient", "low", "high"):
        assert np.array_equal(getattr(again, name), getattr(cloud, name))
        assert getattr(again, name).dtype == getattr(cloud, name).dtype
    assert [file.name for file in path.parent.iterdir()] == ["cloud.npz"]
    with np.load(path, allow_pickle=False) as file:
        assert json.loads(str(file["header"]))["units"]["extinction_coefficient"] == "1/m"


def test_bad_files_are_refused(written, tmp_path):
    _, path = written
    with pytest.raises(ValueError, match="file must have at most 100 bytes"):
        read_voxels(path, largest_bytes=100)
    with pytest.raises(ValueError, match=r"ends in \.npz"):
        write_voxels(tmp_path / "cloud.dat", written[0])
    with pytest.raises(ValueError, match=r"file must exist, got .*none\.npz"):
        read_voxels(tmp_path / "none.npz")
    bad = tmp_path / "bad.npz"
    whole = path.read_bytes()
    with np.load(path) as file:
        good = dict(file)
    for change, message in (
        (b"", "no usable file"),
        (b"text", "no usable file"),
        (whole[: len(whole) // 2], "no usable file"),
        ({"header": np.array("{}")}, "the format is not"),
        ({"header": np.array("[1]")}, "the format is not"),
        ({"header": np.array("x")}, "no usable file"),
        ({"low": np.zeros(2)}, "three of them"),
        ({"high": np.array([1, 2, 3])}, "floating-point"),
        ({"extinction_coefficient": np.full((2, 2, 2), np.nan)}, "extinction_coefficient must be"),
        ({"low": good["high"]}, "low must lie below"),
        ({"header": np.array([{}], dtype=object)}, "no usable file"),
    ):
        if isinstance(change, bytes):
            bad.write_bytes(change)
        else:
            np.savez(bad, **{**good, **change})
        with pytest.raises(ValueError, match=message):
            read_voxels(bad)


def test_known_corners_serve_inside_a_program():
    corners = jnp.zeros(3), jnp.ones(3)
    made = jax.jit(lambda extinction: voxel_cloud(extinction, *corners))(jnp.ones((2, 2, 2)))
    np.testing.assert_array_equal(made.high, 1.0)
    with pytest.raises(ValueError, match="low must lie below high"):
        jax.jit(lambda extinction: voxel_cloud(extinction, *corners[::-1]))(jnp.ones((2, 2, 2)))
