"""Inverse diagnosis of a rigid bench: measured motion in, the torque it should have needed out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.disagreement import Use
from bayesbl.diagnosis.rigid.inverse import (
    POSITION_LAWS,
    TORQUE_CONSTANT,
    TORQUE_LAWS,
    Compared,
    InverseView,
    coherent_hz,
    resolved_hz,
    uncomputable,
    within_turns,
    without_load_angle,
)
from bayesbl.diagnosis.rigid.motion import (
    WIDEST,
    LowPass,
    Window,
    inside,
    motion_of,
    noise_of,
    reach,
    sharper,
    standstill,
    step_of,
    thinned,
    turns_of,
)
from bayesbl.diagnosis.rigid.orders import FEWEST_SAMPLES
from bayesbl.diagnosis.task import (
    GRAVITY,
    INERTIAS,
    USES_OF,
    Comparison,
    Task,
    by_search,
    compared_channel,
    even_recordings,
    notes_of,
    parts_of,
    refused,
    require_enough,
    require_rigid,
    unknown_parameters,
    wanted,
)
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.noise.rotation_noise import HIGHEST_ORDER
from bayesbl.recording.lost_samples import widened
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    Recording,
)

CHANNELS = (MOTOR_TORQUE, MOTOR_CURRENT, LOAD_POSITION)
MOTION_ALONE = (
    "There is neither torque nor current of the motor, nor a second encoder at the load. "
    "From motion alone the torque of the motor is unknown, and with it friction, offsets, "
    "ripple and inertia. Motion alone is enough when the motor is switched off "
    "(free_motion)."
)

ONE_WAY = 0.9
"""Net over total travel from which on a set of recordings turns one way."""


def comparison(task: Task) -> Comparison:
    """What a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    config, bench, asked = task.config, task.bench, task.config.comparison
    channel = compared_channel(task, CHANNELS, MOTION_ALONE)
    load = channel == LOAD_POSITION
    # A joint may rest at the end of its way: only what drives it is asked not to stand still.
    driving = [channel] if channel in (MOTOR_TORQUE, MOTOR_CURRENT) else []
    recordings = even_recordings(task, driving)
    _require_position(config, recordings, load)
    unknown = unknown_parameters(task, () if load else (*INERTIAS, GRAVITY))
    unit_tolerance = _tolerance_of_unit(task, channel)
    every = POSITION_LAWS if load else TORQUE_LAWS
    if not (asked.load_angle_known and bench.value(GRAVITY) > 0.0):
        every = without_load_angle(every)
    every = within_turns(every, turns_of(recordings))
    left_out = uncomputable(every, bench, asked.load_angle_known)
    laws = {name: law for name, law in every.items() if name not in left_out}
    chosen = wanted(config, bench, laws)

    def view_below(cutoff_hz: float) -> InverseView:
        found = [
            part
            for entry, recording in zip(config.recordings, recordings, strict=True)
            for part in compared(
                recording, channel, USES_OF[entry.use], cutoff_hz, config.comparison.known_torque
            )
        ]
        made = InverseView(
            tuple(found),
            bench,
            {name: laws[name] for name in chosen},
            unknown,
            asked.load_angle_known,
            asked.motor_angle_known,
        )
        _require_motion(made, recordings)
        return made

    cutoff = asked.cutoff_hz or _cutoff_hz(recordings, view_below)
    view = view_below(cutoff)
    notes = [*notes_of(recordings), *_one_way(view.parts)]
    notes += _notes_on_sources(view.parts, cutoff, given=asked.cutoff_hz is not None)
    if left_out:
        why = "the load's angle is unknown" if not load else "the bench names no shaft stiffness"
        notes.append(f"Not tried, as {why}: {', '.join(left_out)}.")
    if unit_tolerance:
        notes.append(
            f"The current is compared by the torque constant, which the bench knows to ± "
            f"{100.0 * unit_tolerance:.2g} %: all torques and inertias found are as uncertain, "
            "together."
        )
    return by_search(task, view, chosen, notes, unit_tolerance / math.sqrt(3.0))


def _tolerance_of_unit(task: Task, channel: str) -> float:
    """Relative tolerance of the torque of one unit of the channel."""
    bench = task.bench
    if channel != MOTOR_CURRENT:
        return 0.0
    if TORQUE_CONSTANT in bench.assumed:
        raise ConfigError(
            "Current can be compared only through the torque constant.",
            file=task.config.bench,
            where="[parameters]",
            found="no torque_constant_nm_per_a",
            expected="torque_constant_nm_per_a = {value = …}",
        )
    return bench.tolerances.get(TORQUE_CONSTANT, 0.0) / bench.value(TORQUE_CONSTANT)


def _cutoff_hz(
    recordings: Sequence[Recording], view_below: Callable[[float], InverseView]
) -> float:
    """Up to where the bench explains half of what is measured, or the motion is resolved."""
    period = max(recording.sampling_period_s for recording in recordings)
    positions = [r.channels[MOTOR_POSITION] for r in recordings if MOTOR_POSITION in r.channels]
    resolved = WIDEST / period
    if positions:
        resolved = min(resolved_hz(positions, period), resolved)
    return coherent_hz(view_below(resolved)) or resolved


def _notes_on_sources(parts: Sequence[Compared], cutoff_hz: float, *, given: bool) -> Iterator[str]:
    """Where speed and acceleration are from, and behind which filter both sides are compared."""
    sources = sorted({part.motion.source for part in parts})
    beyond = "." if given else ", beyond which the bench explains less than half."
    for source in sources:
        yield (
            f"Speed and acceleration come from the {source}; both sides are compared behind a "
            f"zero-phase Butterworth low pass of order 4 at {cutoff_hz:.3g} Hz{beyond}"
        )
    if "speed" in sources:
        yield (
            "Without position the motor angle is the integral of the speed: where it starts is "
            "unknown, so a ripple has its own phase in every recording, and gravity's direction "
            "is fitted."
        )


def compared(
    recording: Recording,
    channel: str,
    uses: Sequence[Use],
    cutoff_hz: float,
    known_torque: Sequence[str] = (),
) -> list[Compared]:
    """What is compared of a recording: whole, or its halves, each with a use of its own.

    All of a recording has one motion, so that both halves of a split one have one angle and one
    time. Above the cut-off it is compared too, for what turns with the motor, but not shown.
    """
    period = recording.sampling_period_s
    sharp = sharper(cutoff_hz, period)
    motion = motion_of(recording, sharp)
    if not np.any(motion.speed):
        raise RecordingError(
            "The motor does not move, so there is nothing to compare.",
            file=recording.place,
            found=f"{motion.source} that never changes",
            expected="a recording of a motion",
        )
    # A bridge is no motion, and the filter spreads it.
    out = widened(recording.excluded, reach(recording, sharp))
    require_enough(recording, channel, out)
    position = recording.channels.get(MOTOR_POSITION)
    noise = 0.0 if position is None else noise_of(position)
    if channel != LOAD_POSITION:
        resting = standstill(motion, noise, cutoff_hz)
        out = resting if out is None else out if resting is None else out | resting
    window = None if out is None else np.where(out, 0.0, 1.0)
    low_pass = LowPass(cutoff_hz, period)
    step = 0.0 if position is None else step_of(position)
    windows = [Window(low_pass, window, thinned(recording, cutoff_hz), step_rad=step)]
    if channel != LOAD_POSITION:
        windows.append(Window(low_pass, window, inside(recording, cutoff_hz), True, step, noise))
    compared_samples = len(range(*windows[0].rows.indices(recording.samples)))
    if compared_samples < FEWEST_SAMPLES:
        raise RecordingError(
            "The cut-off of the filter is too low for so short a recording: its ends reach all of "
            "it.",
            file=recording.place,
            found=f"{cutoff_hz:.3g} Hz in {recording.samples * period:.3g} s",
            expected="a longer recording, or a higher [comparison] cutoff_hz",
        )
    torques = (recording.channels[name] for name in known_torque)
    known = LowPass(sharp, period)(sum(torques, np.zeros(recording.samples)))
    found = []
    for view in windows:
        signal = recording.channels[channel]
        # As sharp as the motion, and no sharper, where the motion has a part in it.
        seen = view(signal if view.above else LowPass(sharp, period)(signal))
        excluded = None if out is None or not out[view.rows].any() else out[view.rows]
        time = recording.time_s[view.rows]
        white = low_pass.of_white_noise(view.rows.step, HIGHEST_ORDER + 1)
        shown = not view.above
        whole = Piece(
            recording.name, channel, uses[0], time, seen, excluded, shown, white if shown else None
        )
        for use, rows in parts_of(uses, time.size // 2):
            found.append(Compared(whole.part(rows, use), motion, known, view.part(rows)))
    return found


def _require_motion(view: InverseView, recordings: Sequence[Recording]) -> None:
    """Refuse where nothing moves in a part that is fitted or predicted."""
    for piece in view.pieces:
        moving = piece.kept(piece.time_s).size
        if moving < FEWEST_SAMPLES:
            (place,) = {r.place for r in recordings if r.name == piece.name}
            raise RecordingError(
                "The axis rests or reverses nearly all of the time in a part that is to be fitted "
                "or predicted.",
                file=place,
                where=f"{piece.time_s[0]:.3g} to {piece.time_s[-1]:.3g} s",
                found=f"{moving} of {piece.time_s.size} samples of a motion",
                expected=f"{FEWEST_SAMPLES} or more: a recording that moves throughout, or one "
                "to fit on and another that is held out",
            )


def _require_position(config: DiagnoseConfig, recordings: Sequence[Recording], load: bool) -> None:
    if all(MOTOR_POSITION in recording.channels for recording in recordings):
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


def _one_way(parts: Sequence[Compared]) -> Iterator[str]:
    speed = np.concatenate([p.motion.speed for p in parts if p.piece.use == "used"])
    if abs(speed.sum()) >= ONE_WAY * np.abs(speed).sum():
        yield (
            "The recordings turn one way only: Coulomb friction, an offset and, at one speed, "
            "viscous friction can hardly be told apart; a recording in the other direction would "
            "separate them."
        )
