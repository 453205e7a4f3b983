"""Figures of a sweep: its curve, the tolerances of the bench, and the ringing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.config.bench import parse_bench, reference_bench
from bayesbl.curve.gap_curve import published_curve
from bayesbl.measurement.curves import SOURCE_PREFIX, curve_from_dataset
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.presentation.words import in_words
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import DECAY, FREQUENCY

_PAPER = "#d55e00"
_WIDE_SOURCES = ("bench",)  # sources far larger than the sweep's own; drawn at the scale of eq. 4.

_POINTS: Mapping[str, Any] = {
    "color": style.NEUTRAL,
    "marker": "o",
    "markersize": 2.4,
    "markerfacecolor": "none",
    "markeredgewidth": 0.5,
    "linestyle": "none",
}
_FILLS: Mapping[str, str] = {"bench": "#dcdcdc", "regression": "#0072b2", "lack_of_fit": "#a6cee3"}


@stored_figure(
    "(a) Gap against amplitude of the ringing: the sweep and the curve through it; then, where "
    "they apply, the tolerances' share and eq. 4; last, the distance of the sweep's points from "
    "the curve.",
    50,
    holding("curve", "sweep"),
)
def curve(tree: xr.DataTree) -> Figure:
    """δ over A, and relative deviations from the curve: sweep, wide sources, eq. 4."""
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 3.7)
    outer = style.grid(figure, 1, 2, between=(0.0, 0.7), widths=(1.0, 1.0))
    whole = figure.add_subplot(outer[0, 0])
    swept = parse_bench(tree.attrs["bench"], "bench of the sweep")
    papers = swept.fingerprint() == reference_bench().fingerprint()  # eq. 4 is of no other
    wide = any(source in source_bands(tree) for source in _WIDE_SOURCES)
    right = outer[0, 1].subgridspec(2 if papers or wide else 1, 1, hspace=0.42)
    _draw_whole(whole, tree, papers)
    axes, titles = [whole], ["gap and amplitude"]
    if papers or wide:
        axes.append(figure.add_subplot(right[0, 0]))
        titles.append("eq. 4 of the paper (dashed)" if papers else "tolerances")
        _draw_far(axes[-1], tree, papers)
        axes[-1].tick_params(labelbottom=False)
    axes.append(figure.add_subplot(right[-1, 0]))
    titles.append("the sweep")
    _draw_close(axes[-1], tree)
    amplitude = _values(tree, "curve/amplitude")
    for panel in axes[1:]:
        style.plain_log_axis(panel.xaxis, (1.0, 2.0, 3.0, 5.0))
        panel.set_xlim(0.93 * amplitude[0], 1.07 * amplitude[-1])
        panel.yaxis.set_label_coords(-0.13, 0.5)
        panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.9, zorder=1.5)
    axes[-1].set_xlabel("Amplitude of the ringing A (rpm)")
    style.head_panels(axes, titles)
    return figure


def _values(tree: xr.DataTree, path: str) -> FloatArray:
    """A numeric variable (``curve/amplitude``) in its own shape and unit."""
    group, _, variable = path.partition("/")
    return np.asarray(tree[group].to_dataset()[variable].values, dtype=float)


def source_bands(tree: xr.DataTree) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Bounds of δ by each source alone, each (g,), in percent of the curve at its knots."""
    stored = tree["curve"].to_dataset()
    level = float(stored.attrs["level"])
    edges = (0.5 - 0.5 * level, 0.5 + 0.5 * level)
    bands = {}
    for name in map(str, stored.data_vars):
        if name.startswith(SOURCE_PREFIX):
            low, high = 100.0 * np.expm1(np.quantile(stored[name].values, edges, axis=0))
            bands[name.removeprefix(SOURCE_PREFIX)] = (low, high)
    return bands


def departures_from_curve(tree: xr.DataTree) -> FloatArray:
    """δ of every sweep point over the curve at its amplitude, (g, s), in percent."""
    sweep, stored = tree["sweep"].to_dataset(), tree["curve"].to_dataset()
    nominal = curve_from_dataset(stored, "").gap(sweep["amplitude_rpm"].values)
    return np.asarray(100.0 * (sweep["gap_rad"].values[:, None] / nominal - 1.0))


def _draw_whole(panel: Axes, tree: xr.DataTree, papers: bool) -> None:
    sweep, group = tree["sweep"].to_dataset(), tree["curve"].to_dataset()
    band = f"its {style.band_in_words(group)}, all sources"
    style.draw_curve(panel, group, style.MODEL, f"curve: {_kind(tree)} with lack of fit", band)
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
    panel.set(xlabel="Amplitude of the ringing A (rpm)", ylabel="Gap δ (mrad)")
    panel.set(xlim=(0.0, None), ylim=(0.0, None))
    panel.legend(loc="upper left")


def _kind(tree: xr.DataTree) -> str:
    degree = int(tree.attrs["degree"])
    return "cubic" if degree == 3 else f"degree {degree}"


def _paper(tree: xr.DataTree) -> tuple[FloatArray, FloatArray]:
    """Amplitudes of the curve for which eq. 4 was made, and its δ there in rad."""
    amplitude = _values(tree, "curve/amplitude")
    eq4 = published_curve(draws=1)
    inside = amplitude[eq4.outside(amplitude) == 0.0]
    return inside, eq4.gap(inside)


def _draw_far(panel: Axes, tree: xr.DataTree, papers: bool) -> None:
    """Wide sources, and eq. 4 if it belongs to this bench."""
    _draw_bands(panel, tree, {k: v for k, v in source_bands(tree).items() if k in _WIDE_SOURCES})
    if papers:
        inside, eq4 = _paper(tree)
        nominal = curve_from_dataset(tree["curve"].to_dataset(), "").gap(inside)
        panel.plot(
            inside, 100.0 * (eq4 / nominal - 1.0), color=_PAPER, linestyle=(0.0, (4.0, 2.0)),
        )  # fmt: skip
    panel.margins(y=0.1)
    panel.set_ylabel("Departure of δ (%)")
    if panel.get_legend_handles_labels()[0]:
        panel.legend(loc="upper right")


def _draw_close(panel: Axes, tree: xr.DataTree) -> None:
    """Sweep points with the scatter of start angles, the polynomial, the narrow sources."""
    stored, sweep = tree["curve"].to_dataset(), tree["sweep"].to_dataset()
    knots = stored["knots_rpm"].values
    bands = {k: v for k, v in source_bands(tree).items() if k not in _WIDE_SOURCES}
    _draw_bands(panel, tree, bands)
    panel.plot(
        knots, 100.0 * np.expm1(-stored["correction"].values), color=style.MODEL,
        linestyle=(0.0, (1.0, 1.0)), label=f"{_kind(tree)} alone",
    )  # fmt: skip
    nominal = curve_from_dataset(stored, "")
    scatter = 100.0 * nominal.log_slope(knots) * stored["start_angle_sd_rpm"].values
    dashes = (0.0, (5.0, 2.0))
    for edge, label in ((-scatter, None), (scatter, "start angle, ± 1 sd")):
        panel.plot(knots, edge, color=style.NEUTRAL, lw=0.7, linestyle=dashes, label=label)
    panel.plot(
        sweep["amplitude_rpm"].values.ravel(), departures_from_curve(tree).ravel(),
        label="sweep points", **_POINTS,
    )  # fmt: skip
    bottom, top = panel.get_ylim()
    panel.set_ylim(bottom, top + 0.55 * (top - bottom))
    panel.set_ylabel("Departure of δ (%)")
    panel.legend(loc="upper right", ncols=2, columnspacing=1.0)


def _draw_bands(
    panel: Axes, tree: xr.DataTree, bands: Mapping[str, tuple[FloatArray, FloatArray]]
) -> None:
    """The widest first, below the others."""
    knots = _values(tree, "curve/knots_rpm")
    for source, (low, high) in sorted(bands.items(), key=lambda item: -float(np.ptp(item[1]))):
        colour = _FILLS.get(source, "#f0e0c0")
        panel.fill_between(knots, low, high, color=colour, linewidth=0.0, label=in_words(source))


@stored_figure(
    "The ringing as the gap grows: (a) one rotation of the load, (b) its positive and (c) its "
    "negative pulse.",
    60,
    holding("examples", "sweep"),
)
def disturbance(tree: xr.DataTree) -> Figure:
    """Noise-free speed at some gaps over one load rotation, with both pulses enlarged."""
    names = ("time_s", "motor_speed_rpm", "gap_rad")
    time, speeds, gaps = (_values(tree, f"examples/{name}") for name in names)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 2.6)
    spec = style.grid(figure, 1, 3, top=0.5, between=(0.0, 0.25), widths=(1.5, 1.0, 1.0))
    whole = figure.add_subplot(spec[0, 0])
    begin, length = pulse_view(tree)
    # A quarter of a rotation from either end, as the arm starts level.
    peaks = (np.argmax(speeds[-1]), np.argmin(speeds[-1]))  # of a positive and a negative pulse
    views = {figure.add_subplot(spec[0, n], sharey=whole): peak for n, peak in enumerate(peaks, 1)}
    for gap, speed, colour in zip(gaps, speeds, colours(len(gaps)), strict=True):
        label = f"δ = {1e3 * gap:.2f} mrad"
        whole.plot(time, speed, color=colour, linewidth=0.8, label=label)
        for panel, peak in views.items():
            panel.plot(1e3 * (time - time[peak] - begin), speed, color=colour, linewidth=1.0)
    for peak in views.values():
        style.shade(whole, time[peak] + begin, time[peak] + begin + length)
    whole.set(xlim=(time[0], time[-1]), xlabel="Time (s)", ylabel="Motor speed (rpm)")
    for panel in views:
        panel.set(xlim=(0.0, 1e3 * length), xlabel="Time in the shaded part (ms)")
        panel.tick_params(labelleft=False)
    style.head_panels([whole, *views], ["one load rotation", "positive pulse", "negative pulse"])
    figure.legend(*whole.get_legend_handles_labels(), loc="upper center", ncols=len(gaps))
    return figure


def pulse_view(tree: xr.DataTree) -> tuple[float, float]:
    """Start (relative to a pulse's first peak) and length, in s, of a view of the pulse.

    It begins almost two periods before, and ends when the ringing of the largest gap has fallen to
    5 %.
    """
    period = 2.0 * np.pi / float(_values(tree, f"sweep/{FREQUENCY}")[-1].mean())
    ringing = 3.0 / float(_values(tree, f"sweep/{DECAY}")[-1].mean())
    return -1.75 * period, 1.75 * period + ringing


def colours(count: int) -> list[tuple[float, float, float, float]]:
    """Colours from light to dark with the gap, in grey too."""
    shades = mpl.colormaps["viridis_r"](np.linspace(0.18, 1.0, count))
    return [(float(r), float(g), float(b), float(a)) for r, g, b, a in shades]
