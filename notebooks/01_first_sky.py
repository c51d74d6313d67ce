# %% [markdown]
# # A first sky in ten lines
#
# From one number, the turbidity, to a whole sky: its picture, what each order of scattering adds,
# what was left out, and how every direction answers to a little more haze.
#
# Angles are in radians, spectral radiance in W m⁻² sr⁻¹ nm⁻¹, luminance in cd m⁻².

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.notebook import sliders
from atmofit.render.panorama import DIFFERENCES, draw_dome, draw_sky
from atmofit.render.refit_pictures import exposure

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # coarser, for the tests
RTOL = 5e-2 if FAST else 1e-2  # promised relative error of luminance

# %% [markdown]
# ## The sky
#
# *Turbidity* measures haze: 1 is air without any, 2 a very clear day, 6 a hazy one. The grid
# covers half of the dome: azimuth 0 points to the sun, and the other half is its mirror image.
#
# The first call compiles the simulator for shapes like these, which takes a while. Other numbers
# in the same shapes are then fast.

# %%
turbidity = 3.0
sun = np.radians(60.0)  # from the zenith
wavelength_nm = np.arange(380.0, 781.0, 10.0)
zenith, azimuth = np.radians(np.arange(0, 91, 5)), np.radians(np.arange(0, 181, 10))
grid = af.DirectionGrid(zenith, azimuth)
atmosphere = af.Atmosphere.from_turbidity(turbidity)
radiance = af.simulate_sky(atmosphere, sun, grid, wavelength_nm, orders=2, rtol=RTOL)
xyY = af.spectrum_to_xyY(radiance, wavelength_nm)
ax = plt.figure(figsize=(4.2, 4.2)).add_subplot()
draw_sky(ax, grid, xyY, white_luminance=exposure(xyY[..., 2]), solar_zenith_angle=sun)
plt.show()

# %% [markdown]
# This is a fisheye picture: the zenith in the middle, the horizon around it, the sun at the top.
# The dot only marks the sun, since its disk is not simulated; the glow around it is light that
# the haze sends forward. The horizon is pale because one looks through much air there.
#
# Slide turbidity and sun. One plan serves them all, so nothing is compiled again.

# %%
plan = af.plan_sky(atmosphere, solar_zenith_angle=np.radians([0.0, 88.0]), rtol=RTOL)
white = exposure(xyY[..., 2])


def colours(turbidity, sun):
    air, nm = af.Atmosphere.from_turbidity(turbidity), wavelength_nm
    return af.spectrum_to_xyY(af.simulate_sky(air, sun, grid, nm, plan=plan), nm)


def show_sky(turbidity, sun_deg):
    ax, sun = plt.figure(figsize=(4.2, 4.2)).add_subplot(), np.radians(sun_deg)
    draw_sky(ax, grid, colours(turbidity, sun), white_luminance=white, solar_zenith_angle=sun)


sliders(show_sky, turbidity=(1.7, 3.0, 10.0), sun_deg=(0.0, 75.0, 88.0))

# %% [markdown]
# The numbers behind the picture are a spectrum for every direction, and three numbers made of it:
# chromaticity x and y, and luminance Y.

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
image = draw_dome(left, grid, np.log10(xyY[..., 2]), solar_zenith_angle=sun)
fig.colorbar(image, ax=left, label="log₁₀ (luminance / cd m⁻²)", shrink=0.8)
for place, name, colour in (
    ((0, 0), "zenith", "#1f5fa8"),
    ((-2, -1), "5° above the horizon, away from the sun", "#c05020"),
    ((-2, 9), "5° above the horizon, to the side", "#555555"),
):
    right.plot(wavelength_nm, 1e3 * radiance[place], color=colour, label=name)
right.set(xlabel="wavelength [nm]", ylabel="radiance [mW m⁻² sr⁻¹ nm⁻¹]", ylim=(0, None))
right.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# The zenith is blue: its spectrum falls steeply with wavelength. Near the horizon the blue light
# itself is scattered out again on its long way, and the spectrum becomes flatter. The teeth are
# the sun's own.
#
# ## Once or twice scattered
#
# `orders=1` counts light that was scattered once, `orders=2` also light that was scattered twice.
# The meridian through the sun is made of the first and the last azimuth of the grid.

# %%
once = af.simulate_sky(atmosphere, sun, grid, wavelength_nm, orders=1, rtol=RTOL)
angle_deg = np.degrees(np.concatenate([-zenith[:0:-1], zenith]))


def along_meridian(Y):
    return np.concatenate([Y[:0:-1, -1], Y[:, 0]])


Y1 = along_meridian(af.spectrum_to_xyY(once, wavelength_nm)[..., 2])
Y2 = along_meridian(xyY[..., 2])

fig, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained", sharex=True)
left.semilogy(angle_deg, Y1 / 1e3, "--", color="#c05020", label="order 1")
left.semilogy(angle_deg, Y2 / 1e3, color="#1f5fa8", label="orders 1 and 2")
left.set(ylabel="luminance [kcd m⁻²]")
left.set_yticks([1, 2, 5, 10, 20], [1, 2, 5, 10, 20])
left.legend(frameon=False)
right.plot(angle_deg, 100 * (1 - Y1 / Y2), color="#222222")
right.set(ylabel="share of order 2 [%]", ylim=(0, None))
for ax in (left, right):
    ax.axvline(np.degrees(sun), color="#999999", lw=0.8, ls=":")
    ax.set(xlabel="angle from the zenith, positive toward the sun [°]", xticks=range(-90, 91, 30))
plt.show()

# %%
share = 100 * (1 - Y1 / Y2)
print(f"Share of order 2 at the zenith:        {share[angle_deg == 0][0]:.0f} %")
print(f"Largest share, at {angle_deg[share.argmax()]:+.0f} degrees:          {share.max():.0f} %")
print(f"Smallest share, at {angle_deg[share.argmin()]:+.0f} degrees:         {share.min():.0f} %")

# %% [markdown]
# Near the sun the forward glow of single scattering leaves little room for the second order; far
# from it and low in the sky the second order carries much of the light. Where order 2 is large,
# order 3 will not be nothing.
#
# ## What was left out
#
# A plan says how a sky is computed, and what is not in it. Read it before you trust a number.

# %%
print(af.plan_sky(atmosphere, solar_zenith_angle=sun, orders=2, rtol=RTOL))

# %% [markdown]
# ## How the sky answers to haze
#
# The simulator is a function that JAX can differentiate. `jax.jvp` follows one input, the
# turbidity, through everything: it returns the sky and its derivative in every direction at once.
# (`jax.grad` goes the other way: one output, its derivatives with respect to many inputs.)

# %%
where, direction = (turbidity,), (1.0,)


def luminance(T):
    sky = af.simulate_sky(af.Atmosphere.from_turbidity(T), sun, grid, wavelength_nm, rtol=RTOL)
    return af.spectrum_to_xyY(sky, wavelength_nm)[..., 2]


Y, slope = jax.jvp(luminance, where, direction)
percent = 100 * np.asarray(slope / Y)

# %% [markdown]
# Is it right? Two more skies, with a little more and a little less haze, give the same by
# differences: the dots on the right.

# %%
step = 0.25
by_difference = (luminance(turbidity + step) - luminance(turbidity - step)) / (2 * step)

fig, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
reach = np.abs(percent).max()
image = draw_dome(
    left, grid, percent, limits=(-reach, reach), colour_map=DIFFERENCES, solar_zenith_angle=sun
)
fig.colorbar(image, ax=left, label="change of luminance [% per unit of turbidity]", shrink=0.8)
right.plot(angle_deg, along_meridian(percent), color="#1f5fa8", label="jax.jvp")
dots = along_meridian(100 * by_difference / Y)
right.plot(angle_deg, dots, "o", ms=4, mfc="none", color="#222222", label="differences")
right.axhline(0, color="#999999", lw=0.8)
right.axvline(np.degrees(sun), color="#999999", lw=0.8, ls=":")
right.set(
    xlabel="angle from the zenith, positive toward the sun [°]",
    ylabel="d ln Y / dT [% per unit]",
    xticks=range(-90, 91, 30),
)
right.legend(frameon=False)
plt.show()

# %% [markdown]
# Where the map is red, more haze brightens the sky: more light is sent toward you than is lost.
# Where it is blue, more is lost on the way.
#
# The map also says where to look if you want to *measure* turbidity: where the derivative is
# large, a small error of the luminance is a small error of T; on the white line you learn
# nothing.

# %%
best = np.unravel_index(np.abs(percent).argmax(), percent.shape)
for name, place in (("the zenith", (0, 0)), ("the best direction", best)):
    θ, φ = np.degrees(zenith[place[0]]), np.degrees(azimuth[place[1]])
    print(f"1 % in Y at {name} ({θ:.0f}° from the zenith, azimuth {φ:.0f}°)", end=" ")
    print(f"is {1 / abs(percent[place]):.3f} in turbidity")

# %% [markdown]
# ## Your turn
#
# 1. Lower the sun to 85°. Where is the share of order 2 largest now, and is `orders=2` still
#    enough?
# 2. At `turbidity = 6.0`, does the zenith still brighten with haze? At which turbidity is it
#    brightest?
# 3. Differentiate with respect to the sun instead: which parts of the sky brighten as the sun
#    sets?
# 4. Put a layer of ozone into the atmosphere (`af.Absorber`) and print its plan. What has
#    changed, and why may fewer wavelengths no longer stand for all of them?
