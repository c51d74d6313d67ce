"""Files: coefficients as JSON, skies as netCDF; written whole or not at all."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from atmofit.files import output_folder, readable_file, replace_file
from atmofit.fit import identifiability_words, verdict
from atmofit.fit.refit import RefitResult
from atmofit.fit.skies import QUANTITIES, RefitSettings
from atmofit.fit.training import TrainedModel
from atmofit.models import stored as stored_models
from atmofit.models.preetham import PreethamModel
from atmofit.models.sky_model import SkyModel
from atmofit.provenance import versions

_DISTRIBUTION = {
    "x": "x_distribution",
    "y": "y_distribution",
    "Y": "luminance_distribution",
}
_ZENITH = {"x": "zenith_x", "y": "zenith_y", "Y": "zenith_luminance"}


def coefficients_to_dict(result: RefitResult) -> dict[str, Any]:
    """Every fitted number with its standard error, the settings, versions and comparisons."""
    return {
        "form": "Preetham, Shirley and Smits (1999), appendix A.2; angles in rad, Y in kcd m^-2",
        "turbidity_range": list(result.model.turbidity_range),
        "distribution": {
            q: {
                name: {
                    term: _number(fit.matrix[row, column], fit.standard_error[row, column])
                    for column, term in enumerate(("slope", "intercept"))
                }
                for row, name in enumerate("ABCDE")
            }
            for q, fit in result.distributions.items()
        },
        "zenith": {
            q: _numbers(np.asarray(fit.coefficients), np.asarray(fit.standard_error))
            for q, fit in result.zeniths.items()
        },
        "verdict": verdict.to_dict(result),
        "identifiability": identifiability_words.to_dict(result.identifiability),
        "quality": {q: _quality(result, q) for q in QUANTITIES},
        "prior": {
            "strength": float(result.distributions["Y"].prior.strength),
            "centre": result.distributions["Y"].prior.centre.tolist(),
            "width": result.distributions["Y"].prior.width.tolist(),
        },
        "comparison": {c.name: c.summary() for c in result.comparisons},
        "settings": dataclasses.asdict(result.skies.settings),
        "seconds": result.seconds,
        "versions": versions(),
    }


def write_coefficients(result: RefitResult, path: Path) -> Path:
    """Write `coefficients_to_dict` as JSON."""
    text = json.dumps(coefficients_to_dict(result), indent=1)
    return replace_file(path, lambda name: _write_text(name, text))


def read_coefficients(path: Path) -> PreethamModel:
    """Read a model that `write_coefficients` wrote.

    Raises:
        ValueError: The file is absent, or is not such a file.
    """
    return _read(path)[0]


def read_settings(path: Path) -> RefitSettings:
    """Read what a model was fitted to from the file that `write_coefficients` wrote.

    Raises:
        ValueError: The file is absent, or is not such a file.
    """
    return _read(path)[1]


def _read(path: Path) -> tuple[PreethamModel, RefitSettings]:
    """The model and the settings of a coefficients file."""
    path = readable_file(path)
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        matrices = {
            _DISTRIBUTION[q]: [
                [stored["distribution"][q][name][term]["value"] for term in ("slope", "intercept")]
                for name in "ABCDE"
            ]
            for q in QUANTITIES
        } | {_ZENITH[q]: _values(stored["zenith"][q]) for q in QUANTITIES}
        settings: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in stored["settings"].items()
        }
        low, high = stored["turbidity_range"]
        return PreethamModel(**matrices, turbidity_range=(low, high)), RefitSettings(**settings)
    except OSError as error:
        raise ValueError(f"file must exist, got {str(path)!r} ({error.strerror})") from error
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(
            f"file must be a coefficients.json of atmofit refit, got {str(path)!r} ({error})"
        ) from error


def write_sky_model(trained: TrainedModel, path: Path) -> Path:
    """Write a trained model with what it was made from and how well it fits, as JSON."""
    fit, skies = trained.fit, trained.skies
    made = {
        "settings": dataclasses.asdict(skies.settings),
        "seconds": trained.seconds,
        "versions": versions(),
        "fit": {
            name: np.asarray(getattr(fit, name)).tolist()
            for name in ("rms", "largest", "converged", "steps", "start_loss", "standard_error")
        },
    }
    text = json.dumps(stored_models.to_dict(trained.model) | {"made": made})
    return replace_file(path, lambda name: _write_text(name, text))


def read_sky_model(path: Path) -> SkyModel:
    """Read a model that `write_sky_model` wrote.

    Raises:
        ValueError: The file is absent, or is not such a file.
    """
    path = readable_file(path)
    try:
        return stored_models.from_dict(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ValueError(f"file must exist, got {str(path)!r} ({error.strerror})") from error
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"file must be a sky_model.json of atmofit refit, got {str(path)!r} ({error})"
        ) from error


def write_source(model: SkyModel, language: str, path: Path, name: str) -> Path:
    """Write a sky model as source code, or as JSON.

    Args:
        model: What to write, with the channels it has.
        language: "c", "glsl", "hlsl", "python" or "json".
        path: File to write; its folder is made.
        name: Of the function.

    Raises:
        ValueError: An unknown language, a name that is no identifier, or a folder that cannot be
            written.
        ImportError: sympy (extra `export`) is missing.
    """
    if language == "json":
        text = json.dumps(stored_models.to_dict(model))
    else:
        from atmofit.export.languages import source_code  # sympy is optional

        text = source_code(model, language, name).rstrip("\n")
    output_folder(path.parent)
    return replace_file(path, lambda temporary: _write_text(temporary, text))


def write_dataset(result: RefitResult, path: Path) -> Path:
    """Write a result's dataset as netCDF (h5netcdf)."""
    dataset = result.dataset
    packed = {name: {"zlib": True, "complevel": 4} for name in dataset.data_vars}
    return replace_file(
        path, lambda name: dataset.to_netcdf(name, engine="h5netcdf", encoding=packed)
    )


def _quality(result: RefitResult, quantity: str) -> dict[str, Any]:
    """How well a quantity was fitted, and how far its parameters are determined."""
    joint, single = result.distributions[quantity], result.single_skies[quantity]
    zenith = result.zeniths[quantity]
    return {
        "weighting": joint.weighting,
        "distribution": _statistics(joint) | {"steps": int(np.asarray(joint.steps))},
        "zenith": {
            "rms": float(zenith.rms),
            "largest": float(zenith.largest),
            "condition_number": float(zenith.condition_number),
        },
        "single_skies": _statistics(single) | {"skies": int(np.size(single.rms))},
    }


def _statistics(fit: Any) -> dict[str, Any]:
    """Statistics of one fit, or the worst of many."""
    return {
        "converged": bool(np.all(fit.converged)),
        "rms": float(np.sqrt(np.mean(np.square(fit.rms)))),
        "largest": float(np.max(fit.largest)),
        "condition_number": float(np.max(fit.condition_number)),
    }


def _number(value: Any, standard_error: Any) -> dict[str, float]:
    return {"value": float(value), "standard_error": float(standard_error)}


def _numbers(values: np.ndarray, standard_errors: np.ndarray) -> list[Any]:
    """Nested lists of `_number`."""
    if values.ndim == 0:
        raise TypeError("a list of numbers is needed, got one number")
    if values.ndim == 1:
        return [_number(*pair) for pair in zip(values, standard_errors, strict=True)]
    return [_numbers(*pair) for pair in zip(values, standard_errors, strict=True)]


def _values(numbers: list[Any]) -> list[Any]:
    """The values of nested lists of `_number`."""
    return [item["value"] if isinstance(item, dict) else _values(item) for item in numbers]


def _write_text(path: Path, text: str) -> None:
    path.write_text(text + "\n", encoding="utf-8")
