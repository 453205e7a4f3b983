"""A forward diagnosis as a stored tree.

``gaps``: RMS before and after for every recording, channel and use. ``located_before`` and
``located_after``: what the simulation left. ``ranking``: every candidate added alone. The answer in
the words of ``summary.json`` stands as JSON in the attribute ``diagnosis`` of the root, the bench
with what was named in it as a bench file in the attribute ``augmented_bench``.
"""

from __future__ import annotations

import dataclasses
import json
import math
from statistics import NormalDist
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.discrepancy.forward.diagnosis import ForwardDiagnosis, estimates
from bayesbl.discrepancy.forward.evaluate import ChannelGap
from bayesbl.discrepancy.forward.naming import NamedEffect
from bayesbl.discrepancy.report import Estimate
from bayesbl.physics.bench import Bench
from bayesbl.results.diagnosis import GAP_WORDS, interval_of
from bayesbl.results.located import located_dataset
from bayesbl.results.tree import dataset
from bayesbl.units import unit_of


def forward_tree(
    found: ForwardDiagnosis, believed: Bench, augmented: str, level: float
) -> xr.DataTree:
    """The whole result, without its origin.

    Parameters
    ----------
    believed
        The bench as its file says.
    augmented
        Bench file with what was named in it; empty if nothing was.
    """
    tree = xr.DataTree.from_dict(
        {
            "gaps": _gaps(found),
            "ranking": _ranking(found),
            "located_before": located_dataset(found.located_before),
            "located_after": located_dataset(found.located_after),
        }
    )
    tree.attrs = {
        "kind": "diagnose",
        "method": "forward",
        "outcome": "converged",
        "reason": "",
        "warnings": [],
        "interval_level": level,
        "interval_kind": "equal_tailed",
        "diagnosis": json.dumps(_answer(found, believed, level), ensure_ascii=False),
        "augmented_bench": augmented,
    }
    return tree


def _answer(found: ForwardDiagnosis, believed: Bench, level: float) -> dict[str, Any]:
    named = found.naming.effects
    suggestion = found.suggestion
    return {
        "verdict": found.verdict,
        "effects": [_effect(found, e, level) for e in named if e.candidate.kind == "effect"],
        "parameter_errors": [
            {
                "name": effect.name,
                "believed": believed.value(effect.name),
                "tolerance": believed.parameters[effect.name].tolerance,
                "fitted": interval_of(estimates(found.final, effect.name)[effect.name], level),
                "indistinguishable_from": list(effect.members[1:]),
            }
            for effect in named
            if effect.candidate.kind == "parameter"
        ],
        "remaining": [_plain(dataclasses.asdict(entry)) for entry in found.remaining],
        "gap": _gap_table(found),
        "delta_rad_before": _delta(found.delta_before, level),
        "delta_rad_after": _delta(found.delta_after, level),
        "suggested_recording": None
        if suggestion is None
        else dataclasses.asdict(suggestion)
        | {"separates": [list(e.members) for e in named if e.indistinguishable]},
    }


def _effect(found: ForwardDiagnosis, effect: NamedEffect, level: float) -> dict[str, Any]:
    parameters = estimates(found.final, effect.name)
    return {
        "name": effect.name,
        "parameters": {key: interval_of(value, level) for key, value in parameters.items()},
        "probability": _probability(found, effect),
        "z": math.sqrt(max(effect.gain, 0.0)),
        "indistinguishable_from": list(effect.members[1:]),
    }


def _probability(found: ForwardDiagnosis, effect: NamedEffect) -> float:
    """Of this name among those that cannot be told apart, by their evidence."""
    own = found.naming.final.log_evidence
    odds = [math.exp(min(700.0, e.log_evidence - own)) for e in effect.indistinguishable]
    return 1.0 / (1.0 + sum(odds))


def _gap_table(found: ForwardDiagnosis) -> dict[str, Any]:
    recordings: dict[str, dict[str, dict[str, Any]]] = {}
    for gap in found.gaps:
        channels = recordings.setdefault(gap.recording, {}).setdefault(gap.channel, {})
        channels[gap.use] = _one_gap(gap) | {"unit": unit_of(gap.channel)}
    return {
        "unit": None,
        "recordings": recordings,
        "over_all": {gap.use: _one_gap(gap) | {"unit": "noise"} for gap in found.overall},
    }


def _one_gap(gap: ChannelGap) -> dict[str, float | None]:
    return {name: getattr(gap, name) for name in GAP_WORDS}


def _delta(estimate: Estimate | None, level: float) -> dict[str, Any] | None:
    """From ln δ to δ."""
    if estimate is None:
        return None
    reach = NormalDist().inv_cdf(0.5 + 0.5 * level) * estimate.sd
    return {
        "median": math.exp(estimate.value),
        "low": math.exp(estimate.value - reach),
        "high": math.exp(estimate.value + reach),
        "level": level,
        "kind": "equal_tailed",
    }


def _plain(entry: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no NaN."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in entry.items()
    }


def _gaps(found: ForwardDiagnosis) -> xr.Dataset:
    rows = found.gaps
    variables = {}
    for name, words in GAP_WORDS.items():
        values = [getattr(gap, name) for gap in rows]
        plain = np.array([np.nan if value is None else value for value in values], dtype=float)
        unit = "1" if name == "closed_fraction" else "rpm or A, as the channel"
        variables[name] = (("piece",), plain, unit, words)
    labels = {
        "recording": ("piece", [gap.recording for gap in rows]),
        "channel": ("piece", [gap.channel for gap in rows]),
        "use": ("piece", [gap.use for gap in rows]),
    }
    return dataset(variables, labels)


def _ranking(found: ForwardDiagnosis) -> xr.Dataset:
    ranking = found.naming.ranking
    nominal = found.naming.nominal
    gains = np.array([nominal.fit.chi_square - e.fit.chi_square for e in ranking])
    evidence = np.array([e.log_evidence - nominal.log_evidence for e in ranking])
    dims = ("candidate",)
    return dataset(
        {
            "chi_square_gain": (dims, gains, "1", "drop of χ² by this candidate alone"),
            "log_evidence_gain": (dims, evidence, "1", "log evidence over the bench as believed"),
        },
        {"candidate": [e.candidates[-1].name for e in ranking]},
    )
