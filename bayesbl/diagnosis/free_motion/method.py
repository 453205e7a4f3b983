"""Diagnosis of a rigid bench in free motion: let go without motor torque."""

from __future__ import annotations

import numpy as np

from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.free_motion.trajectory import (
    FreeMotionView,
    free_motion_effects,
    start_of,
)
from bayesbl.diagnosis.inference import MOST_EFFECTS, diagnose
from bayesbl.diagnosis.rigid.preparation import (
    GRAVITY,
    INERTIAS,
    compared_channel,
    even_recordings,
    pieces_of,
    require_rigid,
    unknown_parameters,
)
from bayesbl.diagnosis.task import Task, notes_of, refused, wanted
from bayesbl.errors import RecordingError
from bayesbl.progress import StageProgress
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED

CHANNELS = (MOTOR_POSITION, MOTOR_SPEED)


def view_of(task: Task) -> tuple[FreeMotionView, list[str]]:
    """The view that a configuration asks for, and what these recordings cannot show.

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
    every = free_motion_effects(compared.load_angle_known and gravity)
    view = FreeMotionView(
        pieces,
        tuple(start_of(piece) for piece in pieces),
        bench,
        tuple(effect.name for effect in wanted(config, bench, every)),
        unknown,
        compared.load_angle_known or not gravity,
    )
    for piece in pieces:
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
    return view, notes


class FreeMotion:
    """The method of diagnosis."""

    name = "free_motion"

    def describe(self, task: Task) -> str:
        """Channel and candidates."""
        view, _ = view_of(task)
        channel = view.pieces[0].channel
        return f"{self.name}, {channel}; candidates {', '.join(view.effects)}"

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer."""
        view, notes = view_of(task)
        return diagnose(
            view.prepared(),
            task.bench,
            most=task.config.candidates.max_effects or MOST_EFFECTS,
            notes=lambda inference: notes,
            progress=progress,
        )


METHOD = FreeMotion()
