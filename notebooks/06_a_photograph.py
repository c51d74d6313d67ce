# %% [markdown]
# # Turbidity from a photograph
#
# A photograph with its full range is a measurement: hundreds of directions, three channels, an
# unknown exposure. This notebook finds its sun, masks what is no clear sky, and asks how much haze
# there is, with an interval that knows what the model misses.
#
# If the environment variable ATMOFIT_PHOTOGRAPH names an OpenEXR or Radiance image of the whole
# sky (latitude-longitude), that one is used. Otherwise one is rendered, and spoilt like a real one.

# %%
import os
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af

jax.config.update("jax_enable_x64", True)

# %%
given = os.environ.get("ATMOFIT_PHOTOGRAPH")
truth = None if given else 2.6
if given:
    photograph = af.read_photograph(Path(given))
else:
    sun = np.radians([68.0, 150.0])  # zenith angle, azimuth from the left edge
    blank = af.Photograph(np.full((128, 256, 3), 0.01))
    zenith, azimuth, _ = blank.angles()
    up = zenith < np.pi / 2
    toward = af.Directions(zenith[up], azimuth[up] - sun[1])
    sky = af.ATMOFIT_2026.linear_sRGB(truth, sun[0], toward)
    rgb = blank.rgb.copy()
    rgb[up] = np.asarray(sky) / 2e4  # the camera's unit is anyone's guess
    random = np.random.default_rng(1)
    rgb *= np.exp(0.02 * random.standard_normal(rgb.shape))
    apart = np.hypot(zenith - sun[0], (azimuth - sun[1]) * np.sin(zenith))
    rgb[apart < np.radians(1.5)] = [9e3, 8e3, -2e3]  # the sun blinds the camera
    tree = (np.abs(azimuth - 5.2) < 0.3) & (zenith > np.radians(62))
    rgb[tree] *= 0.1
    cloud = np.hypot(zenith - 1.0, azimuth - 4.3) < 0.2
    rgb[cloud] = rgb[cloud] * 0.4 + 0.25
    photograph = af.Photograph(rgb)

# %% [markdown]
# ## What is sky?
#
# The sun is the brightest spot; damaged pixels count by their size. Each column is followed down
# from the zenith until something dark stands before the sky. What is left is put together in cells
# of about 7.5°; cells that are uneven inside (edges of clouds, wires) are left out. Everything is
# counted.

# %%
found = af.sky_from_photograph(photograph)
elevation = 90 - np.degrees(found.solar_zenith_angle)
print(f"sun at elevation {elevation:.1f}°, azimuth {np.degrees(found.solar_azimuth):.1f}°")
for reason, count in found.counts.items():
    print(f"{count:8d} pixels {reason}")

rows = photograph.rgb.shape[0] // 2 + 10
white = np.nanpercentile(photograph.rgb[:rows], 97)
shown = np.clip(np.nan_to_num(photograph.rgb[:rows]) / white, 0, 1) ** (1 / 2.2)
fig, axes = plt.subplots(2, 1, figsize=(8, 5), layout="constrained")
axes[0].imshow(shown, extent=(0, 360, 90 - 180 * rows / photograph.rgb.shape[0], 90))
axes[1].imshow(np.where(found.used[:rows, :, None], shown, 0.15 * shown), extent=(0, 360, -14, 90))
for ax, title in zip(axes, ("photograph", "used"), strict=True):
    ax.set(xlabel="azimuth from the left edge [°]", ylabel="elevation [°]", title=title)
plt.show()

# %% [markdown]
# ## An estimate
#
# Exposure and white balance are unknown: each channel is multiplied by a number of its own, which
# is found with the rest. So the *pattern* must tell the turbidity. `robust=True` lets cells count
# less that no clear sky explains: the inside of the cloud.

# %%
options = {"robust": True, "starts": 2}
noise_only = af.estimate_turbidity(found.observation, af.ATMOFIT_2026, **options)
problem = af.turbidity_problem(found.observation, af.ATMOFIT_2026, model_error="atmofit_2026")
careful = af.profile_turbidity(problem, af.estimate_turbidity(problem, **options))
for name, e in (("noise alone", noise_only), ("with model error", careful.estimate)):
    low, high = np.asarray(e.interval)
    print(f"{name:<17} T = {e.value:.3f}, 95 %: {low:.3f} to {high:.3f}", end="; ")
    print(f"reduced chi-square {e.reduced_chi_square:.2f}, left {100 * e.rms:.1f} %")
print("truth" if truth else "truth unknown", truth or "")

# %% [markdown]
# A camera is less noisy than any model is right, so the first interval is too short to be true. The
# second knows the patterns in which the model usually misses real skies, and how much
# (`experiments/model_errors.py`).
#
# ## What is left

# %%
view, across = (np.asarray(angle) for angle in found.observation.directions.angles())
e = careful.estimate
left = 100 * np.asarray(e.log_ratio - e.explained)[:, 1]
weight = np.asarray(e.weight)
x, y = np.degrees(view) * np.sin(across), np.degrees(view) * np.cos(across)
fig, axes = plt.subplots(1, 2, figsize=(8.5, 3.8), layout="constrained")
for ax, values, style, label in (
    (axes[0], left, {"cmap": "RdBu_r", "vmin": -15, "vmax": 15}, "ln(model / measured), green [%]"),
    (axes[1], weight, {"cmap": "cividis", "vmin": 0, "vmax": 1.25}, "weight in the fit [-]"),
):
    dots = ax.scatter(x, y, c=values, s=22, **style)
    ax.plot(0, np.degrees(found.solar_zenith_angle), "o", mfc="none", mec="#e66100", ms=9, mew=1.5)
    ax.add_patch(plt.Circle((0, 0), 90, fill=False, color="#999999"))
    ax.set(aspect="equal", xlim=(-95, 95), ylim=(-95, 95))
    ax.axis("off")
    fig.colorbar(dots, ax=ax, label=label, shrink=0.8)
plt.show()

# %% [markdown]
# ## The profile
#
# The rise of the sum of squares as turbidity is moved away from its best value; 3.84 marks the
# 95 % interval. Dotted: the parabola of the standard error.

# %%
fig, ax = plt.subplots(figsize=(6, 3.4), layout="constrained")
ax.plot(careful.turbidity, careful.rise, color="#1f5fa8", label="profile")
parabola = ((careful.turbidity - e.value) / e.standard_error) ** 2
ax.plot(careful.turbidity, parabola, ":", color="#555555", label="parabola")
ax.axhline(3.84, color="#999999", lw=0.8)
if truth:
    ax.axvline(truth, color="#c8553d", ls="--", lw=0.9, label="truth")
ax.set(xlabel="turbidity T [-]", ylabel="rise of the loss [-]", ylim=(0, 12))
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# On the command line the same is `atmofit turbidity FILE`, with a report and JSON.
#
# ## Your turn
#
# 1. Let the sun be found with the rest: add "solar_zenith_angle" and "solar_azimuth" to `free`.
# 2. Set `exposure="unknown"` in `af.SkySettings`: one exposure for all channels. How much shorter
#    is the interval, and may you do that with a photograph of yours?
# 3. Make the cloud cover half the sky. When does the robust fit give up?
