"""``kind = "diagnose"``: find what a bench lacks, from recordings.

Without a configuration, the way to compare them is guessed, each choice with its reason.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.config.kinds import Compared, DiagnoseConfig, Method
from bayesbl.config.loading import config_from_options
from bayesbl.diagnosis.closed_loop import diagnosis as closed_loop
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.groups import diagnosis_tree
from bayesbl.diagnosis.rigid import free_motion, inverse, speed_loop
from bayesbl.diagnosis.task import INERTIAS, Comparison, Task
from bayesbl.errors import RecordingError
from bayesbl.matching.observed import ROUNDING, asked_speed
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.checks import is_constant, is_one_speed, moves, with_speed
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    MOTOR_TORQUE,
    Recording,
)
from bayesbl.results.identified import bench_from
from bayesbl.results.provenance import provenance_of
from bayesbl.results.work import WorkStore
from bayesbl.runs.workflow import Options, Plan, settings_of

FEWEST_SAMPLES = 200


METHODS: Mapping[Method, Callable[[Task], Comparison]] = {
    "forward": lambda task: (
        speed_loop.comparison(task) if task.bench.drive == "rigid" else closed_loop.comparison(task)
    ),
    "inverse": inverse.comparison,
    "free_motion": free_motion.comparison,
}
"""Comparisons by ``[comparison] method``. Each refuses an unsuitable bench, recording or unknown
(``UserError``)."""


def make(config: DiagnoseConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Diagnose as configured. UserError if bench or recordings cannot be compared so."""
    method = METHODS[config.comparison.method]
    bench, recordings = _inputs(config)
    diagnosis = work.get(
        "diagnosis",
        (settings_of(config), bench, recordings),
        lambda: method(Task(config, bench, recordings)).diagnose(options.progress),
        Diagnosis,
    )
    tree = diagnosis_tree(diagnosis, config.interval.level, config.interval.kind)
    tree.attrs |= provenance_of(config)
    return tree


def describe(config: DiagnoseConfig, plan: Plan) -> None:
    """What would be compared."""
    method = METHODS[config.comparison.method]
    plan.add("comparison", lambda: method(Task(config, *_inputs(config))).in_words)


def _inputs(config: DiagnoseConfig) -> tuple[Bench, tuple[Recording, ...]]:
    """Bench and recordings, read, and long enough to be compared."""
    bench, specs = bench_from(config.bench), dict(config.column_specs)
    for name in config.comparison.known_torque:
        specs.setdefault(name, ColumnSpec(name))
    recordings = []
    for entry in config.recordings:
        recording = read_recording(entry.file, name=entry.name, columns=specs)
        if recording.samples < FEWEST_SAMPLES * (2 if entry.use == "split" else 1):
            raise RecordingError(
                "The recording is too short to separate an effect from noise.",
                file=entry.file,
                found=f"{recording.samples} samples",
                expected=f"at least {FEWEST_SAMPLES} to fit on, and as many to predict",
            )
        recordings.append(recording)
    return bench, tuple(recordings)


FEWEST_SETTINGS = 3  # directions and speeds: Coulomb and viscous friction and an offset take 3
SAME_SPEED = 0.01  # relative difference within which recordings have the same speed
FITTED = "effects are fitted on it"
SPLIT_ROTATIONS = 4.0  # rotations of the load in a recording that is split: two in each half


@dataclass(frozen=True, slots=True)
class Choice:
    """A guessed value and its reason.

    ``place``: section and key; for an entry of ``[[recordings]]``, the recording's name and the
    key.
    """

    place: tuple[str, str]
    value: object
    reason: str

    @property
    def told(self) -> str:
        """``[comparison] method = "forward": …``."""
        section, key = self.place
        where = f"[{section}] " if section in ("comparison", "unknowns") else f"{section}: "
        return f"{where}{key} = {toml(self.value)}: {self.reason}"


def guess_diagnosis(
    bench: Bench, recordings: Sequence[Recording], given: DiagnoseConfig | None = None
) -> list[Choice]:
    """Choose method, channels, unknowns, and the use of each recording.

    ``given`` is a configuration that states some of them; the rest follows from it. Raises
    RecordingError if no method suits the recordings and the bench.
    """
    compared = Compared() if given is None else given.comparison
    said = compared.model_fields_set | (given.unknowns.model_fields_set if given else set())
    motor_rpm = [_with_speed(recording).motor_speed_rpm for recording in recordings]
    # The reference does not vary, nor do parts of the recording differ.
    steady = [
        not moves(recording) and is_one_speed(rpm, recording.sampling_period_s)
        for recording, rpm in zip(recordings, motor_rpm, strict=True)
    ]
    choices = []
    method, channels = compared.method, compared.channels
    if "method" not in said:
        method, why = _method(bench, recordings, steady)
        choices.append(Choice(("comparison", "method"), method, why))
    if not channels:
        channels, why = _channels(bench, method, recordings)
        choices.append(Choice(("comparison", "channels"), channels, why))
    choices += [c for c in _unknowns(bench, method, channels) if c.place[1] not in said]
    speeds = [float(rpm.mean()) for rpm in motor_rpm]
    for i, (use, why) in enumerate(_uses(bench, method, recordings, all(steady), speeds)):
        name = recordings[i].name
        choices.append(Choice((name, "use"), use, why))
        if method == "forward" and bench.drive == "two_mass":
            asked, reason = asked_speed(recordings[i], bench)
            if asked is not None:
                choices.append(Choice((name, "reference_speed_rpm"), asked, reason))
    return choices


def completed(config: DiagnoseConfig, guess: Sequence[Choice]) -> DiagnoseConfig:
    """The configuration with these choices."""
    sections = {name: getattr(config, name) for name in ("comparison", "unknowns")}
    entries = {entry.name: entry for entry in config.recordings}
    for choice in guess:
        owner, key = choice.place
        group = sections if owner in sections else entries
        group[owner] = group[owner].model_copy(update={key: choice.value})
    return config.model_copy(update={**sections, "recordings": tuple(entries.values())})


def toml(value: object) -> str:
    """A value in TOML."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


def _with_speed(recording: Recording) -> Recording:
    """The recording with the motor's speed. Raises RecordingError without speed and position."""
    completed = with_speed(recording)
    if MOTOR_SPEED not in completed.channels:
        raise RecordingError(
            "There is neither position nor speed of the motor, so nothing to compare a bench with.",
            file=recording.place,
            found=", ".join(recording.channels),
            expected=f"{MOTOR_SPEED} or {MOTOR_POSITION}; `bayesbl init RECORDING` looks for them "
            "under other names",
        )
    return completed


def _everywhere(recordings: Sequence[Recording], channels: Sequence[str]) -> list[str]:
    """Channels that every recording holds and that vary."""
    return [
        channel
        for channel in channels
        if all(
            channel in recording.channels and not is_constant(recording.channels[channel])
            for recording in recordings
        )
    ]


def _method(
    bench: Bench, recordings: Sequence[Recording], steady: Sequence[bool]
) -> tuple[Method, str]:
    if bench.drive == "two_mass":
        moving = [r for r, even in zip(recordings, steady, strict=True) if not even]
        if moving:
            raise RecordingError(
                "This bench has a shaft with a gap, and is compared with recordings of one speed "
                "each.",
                file=moving[0].place,
                found="a speed that varies",
                expected="recordings of one speed each; or `bayesbl identify RECORDINGS --bench "
                "FILE --effects catalogue`, which finds wrong values and what is missing from "
                'motions; or drive = "rigid" in a copy of the bench, for motions slower than the '
                "shaft",
            )
        return "forward", "the bench has a shaft with a gap, and each recording is of one speed"
    if _everywhere(recordings, (MOTOR_TORQUE, MOTOR_CURRENT)):
        return "inverse", "the bench is rigid, and torque or current is recorded with the motion"
    if all(steady):
        return "forward", (
            "the bench is rigid, neither torque nor current is recorded, and each speed is "
            "constant: the controller's gains say what torque the speed's ripple takes"
        )
    driven = [recording for recording in recordings if moves(recording)]
    if driven:
        raise RecordingError(
            inverse.MOTION_ALONE,
            file=driven[0].place,
            found=", ".join(driven[0].channels),
            expected="one of " + ", ".join(inverse.CHANNELS),
        )
    if _everywhere(recordings, (LOAD_POSITION,)):
        raise RecordingError(
            "Two encoders show what lies between motor and load, not what a rigid bench lacks.",
            file=recordings[0].place,
            found=", ".join(recordings[0].channels),
            expected="one of "
            + ", ".join(inverse.CHANNELS)
            + " beside the motion; or `bayesbl fit "
            "RECORDING --route two_encoders`, which measures play, skew and transmission error",
        )
    return "free_motion", (
        "the bench is rigid, and nothing drives the motor that is recorded: taken for let go with "
        "the motor off"
    )


def _channels(
    bench: Bench, method: Method, recordings: Sequence[Recording]
) -> tuple[tuple[str, ...], str]:
    if method == "forward" and bench.drive == "two_mass":
        names = _everywhere(recordings, closed_loop.CHANNELS)
        why = "all that the simulation gives and every recording holds"
        return tuple(names or closed_loop.CHANNELS[:1]), why
    if method == "forward":
        return (MOTOR_SPEED,), "there is neither torque nor current"
    possible = inverse.CHANNELS if method == "inverse" else free_motion.CHANNELS
    names = _everywhere(recordings, possible)[:1]
    why = "the first of " + ", ".join(possible) + " that every recording holds"
    return tuple(names or possible[:1]), why


def _unknowns(bench: Bench, method: Method, channels: Sequence[str]) -> Iterator[Choice]:
    toleranced = tuple(bench.tolerances)
    if bench.drive == "two_mass" and method == "forward":
        why = "half the play that joints have; wider for a worn one"
        yield Choice(("unknowns", "gap_rad"), closed_loop.DEFAULT_GAP_RAD, why)
    elif method == "forward":
        toleranced = tuple(name for name in toleranced if name in speed_loop.LOOP_PARAMETERS)
    else:
        # Only the sum of the inertias shows: the one that is known worse at the motor is free.
        ratio = bench.value("gear_ratio")
        at_motor = dict(zip(INERTIAS, (1.0, ratio**-2), strict=True))
        free = [name for name in INERTIAS if name in toleranced]
        free.sort(key=lambda name: -bench.tolerances[name] * at_motor[name])
        toleranced = tuple(free[:1])
    if toleranced:
        why = "known within a tolerance only"
        yield Choice(("unknowns", "bench_parameters"), toleranced, why)


def _uses(
    bench: Bench,
    method: Method,
    recordings: Sequence[Recording],
    steady: bool,
    speeds: Sequence[float],
) -> list[tuple[str, str]]:
    """The use of each recording, with the reason."""
    count = len(recordings)
    halves = ("split", "its first half is fitted on, and its second predicted")
    if not steady:
        if count == 1:
            return [halves]
        last = ("hold_out", "predicted, by what the other motions show")
        return [("fit", FITTED)] * (count - 1) + [last]
    held = _spare(speeds)
    why = "predicted, by what the others show of both directions and other speeds"
    if held is None and method == "forward" and bench.drive == "two_mass":
        short = [
            abs(speed) / 60.0 / bench.value("gear_ratio") * r.samples * r.sampling_period_s
            < SPLIT_ROTATIONS - 2.0 * ROUNDING
            for r, speed in zip(recordings, speeds, strict=True)
        ]
        if all(short) and count > 1:
            held, why = count - 1, "predicted: all are too short to be split"
        elif count > 1:
            whole = ("fit", f"{FITTED}: too short to be split")
            return [whole if less else halves for less in short]
    if held is None:
        return [halves] * count
    return [("hold_out", why) if i == held else ("fit", FITTED) for i in range(count)]


def _spare(speeds: Sequence[float]) -> int | None:
    """The recording that can be held out, best one of medium speed; ``None`` if all are needed.

    The others must cover the directions, and enough speeds to separate the laws of friction.
    """
    # A number for each recording, the same for those of one speed and direction.
    settings = [
        next(i for i, other in enumerate(speeds) if abs(speed - other) <= SAME_SPEED * abs(other))
        for speed in speeds
    ]
    possible = []
    for i, speed in enumerate(speeds):
        others = [other for k, other in enumerate(speeds) if k != i]
        settings_left = {setting for k, setting in enumerate(settings) if k != i}
        same = any(math.copysign(1.0, other) == math.copysign(1.0, speed) for other in others)
        if same and len(settings_left) >= FEWEST_SETTINGS:
            possible.append(i)
    sizes = np.abs(speeds)
    middle = float(np.median(sizes))

    def preference(i: int) -> tuple[bool, float, int]:
        ends = np.array([sizes.min(), sizes.max()])
        at_end = bool(np.any(np.abs(sizes[i] / ends - 1.0) <= SAME_SPEED))
        return at_end, abs(float(sizes[i]) - middle), -i

    return min(possible, key=preference, default=None)


def diagnosis_of(
    recordings: Sequence[str | Path], config: str | Path | None = None, **options: object
) -> tuple[DiagnoseConfig, list[Choice]]:
    """The configuration from recordings and options, and the choices that were guessed.

    ``config`` is a configuration to start from, of a diagnosis or of a measurement with its
    columns; ``options`` are those of :func:`bayesbl.config.loading.config_from_options`, with
    ``bench``. Raises UserError if anything cannot be used, or no method suits.
    """
    made = cast(DiagnoseConfig, config_from_options("diagnose", recordings, config, (), **options))
    read = [
        read_recording(entry.file, name=entry.name, columns=made.column_specs)
        for entry in made.recordings
    ]
    guess = guess_diagnosis(bench_from(made.bench), read, made)
    return completed(made, guess), guess
