"""Simulated skies as an xarray dataset, with units and provenance."""

import dataclasses
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from atmofit.fit.skies import QUANTITIES, SimulatedSkies
from atmofit.provenance import versions

if TYPE_CHECKING:
    import xarray


def to_dataset(skies: SimulatedSkies, residuals: np.ndarray) -> "xarray.Dataset":
    """Simulated skies and a model's residuals, with units and provenance.

    Args:
        skies: What was simulated.
        residuals: Model minus simulation, x, y and Y, [turbidity, sun, direction, 3].
    """
    import xarray

    settings = skies.settings
    view, azimuth = (np.asarray(angle) for angle in skies.directions.angles())
    sky = ("turbidity", "solar_zenith_angle", "direction")
    radiance_unit = {"units": "W m-2 sr-1 nm-1", "long_name": "sky radiance at the ground"}
    variables: dict[str, Any] = {
        "radiance": ((*sky, "wavelength"), skies.radiance, radiance_unit),
        "view_zenith_angle": ("direction", view, {"units": "rad", "long_name": "0 overhead"}),
        "relative_azimuth": ("direction", azimuth, {"units": "rad", "long_name": "0 to the sun"}),
    }
    for index, name in enumerate(QUANTITIES):
        unit = "cd m-2" if name == "Y" else "1"
        label = "luminance" if name == "Y" else f"chromaticity_{name}"
        variables[label] = (sky, skies.xyY[..., index], {"units": unit})
        residual = residuals[..., index]
        note = "regenerated model minus simulation"
        variables[f"{label}_residual"] = (sky, residual, {"units": unit, "long_name": note})
    coordinates = {
        "turbidity": ("turbidity", np.asarray(settings.turbidity), {"units": "1"}),
        "solar_zenith_angle": (
            "solar_zenith_angle",
            settings.solar_zenith_angle,
            {"units": "rad"},
        ),
        "wavelength": ("wavelength", np.asarray(settings.wavelength_nm), {"units": "nm"}),
    }
    provenance = {
        "title": "Clear skies simulated by atmofit",
        "settings": json.dumps(dataclasses.asdict(settings)),
        "versions": json.dumps(versions()),
        "plan": str(settings.plan()),
    }
    return xarray.Dataset(variables, coordinates, provenance)
