"""Comparisons of a rigid bench: inverse, and free motion; what they cannot tell is said."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.problem import (
    Problem,
    cuts,
    notes_of,
    piece_of,
    refused,
    rows_of,
    sound,
    wanted,
)
from bayesbl.diagnosis.rigid.free_motion import FreeMotionComparison, free_motion_candidates
from bayesbl.diagnosis.rigid.inverse import InverseComparison
from bayesbl.diagnosis.rigid.motion import Motion, even, motion_of, reach, settled, widened
from bayesbl.diagnosis.rigid.terms import (
    POSITION_TERMS,
    TORQUE_TERMS,
    uncomputable,
    without_load_angle,
)
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.recording.checks import require_channels
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_SPEED,
    MOTOR_TORQUE,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

INVERSE_CHANNELS = (MOTOR_TORQUE, MOTOR_CURRENT, LOAD_POSITION)
FREE_CHANNELS = (MOTOR_POSITION, MOTOR_SPEED)
INERTIAS = ("motor_inertia_kg_m2", "load_inertia_kg_m2")
GRAVITY = "gravity_torque_nm"

ONE_WAY = 0.9
"""Net over total travel from which on a set of recordings turns one way."""


def rigid_problem(config: DiagnoseConfig, bench: Bench, recordings: list[Recording]) -> Problem:
    """The comparison that a configuration asks for, on recordings brought to an even grid.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not fit the method.
    """
    if bench.drive != "rigid":
        raise ConfigError(
            "This method compares a rigid bench: one inertia, no gap.",
            file=config.bench,
            where="drive",
            found=f'"{bench.drive}"',
            expected='"rigid"',
        )
    if config.unknowns.gap_rad is not None:
        raise refused("A rigid bench has no gap.", "[unknowns] gap_rad", None, "no gap_rad")
    channel = _channel(config, recordings)
    # A joint may rest at the end of its way: only what drives it is asked not to stand still.
    driving = [channel] if channel in (MOTOR_TORQUE, MOTOR_CURRENT) else []
    recordings = [even(sound(r, _read(config, r, channel), driving)) for r in recordings]
    method = _inverse if config.comparison.method == "inverse" else _free_motion
    problem = method(config, bench, recordings, channel)
    return replace(problem, notes=(*notes_of(recordings), *problem.notes))


def _read(config: DiagnoseConfig, recording: Recording, channel: str) -> tuple[str, ...]:
    """What is compared, and what the motion of an inverse comparison is taken from."""
    if config.comparison.method == "free_motion":
        return (channel,)
    moved = [c for c in (MOTOR_POSITION, MOTOR_SPEED) if c in recording.channels]
    return (channel, *moved[:1])


def _inverse(
    config: DiagnoseConfig, bench: Bench, recordings: list[Recording], channel: str
) -> Problem:
    compared, load = config.comparison, channel == LOAD_POSITION
    pieces, parts, motions = _moved(config, recordings, channel)
    _require_position(config, motions, load)
    unknown = _unknown(config, bench, load)
    if channel == MOTOR_CURRENT and "torque_constant_nm_per_a" in bench.assumed:
        raise ConfigError(
            "Current can be compared only through the torque constant.",
            file=config.bench,
            where="[parameters]",
            found="no torque_constant_nm_per_a",
            expected="torque_constant_nm_per_a = {value = …}",
        )
    unit = bench.value("torque_constant_nm_per_a") if channel == MOTOR_CURRENT else 1.0
    known = tuple(
        sum((part.channels[n] for n in compared.known_torque), np.zeros(part.samples))
        for part in parts
    )
    every = POSITION_TERMS if load else TORQUE_TERMS
    if not (compared.load_angle_known and bench.value(GRAVITY) > 0.0):
        every = without_load_angle(every)
    left_out = uncomputable(every, bench, compared.load_angle_known)
    terms = {name: term for name, term in every.items() if name not in left_out}
    chosen = wanted(config, bench, [term.candidate for term in terms.values()])
    comparison = InverseComparison(
        pieces,
        motions,
        known,
        bench,
        {candidate.name: terms[candidate.name] for candidate in chosen},
        unknown,
        unit,
        load,
        compared.load_angle_known,
        compared.motor_angle_known,
    )
    notes = [*_one_way(pieces, motions)]
    notes += [
        f"Speed and acceleration come from the {source} behind a zero-phase Butterworth low pass "
        f"of order 4 at {compared.cutoff_hz:g} Hz."
        for source in sorted({motion.source for motion in motions})
    ]
    if any(motion.source == "speed" for motion in motions):
        notes.append(
            "Without position the motor angle is the integral of the speed: where it starts is "
            "unknown, so a ripple has its own phase in every recording, and gravity's direction "
            "is fitted."
        )
    if left_out:
        why = "the load's angle is unknown" if not load else "the bench names no shaft stiffness"
        notes.append(f"Not tried, as {why}: {', '.join(left_out)}.")
    alarm = config.candidates.false_alarm
    return Problem(
        comparison,
        bench,
        lambda fit: comparison.scan_orders(fit).remaining(channel, alarm),
        tuple(notes),
    )


def _moved(
    config: DiagnoseConfig, recordings: list[Recording], channel: str
) -> tuple[tuple[Piece, ...], list[Recording], tuple[Motion, ...]]:
    """Pieces with their motion, without the ends that the filter disturbs.

    The motion is that of the whole recording: both halves of a split one have one angle.
    """
    cutoff = config.comparison.cutoff_hz
    inside = [settled(recording, cutoff) for recording in recordings]
    whole = [motion_of(r, cutoff).part(rows) for r, rows in zip(recordings, inside, strict=True)]
    # A bridge is no motion, and the filter spreads it.
    wary = [replace(r, excluded=widened(r.excluded, reach(r, cutoff))) for r in recordings]
    kept = [rows_of(r, rows) for r, rows in zip(wary, inside, strict=True)]
    found = cuts(config, kept)
    parts = [rows_of(kept[i], rows) for i, _, rows in found]
    pieces = tuple(
        piece_of(part, channel, use) for part, (_, use, _) in zip(parts, found, strict=True)
    )
    return pieces, parts, tuple(whole[i].part(rows) for i, _, rows in found)


def _free_motion(
    config: DiagnoseConfig, bench: Bench, recordings: list[Recording], channel: str
) -> Problem:
    compared = config.comparison
    if compared.known_torque:
        raise refused(
            "Free motion has no torque but the bench's own.",
            "[comparison] known_torque",
            ", ".join(compared.known_torque),
            "none",
        )
    unknown = config.unknowns.bench_parameters
    gravity = bench.value(GRAVITY) > 0.0
    if GRAVITY in unknown and set(INERTIAS) & set(unknown):
        raise refused(
            "Without any measured torque all torques and inertias scaled together look the same.",
            "[unknowns] bench_parameters",
            ", ".join(unknown),
            "inertia or gravity, not both",
        )
    if GRAVITY not in unknown:
        _unknown(config, bench, load=False)
    found = cuts(config, recordings)
    parts = [rows_of(recordings[i], rows) for i, _, rows in found]
    pieces = tuple(
        piece_of(part, channel, use) for part, (_, use, _) in zip(parts, found, strict=True)
    )
    comparison = FreeMotionComparison(
        pieces,
        tuple(_start(part, channel) for part in parts),
        bench,
        tuple(wanted(config, bench, free_motion_candidates(compared.load_angle_known and gravity))),
        unknown,
        compared.load_angle_known or not gravity,
    )
    scale = "gravity" if gravity else "the inertia"
    notes = [
        f"No torque is measured: friction is known as well as {scale} of the bench is.",
        "Torque ripple, encoder and shaft effects are not tried in free motion.",
    ]
    if channel == MOTOR_SPEED:
        notes.append("Speed alone: the start angle is known only through what gravity does.")
    return Problem(comparison, bench, lambda fit: (), tuple(notes))


def _channel(config: DiagnoseConfig, recordings: list[Recording]) -> str:
    """The one channel that is compared."""
    inverse = config.comparison.method == "inverse"
    possible = INVERSE_CHANNELS if inverse else FREE_CHANNELS
    asked = config.comparison.channels
    if not asked:
        everywhere = [c for c in possible if all(c in r.channels for r in recordings)]
        if everywhere:
            return everywhere[0]
        raise _nothing_to_compare(inverse, recordings[0])
    if len(asked) != 1 or asked[0] not in possible:
        raise refused(
            "This method compares one channel.",
            "[comparison] channels",
            ", ".join(asked),
            "one of " + ", ".join(possible),
        )
    for recording in recordings:
        require_channels(recording, asked)
    return asked[0]


def _nothing_to_compare(inverse: bool, recording: Recording) -> RecordingError:
    file = recording.source.file if recording.source else recording.name
    if inverse:
        return RecordingError(
            "There is neither torque nor current of the motor, nor a second encoder at the load. "
            "From motion alone it cannot be told what the motor had to give: friction, offsets, "
            "ripple and inertia all stay unknown. What motion alone can tell, it tells when the "
            "motor is switched off (free_motion).",
            file=file,
            found=", ".join(recording.channels),
            expected="one of " + ", ".join(INVERSE_CHANNELS),
        )
    return RecordingError(
        "There is no motion to compare.",
        file=file,
        found=", ".join(recording.channels),
        expected="one of " + ", ".join(FREE_CHANNELS),
    )


def _require_position(config: DiagnoseConfig, motions: tuple[Motion, ...], load: bool) -> None:
    if all(motion.source == "position" for motion in motions):
        return
    compared = config.comparison
    for name, claimed in (
        ("load_angle_known", compared.load_angle_known),
        ("motor_angle_known", compared.motor_angle_known),
        ("channels", load),
    ):
        if claimed:
            raise refused(
                "Without the motor's position no angle is known.",
                f"[comparison] {name}",
                f"a recording without {MOTOR_POSITION}",
                f"{MOTOR_POSITION} in every recording, or {name} left out",
            )


def _one_way(pieces: tuple[Piece, ...], motions: tuple[Motion, ...]) -> Iterator[str]:
    speeds: list[FloatArray] = [
        motion.speed for piece, motion in zip(pieces, motions, strict=True) if piece.use == "used"
    ]
    speed = np.concatenate(speeds)
    if abs(speed.sum()) >= ONE_WAY * np.abs(speed).sum():
        yield (
            "The recordings turn one way only: Coulomb friction, an offset and, at one speed, "
            "viscous friction can hardly be told apart; a recording in the other direction would "
            "separate them."
        )


def _unknown(config: DiagnoseConfig, bench: Bench, load: bool) -> tuple[str, ...]:
    """Declared unknown bench parameters, refused where they cannot be fitted."""
    names = config.unknowns.bench_parameters
    possible = () if load else (*INERTIAS, GRAVITY)
    for name in names:
        if name not in possible:
            raise refused(
                "This parameter has no part in this comparison.",
                "[unknowns] bench_parameters",
                name,
                ("one of " + ", ".join(possible)) if possible else "none",
            )
    if set(INERTIAS) <= set(names):
        raise refused(
            "A rigid bench shows only the sum of its inertias.",
            "[unknowns] bench_parameters",
            ", ".join(INERTIAS),
            "one of the two",
        )
    if GRAVITY in names and not config.comparison.load_angle_known:
        raise refused(
            "Without the load's angle gravity is fitted anyway, size and direction.",
            "[unknowns] bench_parameters",
            GRAVITY,
            "load_angle_known = true, or no gravity_torque_nm here",
        )
    return names


def _start(part: Recording, channel: str) -> FloatArray:
    """Angle and speed near the first sample, where the fit of the start begins; rad, rad/s."""
    few = max(4, math.ceil(0.02 / part.sampling_period_s))
    time = part.time_s[:few] - part.time_s[0]
    if channel == MOTOR_SPEED:
        return np.array([0.1, part.motor_speed_rpm[0] / RPM_PER_RAD_PER_S])
    slope, angle = np.polyfit(time, part.channels[MOTOR_POSITION][:few], 1)
    return np.array([angle, slope])
