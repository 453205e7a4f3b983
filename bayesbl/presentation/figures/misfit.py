"""What repeats every load rotation and the waveform does not capture."""

from __future__ import annotations

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures import layout, panels, style
from bayesbl.presentation.figures.snapshots import Snapshot, snapshots
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.ringing.symbols import ROTATION, SEPARATION, START, WINDOW_END, WINDOW_START


@stored_figure(
    "What repeats every rotation and the model does not describe, a panel a snapshot; grey: the "
    "windows of its pulses, by their signs.",
    110,
    holding("misfit/mean_rpm"),
)
def misfit(tree: xr.DataTree) -> Figure:
    """Rotation-averaged residual against load phase, ± one standard error, a panel a snapshot."""
    parts = snapshots(tree, "misfit/mean_rpm")
    figure, axes = layout.one_panel_each(len(parts), above=layout.LINE_IN)
    for index, (panel, snapshot) in enumerate(zip(axes, parts, strict=True)):
        _draw(panel, snapshot, style.look(index).colour)
    axes[0].set_ylabel("Repeating residual (rpm)")
    style.head_panels(
        axes, [f"{s.name}: {s.number('misfit', 'rms_rpm'):.2f} rpm RMS" for s in parts]
    )
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=3, columnspacing=1.0)
    return figure


def _draw(panel: Axes, snapshot: Snapshot, colour: str) -> None:
    phase = snapshot.values("misfit", "phase_rad")
    mean = snapshot.values("misfit", "mean_rpm")
    error = snapshot.values("misfit", "standard_error_rpm")
    for first, width, sign in _pulses(snapshot):
        for turn in (0.0, -panels.TURN):
            panel.axvspan(
                first + turn,
                first + turn + width,
                color="#e6e6e6",
                linewidth=0.0,
                label="window of a pulse" if sign == "+" and not turn else None,
            )
        panel.annotate(
            sign,
            ((first + 0.5 * width) % panels.TURN, 0.97),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
        )
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.fill_between(
        phase,
        mean - error,
        mean + error,
        color=colour,
        alpha=0.35,
        linewidth=0.0,
        label="± 1 standard error",
    )
    panel.plot(phase, mean, color=colour, linewidth=0.8, label="mean over rotations")
    panels.rotation_axis(panel, "Load phase since the start of the recording (rad)")
    panel.margins(y=0.18)


def _pulses(snapshot: Snapshot) -> list[tuple[float, float, str]]:
    """(first phase in [0, 2π), width in rad, sign) of the two pulses in a rotation."""
    begin = snapshot.time_s[0]
    period = snapshot.number("optimum", ROTATION)
    start = snapshot.number("optimum", START) + snapshot.number("optimum", WINDOW_START)
    length = snapshot.number("optimum", WINDOW_END) - snapshot.number("optimum", WINDOW_START)
    apart = snapshot.number("optimum", SEPARATION)
    return [
        (panels.TURN * (((at - begin) / period) % 1.0), panels.TURN * length / period, sign)
        for at, sign in ((start, "+"), (start - apart, "−"))
    ]
