"""Joint posterior of a bench's parameters, from a data sheet and recordings.

All parameters that are not known exactly are free within their tolerances, together with the gap
and each recording's start angle. The fit and its posterior are those of the direct route.
Hypotheses are the effects of the catalogue, including a delay of the drive, which the tolerances
would absorb, and a value beyond its tolerance for each parameter. One posterior over their sets
decides (:mod:`bayesbl.model_search.closed_loop`).

One value of a data sheet may also be grossly wrong. A fit descends from its start, and a value in
kg cm² instead of kg m² leads to another local minimum. So each parameter's factor is scanned alone,
from the middle of the data sheet. The χ² there says little: gravity's current dominates it, and is
off by the tolerances of other parameters. The points are ranked by the χ² that one step of all
unknowns, within their ranges, promises to leave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, BenchParameter
from bayesbl.bench.effects import EFFECTS
from bayesbl.bench.kernel import Slot
from bayesbl.bench.parameters import JointNormal
from bayesbl.bench.steady import contact_rates
from bayesbl.diagnosis.closed_loop.prediction import augmented_bench
from bayesbl.errors import BenchError
from bayesbl.matching.alignment import aligned_starts, fit_aligned, remaining_noise, valid_variant
from bayesbl.matching.least_squares import fit_simulated, promised_within
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import RepeatingPower, agrees, is_explained
from bayesbl.matching.signals import SimulatedSignals, Unknown
from bayesbl.model_search.always_in import LinearisedFit, laws, with_far_terms_freed
from bayesbl.model_search.catalogue import Candidate, candidates
from bayesbl.model_search.closed_loop import name_missing, weighed
from bayesbl.model_search.constants import LEAVES_MOST, NAMED_AT, SLACK
from bayesbl.model_search.pipeline import AveragedFit, direct_unknowns
from bayesbl.model_search.refit import (
    SCANNED_GAPS,
    Explanation,
    extended,
    from_afar,
    polished,
    refit,
    with_noise,
    with_own_noise,
)
from bayesbl.model_search.residuals import motor_orders
from bayesbl.progress import Progress, StageProgress, of_stage, silent
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.chains import SamplerSettings

Verdict = Literal["agrees", "missing_effect", "unexplained"]

AFAR = "Seeking a value wrong by far"
"""Stage name of the progress."""

DELAYS = tuple(e.name for e in EFFECTS if e.enters in ("loop", "measurement"))
"""Delays of the drive, between motor and controller, and of the recording."""


@dataclass(frozen=True, slots=True)
class Problem:
    """What is identified, and from what.

    ``used``, ``held_out``: recordings to fit, and to predict; ``parameters``: free bench
    parameters, each with a tolerance; ``effects``: effects that are free from the start, by name;
    ``"catalogue"``: those that the recordings name.
    """

    bench: Bench
    used: tuple[Observed, ...]
    held_out: tuple[Observed, ...]
    parameters: tuple[str, ...]
    effects: tuple[str, ...] | Literal["catalogue"]
    gap_rad: tuple[float, float]
    workers: int = field(default=1, compare=False)

    @property
    def unknowns(self) -> list[Unknown]:
        """Gaps, start angles, delays of motions, effects of the bench file, and parameters."""
        names = [observation.name for observation in self.used]
        moving = [observation.name for observation in self.used if observation.motion is not None]
        fixed = set(self.bench.tolerances) - set(self.parameters)
        unknowns = direct_unknowns(self.bench, names, self.gap_rad, moving)
        return [unknown for unknown in unknowns if unknown.name not in fixed]


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
        Distance of ``found`` from the nearer end of the tolerance, in standard deviations.
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
    """Fits of the recordings.

    Attributes
    ----------
    nominal
        The data sheet within its tolerances, with the effects asked for. It is ``final`` if such a
        fit is far off and one value beyond its tolerance explains everything.
    final
        With the hypotheses found.
    beyond
        The wrong value of the data sheet, if there is one.
    missing
        Names of effects that the bench lacks, each with those indistinguishable from it.
    """

    nominal: Explanation
    final: Explanation
    beyond: BeyondDataSheet | None = None
    missing: tuple[tuple[str, ...], ...] = ()

    @property
    def completed(self) -> bool:
        """Whether the final bench includes anything found."""
        return self.final.names != self.nominal.names


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification(Match):
    """Result of an identification.

    ``check``: what still repeats; ``allows_for_misfit``: whether gap and bench include the possible
    effect of an unnamed law.
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
    """Fit the bench, complete it if something else explains the recordings, and sample.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    match, unnamed = _match(problem, progress)
    linear_fit = with_far_terms_freed(match.final.fit, laws(match.final.fit.model.bench))
    if not linear_fit.explains and unnamed is not None and linear_fit.fit is match.final.fit:
        linear_fit = unnamed
    match = replace(match, final=replace(match.final, fit=linear_fit.fit))
    verdict: Verdict = "agrees" if linear_fit.explains else "unexplained"
    if match.missing:
        verdict = "missing_effect"
    drawing, simulating = (of_stage(progress, s) for s in ("Sampling", "Simulating draws"))
    return Identification(
        match.nominal,
        match.final,
        match.beyond,
        match.missing,
        verdict=verdict,
        check=linear_fit.check,
        posterior=AveragedFit(linear_fit=linear_fit).sampled(sampler, seed, drawing, simulating),
        allows_for_misfit=not agrees(linear_fit.check) and linear_fit.is_useful,
    )


def _match(problem: Problem, progress: StageProgress | None) -> tuple[Match, LinearisedFit | None]:
    """Fit the data sheet, completed by what explains the recordings.

    Also returns the terms linearised at it, misfit included, if a search made them.
    """
    # A fit with an implausible data sheet would take minutes or fail.
    nominal = _nominal(problem, progress) if is_plausible(problem) else None
    # A fit that leaves more than noise does: it decides only the order of two searches.
    far_off = nominal is None or (
        may_be_wrong_by_far(problem) and nominal.fit.chi_square > 2.0 * nominal.fit.residual.size
    )
    gross_error = far_beyond_data_sheet(problem, of_stage(progress, AFAR)) if far_off else None
    if gross_error is not None:
        return replace(gross_error, nominal=nominal or gross_error.final), None
    if nominal is None:
        nominal = _nominal(problem, progress)
    problem = replace(problem, used=tuple(nominal.fit.model.recordings))
    nominal = replace(
        nominal, fit=with_far_terms_freed(nominal.fit, laws(nominal.fit.model.bench)).fit
    )
    naming = name_missing(
        nominal.fit,
        partial(_hypotheses, problem, nominal),
        nuisances=laws(nominal.fit.model.bench),
        progress=of_stage(progress, "Naming what is missing"),
    )
    if naming.repeats and not far_off:
        gross_error = far_beyond_data_sheet(problem, of_stage(progress, AFAR))
        if gross_error is not None:
            return replace(gross_error, nominal=nominal), None
    missing = tuple(e.members for e in naming.effects if e.candidate.kind == "effect")
    is_asked = problem.effects == "catalogue" or all(set(m) <= set(DELAYS) for m in missing)
    if not naming.effects or not is_asked:
        return Match(nominal, nominal, None, missing), None if naming.effects else naming.linear_fit
    final = replace(naming.final, fit=valid_variant(naming.final.fit))
    wrong = next((e for e in naming.effects if e.candidate.kind == "parameter"), None)
    beyond = None
    if wrong is not None:
        beyond = _beyond(final, wrong.candidate, wrong.members[1:], problem)
    linear_fit = naming.linear_fit if final.fit is naming.final.fit else None
    return Match(nominal, final, beyond, missing), linear_fit


def _hypotheses(problem: Problem, nominal: Explanation, peaks: Sequence[float]) -> list[Candidate]:
    """What the data sheet may lack: effects, and each value beyond its tolerance."""
    effects = candidates(nominal.fit.model.bench, problem.used, "all", peaks)
    # A sampled reference has rounded corners, as from a delay.
    moving = all(observation.motion is not None for observation in problem.used)
    hypotheses = [c for c in effects if c.kind == "effect" and not (moving and c.name in DELAYS)]
    for name in problem.parameters:
        value, half = problem.bench.value(name), problem.bench.tolerances[name]
        if value > half:
            usual = np.array([math.log1p(half / value)])
            hypotheses.append(replace(freed(name, nominal.fit.value(name)), usual=usual))
    return hypotheses


def _nominal(problem: Problem, progress: StageProgress | None) -> Explanation:
    """Fit the bench within its tolerances, with the effects asked for by name."""
    stage = of_stage(progress, "Fitting the bench")
    fit = fit_aligned(problem.bench, problem.used, problem.unknowns, problem.workers, stage)
    nominal = Explanation((), fit)
    if problem.effects not in ("catalogue", ()):
        nominal = _with_effects(nominal, problem, motor_orders(fit))
    return replace(nominal, fit=valid_variant(nominal.fit))


def _with_effects(nominal: Explanation, problem: Problem, peaks: Sequence[float]) -> Explanation:
    """Add the effects asked for by name, one after the other."""
    best = nominal
    requested = candidates(problem.bench, problem.used, problem.effects, peaks)
    for candidate in (c for c in requested if c.kind == "effect"):
        starts = [candidate.neutral + np.nan_to_num(candidate.usual), *candidate.starts]
        no_shift = np.zeros(best.fit.point.size)
        trials = [refit(best, [(candidate, start)], no_shift) for start in starts]
        if not is_explained(best.fit):
            trials += from_afar(best, [candidate])
        fits = [e for e in trials if e is not None]
        best = min(fits, key=lambda e: e.fit.chi_square, default=best)
    return with_own_noise(with_noise(polished(best), remaining_noise(best.fit)))


def parameter_draws(result: Identification, names: Sequence[str]) -> FloatArray:
    """Draws of the bench's parameters in their units, shape (draw, k).

    For a parameter that was sought beyond its tolerance, those of the wider range.
    """
    unknowns = result.final.fit.model.unknowns
    indices = {u.name: i for i, u in enumerate(unknowns) if u.recording is None}
    flat = result.posterior.draws.reshape(-1, len(unknowns))
    return np.column_stack([unknowns[indices[n]].value(flat[:, indices[n]]) for n in names])


def identified_bench(result: Identification, problem: Problem) -> Bench:
    """The bench with everything found; positive parameters have a joint normal prior of logarithms.

    The tolerance of each parameter is that of a uniform prior with the same standard deviation.
    """
    bench = augmented_bench(result.final)
    draws = parameter_draws(result, problem.parameters)
    parameters = dict(bench.parameters)
    for name, column in zip(problem.parameters, draws.T, strict=True):
        logarithm = np.log(column) if column.min() > 0.0 else None
        middle = float(column.mean()) if logarithm is None else math.exp(float(logarithm.mean()))
        half = math.sqrt(3.0) * float(column.std())
        parameters[name] = BenchParameter(middle, half)
    together = [i for i, column in enumerate(draws.T) if column.min() > 0.0]
    if not together:
        return replace(bench, parameters=parameters)
    covariance = np.atleast_2d(np.cov(np.log(draws[:, together]).T))
    names = tuple(problem.parameters[i] for i in together)
    return replace(bench, parameters=parameters, identified=JointNormal(names, covariance))


KG_CM2_PER_KG_M2 = 1e4

STEP = math.sqrt(10.0)
"""Ratio of scanned factors: two in a decade. The promise falls over more than that to either side
of the true value. With one in a decade, a stiffness between two points was not found."""

REACH = STEP**2
"""Largest factor of a fit, up or down: to the next point but one. Without a limit, fits of correct
parameters ran off to where a joint takes minutes to simulate."""

SD_DRAWS = 4000
"""A standard deviation is then exact to 1 %."""

FASTEST_PER_S = 5e3
"""Rate of a speed loop or shaft (800 Hz) beyond which a point is not scanned. Real joints reach
some hundred Hz, and the simulation time grows with the rate. A data sheet beyond it is first
searched for a gross error, and fitted like any other if there is none."""


def far_beyond_data_sheet(problem: Problem, progress: Progress = silent) -> Match | None:
    """Find one value beyond its tolerance that explains everything, over its whole range.

    Each parameter is fitted roughly from its best point, the others within their tolerances. All
    contenders are fitted, because promises are inexact where signals are nonlinear. ``progress``:
    called with (points scanned, points in all).
    """
    model = _nothing_fitted(problem)
    scan = _scan_candidates(problem)
    best: dict[str, tuple[float, FloatArray, Candidate]] = {}
    for scanned, candidate in enumerate(scan):
        progress(scanned, len(scan))
        excess, point = _promised(model, candidate)
        if excess < best.get(candidate.name, (math.inf,))[0]:
            best[candidate.name] = excess, point, candidate
    limit = (
        LEAVES_MOST * max(min((excess for excess, *_ in best.values()), default=0.0), 0.0) + SLACK
    )
    rough: list[Explanation] = []
    for excess, point, candidate in best.values():
        if excess < limit:
            with suppress(BenchError):
                fit = fit_simulated(extended(model, candidate), point, rough=True)
                rough.append(Explanation((candidate,), fit))
    rough.sort(key=lambda e: e.fit.chi_square)
    fitted = [with_noise(polished(e), remaining_noise(e.fit)) for e in rough[:3]]
    valid = [weighed(e) for e in fitted if is_explained(e.fit) and _is_outside(e, problem)]
    if not valid:
        return None
    chosen = max(valid, key=lambda entry: entry.log_evidence)
    threshold = chosen.log_evidence + math.log(1.0 - NAMED_AT)
    rivals = [e.explanation for e in valid if e is not chosen and e.log_evidence > threshold]
    could_be, final = tuple(e.candidates[-1].name for e in rivals), chosen.explanation
    return Match(final, final, _beyond(final, final.candidates[-1], could_be, problem))


def _is_outside(explanation: Explanation, problem: Problem) -> bool:
    """Whether the last freed parameter is beyond its tolerance."""
    name = explanation.candidates[-1].name
    value = float(explanation.fit.model.unknowns[-1].value(explanation.fit.point[-1]))
    return abs(value - problem.bench.value(name)) > problem.bench.tolerances[name]


def _beyond(
    final: Explanation, candidate: Candidate, could_be: tuple[str, ...], problem: Problem
) -> BeyondDataSheet:
    name, fit = candidate.name, final.fit
    (index,) = final.places(candidate)
    value, half = problem.bench.value(name), problem.bench.tolerances[name]
    ends = [math.log(end) for end in (value - half, value + half) if end > 0.0]
    sd = float(weighed(final).draws(np.random.default_rng(0), SD_DRAWS)[:, index].std())
    coordinate = float(fit.point[index])
    deviations = min(abs(coordinate - end) for end in ends) / sd
    return BeyondDataSheet(name, value, half, math.exp(coordinate), deviations, could_be)


def freed(name: str, value: float) -> Candidate:
    """A parameter as a candidate, sought around a value."""
    centre, reach = math.log(value), math.log(REACH)
    unknown = Unknown(name, centre - reach, centre + reach, logarithmic=True)
    usual = np.array([math.log(STEP)])
    return Candidate(name, "parameter", (unknown,), np.array([centre]), usual=usual)


def is_plausible(problem: Problem) -> bool:
    """Whether a joint can be as on the data sheet; few data sheets with a wrong unit pass."""
    model = _nothing_fitted(problem)
    return _is_plausible_at(model, _middle(model))


def may_be_wrong_by_far(problem: Problem) -> bool:
    """Whether a gross error is sought before missing effects.

    Scans of motions take long, so everything else is sought first; so are effects that are asked
    for.
    """
    requested = problem.effects not in ("catalogue", ())
    return not requested and all(observation.motion is None for observation in problem.used)


def _nothing_fitted(problem: Problem) -> SimulatedSignals:
    noise = [noise_of(observation, observation.signals) for observation in problem.used]
    return SimulatedSignals(problem.bench, problem.used, problem.unknowns, noise, problem.workers)


def _middle(model: SimulatedSignals) -> FloatArray:
    return np.array([u.middle for u in model.unknowns])


def _scan_candidates(problem: Problem) -> list[Candidate]:
    """Each parameter at factors of its value, up and down to the largest that is sought."""
    largest = max(KG_CM2_PER_KG_M2, problem.bench.value("gear_ratio") ** 2)
    steps = math.ceil(math.log(largest) / math.log(STEP))
    values = {name: problem.bench.value(name) for name in problem.parameters}
    return [
        freed(name, value * STEP**step)
        for name, value in values.items()
        if value > 0.0
        for step in range(-steps, steps + 1)
    ]


def _promised(model: SimulatedSignals, candidate: Candidate) -> tuple[float, FloatArray]:
    """Promised χ² beyond noise with one parameter near a value, and the point that promises it.

    The parameter is the last unknown; gap and start angles are the best ones there. Infinite if the
    bench is implausible.
    """
    extended_model = extended(model, candidate)
    centre = float(candidate.neutral[0])
    point = np.append(_middle(model), centre)
    if not _is_plausible_at(extended_model, point):
        return math.inf, point
    point = aligned_starts(extended_model, {point.size - 1: np.array([centre])}, SCANNED_GAPS)[0]
    low, high = extended_model.low, extended_model.high
    low[-1], high[-1] = centre - math.log(STEP), centre + math.log(STEP)
    excess = promised_within(extended_model, point, low, high) - extended_model.size
    return excess if math.isfinite(excess) else math.inf, point


def _is_plausible_at(model: SimulatedSignals, point: FloatArray) -> bool:
    """Whether the drive lifts the load, the loop forgets in time, and nothing is too fast.

    In time means within a rotation, or a motion's recording: otherwise rotations would not repeat.
    """
    row = model.vectors(point[None], model.recordings[0])[0]
    duration_s = max(
        observation.samples / observation.sampling_hz
        if observation.motion is not None
        else observation.rotation_period_s
        for observation in model.recordings
    )
    torque_nm = row[Slot.torque_constant_nm_per_a] * row[Slot.current_limit_a]
    if row[Slot.gravity_torque_nm] > row[Slot.gear_ratio] * torque_nm:
        return False
    slowest_per_s = -float(np.max(contact_rates(row[None]).real))
    return slowest_per_s * duration_s > 1.0 and _fastest_per_s(row) < FASTEST_PER_S


def _fastest_per_s(row: FloatArray) -> float:
    """The largest of K_p/J_m, D_s/J and √(K_s/J) of the shaft, with 1/J = 1/J_l + 1/(r² J_m)."""
    motor, ratio = row[Slot.motor_inertia_kg_m2], row[Slot.gear_ratio]
    shaft = 1.0 / row[Slot.load_inertia_kg_m2] + 1.0 / (ratio**2 * motor)
    loop = row[Slot.speed_gain_nm_s_per_rad] / motor
    damping = row[Slot.shaft_damping_nm_s_per_rad] * shaft
    ringing = math.sqrt(row[Slot.shaft_stiffness_nm_per_rad] * shaft)
    return float(max(loop, damping, ringing))
