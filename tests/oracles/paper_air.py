"""The paper's clear sky in the oracles' terms, made from the published numbers alone."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from oracles import Reals, Scatterer, rayleigh_phase

# Preetham, Shirley and Smits (1999): Table 1 (0 degrees repeats 1 degree), and K of Table 2.
_ANGLE_DEG = np.array([0, 1, 4, 7, 10, 30, 60, 80, 90, 110, 120, 130, 150, 180.0])
_TABLE_NM = np.array([400, 450, 550, 650, 850.0])
_ETA = np.array(
    [
        [4.192, 4.193, 4.177, 4.147, 4.072],
        [4.192, 4.193, 4.177, 4.147, 4.072],
        [3.311, 3.319, 3.329, 3.335, 3.339],
        [2.860, 2.868, 2.878, 2.883, 2.888],
        [2.518, 2.527, 2.536, 2.542, 2.547],
        [1.122, 1.129, 1.138, 1.142, 1.147],
        [0.3324, 0.3373, 0.3433, 0.3467, 0.3502],
        [0.1644, 0.1682, 0.1730, 0.1757, 0.1785],
        [0.1239, 0.1275, 0.1320, 0.1346, 0.1373],
        [0.08734, 0.09111, 0.09591, 0.09871, 0.10167],
        [0.08242, 0.08652, 0.09179, 0.09488, 0.09816],
        [0.08313, 0.08767, 0.09352, 0.09697, 0.10065],
        [0.09701, 0.1024, 0.1095, 0.1137, 0.1182],
        [0.1307, 0.1368, 0.1447, 0.1495, 0.1566],
    ]
)
_K_NM = np.arange(380, 781, 10.0)
_K = np.array(
    [
        *(0.650, 0.653, 0.656, 0.658, 0.661, 0.662, 0.663, 0.666, 0.667, 0.669, 0.670),
        *(0.671, 0.672, 0.673, 0.674, 0.676, 0.677, 0.678, 0.679, 0.679, 0.680, 0.681),
        *(0.682, 0.682, 0.683, 0.684, 0.684, 0.685, 0.685, 0.685, 0.686, 0.686, 0.687),
        *(0.687, 0.688, 0.688, 0.689, 0.689, 0.689, 0.689, 0.689),
    ]
)
_MOLECULE_SCALE_HEIGHT, _HAZE_SCALE_HEIGHT = 1e3 / 0.1136, 1e3 / 0.8333
_FINE = np.radians(np.linspace(0, 180, 36001))


def paper_constituents(turbidity: float, wavelength_nm: Reals) -> list[Scatterer]:
    """Molecules and haze with the corrected constants of appendix A.3 (n = 1.000278, SI haze)."""
    metres = wavelength_nm * 1e-9
    king = (6 + 3 * 0.035) / (6 - 7 * 0.035)
    molecules = 8 * np.pi**3 * (1.000278**2 - 1) ** 2 * king / (3 * 2.545e25 * metres**4)
    concentration = (0.6544 * turbidity - 0.6510) * 1e-18
    total = np.interp(wavelength_nm, _K_NM, _K)
    haze = 0.434 * concentration * np.pi * (2 * np.pi / metres) ** 2 * total
    return [
        Scatterer(molecules * _MOLECULE_SCALE_HEIGHT, _MOLECULE_SCALE_HEIGHT, rayleigh_phase),
        Scatterer(haze * _HAZE_SCALE_HEIGHT, _HAZE_SCALE_HEIGHT, HazePhase(wavelength_nm)),
    ]


class HazePhase:
    """Table 1 by cubics of log eta with three-point slopes, normalised on a fine grid of angles."""

    def __init__(self, wavelength_nm: Reals) -> None:
        """Tabulate log phase functions at the wavelengths."""
        log_eta = np.stack([np.interp(wavelength_nm, _TABLE_NM, np.log(row)) for row in _ETA])
        angle = np.radians(_ANGLE_DEG)
        step = np.diff(angle)[:, None]
        secant = np.diff(log_eta, axis=0) / step
        slope = np.zeros_like(log_eta)
        slope[1:-1] = (step[1:] * secant[:-1] + step[:-1] * secant[1:]) / (step[1:] + step[:-1])
        self._log = CubicHermiteSpline(angle, log_eta, slope, axis=0)
        values = np.exp(self._log(_FINE))
        self._norm = np.trapezoid(2 * np.pi * np.sin(_FINE)[:, None] * values, _FINE, axis=0)

    def __call__(self, cosine: Reals, wavelength_index: np.ndarray) -> Reals:
        """Phase function [1/sr]; the arguments broadcast, the last axis is the wavelength."""
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        columns = np.exp(self._log(angle[..., 0])) / self._norm
        return columns[..., wavelength_index.ravel()]
