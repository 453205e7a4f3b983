"""Where recording and simulation disagree, over the load angle and by order, for each recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D

from bayesbl.presentation.figures.layout import grid
from bayesbl.presentation.figures.panels import rotation_axis
from bayesbl.presentation.figures.stored_figure import file_ending, holding, stored_figure
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    MEASURED,
    NEUTRAL,
    head_panels,
    look,
    new_figure,
)
from bayesbl.recording.types import CHANNELS, FloatArray
from bayesbl.units import unit_of

_NOISE = "#000000"
_ROW_IN = 2.0
_BINS = 250
_EXCEEDED = 0.01
"""Probability that noise alone shows any bin beyond the limit drawn."""
_LABELLED = 3
_RIGHT_HALF = 400.0
"""Load order beyond which a label has no room on its right."""
_MARKS = {"load angle": "o", "motor angle": "^", "time": "s", "angle or time": "D"}
_NAMES = {
    "load angle": "load order",
    "motor angle": "motor order",
    "time": "periodic in time",
    "angle or time": "angle or time",
}


def _each_recording(tree: xr.DataTree) -> Iterator[tuple[str, tuple[object, ...]]]:
    before, after = (tree[f"residuals_{stage}"].to_dataset() for stage in ("before", "after"))
    for name in map(str, before["recording"].values):
        yield file_ending(name), (before, name, after)


@stored_figure(
    "Measured signals, bench before and after naming, and the residuals.",
    90,
    holding("residuals_before", "residuals_after"),
    name="diagnosis",
    parts=_each_recording,
)
def residuals_by_angle(before: xr.Dataset, recording: str, after: xr.Dataset) -> Figure:
    """A row for each channel: overlay, residuals against load angle, their order spectrum.

    Parameters
    ----------
    before, after
        As :mod:`bayesbl.diagnosis.residual_groups` stores them, of the bench as believed and with
        what was named.
    recording
        Name of one recording of theirs.
    """
    stages = [stage.sel(recording=recording) for stage in (before, after)]
    channels = [str(name) for name in np.atleast_1d(before.attrs["channels"])]
    channels = [n for n in channels if not np.isnan(stages[0][f"{n}_offset"])]
    rows = len(channels)
    figure = new_figure(DOUBLE_COLUMN_IN, 1.04 + _ROW_IN * rows)
    spec = grid(figure, rows, 3, left=0.6, top=0.64, between=(0.6, 0.62))
    axes: list[Axes] = []
    titles: list[str] = []
    for row, channel in enumerate(channels):
        overlay = figure.add_subplot(spec[row, 0])
        _overlay(overlay, stages, channel)
        maps = _load_maps(figure, spec[row, 1], stages, channel)
        spectrum = figure.add_subplot(spec[row, 2])
        _spectrum(spectrum, stages, channel)
        axes += [overlay, maps[0], spectrum]
        titles += [CHANNELS.get(channel, channel), "residuals: before, after", "their spectrum"]
    head_panels(axes, titles)
    _legend(figure, stages, channels)
    return figure


def _overlay(panel: Axes, stages: list[xr.Dataset], channel: str) -> None:
    angle = _values(stages[0], "load_angle_rad")
    panel.plot(angle, _values(stages[0], f"{channel}_recorded"), color=MEASURED, linewidth=1.6)
    for index, stage in enumerate(stages):
        style = look(index)
        panel.plot(
            angle,
            _values(stage, f"{channel}_simulated"),
            color=style.colour,
            linestyle=style.dashes,
            linewidth=0.9,
        )
    panel.set_ylabel(f"{_capital(channel)} ({unit_of(channel)})")
    rotation_axis(panel, "Load angle (rad)")


def _load_maps(
    figure: Figure, place: SubplotSpec, stages: list[xr.Dataset], channel: str
) -> list[Axes]:
    """One above the other on one scale: where little was removed, one would hide the other."""
    angle = _values(stages[0], "load_angle_rad")
    spec = place.subgridspec(len(stages), 1, hspace=0.12)
    panels: list[Axes] = []
    for index, stage in enumerate(stages):
        first = panels[0] if panels else None
        panel = figure.add_subplot(spec[index, 0], sharex=first, sharey=first)
        style = look(index)
        mean = _values(stage, f"{channel}_load_map")
        error = float(stage[f"{channel}_map_error"])
        panel.axhline(0.0, color=NEUTRAL, linewidth=0.6)
        panel.fill_between(
            angle, mean - error, mean + error, color=style.colour, alpha=0.3, linewidth=0.0
        )
        panel.plot(angle, mean, color=style.colour, linewidth=0.7)
        rotation_axis(panel, "Load angle (rad)")
        panel.label_outer()
        panels.append(panel)
    panels[0].set_ylabel(f"Recorded − simulated ({unit_of(channel)})", y=-0.06)
    return panels


def _spectrum(panel: Axes, stages: list[xr.Dataset], channel: str) -> None:
    for index, stage in enumerate(stages):
        order, amplitude, noise = (
            _values(stage, name)
            for name in ("load_order", f"{channel}_amplitude", f"{channel}_noise_amplitude")
        )
        shown = (order > 0.0) & np.isfinite(amplitude)
        style = look(index)
        panel.plot(
            *_peaks(order[shown], amplitude[shown]),
            color=style.colour,
            linestyle=style.dashes,
            linewidth=0.7,
            zorder=1.0,
        )
        _mark(panel, stage, channel, style.colour)
        if index == len(stages) - 1:
            limit = noise[shown] * np.sqrt(np.log(shown.sum() / _EXCEEDED))
            panel.plot(order[shown], limit, color=_NOISE, linewidth=0.8)
    panel.set_xscale("log")
    panel.set_yscale("log")
    low, high = panel.get_ylim()
    panel.set_ylim(low, 2.5 * high)
    panel.set_xlabel("Cycles per load rotation")
    panel.set_ylabel(f"Amplitude ({unit_of(channel)})")


def _peaks(order: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest amplitude in each stretch of the logarithmic axis: every line is on the page."""
    edges = np.geomspace(order[0], order[-1], _BINS + 1)
    starts = np.unique(np.searchsorted(order, edges[:-1]))
    ends = np.append(starts[1:], order.size)
    tops = [
        begin + int(np.argmax(amplitude[begin:end]))
        for begin, end in zip(starts, ends, strict=True)
    ]
    return order[tops], amplitude[tops]


def _mark(panel: Axes, stage: xr.Dataset, channel: str, colour: str) -> None:
    """Significant lines by what they repeat with; the strongest single ones named."""
    order = _values(stage, f"{channel}_line_load_order")
    amplitude = _values(stage, f"{channel}_line_amplitude")
    dependence = np.atleast_1d(stage[f"{channel}_line_dependence"].values).astype(str)
    for name, marker in _MARKS.items():
        here = dependence == name
        panel.plot(
            order[here],
            amplitude[here],
            linestyle="none",
            marker=marker,
            markersize=2.2 if name == "load angle" else 3.5,
            markerfacecolor="none",
            markeredgecolor=colour,
            markeredgewidth=0.6,
            zorder=2.0,
        )
    single = np.flatnonzero((dependence != "load angle") & np.isfinite(order))[:_LABELLED]
    for i in single:
        text = f"{float(stage[f'{channel}_line_frequency_hz'][i]):.3g} Hz"
        if dependence[i] == "motor angle":
            text = f"motor {float(stage[f'{channel}_line_motor_order'][i]):.3g}"
        panel.annotate(
            text,
            (order[i], amplitude[i]),
            xytext=(-3.5 if order[i] > _RIGHT_HALF else 3.5, 0.0),
            textcoords="offset points",
            ha="right" if order[i] > _RIGHT_HALF else "left",
            va="center",
            fontsize=7.0,
        )


def _legend(figure: Figure, stages: list[xr.Dataset], channels: list[str]) -> None:
    panel = figure.axes[0]
    handles = [Line2D([], [], color=MEASURED, linewidth=1.6, label="recorded, mean of rotations")]
    for index, name in enumerate(("simulated before", "simulated after")):
        style = look(index)
        handles += panel.plot([], [], color=style.colour, linestyle=style.dashes, label=name)
    handles.append(
        Line2D(
            [],
            [],
            color=_NOISE,
            linewidth=0.8,
            label=f"limit of noise ({100.0 * _EXCEEDED:g} % false alarm)",
        )
    )
    found = {
        str(name)
        for stage in stages
        for channel in channels
        for name in np.atleast_1d(stage[f"{channel}_line_dependence"].values)
    }
    for name, marker in _MARKS.items():
        if name in found:
            handles.append(
                Line2D(
                    [],
                    [],
                    linestyle="none",
                    marker=marker,
                    markerfacecolor="none",
                    markeredgecolor=NEUTRAL,
                    label=f"significant: {_NAMES[name]}",
                )
            )
    figure.legend(handles=handles, loc="upper center", ncols=4, columnspacing=1.2)


def _capital(channel: str) -> str:
    name = CHANNELS.get(channel, channel)
    return name[:1].upper() + name[1:]


def _values(stage: xr.Dataset, name: str) -> FloatArray:
    return np.atleast_1d(np.asarray(stage[name].values, dtype=float))
