"""Figures of a diagnosis or identification: model errors before and after, and what was learned."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from bayesbl.presentation.diagnosis import USES, compared_pieces, headline, learned_of
from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.presentation.words import capitalised, significant
from bayesbl.recording.types import CHANNELS, FloatArray
from bayesbl.results.store import summary_of
from bayesbl.units import in_words, unit_of

if TYPE_CHECKING:
    from bayesbl.diagnosis.disagreement import DisagreementSummary, Use
    from bayesbl.diagnosis.groups import DiagnosisSummary
    from bayesbl.identification.groups import IdentificationSummary

    Piece = tuple[str, str, Use, DisagreementSummary]

_LOOKS = (style.look(1), style.look(0))  # looks of the bench as given, and with what was named
_ZOOM = 0.04  # share of a recording that the zoom shows
_FEWEST_SHOWN = 150  # samples in the zoom, if the recording has twice as many
_OUTLINE_BINS = 900
_LINE_LETTERS = 125
_SHOWN_ROW_IN = 1.75


def _held_out(tree: xr.DataTree) -> Iterator[tuple[str, tuple[object, ...]]]:
    """The held-out recording that the given bench predicts worst; a fitted one without any."""
    pieces = _pieces(tree)
    last = [piece for piece in pieces if piece[2] == "held_out"] or pieces
    stored = set(tree["signals"].to_dataset()["recording"].values.tolist())
    known = (piece for piece in last if piece[0] in stored)
    name, _, use, _ = max(known, key=lambda piece: piece[3]["before"] / piece[3]["noise_floor"])
    yield "", (tree, name, use)


def _pieces(tree: xr.DataTree) -> list[Piece]:
    """Everything compared, held-out pieces first."""
    summary: DiagnosisSummary = summary_of(tree)
    return sorted(compared_pieces(summary["disagreement"]), key=lambda piece: piece[2])


@stored_figure(
    "A held-out recording: its disagreement with the bench before and after naming.",
    85,
    holding("signals/measured"),
    name="diagnosis",
    parts=_held_out,
)
def held_out(tree: xr.DataTree, recording: str, use: Use) -> Figure:
    """A row for each channel: both residuals on one scale, and a zoom; beside them every RMS."""
    pieces = _pieces(tree)
    rms = {channel: size for name, channel, of, size in pieces if (name, of) == (recording, use)}
    whole = f"Left: recording {recording}, {USES[use]}. Right: all recordings."
    heading = [*textwrap.wrap(headline(summary_of(tree)), _LINE_LETTERS), whole]
    top = 0.5 + style.LINE_IN * len(heading)
    height = max(_SHOWN_ROW_IN * len(rms) + 0.3, 0.26 * len(pieces) + 0.6)
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, top + height)
    spec = style.grid(
        figure, len(rms), 3, left=0.6, top=top, between=(0.62, 0.58), widths=(2.9, 2.1, 1.6)
    )
    figure.text(
        0.06 / style.DOUBLE_COLUMN_IN, 1.0 - 0.06 / (top + height), "\n".join(heading),
        va="top", linespacing=1.25,
    )  # fmt: skip
    heads: dict[Axes, str] = {}
    window: tuple[float, float] | None = None
    for row, (channel, sizes) in enumerate(rms.items()):
        course = _compared(tree["signals"].to_dataset(), recording, use, channel)
        window = window or _worst(course)
        maps = _draw_residuals(spec[row, 0], course, sizes, channel, window)
        zoom = figure.add_subplot(spec[row, 1])
        _draw_zoom(zoom, course, channel, window)
        name = CHANNELS.get(channel, channel)
        heads |= {maps[0]: f"{name}, recorded − simulated", zoom: "the tinted part"}
    every = figure.add_subplot(spec[:, 2])
    _draw_every(every, pieces)
    style.head_panels([*heads, every], [*heads.values(), "RMS over noise floor"])
    handles, labels = zoom.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", ncols=3, borderaxespad=0.0,
        bbox_to_anchor=(0.0, 1.0 - (0.08 + style.LINE_IN * len(heading)) / (top + height)),
    )  # fmt: skip
    return figure


def _compared(signals: xr.Dataset, recording: str, use: str, channel: str) -> dict[str, FloatArray]:
    """``time_s``, ``measured``, ``before`` and ``after``, each (n,); NaN between two pieces."""
    place = {"recording": recording, "use": use, "channel": channel}
    rows = np.all([signals[key].values == value for key, value in place.items()], axis=0)
    pieces = [signals.isel(piece=i) for i in np.flatnonzero(rows)]
    kept = [piece.isel(sample=np.isfinite(piece["time_s"].values)) for piece in pieces]
    return {
        name: np.concatenate([np.append(piece[name].values, np.nan) for piece in kept])[:-1]
        for name in ("time_s", "measured", "before", "after")
    }


def _worst(course: dict[str, FloatArray]) -> tuple[float, float]:
    """The stretch of time in which the given bench is worst."""
    time, residual = course["time_s"], np.abs(course["measured"] - course["before"])
    first, last = float(np.nanmin(time)), float(np.nanmax(time))
    enough = _FEWEST_SHOWN * float(np.nanmedian(np.diff(time)))
    width = min(max(_ZOOM * (last - first), enough), 0.5 * (last - first))
    middle = float(time[np.nanargmax(residual)])
    begin = min(max(middle - 0.4 * width, first), last - width)
    return begin, begin + width


def _draw_residuals(
    place: SubplotSpec,
    course: dict[str, FloatArray],
    rms: DisagreementSummary,
    channel: str,
    window: tuple[float, float],
) -> list[Axes]:
    """Residuals before and after on one scale, with the zoom shaded."""
    unit, sizes, floor = unit_of(channel), (rms["before"], rms["after"]), rms["noise_floor"]
    unchanged = np.array_equal(course["before"], course["after"])
    stages = list(zip(("before", "after"), _LOOKS, strict=True))[: 1 if unchanged else 2]
    # On one scale, one above the other: where little was removed, one would hide the other.
    spec = place.subgridspec(len(stages), 1, hspace=0.12)
    panels = list(spec.subplots(sharex=True, sharey=True, squeeze=False).ravel())
    for panel, (stage, look), size in zip(panels, stages, sizes, strict=False):
        middle, low, high = style.envelope(
            course["time_s"], course["measured"] - course[stage], _OUTLINE_BINS
        )
        panel.fill_between(middle, low, high, color=look.colour, linewidth=0.3)
        style.shade(panel, *window)
        text = f"{stage}: RMS {significant(size, 3)} {unit}"
        if stage == stages[-1][0]:
            text += f", noise floor {significant(floor, 3)} {unit}"
        panel.text(0.01, 0.98, text, transform=panel.transAxes, va="top")
    bottom, top = panels[0].get_ylim()
    panels[0].set_ylim(bottom, top + 0.25 * (top - bottom))  # the line of text is above the data
    panels[0].set_xlim(np.nanmin(course["time_s"]), np.nanmax(course["time_s"]))
    panels[-1].set_xlabel("Time (s)")
    panels[0].set_ylabel(f"Residual ({unit})", y=0.5 if unchanged else -0.06)
    return panels


def _draw_zoom(
    panel: Axes, course: dict[str, FloatArray], channel: str, window: tuple[float, float]
) -> None:
    time = course["time_s"]
    inside = (time >= window[0]) & (time <= window[1])
    panel.plot(
        time[inside], course["measured"][inside], color=style.MEASURED, linewidth=1.4,
        label="recorded",
    )  # fmt: skip
    labels = ("bench as given (before)", "with what was named (after)")
    for stage, look, label in zip(("before", "after"), _LOOKS, labels, strict=True):
        panel.plot(
            time[inside], course[stage][inside], color=look.colour, linestyle=look.dashes,
            linewidth=0.9, label=label,
        )  # fmt: skip
    name = capitalised(CHANNELS.get(channel, channel))
    panel.set(xlim=window, xlabel="Time (s)", ylabel=f"{name} ({unit_of(channel)})")
    panel.locator_params(axis="x", nbins=4)


def _draw_every(panel: Axes, pieces: Sequence[Piece]) -> None:
    """RMS over the noise floor of every recording and channel, before and after."""
    channels = {channel for _, channel, *_ in pieces}
    reach = 1.0
    for row, (name, channel, use, size) in enumerate(pieces):
        ends = tuple(size[stage] / size["noise_floor"] for stage in ("before", "after"))
        reach = max(reach, *ends)
        panel.plot(ends, (row, row), color=style.WITHHELD, linewidth=0.8, zorder=1.0)
        for end, look in zip(ends, _LOOKS, strict=True):
            panel.plot(end, row, look.marker, color=look.colour, zorder=2.0)
        of = f", {CHANNELS.get(channel, channel).removeprefix('motor ')}" * (len(channels) > 1)
        text = f"{name}{of}" + ", held out" * (use == "held_out")
        panel.text(1.0, row - 0.2, f" {text}", va="bottom")
    panel.axvline(1.0, color=style.NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)), zorder=0.5)
    style.plain_log_axis(panel.xaxis, (1.0, 2.0, 5.0) if reach < 30.0 else (1.0,))
    panel.set(xlim=(0.85, 1.25 * max(reach, 1.6)), xlabel="RMS / noise floor")
    panel.set(ylim=(len(pieces) - 0.5, -0.8), yticks=[])
    panel.spines["left"].set_visible(False)


LEVEL_SD = 1.645  # half-width of a 90 % interval in standard deviations

_VARIABLES = {
    "motor_angle": (0.5 / math.pi, "Motor angle from the first recording's start (turns)"),
    "load_angle": (180.0 / math.pi, "Load angle (°), 0 hangs down"),
    "motor_speed": (1.0, "Motor speed (rad/s)"),
    "time": (1.0, "Time from the start of the first recording (s)"),
}
"""Scale of what a learned term depends on, and label."""
_LEARNED = {
    "learned_torque": ("torque_nm", "sd_nm", 1.0, "Learned torque\nat the {} (N m)"),
    "encoder_error": ("angle_rad", "sd_rad", 1e3, "Error of the\nencoder (mrad)"),
}
"""Variables of each group, scale of their values, and label."""


@stored_figure(
    "What was learned because no known effect explains what repeats, with a 90 % band: a torque, "
    "or an error of the motor's encoder (shown angle minus true angle).",
    95,
    lambda tree: any(group in tree.children for group in _LEARNED),
    name="learned",
)
def learned_course(tree: xr.DataTree) -> Figure:
    """The learned term for forward motion."""
    group = next(group for group in _LEARNED if group in tree.children)
    value, deviation, scale, label = _LEARNED[group]
    stored = tree[group].to_dataset()
    term = learned_of(summary_of(tree))
    assert term is not None
    figure = style.new_figure(style.SINGLE_COLUMN_IN, 2.0)
    panel = figure.add_subplot(style.grid(figure, 1, 1, left=0.75, top=0.15)[0, 0])
    in_unit, variable = _VARIABLES[term["variable"]]
    x = stored["variable"].values * in_unit
    course, reach = scale * stored[value].values, scale * LEVEL_SD * stored[deviation].values
    panel.fill_between(x, course - reach, course + reach, color=style.BAND, linewidth=0.0)
    panel.plot(x, course, color=style.MODEL)
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.5)
    panel.set(xlim=(x[0], x[-1]), xlabel=variable, ylabel=label.format(term["side"]))
    if term["variable"] == "load_angle":
        panel.set_xticks([-180.0, -90.0, 0.0, 90.0, 180.0])
    return figure


@stored_figure(
    "Each parameter of the bench: the tolerance of the data sheet, and the interval identified.",
    100,
    lambda tree: bool(tree.attrs["kind"] == "identify"),
)
def prior_and_posterior(tree: xr.DataTree) -> Figure:
    """Per cent from the data sheet: its tolerance, and the identified median and interval."""
    summary: IdentificationSummary = summary_of(tree)
    parameters = summary["parameters"]
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.8 + 0.3 * len(parameters))
    place = style.grid(figure, 1, 1, left=1.55, right=1.75, top=0.35, bottom=0.45)
    panel = figure.add_subplot(place[0, 0])
    for line, entry in enumerate(parameters.values()):
        prior, posterior = entry["prior"], entry["posterior"]
        value, median = prior["value"], posterior["median"]
        scale = 100.0 / value if value else 1.0
        low, high, *ends = (
            scale * (one[end] - value) for one in (prior, posterior) for end in ("low", "high")
        )
        panel.barh(line, high - low, left=low, height=0.6, color=style.BAND, zorder=1)
        panel.plot(ends, (line, line), color=style.MODEL, linewidth=1.4, zorder=2)
        panel.plot(scale * (median - value), line, "o", color=style.MODEL, markersize=4.0, zorder=3)
        unit = f" {entry['unit']}" if entry["unit"] else ""
        text = f"{significant(median, 4)}{unit}, learned {max(0.0, 100.0 * entry['learned']):.0f} %"
        panel.text(1.02, line, text, transform=panel.get_yaxis_transform(), va="center")
    panel.axvline(0.0, color=style.NEUTRAL, linewidth=0.6, zorder=0)
    panel.set_ylim(len(parameters) - 0.5, -0.5)
    panel.set_yticks(range(len(parameters)), [in_words(name).capitalize() for name in parameters])
    panel.tick_params(axis="y", length=0.0)
    panel.spines["left"].set_visible(False)
    panel.set_xlabel("From the data sheet's value (%)")
    level = next(iter(parameters.values()))["posterior"]["level"]
    estimated = f"identified: median and {100.0 * level:g} % interval"
    handles = [
        panel.barh(0, 0, color=style.BAND, label="data sheet with its tolerance"),
        panel.errorbar([], [], xerr=[], fmt="o", color=style.MODEL, label=estimated),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=2)
    return figure
