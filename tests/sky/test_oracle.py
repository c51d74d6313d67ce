"""Luminance against direct nested quadrature, an independent solution of the same equations."""

import numpy as np
import pytest
from oracles.nested_quadrature import sky_radiance
from oracles.paper_air import paper_constituents

import atmofit as af

pytestmark = [pytest.mark.reference, pytest.mark.slow]
WAVELENGTHS = np.arange(380.0, 781.0, 10.0)
TURBIDITY = 6.0
# Where the rungs err most: below a low sun, and beside a high one. [degree]
SUNS_DEG, VIEWS_DEG = (85.0, 10.0), ((89.0, 0.0), (15.0, 60.0))


def _luminance(radiance):
    sun = np.asarray(af.solar_irradiance_spectrum("preetham1999")(WAVELENGTHS))
    return np.asarray(af.spectrum_to_xyY(radiance * sun, WAVELENGTHS))[..., 2]


@pytest.fixture(scope="module")
def exact():
    """At resolution 1, good to 4e-5."""
    air = paper_constituents(TURBIDITY, WAVELENGTHS)
    angles = [np.radians([sun, *view]) for sun, view in zip(SUNS_DEG, VIEWS_DEG, strict=True)]
    return _luminance(np.stack([sky_radiance(air, *a, resolution=1.0).sum(axis=0) for a in angles]))


@pytest.fixture(scope="module")
def errors(exact):
    """Relative errors of each rung, in float32 as the main job runs."""
    views = af.Directions(*np.radians(np.array(VIEWS_DEG)).T)
    air, found = af.Atmosphere.from_turbidity(TURBIDITY), {}
    for rtol in (1e-2, 2e-3):
        plan = af.plan_sky(air, rtol=rtol, dtype="float32")
        field = af.solve_sky(air, WAVELENGTHS, plan=plan)
        skies = [np.asarray(field.radiance(np.radians(s), views, 1.0), float) for s in SUNS_DEG]
        values = _luminance(np.stack([sky[i] for i, sky in enumerate(skies)]))
        found[rtol] = np.abs(values / exact - 1)
    return found


@pytest.mark.parametrize("rtol", [1e-2, 2e-3])
def test_luminance_keeps_the_promise(errors, rtol):
    assert errors[rtol].max() < rtol


def test_a_finer_rung_is_nearer(errors):
    # By the promises five times; an error that passes through zero is not counted on.
    assert errors[2e-3].max() < errors[1e-2].max() / 3
