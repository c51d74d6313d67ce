"""The clear air over a continent: real molecules, a typical haze, ozone and a grey ground."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from atmofit.checks import in_range
from atmofit.constants import (
    MAXIMUM_TURBIDITY,
    MINIMUM_TURBIDITY,
    REFERENCE_WAVELENGTH_NM,
)
from atmofit.extremes import Case, Domain, extremes
from atmofit.optics.air import rayleigh_optical_depth
from atmofit.optics.atmosphere import Atmosphere, Ground
from atmofit.optics.gases import LARGEST_OZONE_DOBSON, Absorber
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import Molecules
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.spectrum import Spectrum, at
from atmofit.tables import constant, preetham1999_spectra
from atmofit.typing import Reals, RealsLike, Scalar

_LONGEST_NM = (349.0, 831.0)  # the table of ozone is continued with 0 to here


def continental_air(
    turbidity: RealsLike,
    albedo: RealsLike | None = 0.2,
    ozone_dobson: RealsLike | None = 300.0,
    angstrom_exponent: RealsLike = 1.3,
    single_scattering_albedo: RealsLike = 0.925,
    asymmetry: RealsLike = 0.703,
    scale_height: RealsLike | None = None,
) -> Atmosphere:
    """Clear air under the standard sun, with a haze that is typical over land.

    The haze is the "continental average" of the OPAC collection: its single-scattering albedo and
    asymmetry at 550 nm and 80 % humidity, and an Angstrom exponent between its two.

    Args:
        turbidity: Optical depth of air with haze over that of air alone at 550 nm, 1 to 64.
        albedo: Of a grey ground, 0 to 1; None: black, and not computed.
        ozone_dobson: Vertical amount of ozone, 0 to 1000 [DU]. Its table is 0 at its ends, 380 and
            780 nm, and is continued with 0, which confines the wavelengths to 349 to 831 nm.
            None: no ozone.
        angstrom_exponent: Of the haze, like the others, -5 to 5.
        single_scattering_albedo: 0 to 1.
        asymmetry: Of its Henyey-Greenstein phase function, -1 to 1.
        scale_height: 1 to 30,000 [m]; None: that of the 1999 paper's haze.

    Raises:
        ValueError: A value lies outside its range.

    References:
        Hess, Koepke and Schult (1998), Bull. Am. Meteorol. Soc. 79, 831, table 4.
    """
    T = in_range("turbidity", turbidity, MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY)
    haze = Haze(
        (T - 1) * rayleigh_optical_depth(REFERENCE_WAVELENGTH_NM),
        angstrom_exponent,
        1 / constant("haze_decay") if scale_height is None else scale_height,
        single_scattering_albedo,
        HenyeyGreenstein(asymmetry),
    )
    return Atmosphere(
        Molecules.standard(),
        haze,
        () if ozone_dobson is None else (_ozone(ozone_dobson),),
        None if albedo is None else Ground(albedo),
        preset="standard",
    ).checked()


def _ozone(column_dobson: RealsLike) -> Absorber:
    gas = Absorber.ozone(column_dobson)
    assert isinstance(gas.optical_depth, Spectrum)
    first, last = _LONGEST_NM
    nodes = np.concatenate([[first], preetham1999_spectra().wavelength_nm, [last]])
    depth = Spectrum(nodes, jnp.pad(gas.optical_depth.values, 1))
    return dataclasses.replace(gas, optical_depth=depth)


def _parts(turbidity: Scalar, albedo: Scalar, ozone_dobson: Scalar) -> Reals:
    """Optical depths of haze and ozone at 550 nm, and what the ground reflects."""
    air = continental_air(turbidity, albedo, ozone_dobson)
    assert air.haze is not None
    assert air.ground is not None
    λ = jnp.full(1, REFERENCE_WAVELENGTH_NM, turbidity.dtype)
    depths = [air.haze.optical_depth_at(λ), air.absorbers[0].optical_depth_at(λ)]
    return jnp.concatenate([*depths, at(air.ground.albedo, λ)])


extremes(
    Case(
        "nothing but air",
        {"turbidity": 1.0, "albedo": 0.0, "ozone_dobson": 0.0},
        limit=(0.0, 0.0, 0.0),
    ),
    call=_parts,
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    albedo=Domain(0.0, 1.0),
    ozone_dobson=Domain(0.0, LARGEST_OZONE_DOBSON),
)(continental_air)
