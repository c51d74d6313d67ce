"""Phase functions: their integrals by SciPy, their moments, the paper's table."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import atmofit as af
from atmofit.optics.phase import resolved
from atmofit.tables import preetham1999_phase, preetham1999_spectra

NODES, WEIGHTS = special.roots_legendre(3000)  # another rule than the library's
SMOOTH = {
    "rayleigh": af.Rayleigh(),
    "henyey 0.76": af.HenyeyGreenstein(0.76),
    "henyey -0.5": af.HenyeyGreenstein(-0.5),
    "henyey 0": af.HenyeyGreenstein(0.0),
    "henyey 0.97": af.HenyeyGreenstein(0.97),
    "cornette 0.7": af.CornetteShanks(0.7),
    "cornette -0.3": af.CornetteShanks(-0.3),
}
BULLRICH_NM = [380.0, 400.0, 425.0, 500.0, 650.0, 780.0, 850.0]


def _moments(phase, count):
    return np.asarray(phase.moments(count, jnp.array([550.0])))[:, 0]


@pytest.mark.parametrize("name", SMOOTH)
def test_integral_and_moments(name):
    phase = SMOOTH[name]
    p = np.asarray(phase(np.arccos(NODES)))
    integrals = 2 * np.pi * (special.eval_legendre(np.arange(40)[:, None], NODES) * p) @ WEIGHTS
    assert integrals[0] == pytest.approx(1, rel=1e-9)  # erratum 13: (1 - g^2), not (1 - g)^2
    np.testing.assert_allclose(_moments(phase, 40), integrals, atol=1e-9)


def test_mean_cosines():
    for g in (-0.4, 0.3, 0.9):
        assert _moments(af.HenyeyGreenstein(g), 2)[1] == pytest.approx(g)
        expected = 3 * g * (4 + g**2) / (5 * (2 + g**2))
        assert _moments(af.CornetteShanks(g), 2)[1] == pytest.approx(expected)


@pytest.mark.parametrize("kind", [af.HenyeyGreenstein, af.CornetteShanks])
def test_positive_asymmetry_is_forward(kind):
    ahead, behind = np.asarray(kind(0.6)(np.array([0.0, np.pi])))
    assert ahead > 5 * behind
    np.testing.assert_allclose(kind(-0.6)(0.4), kind(0.6)(np.pi - 0.4), rtol=1e-12)


def test_cornette_shanks_without_asymmetry_is_rayleigh():
    angle = np.linspace(0, np.pi, 9)
    np.testing.assert_allclose(af.CornetteShanks(0.0)(angle), af.Rayleigh()(angle), rtol=1e-14)


def test_asymmetry_may_vary_with_wavelength():
    phase = af.HenyeyGreenstein(af.Spectrum([400.0, 800.0], [0.8, 0.6]))
    wavelength = jnp.array([400.0, 600.0])
    assert phase.moments(3, wavelength)[1] == pytest.approx([0.8, 0.7])
    found = phase.at_wavelengths(jnp.array([0.1, 2.0]), wavelength)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found[:, 1], af.HenyeyGreenstein(0.7)(np.array([0.1, 2.0])))


def test_forward_peak_keeps_its_digits_in_float32():
    angle = np.array([0.0, 1e-4, 1e-3, 0.01], np.float32)
    g = 0.99
    exact = (1 - g**2) / (
        4 * np.pi * ((1 - g) ** 2 + 4 * g * np.sin(angle.astype(float) / 2) ** 2) ** 1.5
    )
    found = af.HenyeyGreenstein(np.float32(g))(angle)
    # 1 - g is known to 6e-6 in float32, and enters with the power 2.
    np.testing.assert_allclose(found, exact, rtol=3e-5)


@pytest.mark.parametrize("wavelength", BULLRICH_NM)
def test_the_papers_table_is_normalised(wavelength):
    phase = af.bullrich_phase()
    knots = np.concatenate([[0.0], preetham1999_phase().scattering_angle])
    x, w = np.polynomial.legendre.leggauss(12)
    width = np.diff(knots)[:, None]
    angle = knots[:-1, None] + width * (x + 1) / 2
    p = np.asarray(phase(angle, wavelength))
    ring = 2 * np.pi * np.sin(angle) * width * w / 2
    assert (ring * p).sum() == pytest.approx(1, abs=1e-5)
    degree = np.arange(16)
    moments = [(ring * p * special.eval_legendre(n, np.cos(angle))).sum() for n in degree]
    found = phase.moments(16, jnp.array([wavelength]))[:, 0]
    np.testing.assert_allclose(found, moments, atol=2e-5)


def test_the_papers_table_is_met_at_its_knots():
    table, phase = preetham1999_phase(), af.bullrich_phase()
    for column, wavelength in enumerate(table.wavelength_nm):
        ratio = phase(table.scattering_angle, float(wavelength)) / table.eta[:, column]
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


def test_integral_of_the_papers_table_equals_K():
    """Erratum 28: within 0.2 %, with the library's interpolation."""
    table, spectra, phase = preetham1999_phase(), preetham1999_spectra(), af.bullrich_phase()
    for column, wavelength in enumerate(table.wavelength_nm[:4]):
        # The phase function is eta over 2 pi times the integral of eta sin(angle).
        p = phase(table.scattering_angle, float(wavelength))
        integral = float((table.eta[:, column] / np.asarray(p)).mean()) / (2 * np.pi)
        K = np.interp(wavelength, spectra.wavelength_nm, spectra.K)
        assert integral == pytest.approx(K, rel=2e-3)


def test_the_papers_table_is_smooth_between_its_knots():
    table, phase = preetham1999_phase(), af.bullrich_phase()
    knots = np.concatenate([[0.0], table.scattering_angle])
    inside = knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(0, 1, 21)
    for wavelength in BULLRICH_NM:
        log = np.log(np.asarray(phase(inside, wavelength)))
        low, high = np.minimum(log[:, 0], log[:, -1]), np.maximum(log[:, 0], log[:, -1])
        assert (log.max(1) - high).max() < 0.03
        assert (low - log.min(1)).max() < 0.03
    slope = jax.vmap(jax.grad(lambda a: jnp.log(phase(a))))
    before, after = slope(knots[1:-1] - 1e-7), slope(knots[1:-1] + 1e-7)
    np.testing.assert_allclose(before, after, atol=1e-3)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", [*SMOOTH, "bullrich"])
def test_slopes_are_finite(name, dtype):
    phase = af.bullrich_phase() if name == "bullrich" else SMOOTH[name]
    phase = jax.tree.map(lambda x: x.astype(dtype), phase)
    angle = jnp.asarray([0.0, 1e-6, 1.0, np.pi], dtype)
    of_both = jax.value_and_grad(lambda phase, a: phase(a), argnums=(0, 1))
    value, slope = jax.jit(jax.vmap(of_both, in_axes=(None, 0)))(phase, angle)
    assert (np.asarray(value) > 0).all()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_a_table_of_a_known_function():
    angle = np.linspace(0, np.pi, 91)
    exact = af.HenyeyGreenstein(0.5)
    table = af.TabulatedPhase(angle, 7.0 * np.asarray(exact(angle)))
    between = np.linspace(0, np.pi, 400)
    np.testing.assert_allclose(table(between), exact(between), rtol=3e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0], [1.0, 2.0, 3.0]), r"got \(3, 1\)"),
        (([0.0], [1.0]), "at least 2 angles"),
        (([0.0, 4.0], [1.0, 1.0]), "angle must be between 0 and 3.14159 rad, got 4"),
        (([1.0, 0.5], [1.0, 1.0]), "angle of a TabulatedPhase must increase"),
        (([0.0, 1.0], [1.0, 0.0]), "values must be at least .*, got 0"),
        (([0.0, 1.0], [1.0, np.nan]), "values must be .* got nan"),
        (([0.0, 1.0], np.ones((2, 2)), [500.0, 400.0]), "wavelength_nm of a TabulatedPhase must"),
    ],
)
def test_tables_that_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        af.TabulatedPhase(*arguments)


def test_arguments_that_are_refused():
    with pytest.raises(ValueError, match=r"scattering_angle must be .* rad, got 3\.2"):
        af.Rayleigh()(3.2)
    for kind in (af.HenyeyGreenstein, af.CornetteShanks):
        with pytest.raises(ValueError, match=r"asymmetry must be between .*, got 1$"):
            kind(1.0).checked()


def test_unresolved_peaks_are_cut_forward_and_blurred_backward():
    λ = jnp.array([550.0])
    cosine = np.linspace(-1.0, 1.0, 2001)
    for g in (0.99, 0.8, 0.0, -0.5, -0.9, -0.999):
        moments = af.HenyeyGreenstein(g).moments(17, λ)[:, 0]
        kept, peak = resolved(moments)
        # Delta scaling: what is left has the first moments, the peak put back.
        np.testing.assert_allclose(kept[0], 1.0, rtol=1e-12)
        assert float(peak) == pytest.approx(max(g, 0.0) ** 16)
        if g > 0:
            np.testing.assert_allclose(kept * (1 - peak) + peak, moments[:-1], rtol=1e-12)
        if g == -0.999:
            degree = np.arange(kept.size)
            least, bare = (
                np.polynomial.legendre.legval(cosine, (2 * degree + 1) * np.asarray(x)).min()
                for x in (kept, moments[:-1])
            )
            # Cesaro's mean of a peak is nowhere negative.
            assert bare < -20
            assert least > 1e-3 * bare  # seen: -0.008 and -34
    # Resolved: nothing changes.
    wide = af.HenyeyGreenstein(-0.3).moments(33, λ)[:, 0]
    np.testing.assert_allclose(resolved(wide)[0], wide[:-1], atol=1e-15)
