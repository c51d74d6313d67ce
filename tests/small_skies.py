"""A sky with everything in it, on few nodes: fast to compile, for tests that need no accuracy."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import atmofit as af
from atmofit.sky.extremes import FEW_NODES

PARAMETERS = {
    "turbidity": 3.0,
    "molecule_scale_height": 8.8e3,
    "haze_scale_height": 1.2e3,
    "asymmetry": 0.7,
    "haze_albedo": 0.9,
    "ground_albedo": 0.3,
}
WAVELENGTHS = np.array([450.0, 650.0])
# Overhead, at the sun (30 degrees), aside, low, on the horizon.
DIRECTIONS = af.Directions(
    np.radians([0.0, 30.0, 60.0, 85.0, 90.0]), np.radians([0.0, 0.0, 10.0, 100.0, 180.0])
)


def atmosphere(parameters, geometry="spherical", absorbers=()):
    """Molecules and a haze whose every parameter is given."""
    haze = af.Haze(
        af.Haze.from_turbidity(parameters["turbidity"]).optical_depth,
        1.3,
        parameters["haze_scale_height"],
        parameters["haze_albedo"],
        af.HenyeyGreenstein(parameters["asymmetry"]),
    )
    return af.Atmosphere(
        af.Molecules(scale_height=parameters["molecule_scale_height"]),
        haze,
        absorbers,
        af.Ground(parameters["ground_albedo"]),
        geometry,
    )


def few_nodes(air, orders=2, dtype=None, all_wavelengths=None):
    """A plan on few nodes."""
    plan = af.plan_sky(air, orders=orders, rtol=5e-2, dtype=dtype, all_wavelengths=all_wavelengths)
    return dataclasses.replace(plan, nodes=FEW_NODES)


def radiance(parameters, sun, geometry="spherical", dtype="float64"):
    """Radiance over solar irradiance in `DIRECTIONS`."""
    air = atmosphere(parameters, geometry)
    return af.simulate_sky(
        air, sun, DIRECTIONS, WAVELENGTHS, solar_irradiance=1.0, plan=few_nodes(air, dtype=dtype)
    )


def as_arrays(parameters, dtype="float64"):
    """Parameters as arrays of a dtype."""
    return {name: jnp.asarray(value, dtype) for name, value in parameters.items()}
