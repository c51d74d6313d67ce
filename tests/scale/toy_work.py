"""A work that costs nothing: numbers from numbers."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from atmofit.scale.works import Coordinate, Variable, Work


@dataclasses.dataclass(frozen=True)
class ToyWork(Work):
    """Two arrays of each number; the last block is not full, nor is the last group."""

    shift: float = 0.0

    name = "toy"
    axis = "row"
    group = 2

    @property
    def count(self) -> int:
        return 11

    @property
    def settings(self) -> dict[str, Any]:
        return {"shift": self.shift}

    @property
    def variables(self) -> dict[str, Variable]:
        return {
            "waves": Variable(("wave",), (3,), "float64", "1", "three sines"),
            "above": Variable((), (), "bool", "1", "whether the first is positive"),
        }

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        return {"place": (("row",), self.inputs(0, self.count), {"units": "rad"})}

    def inputs(self, first: int, last: int) -> np.ndarray:
        return np.linspace(0.0, 6.0, self.count)[first:last] + self.shift

    def compute(self, inputs):
        assert inputs.shape == (self.group,)
        waves = jnp.sin(inputs[:, None] * jnp.arange(1.0, 4.0)[None, :])
        return {"waves": waves, "above": waves[:, 0] > 0}

    def expected(self) -> np.ndarray:
        return np.sin(self.inputs(0, self.count)[:, None] * np.arange(1.0, 4.0))
