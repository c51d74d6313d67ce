# %% [markdown]
# # What a sky tells about the air
#
# Before measuring one can ask what a measurement would be worth. All that is needed are slopes: how
# the logarithm of radiance in each direction and wavelength answers to each unknown of the air.
# The rest is linear algebra, the Fisher information. The slopes come from the simulator.

# %%
import os

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af

jax.config.update("jax_enable_x64", True)

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # two orders, coarse, for the tests
ORDERS, RTOL = (2, 1e-1) if FAST else ("all", 1e-2)

# %% [markdown]
# ## Seven unknowns
#
# Air over a continent: haze, ozone and a grey ground. Each unknown is counted in a step that makes
# sense for it, so that slopes can be compared.

# %%
names = ["turbidity", "exponent", "absorption", "asymmetry", "height", "ozone", "albedo"]
centre = np.array([3.0, 1.3, 0.925, 0.703, 1200.0, 300.0, 0.2])
step = np.array([0.1, 0.1, 0.01, 0.01, 120.0, 10.0, 0.05])
λ = np.array([420.0, 450.0, 480.0, 510.0, 540.0, 570.0, 600.0, 640.0, 680.0])
sun = np.radians(55.0)
rings, azimuths = np.arange(8, 87, 13), np.arange(0, 181, 30)
directions = af.DirectionGrid(np.radians(rings), np.radians(azimuths))


def air(u):
    T, exponent, share, g, height, ozone, albedo = centre + step * u
    return af.continental_air(T, albedo, ozone, exponent, share, g, height)


plan = af.plan_sky(
    air(jnp.zeros(7)), solar_zenith_angle=sun, orders=ORDERS, rtol=RTOL, dtype="float32"
)


@jax.jit
def log_radiance(u):
    return jnp.log(af.simulate_sky(air(u), sun, directions, λ, plan=plan))


slopes = np.asarray(jax.jit(jax.jacfwd(log_radiance))(jnp.zeros(7)))
print("slopes: [zenith, azimuth, wavelength, unknown] =", slopes.shape)

# %% [markdown]
# ## Where to look, and at what colour
#
# The change of radiance, in percent, for one step of each unknown, along the sun's meridian.

# %%
meridian = np.concatenate([-rings[::-1], rings])
along = np.concatenate([slopes[::-1, -1], slopes[:, 0]])
fig, axes = plt.subplots(2, 4, figsize=(11, 5), sharex=True, layout="constrained")
for k, (ax, name) in enumerate(zip(axes.flat, names, strict=False)):
    for j in (1, 4, 7):
        colour = plt.get_cmap("plasma")(0.1 + 0.1 * j)
        ax.plot(meridian, 100 * along[:, j, k], color=colour, label=f"{λ[j]:.0f} nm")
    ax.axvline(np.degrees(sun), color="#999999", lw=0.8, ls=":")
    ax.set_title(f"{name}: {centre[k]:g} + {step[k]:g}")
for ax in axes[1]:
    ax.set_xlabel("angle from zenith, to the sun [°]")
for ax in axes[:, 0]:
    ax.set_ylabel("change of radiance [%]")
axes[0, 0].legend(frameon=False)
axes[1, 3].axis("off")
plt.show()

# %% [markdown]
# Curves of the same shape are hard to tell apart: haze that absorbs less, a brighter ground and a
# higher turbidity all brighten the sky. What tells them apart is colour, and the side of the sun.
#
# ## Error bars before measuring
#
# With independent noise σ of each value the information is J'J / σ², and its inverse the
# covariance. One unknown alone, or all seven at once? With one colour (540 nm, nearly luminance),
# or with the whole spectrum?


# %%
def errors(J):
    return np.sqrt(np.diag(np.linalg.pinv(J.T @ J / 0.01**2, hermitian=True)))


one_colour, spectra = slopes[:, :, 4].reshape(-1, 7), slopes.reshape(-1, 7)
ways = {
    "540 nm, alone": [errors(column)[0] for column in one_colour.T[:, :, None]],
    "spectrum, alone": [errors(column)[0] for column in spectra.T[:, :, None]],
    "540 nm, all seven": errors(one_colour),
    "spectrum, all seven": errors(spectra),
    "spectrum, all, exposure unknown": errors(spectra - spectra.mean(axis=0)),
}
fig, ax = plt.subplots(figsize=(9, 3.8), layout="constrained")
for k, (way, found) in enumerate(ways.items()):
    colour = plt.get_cmap("viridis")(k / 5)
    ax.bar(np.arange(7) + 0.16 * (k - 2), np.array(found), 0.15, color=colour, label=way)
ax.set_yscale("log")
ax.set_xticks(range(7), [f"{name}\n(of {s:g})" for name, s in zip(names, step, strict=True)])
ax.set_ylabel("standard error [steps], 1 % noise")
ax.legend(frameon=False, fontsize=7)
plt.show()
print("standard error of turbidity:")
for way, found in ways.items():
    print(f"  {way:<32} {step[0] * found[0]:.4f}")

# %% [markdown]
# ## What this sky cannot tell
#
# The eigenvectors of the covariance with the largest errors are the mixtures of unknowns that the
# sky leaves open.

# %%
value, vector = np.linalg.eigh(spectra.T @ spectra / 0.01**2)
value = 1 / value[::-1]
vector = vector[:, ::-1]
fig, ax = plt.subplots(figsize=(8.5, 3.4), layout="constrained")
image = ax.imshow(vector.T[::-1], cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
ax.set_xticks(range(7), names)
ax.set_yticks(range(7), [f"± {e:.2g}" for e in np.sqrt(value[::-1])])
ax.set(ylabel="standard error [steps]", title="mixtures, the least certain on top")
fig.colorbar(image, ax=ax, label="share of each unknown [-]")
plt.show()

# %% [markdown]
# `estimate_turbidity(..., free=(...))` says the same of a measured sky: `covariance`, and `untold`,
# the unknowns of which it learned hardly anything beyond their range. A prior, such as ozone from a
# climatology, is given with `prior={"ozone_dobson": (320.0, 30.0)}`.
#
# ## Your turn
#
# 1. Move the sun to 85°. Which unknowns gain, and why ozone?
# 2. Use only directions within 30° of the sun, then only those beyond 60°.
# 3. How many directions does a photometer need that sees three colours?
