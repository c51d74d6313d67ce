"""Turbidities of a series of measured skies."""

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from atmofit.fit.candidates import Model, name_of
from atmofit.fit.turbidity import TurbidityEstimate, estimate_turbidity
from atmofit.geometry import Directions
from atmofit.models.preetham import PreethamModel
from atmofit.models.sky_model import SkyModel
from atmofit.observe.observation import Observation
from atmofit.scale.works import Coordinate, Variable, Work

_GROUP = 8  # estimates that run as one program
_UNITS = {"solar_zenith_angle": "rad", "solar_azimuth": "rad"}
_SAID = {
    "reduced_chi_square": "near 1 if the model holds the sky to within the noise",
    "rms": "root mean square of ln(model / measured)",
}
_FLAGS = {"converged": "whether the search ended at a minimum", "at_edge": "of the range"}
Rows = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class SeriesWork(Work):
    """Estimates of `estimate_turbidity`, one for each observation of a series.

    Attributes:
        observations: At least one, all of the same channels and exposure; their directions may
            differ, in number too.
        model: As in `turbidity_problem`.
        free: Likewise.
        known: Likewise, of numbers.
        model_error: A name of `stored_model_error`, or None.
        robust: As in `estimate_turbidity`.

    Raises:
        ValueError: Observations that are impossible, or do not belong together.
    """

    observations: Sequence[Observation]
    model: Model = "preetham"
    free: tuple[str, ...] = ("turbidity",)
    known: dict[str, float] = dataclasses.field(default_factory=dict)
    model_error: str | None = None
    robust: bool = False

    name = "series"
    axis = "sky"
    group = _GROUP

    def __post_init__(self) -> None:
        """Refuse what cannot be estimated before any work is done."""
        if not self.observations:
            raise ValueError("observations must be at least one, got none")
        kinds = {(o.wavelength_nm, o.channels, o.exposure) for o in self.observations}
        if len(kinds) > 1:
            raise ValueError(
                f"observations must be of one kind of channels and exposure, got {len(kinds)}"
            )
        for observation in self.observations:
            observation.checked()

    @property
    def count(self) -> int:
        """Observations."""
        return len(self.observations)

    @property
    def settings(self) -> dict[str, Any]:
        """All that the numbers depend on; arrays by their hashes."""
        return {
            "observations": _hash(*self.inputs(0, self.count).values()),
            "kind": repr((self._first.wavelength_nm, self._first.channels, self._first.exposure)),
            "model": self._model_words(),
            "free": list(self.free),
            "known": self.known,
            "model_error": self.model_error,
            "robust": self.robust,
        }

    @property
    def variables(self) -> dict[str, Variable]:
        """Of `TurbidityEstimate`."""
        found = {}
        for name in self.free:
            unit = _UNITS.get(name, "1")
            found[name] = Variable((), (), "float64", unit, f"{name}, estimated")
            found[f"{name}_standard_error"] = Variable((), (), "float64", unit, f"of {name}")
        found |= {name: Variable((), (), "float64", "1", said) for name, said in _SAID.items()}
        return found | {name: Variable((), (), "bool", "1", said) for name, said in _FLAGS.items()}

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """The place of each observation in the series."""
        return {"sky": (("sky",), np.arange(self.count), {"long_name": "place in the series"})}

    def inputs(self, first: int, last: int) -> Rows:
        """Some observations, filled up with masked directions to a common number."""
        most = max(int(np.prod(o.directions.shape)) for o in self.observations)
        rows = [_filled_up(o, most) for o in self.observations[first:last]]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def compute(self, inputs: dict[str, Array]) -> dict[str, Array]:
        """The estimates of a group."""
        return jax.vmap(self._one)(inputs)

    def _one(self, row: dict[str, Array]) -> dict[str, Array]:
        observation = Observation(
            Directions(row["view_zenith_angle"], row["relative_azimuth"]),
            row["values"],
            row["solar_zenith_angle"],
            row["relative_noise"],
            self._first.wavelength_nm,
            self._first.channels,
            row["noise_floor"],
            row["mask"],
            self._first.exposure,
        )
        best: TurbidityEstimate = estimate_turbidity(
            observation,
            self.model,
            robust=self.robust,
            free=self.free,
            known=self.known,
            model_error=self.model_error,
        )
        found: dict[str, Array] = {}
        errors = best.standard_errors
        for place, name in enumerate(best.names):
            found[name] = best.parameters[place]
            found[f"{name}_standard_error"] = errors[place]
        return found | {name: getattr(best, name) for name in (*_SAID, *_FLAGS)}

    @property
    def _first(self) -> Observation:
        return self.observations[0]

    def _model_words(self) -> Any:
        if isinstance(self.model, (PreethamModel, SkyModel)):
            return [name_of(self.model), _hash(*jax.tree.leaves(self.model))]
        return [name_of(self.model), repr(self.model)]


def _hash(*arrays: Any) -> str:
    """SHA-256 of arrays, their shapes included."""
    digest = hashlib.sha256()
    for array in (np.ascontiguousarray(array) for array in arrays):
        digest.update(f"{array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


def _filled_up(observation: Observation, most: int) -> Rows:
    """One observation as arrays of `most` directions; those beyond its own are masked."""
    view, azimuth = (np.asarray(angle, float).ravel() for angle in observation.directions.angles())
    count = view.size
    values = np.asarray(observation.values, float)
    shape = (count, *values.shape[len(observation.directions.shape) :])

    def fill(array: np.ndarray, value: float) -> np.ndarray:
        beyond = [(0, most - count)] + [(0, 0)] * (array.ndim - 1)
        return np.pad(array, beyond, constant_values=value)

    def as_values(array: Any) -> np.ndarray:
        return np.broadcast_to(np.asarray(array, float), values.shape).reshape(shape)

    used = np.asarray(observation.used).ravel()
    seen = used.reshape((count,) + (1,) * (len(shape) - 1))
    return {
        "view_zenith_angle": fill(view, 0.0),
        "relative_azimuth": fill(azimuth, 0.0),
        # What is masked may be anything, and must not reach a logarithm.
        "values": fill(np.where(seen, values.reshape(shape), 1.0), 1.0),
        "solar_zenith_angle": np.asarray(observation.solar_zenith_angle, float),
        "relative_noise": fill(np.where(seen, as_values(observation.relative_noise), 1.0), 1.0),
        "noise_floor": fill(as_values(observation.noise_floor), 0.0),
        "mask": fill(used, 0.0),
    }
