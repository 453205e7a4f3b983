"""Task and comparison of a method of diagnosis, and checks that all methods share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import RigidLaw
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.disagreement import Use
from bayesbl.diagnosis.inference import MOST_EFFECTS, Piece, View, diagnose
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import require_channels, require_unclipped
from bayesbl.recording.repairs import even
from bayesbl.recording.types import BoolArray, Recording

MOST_EXCLUDED = 0.5
"""Largest share of samples that may be excluded."""

UNEVEN = 1e-3
"""Largest deviation of a time stamp from an even grid, in periods."""

INERTIAS = ("motor_inertia_kg_m2", "load_inertia_kg_m2")
GRAVITY = "gravity_torque_nm"

USES_OF: Mapping[str, tuple[Use, ...]] = MappingProxyType(
    {"fit": ("used",), "hold_out": ("held_out",), "split": ("used", "held_out")}
)
"""Uses of an entry of ``[[recordings]]``: of the whole, or of two parts."""


@dataclass(frozen=True, slots=True)
class Task:
    """A configuration, its bench, and a recording for each of its entries."""

    config: DiagnoseConfig
    bench: Bench
    recordings: tuple[Recording, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a method would compare, in words, and the function that does it."""

    in_words: str
    diagnose: Callable[[StageProgress | None], Diagnosis]


def by_search(
    task: Task,
    view: View,
    candidates: Sequence[str],
    notes: Sequence[str],
    scale_sd: float = 0.0,
) -> Comparison:
    """Comparison by the model search, with a view of a rigid bench.

    ``candidates``: effects that may be named; ``notes``: what these recordings cannot show;
    ``scale_sd``: relative standard deviation of a common factor of all torques.
    """
    method, channel = task.config.comparison.method, view.rows.pieces[0].channel
    most = task.config.candidates.max_effects or MOST_EFFECTS
    return Comparison(
        f"{method}, {channel}; candidates {', '.join(candidates)}",
        lambda progress: diagnose(
            view, task.bench, most=most, notes=notes, scale_sd=scale_sd, progress=progress
        ),
    )


def require_rigid(task: Task) -> None:
    """Refuse a bench that is not rigid, and the gap of a rigid one."""
    if task.bench.drive != "rigid":
        raise ConfigError(
            "This method compares a rigid bench: one inertia, no gap.",
            file=task.config.bench,
            where="drive",
            found=f'"{task.bench.drive}"',
            expected='"rigid", or [comparison] method = "forward"',
        )
    if task.config.unknowns.gap_rad is not None:
        raise ConfigError(
            "A rigid bench has no gap.",
            where="[unknowns] gap_rad",
            expected="no gap_rad",
        )


def require_no_known_torque(task: Task, why: str) -> None:
    """Refuse known torques; ``why`` is the reason."""
    if task.config.comparison.known_torque:
        names = ", ".join(task.config.comparison.known_torque)
        raise ConfigError(
            why,
            where="[comparison] known_torque",
            found=names,
            expected="none",
        )


def compared_channel(task: Task, possible: Sequence[str], without_any: str) -> str:
    """The channel that is compared; ``without_any``: the error message if there is none."""
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
        raise ConfigError(
            "This method compares one channel.",
            where="[comparison] channels",
            found=", ".join(asked),
            expected="one of " + ", ".join(possible),
        )
    for recording in task.recordings:
        require_channels(recording, asked)
    return asked[0]


def even_recordings(task: Task, whole: Sequence[str]) -> list[Recording]:
    """Recordings on an even grid; channels in ``whole`` must not be clipped."""
    return [even(unclipped(recording, whole), UNEVEN) for recording in task.recordings]


def piece_of(recording: Recording, channel: str) -> Piece:
    """A whole recording as a piece."""
    require_enough(recording, channel, recording.excluded)
    values = recording.channels[channel]
    return Piece(recording.name, channel, "used", recording.time_s, values, recording.excluded)


def require_enough(recording: Recording, channel: str, excluded: BoolArray | None) -> None:
    """Refuse a recording with too many excluded samples."""
    if excluded is not None and excluded.mean() > MOST_EXCLUDED:
        raise RecordingError(
            "Too little remains to compare beside lost and stray samples.",
            file=recording.place,
            where=channel,
            found=f"{100.0 * excluded.mean():.3g} % of the samples left out, with all that "
            "the filter of the motion carries them to",
            expected=f"at most {100.0 * MOST_EXCLUDED:g} %; use the part with fewer lost samples, "
            "or a higher [comparison] cutoff_hz, which reaches less far",
        )


def parts_of(uses: Sequence[Use], middle: int) -> list[tuple[Use, slice]]:
    """The samples of each use: all, or those before and after a middle."""
    rows = [slice(None)] if len(uses) == 1 else [slice(None, middle), slice(middle, None)]
    return list(zip(uses, rows, strict=True))


def unclipped(recording: Recording, channels: Sequence[str]) -> Recording:
    """The recording; raises ``RecordingError`` if a channel is clipped."""
    for channel in channels:
        require_unclipped(recording, channel)
    return recording


def notes_of(recordings: Sequence[Recording]) -> list[str]:
    """Notes on repairs of each recording, with its name."""
    return [f"{recording.name}: {note}" for recording in recordings for note in recording.notes]


def wanted(
    config: DiagnoseConfig, bench: Bench, laws: Mapping[str, RigidLaw | None]
) -> tuple[str, ...]:
    """Requested effects that the bench does not have.

    An effect may be requested by any name with the same law. ``laws``: laws of the effects that the
    comparison can show; ``None`` for its own.
    """
    present = {effect.name for effect in bench.effects}
    synonyms = {
        name: {name} if law is None else {name, *law.same_as}
        for name, law in laws.items()
        if name not in present and (law is None or not {*law.same_as, law.contains} & present)
    }
    asked = config.candidates.effects
    if asked == "all":
        return tuple(synonyms)
    known = set().union(*synonyms.values())
    for name in asked:
        if name not in known:
            raise ConfigError(
                "This effect does not show in this comparison.",
                where="[candidates] effects",
                found=name,
                expected="one of " + ", ".join(sorted(known)),
            )
    return tuple(name for name, names in synonyms.items() if names & set(asked))


def unknown_parameters(task: Task) -> tuple[str, ...]:
    """Bench parameters declared unknown; refuses those that cannot be fitted."""
    names = task.config.unknowns.bench_parameters
    for name in names:
        if name not in (*INERTIAS, GRAVITY):
            raise ConfigError(
                "This parameter has no part in this comparison.",
                where="[unknowns] bench_parameters",
                found=name,
                expected="one of " + ", ".join((*INERTIAS, GRAVITY)),
            )
    if set(INERTIAS) <= set(names):
        raise ConfigError(
            "A rigid bench shows only the sum of its inertias.",
            where="[unknowns] bench_parameters",
            found=", ".join(INERTIAS),
            expected="one of the two",
        )
    if GRAVITY in names and not task.config.comparison.load_angle_known:
        raise ConfigError(
            "Without the load's angle gravity is fitted anyway, size and direction.",
            where="[unknowns] bench_parameters",
            found=GRAVITY,
            expected="load_angle_known = true, or no gravity_torque_nm here",
        )
    return names


def believed_sds(bench: Bench, names: Sequence[str]) -> dict[str, float]:
    """Prior standard deviations of fitted parameters: the tolerance, but at least the value."""
    return {
        name: max(bench.tolerances.get(name, 0.0), abs(bench.value(name)))
        for name in names
        if bench.value(name) != 0.0
    }
