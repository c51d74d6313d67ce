"""What a refit shows, as numbers and plain sentences."""

import dataclasses

import numpy as np

from atmofit.fit.comparison import Comparison
from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import RefitSettings
from atmofit.models.preetham import PREETHAM_1999
from atmofit.render.coefficients import DISTRIBUTIONS, distribution, zenith

LUMINANCE_CLOSE = 0.1  # relative; within it a luminance is said to reproduce
CHROMATICITY_CLOSE = 0.005
HIGH_SUN_DEG = 50.0


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How many published coefficients come back.

    Attributes:
        count: Of coefficients.
        within_errors: How many published ones lie within two standard errors.
        within_tenth: How many differ by a tenth of the regenerated one or less.
    """

    count: int
    within_errors: int
    within_tenth: int


def agreement(result: RefitResult, *, of_zenith: bool) -> Agreement:
    """Published against regenerated coefficients, of the distributions or of the zenith."""
    fits, part = (result.zeniths, zenith) if of_zenith else (result.distributions, distribution)
    rows = [
        (
            np.ravel(part(PREETHAM_1999, q)),
            np.ravel(part(result.model, q)),
            np.ravel(fits[q].standard_error),
        )
        for q in DISTRIBUTIONS
    ]
    published, regenerated, error = (np.concatenate(column) for column in zip(*rows, strict=True))
    difference = np.abs(published - regenerated)
    return Agreement(
        count=difference.size,
        within_errors=int((difference <= 2 * error).sum()),
        within_tenth=int((difference <= 0.1 * np.abs(regenerated)).sum()),
    )


def pattern_rms(comparison: Comparison) -> float:
    """Root mean square over all skies of a model's pattern in Y, each sky's mean ratio divided out.

    That is the standard deviation of model / simulation over the dome, relative to its mean.
    """
    mean, rms = comparison.luminance_ratio, comparison.luminance_rms
    spread = np.sqrt(np.maximum(rms**2 - (mean - 1) ** 2, 0.0)) / np.abs(mean)
    valid = spread[np.isfinite(spread)]
    return float(np.sqrt(np.mean(valid**2))) if valid.size else float("nan")


def findings(result: RefitResult) -> list[str]:
    """What reproduces and what does not, in sentences whose numbers come from the result."""
    published, regenerated = result.comparisons[:2]
    settings = result.skies.settings
    if not np.isfinite(published.luminance_ratio).any():
        first = [f"The {published.name} model is not valid at any of these turbidities."]
    else:
        first = [
            _luminance(published, settings),
            _zenith_factor(published, settings),
            _pattern(published, regenerated),
            _chromaticity(published),
        ]
    return [_convergence(result), *first, _coefficients(result), _regenerated(result, regenerated)]


def _convergence(result: RefitResult) -> str:
    flags = np.concatenate(
        [
            np.ravel(fit.converged)
            for fits in (result.distributions, result.single_skies)
            for fit in fits.values()
        ]
    )
    zeniths = "The zenith fits are linear and need no search."
    if flags.all():
        return f"All {flags.size} searches (joint fits and single skies) converged. {zeniths}"
    bad = int((~flags).sum())
    return f"{bad} of {flags.size} searches did NOT converge; their numbers may be wrong. {zeniths}"


def _luminance(c: Comparison, settings: RefitSettings) -> str:
    mean = c.summary()["luminance_ratio"]
    return (
        f"Luminance, {_verdict(_close_to_one(c.luminance_ratio))}: over the dome the {c.name} "
        f"model is on average {mean:.2f} times the simulation "
        f"({_extremes(c.luminance_ratio, settings)})."
    )


def _zenith_factor(c: Comparison, settings: RefitSettings) -> str:
    ratio = c.zenith_luminance_ratio
    mean = c.summary()["zenith_luminance_ratio"]
    suns = np.asarray(settings.solar_zenith_angle_deg)
    parts = [_extremes(ratio, settings)]
    for name, chosen in (
        (f"suns within {HIGH_SUN_DEG:g}° of the zenith", suns <= HIGH_SUN_DEG),
        (f"the lowest sun, {suns.max():g}°", suns == suns.max()),
    ):
        values = ratio[:, chosen]
        if np.isfinite(values).any():
            parts.append(f"{np.nanmean(values):.2f} for {name}")
    return (
        f"Zenith luminance, {_verdict(_close_to_one(ratio))}: the {c.name} zenith is "
        f"on average {mean:.2f} times the simulated one ({'; '.join(parts)})."
    )


def _pattern(published: Comparison, regenerated: Comparison) -> str:
    first, second = pattern_rms(published), pattern_rms(regenerated)
    return (
        f"Pattern of luminance over the dome, {_verdict(first <= LUMINANCE_CLOSE)}: with each "
        f"sky's mean ratio divided out, the {published.name} model still differs from the "
        f"simulation by {100 * first:.0f} % rms, the {regenerated.name} one by "
        f"{100 * second:.0f} %."
    )


def _chromaticity(c: Comparison) -> str:
    s = c.summary()
    close = max(s["x_rms"], s["y_rms"]) <= CHROMATICITY_CLOSE
    return (
        f"Chromaticity, {_verdict(close)}: {c.name} minus simulated is {s['x_mean']:+.4f} in x "
        f"and {s['y_mean']:+.4f} in y on average (rms {s['x_rms']:.4f} and {s['y_rms']:.4f})."
    )


def _coefficients(result: RefitResult) -> str:
    joint, at_zenith = (agreement(result, of_zenith=z) for z in (False, True))
    stretch = ", ".join(
        f"{q} {float(result.distributions[q].condition_number):.0f}" for q in DISTRIBUTIONS
    )
    worst = max(float(fit.condition_number) for fit in result.zeniths.values())
    everything = joint.within_errors == joint.count and at_zenith.within_errors == at_zenith.count
    return (
        f"Coefficients, {_verdict(everything)} one by one: of {joint.count} distribution "
        f"coefficients {joint.within_errors} published ones lie within two standard errors of the "
        f"regenerated and {joint.within_tenth} within 10 %; of {at_zenith.count} zenith "
        f"coefficients {at_zenith.within_errors} and {at_zenith.within_tenth}. Condition numbers "
        f"of the joint fits are {stretch}, of the zenith fits up to {worst:.0f}: compare "
        f"predictions rather than coefficients."
    )


def _regenerated(result: RefitResult, c: Comparison) -> str:
    s = c.summary()
    single = result.single_skies["Y"]
    alone = float(np.sqrt(np.mean(np.square(single.rms))))
    free = (
        f" A Perez formula fitted to each sky alone leaves {100 * alone:.1f} % in luminance."
        if single.weighting == "relative"
        else ""
    )
    return (
        f"The {c.name} model follows the skies it was fitted to within "
        f"{100 * s['luminance_rms']:.0f} % rms in luminance (mean ratio "
        f"{s['luminance_ratio']:.2f}), {s['x_rms']:.4f} in x and {s['y_rms']:.4f} in y; this is "
        f"what a model of this form leaves.{free}"
    )


def _close_to_one(ratio: np.ndarray) -> bool:
    return float(np.sqrt(np.nanmean((ratio - 1) ** 2))) <= LUMINANCE_CLOSE


def _verdict(good: bool) -> str:
    return "reproduced" if good else "not reproduced"


def _extremes(values: np.ndarray, settings: RefitSettings) -> str:
    """The smallest and the largest cell with turbidity and sun."""
    words = []
    for word, index in (("from", np.nanargmin(values)), ("to", np.nanargmax(values))):
        row, column = np.unravel_index(int(index), values.shape)
        words.append(
            f"{word} {values[row, column]:.2f} at T {settings.turbidity[row]:g}, sun "
            f"{settings.solar_zenith_angle_deg[column]:g}°"
        )
    return " ".join(words)
