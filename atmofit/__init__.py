"""A differentiable atmosphere, and the toolkit that fits analytic skies to it.

The names below stand in the order in which light travels: what the air is made of, the sky that
it makes, colour, analytic skies, and their fits.
"""

from atmofit import clouds as clouds
from atmofit.checks import debug_checks
from atmofit.colour import (
    XYZ_to_linear_sRGB,
    XYZ_to_xyY,
    linear_sRGB_to_sRGB,
    spectrum_to_xyY,
    spectrum_to_XYZ,
    xyY_to_XYZ,
)
from atmofit.fit.candidates import SimulatorModel
from atmofit.fit.cloud import CloudFit, fit_cloud
from atmofit.fit.comparison import compare
from atmofit.fit.distribution import DistributionFit, fit_distribution
from atmofit.fit.dust import DustFit, SlabView, fit_dust
from atmofit.fit.identifiability import (
    Identifiability,
    identify_distribution,
    identify_perez,
    identify_zenith,
)
from atmofit.fit.model_error import ModelError, stored_model_error
from atmofit.fit.parameters import PerezPrior
from atmofit.fit.posterior import (
    TurbidityProfile,
    TurbiditySamples,
    profile_turbidity,
    sample_turbidity,
)
from atmofit.fit.problem import Sought, TurbidityProblem, turbidity_problem
from atmofit.fit.refit import RefitResult, refit
from atmofit.fit.single_sky import PerezFit, fit_perez
from atmofit.fit.skies import RefitSettings, simulate_skies
from atmofit.fit.sky_model import SkyModelFit, fit_sky_model
from atmofit.fit.training import TrainedModel, TrainingSettings, simulate_training, train
from atmofit.fit.turbidity import TurbidityEstimate, estimate_turbidity
from atmofit.fit.zenith import ZenithFit, fit_zenith_chromaticity, fit_zenith_luminance
from atmofit.geometry import DirectionGrid, Directions, dome_343, scattering_angle
from atmofit.io import read_coefficients, read_sky_model
from atmofit.landscape.light import clear_light, overcast_light
from atmofit.landscape.picture import Light, Picture, render_landscape
from atmofit.landscape.terrain import Terrain, procedural_terrain, read_elevation_grid
from atmofit.landscape.view import View
from atmofit.media.adaptive_sky import AdaptiveSky, adaptive_sky
from atmofit.media.baselines import DepthFog, WardLarson, fit_depth_fog, fit_ward_larson
from atmofit.media.dust import (
    dense_optical_depth,
    empty_probability,
    hapke_irvine,
    opposition_factor,
    over_background,
    slab_brightness,
    slab_transparency,
)
from atmofit.media.fog import FogTransfer, apply_fog, fog_transfer
from atmofit.media.fog_medium import FogLayer, fog_layer
from atmofit.media.fog_object import diffuse_fog, fog_object, fog_sunlight
from atmofit.media.h_functions import h_function, half_space_radiance
from atmofit.media.light_around import LightAround, light_around
from atmofit.media.low_air import LowAir, low_air
from atmofit.media.path_plan import PathPlan
from atmofit.media.path_planning import plan_path
from atmofit.media.rings import (
    RingProfile,
    in_sphere_shadow,
    ring_brightness,
    synthetic_ring_profile,
)
from atmofit.media.scattering_orders import ScatteringOrders, scattering_orders
from atmofit.media.sky_reconstruction import (
    ReconstructionPlan,
    plan_layered_sky,
    reconstruct_layered_sky,
)
from atmofit.media.slab import slab_single_scattering
from atmofit.media.slab_plan import SlabPlan
from atmofit.media.slab_planning import plan_slab
from atmofit.media.slab_solution import SlabSolution, solve_slab
from atmofit.media.transfer import Path, PathTransfer, path_transfer
from atmofit.media.two_layers import TwoLayers, haze_opacity, layered_sky, layered_sun, two_layers
from atmofit.models.cie import CIEShape, cie_clear_sky, cie_general_sky, cie_overcast_sky
from atmofit.models.daylight import DaylightSpectrum, daylight_spectrum
from atmofit.models.dependence import Basis, Dependence
from atmofit.models.overcast import hazy_sky_xyY
from atmofit.models.perez import perez
from atmofit.models.preetham import PREETHAM_1999, PreethamModel
from atmofit.models.shapes import AUREOLE, EXTENDED, PEREZ, Shape
from atmofit.models.sky_model import SkyModel
from atmofit.models.stored import ATMOFIT_2026
from atmofit.models.sunlight import (
    SunTransmittance,
    direct_sun_radiance,
    direct_sun_xyY,
    optical_mass,
    sun_transmittance,
)
from atmofit.models.visibility import (
    angstrom_beta,
    meteorological_range,
    turbidity_from_range,
    turbidity_of,
)
from atmofit.observe.channels import Camera
from atmofit.observe.images import Photograph, read_photograph
from atmofit.observe.observation import Observation
from atmofit.observe.photograph import SkyFromPhotograph, SkySettings, sky_from_photograph
from atmofit.observe.tables import read_observations
from atmofit.optics.air import (
    air_depolarisation,
    air_refractivity,
    king_factor,
    rayleigh_cross_section,
    rayleigh_optical_depth,
)
from atmofit.optics.atmosphere import Atmosphere, Ground
from atmofit.optics.continental import continental_air
from atmofit.optics.exponential_layers import ExponentialLayers
from atmofit.optics.gases import Absorber
from atmofit.optics.haze import Haze, bullrich_phase
from atmofit.optics.mie import MieOptics, mie_haze, mie_optics
from atmofit.optics.molecules import Molecules
from atmofit.optics.particle_phases import (
    Isotropic,
    LambertSphere,
    LinearPhase,
    PhaseSum,
    furnace_slag_phase,
    henyey_greenstein_of_phase_angle,
    phase_angle,
    phase_of_phase_angle,
    saturn_ring_phase,
    scattering_angle_of_phase_angle,
)
from atmofit.optics.phase import (
    CornetteShanks,
    HenyeyGreenstein,
    PhaseFunction,
    Rayleigh,
    TabulatedPhase,
)
from atmofit.optics.profiles import DensityProfile, Exponential, GaussianLayer, Profile
from atmofit.optics.sizes import (
    SizeDistribution,
    junge_sizes,
    lognormal_sizes,
    modified_gamma_sizes,
)
from atmofit.optics.standard_atmosphere import (
    standard_density_profile,
    standard_number_density,
    standard_pressure,
    standard_temperature,
)
from atmofit.scale.blocks import BlockRun, run_blocks
from atmofit.scale.devices import device_mesh, over_devices
from atmofit.scale.fit_work import FitWork
from atmofit.scale.hosts import Hosts, join_hosts
from atmofit.scale.series_work import SeriesWork
from atmofit.scale.sky_work import SkyWork
from atmofit.scale.store import BlockStore, verify_store
from atmofit.sky.direct import simulate_sun
from atmofit.sky.field import SkyField
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import simulate_luminance, simulate_sky, solve_sky
from atmofit.spectrum import Spectrum
from atmofit.sun import solar_irradiance_spectrum
from atmofit.sun_position import solar_position, sun_at

__version__ = "0.1.0"

__all__ = [
    "ATMOFIT_2026",
    "AUREOLE",
    "EXTENDED",
    "PEREZ",
    "PREETHAM_1999",
    "Absorber",
    "AdaptiveSky",
    "Atmosphere",
    "Basis",
    "BlockRun",
    "BlockStore",
    "CIEShape",
    "Camera",
    "CloudFit",
    "CornetteShanks",
    "DaylightSpectrum",
    "DensityProfile",
    "Dependence",
    "DepthFog",
    "DirectionGrid",
    "Directions",
    "DistributionFit",
    "DustFit",
    "Exponential",
    "ExponentialLayers",
    "FitWork",
    "FogLayer",
    "FogTransfer",
    "GaussianLayer",
    "Ground",
    "Haze",
    "HenyeyGreenstein",
    "Hosts",
    "Identifiability",
    "Isotropic",
    "LambertSphere",
    "Light",
    "LightAround",
    "LinearPhase",
    "LowAir",
    "MieOptics",
    "ModelError",
    "Molecules",
    "Observation",
    "Path",
    "PathPlan",
    "PathTransfer",
    "PerezFit",
    "PerezPrior",
    "PhaseFunction",
    "PhaseSum",
    "Photograph",
    "Picture",
    "Plan",
    "PreethamModel",
    "Profile",
    "Rayleigh",
    "ReconstructionPlan",
    "RefitResult",
    "RefitSettings",
    "RingProfile",
    "ScatteringOrders",
    "SeriesWork",
    "Shape",
    "SimulatorModel",
    "SizeDistribution",
    "SkyField",
    "SkyFromPhotograph",
    "SkyModel",
    "SkyModelFit",
    "SkySettings",
    "SkyWork",
    "SlabPlan",
    "SlabSolution",
    "SlabView",
    "Sought",
    "Spectrum",
    "SunTransmittance",
    "TabulatedPhase",
    "Terrain",
    "TrainedModel",
    "TrainingSettings",
    "TurbidityEstimate",
    "TurbidityProblem",
    "TurbidityProfile",
    "TurbiditySamples",
    "TwoLayers",
    "View",
    "WardLarson",
    "XYZ_to_linear_sRGB",
    "XYZ_to_xyY",
    "ZenithFit",
    "adaptive_sky",
    "air_depolarisation",
    "air_refractivity",
    "angstrom_beta",
    "apply_fog",
    "bullrich_phase",
    "cie_clear_sky",
    "cie_general_sky",
    "cie_overcast_sky",
    "clear_light",
    "compare",
    "continental_air",
    "daylight_spectrum",
    "debug_checks",
    "dense_optical_depth",
    "device_mesh",
    "diffuse_fog",
    "direct_sun_radiance",
    "direct_sun_xyY",
    "dome_343",
    "empty_probability",
    "estimate_turbidity",
    "fit_cloud",
    "fit_depth_fog",
    "fit_distribution",
    "fit_dust",
    "fit_perez",
    "fit_sky_model",
    "fit_ward_larson",
    "fit_zenith_chromaticity",
    "fit_zenith_luminance",
    "fog_layer",
    "fog_object",
    "fog_sunlight",
    "fog_transfer",
    "furnace_slag_phase",
    "h_function",
    "half_space_radiance",
    "hapke_irvine",
    "haze_opacity",
    "hazy_sky_xyY",
    "henyey_greenstein_of_phase_angle",
    "identify_distribution",
    "identify_perez",
    "identify_zenith",
    "in_sphere_shadow",
    "join_hosts",
    "junge_sizes",
    "king_factor",
    "layered_sky",
    "layered_sun",
    "light_around",
    "linear_sRGB_to_sRGB",
    "lognormal_sizes",
    "low_air",
    "meteorological_range",
    "mie_haze",
    "mie_optics",
    "modified_gamma_sizes",
    "opposition_factor",
    "optical_mass",
    "over_background",
    "over_devices",
    "overcast_light",
    "path_transfer",
    "perez",
    "phase_angle",
    "phase_of_phase_angle",
    "plan_layered_sky",
    "plan_path",
    "plan_sky",
    "plan_slab",
    "procedural_terrain",
    "profile_turbidity",
    "rayleigh_cross_section",
    "rayleigh_optical_depth",
    "read_coefficients",
    "read_elevation_grid",
    "read_observations",
    "read_photograph",
    "read_sky_model",
    "reconstruct_layered_sky",
    "refit",
    "render_landscape",
    "ring_brightness",
    "run_blocks",
    "sample_turbidity",
    "saturn_ring_phase",
    "scattering_angle",
    "scattering_angle_of_phase_angle",
    "scattering_orders",
    "simulate_luminance",
    "simulate_skies",
    "simulate_sky",
    "simulate_sun",
    "simulate_training",
    "sky_from_photograph",
    "slab_brightness",
    "slab_single_scattering",
    "slab_transparency",
    "solar_irradiance_spectrum",
    "solar_position",
    "solve_sky",
    "solve_slab",
    "spectrum_to_XYZ",
    "spectrum_to_xyY",
    "standard_density_profile",
    "standard_number_density",
    "standard_pressure",
    "standard_temperature",
    "stored_model_error",
    "sun_at",
    "sun_transmittance",
    "synthetic_ring_profile",
    "train",
    "turbidity_from_range",
    "turbidity_of",
    "turbidity_problem",
    "two_layers",
    "verify_store",
    "xyY_to_XYZ",
]
