"""The zenith forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from simple_skies import SUNS, TURBIDITIES

from atmofit.fit.zenith import fit_zenith_chromaticity, fit_zenith_luminance
from atmofit.models.preetham import PREETHAM_1999

T, S = np.meshgrid(TURBIDITIES, SUNS, indexing="ij")
PUBLISHED = np.asarray(PREETHAM_1999.zenith(T, S))
RNG = np.random.default_rng(4)


@pytest.mark.parametrize("weighting", ["relative", "absolute"])
def test_published_coefficients_come_back(weighting):
    luminance = fit_zenith_luminance(TURBIDITIES, SUNS, PUBLISHED[..., 2], weighting=weighting)
    np.testing.assert_allclose(luminance.coefficients, PREETHAM_1999.zenith_luminance, rtol=1e-9)
    for k, matrix in enumerate((PREETHAM_1999.zenith_x, PREETHAM_1999.zenith_y)):
        fit = fit_zenith_chromaticity(TURBIDITIES, SUNS, PUBLISHED[..., k], weighting=weighting)
        np.testing.assert_allclose(fit.coefficients, matrix, atol=1e-10)
        assert float(fit.rms) < 1e-12


def test_standard_errors_are_those_of_repeated_noise():
    fits = [
        fit_zenith_luminance(
            TURBIDITIES, SUNS, PUBLISHED[..., 2] * (1 + 0.01 * RNG.normal(size=T.shape))
        )
        for _ in range(400)
    ]
    spread = np.std([fit.coefficients for fit in fits], axis=0)
    claimed = np.mean([fit.standard_error for fit in fits], axis=0)
    np.testing.assert_allclose(claimed, spread, rtol=0.15)  # 400 draws: 3.5 %
    assert np.mean([fit.rms for fit in fits]) == pytest.approx(0.01, rel=0.05)


def test_robust_errors_hold_where_the_noise_is_uneven():
    noise = 0.003 + 0.05 * (np.abs(SUNS - SUNS.mean()) / np.ptp(SUNS)) ** 2  # worse at both ends
    fits = [
        fit_zenith_luminance(
            TURBIDITIES, SUNS, PUBLISHED[..., 2] * (1 + noise * RNG.normal(size=T.shape))
        )
        for _ in range(400)
    ]
    spread = np.std([fit.coefficients for fit in fits], axis=0)
    claimed = np.mean([fit.robust_standard_error for fit in fits], axis=0)
    np.testing.assert_allclose(claimed, spread, rtol=0.15)  # 400 draws: 3.5 %; HC3 is 5 % large
    naive = np.mean([fit.standard_error for fit in fits], axis=0)
    assert np.abs(np.log(naive / spread)).max() > 0.3


def test_condition_number_and_residuals():
    noisy = PUBLISHED[..., 0] * (1 + 0.01 * RNG.normal(size=T.shape))
    fit = fit_zenith_chromaticity(TURBIDITIES, SUNS, noisy, weighting="absolute")
    basis = np.stack([T**i * S**j for i in (2, 1, 0) for j in (3, 2, 1, 0)], axis=-1).reshape(
        -1, 12
    )
    scaled = basis / np.linalg.norm(basis, axis=0)
    np.testing.assert_allclose(fit.condition_number, np.linalg.cond(scaled), rtol=1e-6)
    expected = basis @ np.ravel(fit.coefficients) - noisy.ravel()
    unit = np.sqrt(np.mean(noisy**2))
    np.testing.assert_allclose(np.ravel(fit.residuals), expected / unit, atol=1e-12)
    assert float(fit.largest) == pytest.approx(np.abs(expected).max() / unit)


def test_bad_input():
    good = PUBLISHED[..., 2]
    with pytest.raises(ValueError, match=r"shape \[turbidity, sun\] = \(5, 12\), got \(12, 5\)"):
        fit_zenith_luminance(TURBIDITIES, SUNS, good.T)
    with pytest.raises(ValueError, match="luminance must be finite, got nan"):
        fit_zenith_luminance(TURBIDITIES, SUNS, np.where(good > 1e4, np.nan, good))
    with pytest.raises(ValueError, match="luminance must be positive"):
        fit_zenith_luminance(TURBIDITIES, SUNS, -good)
    with pytest.raises(ValueError, match=r"luminance must hold data, got shape \(0,\)"):
        fit_zenith_luminance(TURBIDITIES, SUNS, np.zeros(0))
    with pytest.raises(ValueError, match="turbidity must hold at least 3 different values, got 2"):
        fit_zenith_chromaticity(TURBIDITIES[:2], SUNS, PUBLISHED[:2, :, 0])
    with pytest.raises(ValueError, match=r"weighting must be one of .*got 'log'"):
        fit_zenith_luminance(TURBIDITIES, SUNS, good, weighting="log")
    with pytest.raises(ValueError, match=r"solar_zenith_angle.*got 1\.69813"):
        fit_zenith_luminance(TURBIDITIES, SUNS + 1.0, good)


def test_float32_input_is_fitted_in_the_default_type():
    fit = fit_zenith_luminance(TURBIDITIES, SUNS, jnp.asarray(PUBLISHED[..., 2], "float32"))
    np.testing.assert_allclose(fit.coefficients, PREETHAM_1999.zenith_luminance, rtol=1e-4)
