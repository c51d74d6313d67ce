"""Fits of the Perez formula; every test shares one of two compiled programs."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from simple_skies import SUNS, TURBIDITIES, scattered_xyY

from atmofit.fit import single_sky, weighting
from atmofit.fit.distribution import fit_distribution
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.single_sky import fit_perez
from atmofit.geometry import DirectionGrid, Directions, dome_343, scattering_angle
from atmofit.models.perez import perez
from atmofit.models.preetham import PREETHAM_1999

DOME = dome_343()
QUANTITIES = ("x", "y", "luminance")
NO_PRIOR = PerezPrior(strength=0.0)


def published(quantity):
    """Ratios to the zenith that the published matrix makes, [turbidity, sun, direction]."""
    matrix = getattr(PREETHAM_1999, f"{quantity}_distribution")
    view, azimuth = DOME.angles()
    γ = scattering_angle(view[None, :], azimuth[None, :], SUNS[:, None])
    skies = []
    for T in TURBIDITIES:
        c = matrix @ np.array([T, 1.0])
        skies.append(perez(c, view[None, :], γ) / perez(c, 0.0, SUNS)[:, None])
    return np.array(skies)


@pytest.fixture(scope="module")
def scattered():
    return np.moveaxis(scattered_xyY(DOME), -1, 0)


@pytest.fixture(scope="module")
def noisy():
    """180 skies: one sky with 180 times new noise of 1 %."""
    rng = np.random.default_rng(7)
    c = np.array([-0.9, -0.4, 4.0, -2.2, 0.3])
    γ = scattering_angle(*DOME.angles(), 0.9)
    clean = 30.0 * np.asarray(perez(c, DOME.view_zenith_angle, γ))
    return np.append(c, 30.0), clean * (1 + 0.01 * rng.normal(size=(3, 5, 12, 343)))


@pytest.fixture(scope="module")
def scattered_fit(scattered):
    return fit_perez(DOME, SUNS, scattered)


@pytest.fixture(scope="module")
def noisy_fit(noisy):
    return fit_perez(DOME, 0.9, noisy[1])


def test_known_coefficients_come_back():
    tables = np.stack([published(quantity) for quantity in QUANTITIES])
    fit = fit_perez(DOME, SUNS, 1e4 * tables, prior=NO_PRIOR)
    assert fit.converged.all()
    assert float(fit.largest.max()) < 1e-7
    low = (SUNS > 0.1) & (SUNS < 1.3)  # with the sun overhead, two angles are one
    for k, quantity in enumerate(QUANTITIES):
        matrix = getattr(PREETHAM_1999, f"{quantity}_distribution")
        known = TURBIDITIES[:, None] * matrix[:, 0] + matrix[:, 1]
        difference = fit.coefficients[k][:, low] - known[:, None, :]
        assert np.abs(difference).max() < 1e-4


def test_every_scattered_sky_converges(scattered, scattered_fit):
    """Suns from 0 to 87 degrees, T from 2 to 6, x, y and Y: 180 skies in one program."""
    fit = scattered_fit
    assert fit.converged.all()
    assert np.isfinite(fit.standard_error).all()
    assert (fit.coefficients[..., 1] < 0).all()
    assert (fit.coefficients[..., 3] < 0).all()
    # The direction that runs away stays at hand: C <= 1 and D <= -0.1 for both chromaticities.
    assert np.abs(fit.coefficients[:2, ..., 2]).max() < 1.0
    assert fit.coefficients[:2, ..., 3].max() < -0.1
    assert float(fit.rms[:2].max()) < 0.025
    predicted = fit.predict(DOME, SUNS)
    np.testing.assert_allclose(
        np.sqrt(np.mean((predicted / scattered - 1) ** 2, axis=-1)), fit.rms, rtol=1e-6
    )


def test_prior_costs_little(scattered, scattered_fit):
    """Without the prior, the chromaticities are fitted hardly better: 5e-4 at most."""
    without = fit_perez(DOME, SUNS, scattered, prior=NO_PRIOR)
    gain = scattered_fit.rms[:2] - without.rms[:2]
    assert float(gain.max()) < 5e-4
    assert float(np.mean(gain)) < 1e-4


def test_standard_errors_are_those_of_repeated_noise(noisy, noisy_fit):
    (known, _), fit = noisy, noisy_fit
    assert fit.converged.all()
    all_six = np.concatenate([fit.coefficients, fit.scale[..., None]], axis=-1).reshape(-1, 6)
    spread = all_six.std(axis=0)
    claimed = np.asarray(fit.standard_error).reshape(-1, 6).mean(axis=0)
    np.testing.assert_allclose(claimed, spread, rtol=0.2)  # 180 draws: 5 % each
    assert (np.abs(all_six.mean(axis=0) - known) < 5 * spread / np.sqrt(180) + 0.1 * spread).all()
    assert float(fit.rms.mean()) == pytest.approx(0.01, rel=0.05)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(fit.covariance, axis1=-2, axis2=-1)), fit.standard_error, rtol=1e-12
    )


def test_unit_of_the_values_does_not_matter(noisy, noisy_fit):
    fit, same = noisy_fit, fit_perez(DOME, 0.9, 1e-9 * noisy[1])
    np.testing.assert_allclose(fit.coefficients, same.coefficients, rtol=1e-4)
    np.testing.assert_allclose(same.scale, 1e-9 * fit.scale, rtol=1e-4)
    np.testing.assert_allclose(same.standard_error[..., 5], 1e-9 * fit.standard_error[..., 5], 1e-3)


def test_bad_sky_spoils_only_itself(noisy):
    """As under a trace, where data cannot be refused; here past the check, to compile once."""
    _, skies = noisy
    skies = skies.reshape(180, 343).copy()
    skies[77, 4] = np.nan
    suns = jnp.asarray(np.full(180, 0.9))
    values = jnp.asarray(skies)
    measure = weighting.measure(values, "relative", axes=1)
    sky = (*DOME.angles(), suns, values, measure, single_sky.DEFAULT_PRIOR, True)
    fit = single_sky._fit_skies(*single_sky.sky_problem(*sky), single_sky.MAX_STEPS)
    good = np.arange(180) != 77
    for name in ("coefficients", "scale", "standard_error", "rms", "largest"):
        finite = np.isfinite(fit[name]).reshape(180, -1)
        np.testing.assert_array_equal(finite.all(axis=1), good)
        assert not finite[77].any()
    np.testing.assert_array_equal(fit["converged"], good)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_published_matrices_come_back_from_their_own_table(quantity):
    fit = fit_distribution(DOME, SUNS, TURBIDITIES, published(quantity), prior=NO_PRIOR)
    assert fit.converged
    matrix = getattr(PREETHAM_1999, f"{quantity}_distribution")
    np.testing.assert_allclose(fit.matrix, matrix, atol=1e-5)
    np.testing.assert_allclose(
        fit.coefficients(np.array([2.0, 5.0])),
        np.array([[2.0], [5.0]]) * matrix[:, 0] + matrix[:, 1],
        atol=1e-5,
    )


@pytest.mark.parametrize("k", [0, 1, 2])
def test_joint_fits_of_scattered_skies_converge(scattered, k):
    fit = fit_distribution(DOME, SUNS, TURBIDITIES, scattered[k])
    assert fit.converged
    assert np.isfinite(fit.standard_error).all()
    assert fit.rms_per_sky.shape == (5, 12)
    assert float(np.mean(fit.rms_per_sky**2)) == pytest.approx(float(fit.rms) ** 2)
    if k < 2:
        assert float(fit.rms) < 0.03
        assert 5 < float(fit.condition_number) < 1000


@pytest.mark.slow
def test_joint_standard_errors_are_those_of_repeated_noise():
    rng = np.random.default_rng(8)
    table = published("luminance")
    zenith = np.ones((5, 12))
    fits = [
        fit_distribution(
            DOME, SUNS, TURBIDITIES, table * (1 + 0.02 * rng.normal(size=table.shape)),
            zenith_value=zenith,
        )
        for _ in range(24)
    ]  # fmt: skip
    matrices = np.array([fit.matrix for fit in fits])
    assert all(fit.converged for fit in fits)
    claimed = np.mean([fit.standard_error for fit in fits], axis=0)
    ratio = matrices.std(axis=0, ddof=1) / claimed
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.25)  # ten of 15 % each


@pytest.mark.parametrize("weighting", ["absolute", "log"])
def test_weightings(weighting):
    """On a small grid, inside a user's jit, with the scale fixed in one of them."""
    grid = DirectionGrid(np.radians(np.arange(0.0, 90.0, 12.0)), np.radians(np.arange(0, 181, 30)))
    view, azimuth = grid.angles()
    c = np.array([-0.9, -0.4, 4.0, -2.2, 0.3])
    sky = np.asarray(perez(c, view, scattering_angle(view, azimuth, 0.9)))
    free = weighting == "log"

    @eqx.filter_jit
    def run(values):
        return fit_perez(grid, 0.9, values, weighting=weighting, fit_scale=free, prior=NO_PRIOR)

    fit = run(sky * (3.0 if free else 1.0))
    assert fit.converged
    assert fit.weighting == weighting
    np.testing.assert_allclose(fit.coefficients, c, atol=1e-4)
    np.testing.assert_allclose(fit.scale, 3.0 if free else 1.0, rtol=1e-4)
    assert (float(fit.standard_error[5]) > 0) == free
    np.testing.assert_allclose(fit.predict(grid, 0.9), sky * float(fit.scale), rtol=1e-4)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.zeros((0, 343)), {}, r"values must hold data, got shape \(0, 343\)"),
        (np.full(343, np.nan), {}, r"values must be finite, got nan \(343 of 343 values\)"),
        (-np.ones(343), {}, 'values must be positive for weighting "relative", got -1'),
        (np.zeros(343), {"weighting": "log"}, 'positive for weighting "log", got 0'),
        (np.zeros(343), {"weighting": "absolute"}, "must not all be 0"),
        (np.ones(342), {}, r"values must have shape \[\.\.\., 343\], got \(342,\)"),
        (np.ones(343), {"weighting": "squared"}, "weighting must be one of .*got 'squared'"),
    ],
)
def test_bad_values(values, options, message):
    with pytest.raises(ValueError, match=message):
        fit_perez(DOME, 0.5, values, **options)


def test_bad_geometry():
    with pytest.raises(ValueError, match=r"solar_zenith_angle.*got 1\.6"):
        fit_perez(DOME, 1.6, np.ones(343))
    with pytest.raises(ValueError, match=r"broadcast to the skies' shape \(2,\), got \(3,\)"):
        fit_perez(DOME, np.ones(3), np.ones((2, 343)))
    few = Directions(np.linspace(0, 1, 4), np.zeros(4))
    with pytest.raises(ValueError, match="directions must be at least 6, got 4"):
        fit_perez(few, 0.5, np.ones(4))
    low = Directions(np.linspace(0, 1.7, 9), np.zeros(9))
    with pytest.raises(ValueError, match=r"view_zenith_angle.*got 1\.7"):
        fit_perez(low, 0.5, np.ones(9))


def test_weight_zero_leaves_directions_out():
    """The same as a shorter list of directions, in every result; and weights have no unit."""
    view, azimuth = (np.asarray(angle) for angle in DOME.angles())
    kept = view < 1.3
    table = published("luminance") * np.random.default_rng(8).lognormal(sigma=0.05, size=343)
    short = fit_distribution(
        Directions(view[kept], azimuth[kept]), SUNS, TURBIDITIES, table[..., kept]
    )
    spoilt = np.where(kept, table, 1e6)
    weight = np.broadcast_to(3.0 * kept, table.shape)
    fit = fit_distribution(DOME, SUNS, TURBIDITIES, spoilt, weight=weight)
    assert fit.converged
    assert short.converged
    # Two searches end within the square root of their tolerance, 1e-3 standard errors.
    errors = np.asarray(short.standard_error)
    np.testing.assert_allclose(fit.matrix / errors, short.matrix / errors, atol=1e-3)
    for name in ("standard_error", "robust_standard_error", "rms", "largest", "rms_per_sky"):
        np.testing.assert_allclose(getattr(fit, name), getattr(short, name), rtol=1e-3)


@pytest.mark.slow
def test_robust_errors_are_those_of_repeated_skies():
    """Skies that are wrong as a whole: the naive errors are too small, the robust ones hold."""
    rng = np.random.default_rng(9)
    view, azimuth = DOME.angles()
    γ = np.asarray(scattering_angle(view[None, :], azimuth[None, :], SUNS[:, None]))
    clean = published("luminance")
    fits = []
    for _ in range(60):
        tilt, curve = 0.03 * rng.normal(size=(2, 5, 12, 1))
        noise = tilt * np.asarray(view) + curve * np.cos(2 * γ)
        fits.append(fit_distribution(DOME, SUNS, TURBIDITIES, clean * (1 + noise)))
    spread = np.std([fit.matrix for fit in fits], axis=0)
    claimed = np.sqrt(np.mean([fit.robust_standard_error**2 for fit in fits], axis=0))
    naive = np.sqrt(np.mean([fit.standard_error**2 for fit in fits], axis=0))
    # 60 draws know a spread to 9 %; the sandwich of 60 clusters is some 10 % too small. With more
    # than 3 % the fit is not linear in the data, and the sandwich is.
    assert (np.abs(np.log(claimed / spread)) < 0.4).all()
    assert np.median(spread / naive) > 3


def test_bad_weight():
    table = np.ones((5, 12, 343))
    with pytest.raises(ValueError, match=r"weight must be at least 0, got -1"):
        fit_distribution(DOME, SUNS, TURBIDITIES, table, weight=-table)
    with pytest.raises(ValueError, match=r"weight must be at least 0, got nan"):
        fit_distribution(DOME, SUNS, TURBIDITIES, table, weight=np.nan * table)
    with pytest.raises(ValueError, match="weight must not all be 0"):
        fit_distribution(DOME, SUNS, TURBIDITIES, table, weight=0 * table)
    with pytest.raises(
        ValueError, match=r"weight must have the shape.*\(5, 12, 343\), got \(343,\)"
    ):
        fit_distribution(DOME, SUNS, TURBIDITIES, table, weight=np.ones(343))


def test_bad_table():
    table = np.ones((5, 12, 343))
    with pytest.raises(ValueError, match=r"\(5, 12, 343\), got \(12, 5, 343\)"):
        fit_distribution(DOME, SUNS, TURBIDITIES, table.swapaxes(0, 1))
    with pytest.raises(ValueError, match="turbidity must hold two different values"):
        fit_distribution(DOME, SUNS, np.full(5, 2.0), table)
    with pytest.raises(ValueError, match=r"zenith_value must have shape \(5, 12\), got \(5,\)"):
        fit_distribution(DOME, SUNS, TURBIDITIES, table, zenith_value=np.ones(5))
    ring = Directions(jnp.full(9, 0.5), jnp.linspace(0, 3, 9))
    with pytest.raises(ValueError, match=r"directions must hold the zenith.*from 0\.5 rad"):
        fit_distribution(ring, SUNS, TURBIDITIES, np.ones((5, 12, 9)))
