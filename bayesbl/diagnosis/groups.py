"""``summary.json`` of a diagnosis, and the groups of ``result.nc``.

``signals``: measured and predicted values of every piece (a channel of a recording, or of a part of
it); of a closed loop, of the held-out pieces. ``posterior``: draws of all unknowns, with the named
effects. ``learned_torque``, ``encoder_error``: the learned term over its variable. A group without
contents is left out.

The root attribute ``summary`` is the answer in the words of ``summary.json``, as JSON;
``augmented_bench`` is a bench file with the named effects.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from statistics import NormalDist
from typing import Any, Literal, NotRequired, TypedDict

import xarray as xr

from bayesbl.bench.learned import ENCODER_ERROR, LEARNED_TORQUE, LearnedTerm, Side
from bayesbl.bench.learned import Variable as LearnedVariable
from bayesbl.config.bench import dump_bench
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, Verdict
from bayesbl.diagnosis.disagreement import ComparedPiece, DisagreementTableSummary
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.measurement.direct_route import result_name, unit_and_meaning
from bayesbl.measurement.shared_groups import CHAIN, DRAW
from bayesbl.results.folder import AUGMENTED_BENCH
from bayesbl.results.store import Head, Interval, IntervalKind, interval
from bayesbl.results.variables import Group, Variable, columns, dataset, padded, table
from bayesbl.sentences import flaws_in_words
from bayesbl.units import unit_of


class HeldValue(TypedDict):
    """An interval without bounds: the value was not fitted."""

    median: float
    low: None
    high: None
    level: float
    kind: IntervalKind


class EffectSummary(TypedDict):
    """A named effect with the intervals of its parameters."""

    name: str
    parameters: dict[str, Interval | HeldValue]
    probability: float
    z: float
    indistinguishable_from: list[str]


class ParameterErrorSummary(TypedDict):
    """A bench parameter whose value differs from its file."""

    name: str
    believed: float
    tolerance: float
    fitted: Interval | HeldValue
    indistinguishable_from: list[str]


class RemainingSummary(TypedDict):
    """What remains after naming; ``chi_squared`` is null if its test has none."""

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
    """Side and variable of a learned term; ``period`` in rad, rad/s or s."""

    side: Side | Literal["encoder"]
    variable: LearnedVariable
    reverses: bool
    period: float
    orders: int


class LearnedSummary(LearnedDependence):
    """A torque without a known law, or an error of the encoder.

    ``amplitude_nm``, ``amplitude_rad``: largest value, at its side. ``alike``: other dependences
    that these recordings do not distinguish from it.
    """

    amplitude_nm: NotRequired[float]
    amplitude_rad: NotRequired[float]
    alike: list[LearnedDependence]


class SuggestedRecording(TypedDict):
    """A recording that would distinguish what these cannot."""

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
    """Answer of a diagnosis."""

    verdict: Verdict
    effects: list[EffectSummary]
    parameter_errors: list[ParameterErrorSummary]
    bench_parameters: dict[str, Interval | HeldValue]
    remaining: list[RemainingSummary]
    disagreement: DisagreementTableSummary
    delta_rad_before: Interval | None
    delta_rad_after: Interval | None
    gaps: NotRequired[dict[str, Interval]]
    gap_withheld: NotRequired[str]
    suggested_recording: SuggestedRecording | None
    augmented_bench: NotRequired[str]
    learned_torque: NotRequired[LearnedSummary]
    encoder_error: NotRequired[LearnedSummary]
    diagnostics: NotRequired[SamplingSummary]


class DiagnosisSummary(Head, Answer):
    """``summary.json``."""

    kind: Literal["diagnose"]


def answer_of(diagnosis: Diagnosis, level: float, kind: IntervalKind) -> Answer:
    """The answer with credible intervals of this level and kind."""

    def of(value: object) -> Any:
        return plain(value, lambda estimate: interval_of(estimate, level, kind))

    answer: Answer = {
        "verdict": diagnosis.verdict,
        "effects": of(diagnosis.effects),
        "parameter_errors": of(diagnosis.parameter_errors),
        "bench_parameters": of(diagnosis.bench_parameters),
        "remaining": of(diagnosis.remaining),
        "disagreement": diagnosis.disagreement,
        "delta_rad_before": of(diagnosis.delta_before),
        "delta_rad_after": of(diagnosis.delta_after),
        "suggested_recording": of(diagnosis.suggestion),
    }
    if diagnosis.gaps:
        answer["gaps"] = of(diagnosis.gaps)
    if diagnosis.gap_withheld:
        answer["gap_withheld"] = diagnosis.gap_withheld
    if diagnosis.augmented_bench is not None:
        answer["augmented_bench"] = AUGMENTED_BENCH
    if diagnosis.learned is not None:
        alike = [_dependence(other) for other in diagnosis.learned.alike]
        learned = _dependence(diagnosis.learned.term) | {"alike": alike}
        if diagnosis.learned.term.is_of_encoder:
            learned["amplitude_rad"] = diagnosis.learned.amplitude
            answer["encoder_error"] = learned
        else:
            learned["amplitude_nm"] = diagnosis.learned.amplitude
            answer["learned_torque"] = learned
    if diagnosis.posterior is not None:
        answer["diagnostics"] = sampling_summary(diagnosis.posterior)
    return answer


def _dependence(term: LearnedTerm) -> Any:
    """The keys of :class:`LearnedDependence`, as the term has them."""
    return {key: getattr(term, key) for key in LearnedDependence.__annotations__}


def interval_of(estimate: Estimate, level: float, kind: IntervalKind) -> Interval | HeldValue:
    """Interval from draws; without draws, of a normal or lognormal distribution."""
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
    """A value for JSON: dataclasses become objects, tuples lists, NaN null."""
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


def sampling_summary(posterior: DirectPosterior) -> SamplingSummary:
    """How well a posterior was sampled."""
    diagnostics = posterior.diagnostics
    return {
        "r_hat": max(diagnostics.r_hat.values()),
        "ess_bulk": min(diagnostics.ess_bulk.values()),
        "effective_after_simulation": posterior.effective,
        "outcome": diagnostics.outcome,
        "reasons": flaws_in_words(diagnostics.reasons),
    }


def signals_group(unit: str) -> Group:
    """Signals in the unit of their channel; a row for each :class:`ComparedPiece`."""
    return Group(
        "signals",
        table(f"""
            time_s (piece, sample) | s | time
            measured (piece, sample) | {unit} | measured
            before (piece, sample) | {unit} | bench without the named effects
            after (piece, sample) | {unit} | bench with the named effects
        """),
        table("""
            recording (piece) | text | recording
            channel (piece) | text | channel
            use (piece) | text | fitted on (used) or predicted (held_out)
        """),
    )


def _unknown(name: str) -> Variable:
    """Variable of an unknown, whose label may end with a recording in parentheses."""
    shared, _, recording = name.removesuffix(")").partition(" (")
    unit, meaning = unit_and_meaning(shared)
    return Variable(
        name, ("chain", "draw"), unit, f"{meaning}, {recording}" if recording else meaning
    )


POSTERIOR = Group("posterior", coordinates=(CHAIN, DRAW), named=_unknown)

LEARNED = {
    LEARNED_TORQUE: Group(
        LEARNED_TORQUE,
        table("""
            torque_nm (point) | N m | learned torque against the side it acts at, turning forwards
            sd_nm (point) | N m | its standard deviation
        """),
        table("variable (point) | 1 | what it depends on, in rad, rad/s or s"),
    ),
    ENCODER_ERROR: Group(
        ENCODER_ERROR,
        table("""
            angle_rad (point) | rad | error of the motor's encoder
            sd_rad (point) | rad | its standard deviation
        """),
        table("variable (point) | rad | angle of the motor"),
    ),
}
"""Groups of learned terms, by their blocks."""


def diagnosis_tree(diagnosis: Diagnosis, level: float, kind: IntervalKind) -> xr.DataTree:
    """The whole result without its provenance; ``level``, ``kind``: of the credible intervals."""
    groups = {}
    if diagnosis.signals:
        groups["signals"] = signals_dataset(diagnosis.signals)
    if diagnosis.posterior is not None:
        posterior = posterior_dataset(diagnosis.posterior)
        first = diagnosis.posterior.fit.model.recordings[0].name
        groups["posterior"] = posterior.assign(delta_rad=posterior[f"delta_rad ({first})"])
    if diagnosis.learned is not None:
        curve, group = diagnosis.learned, LEARNED[diagnosis.learned.term.block]
        size, sd = (variable.name for variable in group.variables)
        groups[group.name] = dataset(
            group, {size: curve.value, sd: curve.sd}, {"variable": curve.variable}
        )
    tree = xr.DataTree.from_dict(groups)
    doubts = diagnosis.posterior is not None and bool(diagnosis.posterior.diagnostics.reasons)
    bench = diagnosis.augmented_bench
    tree.attrs = {
        "kind": "diagnose",
        "outcome": "usable" if doubts else "converged",
        "reason": "",
        "warnings": list(diagnosis.notes),
        "interval_level": level,
        "interval_kind": kind,
        "summary": json.dumps(answer_of(diagnosis, level, kind), ensure_ascii=False),
        "augmented_bench": "" if bench is None else dump_bench(bench),
    }
    return tree


def signals_dataset(signals: Sequence[ComparedPiece]) -> xr.Dataset:
    """Signals of pieces, padded with NaN to the longest."""
    units = {unit_of(piece.channel) for piece in signals}
    group = signals_group(units.pop() if len(units) == 1 else "as the channel")
    values = columns(group, signals)
    longest = max(piece.time_s.size for piece in signals)
    values |= {
        v.name: padded([getattr(s, v.name) for s in signals], longest) for v in group.variables
    }
    return dataset(group, values)


def posterior_dataset(posterior: DirectPosterior) -> xr.Dataset:
    """Draws of every unknown in its own unit."""
    values = {}
    for i, unknown in enumerate(posterior.fit.model.unknowns):
        name = result_name(unknown)
        label = name if unknown.recording is None else f"{name} ({unknown.recording})"
        values[label] = unknown.value(posterior.draws[..., i])
    return dataset(POSTERIOR, values)
