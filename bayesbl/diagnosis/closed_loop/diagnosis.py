"""Everything that a forward comparison finds, and the answer that it makes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.diagnosis.closed_loop.augment import augmented_bench
from bayesbl.diagnosis.closed_loop.findings import Findings
from bayesbl.diagnosis.closed_loop.learned_in_loop import answer_of
from bayesbl.diagnosis.closed_loop.prediction import residuals_of, signals_of
from bayesbl.diagnosis.closed_loop.suggest import suggested_recording
from bayesbl.diagnosis.diagnosis import (
    Diagnosis,
    Estimate,
    LearnedAnswer,
    NamedEffect,
    ParameterError,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import disagreement_table
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import GAP
from bayesbl.model_search.closed_loop import Naming, laws_of_shaft, log_gap_of, shares_of_others
from bayesbl.model_search.refit import Explanation
from bayesbl.recording.types import FloatArray
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
    gap_is_given = not withheld and GAP in [u.name for u in final.fit.model.unknowns]
    doubts = _doubts_in_words(found) if gap_is_given else ()
    after = None if withheld else _delta_after(found, sampled)
    if sampled is not None and after is not None and after.draws is not None:
        # What is stored is what is told.
        draws = sampled.draws.copy()
        draws[..., final.fit.model.index(GAP)] = np.log(after.draws)
        posterior = replace(sampled, draws=draws)
    shown = [pair for pair in found.pairs if pair.use == "held_out"] or found.pairs
    pieces = [residuals for pair in found.pairs for residuals in residuals_of(pair)]
    return Diagnosis(
        verdict_of(
            effects="effect" in kinds,
            parameters="parameter" in kinds,
            remains=naming.repeats or bool(found.after.remaining) or found.learned is not None,
        ),
        tuple(
            NamedEffect(
                effect.name,
                fitted,
                effect.probability,
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
        found.after.remaining,
        disagreement_table(pieces, in_units_of_noise=True),
        (*notes, *doubts),
        bench_parameters=_declared_parameters(found, sampled),
        delta_before=_delta(naming.nominal),
        delta_after=after,
        gap_withheld=withheld,
        suggestion=suggested_recording(naming.final, naming.effects),
        posterior=posterior,
        signals=tuple(signals for pair in shown for signals in signals_of(pair)),
        residuals_before=found.before,
        residuals_after=found.after,
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


def _doubts_in_words(found: Findings) -> Iterator[str]:
    """What the form of a law that is named, and what is left, do to δ."""
    wider = _misfit_factor(found)
    if wider > 1.05:
        laws = [in_words(c.name) for c in laws_of_shaft(found.naming.final)]
        why = "Something repeats that no name explains."
        if laws:
            why = f"No real shaft follows the law of {' and '.join(laws)} exactly."
        yield f"{why} The gap's interval is {wider:.2g} times as wide for it."


def _misfit_factor(found: Findings) -> float:
    """Standard deviation of ln δ with the misfit over that by noise alone."""
    own, place = found.chosen, found.final.fit.model.index(GAP)
    by_noise = float(own.fit.covariance[place, place])
    return max(1.0, math.sqrt(float(own.covariance[place, place]) / by_noise))


def _delta_after(found: Findings, sampled: DirectPosterior | None) -> Estimate | None:
    """δ of the average over all sets, with laws that nothing shows; ``None`` where it is known."""
    chosen = _delta(found.final, sampled)
    if chosen is None or found.law_shifts is None:
        return chosen
    rng, naming = np.random.default_rng(0), found.naming
    shape = (AVERAGED_DRAWS,) if chosen.draws is None else chosen.draws.shape
    size = math.prod(shape)
    own = log_gap_of(found.chosen, rng, size)
    if chosen.draws is not None:
        logs = np.log(chosen.draws.ravel())
        own = logs.mean() + _misfit_factor(found) * (logs - logs.mean())
    averaged = own if found.learned else _averaged(naming, own, found.final.keys, rng)
    averaged = averaged + rng.permutation(np.resize(found.law_shifts, size))
    draws = None if chosen.draws is None else np.exp(averaged).reshape(shape)
    return Estimate(float(averaged.mean()), float(averaged.std()), draws, logarithmic=True)


def _averaged(
    naming: Naming,
    own: FloatArray,
    keys: frozenset[tuple[str, float | None]],
    rng: np.random.Generator,
) -> FloatArray:
    """Draws of ln δ of the chosen set, with each other one in its share of them, (n,)."""
    averaged = own.copy()
    for other, rows in shares_of_others(naming, keys, own.size, rng):
        averaged[rows] = log_gap_of(other, rng, rows.size)
    return averaged


def _why_no_gap(found: Findings, posterior: DirectPosterior | None, level: float) -> str:
    """What is missing or was learned leaves δ open, or a tolerance decides it; else empty."""
    told = _learned_answer(found)
    if told is not None:
        return told.gap_withheld
    names = [u.name for u in found.final.fit.model.unknowns]
    if GAP not in names:
        return ""
    if found.naming.repeats:
        return (
            "Something repeats that neither the bench nor the catalogue explains. It may move the "
            "gap by more than anything else, so no gap is given. Record another speed or "
            "direction, and look at the residuals."
        )
    return "" if posterior is None else posterior.beyond_tolerance(None, level) or ""


def _learned_answer(found: Findings) -> LearnedAnswer | None:
    if found.learned is None:
        return None
    closed = found.after.closes(found.before)
    # Noise is told from what remains by its tests, not by a share of little.
    remains = bool(found.after.remaining) or not is_explained(found.final.fit)
    return answer_of(found.learned, closed, remains)
