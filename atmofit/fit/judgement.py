"""What an estimate of turbidity is worth, in words and plain numbers."""

import dataclasses
from typing import Any

import numpy as np

from atmofit.constants import REFERENCE_WAVELENGTH_NM
from atmofit.fit.posterior import TurbidityProfile
from atmofit.observe.observation import Observation
from atmofit.optics.air import rayleigh_optical_depth

_DOUBTFUL, _UNHELD = 4.0, 30.0  # reduced chi-square: widened with a warning, and refused
_OUTLIER, _MANY = 0.3, 0.1  # weight of an outlier, and share of directions that is many
_CHI_SQUARE_95 = 3.84
_DEGREES = ("solar_zenith_angle", "solar_azimuth")  # unknowns that are told in degrees


@dataclasses.dataclass(frozen=True)
class Judgement:
    """An estimate as it is reported.

    Attributes:
        name: Of the sky.
        observation: What was measured.
        profile: The fit.
        warnings: Sentences.
        refusal: Why no turbidity is given, or "".
        notes: Facts on the way to the observation, such as the pixels left out.
    """

    name: str
    observation: Observation
    profile: TurbidityProfile
    warnings: tuple[str, ...]
    refusal: str
    notes: tuple[str, ...] = ()

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of turbidity: of the profile, widened where the residuals ask for it."""
        estimate, profile = self.profile.estimate, self.profile
        low, high = estimate.turbidity_range
        value = float(estimate.value)
        wider = max(1.0, float(estimate.reduced_chi_square)) ** 0.5
        lower = value - wider * (value - float(profile.lower))
        upper = value + wider * (float(profile.upper) - value)
        return max(low, lower), min(high, upper)

    def numbers(self) -> dict[str, Any]:
        """Everything as plain values that JSON takes; angles in degrees."""
        estimate = self.profile.estimate
        errors = np.asarray(estimate.scaled_by_residual().standard_errors, float)
        low, high = self.interval
        found = {}
        for name, value, error in zip(
            estimate.names, np.asarray(estimate.parameters, float), errors, strict=True
        ):
            unit = np.degrees(1.0) if name in _DEGREES else 1.0
            label = f"{name}_deg" if name in _DEGREES else name
            found[label] = {"value": value * unit, "standard_error": error * unit}
        depth = float(rayleigh_optical_depth(REFERENCE_WAVELENGTH_NM))
        turbidity = float(estimate.value)
        return {
            "sky": self.name,
            "model": estimate.model,
            "refused": self.refusal,
            "turbidity": turbidity,
            "turbidity_interval_95": [low, high],
            "haze_optical_depth_550": (turbidity - 1) * depth,
            "haze_optical_depth_550_interval_95": [(low - 1) * depth, (high - 1) * depth],
            "unknowns": found,
            "reduced_chi_square": float(estimate.reduced_chi_square),
            "rms": float(estimate.rms),
            "directions": int(np.sum(np.asarray(self.observation.used))),
            "outliers": outliers(self.profile),
            "converged": bool(estimate.converged),
            "not_told_by_this_sky": list(estimate.untold),
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }

    def sentence(self) -> str:
        """The result in one line."""
        if self.refusal:
            return f"{self.name}: no estimate: {self.refusal}"
        numbers = self.numbers()
        low, high = numbers["turbidity_interval_95"]
        thin, thick = numbers["haze_optical_depth_550_interval_95"]
        return (
            f"{self.name}: turbidity {numbers['turbidity']:.2f} (95 %: {low:.2f} to {high:.2f}), "
            f"haze optical depth at 550 nm {numbers['haze_optical_depth_550']:.3f} ({thin:.3f} to "
            f"{thick:.3f})"
        )


def outliers(profile: TurbidityProfile) -> int:
    """Directions that hardly count in a robust fit."""
    weight = np.asarray(profile.estimate.weight)
    seen = np.isfinite(np.asarray(profile.estimate.log_ratio)).all(axis=-1)
    return int(np.sum(seen & (weight < _OUTLIER)))


def judge(
    name: str,
    observation: Observation,
    profile: TurbidityProfile,
    notes: tuple[str, ...] = (),
    second: TurbidityProfile | None = None,
) -> Judgement:
    """Look at a fit: refuse it, or say what it is to be read with.

    Args:
        name: Of the sky.
        observation: What was measured.
        profile: The fit.
        notes: Facts to pass on.
        second: Another fit to the same sky, with which the first must agree: from luminance alone,
            where colours may be wrong.
    """
    refusal = _refusal(profile)
    warnings = [*_warnings(observation, profile, bool(refusal)), *_others(profile)]
    if second is not None:
        value, low, high = (float(x) for x in (second.estimate.value, second.lower, second.upper))
        said = f"luminance alone says {value:.2f} ({low:.2f} to {high:.2f})"
        warnings.append(said)
        if not refusal and (low > float(profile.upper) or high < float(profile.lower)):
            refusal = f"colours and luminance disagree: {said}"
    return Judgement(name, observation, profile, tuple(warnings), refusal, notes)


def _refusal(profile: TurbidityProfile) -> str:
    """Why no turbidity can be given, or ""."""
    estimate = profile.estimate
    chi_square, value = float(estimate.reduced_chi_square), float(estimate.value)
    low, high = estimate.turbidity_range
    if not np.isfinite(value):
        return "the model gives no finite sky here"
    if not bool(estimate.converged):
        return "the search did not converge"
    if bool(estimate.at_edge):
        end = "clearer than" if value < (low * high) ** 0.5 else "hazier than"
        return (
            f"the best turbidity is at the end of the model's range ({value:.3g}): this sky is "
            f"{end} any that the model has, or differs from it otherwise"
        )
    if chi_square > _UNHELD:
        return (
            f"the model does not hold this sky: residuals are {chi_square**0.5:.1f} times as large "
            "as noise and model error"
        )
    return ""


def _warnings(observation: Observation, profile: TurbidityProfile, refused: bool) -> list[str]:
    """What a fit is to be read with."""
    estimate = profile.estimate
    chi_square, count = (
        float(estimate.reduced_chi_square),
        int(np.sum(np.asarray(observation.used))),
    )
    said = []
    if not refused and chi_square > _DOUBTFUL:
        said.append(
            f"residuals are {chi_square**0.5:.1f} times as large as noise and model error; the "
            "interval has been widened by that"
        )
    stuck = zip(estimate.names, np.asarray(estimate.at_edges), strict=True)
    said += [f"{name} ended at the end of its range" for name, at in stuck if at]
    said += [f"this sky tells hardly anything of {name}" for name in estimate.untold]
    if outliers(profile) > _MANY * count:
        said.append(f"{outliers(profile)} of {count} directions count as outliers")
    if observation.exposure != "known":
        said.append("exposure unknown: the level of the sky told nothing")
    return said


def _others(profile: TurbidityProfile) -> list[str]:
    """Other turbidities at which a search ended that fits nearly as well."""
    estimate = profile.estimate
    value, loss = (np.asarray(x, float) for x in (estimate.start_value, estimate.start_loss))
    wider = max(1.0, float(estimate.reduced_chi_square))
    near = 2 * (loss - np.nanmin(loss)) / wider < _CHI_SQUARE_95
    apart = np.abs(value - float(estimate.value)) > 3 * float(estimate.standard_error)
    return [
        f"turbidity {T:.2f} fits nearly as well" for T in np.unique(value[near & apart].round(2))
    ]
