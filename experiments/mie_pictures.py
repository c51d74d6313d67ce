"""Picture of the haze experiment."""

from pathlib import Path

import numpy as np

from atmofit.files import replace_file
from atmofit.tables import preetham1999_phase, preetham1999_spectra


def draw_tables(
    path: Path, degrees: np.ndarray, curve: np.ndarray, eta: np.ndarray, K: np.ndarray
) -> Path:
    """The paper's eta and K as marks, the theory as lines, and what lies between.

    Args:
        path: Of the picture.
        degrees: Scattering angles of the curve.
        curve: eta by theory there, [angle, wavelength].
        eta: Likewise at the printed angles.
        K: By theory at the printed wavelengths.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    table, spectra = preetham1999_phase(), preetham1999_spectra()
    angle = np.degrees(table.scattering_angle)
    # cividis is even in lightness and the same to colour-blind eyes; its last yellow is too pale.
    colours = colormaps["cividis"](np.linspace(0, 0.9, table.wavelength_nm.size))
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for k, (wavelength, colour) in enumerate(zip(table.wavelength_nm, colours, strict=True)):
        left.semilogy(degrees, curve[:, k], color=colour, lw=1.2)
        left.plot(angle, table.eta[:, k], "o", ms=4, mfc="none", color=colour)
        place = np.arange(angle.size)
        middle.plot(
            place, 100 * (eta[:, k] / table.eta[:, k] - 1), "o-", ms=4, lw=0.8, color=colour,
            label=f"{wavelength:.0f} nm",
        )  # fmt: skip
    left.plot([], [], color="#555555", label="Mie theory")
    left.plot([], [], "o", ms=4, mfc="none", color="#555555", label="paper, Table 1")
    left.legend(frameon=False)
    left.set(
        xlabel="scattering angle [°]",
        ylabel="angular scattering term η [-]",
        title="spheres of index 1.50, 0.04 to 10 µm, v = 4",
        xticks=np.arange(0, 181, 30),
    )
    middle.axhline(0, color="#999999", lw=0.8)
    middle.annotate(
        "printed 0.1566,\n0.1546 would fit",
        (angle.size - 1, 100 * (eta[-1, -1] / table.eta[-1, -1] - 1)),
        (-12, 4),
        textcoords="offset points",
        ha="right",
        fontsize=9,
    )
    middle.set(
        xlabel="scattering angle [°]",
        ylabel="η: theory / paper − 1 [%]",
        title="the 65 cells of Table 1",
    )
    middle.set_xticks(np.arange(angle.size), [f"{one:.0f}" for one in angle], fontsize=8)
    middle.legend(frameon=False, loc="lower left")
    right.errorbar(
        spectra.wavelength_nm, spectra.K, 5e-4, fmt=".", ms=4, color=colours[1],
        elinewidth=1, label="paper, Table 2, ± half a digit",
    )  # fmt: skip
    right.plot(spectra.wavelength_nm, K, color="#c8553d", lw=1.2, label="Mie theory")
    right.set(xlabel="wavelength [nm]", ylabel="total scattering term K [-]", title="Table 2")
    right.legend(frameon=False)
    return replace_file(path, lambda name: figure.savefig(name, dpi=130))
