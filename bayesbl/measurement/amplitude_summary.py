"""``summary.json`` of a snapshot that was measured by the amplitude of its ringing."""

from __future__ import annotations

import numpy as np
import xarray as xr

from bayesbl.measurement.other_route import summarised_routes
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import (
    NoiseSummary,
    SamplerCheckSummary,
    SnapshotSummary,
)
from bayesbl.ringing.symbols import AMPLITUDE, SYMBOLS


def summarise_amplitude(stored: StoredSnapshot) -> SnapshotSummary:
    """The contract's keys, and beside them the misfit, the start and the second sampler."""
    posterior, optimum = stored.groups["posterior"], stored.groups["optimum"]
    result: SnapshotSummary = {
        "route": "amplitude",
        "routes": summarised_routes(stored),
        "delta_rad": stored.delta_rad,
        "amplitude_rpm": stored.interval("posterior", AMPLITUDE),
        "parameters": {s: stored.interval("posterior", s) for s in SYMBOLS if s in posterior},
        "optimum": {name: float(optimum[name]) for name in (*SYMBOLS, "rmse_rpm")},
        "noise": _noise(stored.groups["noise"]),
        "misfit_rms_rpm": stored.number("misfit", "rms_rpm"),
        "rotations": stored.number("diagnostics", "rotations"),
        "excluded_samples": stored.excluded_samples,
        "budget": stored.budget,
        "diagnostics": stored.diagnostics,
        "reason": stored.reason,
        "model_check": stored.model_check,
    }
    start = str(optimum["start"].item()) if "start" in optimum else ""
    if start:
        result["start"] = start
    if "box_search" in stored.groups:
        box = stored.groups["box_search"]
        result["box_search"] = {str(name): float(box[name]) for name in box.data_vars}
    if "sampler_check" in stored.groups:
        result["sampler_check"] = _sampler_check(stored.groups["sampler_check"])
    return result


def _noise(noise: xr.Dataset) -> NoiseSummary:
    order, freedom = int(noise["order"]), float(noise["degrees_of_freedom"])
    differentiated = bool(noise["differentiated"])
    evidence = float(noise["student_t_evidence"])
    coloured = "ar" if order or differentiated else "white"
    return {
        "kind": "student_t" if np.isfinite(freedom) else coloured,
        "order": order,
        "sd_rpm": float(noise["sd_rpm"]),
        "coefficients": noise["coefficients"].values[:order].tolist(),
        "degrees_of_freedom": freedom if np.isfinite(freedom) else None,
        "student_t_evidence": evidence if np.isfinite(evidence) else None,
        "differentiated": differentiated,
        "repeating_rounding_sd_rpm": float(noise["hidden_sd_rpm"]),
    }


def _sampler_check(check: xr.Dataset) -> SamplerCheckSummary:
    return {
        "agrees": not np.any(check["differs"].values > 0.0),
        "symbols": {
            str(s): {
                "difference_sd": float(check["difference_sd"].sel(symbol=s)),
                "width_ratio": float(check["width_ratio"].sel(symbol=s)),
            }
            for s in check["symbol"].values
        },
    }
