"""Observations from files: tables in CSV, netCDF, and the scans of Kider et al. (2014)."""

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from atmofit.files import LARGEST_ARRAYS, readable_arrays, readable_file
from atmofit.geometry import Directions
from atmofit.observe.observation import Observation

RELATIVE_NOISE = 0.02  # where a file does not say: the repeatability of a good scan
SUFFIXES = (".csv", ".nc", ".npz")
_PER_NM = "radiance_"
_COLOURS = {"XYZ": ("X", "Y", "Z"), "linear_sRGB": ("R", "G", "B")}
# The first direction of every scan of 2013 is faulty.
_FAULTY = 0
_FULL_TURN = 360.0

Columns = Mapping[str, np.ndarray]


def read_observations(
    path: Path | str,
    *,
    solar_zenith_deg: float | None = None,
    relative_noise: float | None = None,
    spectral: bool = False,
    wavelength_nm: tuple[float, ...] | None = None,
) -> list[Observation]:
    """Measured skies from a file.

    A table (CSV, or netCDF whose variables have one dimension "direction") has a row for each
    direction, with the columns view_zenith_deg; relative_azimuth_deg, or azimuth_deg and
    sun_azimuth_deg; sun_zenith_deg, the same in every row; and luminance_cd_m2, or X, Y, Z, or R,
    G, B (linear sRGB), or radiance_NNN [W m^-2 sr^-1 nm^-1] for wavelengths NNN nm. Optional:
    relative_noise; used (0: the row is left out); scan (rows of several skies). netCDF may hold
    `radiance` with dimensions direction and wavelength_nm instead. Rows whose value is missing,
    not a number or not above 0 are left out.

    The scans of Kider et al. are read from their scans.npz, without the faulty first direction.

    Args:
        path: File; its suffix is .csv, .nc or .npz.
        solar_zenith_deg: For tables without such a column [degree].
        relative_noise: For tables without such a column, and for the scans; None: 0.02.
        spectral: Of the scans, spectra instead of the luminances.
        wavelength_nm: Of these spectra, between which they are interpolated; None: 400 to 700 nm
            by 20 nm. What a table has is taken as it is.

    Returns:
        One observation for each sky.

    Raises:
        ValueError: The file is absent, of another kind, or lacks a column; the message names it.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"file must end in {', '.join(SUFFIXES)}, got {str(path)!r}")
    readable_file(path)
    noise = RELATIVE_NOISE if relative_noise is None else relative_noise
    if path.suffix.lower() == ".npz":
        λ = tuple(float(x) for x in range(400, 701, 20)) if wavelength_nm is None else wavelength_nm
        return _guarded(path, lambda: _read_scans(path, noise, λ if spectral else None))
    read = _read_csv if path.suffix.lower() == ".csv" else _read_netcdf
    columns = _guarded(path, lambda: read(path))
    return [_observation(path, one, solar_zenith_deg, noise) for one in _by_scan(columns)]


def _guarded(path: Path, read: Callable[[], Any]) -> Any:
    """What a reader returns; whatever it cannot read is one clear error."""
    try:
        return read()
    except (OSError, KeyError, TypeError, ValueError, EOFError, BadZipFile, csv.Error) as error:
        raise ValueError(f"file must be a table of a sky, got {str(path)!r} ({error})") from error


def _read_csv(path: Path) -> Columns:
    with path.open(newline="", encoding="utf-8-sig") as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    if not rows:
        raise KeyError("it has no rows")
    return {
        name.strip(): np.array([_number(row.get(name)) for row in rows])
        for name in rows[0]
        if name is not None
    }


def _number(text: str | None) -> float:
    """A cell of a table; NaN where it is empty or not a number."""
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def _read_netcdf(path: Path) -> Columns:
    import xarray

    with xarray.open_dataset(path, engine="h5netcdf") as data:
        # Compressed files may hold far more than their size; nothing has been read yet.
        if data.nbytes > LARGEST_ARRAYS:
            raise ValueError(f"it holds {data.nbytes} bytes, more than {LARGEST_ARRAYS}")
        columns: dict[str, np.ndarray] = {}
        count = data.sizes["direction"]
        for name, values in data.variables.items():
            if values.dims == ("direction",):
                columns[str(name)] = np.asarray(values.values, float)
            elif values.dims == ():
                columns[str(name)] = np.full(count, float(values.values))
        if "radiance" in data:
            radiance = data["radiance"].transpose("direction", "wavelength_nm")
            for λ, column in zip(data["wavelength_nm"].values, radiance.values.T, strict=True):
                columns[f"{_PER_NM}{float(λ):g}"] = np.asarray(column, float)
    return columns


def _by_scan(columns: Columns) -> list[Columns]:
    """The rows of each sky, in the order of their first rows."""
    if "scan" not in columns:
        return [columns]
    numbers, first = np.unique(columns["scan"], return_index=True)
    chosen = [columns["scan"] == number for number in numbers[np.argsort(first)]]
    return [{name: values[rows] for name, values in columns.items()} for rows in chosen]


def _observation(
    path: Path, columns: Columns, solar_zenith_deg: float | None, noise: float
) -> Observation:
    """One sky of a table."""

    def need(*names: str) -> np.ndarray:
        for name in names:
            if name in columns:
                return columns[name]
        raise ValueError(f"file must have a column {' or '.join(names)}, got {str(path)!r}")

    sun = columns.get("sun_zenith_deg")
    if sun is None:
        if solar_zenith_deg is None:
            raise ValueError(
                f"solar_zenith_deg must be given for a file without sun_zenith_deg: {str(path)!r}"
            )
        sun = np.full(len(need("view_zenith_deg")), float(solar_zenith_deg))
    if np.ptp(sun) > 0:
        raise ValueError(f"sun_zenith_deg must be the same in every row of a sky: {str(path)!r}")
    if "relative_azimuth_deg" in columns:
        azimuth = columns["relative_azimuth_deg"]
    else:
        azimuth = need("relative_azimuth_deg", "azimuth_deg") - need("sun_azimuth_deg")
    values, λ, channels = _values(path, columns)
    view = need("view_zenith_deg")
    good = np.isfinite(values) & (values > 0)
    used = (good if good.ndim == 1 else good.all(axis=1)) & np.isfinite(view) & np.isfinite(azimuth)
    if "used" in columns:
        used &= columns["used"] > 0
    own = columns.get("relative_noise")
    given = np.full(values.shape, noise)
    if own is not None:
        own = np.where(np.isfinite(own) & (own > 0), own, noise)
        given = own if values.ndim == 1 else np.repeat(own[:, None], values.shape[1], axis=1)
    return Observation(
        directions=Directions(
            np.radians(np.where(np.isfinite(view), view, 0.0)),
            np.radians(np.where(np.isfinite(azimuth), azimuth, 0.0)),
        ),
        values=values,
        solar_zenith_angle=float(np.radians(sun[0])),
        relative_noise=given,
        wavelength_nm=λ,
        channels=channels,
        mask=used,
    )


def _values(path: Path, columns: Columns) -> tuple[np.ndarray, tuple[float, ...] | None, str]:
    """Values, their wavelengths if they are spectra, and their channels if not."""
    spectra = sorted(
        (float(name[len(_PER_NM) :]), name) for name in columns if _is_wavelength(name)
    )
    if spectra:
        values = np.stack([columns[name] for _, name in spectra], axis=1)
        return values, tuple(λ for λ, _ in spectra), "luminance"
    if "luminance_cd_m2" in columns:
        return columns["luminance_cd_m2"], None, "luminance"
    for channels, names in _COLOURS.items():
        if set(names) <= set(columns):
            return np.stack([columns[name] for name in names], axis=1), None, channels
    raise ValueError(
        "file must have a column luminance_cd_m2, columns X, Y, Z or R, G, B, or columns "
        f"radiance_NNN, got {str(path)!r} with {', '.join(columns)}"
    )


def _is_wavelength(name: str) -> bool:
    return name.startswith(_PER_NM) and name[len(_PER_NM) :].replace(".", "", 1).isdigit()


def _read_scans(
    path: Path, noise: float, wavelength_nm: tuple[float, ...] | None
) -> list[Observation]:
    """The scans of 2013; the dome stood askew, and each scan's symmetry says where the sun was."""
    with np.load(readable_arrays(path), allow_pickle=False) as arrays:
        scans = {name: arrays[name] for name in arrays.files}
    view = scans["view_zenith_deg"]
    starts = np.flatnonzero(np.diff(view, prepend=-1.0))
    rings = tuple(int(n) for n in np.diff(starts, append=view.size))
    used = np.arange(view.size) != _FAULTY
    found = []
    for k, sun in enumerate(scans["sun_zenith_deg"]):
        if wavelength_nm is None:
            values = scans["luminance_cd_m2"][k]
        else:
            fine, spectra = scans["wavelength_nm"].astype(float), scans["radiance_W_m2_sr_nm"][k]
            values = np.stack(
                [np.interp(wavelength_nm, fine, row.astype(float)) for row in spectra]
            )
        azimuth = scans["view_azimuth_deg"] - scans["sun_azimuth_from_symmetry_deg"][k]
        found.append(
            Observation(
                directions=Directions(
                    np.radians(view), np.radians(np.mod(azimuth, _FULL_TURN)), rings
                ),
                values=values,
                solar_zenith_angle=float(np.radians(sun)),
                relative_noise=noise,
                wavelength_nm=wavelength_nm,
                mask=used,
            )
        )
    return found
