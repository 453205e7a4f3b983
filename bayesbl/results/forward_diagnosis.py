"""A forward diagnosis as a stored tree.

``posterior``: draws of δ, of the start angles and of what was named, with it added. ``gaps``: RMS
before and after for every recording, channel and use. ``located_before``, ``located_after``: what
the simulation left. ``ranking``: every candidate added alone. The answer in the words of
``summary.json`` stands as JSON in the attribute ``diagnosis`` of the root, the bench with what was
named in it as a bench file in the attribute ``augmented_bench``.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.closed_loop.diagnosis import ForwardDiagnosis, estimates, places
from bayesbl.diagnosis.closed_loop.evaluate import ChannelGap
from bayesbl.diagnosis.closed_loop.naming import NamedEffect
from bayesbl.diagnosis.report import Estimate
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.signals import GAP
from bayesbl.measurement.direct_groups import result_name, unit_and_meaning
from bayesbl.results.diagnosis import GAP_WORDS, interval_of
from bayesbl.results.intervals import IntervalKind, interval
from bayesbl.results.located import located_dataset, plain
from bayesbl.results.tree import dataset
from bayesbl.units import unit_of


def forward_tree(
    found: ForwardDiagnosis,
    posterior: DirectPosterior,
    believed: Bench,
    augmented: str,
    level: float,
    kind: IntervalKind,
) -> xr.DataTree:
    """The whole result, without its origin.

    Parameters
    ----------
    posterior
        Around ``found.final``. Where it is withheld, intervals are those of the normal
        approximation, and a warning says so.
    believed
        The bench as its file says.
    augmented
        Bench file with what was named in it; empty if nothing was.
    """
    intervals = _Intervals(posterior, level, kind)
    tree = xr.DataTree.from_dict(
        {
            "posterior": _posterior(posterior),
            "gaps": _gaps(found),
            "ranking": _ranking(found),
            "located_before": located_dataset(found.located_before),
            "located_after": located_dataset(found.located_after),
        }
    )
    tree.attrs = {
        "kind": "diagnose",
        "method": "forward",
        "outcome": "usable" if posterior.diagnostics.reasons else "converged",
        "reason": "",
        "warnings": list(_warnings(posterior)),
        "interval_level": level,
        "interval_kind": kind,
        "diagnosis": json.dumps(_answer(found, intervals, believed), ensure_ascii=False),
        "augmented_bench": augmented,
    }
    return tree


@dataclass(frozen=True, slots=True)
class _Intervals:
    """Credible intervals of what was fitted."""

    posterior: DirectPosterior
    level: float
    kind: IntervalKind

    def of(self, estimate: Estimate, place: int | None) -> dict[str, Any]:
        """From the draws; of a normal distribution where they are withheld."""
        if place is None or self.posterior.diagnostics.outcome == "withheld":
            return interval_of(estimate, self.level)
        unknown = self.posterior.fit.model.unknowns[place]
        draws = unknown.value(self.posterior.draws[..., place])
        return dict(interval(draws, self.level, self.kind))

    def of_gap(self, estimate: Estimate | None, place: int | None) -> dict[str, Any] | None:
        """Of δ, whose logarithm is estimated."""
        if estimate is None:
            return None
        if place is not None and self.posterior.diagnostics.outcome != "withheld":
            return self.of(estimate, place)
        logarithm = interval_of(estimate, self.level)
        return logarithm | {k: math.exp(logarithm[k]) for k in ("median", "low", "high")}


def _answer(found: ForwardDiagnosis, intervals: _Intervals, believed: Bench) -> dict[str, Any]:
    named = found.naming.effects
    suggestion = found.suggestion
    unknowns = [u.name for u in found.final.fit.model.unknowns]
    gap = unknowns.index(GAP) if GAP in unknowns else None
    return {
        "verdict": found.verdict,
        "effects": [_effect(found, e, intervals) for e in named if e.candidate.kind == "effect"],
        "parameter_errors": [
            {
                "name": effect.name,
                "believed": believed.value(effect.name),
                "tolerance": believed.parameters[effect.name].tolerance,
                "fitted": _fitted(found, effect, intervals)[effect.name],
                "indistinguishable_from": list(effect.members[1:]),
            }
            for effect in named
            if effect.candidate.kind == "parameter"
        ],
        "remaining": [plain(entry) for entry in found.remaining],
        "gap": _gap_table(found),
        "delta_rad_before": intervals.of_gap(found.delta_before, None),
        "delta_rad_after": intervals.of_gap(found.delta_after, gap),
        "suggested_recording": None
        if suggestion is None
        else dataclasses.asdict(suggestion)
        | {"separates": [list(e.members) for e in named if e.indistinguishable]},
        "diagnostics": _diagnostics(intervals.posterior),
    }


def _effect(found: ForwardDiagnosis, effect: NamedEffect, intervals: _Intervals) -> dict[str, Any]:
    return {
        "name": effect.name,
        "parameters": _fitted(found, effect, intervals),
        "probability": _probability(found, effect),
        "z": math.sqrt(max(effect.gain, 0.0)),
        "indistinguishable_from": list(effect.members[1:]),
    }


def _fitted(
    found: ForwardDiagnosis, effect: NamedEffect, intervals: _Intervals
) -> dict[str, dict[str, Any]]:
    at = places(found.final, effect.name)
    return {
        key: intervals.of(value, at.get(key))
        for key, value in estimates(found.final, effect.name).items()
    }


def _diagnostics(posterior: DirectPosterior) -> dict[str, Any]:
    told = posterior.diagnostics
    return {
        "r_hat": max(told.r_hat.values()),
        "ess_bulk": min(told.ess_bulk.values()),
        "effective_after_simulation": posterior.effective,
        "outcome": told.outcome,
        "reasons": list(told.reasons),
    }


def _warnings(posterior: DirectPosterior) -> Iterator[str]:
    told = posterior.diagnostics
    if told.outcome == "withheld":
        yield "The posterior could not be sampled; intervals are of its normal approximation."
    yield from told.reasons


def _posterior(posterior: DirectPosterior) -> xr.Dataset:
    """Draws by name; what every recording has of its own stands under the recording's name."""
    chains, count, _ = posterior.draws.shape
    variables = {}
    for i, unknown in enumerate(posterior.fit.model.unknowns):
        name = result_name(unknown)
        unit, meaning = unit_and_meaning(name)
        own = unknown.recording
        label = name if own is None else f"{name} ({own})"
        draws = unknown.value(posterior.draws[..., i])
        told = meaning if own is None else f"{meaning}, {own}"
        variables[label] = (("chain", "draw"), draws, unit, told)
    return dataset(variables, {"chain": np.arange(chains), "draw": np.arange(count)})


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
