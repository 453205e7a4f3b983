"""Forward diagnosis of a two-mass bench in its closed loop."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench, heaviest, require_flank_change
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.closed_loop.diagnosis import MOST_EFFECTS, diagnosis_of, search
from bayesbl.diagnosis.diagnosis import Diagnosis
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
from bayesbl.matching.observed import ROUNDING, Observed, observed
from bayesbl.matching.posterior import DirectPosterior, sample_direct, widened
from bayesbl.matching.signals import (
    START_ANGLE,
    Unknown,
    gap_unknown,
    shift_unknowns,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.progress import StageProgress, of_stage
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

CHANNELS = (MOTOR_SPEED, MOTOR_CURRENT)
DEFAULT_GAP_RAD = (1e-4, 4e-3)
KNOWN_ANGLE_SD_RAD = 1e-3
"""Standard deviation of a start angle that a load encoder gives."""

NEAR_LIMIT = 0.95
"""Share of the drive's current limit from which on a current is held by it, offsets allowed for."""

SPEED_ALONE = (
    "There is no motor current: friction, offsets and the torque constant cannot be told apart "
    "by the speed alone, as the controller's integral hides them."
)

NOT_SAMPLED = (
    "With a learned torque nothing is sampled: intervals are of the normal approximation to the "
    "posterior of all its coefficients with everything else."
)


def comparison(task: Task) -> Comparison:
    """Speed and current beside their simulation, with draws of everything unknown.

    Raises
    ------
    UserError
        As :func:`forward_problem`.
    """
    used, held_out, unknowns, notes = forward_problem(task)
    config = task.config

    def diagnose(progress: StageProgress | None) -> Diagnosis:
        found = search(
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
        if found.learned is not None:
            return diagnosis_of(found, None, (*notes, NOT_SAMPLED))
        seed = np.random.SeedSequence(config.run.seed)
        level = config.interval.level
        posterior = sample_direct(found.final.fit, SamplerSettings(level=level), seed)
        posterior = widened(posterior, *seed.spawn(1))
        return diagnosis_of(found, posterior, (*notes, *_notes_on(posterior)), level)

    free = ", ".join(dict.fromkeys(unknown.name for unknown in unknowns))
    return Comparison(
        f"forward, {len(used)} to fit on, {len(held_out)} held out; unknown {free}", diagnose
    )


def forward_problem(
    task: Task,
) -> tuple[list[Observed], list[Observed], list[Unknown], list[str]]:
    """Recordings to fit on and to predict, the unknowns, and what these recordings cannot show.

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
        seen = observed(recording, bench, entry.reference_speed_rpm)
        seen = replace(
            seen,
            name=entry.name,
            signals=seen.signals[: len(channels)],
            motor_angle_rad=_motor_angle(config, recording),
        )
        notes += [f"{entry.name}: {note}" for note in seen.notes]
        if entry.use in ("fit", "split"):
            require_rotations(seen, str(entry.file), entry.use == "split")
        for use, rows in parts_of(USES_OF[entry.use], seen.samples // 2):
            (used if use == "used" else held_out).append(part_of(seen, rows))
    speeds = [seen.reference_speed_rpm for seen in used]
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
    yield from posterior.diagnostics.reasons


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
    """Channels whose peaks must be whole: all but a current at the limit that the bench has too."""
    reached = NEAR_LIMIT * bench.value("current_limit_a")
    return [
        name
        for name in channels
        if name != MOTOR_CURRENT or np.abs(recording.channels[name]).max() < reached
    ]


def require_rotations(seen: Observed, file: str, split: bool) -> None:
    """Whole rotations separate what repeats from noise, in each half if it is split."""
    fewest = (2.0 - ROUNDING) * seen.lag * (2 if split else 1)
    if seen.samples >= fewest:
        return
    problem = "split: each half needs" if split else "fitted: it needs"
    raise RecordingError(
        f"The recording is too short to be {problem} two load rotations.",
        file=file,
        found=f"{seen.samples / seen.lag:.3g} load rotations",
        expected=f"at least {fewest / seen.lag:.3g}, or another use",
    )


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


def _motor_angle(config: DiagnoseConfig, recording: Recording) -> FloatArray | None:
    if not config.comparison.motor_angle_known:
        return None
    require_channels(recording, (MOTOR_POSITION,))
    return recording.channels[MOTOR_POSITION]


def _unknowns(
    config: DiagnoseConfig, bench: Bench, used: Sequence[Observed], recordings: Sequence[Recording]
) -> list[Unknown]:
    unknowns = [gap_unknown(*(config.unknowns.gap_rad or DEFAULT_GAP_RAD))]
    measured = {entry.name: r for entry, r in zip(config.recordings, recordings, strict=True)}
    for seen in used:
        if config.comparison.load_angle_known:
            require_channels(measured[seen.name], (LOAD_POSITION,))
            angle = float(measured[seen.name].channels[LOAD_POSITION][0]) % (2.0 * math.pi)
            known = Unknown(START_ANGLE, centre=angle, sd=KNOWN_ANGLE_SD_RAD, recording=seen.name)
            unknowns.append(known)
        else:
            unknowns.append(start_angle_unknown(seen.name))
    told = config.comparison.motor_angle_known
    for learned in bench.learned_terms:
        if not (told and learned.variable == "motor_angle"):
            unknowns += shift_unknowns(learned, [seen.name for seen in used])
    toleranced = {unknown.name: unknown for unknown in tolerance_unknowns(bench)}
    for name in config.unknowns.bench_parameters:
        if name not in toleranced:
            raise ConfigError(
                "A parameter is free within its tolerance, and this one has none.",
                where="[unknowns] bench_parameters",
                found=name,
                expected=f"a tolerance for {name} in {config.bench.name}",
            )
        unknowns.append(toleranced[name])
    return unknowns
