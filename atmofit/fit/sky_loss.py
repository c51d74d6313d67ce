"""How far a sky is from an observation: residuals without what exposure and model error explain.

The logarithm of model over measurement is noise, plus the unknown logarithm of the exposure, plus
the model error's patterns with their normal amplitudes. Exposure and amplitudes are linear, so they
are eliminated once and for all by an orthogonal projection: the sum of squares that remains is the
one that they would leave at their best, and, being normal, as functions of the unknowns it is their
marginal likelihood too.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from atmofit.fit.candidates import Sky
from atmofit.fit.model_error import (
    FEATURES,
    ModelError,
    amplitudes_design,
    exposure_design,
    features,
)
from atmofit.fit.unknowns import Search
from atmofit.fit.weighting import safe_log
from atmofit.geometry import DirectionGrid, Directions
from atmofit.observe.observation import Observation
from atmofit.typing import Reals, Scalar

_FREEDOM = 4.0  # degrees of freedom of Student's t, for robust weights
_LEAST_WIDTH = 1e-6  # of a model error's amplitude


class SkyLoss(eqx.Module):
    """Residuals of one observation as functions of the unknowns.

    Attributes:
        observation: Checked.
        search: The unknowns.
        log_values: Of the measurement, 0 where masked, [value].
        precision: One over the noise, with the model error's roughness; 0 where masked, [value].
        design: What one of each linear unknown (exposures, then amplitudes in units of their
            width) adds to ln(model / measured), [value, linear].
        expected: Means of these unknowns in the model error's features, [feature, linear].
        informed: 1 for those that have a prior, 0 for exposures, [linear].
    """

    observation: Observation
    search: Search
    log_values: Float[Array, " value"]
    precision: Float[Array, " value"]
    design: Float[Array, "value linear"]
    expected: Float[Array, "feature linear"]
    informed: Float[Array, " linear"]

    def log_ratio(self, sky: Sky, x: Float[Array, " p"]) -> Float[Array, " value"]:
        """Logarithm of model over measured, of every value."""
        values = self.search.all_values(x)
        shifted = _turned(self.observation.directions, values["solar_azimuth"])
        model = sky(values, shifted).astype(x.dtype).ravel()
        used = self.precision > 0
        return jnp.where(used, safe_log(jnp.where(used, model, 1.0)) - self.log_values, 0.0)

    def projection(self, share: Float[Array, " value"]) -> tuple[Reals, Reals]:
        """Orthonormal columns of the linear unknowns, and the triangle behind them.

        Args:
            share: Of each value's precision that counts.
        """
        rows = jnp.concatenate(
            [(self.precision * share)[:, None] * self.design, jnp.diag(self.informed)]
        )
        return jnp.linalg.qr(rows)

    def residuals(
        self, sky: Sky, share: Float[Array, " value"]
    ) -> Callable[[Float[Array, " p"]], Reals]:
        """The function from x in [-1, 1] to residuals in units of their standard deviations."""
        columns = self.projection(share)[0] if self.design.shape[1] else None

        def of(x: Float[Array, " p"]) -> Reals:
            rows = self.precision * share * self.log_ratio(sky, x)
            if columns is not None:
                rows = jnp.concatenate([rows, self._expected_at(x)])
                rows = rows - columns @ (rows @ columns)
            return jnp.concatenate([rows, self.search.prior_residuals(x)])

        return of

    def _expected_at(self, x: Float[Array, " p"]) -> Float[Array, " linear"]:
        """Means of the linear unknowns that have a prior, 0 of the others."""
        values = self.search.all_values(x)
        at = features(values["turbidity"], values["solar_zenith_angle"])
        return self.informed * (at @ self.expected)

    def linear(
        self,
        x: Float[Array, " p"],
        log_ratio: Float[Array, " value"],
        share: Float[Array, " value"],
    ) -> Reals:
        """The best exposures and amplitudes at x, whose log_ratio is given."""
        columns, triangle = self.projection(share)
        rows = jnp.concatenate([self.precision * share * log_ratio, self._expected_at(x)])
        return jax.scipy.linalg.solve_triangular(triangle, rows @ columns)

    def robust_share(
        self,
        x: Float[Array, " p"],
        log_ratio: Float[Array, " value"],
        share: Float[Array, " value"],
    ) -> tuple[Float[Array, " value"], Scalar]:
        """How much each direction's precision counts after a look at its residuals.

        The weights are those of Student's t with four degrees of freedom, in units of the median
        residual where that exceeds the noise; and the loss that goes with them.
        """
        left = log_ratio
        if self.design.shape[1]:
            left = left - self.design @ self.linear(x, log_ratio, share)
        shape = (-1, self.observation.by_channel.shape[-1])
        square = jnp.mean((left * self.precision).reshape(shape) ** 2, axis=1)
        used = self.observation.used.ravel()
        scale = jnp.maximum(1.0, jnp.nanmedian(jnp.where(used, square, jnp.nan)))
        weight = (_FREEDOM + 1) / (_FREEDOM + square / scale)
        loss = jnp.sum(jnp.where(used, (_FREEDOM + 1) * jnp.log1p(square / scale / _FREEDOM), 0.0))
        count = jnp.sum(used).astype(scale.dtype)
        return jnp.repeat(jnp.sqrt(weight), shape[1]), loss + jnp.log(scale) * count

    @property
    def weight(self) -> Scalar:
        """Size of the residuals if a model is off by its own size."""
        return jnp.sqrt(jnp.sum(self.precision**2))

    @property
    def freedom(self) -> Scalar:
        """Values that are used, less the unknowns that nothing but the values decides."""
        uninformed = jnp.sum(self.informed == 0) + jnp.sum(~jnp.isfinite(self.search.prior_width))
        count = jnp.maximum(jnp.sum(self.precision > 0) - uninformed, 1)
        return count.astype(self.precision.dtype)


def sky_loss(observation: Observation, search: Search, error: ModelError | None) -> SkyLoss:
    """Put together what does not depend on the unknowns."""
    dtype = search.low.dtype
    used = jnp.broadcast_to(observation.used[..., None], observation.by_channel.shape).ravel()
    values = observation.by_channel.astype(dtype).ravel()
    log_values = jnp.log(jnp.where(used, values, 1.0))
    noise = observation.noise().astype(dtype).ravel()
    parts = [_linear(jnp.zeros((used.size, 0), dtype), prior=False)]
    exposure = exposure_design(observation)
    if exposure is not None:
        parts.append(_linear(exposure.reshape(used.size, -1).astype(dtype), prior=False))
    if error is not None:
        noise = jnp.hypot(noise, error.rough.astype(dtype))
        design = amplitudes_design(observation).reshape(used.size, -1).astype(dtype)
        least = _LEAST_WIDTH**2 * jnp.eye(design.shape[1], dtype=dtype)
        root = jnp.linalg.cholesky(error.covariance.astype(dtype) + least)
        mean = jax.scipy.linalg.solve_triangular(root, error.mean.astype(dtype).T, lower=True).T
        parts.append(_linear(design @ root, prior=True, mean=mean))
        if observation.wavelength_nm is not None:
            count = len(observation.wavelength_nm)
            own = jnp.asarray(np.tile(np.eye(count), (used.size // count, 1)), dtype)
            width = jnp.maximum(error.channel.astype(dtype), _LEAST_WIDTH)
            parts.append(_linear(own * width, prior=True))
    design, expected, informed = (
        jnp.concatenate(some, axis=-1) for some in zip(*parts, strict=True)
    )
    return SkyLoss(
        observation=observation,
        search=search,
        log_values=log_values,
        precision=jnp.where(used, 1 / noise, 0.0),
        design=design,
        expected=expected,
        informed=informed,
    )


def _linear(design: Reals, *, prior: bool, mean: Reals | None = None) -> tuple[Reals, Reals, Reals]:
    """Columns of linear unknowns, their means in units of their widths, and whether there are."""
    count, dtype = design.shape[1], design.dtype
    expected = jnp.zeros((FEATURES, count), dtype) if mean is None else mean
    return design, expected, jnp.full(count, float(prior), dtype)


def _turned(directions: Directions | DirectionGrid, azimuth: Scalar) -> Directions | DirectionGrid:
    """The directions as seen from a sun that stands elsewhere."""
    turned = directions.relative_azimuth - azimuth.astype(directions.relative_azimuth.dtype)
    return eqx.tree_at(lambda d: d.relative_azimuth, directions, turned)
