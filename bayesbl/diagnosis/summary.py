"""``summary.json`` of a diagnosis, in the keys of the contract."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Literal, NotRequired, TypedDict, cast

import xarray as xr

from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, Verdict
from bayesbl.diagnosis.disagreement import Disagreement, DisagreementTable, FloorFrom, Use
from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.results.folder import AUGMENTED_BENCH
from bayesbl.results.intervals import IntervalKind, interval
from bayesbl.results.store import texts
from bayesbl.units import unit_of

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class CredibleInterval(TypedDict):
    """Bounds are ``None`` where the value was held."""

    median: float
    low: float | None
    high: float | None
    level: float
    kind: IntervalKind


class EffectSummary(TypedDict):
    """A named effect; names of parameters to intervals."""

    name: str
    parameters: dict[str, CredibleInterval]
    probability: float
    z: float
    indistinguishable_from: list[str]


class ParameterErrorSummary(TypedDict):
    """A bench parameter that is not what its file says."""

    name: str
    believed: float
    tolerance: float
    fitted: CredibleInterval
    indistinguishable_from: list[str]


class RemainingSummary(TypedDict):
    """What still stands out after naming; the optional keys where a test of orders found it."""

    channel: str
    dependence: str
    amplitude: float
    unit: str
    lowest_order: float | None
    highest_order: float | None
    frequency_hz: float | None
    recordings: list[str]
    repeats_with: NotRequired[Literal["motor_angle"]]
    order: NotRequired[float]
    chi_squared: NotRequired[float]


class DisagreementSummary(TypedDict):
    """RMS between bench and measurement in ``unit``; ``noise`` where it is over the noise floor."""

    before: float
    after: float
    noise_floor: float
    closed_fraction: float | None
    unit: str
    noise_floor_from: NotRequired[FloorFrom]


class DisagreementTableSummary(TypedDict):
    """By recording, channel and use, and over all by use; ``unit`` where all have one."""

    unit: str | None
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]]
    over_all: dict[Use, DisagreementSummary]


class SuggestedRecording(TypedDict):
    """A recording that would tell apart what these cannot."""

    reference_speed_rpm: float
    payload_share: float
    distance: float
    separates: list[list[str]]


class SamplingSummary(TypedDict):
    """How well the posterior was sampled."""

    r_hat: float
    ess_bulk: float
    effective_after_simulation: float
    outcome: str
    reasons: list[str]


class Answer(TypedDict):
    """What a diagnosis says."""

    verdict: Verdict
    effects: list[EffectSummary]
    parameter_errors: list[ParameterErrorSummary]
    bench_parameters: dict[str, CredibleInterval]
    remaining: list[RemainingSummary]
    disagreement: DisagreementTableSummary
    delta_rad_before: CredibleInterval | None
    delta_rad_after: CredibleInterval | None
    suggested_recording: SuggestedRecording | None
    augmented_bench: NotRequired[str]
    diagnostics: NotRequired[SamplingSummary]


class DiagnosisSummary(Answer):
    """``summary.json``."""

    kind: Literal["diagnose"]
    outcome: str
    reason: str | None
    warnings: list[str]
    version: str | None
    commit: str | None
    seed: int | None


def summarise_diagnosis(tree: xr.DataTree) -> DiagnosisSummary:
    """``summary.json`` of a stored diagnosis."""
    answer: Answer = json.loads(tree.attrs["diagnosis"])
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


def answer_of(found: Diagnosis, level: float, kind: IntervalKind) -> Answer:
    """The answer with credible intervals of this level and kind."""

    def of(estimate: Estimate) -> CredibleInterval:
        return interval_of(estimate, level, kind)

    def of_each(estimates: Mapping[str, Estimate]) -> dict[str, CredibleInterval]:
        return {name: of(estimate) for name, estimate in estimates.items()}

    suggestion = found.suggestion
    answer: Answer = {
        "verdict": found.verdict,
        "effects": [
            {
                "name": effect.name,
                "parameters": of_each(effect.parameters),
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
                "fitted": of(error.fitted),
                "indistinguishable_from": list(error.indistinguishable_from),
            }
            for error in found.parameter_errors
        ],
        "bench_parameters": of_each(found.bench_parameters),
        "remaining": [_remaining(entry) for entry in found.remaining],
        "disagreement": _table(found.disagreement),
        "delta_rad_before": None if found.delta_before is None else of(found.delta_before),
        "delta_rad_after": None if found.delta_after is None else of(found.delta_after),
        "suggested_recording": None
        if suggestion is None
        else {
            "reference_speed_rpm": suggestion.reference_speed_rpm,
            "payload_share": suggestion.payload_share,
            "distance": suggestion.distance,
            "separates": [list(names) for names in suggestion.separates],
        },
    }
    if found.augmented_bench is not None:
        answer["augmented_bench"] = AUGMENTED_BENCH
    if found.posterior is not None:
        answer["diagnostics"] = _sampling(found.posterior)
    return answer


def interval_of(estimate: Estimate, level: float, kind: IntervalKind) -> CredibleInterval:
    """From the draws; of a normal distribution, or lognormal one, where there are none."""
    if estimate.draws is not None:
        return cast(CredibleInterval, interval(estimate.draws, level, kind))
    value = math.exp if estimate.logarithmic else float
    known = math.isfinite(estimate.sd)
    reach = NormalDist().inv_cdf(0.5 + 0.5 * level) * estimate.sd if known else 0.0
    return {
        "median": value(estimate.value),
        "low": value(estimate.value - reach) if known else None,
        "high": value(estimate.value + reach) if known else None,
        "level": level,
        "kind": "equal_tailed",
    }


def plain(entry: DataclassInstance) -> dict[str, Any]:
    """An entry as JSON can hold it, which knows no NaN."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in dataclasses.asdict(entry).items()
    }


def _remaining(entry: Unexplained) -> RemainingSummary:
    found: RemainingSummary = {
        "channel": entry.channel,
        "dependence": entry.dependence,
        "amplitude": entry.amplitude,
        "unit": entry.unit,
        "lowest_order": _finite(entry.lowest_order),
        "highest_order": _finite(entry.highest_order),
        "frequency_hz": _finite(entry.frequency_hz),
        "recordings": list(entry.recordings),
    }
    if entry.chi_squared is not None:
        found["repeats_with"] = "motor_angle"
        found["order"] = entry.lowest_order
        found["chi_squared"] = entry.chi_squared
    return found


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _table(table: DisagreementTable) -> DisagreementTableSummary:
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]] = {}
    for piece, found in table.pieces:
        entry = _disagreement(found, unit_of(piece.channel))
        entry["noise_floor_from"] = piece.noise_floor_from
        recordings.setdefault(piece.recording, {}).setdefault(piece.channel, {})[piece.use] = entry
    unit = table.unit or "noise"
    overall = {use: _disagreement(found, unit) for use, found in table.overall.items()}
    return {"unit": table.unit, "recordings": recordings, "over_all": overall}


def _disagreement(found: Disagreement, unit: str) -> DisagreementSummary:
    return {
        "before": found.before,
        "after": found.after,
        "noise_floor": found.noise_floor,
        "closed_fraction": found.closed_fraction,
        "unit": unit,
    }


def _sampling(posterior: DirectPosterior) -> SamplingSummary:
    diagnostics = posterior.diagnostics
    return {
        "r_hat": max(diagnostics.r_hat.values()),
        "ess_bulk": min(diagnostics.ess_bulk.values()),
        "effective_after_simulation": posterior.effective,
        "outcome": diagnostics.outcome,
        "reasons": list(diagnostics.reasons),
    }
