"""A torque of no known law, over what it depends on."""

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
    from bayesbl.diagnosis.summary import Answer

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
    figure = style.new_figure(style.SINGLE_COLUMN_IN, 2.0)
    panel = figure.add_subplot(grid(figure, 1, 1, left=0.75, top=0.15)[0, 0])
    x = stored["variable"].values * _SCALES.get(told["variable"], 1.0)
    torque, reach = stored["torque_nm"].values, LEVEL_SD * stored["sd_nm"].values
    panel.fill_between(x, torque - reach, torque + reach, color=style.BAND, linewidth=0.0)
    panel.plot(x, torque, color=style.MODEL)
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.5)
    panel.set_xlim(x[0], x[-1])
    if told["variable"] == "load_angle":
        panel.set_xticks([-180.0, -90.0, 0.0, 90.0, 180.0])
    panel.set_xlabel(_LABELS[told["variable"]])
    panel.set_ylabel(f"Learned torque\nat the {told['side']} (N m)")
    return figure
