# %% [markdown]
# # How hazy is it? Turbidity from the light of the sky
#
# Turbidity T compares air with haze to air alone: the ratio of their vertical optical depths at
# 550 nm. 2 is a very clear day, 6 a hazy one. Nobody needs to send a probe up for it: the sky's
# luminance tells. Here you make a sky whose T you know, add noise as a measurement would, and try
# to get T back in three ways.

# %%
import dataclasses
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.render.panorama import draw_dome

jax.config.update("jax_enable_x64", True)  # fits want double precision

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # one order of scattering, coarse, for the tests
ORDERS, RTOL = (1, 5e-2) if FAST else (2, 1e-2)

# %% [markdown]
# ## A sky, measured
#
# 72 directions, nine rings of eight azimuths; the sun stands 50° from the zenith. The noise of each
# direction is 1 % of its luminance, independent of its neighbours'.

# %%
turbidity, sun, noise = 3.2, np.radians(50.0), 0.01
directions = af.DirectionGrid(np.radians(np.arange(5, 86, 10)), np.radians(np.arange(0, 316, 45)))
plan = af.plan_sky(
    af.Atmosphere.from_turbidity(turbidity), quantity="luminance", orders=ORDERS, rtol=RTOL
)


def simulated(T):
    return af.simulate_luminance(af.Atmosphere.from_turbidity(T), sun, directions, plan=plan)


random = np.random.default_rng(3)
with_slope = jax.jit(lambda T: jax.jvp(simulated, (T,), (jnp.ones(()),)))
exact, slope = with_slope(jnp.asarray(turbidity, float))
exact, slope = np.asarray(exact), np.asarray(slope)  # the slope dY/dT is for later
measured = exact * (1 + noise * random.standard_normal(exact.shape))
observation = af.Observation(
    directions=directions, values=measured, solar_zenith_angle=sun, relative_noise=noise
)

fig, ax = plt.subplots(figsize=(4.6, 3.8), layout="constrained")
image = draw_dome(ax, directions, np.log10(measured), solar_zenith_angle=sun)
fig.colorbar(image, ax=ax, label="log₁₀ (Y / cd m⁻²)", shrink=0.8)
plt.show()

# %% [markdown]
# ## Three models
#
# - the **simulator**, which made this sky;
# - the **published** model of 1999, a closed formula;
# - a **regenerated** one: the same formula, its luminance fitted to our own simulations. (Its
#   colours stay those of 1999; luminance is all we use here.)

# %%
settings = af.RefitSettings(orders=ORDERS, rtol=RTOL)
if FAST:
    settings = dataclasses.replace(
        settings, turbidity=(2.0, 4.0, 6.0), solar_zenith_angle_deg=(0.0, 30.0, 60.0, 80.0)
    )
skies = af.simulate_skies(settings)
T, suns, Y = np.array(settings.turbidity), settings.solar_zenith_angle, skies.quantity("Y")
regenerated = dataclasses.replace(
    af.PREETHAM_1999,
    luminance_distribution=af.fit_distribution(skies.directions, suns, T, Y).matrix,
    zenith_luminance=af.fit_zenith_luminance(T, suns, Y[..., 0]).coefficients,
    turbidity_range=(2.0, 6.0),
)

# %%
estimates = {
    "simulator": af.estimate_turbidity(observation, af.SimulatorModel(plan=plan)),
    "published": af.estimate_turbidity(observation, "preetham"),
    "regenerated": af.estimate_turbidity(observation, regenerated),
}
print(f"true turbidity {turbidity}")
print(f"{'':<12} {'T':>6}  {'std. error':>10}  {'scaled':>7}  {'red. chi²':>9}  {'rms':>6}  steps")
for name, e in estimates.items():
    scaled = e.scaled_by_residual().standard_error
    print(f"{name:<12} {e.value:6.3f}  {e.standard_error:10.4f}  {scaled:7.4f}", end="  ")
    print(f"{e.reduced_chi_square:9.1f}  {100 * e.rms:5.1f}%  {e.steps:5d}")

# %% [markdown]
# Read the table from the right. The simulator leaves residuals of the size of the noise: its
# reduced chi-square is near 1, and its standard error means what it says. The others miss the sky
# by far more than 1 %, so their standard errors, which know of the noise only, are far too small:
# the true T lies many of them away. `scaled_by_residual` widens them by what the residuals show,
# and even that takes each direction's miss for an accident of its own, which it is not.
#
# ## The curve behind the estimate
#
# An estimate is the lowest point of a curve: chi-square, the sum of squares of
# log(model / measured) / noise, against T.

# %%
curve_T = {
    "simulator": np.sort(np.append(np.geomspace(1, 30, 12 if FAST else 40), turbidity)),
    "published": np.linspace(1.7, 10.0, 120),
    "regenerated": np.linspace(2.0, 6.0, 80),
}
predicted = {
    "simulator": np.stack([with_slope(T)[0] for T in curve_T["simulator"]]),
}
for name, model in (("published", af.PREETHAM_1999), ("regenerated", regenerated)):
    predicted[name] = np.stack([model(T, sun, directions)[..., 2] for T in curve_T[name]])
colours = {"simulator": "#1f5fa8", "published": "#c8553d", "regenerated": "#5a9367"}

fig, ax = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
for name, Y in predicted.items():
    chi_square = np.sum((np.log(np.asarray(Y) / measured) / noise) ** 2, axis=(1, 2))
    ax.loglog(curve_T[name], chi_square / 71, color=colours[name], label=name)
    e = estimates[name]
    ax.plot(e.value, e.reduced_chi_square, "o", ms=5, color=colours[name])
ax.axvline(turbidity, color="#999999", lw=0.8, ls=":", label="truth")
ax.set_xticks([1, 2, 3, 5, 10, 20, 30], [1, 2, 3, 5, 10, 20, 30])
ax.minorticks_off()
ax.set(xlabel="turbidity T [-]", ylabel="reduced chi-square [-]")
ax.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# The dots sit on the floors of the valleys. Not every curve has only one: for other suns they turn
# down again at their ends. A very hazy sky can be as dark as a clear one, and the published formula
# runs away as T approaches 1.64. A search that begins on the wrong side of such a hill ends in the
# wrong valley and says it has converged. Therefore `estimate_turbidity` looks over the whole range
# before it begins, and the start that you give makes no difference:

# %%
hazy = np.asarray(af.PREETHAM_1999(8.0, np.radians(10.0), directions)[..., 2])
hazy = af.Observation(
    directions=directions, values=hazy, solar_zenith_angle=np.radians(10.0), relative_noise=noise
)
print("A sky of the published model, T = 8, sun 10° from the zenith:")
for start in (1.7, 3.0, 12.0):
    alone = af.estimate_turbidity(hazy, start=start, scan=False)
    scanned = af.estimate_turbidity(hazy, start=start)
    print(f"  start {start:4.1f}: alone {alone.value:.3f}, with the scan {scanned.value:.3f}")

# %% [markdown]
# ## What each model says
#
# Along the sun's meridian: measured (dots), and each formula at the turbidity that it found (solid)
# and at the true one (dotted).

# %%
angle_deg = np.linspace(-85, 85, 86)
meridian = af.Directions(np.radians(np.abs(angle_deg)), np.where(angle_deg < 0, np.pi, 0.0))
fig, ax = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
for name, model in (("published", af.PREETHAM_1999), ("regenerated", regenerated)):
    for T, style in ((float(estimates[name].value), "-"), (turbidity, ":")):
        Y = model(T, sun, meridian)[..., 2]
        ax.semilogy(angle_deg, Y, style, color=colours[name], label=f"{name}, T = {T:.2f}")
rings_deg = np.degrees(directions.view_zenith_angle)
for column, sign in ((0, 1), (4, -1)):  # azimuths 0 and 180
    ax.semilogy(sign * rings_deg, measured[:, column], "o", ms=4, color=colours["simulator"])
ax.axvline(np.degrees(sun), color="#999999", lw=0.8, ls=":")
ax.set(
    xlabel="angle from the zenith, positive toward the sun [°]",
    ylabel="luminance Y [cd m⁻²]",
    xticks=range(-90, 91, 30),
)
ax.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# At the true T the published model is too bright nearly everywhere. It can only become
# darker by taking a smaller T, and so its estimate is too low. That error is in the model; no
# amount of measuring removes it.
#
# ## How good can it be?
#
# The standard error needs one derivative: how log luminance in each direction answers to T. With
# noise σ, it is σ / √(Σ (d ln Y / dT)²).

# %%
per_direction = (slope / exact).ravel()
by_hand = noise / np.sqrt((per_direction**2).sum())
print(f"by hand {by_hand:.5f}, estimate {float(estimates['simulator'].standard_error):.5f}")

repeats = 6 if FAST else 20
errors = []
for again in exact * (1 + noise * random.standard_normal((repeats, *exact.shape))):
    new = dataclasses.replace(observation, values=jnp.asarray(again))
    errors.append(float(af.estimate_turbidity(new, af.SimulatorModel(plan=plan)).value) - turbidity)
print(f"rms error of {repeats} estimates with new noise: {np.sqrt(np.mean(np.square(errors))):.5f}")

# %% [markdown]
# And with other noise, or fewer directions? Choose directions at random and sum over those:

# %%
counts = np.unique(np.geomspace(1, 72, 12).astype(int))
order = np.array([random.permutation(72) for _ in range(200)])
fig, ax = plt.subplots(figsize=(6.5, 3.8), layout="constrained")
for level, shade in ((0.003, "#9ecae1"), (0.01, "#4292c6"), (0.1, "#08306b")):
    sums = np.cumsum(per_direction[order] ** 2, axis=1)[:, counts - 1]
    low, middle, high = np.percentile(level / np.sqrt(sums), [10, 50, 90], axis=0)
    ax.loglog(counts, middle, color=shade, label=f"{100 * level:g} % noise")
    ax.fill_between(counts, low, high, color=shade, alpha=0.2, lw=0)
ax.plot(72, by_hand, "o", ms=5, color=colours["simulator"])
ax.set_xticks([1, 3, 10, 30, 72], [1, 3, 10, 30, 72])
ax.minorticks_off()
ax.set(xlabel="directions, chosen at random [-]", ylabel="standard error of T [-]")
ax.legend(frameon=False, fontsize=8)
plt.show()

# %% [markdown]
# (The band holds 80 % of the choices.) Twice the noise is twice the error; four times the
# directions halve it. A single direction can be as good as ten or as bad as none, which depends on
# where it points: `01_first_sky` has the map.
#
# All of this holds if the noise is independent. A radiometer whose calibration is off by 1 % is
# off by 1 % in every direction, and averages nothing out.
#
# ## Your turn
#
# 1. Multiply `measured` by 1.02, a calibration error. By how many standard errors does the
#    simulator's T move? Does its chi-square show it?
# 2. Give the simulator a sky of turbidity 15 and a start of 2. Where are the valleys now?
# 3. Leave out all directions within 30° of the sun. How much does the standard error grow?
# 4. Estimate with `orders=1` a sky that was simulated with `orders=2`. Which way does T go, and
#    why?
