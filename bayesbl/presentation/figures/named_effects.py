"""Posterior of what a diagnosis named, and of the gap with it added."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesbl.presentation.figures.layout import one_panel_each
from bayesbl.presentation.figures.panels import density
from bayesbl.presentation.figures.snapshots import GAP, credible_interval, interval_name
from bayesbl.presentation.figures.stored_figure import stored_figure
from bayesbl.presentation.figures.style import MODEL, NEUTRAL, head_panels
from bayesbl.presentation.words import significant
from bayesbl.recording.types import FloatArray
from bayesbl.units import in_words

if TYPE_CHECKING:
    from bayesbl.diagnosis.summary import Answer

_BINS = 25
_BELIEVED = "#d55e00"


def has_sizes(tree: xr.DataTree) -> bool:
    """Whether anything but phases and start angles was sampled."""
    if "posterior" not in tree.children or "diagnosis" not in tree.attrs:
        return False
    answer: Answer = json.loads(tree.attrs["diagnosis"])
    return any(_is_size(str(name), answer) for name in tree["posterior"].data_vars)


@stored_figure("The posterior of the gap and of what was named.", 100, has_sizes, name="named")
def named_effects(tree: xr.DataTree) -> Figure:
    """A panel for δ and one for each size that was named, with its value before.

    Phases and start angles, another in every recording, are left out.
    """
    posterior = tree["posterior"].to_dataset()
    answer: Answer = json.loads(tree.attrs["diagnosis"])
    shown = [name for name in map(str, posterior) if _is_size(name, answer)]
    figure, axes = one_panel_each(len(shown), height_in=1.9, shared=False, above=0.2)
    values = [
        _draw(panel, tree, posterior[name], _believed(name, answer))
        for panel, name in zip(axes, shown, strict=True)
    ]
    head_panels(axes, values)
    lines = [line for panel in axes for line in panel.lines]
    by_label = {
        line.get_label(): line for line in lines if not str(line.get_label()).startswith("_")
    }
    figure.legend(handles=list(by_label.values()), loc="upper left", ncols=2)
    return figure


def _is_size(name: str, answer: Answer) -> bool:
    if name == GAP:
        return True
    errors = [error["name"] for error in answer["parameter_errors"]]
    return name in errors or ("__" in name and "__phase_rad" not in name)


def _believed(name: str, answer: Answer) -> float | None:
    """The value that the bench as believed has."""
    if name == GAP:
        before = answer["delta_rad_before"]
        return None if before is None else before["median"]
    for error in answer["parameter_errors"]:
        if error["name"] == name:
            return error["believed"]
    return None


def _draw(
    panel: Axes,
    tree: xr.DataTree,
    variable: xr.DataArray,
    believed: float | None,
) -> str:
    """Draw, and say the values."""
    factor, unit = (1e3, "mrad") if variable.name == GAP else (1.0, str(variable.attrs["units"]))
    draws: FloatArray = factor * np.asarray(variable.values, dtype=float).ravel()
    found = credible_interval(tree, draws)
    counts, edges = density(panel, draws, MODEL, bins=_BINS)
    for end in ("low", "median", "high"):
        panel.axvline(
            found[end], color=NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)),
            label=f"posterior: median and {interval_name(tree)}",
        )  # fmt: skip
    if believed is not None:
        _draw_believed(panel, factor * believed, edges)
    panel.set_ylim(0.0, 1.1 * counts.max())
    quantity = _quantity(str(variable.name))
    panel.set_xlabel(quantity if unit == "1" else f"{quantity} ({unit})")
    panel.set_ylabel("Density")
    panel.set_yticks([])
    panel.locator_params(axis="x", nbins=5)
    ending = "" if unit == "1" else f" {unit}"
    low, middle, high = (significant(found[end], 4) for end in ("low", "median", "high"))
    values = f"{middle}{ending} ({low} to {high})"
    if believed is None:
        return values
    return f"{values}, before {significant(factor * believed, 4)}{ending}"


def _draw_believed(panel: Axes, value: float, edges: FloatArray) -> None:
    """A line, or an arrow to where it would be beyond the panel."""
    if edges[0] < value < edges[-1]:
        panel.axvline(value, color=_BELIEVED, linewidth=1.0, label="before: as in the bench file")
        return
    left = value <= edges[0]
    panel.annotate(
        "← before" if left else "before →",
        (0.02 if left else 0.98, 0.9), xycoords="axes fraction", ha="left" if left else "right",
        color=_BELIEVED,
    )  # fmt: skip


def _quantity(name: str) -> str:
    """``Gap δ``, ``Shaft stiffness``, ``Load Coulomb friction: torque``."""
    if name == GAP:
        return "Gap δ"
    words = ": ".join(map(in_words, name.split("__")))
    return words[0].upper() + words[1:]
