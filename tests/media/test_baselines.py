"""The older models of aerial perspective: found again, and as wrong as expected."""

import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af

WAVELENGTHS = np.linspace(400.0, 700.0, 7)
AIR = af.low_air(
    af.Atmosphere(af.Molecules(), af.Haze(0.1, phase=af.HenyeyGreenstein(0.76))), WAVELENGTHS
)


def test_fog_is_found_again():
    share, colour = 1 - np.exp(-np.linspace(0.1, 4, 9)), np.linspace(2.0, 5.0, 7)
    fog = np.broadcast_to(share[:, None] * colour, (3, 9, 7))
    found = af.fit_depth_fog(fog)
    np.testing.assert_allclose(found(0.0), fog[:1], rtol=1e-10)
    assert found.share.max() == pytest.approx(1.0)
    # Something of the fog's own colour stays as it is.
    same = np.broadcast_to(found.colour, (1, 9, 7))
    np.testing.assert_allclose(found(found.colour[None, None]), same)


def test_ambient_light_is_found_again():
    passing = np.random.default_rng(1).random((3, 9, 7))
    ambient = np.linspace(1.0, 2.0, 7)
    found = af.fit_ward_larson(ambient * (1 - passing), passing)
    np.testing.assert_allclose(found.ambient, ambient, rtol=1e-12)
    np.testing.assert_allclose(found(1.0, passing), passing + ambient * (1 - passing), rtol=1e-12)


def test_a_sun_makes_both_miss():
    """What no model without direction can do: the nearer to the sun, the more."""
    distance = np.geomspace(100, 1e5, 12)
    missed = []
    for nearest in (3.0, 30.0, 60.0):
        angle = jnp.radians(jnp.linspace(nearest, 180.0, 40))
        light = AIR.scattering[None] * AIR.phase_functions(angle)
        source = jnp.broadcast_to(light[:, None], (40, 12, 2, 7))
        path = af.Path(np.broadcast_to(distance, (40, 12)), np.pi / 2)
        found = af.path_transfer(AIR, path, source)
        truth = np.asarray(found.in_scattered)
        models = (
            af.fit_depth_fog(truth)(0.0),
            af.fit_ward_larson(truth, found.transmittance)(0.0, found.transmittance),
        )
        missed.append(
            [np.sqrt(np.mean((np.asarray(m) - truth) ** 2) / np.mean(truth**2)) for m in models]
        )
    missed = np.asarray(missed)
    assert (np.diff(missed, axis=0) < 0).all()
    assert (missed[0] > 0.8).all()
    assert (missed[2] < 0.4).all()


def test_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"must be \[direction, distance, wavelength\], got shape"):
        af.fit_depth_fog(np.ones((3, 4)))
