"""The path tracer against another program's pictures, closed forms and the balance of energy."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from measured_data import data_folder
from reference.data import needs
from scipy.integrate import quad

import atmofit as af
from atmofit.clouds.path_trace import path_trace
from atmofit.clouds.volume import (
    UniformCloud,
    homogeneous_cube,
    homogeneous_sphere,
    voxel_cloud,
)

NPZ = "cloud_sphere_pathtraced.npz"
F32 = np.float32  # the pictures of the tests need no more, and take half the time
POLAR, AZIMUTHS, SLAB_SAMPLES = 8, 6, 500
SIGMAS = 4.0  # of a normal error: 1 comparison in 16,000 fails by chance


def blocks(picture):
    """Averages over 8x8 pixels."""
    return np.asarray(picture, float).reshape(6, 8, 6, 8).mean((1, 3))


def sphere(extinction, radius=1.0):
    return homogeneous_sphere(radius=F32(radius), extinction_coefficient=F32(extinction))


@pytest.mark.reference
@pytest.mark.slow
@needs(NPZ)
@pytest.mark.parametrize("degrees", [0, 30, 60, 90, 120, 150, 180])
def test_sphere_agrees_with_another_path_tracer(degrees):
    with np.load(data_folder() / "reference" / NPZ) as file:
        radiance, error, mean_error = (
            np.asarray(file[f"sun_angle_{degrees}{what}"], float)
            for what in ("", "_stderr", "_mean_stderr")
        )
    traced = path_trace(
        sphere(5.0),
        phase=af.HenyeyGreenstein(0.85),
        sun_angle=np.radians(float(degrees)),
        samples=400,
        seed=1,
    )
    both = np.hypot(mean_error, float(traced.mean_standard_error))
    assert abs(float(traced.mean) - radiance.mean()) < 3 * both + 3e-3 * radiance.mean()
    # A block at the rim sees the cloud with half a pixel: its own few paths tell too little of
    # the rare bright ones, the other picture's many more tell how far its error must be stretched.
    stretch = max(1.0, float(traced.mean_standard_error) / mean_error)
    theirs, own = np.sqrt(blocks(error**2)), np.sqrt(blocks(traced.standard_error**2))
    both = np.hypot(theirs, np.maximum(own, stretch * theirs)) / 8
    wrong = np.abs(blocks(traced.radiance) - blocks(radiance))
    assert np.all(wrong <= 3 * both + 1e-2 * blocks(radiance))
    assert float(traced.given_up) == 0.0


def test_a_thin_sphere_shows_its_chords():
    """Single scattering: p tau times the mean over the pixel of the chord, volume / area."""
    extinction, angle = 1e-6, 1.0
    traced = path_trace(
        sphere(extinction),
        phase=af.HenyeyGreenstein(0.3),
        single_scattering_albedo=0.7,
        sun_angle=angle,
        width=16,
        extent=2.0,
        samples=1000,
    )
    expected = 0.7 * af.HenyeyGreenstein(0.3)(np.pi - angle) * extinction * (4 / 3 * np.pi) / 4
    # The chord itself is the only thing drawn: the noise is that of where the path starts.
    assert float(traced.mean_standard_error) < 2e-3 * float(expected)
    np.testing.assert_allclose(
        traced.mean, expected, atol=SIGMAS * float(traced.mean_standard_error)
    )


@pytest.mark.parametrize("phase", [af.HenyeyGreenstein(0.5), af.Rayleigh()])
def test_a_white_sphere_loses_no_light(phase):
    """What comes out in all directions is what would not go straight through."""
    depth = 2.0
    nodes, weights = np.polynomial.legendre.leggauss(12)
    pictures = [
        path_trace(
            sphere(depth), phase=phase, sun_angle=a, width=8, extent=2.0, samples=300, seed=i
        )
        for i, a in enumerate(np.arccos(nodes))
    ]
    area = 2.0**2
    flux = 2 * np.pi * area * sum(weights * [float(p.mean) for p in pictures])
    error = (
        2
        * np.pi
        * area
        * np.hypot.reduce(weights * [float(p.mean_standard_error) for p in pictures])
    )
    direct, _ = quad(lambda b: 2 * b * np.exp(-2 * depth * np.sqrt(1 - b**2)), 0, 1)
    assert error < 1e-2 * flux
    np.testing.assert_allclose(flux, np.pi * (1 - direct), atol=SIGMAS * error)


class TiltedSlab(UniformCloud):
    """Endless, of unit thickness about the origin."""

    extinction_coefficient: Float[Array, ""]
    normal: Float[Array, "3"]

    def crossing(self, origin, direction):
        height, rise = jnp.sum(origin * self.normal), jnp.sum(direction * self.normal)
        ends = (-0.5 - height) / rise, (0.5 - height) / rise
        return jnp.minimum(*ends), jnp.maximum(*ends)

    def inside(self, position):
        return jnp.abs(jnp.sum(position * self.normal)) < 0.5

    def checked(self):
        return self


def slab_flux(depth, albedo, sun, upward):
    """Flux out of one side over the incoming flux, by quadrature; and its standard error."""
    nodes, weights = np.polynomial.legendre.leggauss(POLAR)
    cosines, turns = (nodes + 1) / 2, np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    flux, variance = 0.0, 0.0
    for cosine, weight in zip(cosines, weights / 2, strict=True):
        for turn in turns:
            height = cosine if upward else -cosine
            to_sun = height * np.cos(sun) + np.sqrt(1 - height**2) * np.sin(sun) * np.cos(turn)
            angle = np.arccos(to_sun)
            # Where the slab's normal is, seen from the sun, beside the sensor.
            beside = (height - to_sun * np.cos(sun)) / (np.sin(angle) * np.sin(sun))
            across = np.sqrt(np.maximum(1 - beside**2, 0.0))
            normal = np.array([np.sin(sun) * beside, np.sin(sun) * across, np.cos(sun)])
            traced = path_trace(
                TiltedSlab(jnp.asarray(F32(depth)), jnp.asarray(normal.astype(F32))),
                phase=af.HenyeyGreenstein(0.85),
                single_scattering_albedo=albedo,
                sun_angle=angle,
                width=1,
                extent=1.0,
                samples=SLAB_SAMPLES,
                seed=int(1e6 * cosine) + int(100 * turn),
            )
            share = weight * cosine * 2 * np.pi / turns.size / np.cos(sun)
            flux += share * float(traced.mean)
            variance += (share * float(traced.mean_standard_error)) ** 2
    return flux, np.sqrt(variance)


@pytest.mark.reference
@pytest.mark.slow
@needs("slab_fluxes.csv")
@pytest.mark.parametrize(("depth", "albedo"), [(1.0, 1.0)])
def test_fluxes_of_a_slab_agree_with_another_code(depth, albedo):
    path = data_folder() / "reference" / "slab_fluxes.csv"
    table = np.genfromtxt(path, delimiter=",", names=True, usecols=range(1, 8))
    [row] = table[(table["tau"] == depth) & (table["ssa"] == albedo) & (table["sun_zenith"] == 30)]
    for name, upward in (("reflectance", True), ("diffuse_transmittance", False)):
        flux, error = slab_flux(depth, albedo, np.radians(30.0), upward)
        np.testing.assert_allclose(flux, row[name], rtol=5e-3, atol=3 * error)


@pytest.mark.slow
def test_voxels_agree_with_a_cube_and_with_each_other():
    """Delta and ratio tracking through voxels against the closed forms of the cube they fill."""
    edge, extinction = 1.5, 4.0
    half = F32(edge / 2)
    low, high = np.full(3, -half), np.full(3, half)
    keywords = {"phase": af.HenyeyGreenstein(0.5), "single_scattering_albedo": 0.9}
    view = {"sun_angle": 2.0, "width": 4, "extent": 2.5, "samples": 2000}
    cube = homogeneous_cube(edge=F32(edge), extinction_coefficient=F32(extinction))
    exact = path_trace(cube, **keywords, **view)
    grid = np.full((3, 3, 5), extinction, F32)
    same = path_trace(voxel_cloud(grid, low, high), **keywords, **view, seed=1)
    layered = np.zeros((1, 1, 4), F32)
    layered[..., 1:3] = [2 * extinction, 0.5 * extinction]
    thick = (low * np.asarray([1, 1, 2], F32), high * np.asarray([1, 1, 2], F32))
    coarse = path_trace(voxel_cloud(layered, *thick), **keywords, **view, seed=2)
    fine = np.repeat(np.repeat(layered, 6, axis=0), 2, axis=2)
    finer = path_trace(voxel_cloud(fine, *thick), **keywords, **view, seed=3)
    for one, other in ((exact, same), (coarse, finer)):
        error = np.hypot(one.standard_error, other.standard_error)
        assert np.all(np.abs(one.radiance - other.radiance) <= SIGMAS * error + 1e-12)
        assert float(one.mean) > 5 * float(np.max(error))


def test_light_through_voxels_is_let_by_as_it_should():
    """Single scattering at albedo near 0, through two layers: a closed form for ratio tracking."""
    thin, dense = 1.0, 3.0
    grid = np.array([thin, dense], F32).reshape(1, 1, 2)
    wide = F32(1e3)
    cloud = voxel_cloud(grid, np.asarray([-wide, -wide, -1], F32), np.asarray([wide, wide, 1], F32))
    angle, albedo = 0.5, 1e-6
    traced = path_trace(
        cloud,
        phase=af.HenyeyGreenstein(0.0),
        single_scattering_albedo=albedo,
        sun_angle=angle,
        width=1,
        extent=1.0,
        samples=200_000,
    )
    slant = 1 + 1 / np.cos(angle)
    # Sun and sensor above: the dense layer first, then the thin one behind it.
    lit = (
        1 - np.exp(-dense * slant) + np.exp(-dense * slant) * (1 - np.exp(-thin * slant))
    ) / slant
    expected = albedo / (4 * np.pi) * lit / np.cos(angle)
    error = float(traced.mean_standard_error)
    assert error < 5e-3 * expected
    np.testing.assert_allclose(traced.mean, expected, atol=SIGMAS * error)


def test_a_table_stands_for_the_closed_form():
    """The same phase function drawn from a table."""

    class Mixed(af.PhaseFunction):
        inner: af.HenyeyGreenstein

        def at_wavelengths(self, angle, wavelength_nm):
            return self.inner.at_wavelengths(angle, wavelength_nm)

        def moments(self, count, wavelength_nm):
            return self.inner.moments(count, wavelength_nm)

    view = {"sun_angle": 2.5, "width": 4, "extent": 2.0, "samples": 2000}
    closed = path_trace(sphere(5.0), phase=af.HenyeyGreenstein(0.85), **view)
    table = path_trace(sphere(5.0), phase=Mixed(af.HenyeyGreenstein(0.85)), **view, seed=1)
    error = np.hypot(closed.standard_error, table.standard_error)
    assert np.all(np.abs(closed.radiance - table.radiance) <= SIGMAS * error)


def test_seeds_reproduce():
    view = {"phase": af.HenyeyGreenstein(0.5), "sun_angle": 1.0, "width": 8, "samples": 10}
    first, again, other = (path_trace(sphere(5.0), **view, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.radiance, again.radiance)
    assert not np.array_equal(first.radiance, other.radiance)


@pytest.mark.parametrize(
    ("extinction", "asymmetry", "albedo"),
    [(1e-6, 0.99, 1.0), (1e4, 0.85, 1.0), (1e4, 0.99, 0.5), (5.0, 0.99, 1.0), (5.0, -0.99, 1.0)],
)
def test_extremes_are_finite_and_bright(extinction, asymmetry, albedo):
    traced = path_trace(
        sphere(extinction / 2),
        phase=af.HenyeyGreenstein(asymmetry),
        single_scattering_albedo=albedo,
        sun_angle=1.0,
        width=8,
        samples=20,
    )
    assert np.all(np.isfinite(traced.radiance))
    assert np.all(np.isfinite(traced.standard_error))
    assert float(traced.mean) > 0
    assert float(traced.given_up) < 0.05


@pytest.mark.parametrize(("extinction", "albedo", "radius"), [(0, 1, 1), (5, 0, 1), (5, 1, 1e-6)])
def test_nothing_to_see_is_black(extinction, albedo, radius):
    """No droplets, black droplets, and a cloud between the rays."""
    traced = path_trace(
        sphere(extinction, radius),
        phase=af.HenyeyGreenstein(0.85),
        single_scattering_albedo=albedo,
        sun_angle=1.0,
        width=4,
        samples=10,
    )
    np.testing.assert_array_equal(traced.radiance, 0.0)
    np.testing.assert_array_equal(traced.standard_error, 0.0)


def test_bad_input_is_refused():
    good = {"phase": af.HenyeyGreenstein(0.5), "sun_angle": 1.0}
    with pytest.raises(ValueError, match="sun_angle"):
        path_trace(sphere(1.0), **{**good, "sun_angle": 4.0})
    with pytest.raises(ValueError, match="samples"):
        path_trace(sphere(1.0), **good, samples=1)
    with pytest.raises(ValueError, match="asymmetry"):
        path_trace(sphere(1.0), **{**good, "phase": af.HenyeyGreenstein(1.5)})
    with pytest.raises(ValueError, match="low must lie below high"):
        voxel_cloud(np.ones((1, 1, 1)), [0.0, 0.0, 1.0], [1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match=r"\[x, y, z\]"):
        voxel_cloud(np.ones((1, 1)), [0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
