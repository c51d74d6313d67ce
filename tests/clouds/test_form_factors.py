"""Form factors: no more light than there is, and the right light between two voxels."""

import numpy as np
import pytest

from atmofit.clouds.form_factors import even_directions, form_factors
from atmofit.optics.particle_phases import Isotropic
from atmofit.optics.phase import CornetteShanks, HenyeyGreenstein

REACH, DEPTH = (4, 4, 8), 0.05  # of a voxel
UP = (0.0, 0.0, 1.0)
LONGEST = float(np.linalg.norm([5, 5, 9])) * DEPTH  # from a voxel's far corner to the box's


def by_middles(asymmetry):
    """What the paper's formula gives without sub-voxels, over 8 x 8 voxels and 8 forward."""
    across, along = np.arange(-4, 4), np.arange(-8, 9)
    place = np.stack(np.meshgrid(across, across, along, indexing="ij"), -1).reshape(-1, 3)
    place = place[np.any(place != 0, axis=1)]
    way = np.linalg.norm(place, axis=1)
    angle = np.arccos(np.clip(place[:, 2] / way, -1, 1))
    phase = np.asarray(CornetteShanks(asymmetry)(angle))
    return float(np.sum(phase * DEPTH * np.exp(-DEPTH * way) / way**2))


@pytest.mark.parametrize("asymmetry", [0.0, 0.7, 0.9, 0.95])
def test_rows_add_to_no_more_than_the_longest_path_takes(asymmetry):
    for direction in (UP, (0.36, 0.48, 0.8)):
        row = form_factors(
            phase=CornetteShanks(asymmetry),
            direction=direction,
            extinction_coefficient=DEPTH,
            reach=REACH,
        )
        assert row.min() >= 0
        assert row.sum() <= 1 - np.exp(-LONGEST)


def test_middles_alone_give_more_light_than_there_is():
    # Erratum 54: 1.22 at g = .9 and 4.4 at g = .95, where .33 is possible.
    assert by_middles(0.9) == pytest.approx(1.22, rel=0.05)
    assert by_middles(0.95) == pytest.approx(4.4, rel=0.05)
    for asymmetry in (0.9, 0.95):
        assert by_middles(asymmetry) > 1 - np.exp(-LONGEST)


def test_far_voxels_have_what_their_middles_say():
    # Isotropic, where a voxel is small as seen from the other.
    row = form_factors(
        phase=Isotropic(), direction=UP, extinction_coefficient=DEPTH, reach=REACH, directions=20000
    )
    for place in [(3, 0, 5), (0, 0, 7), (-3, 2, -6)]:
        way = np.linalg.norm(place)
        middle = DEPTH * np.exp(-DEPTH * way) / way**2 / (4 * np.pi)
        assert row[tuple(np.array(REACH) + place)] == pytest.approx(middle, rel=0.04)


def test_own_and_next_voxel_by_random_places():
    random, count = np.random.default_rng(3), 200_000
    start = random.random((count, 3))
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    phase = np.asarray(HenyeyGreenstein(0.5)(np.arccos(direction[:, 2]))) * 4 * np.pi
    end = start + random.exponential(1 / 0.3, count)[:, None] * direction
    row = form_factors(
        phase=HenyeyGreenstein(0.5), direction=UP, extinction_coefficient=0.3, reach=(1, 1, 1)
    )
    for voxel in [(0, 0, 0), (0, 0, 1), (1, 0, 0)]:
        hit = np.all(np.floor(end) == voxel, axis=1) * phase
        error = hit.std() / np.sqrt(count)
        assert abs(row[tuple(np.array(voxel) + 1)] - hit.mean()) < 4 * error + 0.01 * hit.mean()


def test_directions_are_even():
    directions = even_directions(2000)
    np.testing.assert_allclose(directions.mean(0), 0.0, atol=1e-3)
    np.testing.assert_allclose(directions.T @ directions / 2000, np.eye(3) / 3, atol=1e-3)


def test_refusals():
    with pytest.raises(ValueError, match="extinction"):
        form_factors(phase=Isotropic(), direction=UP, extinction_coefficient=-1.0)
    with pytest.raises(ValueError, match="components"):
        form_factors(phase=Isotropic(), direction=(0.0, 0.0, 0.0), extinction_coefficient=1.0)
