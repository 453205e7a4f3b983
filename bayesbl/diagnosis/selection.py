"""Effects named in sets, by evidence and by prediction of what they were not fitted on.

For comparisons that are cheap least squares; the closed loop has a search of its own
(:mod:`bayesbl.model_search.closed_loop`).

Effects that are linear in one amplitude and have no shape to be found (Coulomb and viscous
friction, an offset, an asymmetry, …) are much alike in most recordings: alone each would take what
belongs to another. They are therefore fitted together, and the smallest of their sets is taken that
all the rest adds nothing to. The others are tried one at a time beside that set, and the set is
chosen again whenever one of them is named. An effect is believed if

- its amplitude stands out of the noise: Wald's χ² under the sandwich covariance, corrected for
  the number of candidates and of shapes tried, below the false-alarm rate; and it is more probable
  than not, by the evidence below;
- the used pieces are predicted better with it than without, each from a fit on the others, beyond
  what the noise does to that;
- it has the sign that physics gives it.

Of those tried one at a time, the one with the most evidence is named; an earlier one that no longer
stands out is dropped. Nothing here looks at held-out pieces: their disagreement is
that of data which no decision has seen. Evidence is Schwarz's approximation, ½χ² − ½k ln n −
ln(trials), n the effective samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.comparison import (
    Comparison,
    EffectsFit,
    Learning,
    TestedEffect,
    residuals,
    residuals_of_pieces,
    shown_squares,
)
from bayesbl.diagnosis.diagnosis import (
    Diagnosis,
    Estimate,
    NamedEffect,
    PieceSignals,
    probability_of,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import disagreement_table
from bayesbl.diagnosis.fitted_parameters import impossible, parameter_errors
from bayesbl.diagnosis.folds import Folds
from bayesbl.diagnosis.plain_sets import smallest_set
from bayesbl.diagnosis.residual_noise import ResidualNoise, distance, sandwich
from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.diagnosis.shared_scale import scaled_parameters, with_shared_scale
from bayesbl.diagnosis.task import Task
from bayesbl.model_search.constants import ALIKE
from bayesbl.progress import StageProgress
from bayesbl.recording.types import FloatArray

MOST_EFFECTS = 6

LOST = 2.0
"""Times the squares that the first names leave: 1.2 with right names found again beside a spring,
18 where Coulomb friction and a ripple were lost to a torque over the same angle."""

EXCESS = 3.4
"""Of what a bench leaves over the noise floor, up to which it is taken for noise. Slower noise, and
drift, is more, and nothing tells it from an effect that is missing. At 2.5 samples in a period of
the cut-off it is 4 times what does not follow from the samples before: there white noise is 1.16
times that. Denser samples do not move it."""


@dataclass(frozen=True, slots=True)
class Settings:
    """``most``: effects named at the end; ``false_alarm``: of one step with nothing missing."""

    most: int = MOST_EFFECTS
    false_alarm: float = 0.01


@dataclass(frozen=True, slots=True)
class Problem:
    """A comparison with its candidates.

    Attributes
    ----------
    remaining
        Describes what still repeats in a fit's residuals.
    notes
        Sentences about what these recordings cannot show.
    notes_on
        Sentences about the comparison and the fit that are told.
    learn
        Learns what a fit of a comparison leaves, at a false-alarm rate, where it can.
    scale_sd
        Relative standard deviation of a factor that all torques and inertias have in common.
    settle
        The comparison with the bench as it was fitted, and the fit on it.
    stated
        The same without what is fitted unasked, where that is another.
    """

    comparison: Comparison
    remaining: Callable[[EffectsFit], tuple[Unexplained, ...]]
    notes: tuple[str, ...] = ()
    notes_on: Callable[[Any, EffectsFit], tuple[str, ...]] = lambda *_: ()
    learn: Callable[[Any, EffectsFit, float], Learning | None] = lambda *_: None
    scale_sd: float = 0.0
    settle: Callable[[EffectsFit], tuple[Comparison, EffectsFit]] | None = None
    stated: Comparison | None = None


@dataclass(frozen=True, slots=True)
class BySelection:
    """A method of diagnosis whose comparison is cheap: effects are named one by one."""

    name: str
    problem: Callable[[Task], Problem]

    def describe(self, task: Task) -> str:
        """Channel and candidates."""
        comparison = self.problem(task).comparison
        names = ", ".join(candidate.name for candidate in comparison.candidates)
        return f"{self.name}, {comparison.pieces[0].channel}; candidates {names}"

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer."""
        asked = task.config.candidates
        settings = Settings(asked.max_effects or MOST_EFFECTS, asked.false_alarm)
        return diagnose(self.problem(task), task.bench, settings, progress)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A candidate tried beside ``base``."""

    candidate: TestedEffect
    base: EffectsFit
    fit: EffectsFit


def diagnose(
    problem: Problem, bench: Bench, settings: Settings, progress: StageProgress | None = None
) -> Diagnosis:
    """Name what is missing; the disagreement before and after.

    Parameters
    ----------
    bench
        The one believed, for the tolerances of parameters that were fitted.
    """
    comparison = problem.comparison
    nothing = comparison.fit((), None)
    before = nothing if problem.stated is None else problem.stated.fit((), None)
    after = _select(comparison, nothing, settings, progress)
    if problem.settle is not None:
        comparison, after = problem.settle(after)
    learned, answer, denied = None, None, tuple(impossible(after, _deviations(comparison, after)))
    if denied:
        comparison, after = problem.stated or problem.comparison, before
    else:
        learned = problem.learn(comparison, after, settings.false_alarm)
    if learned is not None:
        learned, after = _beside(learned, settings, progress)
        comparison = learned.comparison
        answer = learned.answer(after)
    effects = tuple(
        with_shared_scale(_named(comparison, name, after), problem.scale_sd)
        for name in _by_weight(comparison, after)
    )
    spread = _deviations(comparison, after)
    found = {name: Estimate(v, spread.get(name, math.nan)) for name, v in after.bench.items()}
    estimates = {} if denied else scaled_parameters(found, problem.scale_sd)
    errors = parameter_errors(bench, estimates)
    remaining = problem.remaining(after)
    pieces = residuals_of_pieces(comparison, before, after)
    table = disagreement_table(pieces, in_units_of_noise=False)
    left = table.overall["used"]
    is_much = left.after > EXCESS * left.noise_floor
    remains = bool(remaining or denied or problem.stated) or answer is not None or is_much
    doubts = denied
    if effects and is_much:
        doubts = (
            f"What is named leaves {left.after / left.noise_floor:.0f} times the noise: something "
            "else is missing too, and the sizes may hold part of it.",
        )
    return Diagnosis(
        verdict_of(effects=bool(effects), parameters=bool(errors), remains=remains),
        effects,
        errors,
        remaining,
        table,
        (
            *doubts,
            *problem.notes,
            *problem.notes_on(comparison, after),
            *(() if learned is None else learned.notes(after)),
        ),
        bench_parameters=estimates,
        signals=_signals(comparison, before, after),
        augmented_bench=None if learned is None else learned.bench(after),
        learned=answer,
    )


def _beside(
    learned: Learning, settings: Settings, progress: StageProgress | None
) -> tuple[Learning, EffectsFit]:
    """The fit of what is learned and named together: what blurred the names is modelled.

    If names found again leave far more, a law of the same variable was among those found first:
    they stay.
    """
    if learned.same is not None:
        return learned, learned.same
    named = _select(learned.held, learned.held.fit((), None), settings, progress)
    comparison = learned.comparison
    fit = comparison.fit(tuple(named.effects), named)
    fit = _without_weak(comparison, fit, _threshold(comparison, settings))
    first = learned.as_found
    if first is None or first.same is None:
        return learned, fit
    if shown_squares(comparison, fit) > LOST * shown_squares(first.comparison, first.same):
        return first, first.same
    return learned, fit


def _by_weight(comparison: Comparison, after: EffectsFit) -> list[str]:
    """Named effects, the one without which the shown disagreement would be largest first."""

    def left(name: str) -> float:
        fit = comparison.fit(tuple(e for e in after.effects if e != name), after)
        return shown_squares(comparison, fit)

    return sorted(after.effects, key=left, reverse=True)


def _signals(
    comparison: Comparison, before: EffectsFit, after: EffectsFit
) -> tuple[PieceSignals, ...]:
    return tuple(
        PieceSignals(
            piece.name,
            piece.channel,
            piece.use,
            *map(piece.kept, (piece.time_s, piece.measured, *made)),
        )
        for piece, *made in zip(
            comparison.pieces, before.predictions, after.predictions, strict=True
        )
        if piece.shown
    )


def _select(
    comparison: Comparison, before: EffectsFit, settings: Settings, progress: StageProgress | None
) -> EffectsFit:
    """The fit with every effect that is believed."""
    threshold = _threshold(comparison, settings)
    folds = Folds(comparison)
    dropped = set[str]()
    current = _with_set(comparison, folds, before, settings.most, threshold)
    while len(current.effects) < settings.most:
        trials = []
        open_ones = _open(comparison.candidates, current, dropped)
        for done, candidate in enumerate(open_ones):
            trials.append(_trial(comparison, current, candidate))
            if progress is not None:
                progress(f"Seeking effect {len(current.effects) + 1}", done + 1, len(open_ones))
        good = [t for t in trials if _stands_out(comparison, t.fit, t.candidate, threshold)]
        good = [trial for trial in good if folds.predicts(trial.base, trial.fit, trial.candidate)]
        best = _simplest(comparison, good) if good else None
        if best is None:
            break
        current = best.fit
        for name in [e for e in current.effects if e != best.candidate.name]:
            if not _stands_out(comparison, current, _by_name(comparison, name), threshold):
                dropped.add(name)
                current = comparison.fit(tuple(e for e in current.effects if e != name), current)
        current = _with_set(comparison, folds, current, settings.most, threshold)
    return _without_weak(comparison, current, threshold)


def _threshold(comparison: Comparison, settings: Settings) -> float:
    return settings.false_alarm / max(1, len(comparison.candidates))


def _without_weak(comparison: Comparison, fit: EffectsFit, threshold: float) -> EffectsFit:
    """The fit without effects that do not stand out beside all others, one after the other."""
    while weak := _weakest(comparison, fit, threshold):
        fit = comparison.fit(tuple(e for e in fit.effects if e != weak), fit)
    return fit


def _weakest(comparison: Comparison, fit: EffectsFit, threshold: float) -> str | None:
    """Of the effects that do not stand out beside all others, the one with the least evidence."""
    named = [_by_name(comparison, name) for name in fit.effects]
    weak = [c for c in named if not _stands_out(comparison, fit, c, threshold)]
    return min(weak, key=lambda c: _wald(comparison, fit, c)[2]).name if weak else None


def _with_set(
    comparison: Comparison,
    folds: Folds,
    current: EffectsFit,
    most: int,
    threshold: float,
) -> EffectsFit:
    """The fit with the best set of the plain effects beside those others that are named.

    What does not help to predict is dropped, and the set chosen again.
    """
    dropped = set[str]()
    while True:
        inside = {_by_name(comparison, name).contains for name in current.effects}
        plain = [
            c
            for c in comparison.candidates
            if c.is_plain and c.name not in dropped and c.name not in inside
        ]
        others = tuple(e for e in current.effects if not _by_name(comparison, e).is_plain)
        if not plain:
            return current
        every = comparison.fit((*others, *(c.name for c in plain)), current)
        chosen = smallest_set(comparison, every, plain, most - len(others), threshold)
        fit = comparison.fit((*chosen, *others), every)
        idle = []
        for name in chosen:
            without = comparison.fit(tuple(e for e in fit.effects if e != name), fit)
            candidate = _by_name(comparison, name)
            if not (
                _stands_out(comparison, fit, candidate, threshold)
                and folds.predicts(without, fit, candidate)
            ):
                idle.append(name)
        if not idle:
            return fit
        dropped.update(idle[:1])


def _simplest(comparison: Comparison, good: list[_Trial]) -> _Trial | None:
    """The most probable trial, or a simpler one that cannot be told from it.

    By what each leaves: that an amplitude is sharp says nothing of what else would explain as much.
    ``None`` if the base without any of them is more probable. Simpler: fewer parameters, then
    earlier in the catalogue.
    """
    least = min(good, key=lambda trial: sum(_squares(comparison, trial.fit)))
    noises = _noises(comparison, least.fit)
    sizes = [part.size for part in residuals(comparison, least.fit, "used")]
    counts = [noise.effective_samples(size) for noise, size in zip(noises, sizes, strict=True)]

    def misfit(fit: EffectsFit) -> float:
        return float(np.dot(counts, np.log(_squares(comparison, fit))))

    def improbability(trial: _Trial) -> float:
        """−2 ln of the evidence by Schwarz's approximation, each piece with its own noise."""
        freedom, tried = _freedom(trial.fit, trial.candidate)
        return misfit(trial.fit) + freedom * math.log(max(sum(counts), math.e)) + 2.0 * tried

    better = [trial for trial in good if improbability(trial) < misfit(trial.base)]
    if not better:
        return None
    best = min(better, key=improbability)
    noises = _noises(comparison, best.fit)
    theirs = _used(comparison, best.fit)
    alike = [t for t in better if distance(theirs, _used(comparison, t.fit), noises) < ALIKE]
    order = [candidate.name for candidate in comparison.candidates]

    def simplicity(trial: _Trial) -> tuple[int, int]:
        name = trial.candidate.name
        return len(trial.fit.effects[name]), order.index(name)

    return min(alike, key=simplicity)


def _squares(comparison: Comparison, fit: EffectsFit) -> list[float]:
    """Of what a fit leaves of each used piece."""
    tiny = np.finfo(float).tiny
    return [max(float(part @ part), tiny) for part in residuals(comparison, fit, "used")]


def _freedom(fit: EffectsFit, candidate: TestedEffect) -> tuple[int, float]:
    """Degrees of freedom of an effect, and ln of the number of shapes that were tried."""
    phases = sum(name.startswith(f"{candidate.name}.phase_rad") for name in fit.names)
    return candidate.freedom * max(1, phases), math.log(fit.trials.get(candidate.name, 1.0))


def _noises(comparison: Comparison, fit: EffectsFit) -> list[ResidualNoise]:
    """Of the used pieces."""
    return [ResidualNoise.of(part) for part in residuals(comparison, fit, "used")]


def _used(comparison: Comparison, fit: EffectsFit) -> list[FloatArray]:
    """Predictions of the used pieces, at the samples that count."""
    pairs = zip(comparison.pieces, fit.predictions, strict=True)
    return [piece.kept(prediction) for piece, prediction in pairs if piece.use == "used"]


def _open(
    candidates: tuple[TestedEffect, ...], current: EffectsFit, dropped: set[str]
) -> list[TestedEffect]:
    """Candidates still open: skip those named, dropped or contained in a named one.

    A composite effect comes only after its simpler part.
    """
    inside = {c.contains for c in candidates if c.name in current.effects}
    return [
        c
        for c in candidates
        if not c.is_plain
        and c.name not in current.effects
        and c.name not in dropped
        and c.name not in inside
        and (c.contains is None or c.contains in current.effects)
    ]


def _trial(comparison: Comparison, current: EffectsFit, candidate: TestedEffect) -> _Trial:
    kept = tuple(name for name in current.effects if name != candidate.contains)
    return _Trial(candidate, current, comparison.fit((*kept, candidate.name), current))


def _stands_out(
    comparison: Comparison, fit: EffectsFit, candidate: TestedEffect, threshold: float
) -> bool:
    """Whether an effect of a fit stands out of the noise, with a size that physics allows.

    By its p-value and by its probability, which must be above one half.
    """
    if candidate.name in fit.at_edge:
        return False
    if not candidate.is_physical(fit.effects[candidate.name][candidate.amplitude]):
        return False
    _, log_p, log_evidence = _wald(comparison, fit, candidate)
    return log_p < math.log(threshold) and log_evidence > 0.0


def _wald(
    comparison: Comparison, fit: EffectsFit, candidate: TestedEffect
) -> tuple[float, float, float]:
    """z of the amplitude, ln p corrected for the shapes tried, and log evidence."""
    noises = _noises(comparison, fit)
    index = fit.names.index(f"{candidate.name}.{candidate.amplitude}")
    variance = float(sandwich(fit.columns, noises)[index, index])
    amplitude = fit.effects[candidate.name][candidate.amplitude]
    z = abs(amplitude) / math.sqrt(variance) if variance > 0.0 else 0.0
    freedom, trials = _freedom(fit, candidate)
    log_p = min(0.0, float(chi2.logsf(z**2, freedom)) + trials)
    sizes = [part.size for part in residuals(comparison, fit, "used")]
    n = sum(noise.effective_samples(size) for noise, size in zip(noises, sizes, strict=True))
    return z, log_p, 0.5 * z**2 - 0.5 * freedom * math.log(max(n, math.e)) - trials


def _named(comparison: Comparison, name: str, after: EffectsFit) -> NamedEffect:
    """A named effect, tested once more beside all the others."""
    candidate = _by_name(comparison, name)
    z, _, log_evidence = _wald(comparison, after, candidate)
    spread = _deviations(comparison, after)
    parameters = {
        key: Estimate(value, spread.get(f"{name}.{key}", math.nan))
        for key, value in after.effects[name].items()
    }
    alike = (*candidate.same_as, *_rivals(comparison, after, candidate))
    return NamedEffect(name, parameters, probability_of(log_evidence), z, alike)


def _rivals(comparison: Comparison, after: EffectsFit, named: TestedEffect) -> list[str]:
    """Effects that, put in the place of a named one, predict what it predicts within the noise."""
    used = _used(comparison, after)
    noises = _noises(comparison, after)
    others = tuple(name for name in after.effects if name != named.name)
    without = comparison.fit(others, after)
    found = []
    for rival in comparison.candidates:
        if rival.name in after.effects or named.name == rival.contains:
            continue
        fit = comparison.fit((*others, rival.name), without)
        amplitude = fit.effects[rival.name][rival.amplitude]
        if rival.name in fit.at_edge or not rival.is_physical(amplitude):
            continue  # at the end of its range it is only the named effect in disguise
        if distance(used, _used(comparison, fit), noises) < ALIKE:
            found += [rival.name, *rival.same_as]
    return found


def _deviations(comparison: Comparison, fit: EffectsFit) -> dict[str, float]:
    noises = _noises(comparison, fit)
    variances: FloatArray = np.diag(sandwich(fit.columns, noises)) if fit.names else np.array([])
    return dict(zip(fit.names, np.sqrt(np.maximum(variances, 0.0)).tolist(), strict=True))


def _by_name(comparison: Comparison, name: str) -> TestedEffect:
    return next(c for c in comparison.candidates if c.name == name)
