"""The paper's work done again: simulate many skies, fit the sky model to them, compare."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import numpy as np

from atmofit.fit.comparison import Comparison, compare, predict
from atmofit.fit.dataset import to_dataset
from atmofit.fit.distribution import DistributionFit, fit_distribution
from atmofit.fit.identifiability import (
    Identifiability,
    identify_distribution,
    identify_perez,
    identify_zenith,
)
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
        identifiability: How far the skies determine each fit: "Y together", "Y zenith",
            "Y alone" and so for x and y; empty if no starts were asked for.
        seconds: Of each stage.
    """

    model: PreethamModel
    skies: SimulatedSkies
    distributions: Mapping[str, DistributionFit]
    zeniths: Mapping[str, ZenithFit]
    single_skies: Mapping[str, PerezFit]
    comparisons: tuple[Comparison, ...]
    identifiability: Mapping[str, Identifiability]
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
    settings: RefitSettings | None = None,
    *,
    skies: SimulatedSkies | None = None,
    pieces: str | Path | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> RefitResult:
    """Simulate skies, or take given ones, and fit the model of the 1999 paper to them.

    Args:
        settings: What to do; None: the reference job, or the settings of the given skies.
        skies: From `simulate_skies`; nothing is simulated then, and only settings of the fits may
            differ from theirs.
        pieces: Folder in which finished pieces of the simulation are kept, and from which those
            of an earlier run are taken, see `simulate_skies`; None: nothing is written.
        progress: Called with the name of each stage, and with the number of each piece of the
            simulation, as it begins.
        **changes: Settings by name that differ from `settings`.

    Returns:
        The model, its fits with standard errors, the skies and the comparisons.

    Raises:
        ValueError: A setting lies outside its range, or differs from what was simulated; or the
            folder of the pieces cannot be written.
    """
    if skies is not None and pieces is not None:
        raise ValueError(f"pieces must be None where skies are given, got {str(pieces)!r}")
    default = RefitSettings() if skies is None else skies.settings
    settings = dataclasses.replace(settings or default, **changes)
    with jax.enable_x64(True):
        clock = Clock(progress)
        if skies is None:
            skies = simulate_skies(settings, clock, pieces)
        return _fit(skies.under(settings), clock)


def _fit(skies: SimulatedSkies, clock: Clock) -> RefitResult:
    """All fits and both comparisons."""
    with clock.stage("joint fits"):
        joint = _joint_fits(skies)
    with clock.stage("zenith fits"):
        zeniths = _zenith_fits(skies)
    with clock.stage("single skies"):
        single = _single_sky_fits(skies)
    model = fitted_model(joint, zeniths, skies.settings.turbidity)
    with clock.stage("comparison"):
        comparisons = (
            compare(PREETHAM_1999, skies, "published"),
            compare(model, skies, "regenerated"),
        )
    identifiability: dict[str, Identifiability] = {}
    if skies.settings.starts:
        with clock.stage("identifiability"):
            identifiability = _identify(skies, zeniths)
    return RefitResult(
        model, skies, joint, zeniths, single, comparisons, identifiability, dict(clock.seconds)
    )


def _joint_fits(skies: SimulatedSkies) -> dict[str, DistributionFit]:
    """One distribution over all skies for each quantity."""
    s = skies.settings
    axes = (skies.directions, s.solar_zenith_angle, np.asarray(s.turbidity))
    return _to_numpy(
        {
            q: fit_distribution(*axes, skies.quantity(q), weighting=s.weighting_of(q))
            for q in QUANTITIES
        }
    )


def _zenith_fits(skies: SimulatedSkies) -> dict[str, ZenithFit]:
    """Zenith values as functions of turbidity and sun."""
    s, zenith = skies.settings, skies.zenith
    axes = (np.asarray(s.turbidity), s.solar_zenith_angle)
    return _to_numpy(
        {
            "x": fit_zenith_chromaticity(*axes, zenith[..., 0], weighting="absolute"),
            "y": fit_zenith_chromaticity(*axes, zenith[..., 1], weighting="absolute"),
            "Y": fit_zenith_luminance(*axes, zenith[..., 2]),
        }
    )


def _single_sky_fits(skies: SimulatedSkies) -> dict[str, PerezFit]:
    """Each sky fitted alone."""
    s = skies.settings
    axes = (skies.directions, s.solar_zenith_angle)
    return _to_numpy(
        {q: fit_perez(*axes, skies.quantity(q), weighting=s.weighting_of(q)) for q in QUANTITIES}
    )


def _identify(
    skies: SimulatedSkies, zeniths: Mapping[str, ZenithFit]
) -> dict[str, Identifiability]:
    """Every fit searched for from many starts, its weakest direction and its profiles."""
    s = skies.settings
    axes = (skies.directions, s.solar_zenith_angle)
    turbidity = np.asarray(s.turbidity)
    found = {}
    for q in QUANTITIES:
        how: dict[str, Any] = {
            "weighting": s.weighting_of(q), "starts": s.starts, "seed": s.seed
        }  # fmt: skip
        values = skies.quantity(q)
        found[f"{q} together"] = identify_distribution(*axes, turbidity, values, **how)
        found[f"{q} alone"] = identify_perez(*axes, values, **how)
        found[f"{q} zenith"] = identify_zenith(zeniths[q])
    return _to_numpy(found)


def fitted_model(
    joint: Mapping[str, DistributionFit],
    zeniths: Mapping[str, ZenithFit],
    turbidity: tuple[float, ...],
) -> PreethamModel:
    """The fitted coefficients as a model, valid inside the turbidities of the skies."""
    return PreethamModel(
        x_distribution=joint["x"].matrix,
        y_distribution=joint["y"].matrix,
        luminance_distribution=joint["Y"].matrix,
        zenith_x=zeniths["x"].coefficients,
        zenith_y=zeniths["y"].coefficients,
        zenith_luminance=zeniths["Y"].coefficients,
        turbidity_range=(min(turbidity), max(turbidity)),
    )


def _to_numpy(fits: dict[str, _Fit]) -> dict[str, _Fit]:
    """The fits with NumPy arrays, which stay float64 whatever JAX's default is."""
    return jax.tree.map(np.asarray, fits)
