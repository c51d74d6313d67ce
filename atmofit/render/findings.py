"""What a refit shows, as plain sentences whose words follow its numbers."""

import numpy as np

from atmofit.fit.comparison import Comparison
from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import RefitSettings
from atmofit.fit.verdict import CLOSE, DISTRIBUTIONS, scores_of

LUMINANCE_CLOSE = 0.1  # relative; within it a luminance is said to reproduce
CHROMATICITY_CLOSE = 0.005
HIGH_SUN_DEG = 50.0


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
        f"Luminance, {verdict(_close_to_one(c.luminance_ratio))}: over the dome the {c.name} "
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
        f"Zenith luminance, {verdict(_close_to_one(ratio))}: the {c.name} zenith is "
        f"on average {mean:.2f} times the simulated one ({'; '.join(parts)})."
    )


def _pattern(published: Comparison, regenerated: Comparison) -> str:
    first, second = (one.summary()["luminance_pattern_rms"] for one in (published, regenerated))
    return (
        f"Pattern of luminance over the dome, {verdict(first <= LUMINANCE_CLOSE)}: with each "
        f"sky's mean ratio divided out, the {published.name} model still differs from the "
        f"simulation by {100 * first:.0f} % rms, the {regenerated.name} one by "
        f"{100 * second:.0f} %."
    )


def _chromaticity(c: Comparison) -> str:
    s = c.summary()
    close = max(s["x_rms"], s["y_rms"]) <= CHROMATICITY_CLOSE
    return (
        f"Chromaticity, {verdict(close)}: {c.name} minus simulated is {s['x_mean']:+.4f} in x "
        f"and {s['y_mean']:+.4f} in y on average over the dome (rms {s['x_rms']:.4f} and "
        f"{s['y_rms']:.4f}), and {s['zenith_x_difference']:+.4f} and "
        f"{s['zenith_y_difference']:+.4f} at the zenith."
    )


def _coefficients(result: RefitResult) -> str:
    scores = scores_of(result)
    dome, at_zenith = (
        scores.of_group(*(f"{prefix}{q}" for q in DISTRIBUTIONS)).summary()
        for prefix in ("", "zenith ")
    )
    every = scores.summary()
    loose = scores.of_group("zenith x", "zenith y").summary()
    offset = result.comparisons[0].summary()
    wide = (
        f" A coefficient within its errors need not agree: {loose['within_two_robust']} of the "
        f"{loose['count']} zenith coefficients of x and y are within theirs, and yet what they "
        f"give together is off by {offset['zenith_x_difference']:+.3f} and "
        f"{offset['zenith_y_difference']:+.3f}."
        if loose["within_two_robust"] > loose["count"] / 2
        and max(abs(offset[f"zenith_{q}_difference"]) for q in "xy") > CHROMATICITY_CLOSE
        else ""
    )
    stretch = ", ".join(
        f"{q} {float(result.distributions[q].condition_number):.0f}" for q in DISTRIBUTIONS
    )
    worst = max(float(fit.condition_number) for fit in result.zeniths.values())
    return (
        f"Coefficients, {verdict(every['within_two_robust'] == every['count'])} one by one: of "
        f"{dome['count']} distribution coefficients {dome['within_two_robust']} published ones "
        f"lie within {CLOSE:g} robust standard errors of the regenerated ({dome['within_two']} if "
        f"residuals are taken as independent); of {at_zenith['count']} zenith coefficients "
        f"{at_zenith['within_two_robust']} ({at_zenith['within_two']}). The median |z| of all is "
        f"{every['median_robust_z']:.1f} ({every['median_z']:.1f}). Condition numbers of the joint "
        f"fits are {stretch}, of the zenith fits up to {worst:.0f}: compare predictions rather "
        f"than coefficients.{wide}"
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


def verdict(good: bool) -> str:
    """One of two words."""
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
