"""Figure 3: the model of the disturbance, its symbols as they were fitted to a recording."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.stored_figure import snapshots
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    MEASURED,
    MODEL,
    NEUTRAL,
    grid,
    head_panels,
    new_figure,
)
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.waveform import impact, pulse_train

_DASHED = (0.0, (4.0, 2.0))


def data(stored: Stored) -> xr.Dataset:
    """One pulse with its envelope, the train of pulses, and the fitted symbols as attributes."""
    snapshot = snapshots(stored.tree("wear_swept"))[0]
    symbol = {name: snapshot.number("optimum", name) for name in SYMBOLS}
    amplitude, decay = symbol["amplitude_rpm"], symbol["decay_rate_per_s"]
    frequency, period = symbol["angular_frequency_rad_per_s"], symbol["rotation_period_s"]
    length = symbol["window_end_s"] - symbol["window_start_s"]
    since = np.linspace(-0.15 * length, 1.25 * length, 1500)
    inside = np.where((since >= 0.0) & (since <= length), since, np.nan)
    first = symbol["start_time_s"] + symbol["window_start_s"]
    begin = float(snapshot.time_s[0])
    time = np.arange(begin, first + 1.6 * period, 1e-3)
    pulse = impact(since, decay, frequency, length, since[1] - since[0])
    train = pulse_train(time, symbol, 1e-3)
    found = arrays(
        since_impact_s=("pulse_sample", since, "s"),
        pulse_rpm=("pulse_sample", amplitude * pulse, "rpm"),
        envelope_rpm=("pulse_sample", amplitude * np.exp(-decay * inside), "rpm"),
        time_s=("sample", time, "s"),
        train_rpm=("sample", amplitude * train, "rpm"),
    )
    return found.assign_attrs(**symbol, recording=snapshot.name)


def draw(shown: xr.Dataset) -> Figure:
    """One pulse with A, τ, ω, t1, t2; the train of pulses with t0, T and T_w."""
    symbol = shown.attrs
    figure = new_figure(DOUBLE_COLUMN_IN, 2.3)
    spec = grid(figure, 1, 2, widths=(1.0, 1.4))
    pulse, train = figure.add_subplot(spec[0, 0]), figure.add_subplot(spec[0, 1])
    _draw_pulse(pulse, shown)
    _draw_train(train, shown)
    titles = ["one pulse, eq. 3", f"the model of the recording {symbol['recording']}, eq. 6"]
    head_panels([pulse, train], titles)
    return figure


def _draw_pulse(panel: Axes, shown: xr.Dataset) -> None:
    symbol = shown.attrs
    amplitude, decay = symbol["amplitude_rpm"], symbol["decay_rate_per_s"]
    frequency = symbol["angular_frequency_rad_per_s"]
    length = symbol["window_end_s"] - symbol["window_start_s"]
    since, envelope = 1e3 * shown["since_impact_s"], shown["envelope_rpm"]
    for sign in (-1.0, 1.0):
        panel.plot(since, sign * envelope, color=MEASURED, linewidth=0.7, linestyle=_DASHED)
    panel.plot(since, shown["pulse_rpm"], color=MODEL, linewidth=1.2)
    panel.annotate(
        f"A = {amplitude:.1f} rpm", (0.0, amplitude), (9.0, 0.0), textcoords="offset points",
        va="center", arrowprops={"arrowstyle": "-", "linewidth": 0.5},
    )  # fmt: skip
    panel.plot([0.0], [amplitude], color=NEUTRAL, marker="o", markersize=2.5)
    panel.annotate(
        f"± A e$^{{-τ(t-t_1)}}$\nτ = {decay:.1f} 1/s",
        (1e3 * 0.3 * length, amplitude * np.exp(-0.3 * decay * length)),
        (12.0, 8.0),
        textcoords="offset points",
        arrowprops={"arrowstyle": "-", "linewidth": 0.5},
    )
    _span(
        panel,
        0.0,
        2e3 * np.pi / frequency,
        -1.05 * amplitude,
        f"2π/ω = {2e3 * np.pi / frequency:.0f} ms",
        below=True,
    )
    for at, name, side in ((0.0, "t$_1$ ", "right"), (length, " t$_2$", "left")):
        panel.axvline(1e3 * at, color=NEUTRAL, linewidth=0.5, linestyle=(0.0, (1.0, 1.5)))
        panel.text(1e3 * at, 1.12 * amplitude, name, ha=side, va="top")
    panel.set_ylim(-1.4 * amplitude, 1.15 * amplitude)
    panel.set_xlabel("Time since the impact t − t$_1$ (ms)")
    panel.set_ylabel("Disturbance d$_b$ (rpm)")


def _draw_train(panel: Axes, shown: xr.Dataset) -> None:
    symbol = shown.attrs
    amplitude, period = symbol["amplitude_rpm"], symbol["rotation_period_s"]
    apart = symbol["pulse_separation_s"]
    first = symbol["start_time_s"] + symbol["window_start_s"]
    time = shown["time_s"].values
    panel.plot(time, shown["train_rpm"], color=MODEL, linewidth=0.9)
    _span(panel, first - apart, first, -1.1 * amplitude, f"T = {apart:.2f} s", below=True)
    _span(panel, first, first + period, 1.1 * amplitude, f"T$_w$ = {period:.2f} s")
    panel.annotate(
        "t$_0$ + t$_1$", (first, 0.0), (-6.0, 20.0), textcoords="offset points", ha="right",
        arrowprops={"arrowstyle": "->", "linewidth": 0.6},
    )  # fmt: skip
    panel.set_xlim(time[0], time[-1])
    panel.set_ylim(-1.45 * amplitude, 1.45 * amplitude)
    panel.set_xlabel("Time (s)")
    panel.set_ylabel("Disturbance h − v$_t$ (rpm)")


def _span(
    panel: Axes, start: float, stop: float, height: float, text: str, *, below: bool = False
) -> None:
    """A double arrow between two times, and what it measures."""
    panel.annotate(
        "", (stop, height), (start, height),
        arrowprops={"arrowstyle": "<->", "linewidth": 0.6, "shrinkA": 0.0, "shrinkB": 0.0},
    )  # fmt: skip
    panel.annotate(
        text, (0.5 * (start + stop), height), (0.0, -3.0 if below else 3.0),
        textcoords="offset points", ha="center", va="top" if below else "bottom",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
    )  # fmt: skip


def caption(shown: xr.Dataset) -> str:
    """What is seen, with the fitted symbols."""
    symbol = shown.attrs
    return (
        "The model of the disturbance with its symbols as fitted to the recording "
        f"{symbol['recording']}. (a) One pulse (eq. 3): amplitude A = "
        f"{symbol['amplitude_rpm']:.1f} rpm, decay τ = {symbol['decay_rate_per_s']:.1f} 1/s, "
        f"angular frequency ω = {symbol['angular_frequency_rad_per_s']:.1f} rad/s, in the window "
        f"from t1 = {symbol['window_start_s']:g} to t2 = {symbol['window_end_s']:g} s; dashed its "
        "envelope. (b) The train of pulses (eq. 6): in each load rotation, T_w = "
        f"{symbol['rotation_period_s']:.3f} s, a negative pulse and, T = "
        f"{symbol['pulse_separation_s']:.3f} s later, a positive one."
    )


FIGURE = PaperFigure("figure_3", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
