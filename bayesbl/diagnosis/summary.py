"""``summary.json`` of a diagnosis, in the keys of the contract."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from statistics import NormalDist
from typing import Any, Literal, NotRequired, TypedDict

import xarray as xr

from bayesbl.bench.learned import LearnedTerm, Side, Variable
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, LearnedAnswer, Verdict
from bayesbl.diagnosis.disagreement import DisagreementTable, FloorFrom, Use
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.results.folder import AUGMENTED_BENCH
from bayesbl.results.intervals import Interval, IntervalKind, interval
from bayesbl.results.store import Head, head

_PLACE = ("recording", "channel", "use")


class HeldValue(TypedDict):
    """An interval without bounds: the value was not fitted."""

    median: float
    low: None
    high: None
    level: float
    kind: IntervalKind


class EffectSummary(TypedDict):
    """A named effect; names of parameters to intervals."""

    name: str
    parameters: dict[str, Interval | HeldValue]
    probability: float
    z: float
    indistinguishable_from: list[str]


class ParameterErrorSummary(TypedDict):
    """A bench parameter that is not what its file says."""

    name: str
    believed: float
    tolerance: float
    fitted: Interval | HeldValue
    indistinguishable_from: list[str]


class RemainingSummary(TypedDict):
    """What still repeats after naming; ``chi_squared`` of a line whose test has one."""

    channel: str
    dependence: str
    amplitude: float
    unit: str
    lowest_order: float | None
    highest_order: float | None
    frequency_hz: float | None
    recordings: list[str]
    chi_squared: float | None


class LearnedDependence(TypedDict):
    """Where something learned acts and what it depends on; ``period`` in rad, rad/s or s."""

    side: Side | Literal["encoder"]
    variable: Variable
    reverses: bool
    period: float
    orders: int


class LearnedSummary(LearnedDependence):
    """A torque of no known law, or an error of the encoder.

    ``amplitude_nm``, ``amplitude_rad`` its largest size, at its side; ``alike`` other dependences
    that look the same here; ``gap_share`` the share of the information on the gap that remains;
    ``gap_withheld`` why no gap is given.
    """

    amplitude_nm: NotRequired[float]
    amplitude_rad: NotRequired[float]
    alike: list[LearnedDependence]
    gap_share: float | None
    gap_withheld: str


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
    """A recording that would separate what these cannot."""

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
    bench_parameters: dict[str, Interval | HeldValue]
    remaining: list[RemainingSummary]
    disagreement: DisagreementTableSummary
    delta_rad_before: Interval | None
    delta_rad_after: Interval | None
    gap_withheld: NotRequired[str]
    suggested_recording: SuggestedRecording | None
    augmented_bench: NotRequired[str]
    learned_torque: NotRequired[LearnedSummary]
    encoder_error: NotRequired[LearnedSummary]
    diagnostics: NotRequired[SamplingSummary]


class DiagnosisSummary(Head, Answer):
    """``summary.json``."""

    kind: Literal["diagnose"]


def summarise_diagnosis(tree: xr.DataTree) -> DiagnosisSummary:
    """``summary.json`` of a stored diagnosis."""
    answer: Answer = json.loads(tree.attrs["diagnosis"])
    return {"kind": "diagnose", **head(tree), **answer}


def answer_of(found: Diagnosis, level: float, kind: IntervalKind) -> Answer:
    """The answer with credible intervals of this level and kind."""

    def of(value: object) -> Any:
        return plain(value, lambda estimate: interval_of(estimate, level, kind))

    answer: Answer = {
        "verdict": found.verdict,
        "effects": of(found.effects),
        "parameter_errors": of(found.parameter_errors),
        "bench_parameters": of(found.bench_parameters),
        "remaining": of(found.remaining),
        "disagreement": disagreement_summary(found.disagreement),
        "delta_rad_before": of(found.delta_before),
        "delta_rad_after": of(found.delta_after),
        "suggested_recording": of(found.suggestion),
    }
    if found.gap_withheld:
        answer["gap_withheld"] = found.gap_withheld
    if found.augmented_bench is not None:
        answer["augmented_bench"] = AUGMENTED_BENCH
    if found.learned is not None:
        told = _learned(found.learned)
        if found.learned.term.is_of_encoder:
            told["amplitude_rad"] = found.learned.amplitude
            answer["encoder_error"] = told
        else:
            told["amplitude_nm"] = found.learned.amplitude
            answer["learned_torque"] = told
    if found.posterior is not None:
        answer["diagnostics"] = sampling_summary(found.posterior)
    return answer


def _learned(told: LearnedAnswer) -> Any:
    """The keys of :class:`LearnedSummary` but the amplitude."""
    return _dependence(told.term) | {
        "alike": [_dependence(other) for other in told.alike],
        "gap_share": told.gap_share,
        "gap_withheld": told.gap_withheld,
    }


def _dependence(term: LearnedTerm) -> Any:
    """The keys of :class:`LearnedDependence`, as the term has them."""
    return {key: getattr(term, key) for key in LearnedDependence.__annotations__}


def interval_of(estimate: Estimate, level: float, kind: IntervalKind) -> Interval | HeldValue:
    """From the draws; of a normal distribution, or lognormal one, where there are none."""
    if estimate.draws is not None:
        return interval(estimate.draws, level, kind)
    value = math.exp if estimate.logarithmic else float
    median = value(estimate.value)
    if not math.isfinite(estimate.sd):
        return {
            "median": median, "low": None, "high": None, "level": level, "kind": "equal_tailed"
        }  # fmt: skip
    reach = NormalDist().inv_cdf(0.5 + 0.5 * level) * estimate.sd
    return {
        "median": median,
        "low": value(estimate.value - reach),
        "high": value(estimate.value + reach),
        "level": level,
        "kind": "equal_tailed",
    }


def plain(value: object, of_estimate: Callable[[Estimate], object] | None = None) -> Any:
    """A value as JSON can hold it: dataclasses as objects, tuples as lists, NaN as null."""
    if isinstance(value, Estimate) and of_estimate is not None:
        return of_estimate(value)
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: plain(getattr(value, name), of_estimate) for name in names}
    if isinstance(value, Mapping):
        return {key: plain(item, of_estimate) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item, of_estimate) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def disagreement_summary(table: DisagreementTable) -> DisagreementTableSummary:
    """By recording, channel and use, and over all."""
    recordings: dict[str, dict[str, dict[Use, DisagreementSummary]]] = {}
    for piece in table.pieces:
        entry: Any = {key: value for key, value in plain(piece).items() if key not in _PLACE}
        recordings.setdefault(piece.recording, {}).setdefault(piece.channel, {})[piece.use] = entry
    return {"unit": table.unit, "recordings": recordings, "over_all": plain(table.overall)}


def sampling_summary(posterior: DirectPosterior) -> SamplingSummary:
    """How well a posterior was sampled."""
    diagnostics = posterior.diagnostics
    return {
        "r_hat": max(diagnostics.r_hat.values()),
        "ess_bulk": min(diagnostics.ess_bulk.values()),
        "effective_after_simulation": posterior.effective,
        "outcome": diagnostics.outcome,
        "reasons": list(diagnostics.reasons),
    }
