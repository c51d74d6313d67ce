"""Clouds: volumes of droplets, and what light makes of them."""

from atmofit.clouds.bezier import SurfaceHit, surface_hit
from atmofit.clouds.converged import ConvergedLight, converged_light
from atmofit.clouds.depths import optical_depth_toward, sunlight_reaching
from atmofit.clouds.first_order import single_scattering
from atmofit.clouds.form_factors import form_factors
from atmofit.clouds.growth import grow
from atmofit.clouds.marching import Marched, Viewed, march, view
from atmofit.clouds.metaballs import Metaballs, metaballs
from atmofit.clouds.path_trace import PathTraced, path_trace
from atmofit.clouds.pattern import (
    ReferencePattern,
    adaptive_counts,
    random_paths,
    reference_pattern,
)
from atmofit.clouds.pattern_light import PatternLight, cloud_phase, pattern_light
from atmofit.clouds.picture import render_cloud
from atmofit.clouds.plan import CloudPlan, plan_cloud
from atmofit.clouds.presets import cloud_preset
from atmofit.clouds.sky_light import (
    SkyLight,
    refined_sky_light,
    sky_elements,
    sky_light,
    with_ground,
)
from atmofit.clouds.stage import staged_cloud, staged_view
from atmofit.clouds.surroundings import (
    Surroundings,
    clear_surroundings,
    sunless_surroundings,
)
from atmofit.clouds.volume import (
    BoxCloud,
    Cloud,
    SphereCloud,
    VoxelCloud,
    homogeneous_cube,
    homogeneous_sphere,
    voxel_cloud,
)
from atmofit.clouds.voxels import (
    OccupiedBlocks,
    occupied_blocks,
    read_voxels,
    voxelise,
    write_voxels,
)

__all__ = [
    "BoxCloud",
    "Cloud",
    "CloudPlan",
    "ConvergedLight",
    "Marched",
    "Metaballs",
    "OccupiedBlocks",
    "PathTraced",
    "PatternLight",
    "ReferencePattern",
    "SkyLight",
    "SphereCloud",
    "SurfaceHit",
    "Surroundings",
    "Viewed",
    "VoxelCloud",
    "adaptive_counts",
    "clear_surroundings",
    "cloud_phase",
    "cloud_preset",
    "converged_light",
    "form_factors",
    "grow",
    "homogeneous_cube",
    "homogeneous_sphere",
    "march",
    "metaballs",
    "occupied_blocks",
    "optical_depth_toward",
    "path_trace",
    "pattern_light",
    "plan_cloud",
    "random_paths",
    "read_voxels",
    "reference_pattern",
    "refined_sky_light",
    "render_cloud",
    "single_scattering",
    "sky_elements",
    "sky_light",
    "staged_cloud",
    "staged_view",
    "sunless_surroundings",
    "sunlight_reaching",
    "surface_hit",
    "view",
    "voxel_cloud",
    "voxelise",
    "with_ground",
    "write_voxels",
]
