# %% [markdown]
# # Gradients and information
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
from atmofit.render.panorama import draw_dome

jax.config.update("jax_enable_x64", True)

FAST = os.environ.get("ATMOFIT_FAST") == "1"  # two orders, coarse, for the tests
ORDERS, RTOL, STARTS = (2, 1e-1, 8) if FAST else ("all", 1e-2, 64)

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
# `jacfwd` pushes one unknown at a time through everything and finds all that it changes: right for
# few unknowns and many values. `grad` goes backward from a single value to all unknowns at once.
# Both, beside a small step there and back, for the mean of the logarithm over a sky of the
# analytic model.


# %%
def mean_log(u):
    sky = af.ATMOFIT_2026(u[0], u[2], directions, albedo=u[1])
    return jnp.log(sky[..., 2]).mean()


here, h = jnp.array([3.0, 0.2, sun]), 1e-4
by_step = jax.jit(lambda e: (mean_log(here + h * e) - mean_log(here - h * e)) / (2 * h))
there = [by_step(one) for one in np.eye(3)]
ways = {"jacfwd": jax.jacfwd(mean_log)(here), "grad": jax.grad(mean_log)(here), "difference": there}
print("slope by   turbidity     albedo        sun")
for way, found in ways.items():
    print(f"{way:<10}", *(f"{float(one):10.6f}" for one in found))

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
# ## Which directions and colours to choose
#
# Suppose only a few can be afforded. Take them one by one, each time the one that leaves the
# smallest error of turbidity with all seven unknown. What is known beforehand enters as a prior:
# ten steps of each.

# %%
prior = np.eye(7) / 10.0**2
pixels = slopes.reshape(-1, λ.size, 7)  # [direction, wavelength, unknown]
by_direction = np.einsum("dwi,dwj->dij", pixels, pixels) / 0.01**2
by_colour = np.einsum("dwi,dwj->wij", pixels, pixels) / 0.01**2


def left_over(information):
    return np.sqrt(np.linalg.inv(information)[..., 0, 0])


chosen = {"directions": [], "wavelengths": []}
course = {"directions": [10.0], "wavelengths": [10.0]}  # errors of turbidity [steps]
for what, parts in (("directions", by_direction), ("wavelengths", by_colour)):
    known = prior
    for _ in range(8):
        tried = left_over(known + parts)
        chosen[what].append(int(tried.argmin()))
        course[what].append(float(tried.min()))
        known = known + parts[tried.argmin()]

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
alone = left_over(prior + by_direction).reshape(directions.shape)
image = draw_dome(left, directions, step[0] * alone, colour_map="cividis_r", solar_zenith_angle=sun)
fig.colorbar(image, ax=left, label="error of turbidity from one direction [-]", shrink=0.8)
dot = {"boxstyle": "circle,pad=0.2", "facecolor": "white", "edgecolor": "#c05020"}
for number, place in enumerate(chosen["directions"][:4], 1):
    ring, turn = np.unravel_index(place, directions.shape)
    θ, φ = rings[ring], np.radians(azimuths[turn])
    left.text(θ * np.sin(φ), θ * np.cos(φ), number, ha="center", va="center", bbox=dot, fontsize=8)
for what, colour in (("directions", "#1f5fa8"), ("wavelengths", "#c05020")):
    right.semilogy(range(9), step[0] * np.array(course[what]), "o-", color=colour, label=what)
right.set(xlabel="chosen [-]", ylabel="error of turbidity, all seven unknown [-]")
right.legend(frameon=False)
plt.show()
print("wavelengths in order:", *(f"{λ[k]:.0f} nm" for k in chosen["wavelengths"][:4]))

# %% [markdown]
# (Circled: the first four directions, each with all wavelengths. A wavelength comes with all
# directions.) The second choice is not next to the first: it is taken for what the first left
# open. After a handful the rest only averages noise, as the square root of their number; even the
# same one may be taken twice.
#
# ## When the parabola is not enough
#
# Fisher's information takes the misfit for a parabola. With much noise and few directions it is
# not: the profile holds turbidity at each value, with all else at its best. Twelve luminances of
# the sun's half of the sky with 20 % of noise, ground and turbidity unknown; the analytic
# `ATMOFIT_2026` makes this quick.

# %%
few = af.DirectionGrid(np.radians([15.0, 40.0, 65.0]), np.radians([0.0, 30.0, 60.0, 90.0]))
truth = np.asarray(af.ATMOFIT_2026(3.0, sun, few, albedo=0.2)[..., 2])
random = np.random.default_rng(2)
fig, ax = plt.subplots(figsize=(6.6, 3.8), layout="constrained")
for noise, colour in ((0.02, "#1f5fa8"), (0.2, "#c05020")):
    values = truth * np.exp(noise * random.standard_normal(truth.shape))
    seen = af.Observation(few, values, sun, relative_noise=noise)
    problem = af.turbidity_problem(seen, af.ATMOFIT_2026, free=("turbidity", "albedo"))
    best = af.estimate_turbidity(problem)
    profile = af.profile_turbidity(problem, best, points=17)
    at = np.linspace(*best.turbidity_range, 300)
    parabola = ((at - float(best.value)) / float(best.standard_error)) ** 2
    ax.plot(profile.turbidity, profile.rise, "o-", ms=4, color=colour, label=f"{noise:.0%} noise")
    ax.plot(at, parabola, ":", color=colour)
    low, high = best.interval
    print(f"{noise:.0%} noise: T {best.value:.2f}, parabola {low:.2f} to {high:.2f},", end=" ")
    print(f"profile {profile.lower:.2f} to {profile.upper:.2f}")
ax.axhline(3.84, color="#999999", lw=0.8)
ax.set(
    xlabel="turbidity [-]", ylabel="rise of the sum of squares [-]", xlim=(1.5, 5.5), ylim=(0, 12)
)
ax.legend(frameon=False, title="dotted: parabola")
plt.show()

# %% [markdown]
# An interval ends where its curve crosses the line at 3.84. With little noise both ways agree; with
# much the profile is wider, most on the hazy side, since hazier skies differ less from each other.
#
# ## Which numbers of a formula can be told
#
# The same question put to Perez' five coefficients: by how much is the standard error of each
# inflated because the others are unknown too? For luminance, and for chromaticity x.

# %%
dome, low_sun = af.dome_343(), np.radians(75.0)
sky = af.ATMOFIT_2026(3.0, low_sun, dome, albedo=0.2)
fig, ax = plt.subplots(figsize=(6.6, 3.4), layout="constrained")
for k, (column, name, weighting) in enumerate(((2, "Y", "relative"), (0, "x", "absolute"))):
    found = af.identify_perez(dome, low_sun, sky[:, column], weighting=weighting, starts=STARTS)
    place = np.arange(5) + 0.35 * (k - 0.5)
    ax.bar(place, found.inflation[:5], 0.33, color=("#1f5fa8", "#c05020")[k], label=name)
    print(f"{name}: condition number {float(found.condition_number):.0f},", end=" ")
    mixture = zip(found.names, np.asarray(found.weakest_direction), strict=True)
    print("weakest mixture:", ", ".join(f"{share:+.2f} {name}" for name, share in mixture))
ax.set_xticks(range(5), "ABCDE")
ax.set(yscale="log", ylabel="error / with the others known [-]", ylim=(0.8, None))
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# In luminance the horizon's pair A, B is the weak one; in x it is C and D, whose exponential is
# nearly a straight line. The notebook on Perez shows where that leads.
#
# ## Your turn
#
# 1. Move the sun to 85°. Which unknowns gain, and why ozone?
# 2. Use only directions within 30° of the sun, then only those beyond 60°.
# 3. How many directions does a photometer need that sees three colours?
