# %% [markdown]
# # Clouds
#
# A cloud of metaballs, lit by sun, sky and ground. Nishita, Dobashi and Nakamae (1996) followed
# light through three scatterings. Here is their way, what it leaves out, and all orders beside an
# unbiased reference.

# %%
import math
import os

import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit import clouds
from atmofit.render.film import on_film
from atmofit.render.pictures import typical_luminance

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # small grids and few paths, for the tests
GRID, WIDTH, SAMPLES, DIRECTIONS = (10, 24, 64, 14) if FAST else (48, 320, 1024, 50)

# %% [markdown]
# ## Shape
#
# A few large balls are set by hand. Small ones then grow on the surface that the density reaches:
# never on what looks down, so that the bottom stays flat. The same seed makes the same cloud.

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharey=True)
for ax, grown in zip(axes, (False, True), strict=True):
    balls = clouds.cloud_preset("cumulus", seed=5, grown=grown)
    grid = clouds.voxelise(balls, (3 * GRID,) * 3, extinction_coefficient=0.04)
    size = (grid.high - grid.low) / (3 * GRID)
    depth = np.asarray(grid.extinction_coefficient).sum(axis=1).T * float(size[1])
    box = [float(v) / 1e3 for v in (grid.low[0], grid.high[0], grid.low[2], grid.high[2])]
    image = ax.imshow(depth, origin="lower", extent=box, cmap="cividis", vmin=0, vmax=60)
    ax.set(title=f"{balls.count} balls", xlabel="east [km]", facecolor="#00224e")
axes[0].set_ylabel("height [km]")
figure.colorbar(image, ax=axes, label="optical depth, seen from the south [-]")
plt.show()

# %% [markdown]
# ## How far light gets
#
# A thick cloud is bright since light leaves it after many scatterings. A sphere that takes nothing
# away, of optical depth 10 across: one scattering, three by the paper's reference pattern, all by
# discrete ordinates on a grid, and photons, which have no error but noise.

# %%
place = (np.arange(GRID) + 0.5) / GRID * 2 - 1
x, y, z = np.meshgrid(place, place, place, indexing="ij")
share = np.clip((1 - np.sqrt(x**2 + y**2 + z**2)) * GRID / 2 + 0.5, 0, 1)  # of a voxel, inside
sphere = clouds.voxel_cloud(5.0 * share, (-1.0,) * 3, (1.0,) * 3)
drops = {"phase": af.HenyeyGreenstein(0.85), "single_scattering_albedo": 1.0}
angles = np.radians([30.0, 90.0, 150.0])
converged = clouds.converged_light(sphere, **drops, directions=DIRECTIONS, rtol=1e-3)
print(f"power that got lost: {float(converged.power_error):.1e} of what came in")

# %%
seen = {name: [] for name in ("one scattering", "three, as in 1996", "all orders", "photons")}
frame = {"width": 24, "extent": 2.4}
traced = clouds.homogeneous_sphere(radius=1.0, extinction_coefficient=5.0)
for angle in angles:
    toward = np.array([math.sin(angle), 0.0, math.cos(angle)])
    pattern = clouds.pattern_light(sphere, **drops, view_direction=toward, most=100)
    for name, source in zip(seen, (pattern.source_function[0], pattern.total), strict=False):
        seen[name].append(clouds.view(sphere, source, sun_angle=angle, **frame).radiance)
    seen["all orders"].append(converged.view(sun_angle=angle, **frame).radiance)
    photons = clouds.path_trace(traced, **drops, sun_angle=angle, samples=SAMPLES, **frame)
    seen["photons"].append(photons.radiance)

figure, axes = plt.subplots(3, 4, figsize=(9, 6.6), layout="constrained")
for column, (name, pictures) in zip(axes.T, seen.items(), strict=True):
    for ax, picture, true in zip(column, pictures, seen["photons"], strict=True):
        ax.imshow(picture, cmap="cividis", vmin=0, vmax=float(np.max(true)))
        ax.set(xticks=[], yticks=[])
        part = float(np.mean(picture) / np.mean(true))
        ax.set_xlabel(f"{part:.0%} of the photons' light", fontsize=8)
    column[0].set_title(name, fontsize=10)
for ax, angle in zip(axes[:, 0], angles, strict=True):
    ax.set_ylabel(f"sun {np.degrees(angle):.0f}° from\nthe eye", fontsize=9)
plt.show()

# %% [markdown]
# ## In the sky
#
# The cloud is grey. Its colour is that of what lights it: the sun through the air above, the sky,
# the ground below, and the air between it and the eye.

# %%
cloud = clouds.staged_cloud("cumulus", seed=5, voxels=GRID)
camera = clouds.staged_view("cumulus", width=WIDTH)
suns = {"sun at 50°": (50.0, 130.0), "sun at 10°, behind": (10.0, 15.0), "sun at 5°": (5.0, 160.0)}
figure, axes = plt.subplots(1, 3, figsize=(11, 3), layout="constrained")
for ax, (name, (elevation, azimuth)) in zip(axes, suns.items(), strict=True):
    zenith = math.radians(90 - elevation)
    light = clouds.clear_surroundings(2.5, zenith, math.radians(azimuth), 0.15)
    how = {"phase": clouds.cloud_phase(), "directions": DIRECTIONS}
    picture = clouds.render_cloud(cloud, camera, light, **how)
    ax.imshow(on_film(af.XYZ_to_xyY(picture.XYZ), typical_luminance(picture)))
    ax.set_title(name)
    ax.set_axis_off()
plt.show()

# %% [markdown]
# ## What a picture tells
#
# All of it is differentiable, so a picture can be turned around: density, asymmetry and albedo of a
# cloud whose shape is known, from two noisy pictures, with their uncertainty.

# %%
ball = np.meshgrid(*[(np.arange(8) + 0.5) / 8 * 2 - 1] * 3, indexing="ij")
filled = np.clip((1 - np.sqrt(sum(axis**2 for axis in ball))) * 4 + 0.5, 0, 1)
small = clouds.voxel_cloud(5.0 * filled, (-1.0,) * 3, (1.0,) * 3)
truth = {"density_scale": 0.7, "asymmetry": 0.75, "single_scattering_albedo": 0.95}
denser = clouds.voxel_cloud(0.7 * small.extinction_coefficient, small.low, small.high)
light = clouds.converged_light(
    denser, phase=af.HenyeyGreenstein(0.75), single_scattering_albedo=0.95, directions=14
)
two = np.array([0.5, 2.4])
clean = np.stack([light.view(sun_angle=a, width=10, extent=2.4).radiance for a in two])
noise = 0.03 * clean.mean()
noisy = clean + noise * np.random.default_rng(0).normal(size=clean.shape)
found = af.fit_cloud(small, noisy, noise, sun_angle=two, extent=2.4, directions=14)
print(found)

# %%
figure, ax = plt.subplots(figsize=(6, 2.6), layout="constrained")
off = (found.values - np.array([*truth.values()])) / found.standard_error
ax.errorbar(off, range(3), xerr=1, fmt="o", capsize=4)
ax.axvline(0, color="0.6", lw=0.8)
ax.set(
    yticks=range(3), yticklabels=[*truth], xlabel="found - true, in standard errors", xlim=(-4, 4)
)
ax.set_ylim(-0.5, 2.5)
plt.show()

# %% [markdown]
# More: `experiments/clouds.py` stages the paper's figures, `experiments/cloud_methods.py` holds the
# error of each method against its run time, and `docs/paper_says_we_find.md` says what reproduces.
