"""How light that is known against the local sun is seen from elsewhere on the planet.

Light is kept by azimuth mode m and local solar zenith angle: f = sum of (2 - delta_m0) cos(m phi)
A_m(chi). Along a ray of azimuth phi both the local sun's zenith angle and the ray's azimuth from it
turn. For an angle psi at the planet's centre that is a linear map of A, the same for all rays.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from atmofit.sky.sun_angles import SunRange, sun_basis, sun_nodes

_ANGLE = np.radians(3.0)  # at the centre, at which the map is exact: a level ray turns so in 330 km
_TWILIGHT_ANGLES = np.radians([1.5, 4.5])  # likewise, where light comes from far
_TWILIGHT_FROM = np.radians(102.0)  # largest local sun, above which the observer's may be down
_AZIMUTHS = 48
_TURNED = 2 / 3  # of the modes by day; to turn the others too changes 1e-4 of the light (rung 2e-3)


class Turn(NamedTuple):
    """What light that was turned by an angle adds to the light of some modes.

    Attributes:
        of: Parity of the modes that are turned, 0 or 1.
        power: Of the angle that they are weighted with, 1 or 2.
        matrix: From [mode * sun] to [mode * sun].
    """

    of: int
    power: int
    matrix: np.ndarray


@functools.cache
def turns(modes: int, suns: int, local_suns: SunRange) -> tuple[tuple[Turn, ...], ...]:
    """The map in powers of the angle.

    To turn by less than nothing is to turn along the opposite azimuth, which changes the sign of
    odd modes: so the angle couples modes of different parity, and its square those of the same.
    By day that is enough, and the highest modes are left as they are. In twilight light changes so
    fast with the sun that the map is a parabola through two angles, for all modes.

    Args:
        modes: Azimuth modes, two at least.
        suns: Solar zenith angles, at the nodes of `sun_nodes`.
        local_suns: Their range [rad]; light beyond it is taken as at its ends.

    Returns:
        Those that add to even modes, and to odd ones, the first of each.
    """
    by_day = local_suns[1] <= _TWILIGHT_FROM
    if by_day:
        modes = math.ceil(_TURNED * modes)

    def change(angle: float) -> np.ndarray:
        matrix = _at(angle, modes, suns, local_suns) - np.eye(modes * suns)
        return matrix.reshape(modes, suns, modes, suns)

    def turn(to: int, of: int, power: int, coefficient: np.ndarray) -> Turn:
        part = coefficient[to::2, :, of::2]
        rows, columns = part.shape[0] * suns, part.shape[2] * suns
        return Turn(of, power, np.ascontiguousarray(part.reshape(rows, columns).T))

    if by_day:
        by_angle = change(_ANGLE)
        first, second = by_angle / _ANGLE, by_angle / _ANGLE**2
        return tuple((turn(p, 1 - p, 1, first), turn(p, p, 2, second)) for p in (0, 1))
    a, b = _TWILIGHT_ANGLES.tolist()
    at_a, at_b = change(a) / a, change(b) / b
    second = (at_b - at_a) / (b - a)
    first = at_a - second * a
    return tuple(
        tuple(turn(p, of, 1 + k, (first, second)[k]) for of in (0, 1) for k in (0, 1))
        for p in (0, 1)
    )


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
