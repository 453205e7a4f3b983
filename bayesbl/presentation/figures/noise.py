"""The evidence for the noise model: what does not repeat from one rotation to the next."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from bayesbl.noise.autoregression import autocorrelation
from bayesbl.noise.rotation_noise import rotation_difference
from bayesbl.presentation.figures import layout, style
from bayesbl.presentation.figures.snapshots import Snapshot, snapshots
from bayesbl.presentation.figures.stored_figure import holding, stored_figure
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import ROTATION

_FEWEST_LAGS, _MOST_LAGS = 20, 300


@stored_figure(
    "What does not repeat from one rotation to the next, and its noise model.",
    120,
    holding("noise/bic"),
    for_specialists=True,
)
def noise(tree: xr.DataTree) -> Figure:
    """Per snapshot: BIC by autoregressive order, and the autocorrelation it leads to."""
    parts = snapshots(tree, "noise/bic")
    figure = style.new_figure(style.DOUBLE_COLUMN_IN, 0.2 + 2.1 * len(parts))
    spec = layout.grid(figure, len(parts), 2, between=(0.7, 0.6))
    axes: list[Axes] = []
    titles: list[str] = []
    for row, snapshot in enumerate(parts):
        left, right = figure.add_subplot(spec[row, 0]), figure.add_subplot(spec[row, 1])
        _draw_bic(left, snapshot, style.look(row).colour)
        _draw_autocorrelation(right, snapshot, style.look(row).colour)
        axes += [left, right]
        titles += [f"{snapshot.name}", f"{snapshot.name}"]
    style.head_panels(axes, titles)
    return figure


def _draw_bic(panel: Axes, snapshot: Snapshot, colour: str) -> None:
    bic = snapshot.values("noise", "bic")
    order = int(snapshot.number("noise", "order"))
    panel.plot(bic, color=style.MEASURED, marker="o", linewidth=0.7, markersize=3.0, label="BIC")
    if order < bic.size:
        panel.plot(
            [order], [bic[order]], color=colour, marker="s", linestyle="none", markersize=5.0,
            label=f"order used: {order}",
        )  # fmt: skip
    panel.set_yscale("symlog", linthresh=10.0)
    panel.yaxis.set_minor_locator(NullLocator())
    panel.set_ylim(bottom=-2.0)
    panel.set_xlabel("Autoregressive order")
    panel.set_ylabel("BIC above its smallest")
    style.legend_above(panel)


def _draw_autocorrelation(panel: Axes, snapshot: Snapshot, colour: str) -> None:
    time = snapshot.time_s
    period = float(time[-1] - time[0]) / (time.size - 1)
    difference = rotation_difference(
        snapshot.values("predictive", "residual_rpm"), snapshot.number("optimum", ROTATION), period
    )
    differentiated = bool(snapshot.number("noise", "differentiated"))
    model = autocorrelation(
        _coefficients(snapshot), min(_MOST_LAGS, difference.size // 4), differentiated
    )
    lags = min(model.size, max(_FEWEST_LAGS, 2 * int(np.sum(np.abs(model) > 0.05))))
    shown = 1e3 * period * np.arange(lags)
    panel.axhline(0.0, color=style.NEUTRAL, linewidth=0.6)
    panel.vlines(
        shown, 0.0, sample_autocorrelation(difference, lags), color=style.MEASURED, linewidth=1.0
    )
    panel.plot(
        shown,
        sample_autocorrelation(difference, lags),
        color=style.MEASURED,
        marker="o",
        markersize=2.5,
        linestyle="none",
        label="rotation to rotation",
    )
    kind = f"AR({_coefficients(snapshot).size})" if _coefficients(snapshot).size else "white noise"
    kind = f"differentiated {kind}" if differentiated else kind
    sd = snapshot.number("noise", "sd_rpm")
    panel.plot(shown, model[:lags], color=colour, label=f"{kind}, sd {sd:.2f} rpm")
    panel.set_xlabel("Lag (ms)")
    panel.set_ylabel("Autocorrelation")
    style.legend_above(panel)


def _coefficients(snapshot: Snapshot) -> FloatArray:
    order = int(snapshot.number("noise", "order"))
    return snapshot.values("noise", "coefficients")[:order]


def sample_autocorrelation(values: FloatArray, lags: int) -> FloatArray:
    """Autocorrelation of a series with mean zero at lags 0 … lags − 1, shape (lags,).

    Values that are NaN are left out.
    """
    products, pairs = (
        np.fft.irfft(np.abs(np.fft.rfft(series, 2 * series.size)) ** 2)[:lags]
        for series in (np.nan_to_num(values), np.isfinite(values).astype(float))
    )
    # As for a whole series, each lag is divided by the same number of pairs, less those left out.
    share = pairs / (values.size - np.arange(lags))
    return np.asarray(products / share / (products[0] / share[0]))
