"""A torque of no known law, or an error of the encoder, over what it depends on."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

import xarray as xr
from matplotlib.figure import Figure

from bayesbl.presentation.figures import style
from bayesbl.presentation.figures.layout import grid
from bayesbl.presentation.figures.stored_figure import holding, stored_figure

if TYPE_CHECKING:
    from bayesbl.diagnosis.summary import Answer, LearnedSummary
    from bayesbl.recording.types import FloatArray

LEVEL_SD = 1.645
"""Half-width of a 90 % interval in standard deviations."""

_LABELS = {
    "motor_angle": "Motor angle from the first recording's start (turns)",
    "load_angle": "Load angle (°), 0 hangs down",
    "motor_speed": "Motor speed (rad/s)",
    "time": "Time from the start of the first recording (s)",
}
_SCALES = {"motor_angle": 0.5 / math.pi, "load_angle": 180.0 / math.pi}


@stored_figure(
    "The torque that was learned where no effect of the catalogue explains what repeats.",
    95,
    holding("learned_torque"),
    name="learned_torque",
)
def learned_course(tree: xr.DataTree) -> Figure:
    """Its course forwards with a 90 % band."""
    stored = tree["learned_torque"].to_dataset()
    answer: Answer = json.loads(tree.attrs["diagnosis"])
    told = answer["learned_torque"]
    label = f"Learned torque\nat the {told['side']} (N m)"
    return _course(stored, told, stored["torque_nm"].values, stored["sd_nm"].values, label)


@stored_figure(
    "The error of the motor's encoder that was learned: what it shows less the true angle.",
    95,
    holding("encoder_error"),
    name="encoder_error",
)
def encoder_course(tree: xr.DataTree) -> Figure:
    """It over a turn of the motor with a 90 % band."""
    stored = tree["encoder_error"].to_dataset()
    answer: Answer = json.loads(tree.attrs["diagnosis"])
    error, sd = (1e3 * stored[name].values for name in ("angle_rad", "sd_rad"))
    return _course(stored, answer["encoder_error"], error, sd, "Error of the\nencoder (mrad)")


def _course(
    stored: xr.Dataset, told: LearnedSummary, value: FloatArray, sd: FloatArray, label: str
) -> Figure:
    figure = style.new_figure(style.SINGLE_COLUMN_IN, 2.0)
    panel = figure.add_subplot(grid(figure, 1, 1, left=0.75, top=0.15)[0, 0])
    x = stored["variable"].values * _SCALES.get(told["variable"], 1.0)
    reach = LEVEL_SD * sd
    panel.fill_between(x, value - reach, value + reach, color=style.BAND, linewidth=0.0)
    panel.plot(x, value, color=style.MODEL)
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.5)
    panel.set_xlim(x[0], x[-1])
    if told["variable"] == "load_angle":
        panel.set_xticks([-180.0, -90.0, 0.0, 90.0, 180.0])
    panel.set_xlabel(_LABELS[told["variable"]])
    panel.set_ylabel(label)
    return figure
