# %% [markdown]
# # How exact, how fast, how many orders
#
# A sky is computed on a finite number of nodes, in a finite number of scattering orders. Here we
# look at what each of them costs and brings, and let a plan decide.
#
# Radiance is over solar irradiance, in 1/sr, unless said otherwise.

# %%
import os

import jax
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.render.panorama import draw_dome
from atmofit.sky.ladder import LADDER, measured

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # coarser, for the tests
FINEST = 5e-2 if FAST else 2e-3  # what the others are compared with

# %% [markdown]
# ## The ladder
#
# `rtol` picks a *rung*: node counts that were measured against a slow oracle which shares no code
# with the simulator. The measurement is stored in the package: 60 skies (12 suns, 5 turbidities),
# 343 directions, 41 wavelengths, two orders, on two cores.

# %%
fig, ax = plt.subplots(figsize=(5.6, 4), layout="constrained")
for dtype, colour in (("float32", "#1f5fa8"), ("float64", "#c05020")):
    rows = [measured(rung, dtype) for rung in LADDER]
    seconds, error = [row.hot_seconds for row in rows], [100 * row.largest for row in rows]
    ax.loglog(seconds, error, "o-", color=colour, label=dtype)
for rung, second, percent in zip(LADDER, seconds, error, strict=True):
    ax.annotate(f"rtol {rung:g}", (second, percent), xytext=(7, 3), textcoords="offset points")
ax.set(xlabel="time for 60 skies [s]", ylabel="largest error of luminance [%]")
ax.set_xlim(right=4 * max(seconds))
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# The largest error stays below what the rung promises; most directions are far better. Single
# precision saves time on every rung and loses nothing that can be seen here.
#
# ## Where the error sits
#
# The same hazy evening with all orders on three rungs. A rung is compiled once; after that any sun
# and any turbidity are fast.

# %%
sun, turbidity = np.radians(75.0), 4.0
wavelength_nm = np.array([450.0, 550.0, 650.0])
grid = af.DirectionGrid(np.radians(np.arange(0, 90, 3.0)), np.radians(np.arange(0, 181, 10.0)))
air = af.Atmosphere.from_turbidity(turbidity)
rungs = [rung for rung in LADDER if rung > FINEST]
skies = {
    rung: np.asarray(
        af.simulate_sky(air, sun, grid, wavelength_nm, "all", rung, solar_irradiance=1.0)
    )
    for rung in [*rungs, FINEST]
}

# %%
shown = rungs[:3]
fig, axes = plt.subplots(
    1, len(shown), figsize=(4.4 * len(shown), 4), layout="constrained", squeeze=False
)
for ax, rung in zip(axes[0], shown, strict=True):
    error = 100 * np.abs(skies[rung][..., 1] / skies[FINEST][..., 1] - 1)
    image = draw_dome(ax, grid, np.log10(error + 1e-3), solar_zenith_angle=sun)
    fig.colorbar(image, ax=ax, label="log₁₀ (difference at 550 nm / %)", shrink=0.8)
    ax.set_title(f"rtol {rung:g}: {error.max():.2g} % at most", fontsize=10)
plt.show()

# %% [markdown]
# Errors gather at the horizon, where a ray meets the most air; on the dark rings they change sign.
#
# ## Order by order
#
# `by_order=True` keeps the scattering orders apart. How much does each add, in clean and in hazy
# air?

# %%
ORDERS = 8
plan = af.plan_sky(air, orders=ORDERS, rtol=5e-2, by_order=True)
views = af.Directions(np.radians([0.0, 85.0]), np.radians([0.0, 90.0]))


@jax.jit
def by_order(T):
    field = af.solve_sky(af.Atmosphere.from_turbidity(T), wavelength_nm, plan=plan)
    return field.radiance_by_order(sun, views, 1.0)


fig, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharey=True)
for ax, i, name in ((axes[0], 0, "zenith"), (axes[1], 1, "5° above the horizon, to the side")):
    for T, colour in ((1.5, "#1f5fa8"), (4.0, "#c05020")):
        parts = np.asarray(by_order(T))[:, i, 0]
        share = 100 * parts / parts.sum()
        ax.semilogy(range(1, ORDERS + 1), share, "o-", color=colour, label=f"turbidity {T:g}")
    ax.set(xlabel="scattering order", title=name, xticks=range(1, ORDERS + 1))
axes[0].set_ylabel("share of radiance at 450 nm [%]")
axes[0].legend(frameon=False)
plt.show()

# %% [markdown]
# Orders fall like a geometric series, the more slowly the more air there is. Near the horizon two
# orders are not enough. `orders="all"` computes a few and adds the rest.
#
# ## Let a plan decide
#
# With `orders=None` a plan looks at the scene: it leaves out whatever is predicted to change
# luminance by less than the tolerance, and says so. Nothing is compiled yet.

# %%
real = af.Atmosphere.standard(af.Haze(0.1, 1.3), ozone_dobson=300.0)
scenes = {
    "clean air, high sun": (af.Atmosphere(af.Molecules()), 30.0, 5e-2),
    "hazy evening": (af.Atmosphere.from_turbidity(6.0), 85.0, 2e-3),
    "ozone, rough guess": (real, 50.0, 0.1),
}
plans = {
    name: af.plan_sky(scene, solar_zenith_angle=np.radians(angle), orders=None, rtol=tolerance)
    for name, (scene, angle, tolerance) in scenes.items()
}
for name, each in plans.items():
    print(name.upper(), each, sep="\n")

# %%
fig, ax = plt.subplots(figsize=(8, 3.2), layout="constrained")
parts = list(dict.fromkeys(what.split()[0] for each in plans.values() for what, _ in each.errors))
colours = dict(zip(parts, plt.cm.cividis(np.linspace(0, 0.9, len(parts))), strict=True))
for row, each in enumerate(plans.values()):
    left = 0.0
    for what, error in each.errors:
        ax.barh(row, 100 * error, left=left, color=colours[what.split()[0]], edgecolor="white")
        left += 100 * error
tolerances = [100 * tolerance for _, _, tolerance in scenes.values()]
ax.plot(tolerances, range(len(plans)), "|", ms=30, color="#c05020", label="tolerance")
for what, colour in colours.items():
    ax.barh(0, 0, color=colour, label=what)
ax.set_yticks(range(len(plans)), plans)
ax.set(xlabel="predicted error of luminance [%]")
ax.set_xscale("symlog", linthresh=0.1)
ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1, 0.5), markerscale=0.3)
plt.show()

# %% [markdown]
# ## Your turn
#
# 1. At which tolerance does the hazy evening need the sphere? At which does it go without?
# 2. Put a white ground under the clean sky (`af.Ground(0.9)`) and look at the orders again.
# 3. Ask for the zenith alone (`directions=`) or for luminance alone (`quantity="luminance"`): what
#    is left out then?
# 4. Move the sun of the second picture to 40°. Where are the errors now?
