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

import numpy as np

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.parameters import JointNormal
from bayesbl.diagnosis.closed_loop.prediction import augmented_bench
from bayesbl.identification.problem import Problem
from bayesbl.identification.summary import Verdict
from bayesbl.identification.wrong_by_far import (
    explanations_from_afar,
    freed,
    is_plausible,
    may_be_wrong_by_far,
)
from bayesbl.matching.alignment import fit_aligned, remaining_noise
from bayesbl.matching.posterior import DirectPosterior, sample_direct, widened
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements, is_explained
from bayesbl.matching.standstill import believed, in_motion
from bayesbl.model_search.always_in import Beside, is_useful, laws, marginalised, settled
from bayesbl.model_search.catalogue import Candidate, candidates, order_peaks
from bayesbl.model_search.closed_loop import name_missing, weighed
from bayesbl.model_search.constants import NAMED_AT
from bayesbl.model_search.refit import (
    Explanation,
    from_afar,
    is_gross,
    polished,
    refit,
    with_noise,
    with_own_noise,
)
from bayesbl.progress import Progress, StageProgress, of_stage, silent
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings

AFAR = "Seeking a value wrong by far"
"""Stage of the progress."""

DELAYS = tuple(e.name for e in EFFECTS if e.enters in ("loop", "measurement"))
"""Those of the drive: between the motor and the controller, and the recording."""


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
class Match:
    """The recordings fitted.

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
    """

    nominal: Explanation
    final: Explanation
    beyond: BeyondDataSheet | None = None
    missing: tuple[tuple[str, ...], ...] = ()

    @property
    def completed(self) -> bool:
        """Whether what was found is in the final bench."""
        return self.final.names != self.nominal.names


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(Match):
    """What the recordings say.

    ``check``: what still repeats; ``allows_for_misfit``: gap and bench include what a law that
    nothing names may do to them.
    """

    verdict: Verdict
    check: tuple[RepeatingPower, ...]
    posterior: DirectPosterior
    allows_for_misfit: bool = False


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
    match, unnamed = _match(problem, progress)
    fit, rest = settled(match.final.fit, laws(match.final.fit.model.bench))
    check = tuple(disagreements(rest.explained(fit)))
    explained = agrees(check) and rest.is_possible
    if not explained and unnamed is not None and fit is match.final.fit:
        rest = unnamed
    allows = not (explained or agrees(check)) and is_useful(fit, rest)
    match = replace(match, final=replace(match.final, fit=fit))
    verdict: Verdict = "agrees" if explained else "unexplained"
    if match.missing:
        verdict = "missing_effect"
    drawing, simulating = (of_stage(progress, s) for s in ("Sampling", "Simulating draws"))
    posterior = sample_direct(match.final.fit, sampler, seed, drawing, simulating)
    for_impacts, for_laws = seed.spawn(2)
    # As wide as impacts that are not alike ask for, and laws that nothing shows.
    posterior = marginalised(widened(posterior, for_impacts), rest, for_laws)
    return Identification(
        match.nominal,
        match.final,
        match.beyond,
        match.missing,
        verdict=verdict,
        check=check,
        posterior=posterior,
        allows_for_misfit=allows,
    )


def _match(problem: Problem, progress: StageProgress | None) -> tuple[Match, Beside | None]:
    """The data sheet, completed by what explains the recordings.

    With what stands beside it, misfit included, where a search has weighed that.
    """
    # A match with a sheet that no joint can be as would take minutes or fail.
    nominal = _nominal(problem, progress) if is_plausible(problem) else None
    far_off = nominal is None or (may_be_wrong_by_far(problem) and _is_far_off(nominal))
    far = far_beyond_data_sheet(problem, of_stage(progress, AFAR)) if far_off else None
    if far is not None:
        return replace(far, nominal=nominal or far.final), None
    if nominal is None:
        nominal = _nominal(problem, progress)
    problem = replace(problem, used=tuple(nominal.fit.model.recordings))
    fit, _ = settled(nominal.fit, laws(nominal.fit.model.bench))
    nominal = replace(nominal, fit=fit)
    naming = name_missing(
        nominal.fit,
        partial(_hypotheses, problem, nominal),
        among=laws(nominal.fit.model.bench),
        progress=of_stage(progress, "Naming what is missing"),
    )
    if naming.repeats and not far_off:
        far = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if far is not None:
            return replace(far, nominal=nominal), None
    missing = tuple(e.members for e in naming.effects if e.candidate.kind == "effect")
    is_asked = problem.effects == "catalogue" or all(set(m) <= set(DELAYS) for m in missing)
    if not naming.effects or not is_asked:
        return Match(nominal, nominal, None, missing), None if naming.effects else naming.rest
    final = replace(naming.final, fit=believed(naming.final.fit))
    wrong = next((e for e in naming.effects if e.candidate.kind == "parameter"), None)
    beyond = None
    if wrong is not None:
        beyond = _beyond(final, wrong.candidate, wrong.members[1:], problem)
    rest = naming.rest if final.fit is naming.final.fit else None
    return Match(nominal, final, beyond, missing), rest


def _is_far_off(nominal: Explanation) -> bool:
    """Whether the match leaves more than noise does. Only the order of two searches rests on it."""
    return nominal.fit.chi_square > 2.0 * nominal.fit.residual.size


def _hypotheses(problem: Problem, nominal: Explanation, peaks: Sequence[float]) -> list[Candidate]:
    """What the data sheet may lack: effects, and each value beyond its tolerance."""
    effects = candidates(nominal.fit.model.bench, problem.used, "all", peaks)
    # A reference that was sampled has round corners, as by a delay.
    moving = all(seen.motion is not None for seen in problem.used)
    hypotheses = [c for c in effects if c.kind == "effect" and not (moving and c.name in DELAYS)]
    for name in problem.parameters:
        value, half = problem.bench.value(name), problem.bench.tolerances[name]
        if value > half:
            usual = np.array([math.log1p(half / value)])
            hypotheses.append(replace(freed(name, nominal.fit.value(name)), usual=usual))
    return hypotheses


def _nominal(problem: Problem, progress: StageProgress | None) -> Explanation:
    """The bench within its tolerances where it can be believed, with the effects asked for by name.

    Without standstills to name what is missing: no law of the catalogue holds for friction at rest,
    and every joint has some.
    """
    stage = of_stage(progress, "Fitting the bench")
    fit = fit_aligned(problem.bench, problem.used, problem.unknowns, problem.workers, stage)
    nominal = Explanation((), fit)
    if problem.effects not in ("catalogue", ()):
        nominal = _with_effects(nominal, problem, order_peaks(fit))
    fit = believed(nominal.fit)
    if fit is nominal.fit and not is_explained(nominal.fit):
        fit = in_motion(fit) or fit
    return replace(nominal, fit=fit)


def _with_effects(nominal: Explanation, problem: Problem, peaks: Sequence[float]) -> Explanation:
    """Effects asked for by name added one after the other."""
    best = nominal
    asked = candidates(problem.bench, problem.used, problem.effects, peaks)
    for candidate in (c for c in asked if c.kind == "effect"):
        starts = [candidate.neutral + np.nan_to_num(candidate.usual), *candidate.starts]
        unmoved = np.zeros(best.fit.point.size)
        tried = [refit(best, [(candidate, start)], unmoved) for start in starts]
        if is_gross(best) and candidate.scanned:
            tried += from_afar(best, [candidate])
        fits = [e for e in tried if e is not None]
        best = min(fits, key=lambda e: e.fit.chi_square, default=best)
    return with_own_noise(with_noise(polished(best), remaining_noise(best.fit)))


def far_beyond_data_sheet(problem: Problem, progress: Progress = silent) -> Match | None:
    """One value beyond its tolerance that explains all, wherever in its whole range it lies.

    ``progress``: called with (places scanned, places in all).
    """
    rough = sorted(explanations_from_afar(problem, progress), key=lambda e: e.fit.chi_square)
    fitted = [with_noise(polished(e), remaining_noise(e.fit)) for e in rough[:3]]
    own = [weighed(e) for e in fitted if is_explained(e.fit) and _is_outside(e, problem)]
    if not own:
        return None
    chosen = max(own, key=lambda one: one.log_evidence)
    near = chosen.log_evidence + math.log(1.0 - NAMED_AT)
    others = [e.explanation for e in own if e is not chosen and e.log_evidence > near]
    could_be, final = tuple(e.candidates[-1].name for e in others), chosen.explanation
    return Match(final, final, _beyond(final, final.candidates[-1], could_be, problem))


def _is_outside(explanation: Explanation, problem: Problem) -> bool:
    """Whether the parameter freed last is beyond its tolerance."""
    name = explanation.candidates[-1].name
    value = float(explanation.fit.model.unknowns[-1].value(explanation.fit.point[-1]))
    return abs(value - problem.bench.value(name)) > problem.bench.tolerances[name]


def _beyond(
    final: Explanation, candidate: Candidate, could_be: tuple[str, ...], problem: Problem
) -> BeyondDataSheet:
    name, fit = candidate.name, final.fit
    (place,) = final.places(candidate)
    value, half = problem.bench.value(name), problem.bench.tolerances[name]
    ends = [math.log(end) for end in (value - half, value + half) if end > 0.0]
    sd = math.sqrt(float(weighed(final).covariance[place, place]))
    at = float(fit.point[place])
    deviations = min(abs(at - end) for end in ends) / sd
    return BeyondDataSheet(name, value, half, math.exp(at), deviations, could_be)


def parameter_draws(result: Identification, names: Sequence[str]) -> FloatArray:
    """Draws of the bench's parameters in their units, shape (draw, k).

    Of a parameter that was sought beyond its tolerance, those of the wider range.
    """
    unknowns = result.final.fit.model.unknowns
    last = {u.name: i for i, u in enumerate(unknowns) if u.recording is None}
    flat = result.posterior.draws.reshape(-1, len(unknowns))
    return np.column_stack([unknowns[last[n]].value(flat[:, last[n]]) for n in names])


def identified_bench(result: Identification, problem: Problem) -> Bench:
    """The bench with what was found; parameters above zero have a joint normal prior of logarithms.

    The tolerance of each alone is that of a uniform prior of the same standard deviation.
    """
    bench = augmented_bench(result.final)
    draws = parameter_draws(result, problem.parameters)
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
