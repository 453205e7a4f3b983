"""From a data sheet and recordings to the joint posterior of a bench's parameters.

Every parameter that is not known exactly is free within its tolerance, beside the gap and each
recording's start angle; the match and its posterior are those of the direct route. What the
parameters cannot explain within their tolerances is sought beyond one of them, and then among the
effects of the catalogue. Where they seem to explain all, a delay in the controller's loop or in
what it records may be hidden in them: every drive has one, few data sheets, and the gap is wrong
with them. So may one wrong value be, where others have gone to their edges.
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
from bayesbl.identification.beyond_data_sheet import (
    BeyondDataSheet,
    WiderTolerances,
    beyond_an_edge,
    beyond_data_sheet,
    far_beyond_data_sheet,
    with_wider_tolerances,
)
from bayesbl.identification.problem import FALSE_ALARM, Problem, is_explained
from bayesbl.identification.wrong_by_far import may_be_far_off
from bayesbl.matching.alignment import fit_aligned, remaining_noise
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated, with_model
from bayesbl.matching.posterior import DirectPosterior, sample_direct, widened
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements
from bayesbl.matching.standstill import believed, in_motion
from bayesbl.naming.candidates import Candidate, candidates, steady_torque
from bayesbl.naming.criteria import are_alike, is_gross
from bayesbl.naming.explanation import (
    Explanation,
    explain,
    from_afar,
    gain_threshold,
    gains_more_than_chance,
    linear_gains,
    nominal_explanation,
    polished,
    with_noise,
    with_own_noise,
)
from bayesbl.naming.motor_orders import order_peaks
from bayesbl.naming.naming import Naming
from bayesbl.naming.search import WORTH_FITTING, name_missing
from bayesbl.progress import Progress, StageProgress, of_stage
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings

Verdict = Literal["agrees", "missing_effect", "unexplained"]

AFAR = "Seeking a value wrong by far"
"""Stage of the progress."""

DELAYS = tuple(e.name for e in EFFECTS if e.enters in ("loop", "measurement"))
"""Those of the drive: between the motor and the controller, and the recording."""

STEADY_EFFECTS = tuple(
    e.name for e in EFFECTS if e.enters == "motor" and e.sought_in_loop and not e.is_periodic
)
"""Those that may be a constant torque at constant speed, or nearly."""


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
    wider
        The match with wider tolerances; ``None`` where no value lies at the edge of its own, or one
        was found beyond it.
    """

    nominal: Explanation
    final: Explanation
    verdict: Verdict
    beyond: BeyondDataSheet | None
    missing: tuple[tuple[str, ...], ...]
    check: tuple[RepeatingPower, ...]
    wider: WiderTolerances | None
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
    """Match, complete where nothing else explains the recordings, and sample.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    far_off = may_be_far_off(problem)
    if far_off:
        # A match with this sheet would take minutes or fail, only to be further off.
        far = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if far is not None:
            found, value = far
            posterior = _posterior(found.fit, sampler, seed, progress)
            check = tuple(disagreements(found.fit))
            return Identification(found, found, "agrees", value, (), check, None, posterior)
    nominal = _believed(_nominal(problem, of_stage(progress, "Fitting the bench")))
    problem = replace(problem, used=tuple(nominal.fit.model.recordings))
    beyond: BeyondDataSheet | None = None
    if is_explained(nominal):
        final, missing = _delayed(nominal, problem)
    else:
        final, beyond, missing = _completed(nominal, problem, far_off, progress)
    check = tuple(disagreements(final.fit))
    explained = agrees(list(check), FALSE_ALARM)
    verdict: Verdict = "agrees" if explained and not missing else "unexplained"
    if missing:
        verdict = "missing_effect"
    wider = None if beyond is not None else with_wider_tolerances(final.fit, problem)
    completed = final.names != nominal.names
    if wider is not None and explained and (completed or not missing):
        # The other parameters, pressed to their edges, may hide the one that is wrong.
        wrong = beyond_an_edge(final, wider, problem)
        if wrong is not None:
            final, beyond, wider = *wrong, None
            check = tuple(disagreements(final.fit))
    posterior = _posterior(final.fit, sampler, seed, progress)
    return Identification(nominal, final, verdict, beyond, missing, check, wider, posterior)


def _completed(
    nominal: Explanation, problem: Problem, far_off: bool, progress: StageProgress | None
) -> tuple[Explanation, BeyondDataSheet | None, tuple[tuple[str, ...], ...]]:
    """What explains recordings that the data sheet within its tolerances does not.

    The likeliest first: steady friction, a value a little beyond its tolerance, an effect of the
    catalogue, and a value wrong by far unless that has been sought already (``far_off``).
    """
    naming = of_stage(progress, "Naming what is missing")
    steady = _with_steady_torque(problem)
    rubs = steady is not None and is_explained(steady)
    if rubs:
        named, missing = _named(nominal, steady, problem, naming)
        if missing:
            return _asked_for(nominal, named, problem), None, missing
    near = beyond_data_sheet(nominal, problem)
    if near is not None:
        return *near, ()
    if rubs:
        return nominal, None, ()
    named, missing = _named(nominal, steady, problem, naming)
    if not (far_off or is_explained(named)):
        far = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if far is not None:
            return *far, ()
    return _asked_for(nominal, named, problem), None, missing


def _asked_for(nominal: Explanation, named: Explanation, problem: Problem) -> Explanation:
    """With what was named in the bench, if that was asked for."""
    return named if problem.effects == "catalogue" else nominal


def _posterior(
    fit: SimulatedFit,
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: StageProgress | None,
) -> DirectPosterior:
    """Draws about a fit, as wide as impacts that are not alike ask for."""
    drawing, simulating = (of_stage(progress, s) for s in ("Sampling", "Simulating draws"))
    return widened(sample_direct(fit, sampler, seed, drawing, simulating), *seed.spawn(1))


def _nominal(problem: Problem, progress: Progress | None) -> Explanation:
    """The bench within its tolerances, effects asked for by name added one after the other."""
    fit = fit_aligned(problem.bench, problem.used, problem.unknowns, problem.workers, progress)
    found = nominal_explanation(fit)
    if problem.effects in ("catalogue", ()):
        return found
    asked = _effects(problem, fit, problem.effects)
    for candidate in asked:
        tried = [explain(found, candidate)]
        if is_gross(found) and candidate.scanned:
            tried.append(from_afar(found, candidate))
        found = min(filter(None, tried), key=lambda e: e.fit.chi_square, default=found)
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


def _effects(
    problem: Problem, fit: SimulatedFit, names: Sequence[str] | Literal["all"]
) -> list[Candidate]:
    """Candidates of these names; those that turn with the motor at the orders that stand out."""
    found = candidates(problem.bench, problem.used, names, order_peaks(fit))
    return [c for c in found if c.kind == "effect"]


def _delayed(
    nominal: Explanation, problem: Problem
) -> tuple[Explanation, tuple[tuple[str, ...], ...]]:
    """With a delay in loop or recording beside the parameters, if the recordings show one.

    Those at constant speed must: a reference that was sampled has round corners, as by a delay.
    """
    if all(seen.motion is not None for seen in problem.used):
        return nominal, ()
    turning = _at_constant_speed(nominal)
    delays = _effects(problem, nominal.fit, DELAYS)
    found = []
    for candidate, promise in zip(delays, linear_gains(turning, delays), strict=True):
        asked = gain_threshold(len(candidate.unknowns), len(delays), FALSE_ALARM)
        if promise < WORTH_FITTING * asked:
            continue
        fitted = _with(turning, candidate)
        if fitted is None or not gains_more_than_chance(turning, fitted, len(delays), FALSE_ALARM):
            continue
        if turning is not nominal:
            fitted = _with(nominal, candidate)
        if fitted is not None:
            found.append(fitted)
    if not found:
        return nominal, ()
    best, *others = sorted(found, key=lambda e: -e.log_evidence)
    alike = [e.candidates[-1].name for e in others if are_alike(best, e)]
    return with_own_noise(best), ((best.candidates[-1].name, *alike),)


def _with(base: Explanation, candidate: Candidate) -> Explanation | None:
    """One candidate more, fitted to the end."""
    rough = explain(base, candidate)
    return None if rough is None else polished(rough)


def _at_constant_speed(explanation: Explanation) -> Explanation:
    """The same bench fitted to the recordings that are of no motion alone."""
    fit, model = explanation.fit, explanation.fit.model
    kept = [i for i, seen in enumerate(model.recordings) if seen.motion is None]
    if len(kept) == len(model.recordings):
        return explanation
    recordings = [model.recordings[i] for i in kept]
    names = (None, *(seen.name for seen in recordings))
    own = [k for k, unknown in enumerate(model.unknowns) if unknown.recording in names]
    turning = replace(
        model,
        recordings=recordings,
        unknowns=[model.unknowns[k] for k in own],
        noise=[model.noise[i] for i in kept],
    )
    return nominal_explanation(fit_simulated(turning, fit.point[own], fit.steps[own]))


def _with_steady_torque(problem: Problem) -> Explanation | None:
    """The parameters beside a constant torque in each recording; ``None`` if the bench has one.

    At constant speed that is what all friction of the motor looks like, which real joints have and
    data sheets lack: without it the parameters are drawn to the ends of their tolerances. In a
    motion friction reverses: ``None`` where all are of one.
    """
    candidate = steady_torque(problem.bench, problem.used)
    if candidate is None or all(seen.motion is not None for seen in problem.used):
        return None
    unknowns = [*problem.unknowns, *candidate.unknowns]
    bench = candidate.bench(problem.bench)
    fit = fit_aligned(bench, problem.used, unknowns, problem.workers)
    return Explanation((candidate,), fit)


def _named(
    nominal: Explanation,
    steady: Explanation | None,
    problem: Problem,
    progress: Progress | None,
) -> tuple[Explanation, tuple[tuple[str, ...], ...]]:
    """With the effects that the recordings name."""
    naming: Naming = name_missing(
        _to_name_from(nominal, steady),
        partial(
            candidates,
            nominal.fit.model.bench,
            problem.used,
            "all" if steady is None or not is_explained(steady) else STEADY_EFFECTS,
            declared=problem.parameters,
        ),
        false_alarm=FALSE_ALARM,
        progress=progress,
    )
    missing = tuple(effect.members for effect in naming.effects)
    if not missing:
        return nominal, missing
    named = with_own_noise(naming.final)
    return replace(named, fit=believed(named.fit, FALSE_ALARM)), missing


def _to_name_from(nominal: Explanation, steady: Explanation | None) -> SimulatedFit:
    """The nominal comparison where the search begins.

    Where constant torques explain more, that is at their parameters, the torques taken away and
    nothing fitted again: so that friction, once added, finds them as they are.
    """
    if steady is None or steady.fit.chi_square >= nominal.fit.chi_square or nominal.candidates:
        return nominal.fit
    own = nominal.fit.point.size
    model = replace(nominal.fit.model, noise=steady.fit.model.noise)
    begun = replace(steady.fit, point=steady.fit.point[:own], steps=steady.fit.steps[:own])
    return with_model(begun, model)


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
