"""How light that is known against the local sun is seen from elsewhere on the planet.

Light is kept by azimuth mode m and local solar zenith angle: f = sum of (2 - delta_m0) cos(m phi)
A_m(chi). Along a ray of azimuth phi both the local sun's zenith angle and the ray's azimuth from it
turn. For an angle psi at the planet's centre that is a linear map of A, the same for all rays.
"""

import functools

import numpy as np

from atmofit.sky.sun_angles import SunRange, sun_basis, sun_nodes

# Angles at the centre at which the map is exact; between them it is a parabola.
_ANGLES = (0.0, np.radians(1.5), np.radians(4.5))
_AZIMUTHS = 48


@functools.cache
def turning_matrix(modes: int, suns: int, local_suns: SunRange) -> np.ndarray:
    """The map's first and second coefficient in powers of the angle.

    Args:
        modes: Azimuth modes.
        suns: Solar zenith angles, at the nodes of `sun_nodes`.
        local_suns: Their range [rad]; light beyond it is taken as at its ends.

    Returns:
        [2, mode, sun, mode, sun]: from the angle-weighted light (the last two axes) to what it
        adds to the light that arrives.
    """
    maps = np.stack([_at(angle, modes, suns, local_suns) for angle in _ANGLES[1:]])
    change = maps - np.eye(modes * suns)[None]
    a, b = _ANGLES[1:]
    # change(psi) = first psi + second psi^2 through both angles.
    second = (change[1] / b - change[0] / a) / (b - a)
    first = change[0] / a - second * a
    return np.stack([first, second]).reshape(2, modes, suns, modes, suns)


def _at(angle: float, modes: int, suns: int, local_suns: SunRange) -> np.ndarray:
    """[mode sun, mode sun] of one angle."""
    sun = sun_nodes(suns, local_suns)[:, None]
    azimuth = (np.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS)[None, :]
    up = np.cos(sun) * np.cos(angle) + np.sin(sun) * np.cos(azimuth) * np.sin(angle)
    along = np.sin(sun) * np.cos(azimuth) * np.cos(angle) - np.cos(sun) * np.sin(angle)
    aside = np.sin(sun) * np.sin(azimuth)
    there = np.arctan2(np.hypot(along, aside), up)
    of_sun = sun_basis(np.clip(there, *local_suns), suns, local_suns)
    phi = np.arctan2(aside, along)
    order = np.arange(modes)
    twice = np.where(order > 0, 2.0, 1.0)
    seen = np.cos(order * phi[..., None]) * twice
    onto = np.cos(order[:, None] * azimuth[0]) / _AZIMUTHS
    return np.einsum("ka,san,sau->ksnu", onto, seen, of_sun).reshape(modes * suns, modes * suns)
