"""A sky model held against simulated skies."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.fit.skies import QUANTITIES, SimulatedSkies
from atmofit.geometry import Directions
from atmofit.models.preetham import PreethamModel


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A model against simulated skies; every array is [turbidity, sun].

    NaN where the model is not valid, and where every direction of a sky was left out.

    Attributes:
        name: Of the model.
        luminance_ratio: Mean over the dome of model / simulation.
        luminance_rms: Root mean square of model / simulation - 1.
        luminance_log_rms: Root mean square of log(model / simulation); NaN where the model is not
            positive. It counts twice and half alike.
        luminance_pattern_rms: Root mean square of model / simulation - 1 with the sky's mean
            ratio divided out first: the ratio's standard deviation over its mean.
        zenith_luminance_ratio: Model / simulation at the zenith.
        x_ratio, y_ratio: Mean over the dome of model / simulation.
        x_mean, y_mean: Mean of model - simulation.
        x_rms, y_rms: Its root mean square.
        zenith_x_ratio, zenith_y_ratio: Model / simulation at the zenith.
        zenith_x_difference, zenith_y_difference: Model - simulation at the zenith.
    """

    name: str
    luminance_ratio: np.ndarray
    luminance_rms: np.ndarray
    luminance_log_rms: np.ndarray
    luminance_pattern_rms: np.ndarray
    zenith_luminance_ratio: np.ndarray
    x_ratio: np.ndarray
    x_mean: np.ndarray
    x_rms: np.ndarray
    y_ratio: np.ndarray
    y_mean: np.ndarray
    y_rms: np.ndarray
    zenith_x_ratio: np.ndarray
    zenith_x_difference: np.ndarray
    zenith_y_ratio: np.ndarray
    zenith_y_difference: np.ndarray

    def summary(self) -> dict[str, float]:
        """Every array over its valid cells: the rms of what ends so, the mean of the others."""
        out = {}
        for field in dataclasses.fields(self)[1:]:
            values = getattr(self, field.name)
            out[field.name] = over(values, rms=field.name.endswith("rms"))
        return out

    def tables(self) -> dict[str, list[list[float | None]]]:
        """Every array as lists, turbidity by turbidity; None where it is not a number."""
        return {
            field.name: [
                [float(value) if np.isfinite(value) else None for value in row]
                for row in getattr(self, field.name)
            ]
            for field in dataclasses.fields(self)[1:]
        }


def over(values: np.ndarray, *, rms: bool) -> float:
    """Mean or root mean square of the finite values; NaN if there are none."""
    valid = values[np.isfinite(values)]
    if not valid.size:
        return math.nan
    return float(np.sqrt((valid**2).mean()) if rms else valid.mean())


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


def compare(
    model: PreethamModel,
    skies: SimulatedSkies,
    name: str,
    weight: np.ndarray | None = None,
) -> Comparison:
    """Hold a model against simulated skies.

    Args:
        model: Any of this form.
        skies: What it is held against.
        name: Of the model.
        weight: Of each direction in the means over the dome, at least 0, [turbidity, sun,
            direction]; a sky whose weights are all 0 is left out, its zenith too. None: equal.

    Raises:
        ValueError: The weight has another shape, or is negative or not finite.
    """
    shape = skies.xyY.shape[:-1]
    given = np.ones(shape) if weight is None else np.asarray(weight, float)
    if given.shape != shape or not np.all(np.isfinite(given) & (given >= 0)):
        raise ValueError(
            f"weight must be finite, at least 0 and of the shape {shape}, got shape {given.shape} "
            f"from {given.min():.6g} to {given.max():.6g}"
        )
    total = given.sum(-1, keepdims=True)
    used = total > 0
    share = np.where(used, given / np.where(used, total, 1.0), np.nan)

    def mean(values: np.ndarray) -> np.ndarray:
        return (values * share).sum(-1)

    def rms(values: np.ndarray) -> np.ndarray:
        return np.sqrt(mean(values**2))

    predicted = predict(model, skies)
    at_zenith = np.where(used, predicted[:, :, 0], np.nan)
    fields: dict[str, np.ndarray] = {}
    for index, quantity in enumerate(QUANTITIES):
        simulated, zenith = skies.xyY[..., index], skies.zenith[..., index]
        ratio = predicted[..., index] / simulated
        label = "luminance" if quantity == "Y" else quantity
        fields[f"{label}_ratio"] = mean(ratio)
        fields[f"zenith_{label}_ratio"] = at_zenith[..., index] / zenith
        if quantity == "Y":
            average = mean(ratio)[..., None]
            fields["luminance_rms"] = rms(ratio - 1)
            fields["luminance_log_rms"] = rms(np.log(np.where(ratio > 0, ratio, np.nan)))
            fields["luminance_pattern_rms"] = rms(ratio / average - 1)
        else:
            difference = predicted[..., index] - simulated
            fields |= {f"{label}_mean": mean(difference), f"{label}_rms": rms(difference)}
            fields[f"zenith_{label}_difference"] = at_zenith[..., index] - zenith
    return Comparison(name, **fields)
