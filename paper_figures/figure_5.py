"""Figure 5: the variable stiffness of the shaft, as sharp as the bench has it and softer."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.figure import Figure

from bayesbl.presentation.figures.style import NEUTRAL, SINGLE_COLUMN_IN, grid, look, new_figure

_SOFTER = 20.0
"""α δ of the second curve: small enough for its slope to be seen."""


def data(stored: Stored) -> xr.Dataset:
    """K_BL(Δθ, δ) for the gap in the middle of the sweep, by sharpness α."""
    stiffness = stored.bench.value("shaft_stiffness_nm_per_rad")
    gaps = stored.tree("sweep")["sweep"].to_dataset()["gap_rad"].values
    gap = float(gaps[gaps.size // 2])
    alphas = stored.bench.value("stiffness_sharpness_per_rad"), _SOFTER / gap
    twist = gap * np.linspace(-2.5, 2.5, 4001)
    curves = [variable_stiffness(twist, gap, stiffness, alpha) for alpha in alphas]
    return arrays(
        twist_rad=("twist", twist, "rad"),
        sharpness_per_rad=("sharpness", alphas, "1/rad"),
        stiffness_nm_per_rad=(("sharpness", "twist"), curves, "N m/rad"),
    ).assign_attrs(gap_rad=gap, shaft_stiffness_nm_per_rad=stiffness)


def draw(shown: xr.Dataset) -> Figure:
    """Stiffness against twist, as the bench has it and softer."""
    gap, stiffness = (shown.attrs[k] for k in ("gap_rad", "shaft_stiffness_nm_per_rad"))
    figure = new_figure(SINGLE_COLUMN_IN, 2.3)
    panel = figure.add_subplot(grid(figure, 1, 1, top=0.2)[0, 0])
    for index, told in enumerate(("bench", "softer")):
        style, curve = look(index), shown.isel(sharpness=index)
        panel.plot(
            1e3 * curve["twist_rad"], 1e-3 * curve["stiffness_nm_per_rad"],
            color=style.colour, linestyle=style.dashes,
            label=f"α = {_power(float(curve['sharpness_per_rad']))} 1/rad ({told})",
        )  # fmt: skip
    panel.axhline(1e-3 * stiffness, color=NEUTRAL, linewidth=0.5, linestyle=(0.0, (1.0, 1.5)))
    panel.set_xticks(1e3 * gap * np.array([-2, -1, 0, 1, 2]), ["−2δ", "−δ", "0", "δ", "2δ"])
    panel.set_yticks([0.0, 0.5e-3 * stiffness, 1e-3 * stiffness])
    panel.set_ylim(0.0, 1.5e-3 * stiffness)
    panel.set_xlabel(f"Twist Δθ (δ = {1e3 * gap:.2f} mrad)")
    panel.set_ylabel("Stiffness K$_{BL}$ (kN m/rad)")
    panel.text(
        2.5e3 * gap, 1.02e-3 * stiffness, f"K$_s$ = {1e-3 * stiffness:g} kN m/rad", ha="right",
        va="bottom",
    )  # fmt: skip
    panel.legend(loc="upper left", borderaxespad=0.0)
    return figure


def variable_stiffness(
    twist_rad: np.ndarray, gap_rad: float, stiffness: float, sharpness: float
) -> np.ndarray:
    """K_s/π · [π + arctan(α(Δθ − δ)) − arctan(α(Δθ + δ))] in N m/rad, same shape as Δθ."""
    above = np.arctan(sharpness * (twist_rad - gap_rad))
    below = np.arctan(sharpness * (twist_rad + gap_rad))
    return stiffness / np.pi * (np.pi + above - below)


def _power(value: float) -> str:
    """``3 × 10⁴`` as mathtext."""
    exponent = int(np.floor(np.log10(value)))
    factor = value / 10.0**exponent
    head = "" if abs(factor - 1.0) < 0.005 else f"{factor:.2g} × "
    return f"{head}10$^{{{exponent}}}$"


def caption(shown: xr.Dataset) -> str:
    """What is seen, with both sharpnesses."""
    bench, softer = shown["sharpness_per_rad"].values
    return (
        "The variable stiffness of the shaft, K_BL, against its twist Δθ for a gap δ of "
        f"{1e3 * shown.attrs['gap_rad']:.2f} mrad: nearly none inside the gap, K_s = "
        f"{1e-3 * shown.attrs['shaft_stiffness_nm_per_rad']:g} kN m/rad outside. Solid: as sharp "
        f"as the bench has it, α = {bench:.3g} 1/rad; dashed: α = {softer:.3g} 1/rad, to show the "
        "slope."
    )


FIGURE = PaperFigure("figure_5", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
