"""From a data sheet and recordings to the joint posterior of a bench's parameters.

Every parameter that is not known exactly is free within its tolerance, beside the gap and each
recording's start angle; the match and its posterior are those of the direct route. Hypotheses of
what the sheet lacks are the effects of the catalogue, a delay of the drive among them, which the
tolerances would absorb, and each value beyond its tolerance. One posterior over their sets says
what is there (:mod:`bayesbl.model_search.closed_loop`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.parameters import JointNormal
from bayesbl.diagnosis.closed_loop.augment import augmented_bench
from bayesbl.identification.problem import Problem, is_explained
from bayesbl.identification.wrong_by_far import (
    explanations_from_afar,
    freed,
    is_plausible,
    may_be_wrong_by_far,
)
from bayesbl.matching.alignment import fit_aligned, remaining_noise
from bayesbl.matching.posterior import DirectPosterior, sample_direct, widened
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements
from bayesbl.matching.signals import GAP
from bayesbl.matching.standstill import believed, in_motion
from bayesbl.model_search.catalogue import Candidate, OrderPeak, candidates, order_peaks
from bayesbl.model_search.closed_loop import (
    FittedSet,
    NamedCandidate,
    Naming,
    name_missing,
    weighed,
)
from bayesbl.model_search.constants import FALSE_ALARM, NAMED_AT
from bayesbl.model_search.refit import (
    Explanation,
    from_afar,
    is_gross,
    nominal_explanation,
    polished,
    refit,
    with_noise,
    with_own_noise,
)
from bayesbl.progress import Progress, StageProgress, of_stage
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings

Verdict = Literal["agrees", "missing_effect", "unexplained"]

AFAR = "Seeking a value wrong by far"
"""Stage of the progress."""

DELAYS = tuple(e.name for e in EFFECTS if e.enters in ("loop", "measurement"))
"""Those of the drive: between the motor and the controller, and the recording."""

DOUBTFUL = 0.05
"""Probability of a value beyond its tolerance from which on its gap is held against the answer."""


@dataclass(frozen=True, slots=True)
class BeyondDataSheet:
    """A value of the data sheet that the recordings contradict.

    Attributes
    ----------
    believed, tolerance
        By the data sheet.
    found
        By the recordings.
    deviations
        From the nearer end of its tolerance to what was found, in standard deviations.
    could_be
        Other parameters that would explain the recordings as well, each alone.
    """

    name: str
    believed: float
    tolerance: float
    found: float
    deviations: float
    could_be: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DoubtfulValues:
    """Values that may lie beyond their tolerances, too improbable to be named.

    ``gaps_rad``: δ of each gap with all values within, and with the likeliest beyond, (gap, 2).
    """

    names: tuple[str, ...]
    probability: float
    gaps_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Identification:
    """What the recordings say.

    Attributes
    ----------
    nominal
        The data sheet within its tolerances, with the effects asked for; ``final`` where a match
        with it is far off, and one value beyond its tolerance explains all.
    final
        With what was found beside it.
    beyond
        The value of the data sheet that is wrong, if one is.
    missing
        Effects that the bench lacks, by name, each with those it cannot be told from.
    check
        What still repeats.
    doubtful
        Values that may be wrong, too improbable to be named; ``None`` without any.
    """

    nominal: Explanation
    final: Explanation
    verdict: Verdict
    beyond: BeyondDataSheet | None
    missing: tuple[tuple[str, ...], ...]
    check: tuple[RepeatingPower, ...]
    doubtful: DoubtfulValues | None
    posterior: DirectPosterior

    @property
    def completed(self) -> bool:
        """Whether what was found is in the final bench."""
        return self.final.names != self.nominal.names


def identify(
    problem: Problem,
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: StageProgress | None = None,
) -> Identification:
    """Match, complete where something else explains the recordings, and sample.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    # A match with a sheet that no joint can be as would take minutes or fail.
    nominal = None
    if is_plausible(problem):
        nominal = _believed(_nominal(problem, of_stage(progress, "Fitting the bench")))
    far_off = nominal is None or (may_be_wrong_by_far(problem) and _is_far_off(nominal))
    if far_off:
        far = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if far is not None:
            before = nominal or far[0]
            return _identification(before, far[0], far[1], (), None, sampler, seed, progress)
    if nominal is None:
        nominal = _believed(_nominal(problem, of_stage(progress, "Fitting the bench")))
    problem = replace(problem, used=tuple(nominal.fit.model.recordings))
    naming: Naming = name_missing(
        nominal.fit,
        partial(_hypotheses, problem, nominal),
        progress=of_stage(progress, "Naming what is missing"),
    )
    if naming.repeats and not far_off:
        far = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if far is not None:
            return _identification(nominal, far[0], far[1], (), None, sampler, seed, progress)
    final, beyond = nominal, None
    missing = tuple(e.members for e in naming.effects if e.candidate.kind == "effect")
    if naming.effects:
        named = with_own_noise(naming.final)
        named = replace(named, fit=believed(named.fit, FALSE_ALARM))
        asked = problem.effects == "catalogue" or all(
            set(members) <= set(DELAYS) for members in missing
        )
        final = named if asked else nominal
        wrong = [e for e in naming.effects if e.candidate.kind == "parameter"]
        if wrong and asked:
            beyond = _beyond(final, wrong[0], problem)
    return _identification(
        nominal, final, beyond, missing, _doubtful(naming, problem), sampler, seed, progress
    )


def _is_far_off(nominal: Explanation) -> bool:
    """Whether the match leaves more than noise does. Only the order of two searches rests on it."""
    return nominal.fit.chi_square > 2.0 * nominal.fit.residual.size


def _identification(
    nominal: Explanation,
    final: Explanation,
    beyond: BeyondDataSheet | None,
    missing: tuple[tuple[str, ...], ...],
    doubtful: DoubtfulValues | None,
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: StageProgress | None,
) -> Identification:
    """With draws about the fit, as wide as impacts that are not alike ask for."""
    check = tuple(disagreements(final.fit))
    verdict: Verdict = "agrees" if agrees(list(check), FALSE_ALARM) else "unexplained"
    if missing:
        verdict = "missing_effect"
    drawing, simulating = (of_stage(progress, s) for s in ("Sampling", "Simulating draws"))
    posterior = sample_direct(final.fit, sampler, seed, drawing, simulating)
    posterior = widened(posterior, *seed.spawn(1))
    return Identification(nominal, final, verdict, beyond, missing, check, doubtful, posterior)


def _hypotheses(
    problem: Problem, nominal: Explanation, peaks: Sequence[OrderPeak]
) -> list[Candidate]:
    """What the data sheet may lack: effects, and each value beyond its tolerance."""
    effects = candidates(nominal.fit.model.bench, problem.used, "all", peaks)
    # A reference that was sampled has round corners, as by a delay.
    moving = all(seen.motion is not None for seen in problem.used)
    found = [c for c in effects if c.kind == "effect" and not (moving and c.name in DELAYS)]
    for name in problem.parameters:
        value, half = problem.bench.value(name), problem.bench.tolerances[name]
        if value > half:
            usual = np.array([math.log1p(half / value)])
            found.append(replace(freed(name, nominal.fit.value(name)), usual=usual))
    return found


def _nominal(problem: Problem, progress: Progress | None) -> Explanation:
    """The bench within its tolerances, effects asked for by name added one after the other."""
    fit = fit_aligned(problem.bench, problem.used, problem.unknowns, problem.workers, progress)
    found = nominal_explanation(fit)
    if problem.effects in ("catalogue", ()):
        return found
    asked = candidates(problem.bench, problem.used, problem.effects, order_peaks(fit))
    for candidate in (c for c in asked if c.kind == "effect"):
        starts = [candidate.neutral + np.nan_to_num(candidate.usual), *candidate.starts]
        unmoved = np.zeros(found.fit.point.size)
        tried = [refit(found, [(candidate, start)], unmoved) for start in starts]
        if is_gross(found) and candidate.scanned:
            tried += from_afar(found, [candidate])
        fits = [e for e in tried if e is not None]
        found = min(fits, key=lambda e: e.fit.chi_square, default=found)
    found = with_noise(polished(found), remaining_noise(found.fit))
    return with_own_noise(found)


def _believed(nominal: Explanation) -> Explanation:
    """The same where the bench can be believed, and without standstills to name what is missing.

    No law of the catalogue holds for friction at rest, and every joint has some.
    """
    fit = believed(nominal.fit, FALSE_ALARM)
    if fit is nominal.fit and not is_explained(nominal):
        fit = in_motion(fit) or fit
    return replace(nominal, fit=fit)


def far_beyond_data_sheet(
    problem: Problem, progress: Progress | None = None
) -> tuple[Explanation, BeyondDataSheet] | None:
    """One value beyond its tolerance that explains all, wherever in its whole range it lies.

    ``progress``: called with (places scanned, places in all).
    """
    rough = sorted(explanations_from_afar(problem, progress), key=lambda e: e.fit.chi_square)
    fitted = [with_noise(polished(e), remaining_noise(e.fit)) for e in rough[:3]]
    own = [weighed(e) for e in fitted if is_explained(e) and _is_outside(e, problem)]
    if not own:
        return None
    chosen = max(own, key=lambda one: one.log_evidence)
    near = chosen.log_evidence + math.log(1.0 - NAMED_AT)
    others = [e.explanation for e in own if e is not chosen and e.log_evidence > near]
    alike = tuple((e.candidates[-1], e) for e in others)
    name = NamedCandidate(chosen.explanation.candidates[-1], math.inf, 1.0, alike)
    return chosen.explanation, _beyond(chosen.explanation, name, problem)


def _is_outside(explanation: Explanation, problem: Problem) -> bool:
    """Whether the parameter freed last is beyond its tolerance."""
    name = explanation.candidates[-1].name
    found = float(explanation.fit.model.unknowns[-1].value(explanation.fit.point[-1]))
    return abs(found - problem.bench.value(name)) > problem.bench.tolerances[name]


def _beyond(final: Explanation, named: NamedCandidate, problem: Problem) -> BeyondDataSheet:
    name, fit = named.name, final.fit
    (place,) = final.places(named.candidate)
    value, half = problem.bench.value(name), problem.bench.tolerances[name]
    ends = [math.log(end) for end in (value - half, value + half) if end > 0.0]
    sd = math.sqrt(float(weighed(final).covariance[place, place]))
    at = float(fit.point[place])
    return BeyondDataSheet(
        name, value, half, math.exp(at), min(abs(at - end) for end in ends) / sd, named.members[1:]
    )


def _doubtful(naming: Naming, problem: Problem) -> DoubtfulValues | None:
    """Values that may lie beyond their tolerances, with the gap of the likeliest such set."""

    def beyond(own: FittedSet) -> list[str]:
        return [c.name for c in own.explanation.candidates if c.kind == "parameter"]

    sure = {e.name for e in naming.effects}
    sets = [(own, p) for own, p in naming.sets if set(beyond(own)) - sure]
    probability = sum(p for _, p in sets)
    if probability < DOUBTFUL or naming.repeats:
        return None
    likeliest = max(sets, key=lambda item: item[1])[0]
    gaps = [None] if problem.shares_gap else [seen.name for seen in problem.used]
    values = [[f.value(GAP, g) for f in (naming.final.fit, likeliest.fit)] for g in gaps]
    names = dict.fromkeys(name for own, _ in sets for name in beyond(own) if name not in sure)
    return DoubtfulValues(tuple(names), probability, np.array(values))


def parameter_draws(found: Identification, names: Sequence[str]) -> FloatArray:
    """Draws of the bench's parameters in their units, shape (draw, k).

    Of a parameter that was sought beyond its tolerance, those of the wider range.
    """
    unknowns = found.final.fit.model.unknowns
    last = {u.name: i for i, u in enumerate(unknowns) if u.recording is None}
    flat = found.posterior.draws.reshape(-1, len(unknowns))
    return np.column_stack([unknowns[last[n]].value(flat[:, last[n]]) for n in names])


def identified_bench(found: Identification, problem: Problem) -> Bench:
    """The bench with what was found; parameters above zero have a joint normal prior of logarithms.

    The tolerance of each alone is that of a uniform prior of the same standard deviation.
    """
    bench = augmented_bench(found.final)
    draws = parameter_draws(found, problem.parameters)
    parameters = dict(bench.parameters)
    for name, own in zip(problem.parameters, draws.T, strict=True):
        logarithm = np.log(own) if own.min() > 0.0 else None
        middle = float(own.mean()) if logarithm is None else math.exp(float(logarithm.mean()))
        half = math.sqrt(3.0) * float(own.std())
        parameters[name] = BenchParameter(middle, half)
    together = [i for i, own in enumerate(draws.T) if own.min() > 0.0]
    if not together:
        return replace(bench, parameters=parameters)
    covariance = np.atleast_2d(np.cov(np.log(draws[:, together]).T))
    names = tuple(problem.parameters[i] for i in together)
    return replace(bench, parameters=parameters, identified=JointNormal(names, covariance))
