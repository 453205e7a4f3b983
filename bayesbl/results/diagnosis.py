"""A diagnosis as a stored tree, and its summary.

``signals``: measured, before and after for every piece (a recording, or the half of one), padded
with NaN. ``gaps``: RMS before and after for every piece. What was named stands, with its estimates,
as JSON in the attribute ``diagnosis`` of the root, in the words of ``summary.json``.
"""

from __future__ import annotations

import json
import math
from statistics import NormalDist
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.diagnosis.report import Diagnosis, Estimate, Gap
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import texts
from bayesbl.results.tree import dataset
from bayesbl.units import unit_of

GAP_WORDS = {
    "before": "RMS between bench and measurement without the named effects",
    "after": "RMS between bench and measurement with the named effects",
    "noise_floor": "RMS of what cannot be foretold from the samples before",
    "closed_fraction": "share of the excess over the noise floor that is closed",
}


def diagnosis_tree(found: Diagnosis, level: float) -> xr.DataTree:
    """The whole result, without its origin."""
    channel = found.gaps[0][0].channel
    tree = xr.DataTree.from_dict({"signals": _signals(found), "gaps": _gaps(found)})
    tree.attrs = {
        "kind": "diagnose",
        "outcome": "converged",
        "reason": "",
        "warnings": list(found.notes),
        "interval_level": level,
        "interval_kind": "equal_tailed",
        "channel": channel,
        "diagnosis": json.dumps(_answer(found, level), ensure_ascii=False),
    }
    return tree


def summarise_diagnosis(tree: xr.DataTree) -> dict[str, Any]:
    """``summary.json`` of a diagnosis."""
    answer: dict[str, Any] = json.loads(tree.attrs["diagnosis"])
    return {
        "kind": "diagnose",
        "outcome": tree.attrs["outcome"],
        "reason": tree.attrs.get("reason") or None,
        "warnings": texts(tree.attrs.get("warnings")),
        "version": tree.attrs.get("bayesbl_version"),
        "commit": tree.attrs.get("git_commit"),
        "seed": tree.attrs.get("seed"),
        **answer,
    }


def _answer(found: Diagnosis, level: float) -> dict[str, Any]:
    recordings: dict[str, dict[str, dict[str, Any]]] = {}
    for piece, gap in found.gaps:
        channels = recordings.setdefault(piece.name, {}).setdefault(piece.channel, {})
        channels[piece.use] = _gap(gap)
    return {
        "verdict": found.verdict,
        "effects": [
            {
                "name": effect.name,
                "parameters": {k: interval_of(v, level) for k, v in effect.parameters.items()},
                "probability": effect.probability,
                "z": effect.z,
                "indistinguishable_from": list(effect.indistinguishable_from),
            }
            for effect in found.effects
        ],
        "parameter_errors": [
            {
                "name": error.name,
                "believed": error.believed,
                "tolerance": error.tolerance,
                "fitted": interval_of(error.fitted, level),
            }
            for error in found.parameter_errors
        ],
        "bench_parameters": {k: interval_of(v, level) for k, v in found.bench.items()},
        "remaining": [
            {
                "channel": line.channel,
                "repeats_with": "motor_angle",
                "order": line.order,
                "amplitude": line.amplitude,
                "chi_squared": line.chi_squared,
            }
            for line in found.remaining
        ],
        "gap": {
            "unit": unit_of(found.gaps[0][0].channel),
            "recordings": recordings,
            "over_all": {use: _gap(gap) for use, gap in found.overall.items()},
        },
        "delta_rad_before": None,
        "delta_rad_after": None,
        "suggested_recording": None,
    }


def _gap(gap: Gap) -> dict[str, float | None]:
    return {name: getattr(gap, name) for name in GAP_WORDS}


def interval_of(estimate: Estimate, level: float) -> dict[str, Any]:
    """Interval of a normal distribution; bounds are ``None`` where the value was held."""
    known = math.isfinite(estimate.sd)
    reach = NormalDist().inv_cdf(0.5 + 0.5 * level) * estimate.sd if known else 0.0
    return {
        "median": estimate.value,
        "low": estimate.value - reach if known else None,
        "high": estimate.value + reach if known else None,
        "level": level,
        "kind": "equal_tailed",
    }


def _signals(found: Diagnosis) -> xr.Dataset:
    pieces = [piece for piece, _ in found.gaps]
    longest = max(piece.measured.size for piece in pieces)
    unit = unit_of(pieces[0].channel)

    def padded(rows: list[FloatArray]) -> FloatArray:
        table = np.full((len(rows), longest), np.nan)
        for row, values in zip(table, rows, strict=True):
            row[: values.size] = values
        return table

    dims = ("piece", "sample")
    return dataset(
        {
            "time_s": (dims, padded([p.time_s for p in pieces]), "s", "time"),
            "measured": (dims, padded([p.measured for p in pieces]), unit, "measured"),
            "before": (
                dims,
                padded(list(found.before.predictions)),
                unit,
                "bench without the named effects",
            ),
            "after": (
                dims,
                padded(list(found.after.predictions)),
                unit,
                "bench with the named effects",
            ),
        },
        _labels(found),
    )


def _gaps(found: Diagnosis) -> xr.Dataset:
    unit = unit_of(found.gaps[0][0].channel)
    variables = {}
    for name, words in GAP_WORDS.items():
        values = [getattr(gap, name) for _, gap in found.gaps]
        plain = np.array([np.nan if value is None else value for value in values], dtype=float)
        variables[name] = (("piece",), plain, "1" if name == "closed_fraction" else unit, words)
    return dataset(variables, _labels(found))


def _labels(found: Diagnosis) -> dict[str, object]:
    return {
        "recording": ("piece", [piece.name for piece, _ in found.gaps]),
        "use": ("piece", [piece.use for piece, _ in found.gaps]),
    }
