# %% [markdown]
# # Another planet
#
# Hoffman and Preetham (2002) remark in passing that the colours of their paper belong to the Earth,
# and that other air would look quite different. Here are two such skies: one with coarse, rusty
# dust as on Mars, one under a thick organic haze as on Titan.
#
# Both are *like* the real ones: spheres of one material, one even haze, constants rounded. What is
# measured is named with its source; what is our choice is called so.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.render.film import on_film
from atmofit.render.panorama import draw_sky
from atmofit.render.refit_pictures import exposure

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # coarse, for the tests
RTOL, RADII, STREAMS = (1e-1, 120, 8) if FAST else (1e-2, 400, 32)
SLAB_PLAN = af.SlabPlan(STREAMS, STREAMS, 14)

# %% [markdown]
# ## The dust
#
# Cameras on Mars found grains with an effective radius of about 1.7 µm and an effective variance of
# .25 (Markiewicz and others 1999, J. Geophys. Res. 104, 9009). For a lognormal distribution this
# means a median of .97 µm and a factor of 1.6. Iron oxide absorbs blue light. We choose 1.5 for the
# real part of the refractive index, and an imaginary part that falls from .014 in the violet to
# .003 in the red.

# %%
wavelength_nm = np.arange(380.0, 781.0, 50.0)
rust = np.interp(
    wavelength_nm, [380, 440, 500, 600, 680, 780], [14e-3, 12e-3, 8e-3, 4e-3, 3e-3, 3e-3]
)
variance = 0.25
width = np.sqrt(np.log(1 + variance))
sizes = af.lognormal_sizes(1.7e-6 * np.exp(-2.5 * width**2), np.exp(width))
fine = af.lognormal_sizes(0.05e-6, np.exp(width))  # like smoke on the Earth
grains = {
    "Mars-like": af.mie_optics(sizes, 1.5 + 1j * rust, wavelength_nm, radius_count=RADII),
    "coarse, white": af.mie_optics(sizes, 1.5, wavelength_nm, radius_count=RADII),
    "fine, rusty": af.mie_optics(fine, 1.5 + 1j * rust, wavelength_nm, radius_count=RADII),
}
BLUE, RED = 1, 6  # 430 and 680 nm
colours = {"Mars-like": "#b4552d", "coarse, white": "#555555", "fine, rusty": "#1f5fa8"}

fig, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
for name, each in grains.items():
    relative = each.extinction_cross_section / each.extinction_cross_section[3]
    axes[0].plot(wavelength_nm, relative, color=colours[name], label=name)
    axes[1].plot(wavelength_nm, each.single_scattering_albedo, color=colours[name])
    phase = each.phase_function * each.single_scattering_albedo
    angle = np.degrees(each.scattering_angle)
    axes[2].plot(angle, phase[:, BLUE] / phase[:, RED], color=colours[name])
axes[0].set(ylabel="extinction / at 530 nm [-]", yscale="log")
axes[0].set_yticks([0.3, 0.5, 1, 2, 3], [0.3, 0.5, 1, 2, 3])
axes[1].set(ylabel="single-scattering albedo [-]", ylim=(0.6, 1.02))
axes[2].set(xlabel="scattering angle [°]", ylabel="scattered, 430 nm / 680 nm [-]", yscale="log")
axes[2].set_yticks([0.5, 1, 2], [0.5, 1, 2])
axes[2].axhline(1.0, color="#999999", lw=0.8)
for ax in axes[:2]:
    ax.set_xlabel("wavelength [nm]")
for ax in axes[::2]:
    ax.minorticks_off()
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# The three curves of the dust say it all. Coarse grains take away every colour alike, so the sun
# keeps its own. They absorb blue, so light that has been scattered is short of it. But grains large
# against the wavelength send much of their light straight on, in a cone that is the narrower the
# shorter the wavelength: within some ten degrees of the sun there is *more* blue. Fine grains do
# the opposite everywhere.
#
# ## Noon and evening
#
# The gas is carbon dioxide at 610 Pa. Its molecules have a cross section of 1.24e-30 m² at 532 nm
# (Sneep and Ubachs 2005, J. Quant. Spectrosc. Radiat. Transfer 92, 293), which gives an optical
# depth of .003: without dust the sky would be nearly black. Dust, well mixed, has a depth of .5.
# The ground's albedo is our choice, rising from .05 in the violet to .3 in the red. For the picture
# of the Earth, `ATMOFIT_2026` stands in.

# %%
molecule, gravity = 44.01 * 1.6605e-27, 3.71  # [kg], [m/s²]
blue_gas = 610.0 / (molecule * gravity) * 1.24e-30 * (532.0 / wavelength_nm) ** 4
gas = af.Molecules(af.Spectrum(wavelength_nm, blue_gas, smooth=True), scale_height=11e3)
soil = np.interp(wavelength_nm, [380, 500, 580, 680, 780], [0.05, 0.08, 0.17, 0.27, 0.3])
ground = af.Ground(af.Spectrum(wavelength_nm, soil, smooth=True))


def dusty(name, depth=0.5):
    haze = grains[name].haze(depth, scale_height=11e3)
    return af.Atmosphere(gas, haze, ground=ground, preset="standard", radius=3.39e6)


zenith = np.radians([0, 8, 16, 24, 32, 40, 48, 56, 64, 70, 75, 79, 82, 84, 86, 88, 90])
azimuth = np.radians([0, 3, 6, 10, 15, 22, 30, 45, 60, 75, 90, 105, 120, 135, 150, 165, 180])
grid = af.DirectionGrid(zenith, azimuth)
PLAN = af.plan_sky(dusty("Mars-like"), orders="all", rtol=RTOL, all_wavelengths=True)
fine_nm = np.arange(380.0, 781.0, 10.0)
between = np.stack([np.interp(fine_nm, wavelength_nm, row) for row in np.eye(9)])
sunlight = np.asarray(af.solar_irradiance_spectrum("standard")(fine_nm))  # at the Earth


def xyY_of(radiance, distance_au):
    return np.asarray(af.spectrum_to_xyY(radiance @ between * sunlight / distance_au**2, fine_nm))


def sky_of(atmosphere, sun, where=grid):
    field = af.solve_sky(atmosphere, wavelength_nm, plan=PLAN)
    return np.asarray(field.radiance(np.radians(sun), where, solar_irradiance=1.0))


# %%
suns = (40.0, 86.0)
mars = {sun: sky_of(dusty("Mars-like"), sun) for sun in suns}
fig, axes = plt.subplots(2, 2, figsize=(7.4, 7.6), layout="constrained")
for row, sun in zip(axes, suns, strict=True):
    earth = np.asarray(af.ATMOFIT_2026(3.0, np.radians(sun), grid, albedo=0.2))
    for ax, name, xyY in (
        (row[0], "Earth", earth),
        (row[1], "Mars-like", xyY_of(mars[sun], 1.524)),
    ):
        white = exposure(xyY[..., 2])
        draw_sky(ax, grid, xyY, white_luminance=white, solar_zenith_angle=np.radians(sun))
        ax.set_title(f"{name}, sun {90 - sun:g}° high", fontsize=10)
plt.show()
for sun in suns:
    x, y, Y = xyY_of(mars[sun], 1.524)[0, 0]
    print(f"Mars-like zenith, sun {90 - sun:g}° high: x {x:.3f}, y {y:.3f}, {Y:.0f} cd/m²")

# %% [markdown]
# Butterscotch by day, and blue round the low sun, as the landers saw it; the Earth has it the other
# way round. (Each picture has its own exposure.) Turned toward the low sun, 64 degrees wide:

# %%
toward = af.DirectionGrid(np.radians(np.linspace(58.0, 90.0, 17)), np.radians(np.arange(0, 34, 2)))
evening = xyY_of(sky_of(dusty("Mars-like"), 86.0, toward), 1.524)
views = {
    "Earth": np.asarray(af.ATMOFIT_2026(3.0, np.radians(86.0), toward, albedo=0.2)),
    "Mars-like": evening,
}
fig, axes = plt.subplots(1, 2, figsize=(10, 2.9), layout="constrained")
for ax, (name, xyY) in zip(axes, views.items(), strict=True):
    half = on_film(xyY, 1.5 * exposure(xyY[..., 2]))
    both = np.concatenate([half[:, :0:-1], half], axis=1)
    ax.imshow(both, extent=(-33, 33, -1, 33), interpolation="bicubic")
    ax.plot([0], [4], "o", ms=5, mfc="white", mec="black")
    ax.set(title=name, xlabel="beside the sun [°]", ylim=(0, 32))
axes[0].set_ylabel("above the horizon [°]")
plt.show()

# %% [markdown]
# ## What makes the evening blue
#
# The same air with each of the grains, sun 4 degrees high: blue over red against the angle from the
# sun, straight up from it, over the ratio in sunlight.

# %%
up = zenith <= np.radians(86.0)
apart = 86.0 - np.degrees(zenith[up])
low = {name: sky_of(dusty(name), 86.0)[up, 0] for name in grains}
fig, ax = plt.subplots(figsize=(6.6, 3.6), layout="constrained")
for name, radiance in low.items():
    ratio = radiance[:, BLUE] / radiance[:, RED]
    ax.plot(apart, ratio, "o-", ms=3, color=colours[name], label=name)
ax.axhline(1.0, color="#999999", lw=0.8)
ax.set(xlabel="above the sun [°]", ylabel="430 nm / 680 nm, over sunlight [-]", yscale="log")
ax.set_yticks([0.1, 0.3, 1, 3], [0.1, 0.3, 1, 3])
ax.minorticks_off()
ax.legend(frameon=False)
plt.show()
print("the sun itself, 430 nm / 680 nm, over sunlight:")
for name in grains:
    disk = np.asarray(af.simulate_sun(dusty(name), np.radians(86.0), wavelength_nm, 1.0))
    print(f"  {name:<14} {disk[BLUE] / disk[RED]:.3f}")

# %% [markdown]
# Both coarse grains make the glow blue, with iron in them or without: it is the narrow cone of blue
# forward scattering, as Ehlers, Chakrabarty and Moosmüller found (2014, Applied Optics 53, 1808),
# and hardly what is lost on the way, since the sun itself changes little. What the iron makes is
# the rest of the sky. Fine grains redden sun and glow alike, as on the Earth.
#
# ## A dusty season
#
# The optical depth is a traced number: other values compile nothing. Colour and brightness of the
# zenith, the sun 50 degrees high.

# %%
depths = np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
top = np.array([xyY_of(sky_of(dusty("Mars-like", d), 40.0)[0, 0], 1.524) for d in depths])
fig, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
left.loglog(depths, top[:, 2], "o-", color="#b4552d")
left.set(xlabel="optical depth of the dust [-]", ylabel="luminance of the zenith [cd m⁻²]")
right.plot(top[:, 0], top[:, 1], "o-", color="#b4552d")
for d, (x, y, _) in zip(depths, top, strict=True):
    right.annotate(f"{d:g}", (x, y), xytext=(5, -10), textcoords="offset points", fontsize=8)
white = np.asarray(af.spectrum_to_xyY(sunlight, fine_nm))
right.plot(*white[:2], "*", ms=12, color="#e0a000", label="sunlight")
right.set(xlabel="x [-]", ylabel="y [-]")
right.legend(frameon=False)
plt.show()

# %% [markdown]
# Only where the dust has nearly settled do the molecules show, in a dark sky that turns toward
# blue. (Numbers: optical depth of the dust.)
#
# ## Under a thick haze
#
# Titan's haze is thick, and absorbs blue and violet. Our choice: optical depth 4 at 550 nm,
# inverse to the wavelength; single-scattering albedo from .65 in the violet to .97 in the red;
# asymmetry .65; a ground of albedo .15. Nearly all of the light arrives in many scatterings, so a
# slab with all orders is the tool, one wavelength after the other.

# %%
haze_depth = 4.0 * 550.0 / wavelength_nm
albedo = np.interp(wavelength_nm, [380, 450, 550, 650, 780], [0.65, 0.74, 0.88, 0.95, 0.97])
lobe = af.HenyeyGreenstein(0.65)
heights = np.array([70.0, 60.0, 50.0, 40.0, 30.0, 20.0, 15.0, 10.0, 7.0, 4.0])  # of the sun [°]
SUNS, SHOWN = np.radians(90.0 - heights), 2


def slab_at(k):
    slab = {"optical_depth": haze_depth[k], "single_scattering_albedo": albedo[k], "phase": lobe}
    return af.solve_slab(**slab, solar_zenith_angle=SUNS, ground_albedo=0.15, plan=SLAB_PLAN)


slabs = [slab_at(k) for k in range(wavelength_nm.size)]
below = np.stack([np.asarray(slab.radiance(grid)) for slab in slabs], axis=-1)
titan = xyY_of(below[SHOWN], 9.58)
fig = plt.figure(figsize=(10, 3.6), layout="constrained")
left, middle = fig.add_subplot(1, 3, 1), fig.add_subplot(1, 3, (2, 3))
draw_sky(left, grid, titan, white_luminance=exposure(titan[..., 2]), solar_zenith_angle=SUNS[SHOWN])
left.set_title("Titan-like, sun 50° high", fontsize=10)
for name, colour in (
    ("direct_transmittance", "#e0a000"),
    ("diffuse_transmittance", "#b4552d"),
    ("reflectance", "#555555"),
):
    share = [float(getattr(slab, name)[SHOWN]) for slab in slabs]
    middle.semilogy(wavelength_nm, share, "o-", color=colour, label=name.replace("_", " "))
middle.set(xlabel="wavelength [nm]", ylabel="share of the sunlight [-]", ylim=(1e-4, 1))
middle.legend(frameon=False)
plt.show()
print(f"zenith: x {titan[0, 0, 0]:.3f}, y {titan[0, 0, 1]:.3f}, {titan[0, 0, 2]:.1f} cd/m²")

# %% [markdown]
# The sun cannot be seen, and the sky has one colour: orange, since each of the many scatterings
# takes some more of the blue. The last figure is small for two reasons: the haze, and a sun 92
# times as weak as ours (9.58 astronomical units).
#
# ## The same by the simulator, and dusk
#
# A slab is flat. The simulator takes the same haze as a shell, with a scale height of 30 km (our
# choice; the real haze reaches higher still) round a world of 2575 km, or flat. The flat one should
# agree with the slab, and as they share no method, that is worth something. The right half follows
# the evening: the zenith of the Mars-like sky and of the Earth's.

# %%
nitrogen = af.Molecules(af.Spectrum(wavelength_nm, 0 * wavelength_nm, smooth=True))
haze = af.Haze(
    af.Spectrum(wavelength_nm, haze_depth, smooth=True),
    scale_height=30e3,
    single_scattering_albedo=af.Spectrum(wavelength_nm, albedo, smooth=True),
    phase=lobe,
)
soil = af.Ground(0.15)
worlds = {
    "flat": af.Atmosphere(nitrogen, haze, ground=soil, preset="standard", geometry="flat"),
    "round": af.Atmosphere(nitrogen, haze, ground=soil, preset="standard", radius=2.575e6),
}
overhead = af.Directions([0.0], [0.0])


def zenith_of(world):
    field = af.solve_sky(world, wavelength_nm, orders="all", rtol=RTOL)
    return np.array([xyY_of(field.radiance(s, overhead, 1.0)[0], 9.58)[2] for s in SUNS])


titan_Y = {name: zenith_of(world) for name, world in worlds.items()}
round_mars = af.solve_sky(dusty("Mars-like"), wavelength_nm, plan=PLAN)
slab_Y = xyY_of(below[:, 0, 0], 9.58)[:, 2]
late = np.radians(np.arange(40.0, 96.5, 2.0))
red_dusk = np.array([round_mars.radiance(sun, overhead, 1.0)[0] for sun in late])
known = late[late <= np.radians(92.0)]
earth = np.array([af.ATMOFIT_2026(3.0, sun, overhead, albedo=0.2)[0, 2] for sun in known])
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(heights, slab_Y, "o-", color="#b4552d", label="slab")
for (name, Y), colour, marker in zip(titan_Y.items(), ("#1f5fa8", "#555555"), "+x", strict=True):
    left.semilogy(heights, Y, marker + "--", color=colour, label=f"{name}, by the simulator")
left.set(ylabel="zenith, Titan-like [cd m⁻²]")
for name, angle, Y, colour in (
    ("Mars-like", late, xyY_of(red_dusk, 1.524)[:, 2], "#b4552d"),
    ("Earth", known, earth, "#1f5fa8"),
):
    right.semilogy(90 - np.degrees(angle), Y / Y[0], color=colour, label=name)
right.axvline(0.0, color="#999999", lw=0.8, ls=":")
right.set(ylabel="zenith / at 50° [-]")
for ax in (left, right):
    ax.set(xlabel="height of the sun [°]")
    ax.invert_xaxis()
    ax.legend(frameon=False)
plt.show()
for name, Y in titan_Y.items():
    print(name, "/ slab:", np.round(Y / slab_Y, 2))

# %% [markdown]
# After sunset the Mars-like sky stays bright for longer, since its dust reaches ten times as high.
# In the left half slab and flat simulator agree (the numbers above; to 2 % at `rtol=1e-2` and 32
# streams). Round the small world the haze is a shell, whose top the low sun lights from the side:
# at 4 degrees the zenith is more than twice as bright. A haze this thick takes more orders than
# thin air before the rest follows from them; `plan_sky` sees that and says how many.
#
# ## Your turn
#
# 1. How large must the grains be for a blue evening? Try medians from .1 to 2 µm.
# 2. Give the Earth's air the Mars-like dust (`af.Molecules()`, the Earth's radius). Which of the
#    two skies wins at a depth of .5, and at which depth are they even?
# 3. Thin Titan's haze until the sun can be seen as a disk. What colour is the sky then?
# 4. Take the haze's scale height down to 3 km. From which sun on is the world flat to a percent?
