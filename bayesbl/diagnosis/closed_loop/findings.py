"""What a forward comparison finds: names, what is learned beside them, and what they leave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.closed_loop.learned_in_loop import Learned, learned_term
from bayesbl.diagnosis.closed_loop.prediction import (
    SimulatedPair,
    simulated_pairs,
)
from bayesbl.diagnosis.residuals.analysis import ResidualAnalysis, analyse_residuals
from bayesbl.diagnosis.residuals.unexplained import Unexplained, describe_unexplained
from bayesbl.errors import BenchError
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP, START_ANGLE, Unknown
from bayesbl.model_search.always_in import beside, laws
from bayesbl.naming.candidates import candidates
from bayesbl.naming.criteria import ENOUGH_CLOSED, enough_closed, left
from bayesbl.naming.explanation import (
    Explanation,
    effects_alone,
    nominal_explanation,
    reduced,
    with_own_noise,
)
from bayesbl.naming.law_forms import is_within_form, without_mends
from bayesbl.naming.naming import Naming
from bayesbl.naming.search import name_missing
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray

MOST_EFFECTS = 3

SHIFTS_DRAWN = 4000

LEAST_LEARNED = 0.5
"""Of what repeats: what removes less than half of it is not what repeats."""


@dataclass(frozen=True, slots=True)
class ForwardSettings:
    """What may be named, and how surely; as ``[candidates]`` and ``[comparison]`` say."""

    effects: Sequence[str] | None = None
    max_effects: int = MOST_EFFECTS
    false_alarm: float = 0.01
    load_angle_known: bool = False
    motor_angle_known: bool = False
    workers: int = field(default=1, compare=False)


@dataclass(frozen=True, slots=True)
class Findings:
    """The search and what its simulations leave.

    Attributes
    ----------
    believed
        The bench as its file says.
    final
        With everything that is named, its noise estimated without what was missing.
    pairs
        Recordings, those that were held out too, beside both simulations.
    remaining
        What still stands out after naming.
    learned
        What was learned from what naming left; ``final`` has it.
    law_shifts
        Draws of what laws that nothing shows add to ln δ; ``None`` where no gap is sought.
    """

    believed: Bench
    naming: Naming
    final: Explanation
    pairs: tuple[SimulatedPair, ...]
    residuals_before: ResidualAnalysis
    residuals_after: ResidualAnalysis
    remaining: tuple[Unexplained, ...]
    learned: Learned | None = None
    law_shifts: FloatArray | None = None


def search(
    bench: Bench,
    used: Sequence[Observed],
    held_out: Sequence[Observed],
    unknowns: Sequence[Unknown],
    settings: ForwardSettings,
    progress: Progress | None = None,
) -> Findings:
    """Align, name what is missing, and analyse what it leaves.

    Parameters
    ----------
    used, held_out
        Recordings to fit on, and to predict.
    unknowns
        Declared: gap, start angles, bench parameters.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    nominal = fit_aligned(bench, used, unknowns, settings.workers)
    catalogue = partial(
        candidates,
        bench,
        used,
        "all" if settings.effects is None else settings.effects,
        declared=[u.name for u in unknowns],
        load_angle_known=settings.load_angle_known,
        motor_angle_known=settings.motor_angle_known,
        gap_is_unknown=any(u.name == GAP for u in unknowns),
    )
    missing = partial(
        name_missing,
        candidates=catalogue,
        max_effects=settings.max_effects,
        false_alarm=settings.false_alarm,
        progress=progress,
    )
    compared = partial(_compared, nominal_explanation(nominal), held_out)
    naming, final = _enough_closed(missing(nominal), compared)
    result, learned = compared(final), None
    if naming.repeats or (result.remaining and not is_within_form(naming)):
        beside = _with_learned(naming, final, compared, missing, settings)
        if beside is not None:
            naming, learned = beside
            final = learned.explanation
            result = compared(final)
    return Findings(
        bench,
        naming,
        final,
        result.pairs,
        _analysis(result.pairs, naming.nominal, "before"),
        result.after,
        result.remaining,
        learned,
        _law_shifts(final.fit),
    )


def _law_shifts(fit: SimulatedFit) -> FloatArray | None:
    """See :mod:`bayesbl.model_search.always_in`."""
    gaps = [k for k, u in enumerate(fit.model.unknowns) if u.name == GAP]
    if not gaps:
        return None
    rest = beside(fit, laws(fit.model.bench))
    drawn = rest.posterior.draw(np.random.default_rng(0), SHIFTS_DRAWN)
    return np.asarray(drawn.shift[:, gaps[0]])


def _enough_closed(naming: Naming, compared: _Compared) -> tuple[Naming, Explanation]:
    """The names that remove enough of what is no noise, and the explanation by them.

    What was missing is not noise: intervals rest on the noise estimated without it.
    """
    if not naming.final.candidates:
        return naming, naming.final
    final = with_own_noise(naming.final)
    if _is_closed(naming.nominal, compared(final), final):
        return naming, final
    # More is asked of parameters: the effects may do without them.
    fewer = effects_alone(naming.nominal, naming.final)
    if fewer is not None:
        final = with_own_noise(fewer)
        naming = _with_candidates(replace(naming, final=fewer), final)
        if _is_closed(naming.nominal, compared(final), final):
            return naming, final
    # It helps a little, as a parameter may where a line in time remains: no explanation.
    nearest, nominal = naming.final, naming.nominal
    return replace(naming, repeats=True, final=nominal, effects=(), nearest=nearest), nominal


def _with_learned(
    naming: Naming,
    final: Explanation,
    compared: _Compared,
    missing: Callable[[SimulatedFit], Naming],
    settings: ForwardSettings,
) -> tuple[Naming, Learned] | None:
    """What is learned from what is left, with the names that stand beside it."""
    learned = _learned(final, naming, compared, settings)
    if learned is None:
        return None
    names = _with_candidates(naming, learned.explanation)
    if not names.effects and not agrees(disagreements(learned.explanation.fit)):
        # Behind what was learned a law of the catalogue may have been hidden.
        explained = left(naming.nominal) - left(learned.explanation)
        beside = without_mends(missing(learned.explanation.fit), explained)
        if beside.effects:
            learned = learned.beside(with_own_noise(beside.final))
            names = replace(beside, nominal=naming.nominal, alone=naming.alone)
    closed = share_closed(compared(final).after, compared(learned.explanation).after)
    return None if closed < LEAST_LEARNED else (names, learned)


def _learned(
    final: Explanation, naming: Naming, compared: _Compared, settings: ForwardSettings
) -> Learned | None:
    """What is learned from what an explanation leaves, or the nearest one where nothing explains.

    That one is tried where learning from the nominal bench does not close all: its gap may be too
    far off to learn anything beside it. Its names are left out again, as it is no explanation.
    """
    best, most = None, LEAST_LEARNED
    bases = [final]
    if naming.nearest is not None and naming.nearest.candidates:
        bases.append(with_own_noise(naming.nearest))
    for base in bases:
        if most >= ENOUGH_CLOSED:
            break
        without = compared(base)
        learned = learned_term(
            base, without.remaining, settings.false_alarm, settings.motor_angle_known
        )
        if learned is None:
            continue
        share = share_closed(without.after, compared(learned.explanation).after)
        if share >= most:
            best, most = learned, share
    if best is None or not naming.repeats:
        return best
    with suppress(BenchError):
        return best.alone()
    return None


@dataclass(frozen=True, slots=True)
class _Comparison:
    """Recordings beside both simulations, and what the later one leaves."""

    pairs: tuple[SimulatedPair, ...]
    after: ResidualAnalysis
    remaining: tuple[Unexplained, ...]


_Compared = Callable[[Explanation], _Comparison]


def _compared(
    nominal: Explanation, held_out: Sequence[Observed], explanation: Explanation
) -> _Comparison:
    pairs = tuple(simulated_pairs(nominal, explanation, held_out))
    after = _analysis(pairs, explanation, "after")
    return _Comparison(pairs, after, tuple(describe_unexplained(after)))


def _is_closed(nominal: Explanation, result: _Comparison, final: Explanation) -> bool:
    """Whether an explanation leaves nothing, or removes enough of what is no noise."""
    if not result.remaining or not final.candidates:
        return True
    before = _analysis(result.pairs, nominal, "before")
    return share_closed(before, result.after) >= enough_closed(final)


def _with_candidates(naming: Naming, final: Explanation) -> Naming:
    """Without the names that what was learned has made superfluous."""
    idle = [k for k, name in enumerate(naming.final.names) if name not in final.names]
    if idle:
        less = reduced(naming.nominal, naming.final, idle)
        naming = replace(naming, final=less or naming.nominal)
    kept = tuple(e for e in naming.effects if e.candidate.label in naming.final.names)
    return replace(naming, effects=kept)


def _analysis(
    pairs: Sequence[SimulatedPair], explanation: Explanation, stage: Literal["before", "after"]
) -> ResidualAnalysis:
    used = [pair for pair in pairs if pair.use == "used"]
    angles = [_start_angle(explanation, pair.seen) for pair in used]
    predictions = [pair.before if stage == "before" else pair.after for pair in used]
    # Bridged samples hold nothing that repeats.
    seen = [
        replace(pair.seen, signals=made + pair.seen.left_by(made))
        for pair, made in zip(used, predictions, strict=True)
    ]
    return analyse_residuals(seen, predictions, angles)


def share_closed(before: ResidualAnalysis, after: ResidualAnalysis) -> float:
    """Of the power, in units of the noise, that is no noise: repeating or not."""
    first, last = (
        sum(
            (c.split.offset + c.repeating_rms**2 + c.split.other) / c.noise_sd**2
            for recording in analysis.recordings
            for c in recording.channels
        )
        for analysis in (before, after)
    )
    return 1.0 - last / first if first > 0.0 else 0.0


def _start_angle(explanation: Explanation, seen: Observed) -> float:
    fit = explanation.fit
    for unknown, x in zip(fit.model.unknowns, fit.point, strict=True):
        if unknown.name == START_ANGLE and unknown.recording == seen.name:
            return float(x)
    return float(seen.known.get(START_ANGLE, 0.0))


def halves(seen: Observed) -> tuple[Observed, Observed]:
    """A recording cut in two at a whole sample; both halves have its name."""
    middle = seen.samples // 2
    return _rows(seen, slice(None, middle)), _rows(seen, slice(middle, None))


def _rows(seen: Observed, rows: slice) -> Observed:
    excluded, angle = seen.excluded, seen.motor_angle_rad
    return replace(
        seen,
        signals=seen.signals[:, rows],
        excluded=None if excluded is None else excluded[rows],
        motor_angle_rad=None if angle is None else angle[rows],
        begin_s=seen.begin_s + (rows.start or 0) / seen.sampling_hz,
    )
