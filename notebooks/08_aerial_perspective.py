# %% [markdown]
# # Aerial perspective
#
# Light from a distant hill is weakened on its way, and the air adds light of its own. Both depend
# on wavelength, distance and direction. Here are the two terms, the ways to compute them, what
# older models miss, and a landscape.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.render.film import on_film
from atmofit.render.pictures import typical_luminance

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # small pictures, for the tests
COLUMNS, ROWS = (60, 45) if FAST else (640, 480)

# %% [markdown]
# ## Black hills at growing distance
#
# Sun at 60 degrees from the zenith, turbidity 3. `light_around` gathers what sun, sky and ground
# send to a place; `path_transfer` follows a level line of sight.

# %%
light = af.clear_light(3.0, np.radians(60.0), 0.0)
air, around = light.air, light.around
λ = np.asarray(air.wavelength_nm)
distance = np.geomspace(100.0, 6e4, 40)
azimuth = np.radians([10.0, 60.0, 180.0])
shape = (azimuth.size, distance.size)
view, toward = np.full(shape, np.pi / 2), np.broadcast_to(azimuth[:, None], shape)
source = around.toward(air, view, toward)
level = af.path_transfer(air, af.Path(np.broadcast_to(distance, shape), view), source)

figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for k in (0, 4, 8):
    axes[0].plot(distance / 1e3, level.transmittance[0, :, k], label=f"{λ[k]:.0f} nm")
    axes[1].plot(distance / 1e3, level.in_scattered[1, :, k], label=f"{λ[k]:.0f} nm")
axes[0].set(xscale="log", xlabel="distance [km]", ylabel="transmittance [-]")
axes[1].set(xscale="log", xlabel="distance [km]", ylabel="added light / sun's irradiance [1/sr]")
axes[1].set_title("60° beside the sun")
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# Blue goes first and comes first: near hills turn bluish, and only far away does the rest follow.
#
# ## What is computed, and how wrong the rest would be
#
# A plan tries every solver on lines of sight that span the ranges, and takes the cheapest.

# %%
plan = af.plan_path(air, (10.0, 6e4), np.radians([75.0, 105.0]), (500.0, 2000.0), rtol=3e-3)
print(plan)

# %% [markdown]
# The Hermite form of 1999 costs as much as eight quadrature nodes and fails on long paths.
#
# ## What older models miss
#
# Fog that fades everything alike, and a constant ambient light, each at its best fit to the same
# lines of sight: against the angle to the sun at 20 km.

# %%
around_us = np.radians(np.linspace(3.0, 180.0, 60))
everywhere = (around_us.size, distance.size)
level_view = np.full(everywhere, np.pi / 2)
source = around.toward(air, level_view, np.broadcast_to(around_us[:, None], everywhere))
found = af.path_transfer(air, af.Path(np.broadcast_to(distance, everywhere), level_view), source)
fog = af.fit_depth_fog(found.in_scattered)
ambient = af.fit_ward_larson(found.in_scattered, found.transmittance)
models = {
    "true": found.in_scattered,
    "fog": np.broadcast_to(fog(0.0), found.in_scattered.shape),
    "ambient": ambient(0.0, found.transmittance),
}
far = np.argmin(np.abs(distance - 2e4))
figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained", sharey=True)
for ax, k in zip(axes, (1, 7), strict=True):
    for name, values in models.items():
        ax.plot(np.degrees(around_us), np.asarray(values)[:, far, k], label=name)
    ax.set(yscale="log", xlabel="azimuth from the sun [°]", title=f"{λ[k]:.0f} nm")
axes[0].set_ylabel("added light / sun's irradiance [1/sr]")
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# ## A landscape
#
# Mountains from a seed. Change turbidity or the hour: nothing is compiled again.

# %%
terrain = af.procedural_terrain(5, 256 if FAST else 1024, relief=1800.0)
third = terrain.heights.shape[0] // 3
middle = np.asarray(terrain.heights)[third : 2 * third, third : 2 * third]
north, east = np.argwhere(middle == middle.max())[0] + third  # a summit, far from the edges
place = (float(east * terrain.spacing), float(north * terrain.spacing))
west = np.radians(270.0)
camera = af.View(*place, 30.0, west, columns=COLUMNS, rows=ROWS, horizon=0.4)
hours = {
    "T 2, sun 70° from the zenith, east": af.clear_light(2.0, np.radians(70.0), np.radians(90.0)),
    "T 6, sun 80°, west": af.clear_light(6.0, np.radians(80.0), west),
}
figure, axes = plt.subplots(2, 2, figsize=(10, 7.6), layout="constrained")
for row_of_axes, (name, hour) in zip(axes, hours.items(), strict=True):
    sight = af.plan_path(hour.air, (3.0, 6e4), np.radians([60.0, 130.0]), (0.0, 2000.0), 3e-3)
    white = None
    for ax, way in zip(row_of_axes, ("path", "none"), strict=True):
        picture = af.render_landscape(terrain, camera, hour, sight, 0.12, way)
        white = white or typical_luminance(picture)  # both of a row are exposed alike
        ax.imshow(on_film(np.asarray(af.XYZ_to_xyY(picture.XYZ)), white))
        ax.set_title(name + (", no air" if way == "none" else ""), fontsize=9)
        ax.axis("off")
plt.show()

# %% [markdown]
# ## How the colour of the distance answers to the haze
#
# Everything is differentiable: the slope of the added light by turbidity, 20 km away, 60 degrees
# beside the sun.


# %%
def seen(hour):
    source = hour.around.toward(hour.air, np.pi / 2, np.radians(60.0))
    return af.path_transfer(hour.air, af.Path(2e4, np.pi / 2), source).in_scattered


def added(turbidity):
    return seen(af.clear_light(turbidity, np.radians(60.0), 0.0))


slope = jax.jacfwd(added)(3.0) / added(3.0)
figure, ax = plt.subplots(figsize=(5, 3.4), layout="constrained")
ax.plot(λ, 100 * np.asarray(slope), "o-")
ax.axhline(0.0, color="0.7", lw=0.8)
ax.set(xlabel="wavelength [nm]", ylabel="change for one unit of turbidity [%]")
plt.show()

# %% [markdown]
# In the blue this path is already full of light, and more haze takes away from what it adds; in the
# red that still grows.
