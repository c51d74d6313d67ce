"""Directions on the dome, and the angle between them and the sun."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import atmofit as af

ANGLE = st.floats(0, np.pi / 2)


def _vector(zenith, azimuth):
    return np.array(
        [np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)]
    )


@given(ANGLE, st.floats(-7, 7), ANGLE)
@settings(max_examples=50, deadline=None)
def test_scattering_angle_is_the_angle_between_two_vectors(view, azimuth, sun):
    u, v = _vector(view, azimuth), _vector(sun, 0.0)
    exact = 2 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))
    np.testing.assert_allclose(af.scattering_angle(view, azimuth, sun), exact, atol=1e-14)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_scattering_angle_near_the_sun(dtype):
    eps = np.finfo(dtype).eps
    sun = np.asarray(0.7, dtype)
    for gap in (1e-4, 1e-2):  # float32 resolves far below the 0.03 degrees that arccos can
        view = np.asarray(sun + gap, dtype)
        exact = float(view) - float(sun)
        found = float(af.scattering_angle(view, np.zeros((), dtype), sun))
        assert abs(found - exact) <= 4 * eps * exact
    assert af.scattering_angle(sun, np.zeros((), dtype), sun) == 0
    np.testing.assert_allclose(
        af.scattering_angle(
            np.asarray(np.pi / 2, dtype), np.asarray(np.pi, dtype), np.asarray(np.pi / 2, dtype)
        ),
        np.pi,
        rtol=4 * eps,
    )


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_slopes_of_the_scattering_angle(dtype):
    slope = jax.grad(af.scattering_angle, argnums=(0, 1, 2))

    def at(*angles):
        return np.asarray(slope(*(jnp.asarray(a, dtype) for a in angles)))

    for coincident in ((0.7, 0.0, 0.7), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        np.testing.assert_array_equal(at(*coincident), 0)
    np.testing.assert_allclose(at(0.9, 0.0, 0.5), [1, 0, -1], atol=1e-6)
    np.testing.assert_allclose(at(0.5 + 1e-3, 0.0, 0.5), [1, 0, -1], atol=1e-3)
    step, case = 1e-6, np.array([0.8, 1.1, 0.4])
    difference = [
        (af.scattering_angle(*(case + step * e)) - af.scattering_angle(*(case - step * e)))
        / (2 * step)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(at(*case), difference, rtol=1e-5)


def test_arguments_broadcast():
    found = af.scattering_angle(np.zeros((3, 1)), np.zeros((1, 4)), 0.5)
    np.testing.assert_allclose(found, np.full((3, 4), 0.5))


def test_the_reference_dome():
    dome = af.dome_343()
    assert dome.shape == (343,)
    assert dome.rings == (1,) + (19,) * 18
    view = np.degrees(dome.view_zenith_angle)
    assert set(np.round(view, 9)) == {0.0, *range(5, 90, 5), 89.0}
    assert np.degrees(dome.relative_azimuth[1:20]) == pytest.approx(np.arange(0, 181, 10))
    assert dome.checked().shape == (343,)


def test_a_grid_is_its_list():
    grid = af.DirectionGrid(np.radians([10.0, 50.0]), np.radians([0.0, 90.0, 180.0]))
    as_list = grid.as_list()
    assert grid.shape == (2, 3)
    assert as_list.rings == (3, 3)
    np.testing.assert_array_equal(as_list.ring_starts, [0, 3])
    for one, two in zip(grid.angles(), as_list.angles(), strict=True):
        np.testing.assert_array_equal(np.ravel(one), two)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0], [0.0]), r"one length, got shapes \(2,\) and \(1,\)"),
        (([[0.0]], [[0.0]]), r"one length, got shapes \(1, 1\)"),
        (([], []), "at least one direction, got none"),
        (([0.0, 1.0], [0.0, 1.0], (3,)), "rings must be whole numbers above 0 that add up to 2"),
    ],
)
def test_lists_that_do_not_fit(arguments, message):
    with pytest.raises(Exception, match=message) as caught:
        af.Directions(*arguments)
    assert isinstance(caught.value, ValueError | TypeError)


@pytest.mark.parametrize("axes", [([], [0.0]), ([0.0], [])])
def test_a_grid_with_an_empty_axis(axes):
    with pytest.raises(ValueError, match="must be a list that is not empty"):
        af.DirectionGrid(*axes)


@pytest.mark.parametrize(
    ("view", "azimuth", "message"),
    [
        (1.6, 0.0, r"view_zenith_angle must be between .* rad, got 1\.6"),
        (-0.1, 0.0, r"view_zenith_angle must be between .* rad, got -0\.1"),
        (np.nan, 0.0, "view_zenith_angle must be between .* rad, got nan"),
        (0.5, np.inf, "relative_azimuth must be finite, got inf"),
        (0.5, np.nan, "relative_azimuth must be finite, got nan"),
    ],
)
def test_directions_that_are_none(view, azimuth, message):
    with pytest.raises(ValueError, match=message):
        af.Directions([0.3, view], [0.0, azimuth]).checked()


def test_a_ring_has_one_zenith_angle():
    with pytest.raises(ValueError, match="constant in each of the rings"):
        af.Directions([0.1, 0.2], [0.0, 1.0], (2,)).checked()


def test_traced_directions_below_the_horizon_become_nan():
    checked = jax.jit(lambda view: af.Directions(view, view).checked().view_zenith_angle)
    np.testing.assert_array_equal(checked(jnp.array([0.5, 1.6])), [0.5, np.nan])
