"""``summary.json`` of an identification, the groups of ``result.nc``, and reasons for withholding.

``identified``: prior and posterior of the bench's parameters, with their joint normal prior for
later use; ``posterior``: draws of all unknowns. The root attribute ``identification`` is the answer
in the words of ``summary.json``, as JSON. ``identified_bench`` is a bench file.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import combinations
from typing import Literal, NotRequired, TypedDict

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import with_bench_file_hint
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.config.bench import dump_bench
from bayesbl.diagnosis.closed_loop.diagnosis import estimates
from bayesbl.diagnosis.closed_loop.prediction import compared_pieces
from bayesbl.diagnosis.disagreement import DisagreementTableSummary, disagreement_table
from bayesbl.diagnosis.groups import (
    HeldValue,
    SamplingSummary,
    interval_of,
    plain,
    posterior_dataset,
    sampling_summary,
)
from bayesbl.errors import SimulationError
from bayesbl.identification.identify import (
    BeyondDataSheet,
    Identification,
    Problem,
    Verdict,
    identified_bench,
    is_plausible,
    parameter_draws,
)
from bayesbl.identification.next_recording import NextRecordingSummary, next_recording
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.predictive_check import RepeatingPower, agrees, standing_out
from bayesbl.matching.signals import GAP
from bayesbl.model_search.refit import Explanation
from bayesbl.recording.types import FloatArray
from bayesbl.results.folder import IDENTIFIED_BENCH
from bayesbl.results.identified import IDENTIFIED
from bayesbl.results.store import Head, Interval, IntervalKind, interval
from bayesbl.results.variables import dataset
from bayesbl.sentences import flaws_in_words
from bayesbl.units import in_words


class PriorSummary(TypedDict):
    """Value of the data sheet, and the range within its tolerance."""

    value: float
    low: float
    high: float


class ParameterSummary(TypedDict):
    """``learned``: 1 − posterior sd / prior sd."""

    unit: str
    prior: PriorSummary
    posterior: Interval
    learned: float


class EffectFound(TypedDict):
    """A missing or fitted effect; it has ``parameters`` if it is in the identified bench."""

    name: str
    parameters: dict[str, Interval | HeldValue]
    indistinguishable_from: list[str]


class BeyondSummary(TypedDict):
    """A value of the data sheet that the recordings contradict."""

    name: str
    believed: float
    tolerance: float
    found: float
    deviations: float
    could_be: list[str]


class TogetherSummary(TypedDict):
    """Parameters known far better together than alone: by the ratios of all, or the product of two.

    ``alone_sd``: largest relative standard deviation of one; ``together_sd``: that of their ratios
    or product.
    """

    parameters: list[str]
    told: Literal["ratios", "product"]
    alone_sd: float
    together_sd: float


class IdentificationAnswer(TypedDict):
    """Answer of an identification; ``gaps`` are null where they are withheld."""

    verdict: Verdict
    parameters: dict[str, ParameterSummary]
    gaps: dict[str, Interval | None]
    effects: list[EffectFound]
    missing: list[list[str]]
    data_sheet_error: BeyondSummary | None
    not_told_apart: list[TogetherSummary]
    disagreement: DisagreementTableSummary
    suggested_recording: NextRecordingSummary | None
    diagnostics: SamplingSummary
    bench: NotRequired[str]


class IdentificationSummary(Head, IdentificationAnswer):
    """``summary.json``."""

    kind: Literal["identify"]


SHARPER = 0.5
"""Largest spread of a reported combination, relative to that of its sharper member. It changes
words, not numbers."""


def identification_tree(
    result: Identification, problem: Problem, level: float, kind: IntervalKind
) -> xr.DataTree:
    """The whole result, without its origin.

    ``level``, ``kind``: of the credible intervals.
    """
    table = _disagreement(result, problem)
    bench = identified_bench(result, problem)
    reason = reason_of(result)
    answer = _answer(result, problem, table, level, kind, withheld=reason is not None)
    tree = xr.DataTree.from_dict(
        {
            "identified": _identified(result, problem, bench),
            "posterior": posterior_dataset(result.posterior),
        }
    )
    doubts = flaws_in_words(result.posterior.diagnostics.reasons)
    doubts = [*misfit_in_words(result), *doubts]
    outcome = "withheld" if reason else ("usable" if doubts else "converged")
    tree.attrs = {
        "kind": "identify",
        "outcome": outcome,
        "reason": reason or "",
        "warnings": [] if reason else doubts,
        "interval_level": level,
        "interval_kind": kind,
        "summary": json.dumps(answer, ensure_ascii=False),
        "identified_bench": "" if reason else dump_bench(bench),
    }
    return tree


def _identified(result: Identification, problem: Problem, bench: Bench) -> xr.Dataset:
    names, joint = list(problem.parameters), bench.identified
    covariance = np.full((len(names), len(names)), np.nan)
    if joint is not None:
        indices = [names.index(name) for name in joint.names]
        covariance[np.ix_(indices, indices)] = joint.covariance
    prior = np.array([problem.bench.value(name) for name in names])
    half = np.array([problem.bench.tolerances[name] for name in names])
    values = {
        "prior_low": prior - half,
        "prior_high": prior + half,
        "value": [bench.value(name) for name in names],
        "log_covariance": covariance,
    }
    return dataset(IDENTIFIED, values, {"parameter": names, "parameter_": names})


def _disagreement(result: Identification, problem: Problem) -> DisagreementTableSummary:
    """Disagreement with the data sheet's values (gap and start angles fitted), and with the final.

    An implausible data sheet is not simulated: ``final`` replaces it, so the two do not differ.
    """
    identified = set(problem.parameters)
    unknowns = [u for u in problem.unknowns if u.name not in identified]
    before = result.final
    if is_plausible(problem):
        sheet = fit_aligned(problem.bench, problem.used, unknowns, problem.workers)
        before = Explanation((), sheet)
    pieces = compared_pieces(before, result.final, problem.held_out)
    return disagreement_table(pieces)


def _answer(
    result: Identification,
    problem: Problem,
    table: DisagreementTableSummary,
    level: float,
    kind: IntervalKind,
    *,
    withheld: bool,
) -> IdentificationAnswer:
    draws = parameter_draws(result, problem.parameters)
    positive = [i for i, column in enumerate(draws.T) if column.min() > 0.0]
    together = not_told_apart([problem.parameters[i] for i in positive], draws[:, positive])
    answer: IdentificationAnswer = {
        "verdict": result.verdict,
        "parameters": {
            name: _parameter(problem.bench, name, column, level, kind)
            for name, column in zip(problem.parameters, draws.T, strict=True)
        },
        "gaps": {
            name: None if withheld else interval(result.posterior.values(GAP, name), level, kind)
            for name in (observation.name for observation in problem.used)
        },
        "effects": [
            {
                "name": name,
                "parameters": {
                    parameter: interval_of(estimate, level, kind)
                    for parameter, estimate in estimates(
                        result.final, name, result.posterior
                    ).items()
                },
                "indistinguishable_from": [
                    other for first, *rest in result.missing if first == name for other in rest
                ],
            }
            for name in _free_effects(result.final)
        ],
        "missing": [list(members) for members in result.missing],
        "data_sheet_error": plain(result.beyond),
        "not_told_apart": together,
        "disagreement": table,
        "suggested_recording": _suggested(result.final),
        "diagnostics": sampling_summary(result.posterior),
    }
    if not withheld:
        answer["bench"] = IDENTIFIED_BENCH
    return answer


def _free_effects(final: Explanation) -> list[str]:
    """Effects with unknown parameters: friction, the bench's uncertain effects, and named ones."""
    model = final.fit.model
    unknown_effects = {unknown.name.partition("__")[0] for unknown in model.unknowns}
    return [effect.name for effect in model.bench.effects if effect.name in unknown_effects]


def _suggested(final: Explanation) -> NextRecordingSummary | None:
    try:
        return next_recording(final.fit)
    except (SimulationError, np.linalg.LinAlgError):
        return None  # a suggestion is not worth a result


def _parameter(
    bench: Bench, name: str, draws: FloatArray, level: float, kind: IntervalKind
) -> ParameterSummary:
    value, half = bench.value(name), bench.tolerances[name]
    return {
        "unit": PARAMETER_INFO[name].unit,
        "prior": {"value": value, "low": value - half, "high": value + half},
        "posterior": interval(draws, level, kind),
        "learned": 1.0 - float(draws.std()) / (half / np.sqrt(3.0)),
    }


def not_told_apart(names: Sequence[str], draws: FloatArray) -> list[TogetherSummary]:
    """Groups known by their ratios, each parameter in at most one; pairs known by their product.

    ``draws``: of all parameters, above zero, shape (n, k).
    """
    logarithms = np.log(draws)
    alone = logarithms.std(axis=0)

    def sd(i: int, j: int, sign: float) -> float:
        return float((logarithms[:, i] + sign * logarithms[:, j]).std())

    def is_sharp(i: int, j: int, sign: float) -> bool:
        return sd(i, j, sign) < SHARPER * float(min(alone[i], alone[j]))

    confounded: list[tuple[Sequence[int], Literal["ratios", "product"], float]] = []
    remaining: list[int] = np.argsort(alone).tolist()
    while remaining:
        first, *remaining = remaining
        group = sorted([first, *(k for k in remaining if is_sharp(k, first, -1.0))])
        remaining = [k for k in remaining if k not in group]
        if len(group) > 1:
            confounded.append(
                (group, "ratios", max(sd(*pair, -1.0) for pair in combinations(group, 2)))
            )
    groups = [set(group) for group, *_ in confounded]
    for pair in combinations(range(len(names)), 2):
        if is_sharp(*pair, 1.0) and not any(group.issuperset(pair) for group in groups):
            confounded.append((pair, "product", sd(*pair, 1.0)))
    return [
        {
            "parameters": [names[i] for i in group],
            "told": kind,
            "alone_sd": float(alone[list(group)].max()),
            "together_sd": together,
        }
        for group, kind, together in confounded
    ]


def reason_of(result: Identification) -> str | None:
    """Reason for withholding gaps and bench; ``None`` if they are reported."""
    if result.missing and not result.completed:
        return _lacking(result)
    if result.beyond is not None:
        return beyond_in_words(result.beyond)
    unexplained = result.verdict == "unexplained" and not result.allows_for_misfit
    # Something may still repeat although effects were named.
    if unexplained or (result.completed and not agrees(result.check)):
        return (
            "No values within the tolerances, no single value beyond them and no effect of the "
            "catalogue explain these recordings: the bench lacks something that the joint has, "
            "or several values of the data sheet are wrong. "
            f"{left_over(result.check)} Check the data sheet, or widen its tolerances."
        )
    if result.posterior.diagnostics.outcome == "withheld":
        return " ".join(flaws_in_words(result.posterior.diagnostics.reasons))
    # The bench is the answer: a value that its data sheet excludes is no answer, even if δ is fine.
    if contradicted := flaws_in_words(result.posterior.contradicted):
        advice = "Correct the data sheet, or widen this tolerance, and identify again."
        return " ".join([*contradicted, advice])
    return None


def misfit_in_words(result: Identification) -> list[str]:
    """Warning to a user of gaps and bench about unexplained misfit; empty without it."""
    if not result.allows_for_misfit:
        return []
    return [
        f"The bench lacks something that the joint has. {left_over(result.check)} All intervals "
        "include its possible effect. `bayesbl diagnose` looks for what is missing."
    ]


def _lacking(result: Identification) -> str:
    names = " and ".join(" or ".join(map(in_words, members)) for members in result.missing)
    lacks = (
        f"The bench lacks an effect that these recordings show: {names}. Have it found "
        '(--effects catalogue, or effects = "catalogue" under [identify]), or add it to the '
        "data sheet under [[effects]]."
    )
    return with_bench_file_hint(lacks, (members[0] for members in result.missing))


def beyond_in_words(wrong: BeyondDataSheet) -> str:
    """Which value of the data sheet is wrong, by how much, and which others it could be."""
    text = (
        f"{wrong.name} is {wrong.deviations:.0f} standard deviations outside its data sheet: "
        f"{wrong.found:.4g} by the recordings, not {wrong.believed:.4g} ± {wrong.tolerance:.2g}."
    )
    if wrong.could_be:
        text += f" It could also be {' or '.join(wrong.could_be)}."
    return text + " Correct the data sheet, or widen this tolerance, and identify again."


def left_over(check: Sequence[RepeatingPower]) -> str:
    """Where recording and simulation disagree most."""
    worst = max(standing_out(check) or check, key=lambda entry: entry.ratio)
    where = f"orders up to {worst.highest_order}" if worst.highest_order else "the mean"
    return (
        f"The disagreement is largest in {worst.channel} of {worst.recording}, {where}: "
        f"{worst.ratio:.3g} times the power expected from noise."
    )
