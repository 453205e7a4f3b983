"""A sweep: its curve, polynomials of other degrees, the bench's tolerances, the ringing itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.polynomial import polynomial

from bayesbl.config.bench import parse_bench, reference_bench
from bayesbl.curve.gap_curve import published_curve
from bayesbl.curve.regression import relative_fit
from bayesbl.measurement.curves import SOURCE_PREFIX, curve_from_dataset
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import holding, stored_figure, values
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import DECAY, FREQUENCY

_PAPER = "#d55e00"
_WIDE_SOURCES = ("bench",)
"""Sources of another order of magnitude than the sweep's own: drawn at the scale of eq. 4."""

_POINTS: Mapping[str, Any] = {
    "color": style.NEUTRAL,
    "marker": "o",
    "markersize": 2.4,
    "markerfacecolor": "none",
    "markeredgewidth": 0.5,
    "linestyle": "none",
}
_FILLS: Mapping[str, str] = {
    "bench": "#dcdcdc",
    "regression": "#0072b2",
    "lack_of_fit": "#a6cee3",
}
_NAMES: Mapping[str, str] = {
    "bench": "tolerances of the bench",
    "regression": "coefficients",
    "lack_of_fit": "lack of fit",
}


@stored_figure(
    "(a) Gap against amplitude of the ringing: the sweep and the curve through it; then, where "
    "they apply, the tolerances' share and eq. 4; last, the distance of the sweep's points from "
    "the curve.",
    50,
    holding("gap_curve", "sweep"),
)
def curve(tree: xr.DataTree) -> Figure:
    """δ on A, and relative departures from the curve: the sweep's, wide sources', eq. 4's."""
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 3.7)
    outer = style.grid(figure, 1, 2, between=(0.0, 0.7), widths=(1.0, 1.0))
    whole = figure.add_subplot(outer[0, 0])
    papers, wide = is_papers_bench(tree), any(s in source_bands(tree) for s in _WIDE_SOURCES)
    right = outer[0, 1].subgridspec(2 if papers or wide else 1, 1, hspace=0.42)
    _draw_whole(whole, tree, papers)
    axes, titles = [whole], ["gap and amplitude"]
    if papers or wide:
        far = figure.add_subplot(right[0, 0])
        _draw_far(far, tree, papers)
        far.tick_params(labelbottom=False)
        axes.append(far)
        titles.append("eq. 4 of the paper (dashed)" if papers else "tolerances")
    close = figure.add_subplot(right[-1, 0])
    _draw_close(close, tree)
    axes.append(close)
    titles.append("the sweep")
    amplitude = values(tree, "curve", "amplitude")
    for panel in axes[1:]:
        style.plain_log_axis(panel.xaxis, (1.0, 2.0, 3.0, 5.0))
        panel.set_xlim(0.93 * amplitude[0], 1.07 * amplitude[-1])
        panel.yaxis.set_label_coords(-0.13, 0.5)
        panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.9, zorder=1.5)
    close.set_xlabel("Amplitude of the ringing A (rpm)")
    style.head_panels(axes, titles)
    return figure


def is_papers_bench(tree: xr.DataTree) -> bool:
    """Whether the paper's bench was swept: eq. 4 says nothing about another."""
    swept = parse_bench(tree.attrs["bench"], "bench of the sweep")
    return swept.fingerprint() == reference_bench().fingerprint()


def source_bands(tree: xr.DataTree) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Relative bounds of δ by each stored source alone, at the level of the curve's band.

    Returns
    -------
    Source to lower and upper bound at the knots, each (g,), in percent of the curve.
    """
    stored, level = tree["gap_curve"].to_dataset(), float(tree["curve"].attrs["level"])
    edges = (0.5 - 0.5 * level, 0.5 + 0.5 * level)
    bands = {}
    for name in map(str, stored.data_vars):
        if name.startswith(SOURCE_PREFIX):
            low, high = 100.0 * np.expm1(np.quantile(stored[name].values, edges, axis=0))
            bands[name.removeprefix(SOURCE_PREFIX)] = (low, high)
    return bands


def departures_from_curve(tree: xr.DataTree) -> FloatArray:
    """δ of every sweep point over that of the curve at its amplitude, (g, s), in percent."""
    sweep, stored = tree["sweep"].to_dataset(), tree["gap_curve"].to_dataset()
    nominal = curve_from_dataset(stored, "").gap(sweep["amplitude_rpm"].values)
    return np.asarray(100.0 * (sweep["gap_rad"].values[:, None] / nominal - 1.0))


def _draw_whole(panel: Axes, tree: xr.DataTree, papers: bool) -> None:
    sweep, group = tree["sweep"].to_dataset(), tree["curve"].to_dataset()
    amplitude = group["amplitude"].values
    panel.fill_between(
        amplitude, 1e3 * group["low_rad"].values, 1e3 * group["high_rad"].values,
        color="#c8c8c8", linewidth=0.0, label=f"its {style.band_in_words(group)}, all sources",
    )  # fmt: skip
    panel.plot(
        amplitude,
        1e3 * group["delta_rad"].values,
        color=style.MODEL,
        label=f"curve: {_kind(tree)} with lack of fit",
    )
    if papers:
        inside, eq4 = _paper(tree)
        panel.plot(
            inside, 1e3 * eq4, color=_PAPER, linestyle=(0.0, (4.0, 2.0)), label="eq. 4 of the paper"
        )
    starts = sweep.sizes["start"]
    panel.plot(
        sweep["amplitude_rpm"].values.ravel(), 1e3 * np.repeat(sweep["gap_rad"].values, starts),
        label=f"sweep: {sweep.sizes['gap']} gaps, {starts} start angles", **_POINTS,
    )  # fmt: skip
    panel.set_xlim(left=0.0)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("Amplitude of the ringing A (rpm)")
    panel.set_ylabel("Gap δ (mrad)")
    panel.legend(loc="upper left")


def _kind(tree: xr.DataTree) -> str:
    degree = int(tree.attrs["degree"])
    return "cubic" if degree == 3 else f"degree {degree}"


def _paper(tree: xr.DataTree) -> tuple[FloatArray, FloatArray]:
    """Amplitudes of the stored curve that eq. 4 was made for, and its δ there in rad."""
    amplitude = values(tree, "curve", "amplitude")
    eq4 = published_curve(draws=1)
    inside = amplitude[eq4.outside(amplitude) == 0.0]
    return inside, eq4.gap(inside)


def _draw_far(panel: Axes, tree: xr.DataTree, papers: bool) -> None:
    """Sources that are wide beside the sweep's own, and eq. 4 where it is of this bench."""
    knots = values(tree, "gap_curve", "knots_rpm")
    for source, (low, high) in source_bands(tree).items():
        if source in _WIDE_SOURCES:
            _draw_band(panel, knots, low, high, source)
    if papers:
        inside, eq4 = _paper(tree)
        nominal = curve_from_dataset(tree["gap_curve"].to_dataset(), "").gap(inside)
        panel.plot(
            inside, 100.0 * (eq4 / nominal - 1.0), color=_PAPER, linestyle=(0.0, (4.0, 2.0)),
        )  # fmt: skip
    panel.margins(y=0.1)
    panel.set_ylabel("Departure of δ (%)")
    if panel.get_legend_handles_labels()[0]:
        style.legend_above(panel)


def _draw_close(panel: Axes, tree: xr.DataTree) -> None:
    """Sweep points with their start-angle scatter, the polynomial alone, the narrow sources."""
    stored, sweep = tree["gap_curve"].to_dataset(), tree["sweep"].to_dataset()
    knots = stored["knots_rpm"].values
    bands = {k: v for k, v in source_bands(tree).items() if k not in _WIDE_SOURCES}
    for source, (low, high) in sorted(bands.items(), key=lambda item: -float(np.ptp(item[1]))):
        _draw_band(panel, knots, low, high, source)
    panel.plot(
        knots, 100.0 * np.expm1(-stored["correction"].values), color=style.MODEL,
        linestyle=(0.0, (1.0, 1.0)), label=f"{_kind(tree)} alone",
    )  # fmt: skip
    nominal = curve_from_dataset(stored, "")
    scatter = 100.0 * nominal.log_slope(knots) * stored["start_angle_sd_rpm"].values
    for sign in (-1.0, 1.0):
        panel.plot(
            knots, sign * scatter, color=style.NEUTRAL, linewidth=0.7, linestyle=(0.0, (5.0, 2.0)),
            label="start angle, ± 1 sd" if sign > 0.0 else None,
        )  # fmt: skip
    panel.plot(
        sweep["amplitude_rpm"].values.ravel(), departures_from_curve(tree).ravel(),
        label="sweep points", **_POINTS,
    )  # fmt: skip
    bottom, top = panel.get_ylim()
    panel.set_ylim(bottom, top + 0.55 * (top - bottom))
    panel.set_ylabel("Departure of δ (%)")
    panel.legend(loc="upper right", ncols=2, columnspacing=1.0)


def _draw_band(
    panel: Axes, knots: FloatArray, low: FloatArray, high: FloatArray, source: str
) -> None:
    panel.fill_between(
        knots, low, high, color=_FILLS.get(source, "#f0e0c0"), linewidth=0.0,
        label=_NAMES.get(source, source.replace("_", " ")),
    )  # fmt: skip


@stored_figure(
    "How well polynomials of other degrees describe the sweep.", 70, holding("degrees", "sweep")
)
def degrees(tree: xr.DataTree) -> Figure:
    """Departure by degree, along the curve for the degrees around the one used, and evidence."""
    used = int(tree.attrs["degree"])
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.2)
    spec = style.grid(figure, 1, 3, between=(0.0, 0.62), widths=(1.0, 1.5, 1.0))
    by_degree, along, evidence = (figure.add_subplot(spec[0, i]) for i in range(3))
    _draw_by_degree(by_degree, tree, used)
    _draw_along(along, tree, used)
    _draw_evidence(evidence, tree, used)
    style.head_panels([by_degree, along, evidence], ["", "", ""])
    return figure


def departure_of_degree(tree: xr.DataTree, degree: int) -> tuple[FloatArray, FloatArray]:
    """Mean amplitude at each gap, and δ of that degree's polynomial over the gap, (g,), percent."""
    amplitude = values(tree, "sweep", "amplitude_rpm").mean(axis=1)
    gap = values(tree, "sweep", "gap_rad")
    fitted = polynomial.polyval(amplitude, relative_fit(amplitude, gap, degree))
    return amplitude, np.asarray(100.0 * (fitted / gap - 1.0))


def _draw_by_degree(panel: Axes, tree: xr.DataTree, used: int) -> None:
    degree = values(tree, "degrees", "degree")
    for index, (name, label) in enumerate(
        (("largest_departure", "largest"), ("rms_departure", "RMS"))
    ):
        own = style.look(index)
        panel.plot(
            degree, 100.0 * values(tree, "degrees", name), color=own.colour,
            linestyle=own.dashes, marker=own.marker, label=label,
        )  # fmt: skip
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.set_ylabel("Departure of δ (%)")
    _mark_degrees(panel, degree, used)
    style.legend_above(panel)


def _draw_along(panel: Axes, tree: xr.DataTree, used: int) -> None:
    stored = set(values(tree, "degrees", "degree"))
    for index, degree in enumerate(d for d in (used - 1, used, used + 1) if d in stored):
        amplitude, departure = departure_of_degree(tree, degree)
        own = style.look(index)
        panel.plot(
            amplitude, departure, color=own.colour, linestyle=own.dashes,
            marker=own.marker, markersize=2.5, linewidth=0.8, label=f"degree {degree}",
        )  # fmt: skip
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.set_xlabel("Amplitude of the ringing A (rpm)")
    panel.set_ylabel("Departure of δ (%)")
    style.legend_above(panel)


def _draw_evidence(panel: Axes, tree: xr.DataTree, used: int) -> None:
    degree, evidence = (values(tree, "degrees", n) for n in ("degree", "log_evidence"))
    panel.plot(
        degree, evidence.max() - evidence, color=style.MEASURED, marker="o", linewidth=0.7,
        markersize=3.0,
    )  # fmt: skip
    panel.set_yscale("symlog", linthresh=10.0)
    panel.yaxis.set_minor_locator(NullLocator())
    panel.set_ylim(bottom=-1.0)
    panel.set_ylabel("Log evidence below the best")
    _mark_degrees(panel, degree, used)


def _mark_degrees(panel: Axes, degree: FloatArray, used: int) -> None:
    style.shade(panel, used - 0.3, used + 0.3)
    panel.xaxis.set_major_locator(FixedLocator([float(d) for d in degree]))
    panel.set_xlabel("Degree (shaded: used)")


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
    spec = style.grid(figure, 1, 2, between=(0.0, 1.45))
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
    style.plain_log_axis(panel.xaxis)
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


@stored_figure(
    "The ringing as the gap grows: (a) one rotation of the load, (b) its positive and (c) its "
    "negative pulse.",
    60,
    holding("examples", "sweep"),
)
def disturbance(tree: xr.DataTree) -> Figure:
    """Noise-free speed at some gaps over one load rotation; both pulses from nearby."""
    names = ("time_s", "motor_speed_rpm", "gap_rad")
    time, speeds, gaps = (values(tree, "examples", name) for name in names)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.6)
    spec = style.grid(figure, 1, 3, top=0.5, between=(0.0, 0.25), widths=(1.5, 1.0, 1.0))
    whole = figure.add_subplot(spec[0, 0])
    positive = figure.add_subplot(spec[0, 1], sharey=whole)
    negative = figure.add_subplot(spec[0, 2], sharey=whole)
    begin, length = pulse_view(tree)
    views = [(positive, int(np.argmax(speeds[-1]))), (negative, int(np.argmin(speeds[-1])))]
    for index, (gap, speed) in enumerate(zip(gaps, speeds, strict=True)):
        colour = colours(len(gaps))[index]
        label = f"δ = {1e3 * gap:.2f} mrad"
        whole.plot(time, speed, color=colour, linewidth=0.8, label=label)
        for panel, peak in views:
            _draw_pulse(panel, time, speed, time[peak] + begin, length, colour)
    for _, peak in views:
        _mark_disturbance(whole, time, time[peak] + begin, length)
    whole.set_xlim(time[0], time[-1])
    whole.set_xlabel("Time (s)")
    whole.set_ylabel("Motor speed (rpm)")
    for panel, _ in views:
        panel.set_xlim(0.0, 1e3 * length)
        panel.set_xlabel("Time in the shaded part (ms)")
        panel.tick_params(labelleft=False)
    style.head_panels(
        [whole, positive, negative], ["one load rotation", "positive pulse", "negative pulse"]
    )
    figure.legend(*whole.get_legend_handles_labels(), loc="upper center", ncols=len(gaps))
    return figure


def pulse_view(tree: xr.DataTree) -> tuple[float, float]:
    """Start relative to a pulse's first peak, and length, of a view that holds it; s.

    Long enough for the ringing of the largest gap to fall to 5 %, and almost two periods before it.
    """
    period = 2.0 * np.pi / float(values(tree, "sweep", FREQUENCY)[-1].mean())
    ringing = 3.0 / float(values(tree, "sweep", DECAY)[-1].mean())
    return -1.75 * period, 1.75 * period + ringing


def colours(count: int) -> list[tuple[float, float, float, float]]:
    """From light to dark with the gap, in grey too."""
    shades = mpl.colormaps["viridis_r"](np.linspace(0.18, 1.0, count))
    return [(float(r), float(g), float(b), float(a)) for r, g, b, a in shades]


def _mark_disturbance(whole: Axes, time: FloatArray, begin: float, length: float) -> None:
    """Where a pulse's view lies in the rotation, in two parts if it runs over the end."""
    period = time[-1] - time[0]
    for turn in (-period, 0.0, period):
        start, stop = max(begin + turn, time[0]), min(begin + turn + length, time[-1])
        if start < stop:
            style.shade(whole, start, stop)


def _draw_pulse(
    panel: Axes,
    time: FloatArray,
    speed: FloatArray,
    begin: float,
    length: float,
    colour: tuple[float, float, float, float],
) -> None:
    """A stretch of the rotation, which continues from its end to its start."""
    period = time[-1] - time[0]
    shifted = (time[:-1] - begin) % period
    order = np.argsort(shifted)
    inside = order[shifted[order] <= length]
    panel.plot(1e3 * shifted[inside], speed[inside], color=colour, linewidth=1.0)
