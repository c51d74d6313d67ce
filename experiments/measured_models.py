"""What the models of atmofit say about the measured skies."""

from pathlib import Path

import numpy as np
from measured_data import Prediction, Skies, luminance, read_npz

import atmofit as af

ANGSTROM_EXPONENT = 1.3  # of the haze that the 1999 paper's turbidity stands for


def turbidity_from_optical_depth(optical_depth: float) -> float:
    """Turbidity of the 1999 paper for an aerosol optical depth at 550 nm.

    References:
        Preetham et al. (1999), appendix A.1: beta = 0.04608 T - 0.04586, with beta the optical
        depth at 1 um of a haze whose Angstrom exponent is 1.3.
    """
    beta = optical_depth * 0.55**ANGSTROM_EXPONENT
    return (beta + 0.04586) / 0.04608


def analytic(name: str, model: af.PreethamModel, turbidity: float, skies: Skies) -> Prediction:
    """An analytic model of luminance and chromaticity at one turbidity."""
    xyY = np.stack(
        [
            np.asarray(model(turbidity, sun, directions))
            for sun, directions in zip(skies.solar_zenith_angle, skies.directions, strict=True)
        ]
    )
    return Prediction(name, daylight_spectrum(xyY, skies.wavelength_nm), xyY[..., 2])


def daylight_spectrum(xyY: np.ndarray, wavelength_nm: np.ndarray) -> np.ndarray:
    """The daylight spectrum (CIE D series) of a chromaticity, scaled to the luminance.

    Extreme chromaticities give values below 0, which are kept.

    Args:
        xyY: [..., 3], Y in cd m^-2.
        wavelength_nm: 300 to 830 [nm].

    Returns:
        [..., wavelength], W m^-2 sr^-1 nm^-1.

    References:
        Preetham et al. (1999), appendix A.5 (the scaling to luminance is ours, the paper states
        none); the basis functions at all 40 wavelengths come from colour-science.
    """
    import colour  # takes seconds

    basis = colour.colorimetry.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    mean, first, second = (
        np.interp(wavelength_nm, basis[name].wavelengths, basis[name].values)
        for name in ("S0", "S1", "S2")
    )
    x, y, Y = (xyY[..., k, None] for k in range(3))
    share = 0.0241 + 0.2562 * x - 0.7341 * y
    M1 = (-1.3515 - 1.7703 * x + 5.9114 * y) / share
    M2 = (0.0300 - 31.4424 * x + 30.0717 * y) / share
    spectrum = mean + M1 * first + M2 * second
    return spectrum * Y / luminance(spectrum, wavelength_nm)[..., None]


def free_perez(skies: Skies) -> Prediction:
    """Five free coefficients and a scale for each scan: the best that the formula can do.

    Luminance and every wavelength are fitted apart, so the spectral figure is that of 40 fits.
    """
    values = np.concatenate([skies.luminance[..., None], skies.radiance], axis=-1)
    scale = values.mean(axis=1, keepdims=True)
    fitted = scale * np.stack(
        [
            np.asarray(
                af.fit_perez(directions, sun, scan.T).predict(directions, sun).T  # quantity first
            )
            for directions, sun, scan in zip(
                skies.directions, skies.solar_zenith_angle, values / scale, strict=True
            )
        ]
    )
    return Prediction("perez_free", fitted[..., 1:], fitted[..., 0])


def regenerated_model(coefficients: Path | None) -> af.PreethamModel:
    """The model that `atmofit refit` wrote; without a file, that of a fresh refit."""
    return af.refit().model if coefficients is None else af.read_coefficients(coefficients)


def site_atmosphere(folder: Path) -> tuple[af.Atmosphere, af.Spectrum]:
    """The atmosphere that the codes were given in the 2013 comparison, and its solar irradiance.

    Raises:
        DataMissing: The file is absent.
    """
    given = read_npz(folder, "reference/bruneton2016_atmosphere.npz")
    wavelength_nm = given["wavelength_nm"]
    molecules = given["rayleigh_scattering_per_m"] * given["H_rayleigh"]
    haze = given["mie_extinction_per_m"] * given["H_mie"]
    atmosphere = af.Atmosphere(
        molecules=af.Molecules(
            optical_depth=af.Spectrum(wavelength_nm, molecules, smooth=True),
            scale_height=float(given["H_rayleigh"]),
        ),
        haze=af.Haze(
            optical_depth=af.Spectrum(wavelength_nm, haze, smooth=True),
            scale_height=float(given["H_mie"]),
            single_scattering_albedo=float(
                given["mie_scattering_per_m"][0] / given["mie_extinction_per_m"][0]
            ),
            phase=af.CornetteShanks(float(given["mie_g"])),
        ),
        ground=af.Ground(af.Spectrum(wavelength_nm, given["ground_albedo"])),
        radius=float(given["earth_radius_m"]),
    )
    return atmosphere, af.Spectrum(wavelength_nm, given["solar_irradiance"])


def simulation(
    skies: Skies, atmosphere: af.Atmosphere, solar_irradiance: af.Spectrum, orders: int | str
) -> Prediction:
    """The simulator with the atmosphere of the codes; one field serves all suns."""
    every = np.ones(len(skies.time), bool)
    radiance = simulated_radiance(skies, every, atmosphere, solar_irradiance, orders)
    name = "simulation_all_orders" if orders == "all" else f"simulation_order_{orders}"
    return Prediction(name, radiance, luminance(radiance, skies.wavelength_nm))


def simulated_radiance(
    skies: Skies,
    scans: np.ndarray,
    atmosphere: af.Atmosphere,
    solar_irradiance: af.Spectrum,
    orders: int | str,
) -> np.ndarray:
    """Radiance [scan, direction, wavelength] of the scans that are chosen [boolean] by the mask."""
    field = af.solve_sky(atmosphere, skies.wavelength_nm, orders=orders)
    return np.stack(
        [
            np.asarray(
                field.radiance(
                    skies.solar_zenith_angle[scan],
                    skies.directions[scan],
                    solar_irradiance=solar_irradiance,
                )
            )
            for scan in np.flatnonzero(scans)
        ]
    )
