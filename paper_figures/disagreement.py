"""Where recording and simulation disagree, and how naming the missing effect removes it."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.diagnosis.summary import summarise_diagnosis
from bayesbl.presentation.figures.style import (
    DOUBLE_COLUMN_IN,
    MEASURED,
    NEUTRAL,
    grid,
    head_panels,
    look,
    new_figure,
)
from bayesbl.units import unit_of

RECORDING = "forward"
_CHANNELS = {"motor_speed_rpm": "Motor speed", "motor_current_a": "Motor current"}
_STAGES = {"before": "bench as believed", "after": "with the effect that was named"}


def data(stored: Stored) -> xr.Dataset:
    """Over the load angle: recorded, simulated, residual; and how far each recording closed."""
    tree = stored.tree("hidden_friction")
    residuals = [tree[f"residuals_{s}"].to_dataset().sel(recording=RECORDING) for s in _STAGES]
    columns: dict[str, tuple[object, ...]] = {
        "load_angle_rad": ("angle", residuals[0]["load_angle_rad"].values, "rad")
    }
    for channel in _CHANNELS:
        unit = unit_of(channel)
        columns[f"{channel}_recorded"] = ("angle", residuals[0][f"{channel}_recorded"].values, unit)
        for name in ("simulated", "load_map"):
            both = [stage[f"{channel}_{name}"].values for stage in residuals]
            columns[f"{channel}_{name}"] = (("stage", "angle"), both, unit)
        errors = [float(stage[f"{channel}_map_error"]) for stage in residuals]
        columns[f"{channel}_map_error"] = ("stage", errors, unit)
    summary, rows, labels, held = summarise_diagnosis(tree), [], [], []
    for recording, channels in summary["disagreement"]["recordings"].items():
        for channel, uses in channels.items():
            for use, found in uses.items():
                rms = np.array([found["before"], found["after"]])
                rows.append(rms / found["noise_floor"])
                labels.append(f"{recording}, {_CHANNELS[channel].lower().removeprefix('motor ')}")
                held.append(use == "held_out")
    columns["over_noise"] = (("piece", "stage"), rows, "1")
    columns["held_out"] = ("piece", held, "1")
    effect = summary["effects"][0]
    (torque,) = effect["parameters"].values()
    before, after = summary["delta_rad_before"], summary["delta_rad_after"]
    assert before is not None
    assert after is not None
    gaps = {
        "delta_before_mrad": 1e3 * before["median"],
        "delta_after_mrad": 1e3 * after["median"],
    }
    shown = arrays(**columns).assign_coords(piece=labels, stage=list(_STAGES))
    return shown.assign_attrs(effect=effect["name"], size=torque["median"], **gaps)


def draw(shown: xr.Dataset) -> Figure:
    """A row a channel: overlay and residual; beside them the RMS of every recording."""
    figure = new_figure(DOUBLE_COLUMN_IN, 3.8)
    spec = grid(figure, 2, 3, left=0.62, top=0.55, between=(0.45, 0.62), widths=(1.0, 1.0, 1.0))
    panels, titles = [], []
    for row, (channel, label) in enumerate(_CHANNELS.items()):
        overlay, left = (figure.add_subplot(spec[row, column]) for column in range(2))
        _draw_overlay(overlay, shown, channel)
        _draw_left(left, shown, channel)
        overlay.set_ylabel(f"{label} ({unit_of(channel)})")
        left.set_ylabel(f"Residual ({unit_of(channel)})")
        for panel in (overlay, left):
            panel.set_xticks(np.pi * np.arange(5) / 2.0, ["0", "π/2", "π", "3π/2", "2π"])
            panel.set_xlim(0.0, 2.0 * np.pi)
            panel.yaxis.set_label_coords(-0.21, 0.5)
            if row == 1:
                panel.set_xlabel("Load angle (rad)")
        panels += [overlay, left]
        titles += [label.lower(), "its residual"]
    closed = figure.add_subplot(spec[:, 2])
    box = closed.get_position()
    closed.set_position((box.x0 + 0.075, box.y0, box.width - 0.075, box.height))
    _draw_closed(closed, shown)
    head_panels([*panels, closed], [*titles, "all; * held out"])
    figure.legend(*panels[0].get_legend_handles_labels(), loc="upper left",
                  bbox_to_anchor=(0.01, 1.0), ncols=3)  # fmt: skip
    return figure


def _draw_overlay(panel: Axes, shown: xr.Dataset, channel: str) -> None:
    angle = shown["load_angle_rad"]
    panel.plot(angle, shown[f"{channel}_recorded"], color=MEASURED, linewidth=1.8, label="recorded")
    for index, (stage, label) in enumerate(_STAGES.items()):
        style = look(1 - index)
        panel.plot(
            angle, shown[f"{channel}_simulated"].sel(stage=stage), color=style.colour,
            linestyle=style.dashes, linewidth=0.9, label=label,
        )  # fmt: skip


def _draw_left(panel: Axes, shown: xr.Dataset, channel: str) -> None:
    panel.axhline(0.0, color=NEUTRAL, linewidth=0.6)
    for index, stage in enumerate(_STAGES):
        style, part = look(1 - index), shown.sel(stage=stage)
        mean, error = part[f"{channel}_load_map"], float(part[f"{channel}_map_error"])
        panel.fill_between(
            shown["load_angle_rad"], mean - error, mean + error, color=style.colour, alpha=0.3,
            linewidth=0.0,
        )  # fmt: skip
        panel.plot(
            shown["load_angle_rad"], mean, color=style.colour, linestyle=style.dashes,
            linewidth=0.8,
        )  # fmt: skip


def _draw_closed(panel: Axes, shown: xr.Dataset) -> None:
    rows = np.arange(shown.sizes["piece"])
    panel.axvline(1.0, color=NEUTRAL, linewidth=0.8, linestyle=(0.0, (3.0, 2.0)))
    for row in rows:
        ends = shown["over_noise"].isel(piece=row).values
        panel.plot(ends, [row, row], color="#b4b4b4", linewidth=0.8, zorder=1.0)
    for index, stage in enumerate(_STAGES):
        style = look(1 - index)
        panel.plot(
            shown["over_noise"].sel(stage=stage), rows, color=style.colour, marker=style.marker,
            linestyle="none",
        )  # fmt: skip
    told = [
        f"{name}*" if held else str(name)
        for name, held in zip(shown["piece"].values, shown["held_out"].values, strict=True)
    ]
    panel.set_yticks(rows, told)
    panel.tick_params(axis="y", length=0.0)
    panel.set_ylim(rows[-1] + 0.6, -0.6)
    panel.set_xlim(left=0.5)
    panel.set_xlabel("RMS / noise floor")


def caption(shown: xr.Dataset) -> str:
    """What is seen, with what was named and what it does to δ."""
    before, after = shown["over_noise"].values.T
    held = shown["held_out"].values.astype(bool)
    return (
        f"A virtual joint with load friction that the bench lacks. (a), (c) Recording {RECORDING} "
        "over the load angle, with the simulation by the bench before and after naming the effect "
        f"({shown.attrs['effect'].replace('_', ' ')}, {shown.attrs['size']:.2f} N m); (b), (d) "
        "the residual, averaged over the rotations, with its standard error. (e) RMS difference "
        f"over the noise floor in every recording: {before.min():.1f} to {before.max():.1f} before "
        f"naming, at most {after.max():.2f} after it, {after[held].max():.2f} on the recording "
        f"held out. The gap δ is {shown.attrs['delta_after_mrad']:.3f} mrad with the effect and "
        f"{shown.attrs['delta_before_mrad']:.3f} mrad without."
    )


FIGURE = PaperFigure("disagreement", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
