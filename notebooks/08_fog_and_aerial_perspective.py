# %% [markdown]
# # Fog and aerial perspective
#
# Light from a distant hill is weakened on its way, and the air adds light of its own. Both depend
# on wavelength, distance and direction. Here are the two terms, the ways to compute them, what
# older models miss, a landscape, and the same landscape with fog in its valleys.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.landscape.picture import sunlight_weights
from atmofit.notebook import sliders
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
pictures = []
figure, axes = plt.subplots(2, 2, figsize=(10, 7.6), layout="constrained")
for row_of_axes, (name, hour) in zip(axes, hours.items(), strict=True):
    sight = af.plan_path(hour.air, (3.0, 6e4), np.radians([60.0, 130.0]), (0.0, 2000.0), 3e-3)
    white = None
    for ax, way in zip(row_of_axes, ("path", "none"), strict=True):
        picture = af.render_landscape(terrain, camera, hour, sight, 0.12, way)
        white = white or typical_luminance(picture)  # both of a row are exposed alike
        pictures.append((picture, white))
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
#
# ## Fog
#
# Klassen (1987) laid an even fog on flat ground, with an extinction of 15 to 40 per km. Light is
# scattered once. Along a line of sight the way of sunlight through the fog changes linearly, so the
# added light has a closed form. The paper goes a shorter way and gives every droplet the sunlight
# of the ground. On the left is what that costs, for an eye in the fog with the sun 30 degrees high
# ahead. On the right is what the flat earth costs: by how much it overrates the way of sunlight
# through a layer, down to the ground.


# %%
def gray_fog(per_km, top):
    drops = np.full(3, 1e-3 * per_km)
    return af.FogLayer(top, drops, drops, 0 * drops, [600, 555, 450], af.HenyeyGreenstein(0.85))


down, low_sun = np.radians(np.linspace(3.0, 30.0, 60)), np.radians(np.linspace(1.0, 30.0, 60))
figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for eye, top in ((2.0, 10.0), (5.0, 10.0), (10.0, 20.0)):
    where = (gray_fog(25.0, top), np.inf, np.pi / 2 + down, 0.0, np.pi / 3, eye)
    paper, exact = (
        af.fog_transfer(*where, sunlight=name).in_scattered[:, 0] for name in ("constant", "exact")
    )
    error = 100 * (np.asarray(paper / exact) - 1)
    axes[0].plot(np.degrees(down), error, label=f"eye at {eye:g} m, fog to {top:g} m")
for top in (100.0, 1000.0, 8000.0):
    layer = gray_fog(100.0 / top, top)  # an optical depth of 0.1, straight up
    flat, round_ = (
        np.log(af.fog_sunlight(layer, 0.0, np.pi / 2 - low_sun, name)[:, 0])
        for name in ("exact", "curved")
    )
    axes[1].plot(np.degrees(low_sun), 100 * (flat / round_ - 1), label=f"{top / 1e3:g} km thick")
axes[0].set(xlabel="angle downward [°]", ylabel="error of the added light [%]")
axes[1].set(xlabel="elevation of the sun [°]", ylabel="error of the way [%]", yscale="log")
axes[1].set(ylim=(1e-3, None))
for ax in axes:
    ax.legend(frameon=False)
plt.show()

# %% [markdown]
# The constant way leaves out light, the more the deeper the fog and the higher the eye in it. A
# flat earth is good for fog under all but the lowest suns, and less so for the air above.
#
# ## Fog over a picture
#
# A picture that knows its distances can be given fog afterwards. Droplets are much larger than the
# wavelength, so fog is gray, and X, Y and Z can be treated like three wavelengths. The ground keeps
# the light that it had without fog, and where the picture ends in sky, no fog is laid. In the upper
# row the sun stands behind us, in the lower one ahead, where droplets send most of their light.

# %%
azimuth, climb = camera.rays(np.arange(COLUMNS))
eye = float(terrain.height_at(camera.east, camera.north)) + 30.0
weights = sunlight_weights(tuple(λ.tolist()))
scenes = []
for hour, (picture, white) in zip(hours.values(), pictures[::2], strict=True):
    beam = np.asarray(hour.around.sun_irradiance) @ weights  # X, Y, Z of sunlight [lx]
    aside = np.broadcast_to(np.asarray(azimuth - hour.solar_azimuth), (ROWS, COLUMNS))
    steep = np.where(np.isfinite(picture.distance), climb.T, np.maximum(climb.T, 0.0))
    sun = hour.around.solar_zenith_angle
    where = (picture.distance, np.pi / 2 - np.arctan(steep), aside, sun, eye, beam)
    scenes.append((picture.XYZ, where, white))


def developed(scene, fog, sunlight):
    XYZ = af.apply_fog(scene[0], fog, *scene[1], sunlight=sunlight)
    return on_film(np.asarray(af.XYZ_to_xyY(XYZ)), scene[2])


mist, dense = gray_fog(0.3, 1500.0), gray_fog(15.0, 1300.0)
fogs = {
    "0.3 per km to 1500 m, scattered once": (mist, "exact"),
    "15 per km to 1300 m, scattered once": (dense, "exact"),
    "15 per km to 1300 m, diffuse": (dense, "diffuse"),
}
figure, axes = plt.subplots(2, 3, figsize=(11, 5.8), layout="constrained")
for row_of_axes, scene in zip(axes, scenes, strict=True):
    for ax, (name, (fog, sunlight)) in zip(row_of_axes, fogs.items(), strict=True):
        ax.imshow(developed(scene, fog, sunlight))
        ax.set_title(name, fontsize=9)
        ax.axis("off")
plt.show()

# %% [markdown]
# Light that was scattered once makes mist, but leaves dense fog dark, even at its edge toward the
# sun: in truth its light was scattered many times. The notebook on slabs counts all orders. For a
# low sun the paper has a way out, on the right: a fog that shines alike in all directions, with the
# colour of the sun. Its brightness is a choice of ours: the mean of the sun's beam over the sphere.
# Light of the sky is in none of them, which the weak sun of the lower row shows.
#
# Slide the density and the top of such a fog.


# %%
def show_fog(per_km, top):
    plt.figure(figsize=(6, 4.5)).add_axes((0, 0, 1, 1)).axis("off")
    plt.imshow(developed(scenes[0], gray_fog(per_km, top), "diffuse"))


sliders(show_fog, per_km=(0.0, 1.0, 15.0), top=(0.0, 1300.0, 1800.0))
