"""Skies for the tests of the fits: simple physics, so that the Perez formula does not hold them."""

import numpy as np

from atmofit import tables

SUNS = np.radians([*range(0, 81, 8), 87.0])
TURBIDITIES = np.array([2.0, 3.0, 4.0, 5.0, 6.0])


def airmass(zenith_angle):
    """Kasten's formula, as the paper prints it."""
    return 1 / (np.cos(zenith_angle) + 0.15 * (93.885 - np.degrees(zenith_angle)) ** -1.253)


def scattered_xyY(directions):
    """x, y, Y of one uniform layer that scatters once, plus an isotropic rest.

    Molecules and a forward-scattering haze over a black ground. The chromaticities of a low sun
    fall almost in a straight line with the angle from the sun.

    Returns:
        [turbidity, sun, direction, 3].
    """
    view, azimuth = np.asarray(directions.view_zenith_angle), directions.relative_azimuth
    spectra = tables.preetham1999_spectra()
    micrometre = spectra.wavelength_nm[:, None] / 1e3
    curves = 6830 * tables.cie1931_2deg().xyz[::10]
    molecules = 0.008735 * micrometre**-4.08
    skies = []
    for turbidity in TURBIDITIES:
        haze = (0.04608 * turbidity - 0.04586) * micrometre**-1.3
        depth = molecules + haze
        for sun in SUNS:
            cosine = np.cos(view) * np.cos(sun) + np.sin(view) * np.sin(sun) * np.cos(azimuth)
            rayleigh = 3 / (16 * np.pi) * (1 + cosine**2)
            forward = 0.4224 / (4 * np.pi * (1.5776 - 1.52 * cosine) ** 1.5)
            source = (molecules * rayleigh + haze * forward) / depth
            source += -np.expm1(-2 * depth) / (8 * np.pi)
            m, m_sun = airmass(view), airmass(sun)
            x = np.maximum(np.abs(depth * (m_sun - m)), 1e-9)
            escape = np.exp(-depth * np.minimum(m, m_sun)) * -np.expm1(-x) / x
            radiance = spectra.sun_irradiance[:, None] * source * depth * m * escape
            X, Y, Z = curves.T @ radiance
            skies.append(np.stack([X / (X + Y + Z), Y / (X + Y + Z), Y], axis=-1))
    return np.reshape(skies, (TURBIDITIES.size, SUNS.size, view.size, 3))
