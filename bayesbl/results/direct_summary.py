"""``summary.json`` of a snapshot that was measured by the direct route."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import IntervalKind, interval

DELTA, AMPLITUDE = "delta_rad", "amplitude_rpm"


def direct_snapshot(
    groups: dict[str, xr.Dataset],
    verdict: dict[str, Any],
    amplitude_reason: str | None,
    curve: str,
    level: float,
    kind: IntervalKind,
) -> dict[str, Any]:
    """The contract's keys, and beside them the bound, the predictive check and the other route."""
    posterior, optimum = groups["posterior"], groups["optimum"]
    diagnostics, gap = groups["diagnostics"], groups["gap"]
    beside = _beside(groups["amplitude_route"], amplitude_reason, curve, level, kind)
    names = [str(n) for n in optimum["parameter"].values]
    withheld = bool(verdict["reason"])
    return {
        "route": "direct",
        DELTA: None if withheld else interval(posterior[DELTA].values, level, kind),
        AMPLITUDE: beside[AMPLITUDE],
        "parameters": {n: interval(posterior[n].values, level, kind) for n in names if n != DELTA},
        "optimum": {n: float(optimum[n]) for n in names},
        "cramer_rao_sd": dict(zip(names, optimum["cramer_rao_sd"].values.tolist(), strict=True)),
        "posterior_sd": {n: float(posterior[n].std()) for n in names},
        "noise": _noise(groups["noise"]),
        "predictive_check": _check(groups["predictive_check"]),
        "amplitude_route": beside,
        "rotations": float(diagnostics["rotations"]),
        "excluded_samples": int(np.nansum(groups["observed_data"]["excluded"].values)),
        "budget": {
            str(source): float(share)
            for source, share in zip(gap["source"].data, gap["budget"].data, strict=True)
        },
        "diagnostics": {
            "r_hat": float(diagnostics["r_hat"].max()),
            "ess_bulk": float(diagnostics["ess_bulk"].min()),
            "effective_after_simulation": float(diagnostics["effective"]),
            "simulated_draws": int(diagnostics["simulated"]),
            "surrogate_refits": int(diagnostics["refits"]),
            "outcome": verdict["outcome"],
            "reasons": verdict["reasons"],
        },
        "reason": verdict["reason"],
    }


def amplitude_reasons(tree: xr.DataTree) -> dict[str, str | None]:
    """Why the amplitude route has no answer, by snapshot (``fit`` for a fit)."""
    found: dict[str, str | None] = json.loads(tree["amplitude_route"].attrs["reasons"])
    return found


def _beside(
    group: xr.Dataset, reason: str | None, curve: str, level: float, kind: IntervalKind
) -> dict[str, Any]:
    def described(name: str) -> dict[str, Any] | None:
        draws: FloatArray = group[name].values
        draws = draws[np.isfinite(draws)]
        return interval(draws, level, kind) if draws.size else None

    return {
        "curve": curve,
        DELTA: None if reason else described(DELTA),
        AMPLITUDE: described(AMPLITUDE),
        "reason": reason,
    }


def _noise(group: xr.Dataset) -> dict[str, Any]:
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


def _check(group: xr.Dataset) -> list[dict[str, Any]]:
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
