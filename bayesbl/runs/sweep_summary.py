"""``summary.json`` of a sweep, from the stored result alone."""

from __future__ import annotations

from typing import Literal, TypedDict

import numpy as np
import xarray as xr

from bayesbl.measurement.stored_curve import SOURCE_PREFIX
from bayesbl.results.summary_types import Head, head


class DegreeSummary(TypedDict):
    """How well a polynomial of one degree describes the sweep."""

    rms_departure: float
    largest_departure: float
    log_evidence: float


class SweepSummary(Head):
    """``summary.json`` of a sweep."""

    kind: Literal["sweep"]
    curve: str
    coefficients: list[float]
    degree: int
    gap_rad: list[float]
    amplitude_rpm: list[float]
    largest_correction: float
    relative_sd: dict[str, float]
    largest_departure_from_published: float
    degrees: dict[str, DegreeSummary]


def summarise_sweep(tree: xr.DataTree) -> SweepSummary:
    """``summary.json`` of a sweep."""
    sweep, degrees = tree["sweep"].to_dataset(), tree["degrees"].to_dataset()
    stored = tree["gap_curve"].to_dataset()
    return {
        "kind": "sweep",
        **head(tree),
        "curve": tree["curve"].attrs["name"],
        "coefficients": stored["coefficients"].values.tolist(),
        "degree": int(tree.attrs["degree"]),
        "gap_rad": [float(sweep["gap_rad"][0]), float(sweep["gap_rad"][-1])],
        "amplitude_rpm": [float(stored["knots_rpm"][0]), float(stored["knots_rpm"][-1])],
        "largest_correction": float(np.abs(stored["correction"]).max()),
        "relative_sd": {
            name.removeprefix(SOURCE_PREFIX): float(stored[name].values.std(axis=0).max())
            for name in map(str, stored.data_vars)
            if name.startswith(SOURCE_PREFIX)
        },
        "largest_departure_from_published": float(
            np.abs(sweep["amplitude_over_published"] - 1.0).max()
        ),
        "degrees": {
            str(int(d)): {
                "rms_departure": float(degrees["rms_departure"].sel(degree=d)),
                "largest_departure": float(degrees["largest_departure"].sel(degree=d)),
                "log_evidence": float(degrees["log_evidence"].sel(degree=d)),
            }
            for d in degrees["degree"].values
        },
    }
