# %% [markdown]
# # Rings, dust and slabs
#
# A flat layer of small particles stands for rings, dusty moons and clouds. Blinn (1982) lit it by
# single scattering. Here is his slab from both sides, what light scattered more than once adds, and
# what measured brightness tells about the particles.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.notebook import sliders

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # few streams, for the tests
STREAMS = 8 if FAST else 32
PLAN = af.SlabPlan(STREAMS, STREAMS, 20)

# %% [markdown]
# ## One expression, lit from above and from below
#
# How much of a slab is both lit and seen depends on its optical depth and two cosines. The sun
# wanders from overhead to straight below; the observer stays at 60 degrees. Printed in three cases
# (above, below, and opposite directions), it is one here, without a jump or a 0 / 0.

# %%
sun = np.radians(np.linspace(0.0, 180.0, 721))
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for depth in (0.1, 0.5, 2.0, 1000.0):
    seen = af.slab_single_scattering(depth, 0.5, np.cos(sun))
    ax.plot(np.degrees(sun), seen, label=f"optical depth {depth:g}")
ax.axvline(120.0, color="0.6", lw=0.8, ls=":")
ax.text(121.0, 0.55, "sun straight behind", color="0.4")
ax.set(xlabel="angle between sun and normal [°]", ylabel="lit and seen [-]")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# Beyond 90° the observer is on the dark side: a slab of depth 2 shines through, a thick one is
# black, and a thin one hardly minds the side. Near opposite directions the formula of the dark side
# loses its digits in float32; this one keeps them. The limit is 4 exp(-4) = 0.0732626.

# %%
depth, view, cosine = np.float32(2), np.float32(0.5), np.float32([-0.50001, -0.500001, -0.5000001])
print(cosine / (cosine + view) * (np.exp(depth / cosine) - np.exp(-depth / view)), "as printed")
print(af.slab_single_scattering(depth, view, cosine), "here")

# %% [markdown]
# ## Blinn's Figure 8
#
# Light sent in each direction, as seen on a plane parallel to the slab: brightness times the cosine
# of the direction. White particles, the same in all directions; light from the arrow.

# %%
around = np.radians(np.linspace(-89.9, 89.9, 200))
sides = {"above": (around, 1.0), "below": (np.pi - around, -1.0)}
rows, suns = (1000.0, 2.0, 0.5, 0.1), np.radians([36.0, 72.0])
figure, axes = plt.subplots(
    2, 4, figsize=(11, 5.6), layout="constrained", subplot_kw={"projection": "polar"}
)
for row_of_axes, sun in zip(axes, suns, strict=True):
    for ax, depth in zip(row_of_axes, rows, strict=True):
        for angle, side in sides.values():
            sent = af.slab_single_scattering(depth, np.cos(around), side * np.cos(sun))
            ax.fill(angle, np.asarray(sent) * np.cos(around), color="C0" if side > 0 else "C1")
        ax.annotate("", (sun, 0.04), (sun, 0.48), arrowprops={"arrowstyle": "->", "color": "C3"})
        ax.set(theta_zero_location="N", rlim=(0.0, 0.5), rticks=[0.25], xticklabels=[])
        ax.set_theta_direction(-1)
        ax.set_title(f"depth {depth:g}, sun at {np.degrees(sun):.0f}°", fontsize=9)
plt.show()

# %% [markdown]
# ## Phase functions, and two ways to count the angle
#
# Planetary science counts the *phase angle*, 0 at full moon; atmofit counts the *scattering angle*,
# 0 straight on. One is pi minus the other, so an asymmetry changes its sign. Blinn's phase
# functions have a mean of 1, ours integrate to 1.

# %%
phases = {
    "Lambert sphere": af.LambertSphere(),
    "Rayleigh": af.Rayleigh(),
    "furnace slag": af.furnace_slag_phase(),
    "Saturn's rings": af.saturn_ring_phase(),
}
angle = np.radians(np.linspace(0.0, 180.0, 181))
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for name, phase in phases.items():
    ax.plot(np.degrees(angle), af.phase_of_phase_angle(phase, angle), label=name)
ax.set(xlabel="phase angle [°]", ylabel="phase function, mean 1 [-]", yscale="log", ylim=(0.05, 5))
ticks = ax.secondary_xaxis("top", functions=(lambda x: 180 - x, lambda x: 180 - x))
ticks.set_xlabel("scattering angle [°]")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# ## How many orders matter
#
# Blinn leaves out light that was scattered more than once, and warns of albedos above .3.
# `solve_slab` has all orders. For a thick slab that scatters alike in all directions the answer has
# been known since Chandrasekhar: lit and seen from straight above, H(1)² times single scattering.

# %%
albedos = np.asarray([0.05, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99])
cosine = np.linspace(0.05, 1.0, 20)
suns = np.arccos(cosine)
back = af.Directions(np.pi - suns, np.full(cosine.size, np.pi))  # toward the slab, sun behind us


def once(depth, albedo):
    return albedo / (4 * np.pi) * af.slab_single_scattering(depth, 1.0, 1.0)


def all_orders(depth, albedo):
    slab = {"optical_depth": depth, "single_scattering_albedo": albedo, "phase": af.Isotropic()}
    return np.diagonal(af.solve_slab(**slab, solar_zenith_angle=suns, plan=PLAN).radiance(back))


figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for depth in (0.1, 1.0, 10.0, 1000.0):
    ax.plot(albedos, [all_orders(depth, a)[-1] / once(depth, a) for a in albedos], label=depth)
ax.plot(albedos, af.h_function(1.0, albedos) ** 2, "k.", label="H(1)²")
ax.axvline(0.3, color="0.6", lw=0.8, ls=":")
ax.set(xlabel="single-scattering albedo [-]", ylabel="all orders / single [-]")
ax.legend(frameon=False, title="optical depth [-]")
plt.show()
for albedo in (0.1, 0.3, 0.6, 0.9):
    print(f"albedo {albedo}: H(1) = {af.h_function(1.0, albedo):.3f}")

# %% [markdown]
# Slide optical depth and asymmetry of a slab that absorbs nothing, under a sun 60 degrees from the
# normal. The angle counts from the normal, positive where one looks toward the sun; blue is seen
# from below, orange from above.

# %%
tilt = np.radians(np.linspace(-85.0, 85.0, 69))
toward = np.where(tilt > 0, 0.0, np.pi)
looks = [af.Directions(zenith, toward) for zenith in (np.abs(tilt), np.pi - np.abs(tilt))]
shape = {"figsize": (6, 3.4), "layout": "constrained"}
labels = {"xlabel": "angle from the normal [°]", "ylabel": "radiance / irradiance [1/sr]"}


def solved(depth, asymmetry):
    slab = {"optical_depth": depth, "phase": af.HenyeyGreenstein(asymmetry), "plan": PLAN}
    return af.solve_slab(**slab, single_scattering_albedo=1.0, solar_zenith_angle=np.pi / 3)


def show_slab(log10_depth, asymmetry):
    seen = [solved(10**log10_depth, asymmetry).radiance(look) for look in looks]
    plt.figure(**shape).add_subplot(**labels).plot(np.degrees(tilt), np.transpose(seen))


sliders(show_slab, log10_depth=(-2.0, 0.0, 2.0), asymmetry=(0.0, 0.6, 0.85))

# %% [markdown]
# ## Thick clouds turn to Lambert's law
#
# Blinn ends with the remark that many scatterings should lead to Lambert's law, and that cloudy
# Jupiter follows it. A planet at full phase, from its centre (cosine 1) to its limb: single
# scattering makes a flat disc, Lambert's law fades in proportion to the cosine.

# %%
figure, ax = plt.subplots(figsize=(7, 3.4), layout="constrained")
for albedo in (0.3, 0.9, 0.99, 1.0):
    seen = all_orders(1000.0, albedo)
    k = 0.5 * (1 + np.polyfit(np.log(cosine[10:]), np.log(seen[10:]), 1)[0])
    ax.plot(cosine, seen / seen[-1], label=f"albedo {albedo:g}, Minnaert k {k:.2f}")
ax.plot(cosine, cosine, "k--", lw=0.8, label="Lambert, k 1")
ax.set(xlabel="cosine of sun and observer [-]", ylabel="brightness / at the centre [-]")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# White clouds come near Lambert's law but keep a brighter limb; dark ones stay nearly a flat disc.
#
# ## What a phase curve tells
#
# Esposito and Lumme found two lobes in the light of Saturn's rings. Here is a curve made with their
# values and 2 % of noise, and the fit with its uncertainty: once over phase angles that a
# spacecraft reaches, once over the 6 degrees that can be seen from the Earth.

# %%
noise = np.random.default_rng(1).standard_normal(40)
saturn, known = af.saturn_ring_phase(), {"optical_depth": 1.0}
curves = {"spacecraft": np.linspace(5.0, 170.0, 40), "Earth": np.linspace(0.2, 6.0, 40)}
figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for ax, (name, degrees) in zip(axes, curves.items(), strict=True):
    view = af.SlabView(0.05, 0.05, np.pi - np.radians(degrees))
    model = 0.6 * saturn(view.scattering_angle) * af.slab_single_scattering(1.0, 0.05, 0.05)
    measured = np.asarray(model) * (1 + 0.02 * noise)
    found = af.fit_dust(view, measured, relative_noise=0.02, known=known)
    ax.plot(degrees, measured, ".", color="0.6", label="measured")
    ax.plot(degrees, found.predict(view), label="fit")
    ax.set(xlabel="phase angle [°]", ylabel="radiance / irradiance [1/sr]", title=name)
    print(name, found)
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# Both fits pass through the data. From the Earth the lobes cannot be told from the albedo: the
# condition number says so, and `undetermined` lists what is open. Make a noise of your own and see
# how often the truth (.6, .596, ±.5) lies within two errors.
#
# ## How the brightness answers to more dust
#
# Everything is differentiable: the slope of the reflectance by optical depth, all orders.

# %%
depths = np.geomspace(0.01, 100.0, 25 if FAST else 50)


def reflectance(depth, albedo):
    slab = {"optical_depth": depth, "single_scattering_albedo": albedo, "phase": saturn}
    return af.solve_slab(**slab, solar_zenith_angle=np.radians(60.0), plan=PLAN).reflectance


slope = jax.jit(jax.vmap(jax.value_and_grad(reflectance), (0, None)))
figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
for albedo in (0.3, 0.9, 1.0):
    value, by_depth = slope(depths, albedo)
    axes[0].plot(depths, value, label=f"albedo {albedo:g}")
    axes[1].plot(depths, np.asarray(by_depth) * depths)
axes[0].set(xscale="log", xlabel="optical depth [-]", ylabel="reflectance [-]")
axes[1].set(xscale="log", xlabel="optical depth [-]", ylabel="slope by ln(optical depth) [-]")
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# Dark dust saturates at a depth of 2: more of it changes nothing, and brightness tells no more
# about depth. White clouds go on to brighten.
