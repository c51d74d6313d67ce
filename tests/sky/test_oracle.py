"""Luminance against direct nested quadrature, an independent solution of the same equations."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import Scatterer, rayleigh_phase
from oracles.nested_quadrature import sky_radiance
from scipy.interpolate import PchipInterpolator

import atmofit as af
from atmofit.tables import preetham1999_phase

pytestmark = [pytest.mark.reference, pytest.mark.slow]
WAVELENGTHS = np.array([430.0, 500.0, 560.0, 620.0])
VIEWS, AZIMUTHS = np.radians([0.0, 70.0, 85.0]), np.radians([0.0, 30.0, 150.0])


class _PaperPhase:
    """Table 1 interpolated in another way than the library's: monotone cubics of log eta."""

    def __init__(self, wavelength_nm):
        table = preetham1999_phase()
        angle = np.concatenate([[0.0], table.scattering_angle])
        eta = np.concatenate([table.eta[:1], table.eta])
        log = np.stack([np.interp(wavelength_nm, table.wavelength_nm, np.log(row)) for row in eta])
        self.log = PchipInterpolator(angle, log, axis=0)
        fine = np.linspace(0, np.pi, 20_001)
        ring = 2 * np.pi * np.sin(fine)[:, None] * np.exp(self.log(fine))
        self.total = np.trapezoid(ring, fine, axis=0)

    def __call__(self, cosine, wavelength_index):
        angle = np.arccos(np.clip(cosine, -1, 1))[..., 0]
        return (np.exp(self.log(angle)) / self.total)[..., np.ravel(wavelength_index)]


def _constituents(air):
    parts = (air.molecules, air.haze)
    depth = [np.asarray(part.optical_depth_at(jnp.asarray(WAVELENGTHS))) for part in parts]
    height = [float(part.scale_height) for part in parts]
    return [
        Scatterer(depth[0], height[0], rayleigh_phase),
        Scatterer(depth[1], height[1], _PaperPhase(WAVELENGTHS)),
    ]


@pytest.mark.parametrize("turbidity", [2.0, 6.0])
def test_luminance_of_the_papers_sky(turbidity):
    air = af.Atmosphere.from_turbidity(turbidity)
    field = af.solve_sky(air, WAVELENGTHS, rtol=1e-2)
    dirs, constituents = af.Directions(VIEWS, AZIMUTHS), _constituents(air)
    sunlight = np.asarray(af.solar_irradiance_spectrum("preetham1999")(WAVELENGTHS))
    # Weights of luminance at these wavelengths, roughly: both sides carry the same.
    weight = sunlight * np.array([0.02, 0.32, 1.0, 0.38])
    for sun in np.radians([40.0, 85.0]):
        found = np.asarray(field.radiance(sun, dirs, 1.0))
        for i in range(VIEWS.size):
            exact = sky_radiance(constituents, sun, VIEWS[i], AZIMUTHS[i], resolution=0.8).sum(0)
            assert found[i] @ weight == pytest.approx(exact @ weight, rel=1e-2), (sun, i)
            np.testing.assert_allclose(found[i], exact, rtol=2e-2)
