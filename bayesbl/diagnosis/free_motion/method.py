"""Diagnosis of a rigid bench in free motion: let go without motor torque."""

from __future__ import annotations

import numpy as np

from bayesbl.diagnosis.free_motion.trajectory import (
    FreeMotionComparison,
    free_motion_candidates,
    start_of,
)
from bayesbl.diagnosis.rigid.preparation import (
    GRAVITY,
    INERTIAS,
    compared_channel,
    even_recordings,
    pieces_of,
    require_rigid,
    unknown_parameters,
)
from bayesbl.diagnosis.selection import BySelection, Problem
from bayesbl.diagnosis.task import Task, notes_of, refused, wanted
from bayesbl.errors import RecordingError
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED

CHANNELS = (MOTOR_POSITION, MOTOR_SPEED)


def free_motion_problem(task: Task) -> Problem:
    """The comparison that a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    config, bench, compared = task.config, task.bench, task.config.comparison
    channel = compared_channel(task, CHANNELS, "There is no motion to compare.")
    recordings = even_recordings(task, [(channel,)] * len(task.recordings), ())
    task.require_no_known_torque("Free motion has no torque but the bench's own.")
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
        unknown_parameters(task, (*INERTIAS, GRAVITY))
    pieces = pieces_of(task, recordings, channel)
    comparison = FreeMotionComparison(
        pieces,
        tuple(start_of(piece) for piece in pieces),
        bench,
        tuple(wanted(config, bench, free_motion_candidates(compared.load_angle_known and gravity))),
        unknown,
        compared.load_angle_known or not gravity,
    )
    for made in (comparison, *comparison.folds()):
        for piece in made.pieces:
            if not np.ptp(piece.kept(piece.measured)) > 0.0:
                raise RecordingError(
                    "Nothing moves in a part that is to be fitted or predicted.",
                    file=next(r.place for r in recordings if r.name == piece.name),
                    where=f"{piece.time_s[0]:.3g} to {piece.time_s[-1]:.3g} s",
                    found=f"{channel} that never changes",
                    expected="a recording of a motion from its start to its end",
                )
    scale = "gravity" if gravity else "the inertia"
    notes = [
        *notes_of(recordings),
        f"No torque is measured: friction is known as well as {scale} of the bench is.",
        "Torque ripple, encoder and shaft effects are not tried in free motion.",
    ]
    if channel == MOTOR_SPEED:
        notes.append("Speed alone: the start angle is known only through what gravity does.")
    return Problem(comparison, lambda fit: (), tuple(notes))


METHOD = BySelection("free_motion", free_motion_problem)
