"""The reference radiances: where they lie, and their rows."""

import csv

import numpy as np
import pytest
from measured_data import data_folder

import atmofit as af


def needs(name: str) -> pytest.MarkDecorator:
    """Skip where a file of the reference radiances is absent."""
    path = data_folder() / "reference" / name
    return pytest.mark.skipif(
        not path.is_file(),
        reason=f"{name} absent: set ATMOFIT_DATA to the folder that holds reference/{name}",
    )


def groups(name: str) -> dict[tuple[str, float], dict[str, np.ndarray]]:
    """Columns of each (case, solar zenith angle [degrees]); an empty cell is NaN."""
    with (data_folder() / "reference" / name).open() as file:
        rows = list(csv.DictReader(file))
    found: dict[tuple[str, float], list[dict[str, str]]] = {}
    for row in rows:
        found.setdefault((row["case"], float(row["sun_zenith"])), []).append(row)
    return {
        key: {
            name: np.array([float(row[name] or "nan") for row in some])
            for name in some[0]
            if name != "case"
        }
        for key, some in found.items()
    }


def directions(columns: dict[str, np.ndarray]) -> af.Directions:
    """Directions of a group's rows."""
    return af.Directions(np.radians(columns["view_zenith"]), np.radians(columns["rel_azimuth"]))
