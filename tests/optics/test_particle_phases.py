"""Phase functions of particles against SciPy, and the Lambert sphere against its own surface."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import atmofit as af
from atmofit.optics.particle_phases import (
    Isotropic,
    LambertSphere,
    LinearPhase,
    PhaseSum,
    furnace_slag_phase,
    henyey_greenstein_of_phase_angle,
    phase_angle,
    phase_of_phase_angle,
    saturn_ring_phase,
    scattering_angle_of_phase_angle,
)

NODES, WEIGHTS = special.roots_legendre(3000)
PHASES = {
    "isotropic": Isotropic(),
    "linear": LinearPhase(0.7),
    "linear, forward": LinearPhase(-1.0),
    "Lambert": LambertSphere(),
    "slag": furnace_slag_phase(),
    "Saturn": saturn_ring_phase(),
    "nested": PhaseSum(
        [0.25, 0.75], (af.Rayleigh(), PhaseSum([0.5, 0.5], (LambertSphere(), LinearPhase(0.3))))
    ),
}


@pytest.mark.parametrize("name", PHASES)
def test_integral_and_moments(name):
    phase = PHASES[name]
    p = np.asarray(phase(np.arccos(NODES)))
    found = np.asarray(phase.moments(40, jnp.array([550.0])))[:, 0]
    integrals = 2 * np.pi * (special.eval_legendre(np.arange(40)[:, None], NODES) * p) @ WEIGHTS
    assert integrals[0] == pytest.approx(1, rel=1e-9)
    # The Lambert sphere's slope is not smooth at both ends: the rule's error there is 1e-9.
    np.testing.assert_allclose(found, integrals, atol=1e-8)
    in_blinns = 2 * np.pi * np.asarray(phase_of_phase_angle(phase, np.arccos(NODES))) @ WEIGHTS
    assert in_blinns == pytest.approx(4 * np.pi, rel=1e-9)
    if phase.degree is not None:
        assert not found[phase.degree + 1 :].any()


def test_angles_are_converted_back_and_forth():
    angle = np.linspace(0, np.pi, 7)
    assert float(phase_angle(0.0)) == pytest.approx(np.pi)
    np.testing.assert_allclose(
        scattering_angle_of_phase_angle(phase_angle(angle)), angle, atol=1e-15
    )


def test_lambert_sphere_is_the_sum_over_its_lit_and_seen_surface():
    # Brightness over pi of a white surface is cos(incidence) / pi; Gauss-Legendre in latitude and
    # in the longitudes that are both lit and seen, where the integrand is smooth.
    x, w = np.polynomial.legendre.leggauss(60)
    latitude, area = np.pi / 2 * x, np.pi / 2 * w * np.cos(np.pi / 2 * x)
    for a in np.linspace(0.0, np.pi, 13):
        low, high = a - np.pi / 2, np.pi / 2  # observer at longitude 0, sun at a
        longitude = (low + high) / 2 + (high - low) / 2 * x
        both = np.cos(latitude)[:, None] ** 2 * np.cos(longitude) * np.cos(longitude - a)
        seen = (area[:, None] * w * (high - low) / 2 * np.maximum(both, 0.0)).sum() / np.pi
        # Per unit cross section pi: intensity over (intercepted light / (4 pi)).
        expected = seen / np.pi * 4 * np.pi
        assert float(phase_of_phase_angle(LambertSphere(), a)) == pytest.approx(expected, abs=2e-6)


def test_lambert_sphere_as_blinn_writes_it():
    a = np.linspace(0, np.pi, 50)
    printed = 8 / (3 * np.pi) * (np.sin(a) + (np.pi - a) * np.cos(a))
    np.testing.assert_allclose(phase_of_phase_angle(LambertSphere(), a), printed, atol=1e-14)


def test_lambert_sphere_keeps_its_digits_in_a_thin_crescent():
    angle = np.array([1e-3, 0.1, 0.4999, 0.5001, 1.0], np.float32)
    exact = angle.astype(float)
    exact = 2 / (3 * np.pi**2) * (np.sin(exact) - exact * np.cos(exact))
    np.testing.assert_allclose(LambertSphere()(angle), exact, rtol=2e-5)


def test_positive_g_of_the_phase_angle_is_back():
    for g in (0.325, 0.5):
        phase = henyey_greenstein_of_phase_angle(g)
        back, ahead = np.asarray(phase_of_phase_angle(phase, np.array([0.0, np.pi])))
        assert back == pytest.approx((1 - g**2) / (1 - g) ** 3)
        assert ahead == pytest.approx((1 - g**2) / (1 + g) ** 3)
    assert float(np.asarray(furnace_slag_phase().asymmetry)) == pytest.approx(-0.325)
    assert LinearPhase(0.5)(np.pi) > LinearPhase(0.5)(0.0)


def test_the_printed_henyey_greenstein_is_not_normalised():
    # Erratum 21: (1 - g) / (1 + g - 2 g cos a) has a norm of 0.557 at g = 0.325.
    g = 0.325
    printed = (1 - g) / (1 + g - 2 * g * NODES)
    assert printed @ WEIGHTS / 2 == pytest.approx(0.557, abs=5e-4)
    # Erratum 22: 3/4 (1 + cos a) has 0.75, and nothing at a = pi.
    assert pytest.approx(0.75) == 0.75 * (1 + NODES) @ WEIGHTS / 2


def test_saturns_lobes():
    back, ahead = np.asarray(phase_of_phase_angle(saturn_ring_phase(), np.array([0.0, np.pi])))
    assert back == pytest.approx(0.596 * 6 + 0.404 * 0.75 / 1.5**3)
    assert ahead == pytest.approx(0.404 * 6 + 0.596 * 0.75 / 1.5**3)


def test_sums_work_traced_and_at_several_wavelengths():
    varied = af.HenyeyGreenstein(af.Spectrum([400.0, 800.0], [0.8, 0.6]))
    mixture = PhaseSum([0.4, 0.6], (varied, Isotropic()))
    wavelength = jnp.array([400.0, 600.0, 800.0])
    assert mixture.at_wavelengths(jnp.array([0.1, 2.0]), wavelength).shape == (2, 3)
    np.testing.assert_allclose(mixture.moments(2, wavelength)[1], 0.4 * np.array([0.8, 0.7, 0.6]))

    def ahead(share):
        weights = jnp.stack([share, 1 - share])
        return PhaseSum(weights, (LambertSphere(), Isotropic())).checked()(0.0)

    assert float(jax.jit(jax.grad(ahead))(0.3)) == pytest.approx(-1 / (4 * np.pi))
    assert np.isnan(jax.jit(lambda w: PhaseSum(w, (Isotropic(),)).checked()(0.0))(jnp.array([0.9])))


def test_impossible_phase_functions():
    with pytest.raises(ValueError, match=r"weights must add to 1, got 0\.9"):
        PhaseSum([0.4, 0.5], (Isotropic(), LambertSphere()))
    with pytest.raises(ValueError, match="one for each of the 1 parts"):
        PhaseSum([0.4, 0.6], (Isotropic(),))
    with pytest.raises(ValueError, match=r"x must be between -1 and 1, got 1\.5"):
        LinearPhase(1.5).checked()
    with pytest.raises(ValueError, match="g must be"):
        henyey_greenstein_of_phase_angle(1.0)
    with pytest.raises(ValueError, match="x must be"):
        PhaseSum([1.0], (LinearPhase(-2.0),)).checked()
