"""Figure 9: the two recordings with the fitted model."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.presentation.figures.ringing import signal
from bayesbl.presentation.figures.stored_figure import interval_name, snapshots
from bayesbl.ringing.symbols import SYMBOLS


def data(stored: Stored) -> xr.DataTree:
    """Recorded speed, model at the optimum, predictive band and residual of each snapshot."""
    return picked(
        stored.tree("wear_swept"),
        observed_data=("motor_speed_rpm",),
        constant_data=("time_s",),
        predictive=None,
        optimum=SYMBOLS,
        posterior=(),
        diagnostics=(),
    )


def caption(tree: xr.DataTree) -> str:
    """What is seen, with the RMS of the residuals."""
    parts = snapshots(tree)
    left = " and ".join(
        f"{np.sqrt(np.nanmean(s.values('predictive', 'residual_rpm') ** 2)):.2f} rpm ({s.name})"
        for s in parts
    )
    return (
        "Motor speed of the two example recordings (grey), the disturbance model at its optimum "
        f"(blue) and its {interval_name(tree).replace('interval', 'predictive band')}: the whole "
        "recording as the outline of its samples, and one positive and one negative pulse sample "
        f"by sample; below each the residual, {left} RMS."
    )


FIGURE = PaperFigure("figure_9", data, signal, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
