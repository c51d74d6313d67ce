"""Fits of the Perez formula to the skies of a store."""

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array

from atmofit.fit.single_sky import PerezFit, fit_perez
from atmofit.geometry import HORIZON, Directions
from atmofit.scale.store import BlockStore
from atmofit.scale.works import Coordinate, Variable, Work
from atmofit.typing import Reals

_QUANTITIES = ("coefficients", "scale", "standard_error", "condition_number", "rms", "largest")


@dataclass(frozen=True)
class FitWork(Work):
    """Fits of `fit_perez` to luminances; a row is one air under all suns above the horizon.

    Attributes:
        skies: Folder of the finished store of a `SkyWork`.

    Raises:
        ValueError: When used: there is no such store, or it is not finished.
    """

    skies: str | Path

    name = "fits"
    axis = "air"
    group = 1  # air; all suns of it are fitted together

    @functools.cached_property
    def source(self) -> BlockStore:
        """The skies."""
        store = BlockStore.open(self.skies)
        if store.manifest["work"] != "dataset" or "sha256" not in store.manifest:
            raise ValueError(
                f"skies must be a finished store of skies, got {str(self.skies)!r} "
                f"with {store.manifest['work']}"
            )
        return store

    @functools.cached_property
    def known(self) -> dict[str, Coordinate]:
        """Coordinates of the skies."""
        with self.source.dataset() as data:
            return {
                str(name): (tuple(map(str, v.dims)), v.values, dict(v.attrs))
                for name, v in data.coords.items()
            }

    @property
    def suns(self) -> np.ndarray:
        """Which suns are above the horizon."""
        return np.flatnonzero(self.known["solar_zenith_angle"][1] <= HORIZON)

    @property
    def count(self) -> int:
        """Rows."""
        return self.source.manifest["rows"]

    @property
    def settings(self) -> dict[str, Any]:
        """The skies, by their checksums."""
        return {"skies": self.source.key, "sha256": self.source.manifest["sha256"]}

    @property
    def variables(self) -> dict[str, Variable]:
        """Of `PerezFit`."""
        per_sky = (self.suns.size,)
        six = Variable(("sun", "parameter"), (*per_sky, 6), "float64", "1", "A, B, C, D, E, scale")
        one = Variable(("sun",), per_sky, "float64", "1", "")
        return {
            "coefficients": Variable(
                ("sun", "coefficient"), (*per_sky, 5), "float64", "1", "A, B, C, D, E"
            ),
            "scale": one._replace(unit="cd m-2", long_name="factor on the formula"),
            "standard_error": six,
            "condition_number": one._replace(long_name="of the Jacobian, columns of unit length"),
            "rms": one._replace(long_name="root mean square relative residual"),
            "largest": one._replace(long_name="largest relative residual"),
            "converged": one._replace(dtype="bool", long_name="whether the search ended well"),
        }

    @property
    def coordinates(self) -> dict[str, Coordinate]:
        """Of air and sun."""
        axes, suns, attributes = self.known["solar_zenith_angle"]
        return {
            "turbidity": self.known["turbidity"],
            "albedo": self.known["albedo"],
            "solar_zenith_angle": (axes, suns[self.suns], attributes),
        }

    def inputs(self, first: int, last: int) -> np.ndarray:
        """Luminances of some rows, [air, sun, direction]."""
        with self.source.dataset() as data:
            return data["xyY"].isel(air=slice(first, last)).values[..., 2][:, self.suns]

    def compute(self, inputs: Reals) -> dict[str, Array]:
        """The fits of a row."""
        view, azimuth = self.known["view_zenith_angle"][1], self.known["relative_azimuth"][1]
        sun = self.coordinates["solar_zenith_angle"][1]
        fit: PerezFit = fit_perez(Directions(view, azimuth), sun, inputs[0])
        return {name: getattr(fit, name)[None] for name in (*_QUANTITIES, "converged")}
