# %% [markdown]
# # Choosing and exporting a sky model
#
# An analytic sky gives the light of any direction from a few numbers. This notebook compares those
# that come with atmofit, looks at where each fails, and writes one as source code for a renderer.

# %%
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import atmofit as af
from atmofit.io import write_source

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## The sun's side of the sky
#
# Luminance along the great circle through zenith and sun. The published model of 1999 is about
# twice as bright as the simulation that it was fitted to, at low turbidity and low sun more.

# %%
elevation = np.linspace(0.5, 179.5, 180)
toward = np.where(elevation < 90, 0.0, np.pi)
circle = af.Directions(np.abs(np.radians(90 - elevation)), toward)
fig, axes = plt.subplots(1, 3, figsize=(11, 3.6), sharey=True, layout="constrained")
for axis, sun in zip(axes, (20.0, 60.0, 85.0), strict=True):
    for T, colour in ((2.0, "#0b5394"), (6.0, "#b45f06")):
        for model, style in ((af.ATMOFIT_2026, "-"), (af.PREETHAM_1999, ":")):
            luminance = np.asarray(model(T, np.radians(sun), circle))[:, 2]
            name = "ATMOFIT_2026" if style == "-" else "published 1999"
            axis.semilogy(elevation, luminance, style, color=colour, label=f"{name}, T = {T:g}")
    axis.set(title=f"sun at {sun:g}°", xlabel="elevation, from the sun's side [°]")
axes[0].set_ylabel("luminance [cd/m²]")
axes[0].legend(fontsize=7)
plt.show()

# %% [markdown]
# ## Below the horizon
#
# The sun may be below the horizon, which the published model does not know: from 89 to 92 degrees
# the zenith fades to less than a fifth.

# %%
zenith = af.Directions([0.0], [0.0])
suns = np.linspace(80.0, 92.0, 49)
Y = jax.vmap(lambda s: af.ATMOFIT_2026(2.5, s, zenith)[0, 2])(jnp.radians(suns))
fig, axis = plt.subplots(figsize=(5, 3.2), layout="constrained")
axis.semilogy(suns, Y)
axis.set(xlabel="solar zenith angle [°]", ylabel="zenith luminance [cd/m²]")
plt.show()
print(f"from 89 to 92 degrees: a factor of {float(Y[36] / Y[48]):.1f}")

# %% [markdown]
# ## How far the model may be trusted
#
# One sky of its own air, simulated with all orders by a coarse plan, beside the model.

# %%
settings = af.TrainingSettings(rtol=5e-2)
air = settings.atmosphere(jnp.asarray(3.0), jnp.asarray(0.2))
sun, dome = np.radians(70.0), af.dome_343()
wavelength_nm = np.arange(380.0, 781.0, 20.0)
field = af.solve_sky(air, wavelength_nm, plan=settings.plan())
simulated = af.spectrum_to_XYZ(field.radiance(sun, dome), wavelength_nm)[:, 1]
error = np.asarray(af.ATMOFIT_2026(3.0, sun, dome)[:, 2] / simulated - 1)
fig, axis = plt.subplots(figsize=(5, 4), subplot_kw={"projection": "polar"}, layout="constrained")
view, azimuth = dome.angles()
dots = axis.scatter(azimuth, np.degrees(view), c=100 * error, s=28, cmap="PuOr", vmin=-12, vmax=12)
axis.set(thetamin=0, thetamax=180, rlabel_position=90)
axis.set_title("model over simulation less 1 (sun at azimuth 0°, 70° from the zenith)", fontsize=9)
fig.colorbar(dots, label="error of luminance [%]", shrink=0.7)
plt.show()
print(f"rms {np.sqrt(np.mean(error**2)):.1%}, largest {np.abs(error).max():.1%}")

# %% [markdown]
# ## Parts that can be exchanged
#
# A model is a shape and three bases. The overcast sky of the CIE has a shape without any freedom
# but its level; the nine-number shape has the terms of Hosek and Wilkie.

# %%
for shape in (af.PEREZ, af.EXTENDED, af.AUREOLE):
    print(len(shape.names), "numbers:", ", ".join(shape.names))
print("overcast horizon over zenith:", af.cie_general_sky(1, np.pi / 2, 1.0, 1.0))

# %% [markdown]
# ## Into a renderer
#
# The same from the command line: `atmofit export --to glsl --out sky.glsl`.

# %%
with tempfile.TemporaryDirectory() as folder:
    path = write_source(
        af.ATMOFIT_2026.only("colours"), "glsl", Path(folder) / "sky.glsl", "atmofit_2026"
    )
    lines = path.read_text().splitlines()
print("\n".join(lines[:6]))
print("...")
print("\n".join(line for line in lines if line.startswith(("void", "float"))))

# %% [markdown]
# ## Back to the air
#
# The turbidity of a measured sky, by any of the models; here of a sky with 2 % of noise.

# %%
noise = 1 + 0.02 * np.random.default_rng(0).normal(size=simulated.shape)
seen = af.Observation(dome, simulated * noise, sun, relative_noise=0.02)
for name, model in (("ATMOFIT_2026", af.ATMOFIT_2026), ("published", "preetham")):
    estimate = af.estimate_turbidity(seen, model)
    print(f"{name}: T = {estimate.value:.2f}, rms of the logarithm {estimate.rms:.2f}")
