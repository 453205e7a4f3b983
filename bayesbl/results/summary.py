"""``summary.json``: what a stored result says, from the result alone."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.diagnosis.summary import summarise_diagnosis
from bayesbl.measurement.dated_wear import summarise_wear
from bayesbl.measurement.stored_curve import SOURCE_PREFIX
from bayesbl.recording.types import FloatArray
from bayesbl.results.direct_summary import amplitude_reasons, direct_snapshot
from bayesbl.results.intervals import interval
from bayesbl.results.store import texts
from bayesbl.ringing.symbols import SYMBOLS


def summarise(tree: xr.DataTree) -> dict[str, Any]:
    """The summary of a fit, of compared snapshots, of a sweep or of a diagnosis.

    δ and the change are ``None`` where the answer is withheld; ``reason`` says why.
    """
    if tree.attrs["kind"] == "diagnose":
        return dict(summarise_diagnosis(tree))
    if tree.attrs["kind"] == "sweep":
        return _sweep(tree)
    if tree.attrs["kind"] == "compare":
        return _comparison(tree)
    return {**_head(tree), **_snapshot(tree, None)}


def _head(tree: xr.DataTree) -> dict[str, Any]:
    return {
        "kind": tree.attrs["kind"],
        "outcome": tree.attrs["outcome"],
        "reason": tree.attrs.get("reason") or None,
        "warnings": texts(tree.attrs.get("warnings")),
        "curve": tree["curve"].attrs["name"],
        "version": tree.attrs.get("bayesbl_version"),
        "commit": tree.attrs.get("git_commit"),
        "seed": tree.attrs.get("seed"),
    }


def _snapshot(tree: xr.DataTree, name: str | None) -> dict[str, Any]:
    """One snapshot's part; ``name`` is ``None`` for a fit."""

    def group(key: str) -> xr.Dataset:
        whole = tree[key].to_dataset()
        return whole if name is None else whole.sel(snapshot=name)

    if tree.attrs.get("route") == "direct":
        return _direct(tree, name)
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    posterior, noise = group("posterior"), group("noise")
    diagnostics, optimum, gap = group("diagnostics"), group("optimum"), group("gap")
    verdict = _verdict(tree, name)
    delta = posterior["delta_rad"].values
    withheld = bool(verdict["reason"])
    result: dict[str, Any] = {
        "delta_rad": None if withheld else interval(delta, level, kind),
        "amplitude_rpm": interval(posterior["amplitude_rpm"].values, level, kind),
        "parameters": {
            symbol: interval(posterior[symbol].values, level, kind)
            for symbol in SYMBOLS
            if symbol in posterior
        },
        "optimum": {symbol: float(optimum[symbol]) for symbol in SYMBOLS}
        | {"rmse_rpm": float(optimum["rmse_rpm"])},
        "noise": _noise(noise),
        "misfit_rms_rpm": float(group("misfit")["rms_rpm"]),
        "rotations": float(diagnostics["rotations"]),
        "excluded_samples": int(group("observed_data").get("excluded", np.zeros(1)).sum()),
        "budget": {
            str(source): float(share)
            for source, share in zip(gap["source"].data, gap["budget"].data, strict=True)
            if np.isfinite(share)
        },
        "diagnostics": {
            "r_hat": float(diagnostics["r_hat"].max()),
            "ess_bulk": float(diagnostics["ess_bulk"].min()),
            "outcome": verdict["outcome"],
            "reasons": verdict["reasons"],
        },
        "reason": verdict["reason"],
    }
    start = str(optimum["start"].item()) if "start" in optimum else ""
    if start:
        result["start"] = start
    if "sampler_check" in tree:
        check = group("sampler_check")
        result["sampler_check"] = {
            "agrees": not np.any(check["differs"].values > 0.0),
            "symbols": {
                str(s): {
                    "difference_sd": float(check["difference_sd"].sel(symbol=s)),
                    "width_ratio": float(check["width_ratio"].sel(symbol=s)),
                }
                for s in check["symbol"].values
            },
        }
    return result | _above_limit(tree, delta, withheld)


def _above_limit(tree: xr.DataTree, delta_rad: FloatArray, withheld: bool) -> dict[str, Any]:
    limit = tree.attrs.get("limit_rad")
    if limit is None:
        return {}
    above = None if withheld else float(np.mean(delta_rad > float(limit)))
    return {"limit_rad": float(limit), "probability_above_limit": above}


def _direct(tree: xr.DataTree, name: str | None) -> dict[str, Any]:
    """One snapshot of the direct route."""
    groups = {key: node.to_dataset() for key, node in tree.children.items()}
    if name is not None:
        groups = {
            key: data.sel(snapshot=name) for key, data in groups.items() if "snapshot" in data.dims
        }
    verdict = _verdict(tree, name)
    part = direct_snapshot(
        groups,
        verdict,
        amplitude_reasons(tree)[name or "fit"],
        tree["curve"].attrs["name"],
        float(tree.attrs["interval_level"]),
        tree.attrs["interval_kind"],
    )
    draws = groups["posterior"]["delta_rad"].values
    return part | _above_limit(tree, draws, bool(verdict["reason"]))


def _noise(noise: xr.Dataset) -> dict[str, Any]:
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


def _comparison(tree: xr.DataTree) -> dict[str, Any]:
    names = [str(n) for n in tree["posterior"].to_dataset()["snapshot"].values]
    snapshots = [{"name": n, **_snapshot(tree, n)} for n in names]
    for snapshot in snapshots:
        snapshot.setdefault("probability_above_limit", None)
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    change = tree["change"].to_dataset()
    answered = {s["name"]: s["delta_rad"] is not None for s in snapshots}

    def described(draws: FloatArray, first: str, last: str) -> dict[str, Any]:
        given = answered[first] and answered[last]
        return {
            "from": first,
            "to": last,
            "change_rad": interval(draws, level, kind) if given else None,
            "probability_increase": float(np.mean(draws > 0.0)) if given else None,
        }

    total = described(change["change_rad"].values, names[0], names[-1])
    steps = [
        described(change["step_change_rad"].values[i], names[i], names[i + 1])
        for i in range(len(names) - 1)
    ]
    return {
        **_head(tree),
        "snapshots": snapshots,
        "change_rad": total["change_rad"],
        "changes": steps,
        "probability_increase": total["probability_increase"],
        "wear": summarise_wear(tree, names),
    }


def _sweep(tree: xr.DataTree) -> dict[str, Any]:
    sweep, degrees = tree["sweep"].to_dataset(), tree["degrees"].to_dataset()
    stored = tree["gap_curve"].to_dataset()
    return {
        **_head(tree),
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


def _verdict(tree: xr.DataTree, name: str | None) -> dict[str, Any]:
    """Outcome and reasons of one snapshot, kept as attributes of ``diagnostics``."""
    verdicts: dict[str, Any] = json.loads(tree["diagnostics"].attrs["verdicts"])
    found: dict[str, Any] = verdicts[name or "fit"]
    return found
