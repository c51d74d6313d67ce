"""How the experiment `what_moves_it` carries its Monte Carlo samples over the dome."""

import numpy as np
import pytest

pytestmark = pytest.mark.reference


def test_a_smooth_ratio_comes_back_and_is_never_below_one():
    from what_moves_it_third_order import Sampling, _features, smooth

    rng = np.random.default_rng(5)
    s, count = Sampling(), 300
    samples = np.stack(
        [
            rng.uniform(min(s.turbidity), max(s.turbidity), count),
            np.radians(rng.uniform(0, 87, count)),
            np.radians(rng.uniform(0, 89, count)),
            np.radians(rng.uniform(0, 180, count)),
            rng.choice(s.wavelength_nm, count),
        ],
        axis=-1,
    )
    design = _features(samples, 2)
    truth = np.exp(-2 + design @ rng.normal(0, 0.2, design.shape[1]))
    noise = 1e-3 * rng.standard_normal(count)
    columns = (np.log1p(truth) + noise, np.full(count, 1e-3))
    found = smooth(np.concatenate([samples, np.stack(columns, axis=-1)], axis=1))
    ratio = found.ratio(*samples.T)
    # 21 numbers from 300 samples: the fit's error is about a quarter of the noise of one.
    error = np.abs(np.log(ratio) - np.log1p(truth))
    assert np.sqrt(np.mean(error**2)) < 1e-3
    assert ratio.min() >= 1
    assert found.error < 2e-3
    assert found.noise == pytest.approx(1e-3)
