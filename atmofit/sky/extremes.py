"""The simulator's extremes: skies on few nodes, which are as fragile as accurate ones."""

import dataclasses
import math
from typing import Any

from atmofit.constants import (
    LARGEST_OPTICAL_DEPTH,
    LARGEST_SCALE_HEIGHT,
    MAXIMUM_TURBIDITY,
    MAXIMUM_WAVELENGTH_NM,
    MINIMUM_TURBIDITY,
    MINIMUM_WAVELENGTH_NM,
    SMALLEST_SCALE_HEIGHT,
)
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.geometry import HORIZON, Directions
from atmofit.optics.air import LARGEST_PRESSURE
from atmofit.optics.atmosphere import LATEST_SUN, Atmosphere, Ground
from atmofit.optics.gases import Absorber
from atmofit.optics.haze import Haze
from atmofit.optics.molecules import Molecules
from atmofit.optics.phase import HenyeyGreenstein
from atmofit.optics.profiles import GaussianLayer, Profile
from atmofit.sky.ladder import Nodes
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import simulate_luminance, simulate_sky
from atmofit.typing import Reals, Scalar

FEW_NODES = Nodes(
    view=8,
    view_second=6,
    altitude=5,
    sun=6,
    polar=4,
    limb=2,
    azimuth=6,
    bend=2,
    path=6,
    degrees=4,
    higher_modes=3,
    higher_degrees=4,
    streams=3,
    steps=2,
    wavelength=4,
    rough=2,
)
_DEPTH = Domain(0.0, LARGEST_OPTICAL_DEPTH)
_HEIGHT = Domain(SMALLEST_SCALE_HEIGHT, LARGEST_SCALE_HEIGHT)
_SHARE = Domain(0.0, 1.0)
_DIRECTION: dict[str, Any] = {
    "solar_zenith_angle": Domain(0.0, HORIZON),
    "view_zenith_angle": Domain(0.0, HORIZON),
    "azimuth": Span(-math.pi, math.pi),
}
_TWILIGHT = _DIRECTION | {"solar_zenith_angle": Domain(0.0, LATEST_SUN)}
_AIR: dict[str, Any] = {
    "air_depth": _DEPTH,
    "air_height": _HEIGHT,
    "haze_depth": _DEPTH,
    "haze_height": _HEIGHT,
    "haze_albedo": _SHARE,
    "asymmetry": Domain(-0.999, 0.999),
}
_CLEAR = {"air_depth": 0.1, "air_height": 8e3, "haze_depth": 0.2, "haze_height": 1.2e3}
_AT_SUN = {"solar_zenith_angle": 0.7, "view_zenith_angle": 0.7, "azimuth": 0.0}
_LEVEL = {"solar_zenith_angle": HORIZON, "view_zenith_angle": HORIZON, "azimuth": 0.0}
_OVERHEAD = {"solar_zenith_angle": 0.0, "view_zenith_angle": 0.0}
_SKIES = (
    Case("clear", _CLEAR),
    Case("clear, at the sun", _CLEAR | _AT_SUN),
    Case("clear, level at the setting sun", _CLEAR | _LEVEL),
    Case("clear, sun overhead", _CLEAR | _OVERHEAD),
    Case("clear, grazing", _CLEAR | {"view_zenith_angle": 1.570, "solar_zenith_angle": 1.5707}),
    Case("nothing in the air", {"air_depth": 0.0, "haze_depth": 0.0}, limit=0.0),
    Case("next to nothing", {"air_depth": 1e-30, "haze_depth": 1e-30}),
    Case("fog", _CLEAR | {"haze_depth": 1e3, "haze_height": 10.0}),
    Case("fog, level at the setting sun", _CLEAR | _LEVEL | {"haze_depth": 1e3}),
    Case("sharp haze at the sun", _CLEAR | _AT_SUN | {"asymmetry": 0.999}),
    Case("sharp haze opposite", _CLEAR | _LEVEL | {"asymmetry": -0.999, "azimuth": math.pi}),
    Case("black haze", _CLEAR | {"haze_albedo": 0.0}),
    Case("one height for all", _CLEAR | {"haze_height": 8e3}),
    Case("haze above the air", _CLEAR | {"air_height": 1.0, "haze_height": 3e4}),
    Case("black haze, no air", {"air_depth": 0.0, "haze_depth": 6.5, "haze_albedo": 0.0}),
    Case(
        "nearly black thick haze, no air",
        {"air_depth": 0.0, "haze_depth": 22.0, "haze_height": 12.0, "haze_albedo": 1e-9},
    ),
    Case(
        "thick low air, no dark haze aloft",
        {"air_depth": 290.0, "air_height": 23.0, "haze_depth": 0.0, "haze_albedo": 5e-4},
    ),
    Case(
        "thin low air, no haze",
        {"air_depth": 3e-4, "air_height": 1.0, "haze_depth": 0.0, "haze_height": 50.0},
    ),
)
_DUSK = (
    Case("clear, end of twilight", _CLEAR | _LEVEL | {"solar_zenith_angle": LATEST_SUN}),
    Case("fog, end of twilight", _CLEAR | {"haze_depth": 1e3, "solar_zenith_angle": LATEST_SUN}),
)
_THIN = Case(
    "thin air overhead, single scattering",
    _OVERHEAD | {"air_depth": 1e-20, "air_height": 8e3, "haze_depth": 0.0},
    limit=1e-20 * 3 / (8 * math.pi),
    slope={"air_depth": 3 / (8 * math.pi)},
    rtol=5e-2,  # the promise of the coarsest rung
)


def _plan(air: Atmosphere, orders: int | str, dtype: str) -> Plan:
    coarse = plan_sky(air, orders=orders, rtol=5e-2, dtype=dtype, all_wavelengths=True)
    return dataclasses.replace(coarse, nodes=FEW_NODES)


def _looked_at(
    air: Atmosphere,
    sun: Scalar,
    view: Scalar,
    azimuth: Scalar,
    orders: int | str,
    wavelength_nm: Scalar | float = 550.0,
) -> Reals:
    """Radiance over solar irradiance at one wavelength in one direction [1/sr]."""
    direction = Directions(view[None], azimuth[None])
    plan = _plan(air, orders, sun.dtype.name)
    return simulate_sky(air, sun, direction, wavelength_nm, solar_irradiance=1.0, plan=plan)


def _sky(
    air_depth: Scalar,
    air_height: Scalar,
    haze_depth: Scalar,
    haze_height: Scalar,
    haze_albedo: Scalar,
    asymmetry: Scalar,
    solar_zenith_angle: Scalar,
    view_zenith_angle: Scalar,
    azimuth: Scalar,
    ground_albedo: Scalar | None = None,
    *,
    geometry: str,
    orders: int | str = 1,
) -> Reals:
    """A sky of molecules and haze over a black or a grey ground."""
    haze = Haze(haze_depth, 1.3, haze_height, haze_albedo, HenyeyGreenstein(asymmetry))
    ground = None if ground_albedo is None else Ground(ground_albedo)
    air = Atmosphere(Molecules(air_depth, air_height), haze, (), ground, geometry)
    return _looked_at(air, solar_zenith_angle, view_zenith_angle, azimuth, orders)


def _layers(
    density: Reals,
    gas_depth: Scalar,
    solar_zenith_angle: Scalar,
    view_zenith_angle: Scalar,
    azimuth: Scalar,
) -> Reals:
    """A tabulated haze under a Gaussian layer of gas."""
    haze = Haze(1.0, profile=Profile((0.0, 1e3, 1001.0, 2e3), density))
    gas = Absorber(gas_depth, GaussianLayer(22e3, 5e3))
    air = Atmosphere(haze=haze, absorbers=(gas,))
    return _looked_at(air, solar_zenith_angle, view_zenith_angle, azimuth, 1)


for _geometry, _cases, _direction in (
    ("flat", _SKIES, _DIRECTION),
    ("pseudo-spherical", _SKIES + _DUSK, _TWILIGHT),
    ("spherical", _SKIES + _DUSK, _TWILIGHT),
):
    extremes(
        *_cases,
        _THIN,
        part=f"order 1, {_geometry}",
        least=0.0,
        call=lambda geometry=_geometry, **at: _sky(**at, geometry=geometry),
        derivative="reverse" if _geometry == "flat" else "forward",
        heavy=_geometry == "pseudo-spherical",
        **_AIR,
        **_direction,
    )(simulate_sky)
    for _orders, _word in ((2, "order 2"), ("all", "all orders")):
        extremes(
            *_cases,
            part=f"{_word}, {_geometry}",
            least=0.0,
            call=lambda geometry=_geometry, orders=_orders, **at: _sky(
                **at, geometry=geometry, orders=orders
            ),
            derivative="forward",
            heavy=True,
            **_AIR,
            **_direction,
            ground_albedo=_SHARE,
        )(simulate_sky)

extremes(
    Case(
        "ultraviolet, end of twilight", {"wavelength_nm": 300.0, "solar_zenith_angle": LATEST_SUN}
    ),
    Case("infrared, end of twilight", {"wavelength_nm": 2500.0, "solar_zenith_angle": LATEST_SUN}),
    part="all orders, real air",
    least=0.0,
    call=lambda wavelength_nm, surface_pressure, haze_depth, ground_albedo, **at: _looked_at(
        Atmosphere.standard(
            Haze(haze_depth, 1.3), Ground(ground_albedo), surface_pressure, ozone_dobson=None
        ),
        at["solar_zenith_angle"],
        at["view_zenith_angle"],
        at["azimuth"],
        "all",
        wavelength_nm,
    ),
    derivative="forward",
    heavy=True,
    wavelength_nm=Domain(MINIMUM_WAVELENGTH_NM, MAXIMUM_WAVELENGTH_NM),
    surface_pressure=Domain(0.0, LARGEST_PRESSURE),
    haze_depth=_DEPTH,
    ground_albedo=_SHARE,
    **_TWILIGHT,
)(simulate_sky)

extremes(
    Case("jump by a million", {"density": (1e-6, 1e-6, 1.0, 0.0), "gas_depth": 0.0}),
    Case("no gas", {"gas_depth": 0.0} | _LEVEL),
    part="order 1, layers",
    least=0.0,
    call=_layers,
    derivative="forward",
    heavy=True,
    density=Domain((1e-6, 0.0, 0.0, 0.0), (math.inf,) * 4),
    gas_depth=_DEPTH,
    **_TWILIGHT,
)(simulate_sky)

extremes(
    Case("clear, at the sun", _AT_SUN | {"turbidity": 2.0}),
    Case("clear, level at the setting sun", _LEVEL | {"turbidity": 2.0}),
    part="order 1, turbidity",
    least=0.0,
    call=lambda turbidity, solar_zenith_angle, view_zenith_angle, azimuth: _looked_at(
        Atmosphere.from_turbidity(turbidity),
        solar_zenith_angle,
        view_zenith_angle,
        azimuth,
        orders=1,
    ),
    derivative="forward",
    heavy=True,
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    **_TWILIGHT,
)(simulate_sky)

extremes(
    Case("clear, level at the setting sun", _LEVEL | {"turbidity": 2.0}),
    least=0.0,
    call=lambda turbidity, solar_zenith_angle, view_zenith_angle, azimuth: simulate_luminance(
        Atmosphere.from_turbidity(turbidity, "flat"),
        solar_zenith_angle,
        Directions(view_zenith_angle[None], azimuth[None]),
        orders=1,
        rtol=5e-2,
    ),
    heavy=True,
    turbidity=Domain(MINIMUM_TURBIDITY, MAXIMUM_TURBIDITY),
    **_DIRECTION,
)(simulate_luminance)
