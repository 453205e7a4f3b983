"""What a forward comparison finds: names, what is learned beside them, and what they leave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.closed_loop.learned_in_loop import Learned, learned_term
from bayesbl.diagnosis.closed_loop.prediction import SimulatedPair, simulated_pairs
from bayesbl.diagnosis.residuals import ResidualAnalysis, analyse_residuals
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import GAP, START_ANGLE, Unknown
from bayesbl.model_search.always_in import beside, laws
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.closed_loop import FittedSet, Naming, laws_of_shaft, name_missing, weighed
from bayesbl.model_search.constants import UNEXPLAINED_SHARE
from bayesbl.model_search.refit import Explanation
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray

MOST_EFFECTS = 3

SHIFTS_DRAWN = 4000


@dataclass(frozen=True, slots=True)
class ForwardSettings:
    """What may be named, and how surely; as ``[candidates]`` and ``[comparison]`` say."""

    effects: Sequence[str] | None = None
    max_effects: int = MOST_EFFECTS
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
    chosen
        The set of everything that is named, its noise estimated without what was missing; with what
        was learned, if anything was.
    pairs
        Recordings, those that were held out too, beside both simulations.
    before, after
        Without and with what is named.
    learned
        What was learned from what naming left; ``chosen`` has it.
    law_shifts
        Draws of what laws that nothing shows add to ln δ; ``None`` where no gap is sought.
    """

    believed: Bench
    naming: Naming
    chosen: FittedSet
    pairs: tuple[SimulatedPair, ...]
    before: ResidualAnalysis
    after: ResidualAnalysis
    learned: Learned | None = None
    law_shifts: FloatArray | None = None

    @property
    def final(self) -> Explanation:
        """The fit of what is named."""
        return self.chosen.explanation


def search(
    bench: Bench,
    used: Sequence[Observed],
    held_out: Sequence[Observed],
    unknowns: Sequence[Unknown],
    settings: ForwardSettings,
    progress: Progress = silent,
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
        progress=progress,
    )
    compared = cache(_compared)
    naming, learned = missing(nominal), None
    before = compared(naming.nominal)
    final = naming.final
    after = compared(final)
    if naming.effects and after.remaining and after.closes(before) < 1.0 - UNEXPLAINED_SHARE:
        # It helps a little, as a parameter may where a line in time remains: no explanation.
        nearest, final = naming.final, naming.nominal
        naming = replace(naming, repeats=True, final=final, effects=(), nearest=nearest)
    # What does not repeat with the load, a line of the motor or in time, is in no band.
    if naming.repeats or (after.remaining and not laws_of_shaft(naming.final)):
        beside = _with_learned(naming, final, compared, missing, settings)
        if beside is not None:
            naming, learned = beside
            final = learned.explanation
    return Findings(
        bench,
        naming,
        weighed(final),
        tuple(simulated_pairs(naming.nominal, final, held_out)),
        before,
        compared(final),
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


def _with_learned(
    naming: Naming,
    final: Explanation,
    compared: _Compared,
    missing: Callable[[SimulatedFit], Naming],
    settings: ForwardSettings,
) -> tuple[Naming, Learned] | None:
    """What is learned from what is left, with the names that stand beside it.

    Where nothing explains, it is sought around the nearest explanation too: the gap of the nominal
    bench may be too far off.
    """
    near = () if naming.nearest is None else (naming.nearest,)
    around = [(explanation, compared(explanation).remaining) for explanation in (final, *near)]
    learned = learned_term(final, around, settings.motor_angle_known)
    if learned is None:
        return None
    if not naming.effects and not is_explained(learned.explanation.fit):
        # Behind what was learned a law of the catalogue may have been hidden.
        beside = missing(learned.explanation.fit)
        if beside.effects:
            learned = replace(learned, explanation=beside.final)
            return replace(beside, nominal=naming.nominal), learned
    return replace(naming, final=learned.explanation), learned


_Compared = Callable[[Explanation], ResidualAnalysis]


def _compared(explanation: Explanation) -> ResidualAnalysis:
    fit = explanation.fit
    used = fit.model.recordings
    own = [fit.model.signals(fit.point, i)[0] for i in range(len(used))]
    # Bridged samples hold nothing that repeats.
    seen = [replace(s, signals=m + s.left_by(m)) for s, m in zip(used, own, strict=True)]
    return analyse_residuals(seen, own, [_start_angle(explanation, s) for s in used])


def _start_angle(explanation: Explanation, seen: Observed) -> float:
    fit = explanation.fit
    for unknown, x in zip(fit.model.unknowns, fit.point, strict=True):
        if unknown.name == START_ANGLE and unknown.recording == seen.name:
            return float(x)
    return float(seen.known.get(START_ANGLE, 0.0))


def part_of(seen: Observed, rows: slice) -> Observed:
    """Some samples of a recording, under its name."""
    excluded, angle = seen.excluded, seen.motor_angle_rad
    return replace(
        seen,
        signals=seen.signals[:, rows],
        excluded=None if excluded is None else excluded[rows],
        motor_angle_rad=None if angle is None else angle[rows],
        begin_s=seen.begin_s + (rows.start or 0) / seen.sampling_hz,
    )
