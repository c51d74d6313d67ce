"""What does each way to compute a sky, and each omission, cost in accuracy?

In random skies (turbidity 1 to 10, sun 0 to 92 degrees, ground albedo 0 to 1, Henyey-Greenstein
asymmetry 0 to 0.9, ozone 0 to 500 DU) every rung of the ladder is compared with a fine solution,
and every omission with the sky it is left out of. Errors are those of luminance, the largest over
all views down to 60, 75, 85 and 89 degrees. A power law of the facts that `plan_sky` knows is
fitted to each kind of error; its margin holds 97 of 100 skies. With --store the laws go to
atmofit/sky/plan_errors.json. With --verify other random skies are planned by `plan_sky` alone and
compared with fine solutions.
"""

import dataclasses
import datetime
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from run_files import markdown

import atmofit as af
from atmofit.files import replace_file
from atmofit.fit.dataset import versions
from atmofit.sky import ladder, predicted
from atmofit.sky.ladder import Nodes
from atmofit.sky.luminance import COUNTS, luminance_nodes

# Degrees enough for an asymmetry of 0.9: what is beyond the last is 0.3 % of its light.
FINE = Nodes(
    view=80,
    view_second=32,
    altitude=28,
    sun=44,
    polar=28,
    limb=12,
    azimuth=60,
    bend=5,
    path=24,
    degrees=56,
    higher_modes=20,
    higher_degrees=32,
    streams=20,
    steps=12,
    wavelength=0,
    rough=0,
)
BLOCKS_DEG = ((0.0, 55.0), (55.0, 75.0), (75.0, 92.0))  # one set of programs for the suns of each
VIEWS_DEG = (0.0, 25.0, 50.0, 60.0, 70.0, 75.0, 80.0, 85.0, 89.0)
LIMITS_DEG = (60.0, 75.0, 85.0, 89.0)
AZIMUTHS_DEG = (0.0, 3.0, 15.0, 60.0, 120.0, 180.0)
COUNT = 5  # wavelengths of luminance; the same in both skies that are compared
QUANTILE = 0.97
FLOOR = 1e-7
_PLANS_AT_ONCE = 8


@dataclasses.dataclass(frozen=True)
class Scene:
    """One random sky."""

    turbidity: float
    sun_deg: float
    albedo: float
    asymmetry: float
    ozone_dobson: float
    rtol: float

    def atmosphere(self, geometry: str = "spherical") -> af.Atmosphere:
        """Its air."""
        depth = af.Haze.from_turbidity(self.turbidity).optical_depth
        haze = af.Haze(depth, 1.3, 1.2e3, 1.0, af.HenyeyGreenstein(self.asymmetry))
        ozone, ground = af.Absorber.ozone(self.ozone_dobson), af.Ground(self.albedo)
        return af.Atmosphere(af.Molecules(), haze, (ozone,), ground, geometry)

    def facts(self, view_deg: float) -> predicted.Facts:
        """What `plan_sky` knows of it."""
        return predicted.facts(self.atmosphere(), self.sun_deg, view_deg)


@dataclasses.dataclass(frozen=True)
class Config:
    """All the run depends on; saved beside its results."""

    skies: int = 90
    """Random skies that the laws are fitted to."""
    verify: int = 0
    """Other random skies that plans are tried in, in place of fitting."""
    store: bool = False
    """Write the laws into the package."""
    fresh: bool = False
    """Compute finished skies again."""
    out: Path = Path("runs/plan_errors")


def main(config: Config) -> None:
    """Measure block by block in processes of their own; fit, print, store; or verify."""
    config.out.mkdir(parents=True, exist_ok=True)
    count, seed, task = (config.verify, 2, "verify") if config.verify else (config.skies, 1, "fit")
    rows: list[dict[str, Any]] = []
    for block, ends in enumerate(BLOCKS_DEG):
        chosen = [s for s in scenes(count, seed) if ends[0] <= s.sun_deg < ends[1]]
        # Plans differ from sky to sky, and a process can hold only so many programs.
        step = _PLANS_AT_ONCE if config.verify else len(chosen) or 1
        for first in range(0, len(chosen), step):
            file = config.out / f"{task}_{count}_{block}_{first}.json"
            if config.fresh or not file.exists():
                facts = json.dumps([dataclasses.asdict(s) for s in chosen[first : first + step]])
                command = [sys.executable, __file__, "--block", task, str(block), facts, str(file)]
                subprocess.run(command, check=True)
            rows += json.loads(file.read_text(encoding="utf-8"))
    if config.verify:
        text = verification(rows)
    else:
        laws = fit(rows)
        text = laws_table(laws)
        if config.store:
            store(laws, config)
    print(text)
    replace_file(config.out / f"{task}.md", lambda path: _write(path, text))


def scenes(count: int, seed: int) -> list[Scene]:
    """Random skies; every quantity is evenly spread."""
    rng = np.random.default_rng(seed)
    low, high = np.array([[1, 0, 0, 0, 0], [10, 92, 1, 0.9, 500]])
    values = low + (high - low) * rng.random((count, 5))
    rtols = rng.choice([5e-2, 1e-2, 2e-3], count, p=[0.25, 0.5, 0.25])
    return [Scene(*v, rtol=r) for v, r in zip(values.round(3).tolist(), rtols, strict=True)]


def directions(sun_deg: jax.Array) -> af.DirectionGrid:
    """Where errors are looked for: all over the dome, and about the sun."""
    views = jnp.append(jnp.asarray(VIEWS_DEG), jnp.minimum(sun_deg, VIEWS_DEG[-1]))
    return af.DirectionGrid(jnp.radians(views), jnp.radians(jnp.asarray(AZIMUTHS_DEG)))


def plan_of(nodes: Nodes, block: int, orders: int | str = "all", dtype: str = "float32") -> af.Plan:
    """A plan for the suns of a block at every wavelength asked for."""
    suns = np.radians(BLOCKS_DEG[block])
    plan = af.plan_sky(
        Scene(2.0, 0.0, 0.0, 0.0, 0.0, 1e-2).atmosphere(),
        solar_zenith_angle=suns,
        orders=orders,
        dtype=dtype,
        all_wavelengths=True,
    )
    sun = round(nodes.sun * plan.nodes.sun / ladder.LADDER[plan.rtol].sun)
    return dataclasses.replace(plan, nodes=dataclasses.replace(nodes, sun=sun))


class Skies:
    """Luminance of scenes by compiled programs, one for each plan, geometry and absence."""

    def __init__(self) -> None:
        """Nothing is compiled yet."""
        self._programs: dict[Any, Any] = {}

    def luminance(
        self,
        scene: Scene,
        plan: af.Plan,
        geometry: str = "spherical",
        without: str = "",
        count: int = COUNT,
    ) -> np.ndarray:
        """Luminance [view, azimuth] from few wavelengths, the same ones in every way."""
        nodes = luminance_nodes(count, "preetham1999")
        assert nodes.interpolation is not None
        radiance = self._radiance(scene, plan, nodes.wavelength_nm, geometry, without)
        radiance = np.maximum(radiance, np.finfo(float).tiny)  # single scattering may be dark
        return np.exp(np.log(radiance) @ nodes.interpolation.T) @ nodes.weight

    def whole_luminance(self, scene: Scene, plan: af.Plan, without: str = "") -> np.ndarray:
        """Luminance [view, azimuth] from the whole spectrum."""
        every = luminance_nodes(0, "preetham1999")
        radiance = self._radiance(scene, plan, every.wavelength_nm, without=without)
        return radiance @ every.weight

    def _radiance(
        self,
        scene: Scene,
        plan: af.Plan,
        wavelength_nm: np.ndarray,
        geometry: str = "spherical",
        without: str = "",
    ) -> np.ndarray:
        key = (plan, geometry, without, wavelength_nm.size)
        if key not in self._programs:

            @jax.jit
            def program(values: jax.Array) -> jax.Array:
                air = Scene(*values, rtol=0.0).atmosphere(geometry)
                if without:
                    nothing = () if without == "absorbers" else None
                    air = dataclasses.replace(air, **{without: nothing})
                sun, views = jnp.radians(values[1]), directions(values[1])
                return af.simulate_sky(
                    air, sun, views, wavelength_nm, solar_irradiance=1.0, plan=plan
                )

            self._programs[key] = program
        values = jnp.asarray(dataclasses.astuple(scene)[:5])
        return np.asarray(self._programs[key](values), float)


def measure(block: int, chosen: list[Scene]) -> list[dict[str, Any]]:
    """All kinds of errors of the scenes of a block."""
    skies, rows = Skies(), []
    fine = plan_of(FINE, block, dtype="float64")
    base = plan_of(ladder.LADDER[1e-2], block)
    two, one = (plan_of(ladder.LADDER[1e-2], block, orders) for orders in (2, 1))
    for number, scene in enumerate(chosen, 1):
        exact = skies.luminance(scene, fine)
        usual = skies.luminance(scene, base)
        found = {
            f"rung {rtol:g}": (skies.luminance(scene, plan_of(nodes, block)), exact)
            for rtol, nodes in ladder.LADDER.items()
        }
        found |= {"orders 2": (skies.luminance(scene, two), usual)}
        found |= {"orders 1": (skies.luminance(scene, one), usual)}
        for name in ("haze", "ground", "absorbers"):
            found[f"without {name}"] = (skies.luminance(scene, base, without=name), usual)
        found["pseudo-spherical"] = (skies.luminance(scene, base, "pseudo-spherical"), usual)
        if scene.sun_deg < 90:
            found["flat"] = (skies.luminance(scene, base, "flat"), usual)
        found |= wavelengths(skies, scene, block)
        rows += [
            {"scene": dataclasses.asdict(scene), "what": what, "view_deg": limit, "error": error}
            for what, (values, reference) in found.items()
            for limit, error in by_limit(values / reference - 1, scene.sun_deg).items()
        ]
        print(f"block {block}: {number}/{len(chosen)}", file=sys.stderr, flush=True)
    return rows


def wavelengths(skies: Skies, scene: Scene, block: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Luminance from each rung's few wavelengths and from every one, by the same coarse rays."""
    coarse = ladder.LADDER[1e-1]
    found = {
        f"wavelengths {rtol:g}": interpolated(skies, scene, block, nodes)
        for rtol, nodes in ladder.LADDER.items()
    }
    # Luminance from few wavelengths is for skies without gases.
    plan = plan_of(coarse, block)
    clear = skies.whole_luminance(scene, plan, without="absorbers")
    for count in sorted(set(COUNTS.values())):
        few = skies.luminance(scene, plan, without="absorbers", count=count)
        found[f"luminance {count}"] = (few, clear)
    return found


def interpolated(
    skies: Skies, scene: Scene, block: int, nodes: Nodes
) -> tuple[np.ndarray, np.ndarray]:
    """Luminance from the wavelengths of some nodes and from every one, by the same coarse rays."""
    coarse = ladder.LADDER[1e-1]
    few = dataclasses.replace(coarse, wavelength=nodes.wavelength, rough=nodes.rough)
    plan = dataclasses.replace(plan_of(few, block), all_wavelengths=False)
    every = skies.whole_luminance(scene, plan_of(coarse, block))
    return skies.whole_luminance(scene, plan), every


def by_limit(relative: np.ndarray, sun_deg: float) -> dict[float, float]:
    """The largest error among all views down to each limit."""
    views = np.append(VIEWS_DEG, min(sun_deg, VIEWS_DEG[-1]))
    return {limit: float(np.abs(relative[views <= limit]).max()) for limit in LIMITS_DEG}


def fit(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A power law for each kind of error: least squares of the logarithm, and a margin."""
    laws = {}
    for what in dict.fromkeys(row["what"] for row in rows):
        chosen = [row for row in rows if row["what"] == what]
        known = [Scene(**row["scene"]).facts(row["view_deg"]) for row in chosen]
        amounts = np.array([predicted.amount(what, each) for each in known])
        errors = np.log(np.maximum([row["error"] for row in chosen], FLOOR) / amounts)
        terms = np.stack([each.powers() for each in known])
        # A ridge, since some facts go together.
        size = terms.shape[1]
        powers = np.linalg.solve(terms.T @ terms + 1e-2 * np.eye(size), terms.T @ errors)
        rest = errors - terms @ powers
        laws[what] = {
            "powers": [float(f"{value:.4g}") for value in powers],
            "margin": float(f"{np.exp(np.quantile(rest, QUANTILE)):.4g}"),
            "scatter": float(f"{np.exp(rest.std()):.3g}"),
            "median": float(f"{np.median([row['error'] for row in chosen]):.3g}"),
            "largest": float(f"{np.max([row['error'] for row in chosen]):.3g}"),
        }
    return laws


def laws_table(laws: dict[str, Any]) -> str:
    """In Markdown."""
    head = ["what", "median error", "largest error", "scatter about the law", "margin"]
    return markdown(
        head,
        [
            [
                what,
                f"{law['median']:.2g}",
                f"{law['largest']:.2g}",
                f"{law['scatter']:.2f}",
                f"{law['margin']:.2f}",
            ]
            for what, law in laws.items()
        ],
    )


def verify(block: int, chosen: list[Scene]) -> list[dict[str, Any]]:
    """Plans by `plan_sky` from the scene and a tolerance alone, against fine solutions.

    The error is that at the wavelengths of the fine solution, plus what the interpolation between
    wavelengths adds to it.
    """
    skies, rows = Skies(), []
    fine = plan_of(FINE, block, dtype="float64")
    for number, scene in enumerate(chosen, 1):
        exact = skies.luminance(scene, fine)
        sun, air = np.radians(scene.sun_deg), scene.atmosphere()
        plan = af.plan_sky(air, solar_zenith_angle=sun, orders=None, rtol=scene.rtol)
        every = dataclasses.replace(plan, all_wavelengths=True)
        found = skies.luminance(scene, every)
        error = float(np.abs(found / exact - 1).max())
        if not plan.all_wavelengths:
            few, whole = interpolated(skies, scene, block, plan.nodes)
            error += float(np.abs(few / whole - 1).max())
        rows.append(
            {
                "scene": dataclasses.asdict(scene),
                "error": error,
                "predicted": plan.predicted_error,
                "rung": plan.rtol,
                "orders": plan.orders,
                "geometry": plan.geometry or "spherical",
                "without": plan.without,
                "every_wavelength": plan.all_wavelengths,
            }
        )
        share = error / scene.rtol
        print(f"block {block}: {number}/{len(chosen)} {share:.2f}", file=sys.stderr, flush=True)
    return rows


def verification(rows: list[dict[str, Any]]) -> str:
    """How many plans keep their promise, in Markdown."""
    kept = sum(row["error"] <= row["scene"]["rtol"] for row in rows)
    names = ("turbidity", "sun_deg", "albedo", "asymmetry", "ozone_dobson", "rtol")
    chosen = ("rung", "orders", "geometry", "without", "every_wavelength")
    body = [
        [
            *(f"{row['scene'][name]:.3g}" for name in names),
            f"{row['error']:.2g}",
            f"{row['predicted']:.2g}",
            *(str(row[name]) for name in chosen),
        ]
        for row in rows
    ]
    head = [*names, "error", "predicted", *chosen]
    return f"{kept} of {len(rows)} plans meet the tolerance.\n\n" + markdown(head, body)


def store(laws: dict[str, Any], config: Config) -> None:
    """Write the laws into the package."""
    stored = {
        "errors": "relative, of luminance, largest over views; rungs against a fine solution, "
        "omissions against the sky they are left out of",
        "skies": config.skies,
        "quantile": QUANTILE,
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "versions": versions(),
        "processors": os.cpu_count(),
        "laws": laws,
    }
    file = Path(predicted.__file__).with_name("plan_errors.json")
    replace_file(file, lambda path: _write(path, json.dumps(stored, indent=1) + "\n"))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _block(task: str, block: str, facts: str, file: str) -> None:
    chosen = [Scene(**each) for each in json.loads(facts)]
    rows = {"fit": measure, "verify": verify}[task](int(block), chosen)
    replace_file(Path(file), lambda path: _write(path, json.dumps(rows)))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    if sys.argv[1:2] == ["--block"]:
        _block(*sys.argv[2:])
    else:
        main(tyro.cli(Config))
