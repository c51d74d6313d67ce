"""What is computed in blocks: rows of a table, each from its own inputs alone."""

import abc
from typing import Any, ClassVar, NamedTuple

import numpy as np


class Variable(NamedTuple):
    """One array of a store; its first axis is the rows of the work.

    Attributes:
        dimensions: Names of the other axes.
        shape: Of the other axes.
        dtype: In NumPy's words.
        unit: As netCDF's attribute `units`.
        long_name: Likewise.
    """

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: str
    unit: str
    long_name: str


# Dimensions, values, attributes.
Coordinate = tuple[tuple[str, ...], np.ndarray, dict[str, str]]


class Work(abc.ABC):
    """Rows that are computed independently of each other.

    Attributes:
        name: Of the work.
        axis: Name of the first axis of every array.
        group: Rows that a device takes at a time.
    """

    name: ClassVar[str]
    axis: ClassVar[str]
    group: ClassVar[int]

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Rows."""

    @property
    @abc.abstractmethod
    def settings(self) -> dict[str, Any]:
        """All that the numbers depend on besides the code; plain values that JSON takes."""

    @property
    @abc.abstractmethod
    def variables(self) -> dict[str, Variable]:
        """The arrays that are computed."""

    @property
    @abc.abstractmethod
    def coordinates(self) -> dict[str, Coordinate]:
        """Arrays that are known beforehand."""

    @abc.abstractmethod
    def inputs(self, first: int, last: int) -> Any:
        """Inputs of rows first to last - 1, a tree of arrays with these rows."""

    @abc.abstractmethod
    def compute(self, inputs: Any) -> Any:
        """From the inputs of `group` rows to the variables by name; pure, under jit."""
