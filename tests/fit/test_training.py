"""Training sets, and sky models trained on them."""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import atmofit as af
from atmofit.fit.skies import Clock
from atmofit.fit.training import TrainingSettings, simulate_training, train
from atmofit.io import read_sky_model, write_sky_model
from atmofit.models.dependence import Basis
from atmofit.models.shapes import EXTENDED
from atmofit.render.training import write_training_report

pytestmark = pytest.mark.slow
SMALL = TrainingSettings(
    turbidity=(1.7, 3.0, 6.0),
    solar_zenith_angle_deg=(0.0, 50.0, 80.0, 91.0),
    albedo=(0.0, 0.5),
    wavelength_nm=(450.0, 550.0),
    rtol=0.1,
)
BASES = (Basis("polynomial", 2), Basis("polynomial", 3), Basis("polynomial", 2))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("training")


@pytest.fixture(scope="module")
def skies(folder):
    return simulate_training(SMALL, pieces=folder / "pieces")


@pytest.fixture(scope="module")
def trained(skies):
    return train(skies=skies, shape=EXTENDED, bases=BASES, starts=2)


def test_skies_are_those_of_the_simulator(skies):
    """One sky computed alone, without the training set's loops."""
    at = SMALL.atmosphere(jnp.asarray(3.0), jnp.asarray(0.5))
    field = af.solve_sky(at, SMALL.all_wavelength_nm, plan=SMALL.plan())
    alone = field.radiance(np.radians(80.0), skies.directions, 1.0)
    np.testing.assert_allclose(skies.radiance[1, 1, 2], alone, rtol=2e-5)  # float32
    T, sun, albedo = skies.place
    assert (T[14], albedo[14], np.degrees(sun[14])) == pytest.approx((3.0, 0.5, 80.0))


def test_finished_pieces_are_taken(skies, folder):
    told = []
    again = simulate_training(SMALL, Clock(told.append), folder / "pieces")
    assert again.pieces_read == 6
    np.testing.assert_array_equal(again.radiance, skies.radiance)
    assert "piece 6 of 6" in told


def test_model_fits_and_comes_back(trained, skies, folder):
    assert trained.fit.converged.all()
    # Nine numbers hold a sky of 343 directions to a few per cent, low suns to some ten.
    assert trained.fit.rms.max() < 0.12
    text, paths = write_training_report(trained, folder)
    assert "5 channels of 108 coefficients; 5 of 5 fits converged" in text
    assert [path.name for path in paths] == ["table.md", "errors.png"]
    again = read_sky_model(write_sky_model(trained, folder / "sky_model.json"))
    xyY = again(3.0, np.radians(50.0), skies.directions, 0.5)
    simulated = skies.XYZ()[13, :, 1]  # eight skies of turbidity 1.7, four of black ground, one
    assert again.turbidity_range == (1.7, 6.0)
    assert np.sqrt(np.mean((xyY[:, 2] / simulated - 1) ** 2)) < 0.12


def test_impossible_settings_are_refused(skies):
    with pytest.raises(ValueError, match=r"albedo must be between 0 and 1, got 1\.5"):
        TrainingSettings(albedo=(0.0, 1.5))
    with pytest.raises(ValueError, match="turbidity must be an increasing list"):
        TrainingSettings(turbidity=(3.0, 2.0))
    with pytest.raises(ValueError, match="settings must be None where skies are given"):
        train(dataclasses.replace(SMALL, ozone_dobson=0.0), skies=skies)
    with pytest.raises(ValueError, match=r"file must be a sky_model\.json"):
        read_sky_model(Path(__file__))
