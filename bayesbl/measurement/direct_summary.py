"""``summary.json`` of a snapshot that was measured by the direct route."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayesbl.measurement.other_route import summarised_routes
from bayesbl.measurement.shared_groups import DELTA
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import (
    MotionSummary,
    NoiseSummary,
    PredictiveCheckEntry,
    SnapshotSummary,
)


def summarise_direct(stored: StoredSnapshot) -> SnapshotSummary:
    """The contract's keys, and beside them the bound and the predictive check."""
    routes = summarised_routes(stored)
    amplitude = routes["amplitude"].get("amplitude_rpm") if "amplitude" in routes else None
    posterior, optimum = stored.groups["posterior"], stored.groups["optimum"]
    # What is free in another recording alone has no value in this one.
    names = [str(n) for n in optimum["parameter"].values if np.isfinite(float(optimum[str(n)]))]
    found: SnapshotSummary = {
        "route": "direct",
        "routes": routes,
        "delta_rad": stored.delta_rad,
        "amplitude_rpm": amplitude,
        "parameters": {n: stored.interval("posterior", n) for n in names if n != DELTA.name},
        "optimum": {n: float(optimum[n]) for n in names},
        "cramer_rao_sd": {n: float(optimum["cramer_rao_sd"].sel(parameter=n)) for n in names},
        "posterior_sd": {n: float(posterior[n].std()) for n in names},
        "noise": _noise(stored.groups["noise"]),
        "predictive_check": _check(stored.groups["predictive_check"]),
        "rotations": stored.number("diagnostics", "rotations"),
        "excluded_samples": stored.excluded_samples,
        "budget": stored.budget,
        "diagnostics": {
            **stored.diagnostics,
            "effective_after_simulation": stored.number("diagnostics", "effective"),
            "simulated_draws": int(stored.number("diagnostics", "simulated")),
            "surrogate_refits": int(stored.number("diagnostics", "refits")),
        },
        "reason": stored.reason,
        "model_check": stored.model_check,
    }
    if "flank_changes" in stored.groups["predictive"]:
        found["motion"] = _motion(stored)
    return found


def _motion(stored: StoredSnapshot) -> MotionSummary:
    repeats = stored.number("predictive", "repeats") > 0.0
    return {
        "cycle_s": stored.number("predictive", "rotation_period_s") if repeats else None,
        "cycles": stored.number("diagnostics", "rotations") if repeats else None,
        "flank_changes": round(stored.number("predictive", "flank_changes")),
        "compared_from_s": stored.number("predictive", "compared_from_s"),
    }


def _noise(group: xr.Dataset) -> NoiseSummary:
    order = int(group["order"])
    present = np.isfinite(group["sd"].values)
    sd = group["sd"].values[present].tolist()
    coefficients = group["coefficients"].values[:order][:, present][:, :, present]
    return {
        "kind": "ar" if order else "white",
        "order": order,
        "sd_rpm": sd[0],
        "sd_a": sd[1] if len(sd) > 1 else None,
        "coefficients": coefficients.tolist(),
        "degrees_of_freedom": None,
    }


def _check(group: xr.Dataset) -> list[PredictiveCheckEntry]:
    """One entry per channel and band of load orders."""
    return [
        {
            "channel": str(channel),
            "highest_order": int(order),
            "ratio": float(group["ratio"].values[i, j]),
            "probability": float(group["probability"].values[i, j]),
        }
        for i, channel in enumerate(group["channel"].values)
        for j, order in enumerate(group["highest_order"].values)
        if np.isfinite(group["ratio"].values[i, j])
    ]
