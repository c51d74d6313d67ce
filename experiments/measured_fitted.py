"""Analytic models with their turbidity fitted to measured skies, and nothing else.

Every scan has a turbidity of its own, found by least squares of spectral radiance in every second
direction at the wavelengths that all models have; the other directions are scored. The ground is
the site's, as one albedo for what the eye sees.
"""

import functools
from collections.abc import Callable
from typing import Any, TypedDict

import jax
import numpy as np
import scipy.optimize
from measured_data import Prediction, Skies, luminance
from measured_models import daylight_spectrum

import atmofit as af

LONGEST_SHARED_NM = 715.0  # the Hosek-Wilkie spectra of mitsuba end below 720 nm
_NODES = 24  # of the scan over turbidity that brackets the minimum

# Spectral radiance [direction, wavelength] of a scan at a turbidity.
Model = Callable[[int, float], np.ndarray]


class FittedScore(TypedDict):
    """How a model with fitted turbidity does in the directions that it was not fitted to.

    Keys:
        model: Its name; a code has no turbidity, and is scored in the same directions.
        group: "may" or "september".
        rms_mW: Over 40 wavelengths [mW m^-2 sr^-1 nm^-1]; None for a model that ends before.
        rms_shared_mW: Over the wavelengths that all models have.
        luminance_rms_relative: Relative to the measured luminance of each direction [-].
        turbidity: Of each scan, in the order of time.
        rms_shared_mW_by_scan: Likewise.
    """

    model: str
    group: str
    rms_mW: float | None
    rms_shared_mW: float
    luminance_rms_relative: float | None
    turbidity: list[float]
    rms_shared_mW_by_scan: list[float]


def site_albedo(ground: Any, solar_irradiance: af.Spectrum) -> float:
    """Share of the sunlight's luminance that the ground reflects."""
    assert isinstance(ground, af.Spectrum)
    wavelength_nm = np.asarray(ground.wavelength_nm)
    sun = np.asarray(solar_irradiance(wavelength_nm))
    reflected = luminance(np.asarray(ground.values) * sun, wavelength_nm)
    return float(reflected / luminance(sun, wavelength_nm))


def fitted_scores(
    skies: Skies,
    codes: list[Prediction],
    regenerated: af.PreethamModel,
    solar_irradiance: af.Spectrum,
    albedo: float,
) -> list[FittedScore]:
    """Every model's score, May and September apart."""
    models: dict[str, tuple[Model, tuple[float, float]]] = {
        "atmofit_2026": (_atmofit(skies, solar_irradiance, albedo), (1.2, 10.0)),
        "hosek_wilkie": (_hosek_wilkie(skies, albedo), (1.0, 10.0)),
        "preetham_1999": (_daylight(skies, af.PREETHAM_1999), (1.7, 10.0)),
        "regenerated": (_daylight(skies, regenerated), regenerated.turbidity_range),
    }
    shared = skies.wavelength_nm <= LONGEST_SHARED_NM
    scans = range(len(skies.time))
    scores = []
    for name, (model, limits) in models.items():
        turbidity = [_fitted(model, scan, limits, skies, shared) for scan in scans]
        radiance = np.stack([model(scan, turbidity[scan]) for scan in scans])
        scores += _scores(name, radiance, turbidity, skies, shared)
    for code in codes:
        scores += _scores(code.name, code.radiance, None, skies, shared)
    return scores


def _fitted(
    model: Model, scan: int, limits: tuple[float, float], skies: Skies, shared: np.ndarray
) -> float:
    """The turbidity with the least squared error in every second direction."""

    def error(log_turbidity: float) -> float:
        turbidity = float(np.clip(np.exp(log_turbidity), *limits))
        residual = model(scan, turbidity) - skies.radiance[scan]
        return float(np.mean(residual[::2][:, shared] ** 2))

    low, high = limits
    nodes = np.linspace(np.log(low), np.log(high), _NODES)
    best = int(np.argmin([error(node) for node in nodes]))
    bracket = nodes[max(best - 1, 0)], nodes[min(best + 1, _NODES - 1)]
    found = scipy.optimize.minimize_scalar(error, bounds=bracket, method="bounded")
    return float(np.clip(np.exp(found.x), *limits))


def _scores(
    name: str,
    radiance: np.ndarray,
    turbidity: list[float] | None,
    skies: Skies,
    shared: np.ndarray,
) -> list[FittedScore]:
    error_mW = 1e3 * (radiance - skies.radiance)[:, 1::2]
    whole = bool(np.isfinite(radiance).all())
    scores: list[FittedScore] = []
    for group, chosen in skies.groups.items():
        of_scan = np.sqrt(np.mean(error_mW[chosen][..., shared] ** 2, axis=(1, 2)))
        relative = None
        if whole:
            modelled = luminance(radiance[chosen][:, 1::2], skies.wavelength_nm)
            relative = _rms(modelled / skies.luminance[chosen][:, 1::2] - 1)
        scores.append(
            {
                "model": name,
                "group": group,
                "rms_mW": _rms(error_mW[chosen]) if whole else None,
                "rms_shared_mW": _rms(of_scan),
                "luminance_rms_relative": relative,
                "turbidity": [] if turbidity is None else np.asarray(turbidity)[chosen].tolist(),
                "rms_shared_mW_by_scan": of_scan.tolist(),
            }
        )
    return scores


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _atmofit(skies: Skies, solar_irradiance: af.Spectrum, albedo: float) -> Model:
    sun = np.asarray(solar_irradiance(skies.wavelength_nm))

    @jax.jit
    def sky(turbidity: jax.Array, solar: jax.Array, directions: af.Directions) -> jax.Array:
        return af.ATMOFIT_2026.radiance(
            turbidity, solar, directions, skies.wavelength_nm, albedo, sun
        )

    def model(scan: int, turbidity: float) -> np.ndarray:
        return np.asarray(sky(turbidity, skies.solar_zenith_angle[scan], skies.directions[scan]))

    return model


def _daylight(skies: Skies, analytic: af.PreethamModel) -> Model:
    def model(scan: int, turbidity: float) -> np.ndarray:
        xyY = analytic(turbidity, skies.solar_zenith_angle[scan], skies.directions[scan])
        return daylight_spectrum(np.asarray(xyY), skies.wavelength_nm)

    return model


def _hosek_wilkie(skies: Skies, albedo: float) -> Model:
    """Radiance in W m^-2 sr^-1 nm^-1; NaN beyond the shared wavelengths."""
    shared = skies.wavelength_nm <= LONGEST_SHARED_NM

    @functools.lru_cache(maxsize=4096)
    def model(scan: int, turbidity: float) -> np.ndarray:
        sky = hosek_wilkie(turbidity, skies.solar_zenith_angle[scan], albedo)
        radiance = np.full((skies.view_zenith_angle.size, skies.wavelength_nm.size), np.nan)
        azimuth = skies.relative_azimuth[scan]
        radiance[:, shared] = sky(skies.view_zenith_angle, azimuth, skies.wavelength_nm[shared])
        return radiance

    return model


def hosek_wilkie(
    turbidity: float, solar_zenith_angle: float, albedo: float
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """The sky of Hosek and Wilkie (2012), as mitsuba computes it.

    Returns:
        From view zenith angles and relative azimuths [rad], lists of one length, and wavelengths
        [nm], 320 to 715, to radiance [direction, wavelength], W m^-2 sr^-1 nm^-1.
    """
    import mitsuba

    mitsuba.set_variant("scalar_spectral")
    at: Any = mitsuba.SurfaceInteraction3f()
    sky: Any = mitsuba.load_dict(
        {
            "type": "sunsky",
            "turbidity": turbidity,
            "albedo": {"type": "uniform", "value": albedo},
            "sun_direction": [np.sin(solar_zenith_angle), 0.0, np.cos(solar_zenith_angle)],
            "sun_scale": 0.0,
        }
    )

    def radiance(view: np.ndarray, azimuth: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
        values = np.empty((view.size, wavelength_nm.size))
        across = np.sin(view)
        toward = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(view)], -1)
        for direction, vector in enumerate(toward):
            at.wi = mitsuba.Vector3f(*(-vector).tolist())
            for start in range(0, wavelength_nm.size, 4):  # four at once
                asked = wavelength_nm[start : start + 4]
                at.wavelengths = np.resize(asked, 4).tolist()
                values[direction, start : start + asked.size] = np.array(sky.eval(at))[: asked.size]
        return values

    return radiance
