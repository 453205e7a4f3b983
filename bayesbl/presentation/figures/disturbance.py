"""How the disturbance changes as the gap grows (the paper's figure 7)."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import values
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import DECAY, FREQUENCY


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
    spec = layout.grid(figure, 1, 3, top=0.5, between=(0.0, 0.25), widths=(1.5, 1.0, 1.0))
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
        _mark(whole, time, time[peak] + begin, length)
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


def _mark(whole: Axes, time: FloatArray, begin: float, length: float) -> None:
    """Where a pulse's view lies in the rotation, in two parts if it runs over the end."""
    period = time[-1] - time[0]
    for turn in (-period, 0.0, period):
        start, stop = max(begin + turn, time[0]), min(begin + turn + length, time[-1])
        if start < stop:
            panels.shade(whole, start, stop)


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
