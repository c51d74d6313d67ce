"""Identifiability of fits as a part of the report: a table and a picture."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from atmofit.fit.identifiability import GOOD, Identifiability
from atmofit.fit.identifiability_words import interval, weakest_direction, weakest_fit
from atmofit.fit.profile_likelihood import CHI_SQUARE
from atmofit.render import html
from atmofit.render.image import new_figure, png_bytes, style
from atmofit.render.text import condition

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEAD = (
    "fit",
    "good starts",
    "the same, straight",
    "condition",
    "weakest direction",
    "two weakest parameters, 95 % of the profile",
)
_SMALLEST_EXCESS = 1e-9  # of a loss over the best; below it a start counts as having found it


def section(
    found: Mapping[str, Identifiability], labels: Sequence[Sequence[str]] = ()
) -> list[str]:
    """HTML parts: what was asked of the fits, and the answers.

    Args:
        found: By the name of the fit, as the table shall show it. Of many fits the worst
            conditioned one is described, and shares are of all.
        labels: What the places along each axis of many fits are called, such as "T = 2" and
            "sun 8°". Empty: their numbers.
    """
    rows = [_row(name, fit, labels) for name, fit in found.items()]
    searched = [fit for fit in found.values() if not fit.linear]
    parts = [html.heading("How far the skies determine the fits")]
    if searched:
        starts = searched[0].good.shape[-1]
        parts.append(html.paragraph(
            f"Each fit was searched for from {starts} random starts. A start is good when the "
            "search from it converged to a loss within 1 % of the lowest that any search found. "
            "A search follows four paths, one straight from the start and three released from a "
            "strong prior, and keeps the lowest end; the column \"straight\" is what the first "
            "path alone reaches, and so tells how many minima a fit has."
        ))  # fmt: skip
    parts.append(html.table(_HEAD, rows, words=True))
    parts.append(html.paragraph(
        "Condition numbers are those of the Jacobian with columns of unit length, by the "
        "coefficients at the lowest and the highest turbidity for the joint fits. Intervals take "
        "residuals as independent, which they are not: they say how well these skies fix a "
        "coefficient in this formula, and are too narrow as a statement about the air."
    ))  # fmt: skip
    return parts


def _row(name: str, found: Identifiability, labels: Sequence[Sequence[str]]) -> tuple[str, ...]:
    worst = weakest_fit(found)
    many = len(worst) > 0
    conditions = np.asarray(found.condition_number)
    number = condition(float(conditions.max()))
    if many:
        number = f"{condition(float(np.median(conditions)))}, at most {number}"
    called = [labels[a][k] if labels else f"number {k + 1}" for a, k in enumerate(worst)]
    which = f"{', '.join(called)}: " if many else ""
    return (
        name,
        "linear" if found.linear else _share(found.good),
        "-" if found.linear else _share(found.straight),
        number,
        which + weakest_direction(found, worst),
        which + "; ".join(interval(found, k, worst) for k in (0, 1)),
    )


def _share(good: object) -> str:
    shares = 100 * np.asarray(good).mean(axis=-1)
    if shares.ndim == 0:
        return f"{shares:.0f} %"
    return f"{shares.mean():.1f} %, worst {shares.min():.0f} %"


def picture(found: Mapping[str, Identifiability]) -> bytes:
    """The losses of all starts and the profiles of the weakest parameters, as a PNG.

    Args:
        found: As for `section`; of many fits the worst conditioned one is shown.
    """
    with style():
        return png_bytes(draw(found))


def draw(found: Mapping[str, Identifiability]) -> "Figure":
    """The figure of `picture`: a row of losses, then two rows of profiles."""
    shown = {name: fit for name, fit in found.items() if not fit.linear}
    if not shown:
        raise ValueError(f"found must hold a fit that was searched for, got {list(found)}")
    figure = new_figure(0.6 + 2.5 * len(shown), 6.6)
    axes = figure.subplots(3, len(shown), squeeze=False, sharey="row")
    for column, (name, fit) in enumerate(shown.items()):
        worst = weakest_fit(fit)
        _draw_losses(axes[0, column], fit)
        axes[0, column].set_title(name)
        for k in (0, 1):
            _draw_profile(axes[1 + k, column], fit, worst, k)
    axes[0, 0].set_ylabel("loss / lowest loss − 1 [-]")
    for row in axes[1:, 0]:
        row.set_ylabel("rise of the loss [variances]")
    return figure


def _draw_losses(ax: "Axes", found: Identifiability) -> None:
    """Excess losses of all starts, sorted; one line for each of many fits."""
    excess = np.asarray(found.relative_loss).reshape(-1, found.good.shape[-1]) - 1
    excess = np.sort(np.maximum(np.nan_to_num(excess, nan=np.inf), _SMALLEST_EXCESS), axis=-1)
    share = 100 * (np.arange(excess.shape[1]) + 0.5) / excess.shape[1]
    one = len(excess) == 1
    for line in excess:
        ax.plot(share, line, color="#08519c", lw=1.5 if one else 0.7, alpha=1 if one else 0.5)
    ax.axhline(GOOD - 1, color="black", lw=0.8, ls=":")
    ax.set_yscale("log")
    ax.set_ylim(_SMALLEST_EXCESS / 2, 1e4)
    ax.set_xlabel("share of the starts [%]")
    ax.grid(alpha=0.25, lw=0.5)


def _draw_profile(ax: "Axes", found: Identifiability, fit: tuple[int, ...], number: int) -> None:
    """Rise of the loss against one parameter, its parabola and the threshold of 95 %."""
    k = int(np.asarray(found.profile.parameter)[fit][number])
    value = np.asarray(found.profile.value)[fit][number]
    rise = np.asarray(found.profile.rise)[fit][number]
    centre, width = (np.asarray(a)[fit][k] for a in (found.estimate, found.standard_error))
    around = np.linspace(centre - 4 * width, centre + 4 * width, 80)
    ax.plot(around, ((around - centre) / width) ** 2, "--", color="#888888", lw=1.0)
    ax.plot(value, rise, "o-", color="#08519c", ms=2.5, lw=1.2)
    ax.axhline(CHI_SQUARE, color="black", lw=0.8, ls=":")
    near = np.abs(value - centre) <= 4.5 * width
    low, high = value[near].min(), value[near].max()
    ax.set_xlim(low - 0.02 * (high - low), high + 0.02 * (high - low))
    ax.set_ylim(-0.5, 16)
    ax.locator_params(axis="x", nbins=4)
    ax.set_xlabel(f"{found.names[k]} [-]")
    ax.grid(alpha=0.25, lw=0.5)
