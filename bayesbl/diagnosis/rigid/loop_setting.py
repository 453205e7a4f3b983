"""What is asked of a rigid drive's speed loop: recordings, what may be fitted and be named."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

from bayesbl.diagnosis.comparison import TestedEffect
from bayesbl.diagnosis.rigid.order_laws import Free
from bayesbl.diagnosis.rigid.order_lines import Turning, turned
from bayesbl.diagnosis.rigid.preparation import even_recordings, require_rigid
from bayesbl.diagnosis.rigid.speed_loop import (
    LOOP_EFFECTS,
    LOOP_PARAMETERS,
    loop_values,
    speed_of_torque,
)
from bayesbl.diagnosis.task import Task, notes_of, piece_of, refused, wanted
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.recording.moving import is_one_speed
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED

RIPPLE, ECCENTRICITY = "motor_torque_ripple", "encoder_eccentricity"
GAINS = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
CANDIDATES = (
    TestedEffect(RIPPLE),
    TestedEffect(ECCENTRICITY),
    *map(TestedEffect, LOOP_EFFECTS),
)
CONSTANT = ("motor_coulomb_friction", "load_coulomb_friction", "load_viscous_friction")
"""Effects of a bench that are no line at one speed, or are known to the loop."""

LOAD_COUNTS = 0.01
"""Share of the inertia from which the load's is spoken of."""

HIDDEN = (
    "From the speed alone the controller's integral hides what friction is on average: only what "
    "repeats, and what changes how the loop answers, can be named. Its sizes are known as well as "
    "the gains and the inertia are."
)


@dataclass(frozen=True, slots=True)
class Setting:
    """Pieces to fit on and to predict, what of the loop is free, what may be named, and notes."""

    used: tuple[Turning, ...]
    held_out: tuple[Turning, ...]
    values: dict[str, float]
    free: Free
    candidates: tuple[str, ...]
    notes: tuple[str, ...]


def loop_setting(task: Task) -> Setting:
    """What a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    task.require_no_known_torque("The speed alone is compared, without any torque.")
    config, bench = task.config, task.bench
    if not set(config.comparison.channels) <= {MOTOR_SPEED}:
        raise refused(
            "A rigid drive in its closed loop is compared by its speed.",
            "[comparison] channels",
            ", ".join(config.comparison.channels),
            f'["{MOTOR_SPEED}"]; or method = "inverse", which compares torque or current; or '
            'drive = "two_mass" in the bench, with its shaft and gap',
        )
    missing = [name for name in GAINS if name in bench.assumed]
    if missing:
        raise ConfigError(
            "What the speed shows of a torque is decided by the controller's gains.",
            file=config.bench,
            where="[parameters]",
            found=f"no {' and no '.join(missing)}",
            expected=" and ".join(f"{name} = {{value = …}}" for name in missing),
        )
    known = {*LOOP_EFFECTS, *CONSTANT}
    others = [effect.name for effect in bench.effects if effect.name not in known]
    if others:
        raise ConfigError(
            "What repeats with the motor is named afresh here, not beside what the bench has.",
            file=config.bench,
            where="[[effects]]",
            found=", ".join(others),
            expected="a bench without them",
        )
    task.require_channels_of([MOTOR_SPEED])
    used, held_out = [], []
    recordings = even_recordings(task, [(MOTOR_SPEED,)] * len(task.recordings), (MOTOR_SPEED,))
    values = loop_values(bench)
    response = partial(speed_of_torque, values)
    load_order = 1.0 / bench.value("gear_ratio") if bench.value("gravity_torque_nm") else None
    for entry, recording in zip(config.recordings, recordings, strict=True):
        if not is_one_speed(recording.motor_speed_rpm, recording.sampling_period_s):
            raise RecordingError(
                "The speed alone is compared in recordings of one speed each.",
                file=recording.place,
                where=MOTOR_SPEED,
                found=f"a mean of {recording.motor_speed_rpm.mean():.4g} rpm, and parts that "
                "depart from it by more than noise and ripple do",
                expected="one speed; or torque or current beside the motion (inverse)",
            )
        whole = piece_of(recording, MOTOR_SPEED, "used")
        angle = recording.channels.get(MOTOR_POSITION)
        made = Turning(whole, turned(whole) if angle is None else angle, response, load_order)
        if entry.use == "split":
            used.append(_half(made, False))
            held_out.append(_half(made, True))
        elif entry.use == "fit":
            used.append(made)
        else:
            held_out.append(_as_held_out(made))
    unknown = config.unknowns.bench_parameters
    for name in unknown:
        if name not in LOOP_PARAMETERS or not bench.tolerances.get(name):
            raise refused(
                "A parameter of the loop is free within its tolerance, and this one is none or "
                "has none.",
                "[unknowns] bench_parameters",
                name,
                "one with a tolerance of " + ", ".join(LOOP_PARAMETERS),
            )
    priors = {n: bench.tolerances[n] / math.sqrt(3.0) / bench.value(n) for n in unknown}
    names = tuple(candidate.name for candidate in wanted(config, bench, CANDIDATES))
    notes = (*notes_of(recordings), HIDDEN, *_soft_shaft(values))
    return Setting(tuple(used), tuple(held_out), values, Free(priors), names, notes)


def _soft_shaft(values: Mapping[str, float]) -> Iterator[str]:
    """What the load's inertia means where a shaft lies between."""
    at_motor = values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    motor = values["motor_inertia_kg_m2"] / (values["motor_inertia_kg_m2"] + at_motor)
    if motor < 1.0 - LOAD_COUNTS:
        yield (
            f"The load holds {100.0 * (1.0 - motor):.2g} % of the inertia. Beyond the resonance of "
            f"a shaft to it only the motor's own moves, and torques are {motor:.2g} times what is "
            'said here: compare with drive = "two_mass" if the joint has a gear.'
        )


def _half(item: Turning, second: bool) -> Turning:
    middle = item.angle.size // 2
    angle = item.angle[middle:] if second else item.angle[:middle]
    half = replace(item, piece=item.piece.half(second), angle=angle, made={})
    return _as_held_out(half) if second else half


def _as_held_out(item: Turning) -> Turning:
    return replace(item, piece=replace(item.piece, use="held_out"))
