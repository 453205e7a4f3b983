"""What the comparisons of a rigid bench ask of it and of the recordings, and their answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.inference import MOST_EFFECTS, View, diagnose
from bayesbl.diagnosis.task import (
    USES_OF,
    Task,
    parts_of,
    piece_of,
    refused,
    require_enough,
    unclipped,
)
from bayesbl.errors import RecordingError
from bayesbl.progress import StageProgress
from bayesbl.recording.lost_samples import even
from bayesbl.recording.types import Recording

UNEVEN = 1e-3
"""Departure of a time stamp from the even grid, in periods, up to which it is even."""

INERTIAS = ("motor_inertia_kg_m2", "load_inertia_kg_m2")
GRAVITY = "gravity_torque_nm"


def require_rigid(task: Task) -> None:
    """Refuse a bench that is not rigid, and a gap in one that is."""
    task.require_drive("rigid", "This method compares a rigid bench: one inertia, no gap.")
    if task.config.unknowns.gap_rad is not None:
        raise refused("A rigid bench has no gap.", "[unknowns] gap_rad", None, "no gap_rad")


def compared_channel(task: Task, possible: Sequence[str], without_any: str) -> str:
    """The one channel that is compared; ``without_any`` says why none of them is not enough."""
    asked = task.config.comparison.channels
    if not asked:
        everywhere = [c for c in possible if all(c in r.channels for r in task.recordings)]
        if everywhere:
            return everywhere[0]
        first = task.recordings[0]
        raise RecordingError(
            without_any,
            file=first.place,
            found=", ".join(first.channels),
            expected="one of " + ", ".join(possible),
        )
    if len(asked) != 1 or asked[0] not in possible:
        raise refused(
            "This method compares one channel.",
            "[comparison] channels",
            ", ".join(asked),
            "one of " + ", ".join(possible),
        )
    task.require_channels_of(asked)
    return asked[0]


def even_recordings(task: Task, whole: Sequence[str]) -> list[Recording]:
    """Recordings on an even grid; the peaks of the channels ``whole`` must not be cut off."""
    return [even(unclipped(recording, whole), UNEVEN) for recording in task.recordings]


def pieces_of(task: Task, recordings: Sequence[Recording], channel: str) -> tuple[Piece, ...]:
    """Pieces to fit on and to predict; what comes to rest is split where half its way is done."""
    found = []
    for entry, recording in zip(task.config.recordings, recordings, strict=True):
        way = np.cumsum(np.abs(np.diff(recording.channels[channel])))
        middle = int(np.searchsorted(way, 0.5 * way[-1]))
        whole = piece_of(recording, channel)
        for use, rows in parts_of(USES_OF[entry.use], middle):
            found.append(whole.part(rows, use))
            require_enough(recording, channel, found[-1].excluded)
    return tuple(found)


def unknown_parameters(task: Task, possible: Sequence[str]) -> tuple[str, ...]:
    """Declared unknown bench parameters, refused where they cannot be fitted."""
    names = task.config.unknowns.bench_parameters
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
    if GRAVITY in names and not task.config.comparison.load_angle_known:
        raise refused(
            "Without the load's angle gravity is fitted anyway, size and direction.",
            "[unknowns] bench_parameters",
            GRAVITY,
            "load_angle_known = true, or no gravity_torque_nm here",
        )
    return names


def believed_sds(bench: Bench, names: Sequence[str]) -> dict[str, float]:
    """Of parameters that are fitted: as far as the tolerance, or as far as nothing."""
    return {
        name: max(bench.tolerances.get(name, 0.0), abs(bench.value(name)))
        for name in names
        if bench.value(name) != 0.0
    }


@dataclass(frozen=True, slots=True)
class Asked:
    """What a configuration asks for.

    ``candidates``: effects that may be named. ``notes``: what these recordings cannot show.
    ``scale_sd``: relative standard deviation of a factor that all torques have in common.
    """

    view: View
    candidates: tuple[str, ...]
    notes: tuple[str, ...]
    scale_sd: float = 0.0


@dataclass(frozen=True, slots=True)
class RigidMethod:
    """A method of diagnosis by the model search; ``asked``: from a task to its view."""

    name: str
    asked: Callable[[Task], Asked]

    def describe(self, task: Task) -> str:
        """Channel and candidates."""
        asked = self.asked(task)
        channel = asked.view.pieces[0].channel
        return f"{self.name}, {channel}; candidates {', '.join(asked.candidates)}"

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer."""
        asked = self.asked(task)
        return diagnose(
            asked.view,
            task.bench,
            most=task.config.candidates.max_effects or MOST_EFFECTS,
            notes=asked.notes,
            scale_sd=asked.scale_sd,
            progress=progress,
        )
