"""Sky models as plain values that JSON takes, and the one that is shipped."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from atmofit.extremes import Case, Domain, extremes
from atmofit.geometry import HORIZON, Directions
from atmofit.models.cie import CIEShape
from atmofit.models.dependence import Basis, Dependence
from atmofit.models.shapes import Shape
from atmofit.models.sky_model import COLOURS, AnyShape, SkyModel

FORM = (
    "value = (1 + A exp(B/c)) sum_j exp(n_j) term_j(c, gamma) with the terms, free numbers and "
    "coordinates of atmofit's models/shapes.py and models/dependence.py; free numbers = "
    "coefficients [channel][number][basis] times basis, the basis a product of the bases in "
    "turbidity, sun and albedo, albedo's running fastest"
)
_DIGITS = 9  # significant; they hold single precision


def to_dict(model: SkyModel) -> dict[str, Any]:
    """The model, and the hash of its coefficients."""
    coefficients = _rounded(np.asarray(model.coefficients, float))
    d = model.dependence
    bases = {axis: dataclasses.asdict(getattr(d, axis)) for axis in ("turbidity", "sun", "albedo")}
    return {
        "form": FORM,
        "channels": {
            "wavelength_nm": list(model.wavelength_nm),
            "unit": "radiance over solar irradiance, 1/sr",
            "colours": list(COLOURS) if model.colours else [],
            "unit of colours": "cd/m^2",
        },
        "shape": _shape(model.shape),
        "dependence": {
            **bases,
            "turbidity_range": list(d.turbidity_range),
            "latest_sun_deg": d.latest_sun_deg,
            "largest_albedo": d.largest_albedo,
        },
        "sha256": digest(coefficients),
        "coefficients": coefficients.tolist(),
    }


def from_dict(stored: Mapping[str, Any]) -> SkyModel:
    """The model again.

    Raises:
        ValueError: The coefficients are not those that were hashed, or do not fit.
        KeyError: Something is missing.
    """
    coefficients = np.asarray(stored["coefficients"], float)
    if digest(coefficients) != stored["sha256"]:
        raise ValueError("coefficients must be those whose hash is stored, got others")
    d = dict(stored["dependence"])
    bases = [Basis(**d.pop(axis)) for axis in ("turbidity", "sun", "albedo")]
    low, high = d.pop("turbidity_range")
    return SkyModel(
        coefficients,
        _read_shape(stored["shape"]),
        Dependence(*bases, turbidity_range=(low, high), **d),
        tuple(stored["channels"]["wavelength_nm"]),
        bool(stored["channels"]["colours"]),
    )


def digest(coefficients: np.ndarray) -> str:
    """Hash of coefficients with the digits that are stored."""
    text = ",".join(f"{value:.{_DIGITS}g}" for value in coefficients.ravel())
    return hashlib.sha256(text.encode()).hexdigest()


def _shape(shape: AnyShape) -> dict[str, Any]:
    own = {"cie_type": shape.sky_type} if isinstance(shape, CIEShape) else {"terms": shape.terms}
    return own | {"numbers": list(shape.names)}


def _read_shape(stored: Mapping[str, Any]) -> AnyShape:
    return CIEShape(stored["cie_type"]) if "cie_type" in stored else Shape(tuple(stored["terms"]))


def _rounded(values: np.ndarray) -> np.ndarray:
    flat = [float(f"{value:.{_DIGITS}g}") for value in values.ravel()]
    return np.asarray(flat).reshape(values.shape)


def _shipped(name: str) -> SkyModel:
    path = Path(__file__).with_name(name)
    return from_dict(json.loads(path.read_text(encoding="utf-8")))


ATMOFIT_2026 = _shipped("atmofit_2026.json")

_CLEAR = {"turbidity": 3.0, "solar_zenith_angle": 1.0, "view_zenith_angle": 0.8, "azimuth": 1.0}
extremes(
    Case("at the sun", _CLEAR | {"view_zenith_angle": 1.0, "azimuth": 0.0}),
    Case("horizon at sunset", {"view_zenith_angle": HORIZON, "solar_zenith_angle": HORIZON}),
    Case("everything overhead", {"view_zenith_angle": 0.0, "solar_zenith_angle": 0.0}),
    Case("twilight", {"solar_zenith_angle": math.radians(92.0), "azimuth": math.pi}),
    call=lambda turbidity, solar_zenith_angle, view_zenith_angle, azimuth, albedo: ATMOFIT_2026.XYZ(
        turbidity, solar_zenith_angle, Directions(view_zenith_angle[None], azimuth[None]), albedo
    ),
    turbidity=Domain(*ATMOFIT_2026.turbidity_range),
    solar_zenith_angle=Domain(0.0, math.radians(ATMOFIT_2026.dependence.latest_sun_deg)),
    view_zenith_angle=Domain(0.0, HORIZON),
    azimuth=Domain(-math.inf, math.inf),
    albedo=Domain(0.0, ATMOFIT_2026.dependence.largest_albedo),
)(SkyModel)
