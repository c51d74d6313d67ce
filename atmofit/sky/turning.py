"""How light that is known against the local sun is seen from elsewhere on the planet.

Light is kept by azimuth mode m and local solar zenith angle: f = sum of (2 - delta_m0) cos(m phi)
A_m(chi). Along a ray of azimuth phi both the local sun's zenith angle and the ray's azimuth from it
turn. For an angle psi at the planet's centre that is a linear map of A, the same for all rays.
"""

import functools

import numpy as np

from atmofit.sky.sun_angles import SunRange, sun_basis, sun_nodes

# The angle at the centre at which the map is exact: a level ray turns so far in 330 km.
_ANGLE = np.radians(3.0)
_AZIMUTHS = 48


@functools.cache
def turning_matrices(
    modes: int, suns: int, local_suns: SunRange
) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """The map's coefficients of the angle and of its square.

    To turn by less than nothing is to turn along the opposite azimuth, which changes the sign of
    odd modes: so the angle couples modes of different parity, and its square those of the same.

    Args:
        modes: Azimuth modes, two at least.
        suns: Solar zenith angles, at the nodes of `sun_nodes`.
        local_suns: Their range [rad]; light beyond it is taken as at its ends.

    Returns:
        For even and for odd modes of the result: from the light of the other parity weighted with
        the angle, and from that of the same weighted with its square, to what they add,
        [mode * sun, mode * sun].
    """
    size = modes * suns
    change = _at(_ANGLE, modes, suns, local_suns) - np.eye(size)
    change = change.reshape(modes, suns, modes, suns)

    def coupled(to: int, of: int, power: int) -> np.ndarray:
        part = change[to::2, :, of::2]
        rows, columns = part.shape[0] * suns, part.shape[2] * suns
        return np.ascontiguousarray(part.reshape(rows, columns).T) / _ANGLE**power

    return tuple((coupled(p, 1 - p, 1), coupled(p, p, 2)) for p in (0, 1))


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
