"""What air does to light on a straight path: extinction, and light that is scattered into it.

Radiance after a path is L0 times the transmittance plus the sum over the scatterers of a source
(the light that reaches a place, scattered toward the eye by what is there at altitude 0) times an
integral I [m] of density times transmittance. The density of every constituent falls exponentially
with altitude over a flat ground, and the light that is scattered is the same everywhere on the path
(Preetham, Shirley and Smits 1999, section 4). Four ways to the integrals, from cheap to exact:

- "constant": the density at the eye everywhere, as Hoffman and Preetham (2002), equation 19; it
  makes the transmittance approximate too;
- "horizontal": the densities fall, but not in the transmittance: equation 10 of 1999, with the
  factor H in front that it needs;
- "hermite": the transmittance of all other constituents as a cubic in the density of one: equation
  11 and appendix A.4 of 1999, with slopes by that density. Wrong beyond recognition on long paths,
  so a plan takes it only where it has been checked;
- "gauss": Gauss-Legendre quadrature in a variable that stretches the path's beginning and end.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from atmofit.checks import angle_in_range, in_range
from atmofit.extremes import Case, Domain, Span, extremes
from atmofit.media.low_air import LowAir
from atmofit.media.path_plan import DEFAULT_PLAN, SOLVERS, PathPlan
from atmofit.numerics import gauss_nodes, mean_decay
from atmofit.optics.phase import HenyeyGreenstein, Rayleigh
from atmofit.typing import Reals, RealsLike, Scalar, real_array

LONGEST, HIGHEST, LOWEST = 1e6, 1e5, -500.0  # [m]
_LARGEST_GROWTH = 60.0  # exponent that single precision holds
_SERIES_TO, _SERIES_TERMS = 2.0, 26  # of the moments, whose terms are then below 1e-16
_LEAST_RATE = 1e-9  # [1/m]


class Path(eqx.Module):
    """Straight ways from an eye. All broadcast.

    Attributes:
        distance: Length [m], 0 to 1,000,000.
        view_zenith_angle: Of the way from the eye, 0 (up) to pi (down) [rad].
        observer_altitude: Of the eye [m], -500 to 100,000; the far end is not below -500 m.
    """

    distance: Reals = eqx.field(converter=real_array)
    view_zenith_angle: Reals = eqx.field(converter=real_array)
    observer_altitude: Reals = eqx.field(converter=real_array, default=0.0)

    def checked(self) -> "Path":
        """Refuse impossible ways; traced ones get NaN for a distance."""
        distance = in_range("distance", self.distance, 0.0, LONGEST, "m")
        zenith = angle_in_range("view_zenith_angle", self.view_zenith_angle, 0.0, math.pi)
        altitude = in_range("observer_altitude", self.observer_altitude, LOWEST, HIGHEST, "m")
        dtype = jnp.result_type(distance, zenith, altitude)
        distance, zenith, altitude = (
            values.astype(dtype) for values in jnp.broadcast_arrays(distance, zenith, altitude)
        )
        end = altitude + distance * cosine(zenith)
        # A metre for the rounding of a long way down.
        end = in_range("altitude of the path's end", end, LOWEST - 1.0, math.inf, "m")
        return Path(jnp.where(jnp.isnan(end), end, distance), zenith, altitude)


def cosine(zenith_angle: Reals) -> Reals:
    """Of an angle; 0 at a right one, whose rounding the cosine itself would show."""
    return jnp.sin(math.pi / 2 - zenith_angle)


class PathTransfer(eqx.Module):
    """What a path does to light.

    Attributes:
        transmittance: Share of the light that passes [-], [path axes, wavelength].
        integrals: Of density times transmittance [m], [path axes, scatterer, wavelength].
        in_scattered: Radiance that is added [the source's unit times m], [path axes, wavelength].
    """

    transmittance: Float[Array, "*path w"]
    integrals: Float[Array, "*path scatterer w"]
    in_scattered: Float[Array, "*path w"]

    def __call__(self, radiance: RealsLike) -> Reals:
        """Radiance at the eye of something that has this radiance."""
        return jnp.asarray(radiance) * self.transmittance + self.in_scattered


def path_transfer(
    air: LowAir, path: Path, source: RealsLike, plan: PathPlan = DEFAULT_PLAN
) -> PathTransfer:
    """Extinction and in-scattering along paths.

    Args:
        air: What they go through.
        path: Where they go.
        source: Light that each scatterer sends toward the eye from a metre of path at altitude 0
            [W m^-3 sr^-1 nm^-1], [path axes, scatterer, wavelength]; see `LightAround`. 1.0 or 0.0:
            where only integrals or transmittance are wanted.
        plan: Which solver, see `plan_path`. Static.

    Returns:
        Arrays with the path's axes first. NaN where a traced path is impossible.

    Raises:
        ValueError: A known path is out of range, or the source's shape does not fit.

    References:
        Preetham, Shirley and Smits (1999), section 4; Hoffman and Preetham (2002), equation 15.
    """
    path = path.checked()
    sources = real_array(source).astype(path.distance.dtype)
    shape = (*path.distance.shape, *air.scattering.shape)
    if sources.shape not in ((), shape):
        raise ValueError(
            f"source must be a number or [path axes, scatterer, wavelength] = {shape}, got shape "
            f"{sources.shape}"
        )
    return _transfer(air, path, jnp.broadcast_to(sources, shape), plan)


@eqx.filter_jit
def _transfer(air: LowAir, path: Path, source: Reals, plan: PathPlan) -> PathTransfer:
    """The kernel, with all paths on one last axis, which vectorises best."""
    transmittance, integrals = along(air, jax.tree.map(jnp.ravel, path), plan)
    integrals = jnp.moveaxis(integrals, -1, 0).reshape(source.shape)
    return PathTransfer(
        transmittance=transmittance.T.reshape(*path.distance.shape, transmittance.shape[0]),
        integrals=integrals,
        in_scattered=jnp.sum(source * integrals, axis=-2),
    )


def along(
    air: LowAir, path: Path, plan: PathPlan
) -> tuple[Float[Array, "w path"], Float[Array, "scatterer w path"]]:
    """Transmittances and integrals of paths on one axis."""
    ray = Ray.of(air, path)
    if plan.solver == "constant":
        return _constant(ray)
    transmittance = jnp.exp(-ray.depth(ray.distance))
    if plan.solver == "horizontal":
        return transmittance, _horizontal(ray)
    if plan.solver == "hermite":
        return transmittance, _hermite(ray)
    nodes, weights = (jnp.asarray(x, ray.start.dtype) for x in gauss_nodes(plan.nodes))
    return transmittance, by_quadrature(ray, nodes, weights)


class Ray(eqx.Module):
    """Paths through an air, on the last axis; wavelengths are met in matrix products only.

    Attributes:
        extinction: At altitude 0 [1/m].
        rise: Decay times the cosine: how fast density falls along the way [1/m].
        start: Density at the eye over that at altitude 0 [-].
        distance: [m].
        scatterers: How many; they come first. Static.
    """

    extinction: Float[Array, "constituent w"]
    rise: Float[Array, "constituent path"]
    start: Float[Array, "constituent path"]
    distance: Float[Array, " path"]
    scatterers: int = eqx.field(static=True)

    @classmethod
    def of(cls, air: LowAir, path: Path) -> "Ray":
        """The ways through an air."""
        dtype = path.distance.dtype
        decay = air.decay.astype(dtype)[:, None]
        upward, altitude = cosine(path.view_zenith_angle), path.observer_altitude
        return cls(
            air.extinction.astype(dtype),
            decay * upward[None, :],
            jnp.exp(-decay * altitude[None, :]),
            path.distance,
            len(air.phases),
        )

    @property
    def fading(self) -> Float[Array, "w path"]:
        """Extinction of all constituents at the eye [1/m]."""
        return self.extinction.T @ self.start

    def column(self, x: Float[Array, " path"]) -> Float[Array, "constituent path"]:
        """Density over that at altitude 0, from the eye to a distance [m]."""
        y = self.rise * x[None, :]
        # From the denser end, where nothing overflows.
        return self.start * jnp.exp(-jnp.minimum(y, 0.0)) * (x[None, :] * mean_decay(jnp.abs(y)))

    def depth(self, x: Float[Array, " path"]) -> Float[Array, "w path"]:
        """Optical depth from the eye to a distance."""
        return self.extinction.T @ self.column(x)


def _constant(ray: Ray) -> tuple[Reals, Reals]:
    """Hoffman and Preetham's closed form: nothing thins out."""
    depth = ray.fading * ray.distance[None, :]
    integral = ray.distance[None, :] * mean_decay(depth)
    return jnp.exp(-depth), ray.start[: ray.scatterers, None, :] * integral[None]


def _horizontal(ray: Ray) -> Reals:
    """Equation 10 of 1999, with H in place of exp(-H)."""
    s, distance = ray.scatterers, ray.distance[None, None, :]
    growth = (ray.rise[:s, None, :] + ray.fading[None]) * distance
    # Steeply down the form is far from true anyway.
    decay = mean_decay(jnp.maximum(growth, -_LARGEST_GROWTH))
    return ray.start[:s, None, :] * distance * decay


def _hermite(ray: Ray) -> Reals:
    """Equation 11 and appendix A.4 of 1999.

    The integral over the density u of one scatterer from u(0) to u(s), over u(s) - u(0), is one
    over t from 0 to 1 of exp(-B t) g(t), where B is the scatterer's optical depth and g a cubic.
    The moments of exp(-B t) stay finite where the paper's integration by parts divides by zero.
    """
    column, end = ray.column(ray.distance), ray.rise * ray.distance[None, :]
    at_end = ray.start * jnp.exp(-end)
    found = []
    for i in range(ray.scatterers):
        others = ray.extinction.at[i].set(0.0).T
        last = jnp.exp(-(others @ column))
        # The scatterer's column over its density at the eye, and over that at the end.
        mean = ray.distance * mean_decay(jnp.abs(end[i]))
        over_first = mean * jnp.exp(-jnp.minimum(end[i], 0.0))
        over_last = mean * jnp.exp(jnp.clip(end[i], 0.0, _LARGEST_GROWTH))
        first_slope = -over_first[None, :] * (others @ ray.start)
        last_slope = -over_last[None, :] * last * (others @ at_end)
        # The cubic through 1 and `last` with these slopes.
        square = 3 * (last - 1) - 2 * first_slope - last_slope
        cube = 2 * (1 - last) + first_slope + last_slope
        m = _moments(ray.extinction[i][:, None] * column[i][None, :])
        sum_of_powers = m[0] + first_slope * m[1] + square * m[2] + cube * m[3]
        found.append(column[i][None, :] * sum_of_powers)
    return jnp.stack(found)


def _moments(depth: Reals) -> tuple[Reals, Reals, Reals, Reals]:
    """Integrals of t^n exp(-depth t) from 0 to 1 for n from 0 to 3, depth at least 0."""
    thin = depth < _SERIES_TO
    small, large = jnp.where(thin, depth, 0.0), jnp.where(thin, _SERIES_TO, depth)
    fading = jnp.exp(-large)
    found, thick = [mean_decay(depth)], (1 - fading) / large
    for n in (1, 2, 3):
        thick = (n * thick - fading) / large
        series = jnp.zeros_like(depth)
        for k in reversed(range(_SERIES_TERMS)):
            series = series * small + (-1) ** k / (math.factorial(k) * (n + k + 1))
        found.append(jnp.where(thin, series, thick))
    return found[0], found[1], found[2], found[3]


def by_quadrature(
    ray: Ray, nodes: Float[Array, " node"], weights: Float[Array, " node"]
) -> Float[Array, "scatterer w path"]:
    """The integrals by a rule for 0 to 1, in a variable in which both ends are stretched.

    With x0 the length over which light of the wavelength that fades most does so at the eye, and
    z0 that over which the densest constituent thins out from the far end of a way down, the nodes
    lie evenly in y = log(1 + x / x0) - log(1 - x / (s + z0)). All wavelengths share them.
    """
    s = ray.distance
    fading = jnp.max(ray.fading, axis=0) + jnp.maximum(jnp.max(ray.rise, axis=0), 0.0)
    x0 = 1 / jnp.maximum(fading, _LEAST_RATE)
    z0 = 1 / jnp.maximum(-jnp.min(ray.rise, axis=0), _LEAST_RATE)
    ratio = x0 / (s + z0)
    whole = jnp.log1p(s / x0) + jnp.log1p(s / z0)

    def add(total: Reals, at: tuple[Scalar, Scalar]) -> tuple[Reals, None]:
        node, weight = at
        growth = jnp.exp(whole * node)
        bend = 1 + ratio * growth
        x = jnp.minimum(x0 * jnp.expm1(whole * node) / bend, s)
        slope = x0 * growth * (1 + ratio) / bend**2 * weight
        density = ray.start * jnp.exp(-ray.rise * x[None, :]) * slope[None, :]
        return total + density[: ray.scatterers, None, :] * jnp.exp(-ray.depth(x))[None], None

    none = jnp.zeros((ray.scatterers, ray.extinction.shape[1], s.size), s.dtype)
    total, _ = jax.lax.scan(add, none, (nodes, weights))
    return total * whole[None, None, :]


def _of_two(
    plan: PathPlan,
    molecules: Scalar,
    haze: Scalar,
    distance: Scalar,
    view_zenith_angle: Scalar,
    observer_altitude: Scalar,
) -> tuple[Reals, Reals, Reals]:
    """Transfer through molecules and haze, for the stability table."""
    extinction = jnp.stack([molecules, haze])[:, None]
    air = LowAir(
        extinction,
        extinction,
        jnp.asarray([1 / 8e3, 1 / 1.2e3], extinction.dtype),
        (Rayleigh(), HenyeyGreenstein(0.7)),
        jnp.asarray([550.0], extinction.dtype),
    )
    path = Path(distance, view_zenith_angle, observer_altitude)
    found = path_transfer(air, path, 1.0, plan)
    return found.transmittance, found.integrals, found.in_scattered


for _plan in (*(PathPlan(solver, 0) for solver in SOLVERS[:3]), DEFAULT_PLAN):
    extremes(
        Case("no way", {"distance": 0.0}, limit=(1.0, 0.0, 0.0, 0.0)),
        Case("level", {"view_zenith_angle": math.pi / 2}),
        Case("straight down", {"view_zenith_angle": math.pi, "observer_altitude": 1e5}),
        Case("to the ground", {"view_zenith_angle": 2.0, "distance": 4e3}),
        Case("no haze", {"haze": 0.0}),
        Case("no air", {"haze": 0.0, "molecules": 0.0}),
        Case("optical depth 1000", {"haze": 0.1, "distance": 1e4}),
        Case("a centimetre", {"distance": 1e-2}),
        part=_plan.name,
        call=functools.partial(_of_two, _plan),
        molecules=Span(0.0, 1e-4),
        haze=Span(0.0, 0.1),
        distance=Span(0.0, 1e5),
        view_zenith_angle=Span(0.0, math.pi / 2),
        observer_altitude=Domain(LOWEST, HIGHEST),
        least=None if _plan.solver == "hermite" else 0.0,  # which is wrong on long paths
    )(path_transfer)
