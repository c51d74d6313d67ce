"""Real air above the measured skies: every number was chosen, and is argued for, before its score.

Only the air differs from the atmosphere that the codes were given. Sun, grass and the radius of the
planet stay, so that the difference between the two runs is the air's.

- Molecules: standard air (Bodhaine et al. 1999) at 981 hPa, the standard atmosphere's pressure at
  270 m, about the altitude of the roof. The given air has no altitude.
- Ozone: Van Heuklon (1979), Solar Energy 22, 63, for the site and the day of the year: 368 DU on
  May 27, 323 DU on September 24. The table of `Absorber.ozone` is 0 at both its ends, 380 and
  780 nm, and is continued with 0 to the other wavelengths (two below, four above); that leaves out
  less than 0.005 of optical depth.
- Aerosol: the AERONET retrievals at Egbert, Ontario, on the morning of the May scans (five from
  7:19 to 10:19 local time, 300 km from the site, rural as it is): the means of their optical depth,
  Angstrom exponent and phase function. There is none for September: the same is taken, though
  September is known to have had another.
- Its single-scattering albedo, which the file lacks: Dubovik et al. (2002), J. Atmos. Sci. 59, 590,
  table 1, for Greenbelt (Maryland), the nearest of their sites and kinds.
- Its scale height: 1200 m, as given to the codes.

Left out: water vapour and oxygen (bands from 680 nm on, narrower than the distance of the
wavelengths), nitrogen dioxide, and the distance of the sun (in May its light is 2.6 % weaker than
the mean that the codes were given).
"""

import csv
import dataclasses
from pathlib import Path

import numpy as np
from measured_data import Prediction, Skies, data_file, luminance
from measured_models import simulated_radiance, site_atmosphere

import atmofit as af

RETRIEVALS = "reference/130527_130527_Egbert.pfn"
OZONE_DOBSON = {"may": 368.0, "september": 323.0}
SURFACE_PRESSURE = 98.1e3
RETRIEVED_NM = (440.0, 675.0, 870.0, 1020.0)
SCATTERED_SHARE = (0.98, 0.97, 0.96, 0.95)  # at these wavelengths

NOTE = """\
simulation_all_orders_real_air: molecules of standard air at 981 hPa; ozone 368 DU in May and 323 DU
in September (Van Heuklon 1979); the aerosol that AERONET retrieved on the May morning 300 km away
(optical depth {depth:.3f} at 550 nm, Angstrom exponent {exponent:.2f}, its phase functions) with
the single-scattering albedo of Greenbelt (Dubovik et al. 2002, 0.98 at 440 nm, 0.95 at 1020 nm), in
September too for want of another. Chosen before its score was seen (measured_air.py), and not
changed since."""


@dataclasses.dataclass(frozen=True)
class Retrieved:
    """Aerosol seen by an AERONET station: means over the retrievals of a day.

    Attributes:
        optical_depth: At 550 nm [-].
        angstrom_exponent: From 440 to 870 nm [-].
        scattering_angle: [angle], rad.
        phase_function: Normalised to 4 pi, [angle, wavelength], at 440, 675, 870 and 1020 nm.
    """

    optical_depth: float
    angstrom_exponent: float
    scattering_angle: np.ndarray
    phase_function: np.ndarray


def read_retrievals(folder: Path) -> Retrieved:
    """The aerosol of May 27, 2013 at Egbert.

    Raises:
        DataMissing: The file is absent.
    """
    with data_file(folder, RETRIEVALS).open(newline="") as lines:
        header, *rows = list(csv.reader(lines))[3:]  # three lines of words come first
    table = {name: np.array(column) for name, *column in zip(header, *rows, strict=True)}
    exponent = table["alpha440-870"].astype(float)
    at_440 = table["tau440(measured)"].astype(float)
    angles = [name for name in header if "[" in name]  # such as 1.7100[442nm]
    phase = np.array([table[name].astype(float).mean() for name in angles])
    degrees = np.array([float(name.split("[")[0]) for name in angles])
    count = degrees.size // len(RETRIEVED_NM)
    return Retrieved(
        optical_depth=float(np.mean(at_440 * (550 / 440) ** -exponent)),
        angstrom_exponent=float(exponent.mean()),
        scattering_angle=np.radians(degrees[:count]),
        phase_function=phase.reshape(len(RETRIEVED_NM), count).T,
    )


def real_atmosphere(folder: Path, group: str) -> tuple[af.Atmosphere, af.Spectrum]:
    """The atmosphere of "may" or "september", and the solar irradiance of the codes.

    Raises:
        DataMissing: A file is absent.
    """
    given, solar_irradiance = site_atmosphere(folder)
    assert given.haze is not None
    aerosol = read_retrievals(folder)
    wavelength_nm = np.asarray(solar_irradiance.wavelength_nm)
    share = np.interp(wavelength_nm, RETRIEVED_NM, SCATTERED_SHARE)
    haze = af.Haze(
        optical_depth=aerosol.optical_depth,
        angstrom_exponent=aerosol.angstrom_exponent,
        scale_height=given.haze.scale_height,
        single_scattering_albedo=af.Spectrum(wavelength_nm, share, smooth=True),
        phase=af.TabulatedPhase(aerosol.scattering_angle, aerosol.phase_function, RETRIEVED_NM),
    )
    atmosphere = dataclasses.replace(
        given,
        molecules=af.Molecules.standard(SURFACE_PRESSURE),
        haze=haze,
        absorbers=(_ozone(OZONE_DOBSON[group], wavelength_nm),),
    )
    return atmosphere, solar_irradiance


def real_air(skies: Skies, folder: Path) -> Prediction:
    """The simulator with all orders and real air; one field serves the suns of a month.

    Raises:
        DataMissing: A file is absent.
    """
    radiance = np.full_like(skies.radiance, np.nan)
    for group, scans in skies.groups.items():
        radiance[scans] = simulated_radiance(skies, scans, *real_atmosphere(folder, group), "all")
    name = "simulation_all_orders_real_air"
    return Prediction(name, radiance, luminance(radiance, skies.wavelength_nm))


def describe(folder: Path) -> str:
    """What has to be known to read its score; two numbers are those of the data.

    Raises:
        DataMissing: The file is absent.
    """
    aerosol = read_retrievals(folder)
    return NOTE.format(depth=aerosol.optical_depth, exponent=aerosol.angstrom_exponent)


def _ozone(column_dobson: float, wavelength_nm: np.ndarray) -> af.Absorber:
    """Ozone whose table, 0 at both ends, is continued with 0 to all the wavelengths."""
    gas = af.Absorber.ozone(column_dobson)
    depth = gas.optical_depth
    assert isinstance(depth, af.Spectrum)
    nodes = np.concatenate([wavelength_nm[:1], depth.wavelength_nm, wavelength_nm[-1:]])
    values = np.pad(np.asarray(depth.values), 1)
    return dataclasses.replace(gas, optical_depth=af.Spectrum(nodes, values))
