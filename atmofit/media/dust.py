"""Brightness of clouds and dusty surfaces by single scattering, after Blinn (1982).

A layer of particles shows w phi(a) times how much of it is both lit and seen (`media.slab`), over a
background dimmed by its transparency. Blinn's brightness B is 4 pi times radiance over the
irradiance across the sun's rays; his phase function phi has a mean of 1 over the sphere.
"""

import math

import equinox as eqx
import jax.numpy as jnp

from atmofit.checks import angle_in_range, in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.media.slab import SMALLEST_COSINE, THICKEST, lit_and_seen
from atmofit.optics.particle_phases import phase_of_phase_angle
from atmofit.optics.phase import HenyeyGreenstein, PhaseFunction
from atmofit.typing import Reals, RealsLike

DENSEST = 0.99  # share of the volume that particles fill; hard spheres reach 0.74
_THINNEST = 1e-6  # volume fraction that sets how narrow the opposition effect may be
_AGAINST = 1e-18  # cosine of half a phase angle of pi, which rounding may make negative
_DEEP = 1e3  # slant optical depth beyond which its width is an endless slab's


@extremes(
    Case("dense", {"optical_depth": 1.0, "volume_fraction": 0.5}, limit=2.0),
    Case("thin air", {"volume_fraction": 0.0, "optical_depth": 1.0}, 1.0, {"volume_fraction": 1.0}),
    optical_depth=Domain(0.0, THICKEST),
    volume_fraction=Domain(0.0, DENSEST),
    least=0.0,
)
def dense_optical_depth(optical_depth: RealsLike, volume_fraction: RealsLike) -> Reals:
    """Optical depth of particles that cannot overlap, tau / (1 - D) [-].

    The mean way between two particles that do not overlap is (1 - D) / (n pi p^2) exactly; that
    ways are spread exponentially around it is not (`experiments/particle_shadows.py`).

    Args:
        optical_depth: n pi p^2 times the thickness [-], 0 to 1,000,000.
        volume_fraction: Share D of the volume that particles fill [-], 0 to 0.99.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Esposito (1979), Icarus 39, 69, as quoted by Blinn (1982), section 5.1.
    """
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST)
    return depth / (1 - in_range("volume_fraction", volume_fraction, 0.0, DENSEST))


@extremes(
    Case("nothing", {"expected_count": 0.0}, limit=1.0),
    Case("dense", {"expected_count": 1.0, "volume_fraction": 0.5}, limit=math.exp(-2)),
    expected_count=Domain(0.0, THICKEST),
    volume_fraction=Domain(0.0, DENSEST),
    least=0.0,
)
def empty_probability(expected_count: RealsLike, volume_fraction: RealsLike = 0.0) -> Reals:
    """Probability [-] that no particle's centre lies in a volume V, exp(-n V / (1 - D)).

    Args:
        expected_count: n V, number density times volume [-].
        volume_fraction: Share D of the space that particles fill [-]; 0 is a Poisson process.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, sections 2.4 and 5.1.
    """
    count = in_range("expected_count", expected_count, 0.0, THICKEST)
    return jnp.exp(-count / (1 - in_range("volume_fraction", volume_fraction, 0.0, DENSEST)))


@extremes(
    Case("nothing", {"optical_depth": 0.0}, limit=1.0),
    Case(
        "at its depth",
        {"optical_depth": 0.5, "view_cosine": 0.5, "forward_scattering": 0.5},
        limit=1.5 / math.e,
    ),
    Case("grazing", {"view_cosine": 1e-6, "optical_depth": 1.0}, limit=0.0),
    optical_depth=Domain(0.0, THICKEST),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    forward_scattering=Domain(0.0, 1.0),
    least=0.0,
)
def slab_transparency(
    optical_depth: RealsLike, view_cosine: RealsLike, forward_scattering: RealsLike = 0.0
) -> Reals:
    """Share of a background that shows through a slab [-], 0 to 1.

    exp(-tau / mu) passes between the particles; once scattered straight on,
    w phi(pi) (tau / mu) exp(-tau / mu) joins it.

    Args:
        optical_depth: Vertical [-], 0 to 1,000,000.
        view_cosine: Of the angle between normal and observer, 1e-6 to 1 [-].
        forward_scattering: w phi(pi), albedo times Blinn's phase function straight on [-], 0 to 1:
            with more, a slab would show more light than lies behind it. 0 leaves it out.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 2.5. As printed, the forward term lacks its
        factor (tau / mu) exp(-tau / mu) and gives light where there is no slab.
    """
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST)
    slant = depth / in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0)
    forward = in_range("forward_scattering", forward_scattering, 0.0, 1.0)
    return (1 + forward * slant) * jnp.exp(-slant)


def over_background(brightness: RealsLike, transparency: RealsLike, background: RealsLike) -> Reals:
    """A layer over what lies behind it: brightness + transparency x background.

    Args:
        brightness: Of the layer, at least 0, in any unit.
        transparency: Share of the background that shows [-], 0 to 1.
        background: In the unit of the brightness, at least 0. The three broadcast.

    Raises:
        ValueError: A known argument is out of range.
    """
    layer = in_range("brightness", brightness, 0.0, math.inf)
    through = in_range("transparency", transparency, 0.0, 1.0)
    return layer + through * in_range("background", background, 0.0, math.inf)


extremes(
    Case("clear", {"brightness": 0.0, "transparency": 1.0, "background": 3.0}, limit=3.0),
    Case("opaque", {"brightness": 2.0, "transparency": 0.0}, limit=2.0),
    call=over_background,
    brightness=Span(0.0, 1e30),
    transparency=Domain(0.0, 1.0),
    background=Span(0.0, 1e30),
    least=0.0,
)(over_background)


@extremes(
    Case("night", {"solar_cosine": -0.5}, limit=0.0),
    Case("full moon's limb", {"view_cosine": 1e-5, "solar_cosine": 1e-5}, limit=0.5),
    Case("full moon's centre", {"view_cosine": 1.0, "solar_cosine": 1.0}, limit=0.5),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    solar_cosine=Domain(-1.0, 1.0),
    least=0.0,
)
def hapke_irvine(view_cosine: RealsLike, solar_cosine: RealsLike) -> Reals:
    """How much of an infinitely deep slab is lit and seen, mu0 / (mu0 + mu) [-]; 0 at night.

    Times albedo and Blinn's phase function it is the brightness of a dusty surface. With the sun
    behind the observer it is 1/2 whatever the normal, which makes a full moon a flat disc.

    Args:
        view_cosine: Of the angle between normal and observer, 1e-6 to 1 [-].
        solar_cosine: Of the angle between normal and sun, -1 to 1 [-].

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 2.7.
    """
    seen = in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0)
    sun = jnp.maximum(in_range("solar_cosine", solar_cosine, -1.0, 1.0), 0.0)
    return sun / (sun + seen)


@extremes(
    Case(
        "Blinn's, thin",
        {"optical_depth": 0.1, "view_cosine": 0.5, "phase_angle": 0.0},
        limit=2 / (1 + math.exp(-0.2)),
    ),
    Case("deep", {"optical_depth": 1e6, "phase_angle": 0.0}, limit=2.0),
    Case("nothing", {"optical_depth": 0.0, "phase_angle": 0.0}, limit=1.0),
    Case("opposite", {"phase_angle": math.pi}, limit=1.0),
    Case("nothing, opposite", {"optical_depth": 0.0, "phase_angle": math.pi}, limit=1.0),
    optical_depth=Domain(0.0, THICKEST),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    phase_angle=Domain(0.0, math.pi),
    volume_fraction=Domain(0.0, DENSEST),
    least=0.0,
)
def opposition_factor(
    optical_depth: RealsLike,
    view_cosine: RealsLike,
    phase_angle: RealsLike,
    volume_fraction: RealsLike,
) -> Reals:
    """How much brighter a slab is because light returns by the way it came [-], 1 to 2.

    At phase angle 0 every particle that is lit is also seen, and the factor is
    2 / (1 + exp(-x)) with x = tau / mu, from Blinn's two integrals. Its decay is ours, of the
    shape he asks for: 1 / (1 + tan(a / 2) / h) of the excess remains. The ways in and out, as wide
    as a particle, part after some particles' radii, so that h grows with D, and in a thin slab,
    where ways are short: h = D (1/3 + 2 / (x (2 + x))). With sun and observer on either side of
    the normal, up to 60 degrees apart, and D up to 0.3 the factor is within 0.04 of the integral
    over two cylinders' union (a test).

    Args:
        optical_depth: Vertical [-], 0 to 1,000,000.
        view_cosine: Of the angle between normal and observer, 1e-6 to 1 [-].
        phase_angle: 0 = sun behind the observer [rad], to pi.
        volume_fraction: Share D of the volume that particles fill [-], 0 to 0.99.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 5.2, for phase angle 0.
    """
    depth = in_range("optical_depth", optical_depth, 0.0, THICKEST)
    seen = in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0)
    half = angle_in_range("phase_angle", phase_angle, 0.0, math.pi) / 2
    dense = in_range("volume_fraction", volume_fraction, 0.0, DENSEST)
    slant = depth / seen
    # All times x (2 + x) and the cosine: x may be 0 and the tangent of pi / 2 is endless.
    short = jnp.minimum(slant, _DEEP)
    bend = short * (2 + short)
    near = jnp.maximum(dense, _THINNEST) * (bend / 3 + 2) * jnp.maximum(jnp.cos(half), _AGAINST)
    excess = 2 / (1 + jnp.exp(-slant)) - 1
    return 1 + excess * near / (near + bend * jnp.sin(half))


def slab_brightness(
    optical_depth: RealsLike,
    view_cosine: RealsLike,
    solar_cosine: RealsLike,
    phase_angle: RealsLike,
    *,
    single_scattering_albedo: RealsLike,
    phase: PhaseFunction,
    wavelength_nm: RealsLike = 550.0,
) -> Reals:
    """Blinn's brightness B of a slab, lit from either side, by single scattering.

    Args:
        optical_depth: Vertical [-], 0 to 1,000,000; of a dense layer, `dense_optical_depth`.
        view_cosine: Of the angle between normal and observer, 1e-6 to 1 [-].
        solar_cosine: Of the angle between normal and sun, -1 to 1 [-]; below 0 lit from behind.
        phase_angle: Between sun and observer, 0 to pi [rad].
        single_scattering_albedo: 0 to 1 [-]. Above about 0.3 light scattered more than once,
            which is left out here, matters. These arguments broadcast.
        phase: Phase function of the particles.
        wavelength_nm: At which it is taken [nm], a number.

    Returns:
        B [-]: 4 pi times radiance over the irradiance across the sun's rays.

    Raises:
        ValueError: A known argument is out of range.

    References:
        Blinn (1982), Computer Graphics 16, 21, section 2.4.
    """
    return _slab_brightness(
        in_range("optical_depth", optical_depth, 0.0, THICKEST),
        in_range("view_cosine", view_cosine, SMALLEST_COSINE, 1.0),
        in_range("solar_cosine", solar_cosine, -1.0, 1.0),
        angle_in_range("phase_angle", phase_angle, 0.0, math.pi),
        in_range("single_scattering_albedo", single_scattering_albedo, 0.0, 1.0),
        phase.checked(),
        in_range("wavelength_nm", wavelength_nm, 0.0, math.inf, "nm"),
    )


extremes(
    Case("nothing", {"optical_depth": 0.0}, limit=0.0),
    Case(
        "full moon",
        {"optical_depth": 1e6, "view_cosine": 0.5, "solar_cosine": 0.5, "albedo": 1.0, "g": 0.0},
        limit=0.5,
    ),
    call=lambda optical_depth, view_cosine, solar_cosine, phase_angle, albedo, g: slab_brightness(
        optical_depth,
        view_cosine,
        solar_cosine,
        phase_angle,
        single_scattering_albedo=albedo,
        phase=HenyeyGreenstein(g),
    ),
    optical_depth=Domain(0.0, THICKEST),
    view_cosine=Domain(SMALLEST_COSINE, 1.0),
    solar_cosine=Domain(-1.0, 1.0),
    phase_angle=Domain(0.0, math.pi),
    albedo=Domain(0.0, 1.0),
    g=Domain(-0.999, 0.999),
    least=0.0,
)(slab_brightness)


@eqx.filter_jit
def _slab_brightness(
    depth: Reals,
    seen: Reals,
    sun: Reals,
    phase_angle: Reals,
    albedo: Reals,
    phase: PhaseFunction,
    wavelength_nm: Reals,
) -> Reals:
    shape = phase_of_phase_angle(phase, phase_angle, wavelength_nm)
    return albedo * shape * lit_and_seen(depth, seen, sun)
