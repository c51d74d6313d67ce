"""How fast are sky models evaluated, and how fast are five parameters fitted to skies?

Evaluation: X, Y, Z of the shipped model in single precision, over many directions of one sky, next
to the published model of 1999. Fits: `fit_perez` for a thousand skies, next to a loop over
`scipy.optimize.least_squares` with analytic Jacobians, from the best of the same candidates and
from as many of them as `fit_perez` has paths.
"""

import dataclasses
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import tyro
from run_files import markdown, write_run

import atmofit as af
from atmofit.fit import parameters

HEAD = ["what", "compile [s]", "first call [s]", "hot [s]", "per second", "peak [MB]"]


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    directions: int = 1_000_000
    """Evaluated at once."""
    skies: int = 1000
    """Fitted."""
    repeats: int = 5
    """Hot calls; the fastest is reported."""
    scipy_starts: int = 4
    """Of the slower of the two loops; as many as fit_perez has paths."""
    seed: int = 0
    """Of the skies."""
    out: Path = Path("runs/sky_model_speed")


def main(config: Config) -> None:
    """Evaluate and fit; print and write the table."""
    rows, facts = [], {}
    rng = np.random.default_rng(config.seed)
    angles = rng.uniform([0.0, -np.pi], [np.pi / 2, np.pi], (config.directions, 2))
    view, azimuth = jnp.asarray(angles.T, "float32")
    colours = af.ATMOFIT_2026.only("colours")
    for name, sky in (
        ("ATMOFIT_2026, X Y Z", lambda v, a: colours.XYZ(3.0, 1.0, af.Directions(v, a))),
        ("PREETHAM_1999, x y Y", lambda v, a: af.PREETHAM_1999(3.0, 1.0, af.Directions(v, a))),
    ):
        row, hot = _timed(sky, (view, azimuth), config.repeats)
        facts[name] = config.directions / hot
        rows.append([name, *row, f"{facts[name] / 1e6:.1f} million directions", _peak()])
    dome = af.dome_343()
    suns, skies = _skies(config.skies, rng, dome)
    begin = time.perf_counter()
    fits = af.fit_perez(dome, suns, skies)
    jax.block_until_ready(fits.coefficients)
    first, times = time.perf_counter() - begin, []
    for _ in range(2):
        begin = time.perf_counter()
        fits = af.fit_perez(dome, suns, skies)
        jax.block_until_ready(fits.coefficients)
        times.append(time.perf_counter() - begin)
    hot = min(times)
    rows.append(
        ["fit_perez", "-", f"{first:.1f}", f"{hot:.2f}", f"{config.skies / hot:.0f} fits", _peak()]
    )
    ours, words = np.asarray(fits.rms), "\n"
    facts["fits"] = config.skies / hot
    for starts in (1, config.scipy_starts):
        begin = time.perf_counter()
        best = _scipy_rms(dome, suns, skies, starts)
        loop = time.perf_counter() - begin
        name = f"loop over scipy, {starts} start{'s' * (starts > 1)}"
        facts[name] = config.skies / loop
        rows.append([name, "-", "-", f"{loop:.1f}", f"{facts[name]:.1f} fits", _peak()])
        words += (
            f"\nfit_perez: {loop / hot:.0f} times as many fits per second as the {name}, whose "
            f"mean squared residual is {np.mean(best**2) / np.mean(ours**2) - 1:+.2%} off; "
            f"fit_perez ends no higher (within 1e-4) in {np.mean(ours < best * (1 + 1e-4)):.1%}."
        )
    converged = np.mean(np.asarray(fits.converged))
    words += f"\nConverged: {converged:.1%}. {os.cpu_count()} processors."
    text = markdown(HEAD, rows) + words
    print(text)
    write_run(config.out, config, {"per second": facts}, text + "\n")


def _timed(
    function: Callable[..., Any], arguments: tuple[Any, ...], repeats: int
) -> tuple[list[str], float]:
    """Compile, first and hot seconds as texts; hot as a number."""
    begin = time.perf_counter()
    compiled = jax.jit(function).lower(*arguments).compile()
    compile_seconds = time.perf_counter() - begin
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(compiled(*arguments))
        times.append(time.perf_counter() - begin)
    first, *hot = times
    return [f"{compile_seconds:.2f}", f"{first:.3f}", f"{min(hot):.3f}"], min(hot)


def _skies(
    count: int, rng: np.random.Generator, dome: af.Directions
) -> tuple[np.ndarray, np.ndarray]:
    """Luminance of the shipped model under random air, suns and grounds."""
    low = [1.2, 0.0, 0.0]
    T, sun, albedo = jnp.asarray(rng.uniform(low, [10.0, np.pi / 2, 0.8], (count, 3)).T)

    def sky(at: tuple[jax.Array, ...]) -> jax.Array:
        return af.ATMOFIT_2026.XYZ(at[0], at[1], dome, at[2])[:, 1]

    return np.asarray(sun), np.asarray(jax.jit(lambda *at: jax.lax.map(sky, at))(T, sun, albedo))


def _scipy_rms(dome: af.Directions, suns: np.ndarray, skies: np.ndarray, count: int) -> np.ndarray:
    """Rms residuals of fits one by one, in the same free parameters plus the scale.

    From the best of the candidates; the lowest end counts.
    """
    view, azimuth = (np.asarray(x) for x in dome.angles())
    cosine = np.maximum(np.cos(view), 1e-3)
    candidates = np.asarray(parameters.candidates())
    rms = []
    for sun, values in zip(suns, skies, strict=True):
        γ = np.asarray(af.scattering_angle(view, azimuth, sun))
        unit = np.sqrt(np.mean(values**2))
        problem = _Problem(cosine, γ, np.cos(γ) ** 2, values / unit)
        starts = [np.append(c, np.log(problem.best_scale(c))) for c in candidates]
        starts.sort(key=lambda p: float(np.sum(problem.residuals(p) ** 2)))
        costs = [
            scipy.optimize.least_squares(
                problem.residuals,
                start,
                problem.jacobian,  # pyright: ignore
                method="lm",
                xtol=1e-10,
                ftol=1e-10,
            ).cost
            for start in starts[:count]
        ]
        rms.append(np.sqrt(2 * min(costs) / values.size))
    return np.asarray(rms)


@dataclasses.dataclass(frozen=True)
class _Problem:
    """One sky: relative residuals of scale x F, and their analytic Jacobian."""

    cosine: np.ndarray
    γ: np.ndarray
    square: np.ndarray
    values: np.ndarray

    def _parts(self, free: np.ndarray) -> tuple[Any, ...]:
        w, log_b, C, log_d, E = free[:5]
        with np.errstate(over="ignore"):
            B, D = -np.exp(np.clip(log_b, -30, 30)), -np.exp(np.clip(log_d, -30, 30))
            A = np.expm1(np.clip(w, -30, 30)) * np.exp(-B)
            horizon, around = np.exp(B / self.cosine), np.exp(D * self.γ)
        return A, B, C, D, E, horizon, around

    def _model(self, free: np.ndarray) -> np.ndarray:
        A, _, C, _, E, horizon, around = self._parts(free)
        A = np.clip(A, -1e9, 1e9)  # a trial far off must stay finite
        return (1 + A * horizon) * (1 + C * around + E * self.square)

    def best_scale(self, free: np.ndarray) -> float:
        ratio = self._model(free) / self.values
        return float(max(ratio.sum() / (ratio @ ratio), 1e-12))

    def residuals(self, p: np.ndarray) -> np.ndarray:
        return np.exp(np.clip(p[5], -30, 30)) * self._model(p) / self.values - 1

    def jacobian(self, p: np.ndarray) -> np.ndarray:
        A, B, C, D, E, horizon, around = self._parts(p)
        first, second = 1 + A * horizon, 1 + C * around + E * self.square
        # dA/dw = exp(w - B); dA/dln(-B) = -A B; dB/dln(-B) = B.
        by_w = np.exp(np.clip(p[0], -30, 30) - B) * horizon * second
        by_b = (A * horizon / self.cosine - A * horizon) * B * second
        by_d = first * C * around * self.γ * D
        columns = [by_w, by_b, first * around, by_d, first * self.square, first * second]
        return np.exp(np.clip(p[5], -30, 30)) * np.stack(columns, axis=1) / self.values[:, None]


def _peak() -> str:
    return f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f}"


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    sys.exit(main(tyro.cli(Config)))
