"""Figure 6: recorded and simulated position, speed and current laid over each other.

The bench is the one that was swept, the gap the median of the stored posterior. The only
unknown is the load's angle at the first sample. Least squares finds it, first from the current
alone to within a few degrees, as its error has one minimum, then from speed and current together.
The example recordings were made by this bench, so they agree up to noise; a real joint would not.
"""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import minimize_scalar

from bayesbl.bench.bench import Bench
from bayesbl.errors import ResultError
from bayesbl.measurement.stored import Snapshot
from bayesbl.presentation.figures.stored_figure import snapshots
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    GAP,
    MODEL,
    grid,
    head_panels,
    new_figure,
)
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S, unit_of

_CHANNELS = {
    MOTOR_POSITION: "Position − ω$_{ref}$ t (rad)",
    MOTOR_SPEED: "Speed (rpm)",
    MOTOR_CURRENT: "Current (A)",
}
_ANGLES = 24
_LIGHT = "#b4b4b4"
_REFERENCE = "reference_speed_rpm"


def data(stored: Stored) -> xr.DataTree:
    """A node for each recording: one load rotation of each channel, recorded and simulated."""
    return xr.DataTree.from_dict(
        {s.name: _rotation(stored.bench, s) for s in snapshots(stored.tree("wear_swept"))}
    )


def _rotation(bench: Bench, snapshot: Snapshot) -> xr.Dataset:
    time, recorded = recorded_channels(snapshot)
    gap = float(np.median(snapshot.values("posterior", GAP)))
    simulated = simulated_like(bench, gap, time, recorded)
    length = min(simulated.time_s.size, time.size)
    columns: dict[str, tuple[object, ...]] = {"time_s": ("sample", time[:length], "s")}
    turned = simulated.metadata[_REFERENCE] / RPM_PER_RAD_PER_S * time[:length]
    for channel in _CHANNELS:
        for kind, values in (("recorded", recorded), ("simulated", simulated.channels)):
            shown = values[channel][:length]
            if channel == MOTOR_POSITION:
                shown = shown - shown[0] - turned
            columns[f"{kind}_{channel}"] = ("sample", shown, unit_of(channel))
    return arrays(**columns).assign_attrs(gap_rad=gap)


def draw(shown: xr.DataTree) -> Figure:
    """A column a recording, one load rotation of each channel."""
    parts = {name: node.to_dataset() for name, node in shown.children.items()}
    figure = new_figure(DOUBLE_COLUMN_IN, 4.4)
    spec = grid(figure, 3, len(parts), left=0.62, top=0.45, between=(0.12, 0.45))
    heads, titles = [], []
    for column, (name, part) in enumerate(parts.items()):
        for row, channel in enumerate(_CHANNELS):
            panel = figure.add_subplot(spec[row, column])
            _draw_channel(panel, channel, part)
            panel.tick_params(labelbottom=row == 2)
            if column == 0:
                panel.set_ylabel(_CHANNELS[channel])
                panel.yaxis.set_label_coords(-0.14, 0.5)
            if row == 0:
                heads.append(panel)
                titles.append(f"{name}, δ = {1e3 * part.attrs['gap_rad']:.3f} mrad")
        panel.set_xlabel("Time (s)")
    head_panels(heads, titles)
    figure.legend(*heads[0].get_legend_handles_labels(), loc="upper center", ncols=2)
    return figure


def caption(shown: xr.DataTree) -> str:
    """What is seen, with the residuals of recording and simulation."""
    left = "; ".join(
        f"{name}: "
        + ", ".join(
            f"{float(np.std(part[f'recorded_{c}'] - part[f'simulated_{c}'])):.2g} {unit_of(c)}"
            for c in (MOTOR_SPEED, MOTOR_CURRENT)
        )
        for name, part in shown.children.items()
    )
    return (
        "One load rotation of the two example recordings (grey) and of the virtual bench at the "
        "gap that was found (blue): motor position less that of the reference speed, motor speed, "
        "motor current. Only the start angle was fitted. Standard deviation of the residuals "
        f"of speed and current, which are the recordings' noise: {left}."
    )


def recorded_channels(snapshot: Snapshot) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Time since the first sample in s, and the three recorded channels, each (n,)."""
    lacking = [
        name
        for name in _CHANNELS
        if not any(name in snapshot.group(g) for g in ("observed_data", "constant_data"))
    ]
    if lacking:
        raise ResultError(
            f"The stored recording {snapshot.name} lacks channels.",
            found=f"no {', '.join(lacking)}",
            expected=", ".join(_CHANNELS),
        )
    time = snapshot.time_s
    return time - time[0], {n: snapshot.channel(n) for n in _CHANNELS}


def simulated_like(
    bench: Bench, gap: float, time: FloatArray, recorded: dict[str, FloatArray]
) -> Recording:
    """One load rotation, noise-free, that begins where the recording does."""
    rate = (time.size - 1) / time[-1]
    reference = float(np.sign(recorded[MOTOR_SPEED].mean()) * abs(bench.value(_REFERENCE)))

    def simulate(angle: float) -> Recording:
        return bench.simulate(
            gap,
            rotations=1.0,
            sampling_hz=rate,
            start_angle_rad=angle,
            reference_speed_rpm=reference,
        )

    def apart(angle: float, *names: str) -> float:
        """Mean squared departure over the variance, summed over channels."""
        made = simulate(angle).channels
        pairs = [(made[n], recorded[n][: made[n].size]) for n in names]
        return sum(float(np.mean((m[: r.size] - r) ** 2) / np.var(r)) for m, r in pairs)

    step = 2.0 * np.pi / _ANGLES
    coarse = min(step * np.arange(_ANGLES), key=lambda angle: apart(angle, MOTOR_CURRENT))
    both = (MOTOR_SPEED, MOTOR_CURRENT)
    # Impacts are sharp: the grid must be finer than a fraction of the ringing.
    near = coarse + step * np.linspace(-1.0, 1.0, 4 * _ANGLES + 1)
    close, fine = min(near, key=lambda angle: apart(angle, *both)), near[1] - near[0]
    bounds = (close - fine, close + fine)
    found = minimize_scalar(lambda angle: apart(angle, *both), bounds=bounds, method="bounded")
    return simulate(float(found.x))


def _draw_channel(panel: Axes, channel: str, part: xr.Dataset) -> None:
    # Where there is little noise, a thin line would vanish under the simulated one.
    thick = 0.6 if channel == MOTOR_SPEED else 2.6
    time = part["time_s"].values
    for kind, colour, width in (("recorded", _LIGHT, thick), ("simulated", MODEL, 0.9)):
        panel.plot(time, part[f"{kind}_{channel}"], color=colour, linewidth=width, label=kind)
    panel.set_xlim(0.0, time[-1])
    panel.locator_params(axis="y", nbins=5)


FIGURE = PaperFigure("figure_6", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
