"""Which assumptions of the 1999 paper, unstated or doubtful, bring its coefficients back?

The published luminance is the data. The prediction is the paper's work done again: skies of its
air, simulated, and the five-parameter formula fitted to all of them, linear in turbidity. What is
not stated, or may be wrong, is a factor with a logarithm of 0 as we read the paper. Slopes of the
prediction go through the simulator and through the fit (by the implicit function theorem); with
them each assumption alone, and then the pairs that promise most, are moved to where the
prediction is nearest. How luminance is weighted in the fit and which suns it sees are tried as
choices. Beside each, how far x and y of the simulated skies are from the published ones; they were
not searched for.
Writes table.md and result.json.
"""

import dataclasses
import itertools
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown, write_run
from what_moves_it_skies import ScaledPhase

import atmofit as af

ASSUMPTIONS = {
    "optical depth of air": "extinction scale; refractive index, n - 1 by the root of the factor",
    "scale height of air": "density profile of air",
    "optical depth of haze": "haze constant (printed and corrected differ), extinction scale",
    "scale height of haze": "profile of the haze",
    "exponent of haze": "Junge exponent",
    "scattered share of haze": "single-scattering albedo; at most 1",
    "phase function of haze": "its normalisation: haze scatters more or less than it takes away",
    "light of the sun": "solar scale, photometric constant",
}
NAMES = tuple(ASSUMPTIONS)
LARGEST = np.log(10.0)  # of a factor's logarithm: beyond, it is no longer the paper's air


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    turbidity: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0)
    suns_deg: tuple[float, ...] = (10.0, 25.0, 40.0, 55.0, 70.0, 80.0)
    """Solar zenith angles [degree]."""
    orders: tuple[int, ...] = (1, 2, 4)
    """Scattering orders that may have been meant; the paper says two."""
    weightings: tuple[str, ...] = ("absolute", "log")
    """Of luminance in the fit, tried instead of "relative"."""
    latest_suns_deg: tuple[float, ...] = (60.0,)
    """Suns that the fit may have ended at, tried instead of all of them."""
    rtol: float = 5e-2
    """Rung of the simulation."""
    steps: int = 5
    """Gauss-Newton steps of each search."""
    pairs: int = 6
    """Pairs that are searched, those of which the slopes promise most."""
    out: Path = Path("runs/preetham_forensics")


def main(config: Config) -> None:
    """Search, rank, print and write."""
    config.out.mkdir(parents=True, exist_ok=True)
    published = _published(config)
    found: list[dict[str, Any]] = []
    for orders in config.orders:
        problem = Problem(config, orders, published)
        start = problem.state(np.zeros(len(NAMES)))
        found.append(_row(problem, start, {}))
        if orders != 2:
            continue
        singles = [(k,) for k in range(len(NAMES))]
        for which in singles + problem.promising(start, config.pairs):
            end = problem.search(which, config.steps)
            changed = {NAMES[k]: float(np.exp(end.place[k])) for k in which}
            found.append(_row(problem, end, changed))
        choices: list[dict[str, Any]] = [{"weighting": name} for name in config.weightings]
        choices += [{"latest_sun_deg": sun} for sun in config.latest_suns_deg]
        for choice in choices:
            other = Problem(config, orders, published, **choice)
            found.append(_row(other, other.state(start.place), choice))
    found.sort(key=lambda each: each["rms"])
    head = ["orders", "changed, by factor", "rms of ln luminance", "level", "rms of pattern"]
    head += ["rms of x", "rms of y"]
    rows = [
        [
            str(each["orders"]),
            _words(each["changed"]),
            f"{each['rms']:.3f}",
            f"{np.exp(each['level']):.2f}",
            f"{each['pattern']:.3f}",
            f"{each['x']:.3f}",
            f"{each['y']:.3f}",
        ]
        for each in found
    ]
    text = markdown(head, rows)
    print(text)
    write_run(config.out, config, {"found": found, "assumptions": ASSUMPTIONS}, text + "\n")


def _row(problem: "Problem", state: "State", changed: dict[str, Any]) -> dict[str, Any]:
    """What was found, printed at once."""
    row = {"orders": problem.orders, "changed": changed, **state.summary()}
    row |= problem.chromaticity(state.place)
    print(row, flush=True)
    return row


def _words(changed: dict[str, Any]) -> str:
    """What was changed, in words."""
    return (
        "; ".join(
            f"{name.replace('_', ' ')} {value:.2f}"
            if isinstance(value, float)
            else f"{name} {value}"
            for name, value in changed.items()
        )
        or "nothing"
    )


@dataclasses.dataclass(frozen=True)
class State:
    """A prediction.

    Attributes:
        place: Logarithms of the factors.
        difference: ln(predicted / published), [turbidity, sun, direction].
    """

    place: np.ndarray
    difference: np.ndarray

    def summary(self) -> dict[str, float]:
        """Rms difference; its mean; and what remains when every sky's own mean is taken out."""
        level = self.difference.mean(axis=2, keepdims=True)
        return {
            "rms": _rms(self.difference),
            "level": float(self.difference.mean()),
            "pattern": _rms(self.difference - level),
        }


class Problem:
    """Prediction less publication, and its slopes, for one number of orders and one way to fit."""

    def __init__(
        self,
        config: Config,
        orders: int,
        published: np.ndarray,
        weighting: str = "relative",
        latest_sun_deg: float = 90.0,
    ) -> None:
        """Say what is computed; it is compiled where first used.

        Args:
            config: Of the run.
            orders: Of scattering.
            published: x, y and ln Y, [turbidity, sun, direction, quantity].
            weighting: Of luminance in the fit.
            latest_sun_deg: Of the suns that the fit sees.
        """
        self.orders = orders
        dome, turbidity = af.dome_343(), jnp.asarray(config.turbidity)
        suns = jnp.radians(jnp.asarray(config.suns_deg))
        plan = af.plan_sky(
            air(jnp.asarray(3.0), jnp.zeros(len(NAMES))),
            quantity="luminance",
            solar_zenith_angle=np.radians([0.0, 80.0]),
            orders=orders,
            rtol=config.rtol,
            dtype="float64",
        )

        fitted_suns = (np.asarray(config.suns_deg) <= latest_sun_deg).astype(float)
        weight = np.broadcast_to(fitted_suns[:, None], (turbidity.size, suns.size, dome.shape[0]))

        def luminance(at: jax.Array) -> jax.Array:
            def of_air(T: jax.Array) -> jax.Array:
                field = af.solve_sky(air(T, at), None, plan=plan)
                return jax.vmap(lambda sun: field.luminance(sun, dome))(suns)

            return jnp.exp(at[NAMES.index("light of the sun")]) * jax.lax.map(of_air, turbidity)

        def predicted(at: jax.Array) -> jax.Array:
            skies = luminance(at)
            zenith = skies[:, :, 0]
            fit = af.fit_distribution(
                dome, suns, turbidity, skies, zenith_value=zenith, weighting=weighting,
                weight=weight,
            )  # fmt: skip
            view, azimuth = dome.angles()
            γ = af.scattering_angle(view[None, :], azimuth[None, :], suns[:, None])
            coefficients = fit.coefficients(turbidity)[:, None, None, :]
            shape = af.perez(coefficients, view[None, None, :], γ[None])
            overhead = af.perez(coefficients[:, :, 0], jnp.zeros((1, 1)), suns[None, :])
            return jnp.log(zenith[..., None] * shape / overhead[..., None])

        λ = jnp.arange(380.0, 781.0, 10.0)

        def chromaticities(at: jax.Array) -> jax.Array:
            def of_air(T: jax.Array) -> jax.Array:
                field = af.solve_sky(air(T, at), λ, orders=orders, rtol=config.rtol)
                skies = jax.lax.map(lambda sun: field.radiance(sun, dome), suns)
                return af.spectrum_to_xyY(skies, λ)[..., :2]

            return jax.lax.map(of_air, turbidity)

        self._published = published
        self._value = jax.jit(predicted)
        self._chromaticities = jax.jit(chromaticities)
        self._slope = jax.jit(lambda at, along: jax.jvp(predicted, (at,), (along,))[1])

    def state(self, place: np.ndarray) -> State:
        """The prediction at some factors."""
        return State(place, np.asarray(self._value(jnp.asarray(place))) - self._published[..., 2])

    def chromaticity(self, place: np.ndarray) -> dict[str, float]:
        """Rms difference of simulated and published x, and of y."""
        off = np.asarray(self._chromaticities(jnp.asarray(place))) - self._published[..., :2]
        return {"x": _rms(off[..., 0]), "y": _rms(off[..., 1])}

    def slopes(self, at: State, which: tuple[int, ...]) -> np.ndarray:
        """Of the difference by some of the factors, [number, which]."""
        unit = np.eye(len(NAMES))
        columns = [self._slope(jnp.asarray(at.place), jnp.asarray(unit[k])) for k in which]
        return np.stack([np.asarray(column).ravel() for column in columns], axis=1)

    def promising(self, at: State, count: int) -> list[tuple[int, ...]]:
        """Pairs whose slopes promise the nearest predictions."""
        slopes, difference = self.slopes(at, tuple(range(len(NAMES)))), at.difference.ravel()
        promised = {}
        for pair in itertools.combinations(range(len(NAMES)), 2):
            move, *_ = np.linalg.lstsq(slopes[:, pair], -difference)
            promised[pair] = _rms(difference + slopes[:, pair] @ np.clip(move, -LARGEST, LARGEST))
        return sorted(promised, key=promised.__getitem__)[:count]

    def search(self, which: tuple[int, ...], steps: int) -> State:
        """Gauss-Newton with halved steps, inside the factors' range."""
        begin = time.perf_counter()
        here = self.state(np.zeros(len(NAMES)))
        for _ in range(steps):
            move, *_ = np.linalg.lstsq(self.slopes(here, which), -here.difference.ravel())
            for share in (1.0, 0.5, 0.25, 0.1):
                place = here.place.copy()
                place[list(which)] += share * np.clip(move, -1.0, 1.0)
                place = np.clip(place, -LARGEST, LARGEST)
                place[NAMES.index("scattered share of haze")] = min(
                    place[NAMES.index("scattered share of haze")], 0.0
                )
                trial = self.state(place)
                if _rms(trial.difference) < _rms(here.difference):
                    break
            else:
                break
            gain = _rms(here.difference) - _rms(trial.difference)
            here = trial
            if gain < 1e-4:
                break
        print(f"  {time.perf_counter() - begin:.0f} s", flush=True)
        return here


def air(turbidity: jax.Array, at: jax.Array) -> af.Atmosphere:
    """The paper's air with some of its numbers multiplied."""
    factor = dict(zip(NAMES, jnp.exp(at), strict=True))
    λ = np.arange(380.0, 781.0, 10.0)
    haze = af.Haze.from_turbidity(turbidity)
    depth = af.Molecules().optical_depth_at(jnp.asarray(λ)) * factor["optical depth of air"]
    return af.Atmosphere(
        af.Molecules(
            af.Spectrum(λ, depth, smooth=True),
            scale_height=af.Molecules().scale_height * factor["scale height of air"],
        ),
        dataclasses.replace(
            haze,
            optical_depth=haze.optical_depth * factor["optical depth of haze"],
            phase=ScaledPhase(
                af.bullrich_phase(),
                af.Spectrum(λ, factor["phase function of haze"] * jnp.ones(λ.size), smooth=True),
            ),
            scale_height=haze.scale_height * factor["scale height of haze"],
            angstrom_exponent=haze.angstrom_exponent * factor["exponent of haze"],
            single_scattering_albedo=factor["scattered share of haze"],
        ),
    )


def _published(config: Config) -> np.ndarray:
    """Published x, y and ln Y, [turbidity, sun, direction, quantity]."""
    dome = af.dome_343()
    rows = [
        [np.asarray(af.PREETHAM_1999(T, np.radians(sun), dome)) for sun in config.suns_deg]
        for T in config.turbidity
    ]
    xyY = np.asarray(rows)
    return np.concatenate([xyY[..., :2], np.log(xyY[..., 2:])], axis=-1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main(tyro.cli(Config))
