"""What the bench's tolerances do to the amplitude, and which parameter does it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.scales import plain_log_axis
from bayesbl.presentation.figures.snapshots import values
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray

_LEVEL = 0.9
_SHORT: Mapping[str, str] = {
    "gear_ratio": "gear ratio N",
    "motor_inertia_kg_m2": "motor inertia J$_{m}$",
    "load_inertia_kg_m2": "load inertia J$_{l}$",
    "shaft_stiffness_nm_per_rad": "shaft stiffness K$_{s}$",
    "shaft_damping_nm_s_per_rad": "shaft damping D$_{s}$",
    "gravity_torque_nm": "gravity m g l",
    "speed_gain_nm_s_per_rad": "speed gain K$_{p}$",
    "integral_gain_nm_per_rad": "integral gain K$_{i}$",
    "position_gain_per_s": "position gain",
    "torque_constant_nm_per_a": "torque constant K$_{t}$",
    "current_limit_a": "current limit i$_{max}$",
    "reference_speed_rpm": "reference speed ω$_{ref}$",
    "stiffness_sharpness_per_rad": "sharpness α",
}


@stored_figure(
    "The curve over benches within their tolerances.", 80, holding("bench_draws", "sweep")
)
def bench_draws(tree: xr.DataTree) -> Figure:
    """Departure of A from the nominal sweep, a line a draw; its slopes at three gaps."""
    parameters = tree["bench_draws"].sizes["parameter"]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, max(2.4, 1.1 + 0.26 * parameters))
    spec = layout.grid(figure, 1, 2, between=(0.0, 1.45))
    spread, slopes = figure.add_subplot(spec[0, 0]), figure.add_subplot(spec[0, 1])
    _draw_spread(spread, tree)
    _draw_slopes(slopes, tree)
    style.head_panels([spread, slopes], ["", ""])
    return figure


def departure_of_log_amplitude(tree: xr.DataTree) -> FloatArray:
    """Of each draw from the nominal sweep at each gap, shape (draw, gap)."""
    group = tree["bench_draws"].to_dataset()
    return np.asarray(group["departure"].sel(quantity="ln_amplitude").values)


def standardised_slopes(tree: xr.DataTree) -> tuple[FloatArray, FloatArray] | None:
    """Change of ln A as one parameter moves by its whole tolerance, all of them regressed at once.

    Returns
    -------
    Slopes and standard errors, each (parameter, gap); ``None`` where there are too few draws.
    """
    shifts = values(tree, "bench_draws", "shift")
    draws, parameters = shifts.shape
    if draws < parameters + 2:
        return None
    design = np.column_stack([np.ones(draws), shifts])
    departure = departure_of_log_amplitude(tree)
    solution = np.linalg.lstsq(design, departure, rcond=None)[0]
    residual = departure - design @ solution
    variance = (residual**2).sum(axis=0) / (draws - parameters - 1)
    inverse = np.diag(np.linalg.inv(design.T @ design))
    return np.asarray(solution[1:]), np.sqrt(np.asarray(inverse[1:, None] * variance))


def _draw_spread(panel: Axes, tree: xr.DataTree) -> None:
    gap = 1e3 * values(tree, "sweep", "gap_rad")
    percent = 100.0 * np.expm1(departure_of_log_amplitude(tree))
    edges = (0.5 - 0.5 * _LEVEL, 0.5 + 0.5 * _LEVEL)
    low, high = np.quantile(percent, edges, axis=0)
    panel.fill_between(
        gap, low, high, color=style.BAND, linewidth=0.0, label=f"{100.0 * _LEVEL:g} % of the draws"
    )
    for index, line in enumerate(percent):
        panel.plot(
            gap, line, color=style.MODEL, linewidth=0.35, alpha=0.7,
            label=f"{len(percent)} bench draws" if index == 0 else None,
        )  # fmt: skip
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    plain_log_axis(panel.xaxis)
    panel.set_xlim(gap[0], gap[-1])
    panel.set_xlabel("Gap δ (mrad)")
    panel.set_ylabel("Departure of A from the nominal bench (%)")
    style.legend_above(panel)


def _draw_slopes(panel: Axes, tree: xr.DataTree) -> None:
    names = [str(n) for n in tree["bench_draws"].to_dataset()["parameter"].values]
    found = standardised_slopes(tree)
    if found is None:
        panel.set_axis_off()
        why = f"too few draws for {len(names)} slopes"
        panel.text(0.5, 0.5, why, ha="center", transform=panel.transAxes)
        return
    slopes, errors = (100.0 * part for part in found)
    gap = values(tree, "sweep", "gap_rad")
    order = np.argsort(np.abs(slopes).mean(axis=1))
    rows = np.arange(len(names))
    for index, column in enumerate((0, gap.size // 2, gap.size - 1)):
        own = style.look(index)
        panel.errorbar(
            slopes[order, column], rows + 0.22 * (1 - index), xerr=errors[order, column],
            color=own.colour, marker=own.marker, markersize=3.5, linestyle="none",
            elinewidth=0.7, label=f"{1e3 * gap[column]:.2g} mrad",
        )  # fmt: skip
    for row in rows[1:]:
        panel.axhline(row - 0.5, color="#e6e6e6", linewidth=0.6, zorder=0.0)
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.set_yticks(rows, [_SHORT.get(names[i], names[i].replace("_", " ")) for i in order])
    panel.tick_params(axis="y", length=0.0)
    panel.set_ylim(-0.5, len(names) - 0.5)
    panel.set_xlabel("Change of A for one tolerance (%)")
    style.legend_above(panel)
