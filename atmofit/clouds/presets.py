"""Clouds to start from, in metres, with their bottoms at height 0."""

import math

import numpy as np

from atmofit.checks import choice
from atmofit.clouds.growth import grow
from atmofit.clouds.metaballs import Metaballs, metaballs

PRESETS = ("cumulus", "cumulonimbus")


def cloud_preset(name: str, *, seed: int = 0, grown: bool = True) -> Metaballs:
    """A cloud of balls: "cumulus", 2 km wide, or "cumulonimbus", 10 km tall with an anvil.

    Args:
        name: "cumulus" (96 balls) or "cumulonimbus" (340 balls).
        seed: The same seed, the same cloud.
        grown: False: only the large balls that it grows from.

    Returns:
        Balls of density 1 on a bottom at height 0 about the z axis [m].

    Raises:
        ValueError: The name is unknown.
    """
    choice("name", name, PRESETS)
    random = np.random.default_rng(seed)
    if name == "cumulus":
        start = _balls(_cumulus(random))
        return grow(start, most=96, shrink=0.68, outward=0.35, seed=seed) if grown else start
    start = _balls(_cumulonimbus(random))
    return grow(start, most=340, shrink=0.6, outward=0.35, seed=seed) if grown else start


def _balls(rows: list[tuple[float, float, float, float]]) -> Metaballs:
    """From x, y, z and radius, lifted so that no ball reaches below 0."""
    x, y, z, radius = np.asarray(rows).T
    return metaballs(np.stack([x, y, np.maximum(z, radius)], axis=-1), radius, 1.0)


def _cumulus(random: np.random.Generator) -> list[tuple[float, float, float, float]]:
    """A floor of middling balls, and heaps of larger ones on it."""
    rows = _disc(random, 9, 760.0, 0.0, 400.0, 0.7)
    for x, y, z, radius in (
        (-430.0, 40.0, 470.0, 430.0),
        (-60.0, -60.0, 640.0, 520.0),
        (380.0, 80.0, 520.0, 450.0),
        (90.0, 60.0, 900.0, 420.0),
    ):
        dx, dy = random.uniform(-70.0, 70.0, 2)
        rows.append((x + dx, y + dy, z, radius))
    return rows


def _cumulonimbus(random: np.random.Generator) -> list[tuple[float, float, float, float]]:
    """A wide floor, a tower that leans and narrows, and an anvil that reaches downwind."""
    rows = _disc(random, 14, 3200.0, 0.0, 1900.0, 0.75)
    for height in np.linspace(2000.0, 8200.0, 7):
        up = (height - 2000.0) / 6200.0
        spread, radius = 1500.0 - 700.0 * up, 1900.0 - 500.0 * up
        for turn in random.uniform(0, 2 * math.pi) + np.array([0.0, 2.1, 4.2]):
            x, y = spread * math.cos(turn), spread * math.sin(turn)
            rows.append((600.0 * up + x, y, height + random.uniform(-300.0, 300.0), radius))
    for x, y, _, radius in _disc(random, 20, 4500.0, 0.0, 1900.0, 0.8):
        rows.append((1700.0 + 1.15 * x, 0.85 * y, 9000.0 + random.uniform(-120.0, 120.0), radius))
    return rows


def _disc(
    random: np.random.Generator, count: int, extent: float, z: float, radius: float, flat: float
) -> list[tuple[float, float, float, float]]:
    """Balls evenly over a disc, as a sunflower's seeds are; `flat` as large at the rim."""
    rows = []
    for k in range(count):
        share = math.sqrt((k + 0.5) / count)
        turn = k * math.pi * (3 - math.sqrt(5)) + random.uniform(-0.2, 0.2)
        size = radius * (1 - (1 - flat) * share) * random.uniform(0.85, 1.15)
        rows.append((extent * share * math.cos(turn), extent * share * math.sin(turn), z, size))
    return rows
