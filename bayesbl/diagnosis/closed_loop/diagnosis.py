"""Everything that a forward comparison finds, and the answer that it makes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from bayesbl.diagnosis.closed_loop.augment import augmented_bench
from bayesbl.diagnosis.closed_loop.findings import Findings, share_closed
from bayesbl.diagnosis.closed_loop.learned_in_loop import answer_of
from bayesbl.diagnosis.closed_loop.prediction import (
    residuals_of,
)
from bayesbl.diagnosis.closed_loop.suggest import suggested_recording
from bayesbl.diagnosis.diagnosis import (
    GOLDEN_RATIO,
    Diagnosis,
    Estimate,
    LearnedAnswer,
    NamedEffect,
    ParameterError,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import disagreement_table
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP
from bayesbl.naming.criteria import misfit_scale
from bayesbl.naming.explanation import (
    Explanation,
)
from bayesbl.naming.law_forms import (
    FORM_SHARE,
    form_of_gap,
    form_sd,
    is_within_form,
    laws_of_shaft,
)
from bayesbl.naming.naming import Naming
from bayesbl.units import in_words

AVERAGED_DRAWS = 4000
"""Of δ over several explanations, where the chosen one was not sampled."""


def diagnosis_of(
    found: Findings,
    posterior: DirectPosterior | None = None,
    notes: Sequence[str] = (),
    level: float = 0.9,
) -> Diagnosis:
    """The answer.

    Parameters
    ----------
    posterior
        Around ``found.final``. Where there is none or it is withheld, estimates are those of the
        normal approximation.
    level
        Of the intervals.
    """
    naming, final = found.naming, found.final
    sampled = posterior
    if posterior is not None and posterior.diagnostics.outcome == "withheld":
        sampled = None
    named = [(effect, estimates(final, effect.name, sampled)) for effect in naming.effects]
    kinds = {candidate.kind for candidate in final.candidates}
    withheld = _why_no_gap(found, posterior, level)
    form = 0.0 if found.learned else form_sd(naming)
    misfit = math.sqrt(misfit_scale(final.fit))
    gap_is_given = not withheld and GAP in [u.name for u in final.fit.model.unknowns]
    doubts = _doubts_in_words(found, form, misfit) if gap_is_given else ()
    pieces = [residuals for pair in found.pairs for residuals in residuals_of(pair)]
    return Diagnosis(
        verdict_of(
            effects="effect" in kinds,
            parameters="parameter" in kinds,
            remains=naming.repeats or bool(found.remaining) or found.learned is not None,
        ),
        tuple(
            NamedEffect(
                effect.name,
                fitted,
                _probability(naming, effect.name),
                math.sqrt(max(effect.gain, 0.0)),
                effect.members[1:],
            )
            for effect, fitted in named
            if effect.candidate.kind == "effect"
        ),
        tuple(
            ParameterError(
                effect.name,
                found.believed.value(effect.name),
                found.believed.parameters[effect.name].tolerance,
                fitted[effect.name],
                effect.members[1:],
            )
            for effect, fitted in named
            if effect.candidate.kind == "parameter"
        ),
        found.remaining,
        disagreement_table(pieces, in_units_of_noise=True),
        (*notes, *doubts),
        bench_parameters=_declared_parameters(found, sampled),
        delta_before=_delta(naming.nominal),
        delta_after=None if withheld else _delta_after(found, sampled, form, misfit),
        gap_withheld=withheld,
        suggestion=suggested_recording(naming.final, naming.effects),
        posterior=posterior,
        residuals_before=found.residuals_before,
        residuals_after=found.residuals_after,
        ranking=naming.ranking,
        augmented_bench=augmented_bench(final) if final.candidates or found.learned else None,
        learned=_learned_answer(found),
    )


def estimates(
    explanation: Explanation, name: str, posterior: DirectPosterior | None = None
) -> dict[str, Estimate]:
    """Fitted values of one named effect or parameter, with what its bench entry holds fixed.

    A phase that every recording has of its own has the recording's name behind it.
    """
    found: dict[str, Estimate] = {}
    for effect in explanation.fit.model.bench.effects:
        if effect.name == name:
            found |= {k: Estimate(v.value, math.nan) for k, v in effect.parameters.items()}
    for i, unknown in enumerate(explanation.fit.model.unknowns):
        owner, _, parameter = unknown.name.rpartition("__")
        if name in (owner, unknown.name):
            own = unknown.recording
            if own is not None:
                found.pop(parameter, None)
            key = parameter if own is None else f"{parameter} ({own})"
            found[key] = _estimate(explanation, i, posterior)
    return found


def _estimate(explanation: Explanation, i: int, posterior: DirectPosterior | None) -> Estimate:
    """Of one unknown, in the coordinate that was fitted; its draws in the value's unit."""
    fit = explanation.fit
    unknown = fit.model.unknowns[i]
    draws = None if posterior is None else unknown.value(posterior.draws[..., i])
    sd = float(np.sqrt(fit.covariance[i, i]))
    return Estimate(float(fit.point[i]), sd, draws, unknown.logarithmic)


def _delta(explanation: Explanation, posterior: DirectPosterior | None = None) -> Estimate | None:
    names = [u.name for u in explanation.fit.model.unknowns]
    return _estimate(explanation, names.index(GAP), posterior) if GAP in names else None


def _declared_parameters(found: Findings, posterior: DirectPosterior | None) -> dict[str, Estimate]:
    return {
        unknown.name: _estimate(found.final, i, posterior)
        for i, unknown in enumerate(found.final.fit.model.unknowns)
        if unknown.name in found.believed.parameters and unknown.name not in found.final.names
    }


def _probability(naming: Naming, name: str) -> float:
    """Of this name, by evidence over every explanation that was fitted, nothing included."""
    return sum(w for e, w in _weighted(naming) if name in e.names)


def _weighted(naming: Naming) -> list[tuple[Explanation, float]]:
    """Every explanation that was fitted, nothing included, with its share of the evidence.

    All were fitted with the noise of the nominal fit, as evidences of different noise do not
    compare.
    """
    rivals = [rival for effect in naming.effects for rival in effect.indistinguishable]
    found: dict[frozenset[str], Explanation] = {}
    for explanation in (naming.final, *rivals, *naming.alone, naming.nominal):
        found.setdefault(frozenset(explanation.names), explanation)
    logs = np.array([explanation.log_evidence for explanation in found.values()])
    weights = np.exp(logs - logs.max())
    return list(zip(found.values(), map(float, weights / weights.sum()), strict=True))


def _doubts_in_words(found: Findings, form: float, misfit: float) -> Iterator[str]:
    """What the form of a law that is named, and what is left, do to δ."""
    laws = " and ".join(in_words(law.name) for law in laws_of_shaft(found.naming))
    if form > 0.0:
        known = 100.0 * form_of_gap(found.naming)
        yield (
            f"No real shaft follows the law of {laws} exactly. How far it moves the gap is taken "
            f"as known to {known:.0f} %. That is a standard deviation of "
            f"{100.0 * form:.2g} % of the gap, and the gap's interval includes it."
        )
    if found.remaining and is_within_form(found.naming):
        yield (
            f"What is left is less than {100.0 * FORM_SHARE:.1g} % of what {laws} explains. The "
            "form of that law may leave as much, so no other name is given for it."
        )
    if misfit > 1.0:
        yield (
            "What is left still repeats. It counts as noise for the gap, whose interval is "
            f"{misfit:.1f} times as wide for it."
        )


def _delta_after(
    found: Findings, sampled: DirectPosterior | None, form: float, misfit: float
) -> Estimate | None:
    """δ with what was named and learned; ``None`` where it is known.

    ``form``: standard deviation of ln δ that the form of the shaft's named laws adds. ``misfit``:
    of what is left over that of noise. Laws that nothing shows are always included.
    """
    if found.learned is None:
        estimate = _averaged_delta(found.naming, found.final, sampled)
    else:
        estimate = _delta(found.final, sampled)
    if estimate is None or found.law_shifts is None:
        return estimate
    return estimate.widened(misfit, form).shifted(found.law_shifts)


def _why_no_gap(found: Findings, posterior: DirectPosterior | None, level: float) -> str:
    """What was learned leaves δ open, or a tolerance decides it; empty where neither does."""
    told = _learned_answer(found)
    if told is not None:
        return told.gap_withheld
    names = [u.name for u in found.final.fit.model.unknowns]
    if posterior is None or GAP not in names:
        return ""
    return posterior.beyond_tolerance(None, level) or ""


def _learned_answer(found: Findings) -> LearnedAnswer | None:
    if found.learned is None:
        return None
    closed = share_closed(found.residuals_before, found.residuals_after)
    # Noise is told from what remains by its tests, not by a share of little.
    remains = bool(found.remaining) or not agrees(disagreements(found.final.fit))
    return answer_of(found.learned, closed, remains)


def _averaged_delta(
    naming: Naming, final: Explanation, posterior: DirectPosterior | None
) -> Estimate | None:
    """δ over every explanation that the recordings do not exclude, by evidence.

    Of the chosen one the draws, where it was sampled. Each other explanation takes a share of them
    as large as its weight, spread evenly, and puts its normal approximation there.
    """
    chosen = _delta(final, posterior)
    if chosen is None:
        return None
    draws = chosen.normal_draws(AVERAGED_DRAWS) if chosen.draws is None else chosen.draws
    averaged = draws.ravel().copy()
    order, begin = np.argsort(np.arange(averaged.size) * GOLDEN_RATIO % 1.0), 0
    for explanation, weight in _weighted(naming):
        other, count = _delta(explanation), round(weight * averaged.size)
        if explanation is naming.final or other is None or count == 0:
            continue
        averaged[order[begin : begin + count]] = other.normal_draws(count)
        begin += count
    if begin == 0:
        return chosen
    coordinate = np.log(averaged) if chosen.logarithmic else averaged
    return Estimate(
        float(coordinate.mean()),
        float(coordinate.std()),
        averaged.reshape(draws.shape),
        chosen.logarithmic,
    )
