"""Figure 8: the gap curve of the sweep, with eq. 4 beside it."""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, main, picked

from bayesbl.curve.gap_curve import published_curve
from bayesbl.presentation.figures.sweep import curve, departures_from_curve


def data(stored: Stored) -> xr.DataTree:
    """The sweep's points, the curve through them with its band, and the sources of the band."""
    return picked(
        stored.tree("sweep"),
        sweep=("gap_rad", "amplitude_rpm"),
        curve=(
            "delta_rad",
            "low_rad",
            "high_rad",
            "coefficients",
            "knots_rpm",
            "correction",
            "start_angle_sd_rpm",
            "source_regression",
            "source_lack_of_fit",
        ),
    )


def caption(tree: xr.DataTree) -> str:
    """What is seen, and how far curve, points and eq. 4 are apart."""
    group = tree["curve"].to_dataset()
    amplitude, eq4 = group["amplitude"].values, published_curve(draws=1)
    inside = eq4.outside(amplitude) == 0.0
    apart = 100.0 * (eq4.gap(amplitude[inside]) / group["delta_rad"].values[inside] - 1.0)
    return (
        "(a) Gap δ against amplitude A of the ringing: the sweep of the virtual bench, the cubic "
        "through it with its smooth lack of fit, and eq. 4 of the paper. (b) Eq. 4 over the "
        f"sweep's curve: {apart.min():.1f} to {apart.max():+.1f} % in δ. (c) The sweep's points "
        "over the curve, at most "
        f"{np.abs(departures_from_curve(tree)).max():.2f} % away; the cubic alone; what the start "
        f"angle scatters; {100.0 * float(group.attrs['level']):g} % bands of the curve's sources."
    )


FIGURE = PaperFigure("figure_8", data, curve, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
