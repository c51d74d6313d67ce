"""Clouds: volumes of droplets, and what light makes of them."""

from atmofit.clouds.path_trace import PathTraced, path_trace
from atmofit.clouds.volume import (
    BoxCloud,
    Cloud,
    SphereCloud,
    VoxelCloud,
    homogeneous_cube,
    homogeneous_sphere,
    voxel_cloud,
)

__all__ = [
    "BoxCloud",
    "Cloud",
    "PathTraced",
    "SphereCloud",
    "VoxelCloud",
    "homogeneous_cube",
    "homogeneous_sphere",
    "path_trace",
    "voxel_cloud",
]
