"""Ten measured skies, two codes that computed them, and the measures of how well a model does.

The one resampling of the whole comparison: measured spectra (1 nm apart) are interpolated linearly
at the 40 wavelengths of the codes, and every luminance is the integral over these 40 samples.
"""

import dataclasses
import os
from pathlib import Path
from typing import TypedDict

import numpy as np

import atmofit as af

NEAR_SUN = np.radians(10.0)  # the field of view is unknown, so this close the scan is uncertain
FAULTY, NEIGHBOURS = 0, [1, 31]  # directions; the neighbours share the ring of the faulty one
CODES = {
    "disort": "disort_pseudospherical_kider_given.npz",
    "libradtran": "libradtran202_kider_given.npz",
}


class DataMissing(Exception):
    """The folder of the measured skies is absent or incomplete."""


@dataclasses.dataclass(frozen=True)
class Skies:
    """Measured skies; angles in radians, `relative_azimuth` is 0 toward the sun.

    Attributes:
        time: Local time of each scan, ISO 8601.
        wavelength_nm: [wavelength].
        radiance: [scan, direction, wavelength], W m^-2 sr^-1 nm^-1.
        luminance: [scan, direction], cd m^-2.
        view_zenith_angle: [direction].
        relative_azimuth: [scan, direction].
        scattering_angle: Angle to the sun, [scan, direction].
        solar_zenith_angle: [scan].
    """

    time: tuple[str, ...]
    wavelength_nm: np.ndarray
    radiance: np.ndarray
    luminance: np.ndarray
    view_zenith_angle: np.ndarray
    relative_azimuth: np.ndarray
    scattering_angle: np.ndarray
    solar_zenith_angle: np.ndarray

    @property
    def directions(self) -> list[af.Directions]:
        """The directions of each scan, by rings of one zenith angle."""
        starts = np.flatnonzero(np.diff(self.view_zenith_angle, prepend=-1.0))
        rings = tuple(int(n) for n in np.diff(starts, append=self.view_zenith_angle.size))
        return [
            af.Directions(self.view_zenith_angle, azimuth, rings)
            for azimuth in self.relative_azimuth
        ]

    @property
    def groups(self) -> dict[str, np.ndarray]:
        """Which scans belong to "may" and which to "september"."""
        month = np.array([time[5:7] for time in self.time])
        return {"may": month == "05", "september": month == "09"}


@dataclasses.dataclass(frozen=True)
class Prediction:
    """What a model says about all the scans.

    Attributes:
        name: Name of the model.
        radiance: [scan, direction, wavelength], W m^-2 sr^-1 nm^-1.
        luminance: [scan, direction], cd m^-2.
    """

    name: str
    radiance: np.ndarray
    luminance: np.ndarray


class Score(TypedDict):
    """Errors of one model in one month.

    Keys:
        model: Name of the model.
        group: "may" or "september".
        rms_mW: Over all directions and wavelengths [mW m^-2 sr^-1 nm^-1].
        rms_far_mW: The same without directions within 10 degrees of the sun.
        luminance_rms_relative: Relative to the measured luminance of each direction [-].
        luminance_level: Model over measured luminance, the geometric mean of all directions [-].
        luminance_pattern_rms: Of the logarithm of this ratio, each scan's mean taken out [-].
        rms_mW_by_scan: `rms_mW` of each scan of the month, in the order of time.
    """

    model: str
    group: str
    rms_mW: float
    rms_far_mW: float
    luminance_rms_relative: float
    luminance_level: float
    luminance_pattern_rms: float
    rms_mW_by_scan: list[float]


def data_folder() -> Path:
    """`ATMOFIT_DATA`, else `../shared/data` beside the checkout."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("ATMOFIT_DATA", beside))


def data_file(folder: Path, name: str) -> Path:
    """Path of a file of the data folder.

    Raises:
        DataMissing: The file is absent; the message is one line.
    """
    path = folder / name
    if not path.is_file():
        raise DataMissing(
            f"no measured skies: {path} is missing. They are the public data set of Kider et al. "
            "2014 (repository sky-measurements-2014); expected is a folder that holds "
            "measured_sky_2013/scans.npz and reference/, named by ATMOFIT_DATA or lying at "
            "../shared/data beside the checkout"
        )
    return path


def read_npz(folder: Path, name: str) -> dict[str, np.ndarray]:
    """All arrays of a file of the data folder.

    Raises:
        DataMissing: The file is absent.
    """
    with np.load(data_file(folder, name)) as arrays:
        return {key: arrays[key] for key in arrays.files}


def read_skies(folder: Path, *, band: bool = False) -> Skies:
    """The ten scans, repaired, at the wavelengths of the codes.

    Args:
        folder: The data folder.
        band: Average over the 11.75 nm that begin at each wavelength instead of interpolating: the
            solar spectrum that the codes were given is such an average. Only to show what the
            resampling does.

    Raises:
        DataMissing: A file is absent.
    """
    scans = read_npz(folder, "measured_sky_2013/scans.npz")
    wavelength_nm = read_npz(folder, f"reference/{CODES['disort']}")["wavelength_nm"]
    fine = scans["radiance_W_m2_sr_nm"].astype(float)
    fine[:, FAULTY] = fine[:, NEIGHBOURS].mean(axis=1)
    width = 11.75 if band else 0.0
    radiance = fine @ _interpolation(scans["wavelength_nm"].astype(float), wavelength_nm, width)
    view = np.radians(scans["view_zenith_deg"])
    # The dome was rotated against north, so the symmetry of each scan gives the sun's azimuth.
    azimuth = np.radians(
        scans["view_azimuth_deg"] - scans["sun_azimuth_from_symmetry_deg"][:, None]
    )
    sun = np.radians(scans["sun_zenith_deg"])
    return Skies(
        time=tuple(str(time) for time in scans["time_local"]),
        wavelength_nm=wavelength_nm,
        radiance=radiance,
        luminance=luminance(radiance, wavelength_nm),
        view_zenith_angle=view,
        relative_azimuth=np.mod(azimuth, 2 * np.pi),
        scattering_angle=_scattering_angle(view, azimuth, sun),
        solar_zenith_angle=sun,
    )


def read_codes(folder: Path) -> list[Prediction]:
    """Radiances of DISORT and libRadtran in the measured directions.

    Raises:
        DataMissing: A file is absent.
    """
    predictions = []
    for name, file in CODES.items():
        code = read_npz(folder, f"reference/{file}")
        radiance = code["radiance_W_m2_sr_nm"].astype(float)
        predictions.append(Prediction(name, radiance, luminance(radiance, code["wavelength_nm"])))
    return predictions


def luminance(radiance: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """Luminance of spectra that are linear between their samples.

    Args:
        radiance: [..., wavelength], W m^-2 sr^-1 nm^-1.
        wavelength_nm: [wavelength]; what lies outside 380 to 780 nm is left out.

    Returns:
        [...], cd m^-2.
    """
    seen = (wavelength_nm >= 380) & (wavelength_nm <= 780)
    return np.asarray(af.spectrum_to_XYZ(radiance[..., seen], wavelength_nm[seen]))[..., 1]


def score(skies: Skies, predictions: list[Prediction]) -> list[Score]:
    """Every model's errors, May and September apart."""
    far = skies.scattering_angle >= NEAR_SUN
    scores: list[Score] = []
    for prediction in predictions:
        error_mW = 1e3 * (prediction.radiance - skies.radiance)
        ratio = prediction.luminance / skies.luminance
        level = np.log(ratio).mean(axis=1, keepdims=True)
        for group, scans in skies.groups.items():
            scores.append(
                {
                    "model": prediction.name,
                    "group": group,
                    "rms_mW": _rms(error_mW[scans]),
                    "rms_far_mW": _rms(error_mW[scans][far[scans]]),
                    "luminance_rms_relative": _rms(ratio[scans] - 1),
                    "luminance_level": float(np.exp(level[scans].mean())),
                    "luminance_pattern_rms": _rms((np.log(ratio) - level)[scans]),
                    "rms_mW_by_scan": [_rms(scan) for scan in error_mW[scans]],
                }
            )
    return scores


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _scattering_angle(view: np.ndarray, azimuth: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Angle between each direction and the sun, [scan, direction]."""
    sun = sun[:, None]
    cosine = np.cos(view) * np.cos(sun) + np.sin(view) * np.sin(sun) * np.cos(azimuth)
    return np.arccos(np.clip(cosine, -1.0, 1.0))  # no direction is within a degree of the sun


def _interpolation(nodes: np.ndarray, targets: np.ndarray, width: float) -> np.ndarray:
    """Matrix [node, target] of linear interpolation, or of its mean over [target, target + width].

    Targets outside the nodes get 0.
    """
    inside = np.linspace(0.0, width, 48)[:-1] + width / 94 if width else np.zeros(1)
    points = targets[:, None] + inside
    hats = [np.interp(points, nodes, row, left=0.0, right=0.0) for row in np.eye(nodes.size)]
    return np.array(hats).mean(axis=-1)
