"""Closed-loop diagnosis of a two-mass bench from speed and current.

Recordings are compared with their simulation (:mod:`bayesbl.matching.signals`), and
:mod:`bayesbl.model_search` finds what is missing. :mod:`.learned_in_loop` learns what no effect
explains. :mod:`.prediction` adds the findings to the bench, simulates held-out recordings, and
suggests the next one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from bayesbl.bench.bench import Bench, heaviest, require_flank_change
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.closed_loop.learned_in_loop import (
    Learned,
    answer_of,
    learned_term,
    why_no_gap,
)
from bayesbl.diagnosis.closed_loop.prediction import (
    augmented_bench,
    compared_pieces,
    suggested_recording,
)
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, NamedEffect, ParameterError, verdict_of
from bayesbl.diagnosis.disagreement import ComparedPiece
from bayesbl.diagnosis.task import (
    USES_OF,
    Comparison,
    Task,
    notes_of,
    parts_of,
    require_no_known_torque,
    unclipped,
)
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import ROUNDING, Observed, observed
from bayesbl.matching.posterior import DirectPosterior, sample_direct
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import (
    GAP,
    START_ANGLE,
    Unknown,
    gap_unknown,
    shift_unknowns,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.model_search.always_in import laws
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.closed_loop import FittedSet, Naming, laws_of_shaft, name_missing, weighed
from bayesbl.model_search.constants import UNEXPLAINED_SHARE
from bayesbl.model_search.pipeline import AveragedFit
from bayesbl.model_search.refit import Explanation, with_own_noise
from bayesbl.model_search.residuals import ResidualAnalysis, residuals_of
from bayesbl.progress import Progress, StageProgress, of_stage, silent
from bayesbl.recording.checks import moves, require_alive, require_channels
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    FloatArray,
    Recording,
)
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sentences import flaws_in_words, tolerance_decides
from bayesbl.units import in_words

MOST_EFFECTS = 3


@dataclass(frozen=True, slots=True)
class Findings:
    """Result of the search, and the residuals of its simulations.

    Attributes
    ----------
    chosen
        The set of all named hypotheses with its own noise, with anything learned and with laws that
        are always in.
    pieces
        Channels of all recordings, also held-out ones, with both simulations.
    before, after
        Residuals without and with the named hypotheses.
    learned
        What was learned from the remaining residual; ``chosen`` includes it.
    """

    naming: Naming
    chosen: FittedSet
    pieces: tuple[ComparedPiece, ...]
    before: ResidualAnalysis
    after: ResidualAnalysis
    learned: Learned | None = None

    @property
    def believed(self) -> Bench:
        """The bench of the file."""
        return self.naming.nominal.fit.model.bench

    @property
    def final(self) -> Explanation:
        """The fit of the named hypotheses."""
        return self.chosen.explanation

    @property
    def whole(self) -> AveragedFit:
        """The fit with everything to average over: misfit, noise in the loop, laws that are always
        in, and all other sets, unless a torque was learned."""
        others = () if self.learned else self.naming.others
        nuisances = laws(self.final.fit.model.bench)
        return AveragedFit(linear_fit=self.chosen, others=others, nuisances=nuisances)


def search(
    bench: Bench,
    used: Sequence[Observed],
    held_out: Sequence[Observed],
    unknowns: Sequence[Unknown],
    *,
    effects: Sequence[str] | Literal["all"] = "all",
    max_effects: int = MOST_EFFECTS,
    load_angle_known: bool = False,
    motor_angle_known: bool = False,
    workers: int = 1,
    progress: Progress = silent,
) -> Findings:
    """Align, name what is missing, and analyse the residual.

    Parameters
    ----------
    used, held_out
        Recordings to fit, and to predict.
    unknowns
        Declared unknowns: gap and start angle of each recording, and bench parameters.
    effects, max_effects, load_angle_known, motor_angle_known
        As in ``[candidates]`` and ``[comparison]``.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    nominal = fit_aligned(bench, used, unknowns, workers)
    catalogue = partial(
        candidates,
        bench,
        used,
        effects,
        declared=[u.name for u in unknowns],
        load_angle_known=load_angle_known,
        motor_angle_known=motor_angle_known,
    )
    missing = partial(
        name_missing, candidates=catalogue, max_effects=max_effects, progress=progress
    )
    naming, learned = missing(nominal), None
    final = naming.final
    before, after = residuals_of(naming.nominal.fit), residuals_of(final.fit)
    if naming.effects and after.remaining and after.closes(before) < 1.0 - UNEXPLAINED_SHARE:
        # A parameter may help a little although, for example, a line in time remains.
        nearest, final = naming.final, naming.nominal
        naming = replace(naming, repeats=True, final=final, effects=(), nearest=nearest)
        after = before
    # Lines of the motor or in time do not repeat with the load, so they are in no band.
    if naming.repeats or (after.remaining and not laws_of_shaft(naming.final)):
        extended = _with_learned(naming, final, after, missing, motor_angle_known)
        if extended is not None:
            naming, learned = extended
            final = learned.explanation
    return Findings(
        naming,
        weighed(final, laws(final.fit.model.bench)),
        compared_pieces(naming.nominal, final, held_out),
        before,
        after if learned is None else residuals_of(final.fit),
        learned,
    )


def _with_learned(
    naming: Naming,
    final: Explanation,
    after: ResidualAnalysis,
    missing: Callable[[SimulatedFit], Naming],
    motor_angle_known: bool,
) -> tuple[Naming, Learned] | None:
    """What is learned from the residual, and the naming with it; ``None`` if nothing is.

    If no set explains the recordings, something is also sought at the nearest explanation, because
    the gap of the nominal bench may be too far off.
    """
    around = [(final, after.remaining)]
    if naming.nearest is not None:
        near = with_own_noise(naming.nearest)
        around.append((near, residuals_of(near.fit).remaining))
    learned = learned_term(final, around, motor_angle_known)
    if learned is None:
        return None
    if not naming.effects and not is_explained(learned.explanation.fit):
        # What is learned now may have hidden a law of the catalogue.
        again = missing(learned.explanation.fit)
        if again.effects:
            learned = replace(learned, explanation=again.final)
            return replace(again, nominal=naming.nominal), learned
    return replace(naming, final=learned.explanation), learned


def diagnosis_of(
    findings: Findings,
    posterior: DirectPosterior | None = None,
    notes: Sequence[str] = (),
    level: float = 0.9,
) -> Diagnosis:
    """Make the result from the findings.

    ``posterior``: at ``findings.final``; without one, or if it is withheld, estimates come from the
    normal approximation. ``level``: of the credible intervals.
    """
    naming, final = findings.naming, findings.final
    kinds = {candidate.kind for candidate in final.candidates}
    withheld = _why_no_gap(findings, posterior, level)
    is_sampled = posterior is not None and posterior.diagnostics.outcome != "withheld"
    sampled = posterior if is_sampled else None
    gaps, doubts = dict[str, Estimate](), list[str]()
    if not withheld:
        seed = np.random.SeedSequence(0)
        around = sampled or sample_direct(final.fit, SamplerSettings(), seed, withheld=True)
        whole = findings.whole.averaged(around, seed)
        gaps, doubts = _averaged_gaps(whole), [*_doubts_in_words(findings, whole)]
        if sampled is not None:
            posterior = sampled = whole
    first = final.fit.model.recordings[0].name
    named = [(effect, estimates(final, effect.name, sampled)) for effect in naming.effects]
    return Diagnosis(
        verdict_of(
            effects="effect" in kinds,
            parameters="parameter" in kinds,
            remains=naming.repeats
            or bool(findings.after.remaining)
            or findings.learned is not None,
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
                findings.believed.value(effect.name),
                findings.believed.parameters[effect.name].tolerance,
                fitted[effect.name],
                effect.members[1:],
            )
            for effect, fitted in named
            if effect.candidate.kind == "parameter"
        ),
        findings.after.remaining,
        findings.pieces,
        (*notes, *doubts),
        bench_parameters=_declared_parameters(findings, sampled),
        delta_before=_estimate(naming.nominal, naming.nominal.fit.model.index(GAP, first), None),
        gaps=gaps,
        gap_withheld=withheld,
        suggestion=suggested_recording(naming.final, naming.effects),
        posterior=posterior,
        augmented_bench=augmented_bench(final) if final.candidates or findings.learned else None,
        learned=None if findings.learned is None else answer_of(findings.learned),
    )


def estimates(
    explanation: Explanation, name: str, posterior: DirectPosterior | None = None
) -> dict[str, Estimate]:
    """Values of one named effect or parameter, fitted or fixed by its entry in the bench.

    The phase of a single recording has the recording's name in parentheses.
    """
    by_name: dict[str, Estimate] = {}
    for effect in explanation.fit.model.bench.effects:
        if effect.name == name:
            by_name |= {k: Estimate(v.value, math.nan) for k, v in effect.parameters.items()}
    for i, unknown in enumerate(explanation.fit.model.unknowns):
        owner, _, parameter = unknown.name.rpartition("__")
        if name in (owner, unknown.name):
            own = unknown.recording
            if own is not None:
                by_name.pop(parameter, None)
            key = parameter if own is None else f"{parameter} ({own})"
            by_name[key] = _estimate(explanation, i, posterior)
    return by_name


def _estimate(explanation: Explanation, i: int, posterior: DirectPosterior | None) -> Estimate:
    """Estimate of one unknown's coordinate; its draws are in the value's unit."""
    fit = explanation.fit
    unknown = fit.model.unknowns[i]
    draws = None if posterior is None else unknown.value(posterior.draws[..., i])
    sd = float(np.sqrt(fit.covariance[i, i]))
    return Estimate(float(fit.point[i]), sd, draws, unknown.logarithmic)


def _averaged_gaps(posterior: DirectPosterior) -> dict[str, Estimate]:
    gaps = {}
    for observation in posterior.fit.model.recordings:
        values = posterior.values(GAP, observation.name)
        logs = np.log(values)
        gaps[observation.name] = Estimate(
            float(logs.mean()), float(logs.std()), values, logarithmic=True
        )
    return gaps


def _declared_parameters(
    findings: Findings, posterior: DirectPosterior | None
) -> dict[str, Estimate]:
    return {
        unknown.name: _estimate(findings.final, i, posterior)
        for i, unknown in enumerate(findings.final.fit.model.unknowns)
        if unknown.name in findings.believed.parameters and unknown.name not in findings.final.names
    }


def _doubts_in_words(findings: Findings, whole: DirectPosterior) -> Iterator[str]:
    """How the inexact form of a named law and the misfit widen the interval of δ."""
    gaps = [i for i, unknown in enumerate(whole.fit.model.unknowns) if unknown.name == GAP]
    wider = float(whole.model_widening[gaps].max())
    of_shaft = [in_words(c.name) for c in laws_of_shaft(findings.naming.final)]
    if wider > 1.05 and (of_shaft or findings.chosen.misfit > 0.0):
        why = "Something repeats that no name explains."
        if of_shaft:
            why = f"No real shaft follows the law of {' and '.join(of_shaft)} exactly."
        yield (
            f"{why} For this, and for laws that no recording shows, the gap's interval is "
            f"{'up to ' if len(gaps) > 1 else ''}{wider:.2g} times as wide."
        )


def _why_no_gap(findings: Findings, posterior: DirectPosterior | None, level: float) -> str:
    """Reason why the recordings do not determine δ; empty otherwise."""
    if findings.learned is not None:
        # Tests decide whether something remains: a share of nearly nothing says little.
        remains = bool(findings.after.remaining) or not is_explained(findings.final.fit)
        return why_no_gap(findings.learned, findings.after.closes(findings.before), remains)
    if findings.naming.repeats:
        return (
            "Something repeats that neither the bench nor the catalogue explains. It may move the "
            "gap by more than anything else, so no gap is given. Record another speed or "
            "direction, and look at the residuals."
        )
    if posterior is not None:
        for observation in findings.final.fit.model.recordings:
            if decides := posterior.beyond_tolerance(observation.name, level):
                return tolerance_decides(**decides)
    return ""


CHANNELS = (MOTOR_SPEED, MOTOR_CURRENT)
DEFAULT_GAP_RAD = (1e-4, 4e-3)
KNOWN_ANGLE_SD_RAD = 1e-3
"""Standard deviation of a start angle that a load encoder gives."""

NEAR_LIMIT = 0.95
"""Share of the drive's current limit from which the limit may hold the current."""

SPEED_ALONE = (
    "There is no motor current: friction, offsets and the torque constant cannot be told apart "
    "by the speed alone, as the controller's integral hides them."
)

NOT_SAMPLED = (
    "With a learned torque nothing is sampled: intervals are of the normal approximation to the "
    "posterior of all its coefficients with everything else."
)


def comparison(task: Task) -> Comparison:
    """Comparison of a task; raises ``UserError`` as :func:`forward_problem` does."""
    used, held_out, unknowns, notes = forward_problem(task)
    config = task.config

    def diagnose(progress: StageProgress | None) -> Diagnosis:
        findings = search(
            task.bench,
            used,
            held_out,
            unknowns,
            effects=config.candidates.effects,
            max_effects=config.candidates.max_effects or MOST_EFFECTS,
            load_angle_known=config.comparison.load_angle_known,
            motor_angle_known=config.comparison.motor_angle_known,
            workers=config.run.workers,
            progress=of_stage(progress, "Fitting candidates"),
        )
        if findings.learned is not None:
            return diagnosis_of(findings, None, (*notes, NOT_SAMPLED))
        seed = np.random.SeedSequence(config.run.seed)
        level = config.interval.level
        posterior = sample_direct(findings.final.fit, SamplerSettings(level=level), seed)
        return diagnosis_of(findings, posterior, (*notes, *_notes_on(posterior)), level)

    free = ", ".join(dict.fromkeys(unknown.name for unknown in unknowns))
    return Comparison(
        f"forward, {len(used)} to fit on, {len(held_out)} held out; unknown {free}", diagnose
    )


def forward_problem(task: Task) -> tuple[list[Observed], list[Observed], list[Unknown], list[str]]:
    """Recordings to fit, recordings to predict, unknowns, and notes.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_no_known_torque(task, "The forward comparison knows no torque from outside.")
    config, bench = task.config, task.bench
    channels = _channels(task)
    recordings = [unclipped(r, _unclipped(bench, r, channels)) for r in task.recordings]
    used: list[Observed] = []
    held_out: list[Observed] = []
    notes = notes_of(recordings)
    for entry, recording in zip(config.recordings, recordings, strict=True):
        if moves(recording):
            raise RecordingError(
                "A diagnosis compares recordings of one speed each, and this is of a motion.",
                file=str(entry.file),
                found="a reference that varies over time",
                expected="bayesbl identify RECORDINGS --bench FILE --effects catalogue, which "
                "finds wrong values and what is missing from motions",
            )
        observation = observed(recording, bench, entry.reference_speed_rpm)
        observation = replace(
            observation,
            name=entry.name,
            signals=observation.signals[: len(channels)],
            motor_angle_rad=_motor_angle(config, recording),
        )
        notes += [f"{entry.name}: {note}" for note in observation.notes]
        if entry.use in ("fit", "split"):
            require_rotations(observation, str(entry.file), entry.use == "split")
        for use, rows in parts_of(USES_OF[entry.use], observation.samples // 2):
            (used if use == "used" else held_out).append(part_of(observation, rows))
    speeds = [observation.reference_speed_rpm for observation in used]
    require_flank_change(heaviest(bench), speeds, config.bench)
    unknowns = _unknowns(config, bench, used, recordings)
    notes += _counted_twice(bench, recordings)
    notes += [] if MOTOR_CURRENT in channels else [SPEED_ALONE]
    return used, held_out, unknowns, notes


def _counted_twice(bench: Bench, recordings: Sequence[Recording]) -> Iterator[str]:
    known = () if bench.identified is None else bench.identified.sources
    names = [r.name for r in recordings if r.source is not None and r.source.sha256 in known]
    if names:
        yield (
            f"The bench was identified from {', '.join(names)} too. It was fitted to them, so "
            "it may hide what is missing: use later recordings."
        )


def _notes_on(posterior: DirectPosterior) -> Iterator[str]:
    if posterior.diagnostics.outcome == "withheld":
        yield "The posterior could not be sampled; intervals are of its normal approximation."
    yield from flaws_in_words(posterior.diagnostics.reasons)


def _channels(task: Task) -> tuple[str, ...]:
    asked = task.config.comparison.channels or tuple(
        c for c in CHANNELS if all(c in recording.channels for recording in task.recordings)
    )
    if MOTOR_SPEED not in asked or not set(asked) <= set(CHANNELS):
        raise ConfigError(
            "The forward comparison needs the motor speed, with or without the current.",
            where="[comparison] channels",
            found=", ".join(asked) or "none in every recording",
            expected=", ".join(CHANNELS),
        )
    for recording in task.recordings:
        require_channels(recording, asked)
        require_alive(recording, asked)
    return tuple(c for c in CHANNELS if c in asked)


def _unclipped(bench: Bench, recording: Recording, channels: Sequence[str]) -> list[str]:
    """Channels that must not be clipped: all but a current at the limit, which the bench has."""
    reached = NEAR_LIMIT * bench.value("current_limit_a")
    return [
        name
        for name in channels
        if name != MOTOR_CURRENT or np.abs(recording.channels[name]).max() < reached
    ]


def require_rotations(observation: Observed, file: str, split: bool) -> None:
    """Refuse less than two load rotations, in each half if it is split: they separate noise."""
    fewest = (2.0 - ROUNDING) * observation.lag * (2 if split else 1)
    if observation.samples >= fewest:
        return
    problem = "split: each half needs" if split else "fitted: it needs"
    raise RecordingError(
        f"The recording is too short to be {problem} two load rotations.",
        file=file,
        found=f"{observation.samples / observation.lag:.3g} load rotations",
        expected=f"at least {fewest / observation.lag:.3g}, or another use",
    )


def part_of(observation: Observed, rows: slice) -> Observed:
    """Some samples of a recording, with its name."""
    excluded, angle = observation.excluded, observation.motor_angle_rad
    return replace(
        observation,
        signals=observation.signals[:, rows],
        excluded=None if excluded is None else excluded[rows],
        motor_angle_rad=None if angle is None else angle[rows],
        begin_s=observation.begin_s + (rows.start or 0) / observation.sampling_hz,
    )


def _motor_angle(config: DiagnoseConfig, recording: Recording) -> FloatArray | None:
    if not config.comparison.motor_angle_known:
        return None
    require_channels(recording, (MOTOR_POSITION,))
    return recording.channels[MOTOR_POSITION]


def _unknowns(
    config: DiagnoseConfig, bench: Bench, used: Sequence[Observed], recordings: Sequence[Recording]
) -> list[Unknown]:
    gap_rad = config.unknowns.gap_rad or DEFAULT_GAP_RAD
    unknowns = [gap_unknown(*gap_rad, observation.name) for observation in used]
    measured = {entry.name: r for entry, r in zip(config.recordings, recordings, strict=True)}
    for observation in used:
        if config.comparison.load_angle_known:
            require_channels(measured[observation.name], (LOAD_POSITION,))
            angle = float(measured[observation.name].channels[LOAD_POSITION][0]) % (2.0 * math.pi)
            known = Unknown(
                START_ANGLE, centre=angle, sd=KNOWN_ANGLE_SD_RAD, recording=observation.name
            )
            unknowns.append(known)
        else:
            unknowns.append(start_angle_unknown(observation.name))
    for learned in bench.learned_terms:
        if not (config.comparison.motor_angle_known and learned.variable == "motor_angle"):
            unknowns += shift_unknowns(learned, [observation.name for observation in used])
    toleranced = {unknown.name: unknown for unknown in tolerance_unknowns(bench)}
    for name in config.unknowns.bench_parameters:
        if name not in toleranced:
            raise ConfigError(
                "A parameter is fitted within its tolerance, and this one has none.",
                where="[unknowns] bench_parameters",
                found=name,
                expected=f"a tolerance for {name} in {config.bench.name}",
            )
        unknowns.append(toleranced[name])
    return unknowns
