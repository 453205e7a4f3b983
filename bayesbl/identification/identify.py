"""From a data sheet and recordings to the joint posterior of a bench's parameters.

Every parameter that is not known exactly is free within its tolerance, beside the gap and each
recording's start angle; the match and its posterior are those of the direct route. What the
parameters cannot explain within their tolerances is sought beyond one of them, and then among the
effects of the catalogue. Where they seem to explain all, a delay in the controller's loop or in
what it records may be hidden in them: every drive has one, few data sheets, and the gap is wrong
with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.joint_normal import JointNormal
from bayesbl.diagnosis.closed_loop.augment import augmented_bench
from bayesbl.matching.alignment import fit_aligned, remaining_noise
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated, with_model
from bayesbl.matching.observed import Observed
from bayesbl.matching.posterior import DirectPosterior, sample_direct
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    SimulatedSignals,
    Unknown,
    effect_unknowns,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
)
from bayesbl.naming.candidates import Candidate, candidates, steady_torque
from bayesbl.naming.criteria import ALIKE, is_gross
from bayesbl.naming.explanation import (
    Explanation,
    distance,
    explain,
    from_afar,
    gain_threshold,
    linear_gains,
    nominal_explanation,
    polished,
    with_noise,
)
from bayesbl.naming.naming import Naming
from bayesbl.naming.search import WORTH_FITTING, name_missing
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import Progress, SamplerSettings

Verdict = Literal["agrees", "missing_effect", "unexplained"]

FALSE_ALARM = 0.01
"""Of the predictive check and of naming, each over all that it tests."""

FURTHEST_WRONG = 3.0
"""Factor by which a value of the data sheet may be wrong beyond its tolerance, up or down."""

WIDER = 1.5
"""Times a tolerance, where its edge has stopped a match."""

AT_EDGE = 1e-6
"""Of a tolerance's width, between a match that an edge has stopped and the edge."""

EDGE_GAIN = 2.7
"""Fall of χ² beyond the edge of a tolerance that is no chance: where the true value lies at the
very edge, a normal likelihood has its peak that far outside in 5 %."""

POLISHED = 3
"""Parameters beyond their tolerance that are fitted to the end, the best of the rough fits."""

DELAYS = tuple(e.name for e in EFFECTS if e.enters in ("loop", "measurement"))
"""Those of the drive: between the motor and the controller, and the recording."""

STEADY_EFFECTS = tuple(e.name for e in EFFECTS if e.enters == "motor" and not e.is_periodic)
"""Those that may be a constant torque at constant speed, or nearly."""


@dataclass(frozen=True, slots=True)
class Problem:
    """What is identified, and from what.

    Attributes
    ----------
    used, held_out
        Recordings to fit on, and to predict.
    parameters
        Bench parameters that are free, each with a tolerance.
    effects
        Free from the start, by name; ``"catalogue"``: those that the recordings name.
    shares_gap
        Whether all recordings have one gap.
    """

    bench: Bench
    used: tuple[Observed, ...]
    held_out: tuple[Observed, ...]
    parameters: tuple[str, ...]
    effects: tuple[str, ...] | Literal["catalogue"]
    gap_rad: tuple[float, float]
    shares_gap: bool
    workers: int = field(default=1, compare=False)

    @property
    def unknowns(self) -> list[Unknown]:
        """Gaps, start angles, delays of motions, effects of the bench file, and parameters."""
        names = [seen.name for seen in self.used]
        gap = gap_unknown(*self.gap_rad)
        return [
            *([gap] if self.shares_gap else (replace(gap, recording=name) for name in names)),
            *(start_angle_unknown(name) for name in names),
            *(reference_delay_unknown(r.name) for r in self.used if r.motion is not None),
            *effect_unknowns(self.bench, names),
            *(parameter_unknown(self.bench, name) for name in self.parameters),
        ]


def parameter_unknown(bench: Bench, name: str) -> Unknown:
    """A parameter uniform within its tolerance, by its logarithm where all of it is above zero.

    What no recording can show, such as all torques and the torque constant times one factor, is a
    straight line among logarithms, however wide the tolerances.
    """
    value, half = bench.value(name), bench.tolerances[name]
    if value <= half:
        return Unknown(name, value - half, value + half)
    low, high = math.log(value - half), math.log(value + half)
    return Unknown(name, low, high, logarithmic=True, flat_in_value=True)


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
class WiderTolerances:
    """The recordings matched again with tolerances half as wide again.

    Attributes
    ----------
    at_edges
        Parameters that lay at the edges of their tolerances.
    gain
        By how much χ² falls.
    gaps_rad
        δ of each gap before and after, shape (gap, 2).
    """

    at_edges: tuple[str, ...]
    gain: float
    gaps_rad: FloatArray

    @property
    def explain_more(self) -> bool:
        """Whether χ² falls by more than chance, were the true values within the tolerances."""
        return self.gain > EDGE_GAIN


@dataclass(frozen=True, slots=True)
class Identification:
    """What the recordings say.

    Attributes
    ----------
    nominal
        The data sheet within its tolerances, with the effects asked for.
    final
        With what was found beside it.
    beyond
        The value of the data sheet that is wrong, if one is.
    missing
        Effects that the bench lacks, by name, each with those it cannot be told from.
    check
        What still repeats.
    wider
        The match with wider tolerances; ``None`` where no value lies at the edge of its own.
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
    progress: Progress | None = None,
) -> Identification:
    """Match, complete where nothing else explains the recordings, and sample.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    nominal = _nominal(problem)
    final = nominal
    beyond: BeyondDataSheet | None = None
    missing: tuple[tuple[str, ...], ...] = ()
    if _agrees(nominal):
        final, missing = _delayed(nominal, problem)
    else:
        steady = _with_steady_torque(problem)
        rubs = steady is not None and _agrees(steady)
        if rubs:
            final, missing = _named(nominal, steady, problem)
        if not missing:
            wrong = _beyond_data_sheet(nominal, problem)
            if wrong is not None:
                final, beyond = wrong
            elif not rubs:
                final, missing = _named(nominal, steady, problem)
    check = tuple(disagreements(final.fit))
    explained = agrees(list(check), FALSE_ALARM)
    verdict: Verdict = "agrees" if explained and not missing else "unexplained"
    if missing:
        verdict = "missing_effect"
    wider = None if beyond is not None else _with_wider_tolerances(final.fit, problem)
    if wider is not None and verdict == "agrees":
        # The other parameters, pressed to their edges, may hide the one that is wrong.
        wrong = _beyond_an_edge(final, wider, problem)
        if wrong is not None:
            final, beyond, wider = *wrong, None
            check = tuple(disagreements(final.fit))
    posterior = sample_direct(final.fit, sampler, seed, progress)
    return Identification(nominal, final, verdict, beyond, missing, check, wider, posterior)


def _nominal(problem: Problem) -> Explanation:
    """The bench within its tolerances, effects asked for by name added one after the other."""
    fit = fit_aligned(problem.bench, problem.used, problem.unknowns, problem.workers)
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
    return with_noise(found, remaining_noise(found.fit))


def _effects(
    problem: Problem, fit: SimulatedFit, names: Sequence[str] | Literal["all"]
) -> list[Candidate]:
    """Candidates of these names; those that turn with the motor at the orders that stand out."""
    from bayesbl.naming.motor_orders import order_peaks

    found = candidates(problem.bench, problem.used, names, order_peaks(fit))
    return [c for c in found if c.kind == "effect"]


def _agrees(explanation: Explanation) -> bool:
    return agrees(disagreements(explanation.fit), FALSE_ALARM)


def _delayed(
    nominal: Explanation, problem: Problem
) -> tuple[Explanation, tuple[tuple[str, ...], ...]]:
    """With a delay in loop or recording beside the parameters, if the recordings show one.

    Those at constant speed must: a reference that was sampled has round corners, as by a delay.
    """
    if all(seen.motion is not None for seen in problem.used):
        return nominal, ()
    delays = _effects(problem, nominal.fit, DELAYS)
    found = []
    for candidate, promise in zip(delays, linear_gains(nominal, delays), strict=True):
        asked = gain_threshold(len(candidate.unknowns), len(delays), FALSE_ALARM)
        if promise < WORTH_FITTING * asked:
            continue
        rough = explain(nominal, candidate)
        fitted = None if rough is None else polished(rough)
        if fitted is not None and _gain_at_constant_speed(nominal, fitted) > asked:
            found.append(fitted)
    if not found:
        return nominal, ()
    best, *others = sorted(found, key=lambda e: -e.log_evidence)
    alike = [e.candidates[-1].name for e in others if distance(best, e) < ALIKE]
    return with_noise(best, remaining_noise(best.fit)), ((best.candidates[-1].name, *alike),)


def _gain_at_constant_speed(base: Explanation, more: Explanation) -> float:
    """By how much χ² of the recordings that are of no motion falls."""
    model = base.fit.model
    parts = model.by_recording(base.fit.residual**2 - more.fit.residual**2)
    pairs = zip(model.recordings, parts, strict=True)
    return sum(float(part.sum()) for seen, part in pairs if seen.motion is None)


def _with_wider_tolerances(fit: SimulatedFit, problem: Problem) -> WiderTolerances | None:
    """The match again, from where it ended, if the edge of a tolerance has stopped it there."""
    model = fit.model
    own = [k for k, u in enumerate(model.unknowns) if u.name in problem.parameters]
    ends = np.minimum(fit.point - model.low, model.high - fit.point)
    stopped = [k for k in own if ends[k] < AT_EDGE * (model.high[k] - model.low[k])]
    if not stopped:
        return None
    unknowns = [_wider(u) if k in own else u for k, u in enumerate(model.unknowns)]
    wider = fit_simulated(replace(model, unknowns=unknowns), fit.point, fit.steps)
    gaps = [k for k, u in enumerate(unknowns) if u.name == GAP]
    values = [[unknowns[k].value(f.point[k]) for f in (fit, wider)] for k in gaps]
    names = tuple(unknowns[k].name for k in stopped)
    return WiderTolerances(names, fit.chi_square - wider.chi_square, np.array(values))


def _wider(unknown: Unknown) -> Unknown:
    """Over a range ``WIDER`` times as wide; none that is not negative becomes so."""
    more = 0.5 * (WIDER - 1.0) * (unknown.high - unknown.low)
    low = unknown.low - more
    if unknown.low >= 0.0 and not unknown.logarithmic:
        low = max(low, 0.0)
    return replace(unknown, low=low, high=unknown.high + more)


def _with_steady_torque(problem: Problem) -> Explanation | None:
    """The parameters beside a constant torque in each recording; ``None`` if the bench has one.

    At constant speed that is what all friction of the motor looks like, which real joints have and
    data sheets lack: without it the parameters are drawn to the ends of their tolerances.
    """
    candidate = steady_torque(problem.bench, problem.used)
    if candidate is None:
        return None
    unknowns = [*problem.unknowns, *candidate.unknowns]
    bench = candidate.bench(problem.bench)
    fit = fit_aligned(bench, problem.used, unknowns, problem.workers)
    return Explanation((candidate,), fit)


def _beyond_an_edge(
    found: Explanation, wider: WiderTolerances, problem: Problem
) -> tuple[Explanation, BeyondDataSheet] | None:
    """One parameter beyond its tolerance, where that explains more than chance would."""
    asked = gain_threshold(1, len(problem.parameters), FALSE_ALARM)
    if wider.gain < asked:
        return None
    wrong = _beyond_data_sheet(found, problem)
    if wrong is None:
        return None
    by_same_noise = with_noise(wrong[0], found.fit.model.noise)
    gain = found.fit.chi_square - by_same_noise.fit.chi_square
    return wrong if gain > asked else None


def _beyond_data_sheet(
    nominal: Explanation, problem: Problem
) -> tuple[Explanation, BeyondDataSheet] | None:
    """One parameter beyond its tolerance that explains all, the others within theirs."""
    wider = [
        _widened(nominal, name) for name in problem.parameters if problem.bench.value(name) > 0.0
    ]
    rough = [e for e in (explain(nominal, c) for c in wider) if e is not None]
    best = sorted(rough, key=lambda e: e.fit.chi_square)[:POLISHED]
    fitted = [with_noise(polished(e), remaining_noise(e.fit)) for e in best]
    found = sorted(filter(_agrees, fitted), key=lambda e: e.fit.chi_square)
    if not found:
        return None
    chosen, *others = found
    name = chosen.candidates[-1].name
    value, half = problem.bench.value(name), problem.bench.tolerances[name]
    unknown = chosen.fit.model.unknowns[-1]
    estimate = float(chosen.fit.point[-1])
    ends = [math.log(end) for end in (value - half, value + half) if end > 0.0]
    sd = float(np.sqrt(chosen.fit.covariance[-1, -1]))
    return chosen, BeyondDataSheet(
        name,
        value,
        half,
        float(unknown.value(np.array(estimate))),
        min(abs(estimate - end) for end in ends) / sd,
        tuple(e.candidates[-1].name for e in others if distance(chosen, e) < ALIKE),
    )


def _widened(nominal: Explanation, name: str) -> Candidate:
    """The same parameter over a wider range, in place of the one within its tolerance."""
    fit = nominal.fit
    at = fit.model.index(name)
    centre = math.log(fit.model.bench.value(name))
    reach = math.log(FURTHEST_WRONG)
    unknown = Unknown(name, centre - reach, centre + reach, logarithmic=True)
    start = np.log(fit.model.unknowns[at].value(fit.point[at : at + 1]))
    return Candidate(name, "parameter", (unknown,), start)


def _named(
    nominal: Explanation, steady: Explanation | None, problem: Problem
) -> tuple[Explanation, tuple[tuple[str, ...], ...]]:
    """With the effects that the recordings name; in the bench only if that was asked for."""
    naming: Naming = name_missing(
        _to_name_from(nominal, steady),
        partial(
            candidates,
            nominal.fit.model.bench,
            problem.used,
            "all" if steady is None or not _agrees(steady) else STEADY_EFFECTS,
            declared=problem.parameters,
        ),
        false_alarm=FALSE_ALARM,
    )
    missing = tuple(effect.members for effect in naming.effects)
    if not missing or problem.effects != "catalogue":
        return nominal, missing
    return with_noise(naming.final, remaining_noise(naming.final.fit)), missing


def _to_name_from(nominal: Explanation, steady: Explanation | None) -> SimulatedFit:
    """The nominal comparison where the search begins.

    Where constant torques explain more, that is at their parameters, the torques taken away and
    nothing fitted again: so that friction, once added, finds them as they are.
    """
    if steady is None or steady.fit.chi_square >= nominal.fit.chi_square or nominal.candidates:
        return nominal.fit
    own, old = nominal.fit.point.size, nominal.fit.model
    model = SimulatedSignals(
        old.bench,
        old.recordings,
        old.unknowns,
        steady.fit.model.noise,
        old.workers,
        recent=old.recent,
    )
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
