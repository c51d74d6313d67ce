# %% [markdown]
# # From air to colour
#
# Why is the sky blue and the low sun red? Here is the chain from molecules and haze to three
# numbers on a screen: optical depth, phase function, the spectrum of sun and sky, and the eye.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.render.film import on_film
from atmofit.tables import cie1931_2deg

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # coarser, for the tests
RTOL = 5e-2 if FAST else 1e-2
λ = np.arange(380.0, 781.0, 10.0)

# %% [markdown]
# ## What the air is made of
#
# The optical depth says how much of a ray straight up is scattered or absorbed: exp(-τ) is left.
# Molecules are much smaller than a wavelength and scatter short waves most. Haze is about as large
# and hardly cares. Ozone absorbs orange.

# %%
air = af.Atmosphere.standard(af.Haze(0.1, 1.3), af.Ground(0.2), ozone_dobson=320.0)
depths = {"molecules": air.molecules, "haze": air.haze, "ozone": air.absorbers[0]}
angle = np.radians(np.linspace(0.0, 180.0, 181))
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for name, part in depths.items():
    left.plot(λ, part.optical_depth_at(λ), label=name)
left.plot(λ, depths["molecules"].optical_depth_at(λ[17]) * (λ[17] / λ) ** 4, "k:", label="λ⁻⁴")
left.set(xlabel="wavelength [nm]", ylabel="vertical optical depth [-]", yscale="log")
left.set(ylim=(1e-3, 1.0))
left.legend(frameon=False)
for name in ("molecules", "haze"):
    phase = air.molecules.phase() if name == "molecules" else air.haze.phase
    right.plot(np.degrees(angle), phase(angle), label=name)
right.set(xlabel="scattering angle [°]", ylabel="phase function [1/sr]", yscale="log")
right.legend(frameon=False)
plt.show()

# %% [markdown]
# On the right: where the light goes. Molecules send as much back as on; haze sends most of it on,
# which makes the bright ring around the sun.
#
# ## The sun, weakened
#
# Its light crosses more air the lower it stands, and blue is lost first.

# %%
suns_deg = np.array([0.0, 60.0, 75.0, 85.0, 89.0])
beams = [np.asarray(af.simulate_sun(air, np.radians(sun), λ)) for sun in suns_deg]
colours = on_film([[*np.asarray(af.spectrum_to_xyY(beam, λ))[:2], 1.0] for beam in beams], 1.0)
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
ax.set_facecolor("0.25")
for sun, beam, colour in zip(suns_deg, beams, colours, strict=True):
    ax.plot(λ, beam, color=colour, lw=2, label=f"{sun:.0f}°")
ax.set(xlabel="wavelength [nm]", ylabel="spectral irradiance [W m⁻² nm⁻¹]")
ax.legend(title="sun from the zenith", loc="upper left", bbox_to_anchor=(1.0, 1.0))
plt.show()

# %% [markdown]
# ## The sky, and the eye
#
# What the beam lost is the sky's. The eye weighs a spectrum by three curves; their sums X, Y and Z
# are the colour. Y is the luminance, x = X / (X + Y + Z) and y the chromaticity.

# %%
height_deg = np.array([90.0, 60.0, 30.0, 15.0, 8.0, 4.0, 2.0])
aside = np.full(height_deg.size, np.pi / 2)
look = af.Directions(np.radians(90.0 - height_deg), aside)
sky = np.asarray(af.simulate_sky(air, np.radians(60.0), look, λ, rtol=RTOL))
curves = cie1931_2deg()
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for place in (0, 3, 6):
    left.plot(λ, 1e3 * sky[place], label=f"{height_deg[place]:g}° above the horizon")
left.set(xlabel="wavelength [nm]", ylabel="radiance [mW m⁻² sr⁻¹ nm⁻¹]", ylim=(0, None))
left.legend(frameon=False, fontsize=8)
for name, curve, colour in zip("xyz", np.transpose(curves.xyz), ("C3", "C2", "C0"), strict=True):
    right.plot(curves.wavelength_nm, curve, color=colour, label=name)
right.set(xlabel="wavelength [nm]", ylabel="sensitivity of the eye [-]", xlim=(380, 780))
right.legend(frameon=False)
plt.show()

# %% [markdown]
# ## On a map of colours
#
# White light of equal energy lies at x = y = 1/3. From the zenith down the sky moves toward white,
# since near the horizon blue light is scattered out again on its way. The sun goes the other way
# round: from white to orange. Large dots are painted in their own colour.

# %%
sky_xy = np.asarray(af.spectrum_to_xyY(sky, λ))[:, :2]
sun_xy = np.asarray([af.spectrum_to_xyY(beam, λ) for beam in beams])[:, :2]
figure, ax = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
for name, points in (("sky, 90° to the sun's side", sky_xy), ("sun", sun_xy)):
    ax.plot(*points.T, color="0.5", lw=1, zorder=1)
    paint = on_film([[x, y, 1.0] for x, y in points], 1.0)
    ax.scatter(*points.T, c=paint, s=90, edgecolors="0.3", zorder=2)
    ax.annotate(name, points[0], xytext=(12, -4), textcoords="offset points")
ax.plot(1 / 3, 1 / 3, "k+", ms=9)
ax.set(xlabel="x [-]", ylabel="y [-]")
plt.show()
for height, (x, y) in zip(height_deg, sky_xy, strict=True):
    print(f"sky {height:4.0f}° above the horizon: x {x:.3f}, y {y:.3f}")

# %% [markdown]
# ## Your turn
#
# 1. Take the haze away (`af.Atmosphere.standard()`). How far does the zenith move on the map?
# 2. Take the ozone away (`ozone_dobson=0.0`) and lower the sun to 88°. Which way does the zenith
#    move? The blue of twilight is ozone's.
# 3. What would be the colour of a sky whose molecules scattered all wavelengths alike?
