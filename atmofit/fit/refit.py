"""The paper's work done again: simulate many skies, fit the sky model to them, compare."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import numpy as np

from atmofit.fit.comparison import Comparison, compare, predict
from atmofit.fit.dataset import to_dataset
from atmofit.fit.distribution import DistributionFit, fit_distribution
from atmofit.fit.single_sky import PerezFit, fit_perez
from atmofit.fit.skies import (
    QUANTITIES,
    Clock,
    Progress,
    RefitSettings,
    SimulatedSkies,
    simulate_skies,
)
from atmofit.fit.zenith import ZenithFit, fit_zenith_chromaticity, fit_zenith_luminance
from atmofit.models.preetham import PREETHAM_1999, PreethamModel

if TYPE_CHECKING:
    import xarray

_Fit = TypeVar("_Fit")


@dataclasses.dataclass(frozen=True)
class RefitResult:
    """A sky model fitted to simulated skies.

    Attributes:
        model: The regenerated model, valid inside the turbidities of the settings.
        skies: What it was fitted to.
        distributions: Joint fits of "x", "y" and "Y".
        zeniths: Fits of the zenith values of "x", "y" and "Y".
        single_skies: Perez fits to each sky alone, [turbidity, sun].
        comparisons: Of the published and of the regenerated model.
        seconds: Of each stage.
    """

    model: PreethamModel
    skies: SimulatedSkies
    distributions: Mapping[str, DistributionFit]
    zeniths: Mapping[str, ZenithFit]
    single_skies: Mapping[str, PerezFit]
    comparisons: tuple[Comparison, ...]
    seconds: dict[str, float]

    @property
    def residuals(self) -> np.ndarray:
        """Model minus simulation, x, y and Y [cd m^-2], [turbidity, sun, direction, 3]."""
        return predict(self.model, self.skies) - self.skies.xyY

    @property
    def covariance(self) -> dict[str, np.ndarray]:
        """Covariance of each joint fit's ten coefficients, row by row."""
        return {q: np.asarray(fit.covariance) for q, fit in self.distributions.items()}

    @property
    def converged(self) -> bool:
        """Whether every fit did."""
        fits = [*self.distributions.values(), *self.single_skies.values()]
        return all(bool(np.all(np.asarray(fit.converged))) for fit in fits)

    @property
    def dataset(self) -> "xarray.Dataset":
        """Simulated skies, residuals and units as an xarray dataset."""
        return to_dataset(self.skies, self.residuals)


def refit(
    settings: RefitSettings | None = None, *, progress: Progress | None = None, **changes: Any
) -> RefitResult:
    """Simulate skies and fit the model of the 1999 paper to them.

    Args:
        settings: What to do; None: the reference job.
        progress: Called with the name of each stage as it begins.
        **changes: Settings by name that differ from `settings`.

    Returns:
        The model, its fits with standard errors, the skies and the comparisons.

    Raises:
        ValueError: A setting lies outside its range.
    """
    settings = dataclasses.replace(settings or RefitSettings(), **changes)
    with jax.enable_x64(True):
        clock = Clock(progress)
        skies = simulate_skies(settings, clock)
        return _fit(skies, clock)


def _fit(skies: SimulatedSkies, clock: "Clock") -> RefitResult:
    """All fits and both comparisons."""
    s = skies.settings
    axes = (skies.directions, s.solar_zenith_angle, np.asarray(s.turbidity))
    weighting = {"x": "absolute", "y": "absolute", "Y": s.weighting}
    with clock.stage("joint fits"):
        joint = {
            q: fit_distribution(*axes, skies.quantity(q), weighting=weighting[q])
            for q in QUANTITIES
        }
        joint = _to_numpy(joint)
    with clock.stage("zenith fits"):
        table = (axes[2], axes[1])
        zeniths = {
            "x": fit_zenith_chromaticity(*table, skies.zenith[..., 0], weighting="absolute"),
            "y": fit_zenith_chromaticity(*table, skies.zenith[..., 1], weighting="absolute"),
            "Y": fit_zenith_luminance(*table, skies.zenith[..., 2]),
        }
        zeniths = _to_numpy(zeniths)
    with clock.stage("single skies"):
        single = {
            q: fit_perez(axes[0], axes[1], skies.quantity(q), weighting=weighting[q])
            for q in QUANTITIES
        }
        single = _to_numpy(single)
    model = PreethamModel(
        x_distribution=joint["x"].matrix,
        y_distribution=joint["y"].matrix,
        luminance_distribution=joint["Y"].matrix,
        zenith_x=zeniths["x"].coefficients,
        zenith_y=zeniths["y"].coefficients,
        zenith_luminance=zeniths["Y"].coefficients,
        turbidity_range=(min(s.turbidity), max(s.turbidity)),
    )
    with clock.stage("comparison"):
        comparisons = (
            compare(PREETHAM_1999, skies, "published"),
            compare(model, skies, "regenerated"),
        )
    return RefitResult(model, skies, joint, zeniths, single, comparisons, dict(clock.seconds))


def _to_numpy(fits: dict[str, _Fit]) -> dict[str, _Fit]:
    """The fits with NumPy arrays, which stay float64 whatever JAX's default is."""
    return jax.tree.map(np.asarray, fits)
