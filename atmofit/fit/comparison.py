"""A sky model held against simulated skies."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.fit.skies import SimulatedSkies
from atmofit.geometry import Directions
from atmofit.models.preetham import PreethamModel


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A model against simulated skies; every array is [turbidity, sun].

    NaN where the model is not valid.

    Attributes:
        name: Of the model.
        luminance_ratio: Mean over the dome of model / simulation.
        luminance_rms: Root mean square of model / simulation - 1.
        zenith_luminance_ratio: Model / simulation at the zenith.
        x_mean, x_rms: Mean and root mean square of model - simulation.
        y_mean, y_rms: Likewise.
    """

    name: str
    luminance_ratio: np.ndarray
    luminance_rms: np.ndarray
    zenith_luminance_ratio: np.ndarray
    x_mean: np.ndarray
    x_rms: np.ndarray
    y_mean: np.ndarray
    y_rms: np.ndarray

    def summary(self) -> dict[str, float]:
        """Every array over its valid cells: the ratios' means, the rms of the others."""
        out = {}
        for field in dataclasses.fields(self)[1:]:
            values = getattr(self, field.name)
            valid = values[np.isfinite(values)]
            mean = valid.mean() if valid.size else math.nan
            rms = np.sqrt((valid**2).mean()) if valid.size else math.nan
            out[field.name] = float(rms if field.name.endswith("rms") else mean)
        return out


def predict(model: PreethamModel, skies: SimulatedSkies) -> np.ndarray:
    """What a model says of the simulated skies, x, y and Y; NaN outside its turbidities.

    Returns:
        [turbidity, sun, direction, 3], Y in cd m^-2.
    """
    with jax.enable_x64(True):
        return _predicted(model, skies)


def _predicted(model: PreethamModel, skies: SimulatedSkies) -> np.ndarray:
    turbidity, suns = (
        jnp.asarray(axis, float)
        for axis in (skies.settings.turbidity, skies.settings.solar_zenith_angle)
    )
    return np.asarray(_predict(model, turbidity, suns, skies.directions))


@eqx.filter_jit
def _predict(
    model: PreethamModel, turbidity: jax.Array, suns: jax.Array, directions: Directions
) -> jax.Array:
    over_suns = jax.vmap(lambda T, sun: model(T, sun, directions), (None, 0))
    return jax.vmap(over_suns, (0, None))(turbidity, suns)


def compare(model: PreethamModel, skies: SimulatedSkies, name: str) -> Comparison:
    """Hold a model against simulated skies."""
    difference = predict(model, skies)
    ratio = difference[..., 2] / skies.quantity("Y")
    x, y = (difference[..., k] - skies.xyY[..., k] for k in range(2))

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt((values**2).mean(-1))

    return Comparison(
        name, ratio.mean(-1), rms(ratio - 1), ratio[..., 0], x.mean(-1), rms(x), y.mean(-1), rms(y)
    )
