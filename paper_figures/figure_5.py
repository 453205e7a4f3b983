"""Figure 5: the variable stiffness of the shaft, as sharp as the bench has it and softer."""

from __future__ import annotations

import sys

import numpy as np
from common import Stored, main
from matplotlib.figure import Figure

from bayesbl.figures.layout import grid
from bayesbl.figures.style import NEUTRAL, SINGLE_COLUMN_IN, look, new_figure

_SOFTER = 20.0
"""α δ of the second curve: small enough for its slope to be seen."""


def draw(stored: Stored) -> Figure:
    """K_BL(Δθ, δ) for the gap in the middle of the sweep."""
    stiffness = stored.bench.value("shaft_stiffness_nm_per_rad")
    sharpness = stored.bench.value("stiffness_sharpness_per_rad")
    gaps = stored.sweep["sweep"].to_dataset()["gap_rad"].values
    gap = float(gaps[gaps.size // 2])
    figure = new_figure(SINGLE_COLUMN_IN, 2.3)
    panel = figure.add_subplot(grid(figure, 1, 1, top=0.2)[0, 0])
    twist = gap * np.linspace(-2.5, 2.5, 4001)
    for index, (alpha, told) in enumerate(((sharpness, "bench"), (_SOFTER / gap, "softer"))):
        style = look(index)
        panel.plot(
            1e3 * twist, 1e-3 * variable_stiffness(twist, gap, stiffness, alpha),
            color=style.colour, linestyle=style.dashes,
            label=f"α = {_power(alpha)} 1/rad ({told})",
        )  # fmt: skip
    panel.axhline(1e-3 * stiffness, color=NEUTRAL, linewidth=0.5, linestyle=(0.0, (1.0, 1.5)))
    panel.set_xticks(1e3 * gap * np.array([-2, -1, 0, 1, 2]), ["−2δ", "−δ", "0", "δ", "2δ"])
    panel.set_yticks([0.0, 0.5e-3 * stiffness, 1e-3 * stiffness])
    panel.set_ylim(0.0, 1.45e-3 * stiffness)
    panel.set_xlabel(f"Twist Δθ (δ = {1e3 * gap:.2f} mrad)")
    panel.set_ylabel("Stiffness K$_{BL}$ (kN m/rad)")
    panel.text(
        2.5e3 * gap, 1.02e-3 * stiffness, f"K$_s$ = {1e-3 * stiffness:g} kN m/rad", ha="right",
        va="bottom", fontsize=6.0,
    )  # fmt: skip
    panel.legend(loc="upper center", ncols=2)
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


if __name__ == "__main__":
    sys.exit(main([("figure_5", draw)]))
