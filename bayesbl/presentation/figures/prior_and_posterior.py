"""What recordings added to a data sheet: prior against posterior, a line for each parameter."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.stored_figure import stored_figure
from bayesbl.presentation.figures.style import BAND, DOUBLE_COLUMN_IN, MODEL, NEUTRAL, new_figure
from bayesbl.presentation.words import significant
from bayesbl.units import in_words

if TYPE_CHECKING:
    from bayesbl.identification.summary import IdentificationAnswer, ParameterSummary

_LINE_IN = 0.3
_LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 1.55, 1.75, 0.35, 0.45


def is_identified(tree: xr.DataTree) -> bool:
    """Whether the result is of an identification."""
    return "identification" in tree.attrs


@stored_figure("Each parameter before and after the recordings.", 100, is_identified)
def prior_and_posterior(tree: xr.DataTree) -> Figure:
    """Per cent from the data sheet's value: its tolerance, and median and interval found."""
    answer: IdentificationAnswer = json.loads(tree.attrs["identification"])
    found = answer["parameters"]
    height = _TOP_IN + _BOTTOM_IN + _LINE_IN * len(found)
    figure = new_figure(DOUBLE_COLUMN_IN, height)
    panel = figure.add_axes(
        (
            _LEFT_IN / DOUBLE_COLUMN_IN,
            _BOTTOM_IN / height,
            1.0 - (_LEFT_IN + _RIGHT_IN) / DOUBLE_COLUMN_IN,
            1.0 - (_TOP_IN + _BOTTOM_IN) / height,
        )
    )
    for line, entry in enumerate(found.values()):
        _draw(panel, line, entry)
    panel.axvline(0.0, color=NEUTRAL, linewidth=0.6, zorder=0)
    panel.set_ylim(len(found) - 0.5, -0.5)
    panel.set_yticks(range(len(found)), [in_words(name).capitalize() for name in found])
    panel.tick_params(axis="y", length=0.0)
    panel.spines["left"].set_visible(False)
    panel.set_xlabel("From the data sheet's value (%)")
    level = next(iter(found.values()))["posterior"]["level"]
    handles = [
        panel.barh(0, 0, color=BAND, label="data sheet with its tolerance"),
        panel.errorbar([], [], xerr=[], fmt="o", color=MODEL, label=_label(level)),
    ]
    figure.legend(handles=handles, loc="upper left", ncols=2)
    return figure


def _label(level: float) -> str:
    return f"found: median and {100.0 * level:g} % interval"


def _draw(panel: Axes, line: int, entry: ParameterSummary) -> None:
    prior, posterior = entry["prior"], entry["posterior"]
    scale = 100.0 / prior["value"] if prior["value"] else 1.0

    def percent(value: float) -> float:
        return scale * (value - prior["value"])

    low, high = percent(prior["low"]), percent(prior["high"])
    panel.barh(line, high - low, left=low, height=0.6, color=BAND, zorder=1)
    ends = (percent(posterior["low"]), percent(posterior["high"]))
    panel.plot(ends, (line, line), color=MODEL, linewidth=1.4, zorder=2)
    panel.plot(percent(posterior["median"]), line, "o", color=MODEL, markersize=4.0, zorder=3)
    unit = f" {entry['unit']}" if entry["unit"] else ""
    learned = max(0.0, 100.0 * entry["learned"])
    panel.text(
        1.02, line, f"{significant(posterior['median'], 4)}{unit}, learned {learned:.0f} %",
        transform=panel.get_yaxis_transform(), va="center",
    )  # fmt: skip
