"""What models of the sky miss: a few smooth patterns over the dome, and their usual size.

A good scan is less noisy than any model is right. The logarithm of model over sky is therefore
taken as noise and a sum of patterns: a level, gradients toward the horizon and around the sun, each
alike at all wavelengths and growing with the logarithm of the wavelength. How large their
amplitudes are, and which go together, was measured by simulation (experiments/model_errors.py).
"""

import functools
import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from atmofit.checks import in_range
from atmofit.geometry import DirectionGrid, Directions, scattering_angle
from atmofit.observe.channels import effective_wavelengths
from atmofit.observe.observation import Observation
from atmofit.typing import Reals, Scalar, real_array, scalar

PATTERNS = (
    "level", "gradient", "horizon", "sun", "sun squared", "aureole", "near sun", "sun x gradient"
)  # fmt: skip
FEATURES = 5
_REFERENCE_NM = 550.0


class ModelError(eqx.Module):
    """The amplitudes of the patterns as a normal distribution, and what the patterns leave.

    Attributes:
        mean: Of each amplitude of ln(model / sky), in the features of turbidity and sun that
            `features` gives; the patterns alike at all wavelengths first, then those that grow
            with its logarithm.
        covariance: Of the amplitudes around their means.
        rough: Standard deviation of what remains in each value.
        channel: Of a level of each wavelength's own, such as the error of the sun's spectrum or of
            a spectrometer's calibration; counts for spectral observations only.
    """

    mean: Float[Array, "feature amplitude"] = eqx.field(converter=real_array)
    covariance: Float[Array, "amplitude amplitude"] = eqx.field(converter=real_array)
    rough: Scalar = eqx.field(converter=scalar)
    channel: Scalar = eqx.field(converter=scalar, default=0.0)

    def __check_init__(self) -> None:
        """Check that the sizes belong together."""
        size = 2 * len(PATTERNS)
        if self.mean.shape != (FEATURES, size) or self.covariance.shape != (size, size):
            raise ValueError(
                f"mean and covariance must have shapes ({FEATURES}, {size}) and ({size}, {size}), "
                f"got {self.mean.shape} and {self.covariance.shape}"
            )

    @classmethod
    def of_size(
        cls, level: float, pattern: float, rough: float = 0.0, channel: float = 0.0
    ) -> "ModelError":
        """Independent amplitudes around 0.

        Args:
            level: Standard deviation of the level [-], above 0 to 10.
            pattern: Of every other pattern, and of the level's change when the wavelength is e
                times as long.
            rough: Of what remains.
            channel: Of each wavelength's own level.

        Raises:
            ValueError: A size lies outside its range.
        """
        for name, size in (("level", level), ("pattern", pattern)):
            in_range(name, size, 1e-6, 10.0)
        in_range("rough", rough, 0.0, 10.0)
        in_range("channel", channel, 0.0, 10.0)
        widths = np.full(2 * len(PATTERNS), float(pattern))
        widths[0] = level
        return cls(np.zeros((FEATURES, widths.size)), np.diag(widths**2), rough, channel)


def features(turbidity: Scalar, solar_zenith_angle: Scalar) -> Float[Array, " feature"]:
    """What the mean amplitudes are linear in: products of powers of ln T and the sun's cosine."""
    log, cosine = jnp.log(turbidity), jnp.cos(solar_zenith_angle)
    return jnp.stack([jnp.ones_like(log), log, log**2, cosine, log * cosine])


def patterns(directions: Directions | DirectionGrid, solar_zenith_angle: Scalar) -> Reals:
    """The patterns in some directions, [direction axes, pattern]."""
    view, azimuth = directions.angles()
    γ = scattering_angle(view, azimuth, solar_zenith_angle.astype(view.dtype))
    μ, cosine = jnp.cos(view), jnp.cos(γ)
    return jnp.stack(
        [
            jnp.ones_like(μ),
            1 - 2 * μ,
            jnp.exp(-μ / 0.15),
            cosine,
            1.5 * cosine**2 - 0.5,
            jnp.exp(-γ / 0.1),
            jnp.exp(-γ / 0.4),
            cosine * (1 - 2 * μ),
        ],
        axis=-1,
    )


def channel_positions(observation: Observation) -> NDArray[np.float64]:
    """Logarithm of each channel's wavelength over 550 nm; 0 for luminance."""
    if observation.wavelength_nm is not None:
        λ = np.asarray(observation.wavelength_nm)
    elif observation.channels == "luminance":
        return np.zeros(1)
    else:
        λ = effective_wavelengths(observation.channels)
    return np.log(λ / _REFERENCE_NM)


def amplitudes_design(observation: Observation) -> Reals:
    """What one of each amplitude adds to ln(model / sky), [direction axes, channel, amplitude]."""
    over_dome = patterns(observation.directions, observation.solar_zenith_angle)
    position = jnp.asarray(channel_positions(observation), over_dome.dtype)
    by_channel = jnp.stack([jnp.ones_like(position), position], axis=-1)
    both = over_dome[..., None, None, :] * by_channel.reshape(
        (1,) * (over_dome.ndim - 1) + (*by_channel.shape, 1)
    )
    return both.reshape(*both.shape[:-2], -1)


def exposure_design(observation: Observation) -> Reals | None:
    """Columns of unknown exposures, [direction axes, channel, exposure]; None: all are known."""
    if observation.exposure == "known":
        return None
    count = observation.by_channel.shape[-1]
    own = jnp.eye(count, dtype=observation.values.dtype)
    columns = jnp.ones((count, 1), own.dtype) if observation.exposure == "unknown" else own
    shape = (*observation.directions.shape, *columns.shape)
    return jnp.broadcast_to(columns.reshape((1,) * (len(shape) - 2) + columns.shape), shape)


def stored_model_error(name: str) -> ModelError:
    """The measured error of a model.

    Args:
        name: "preetham", "simulator" (two orders, the paper's air), "simulator all" (all orders,
            the paper's air), "continental all" (`continental_air`, all orders) or "atmofit_2026".

    Raises:
        ValueError: No such model was measured.
    """
    known = _stored()
    if name not in known:
        words = ", ".join(f'"{word}"' for word in known)
        raise ValueError(f"model_error must be one of {words} or a ModelError, got {name!r}")
    found = known[name]
    return ModelError(*(np.asarray(found[key]) for key in ("mean", "covariance", "rough")))


@functools.cache
def _stored() -> dict[str, Any]:
    path = Path(__file__).with_name("model_errors.json")
    return json.loads(path.read_text(encoding="utf-8"))["models"]
