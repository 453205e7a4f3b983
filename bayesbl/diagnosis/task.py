"""What a method of diagnosis is given, what all of them ask of it, and what each makes of it."""

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
"""Largest share of a piece that may be left out: what remains should still be a recording."""

UNEVEN = 1e-3
"""Departure of a time stamp from the even grid, in periods, up to which it is even."""

INERTIAS = ("motor_inertia_kg_m2", "load_inertia_kg_m2")
GRAVITY = "gravity_torque_nm"

USES_OF: Mapping[str, tuple[Use, ...]] = MappingProxyType(
    {"fit": ("used",), "hold_out": ("held_out",), "split": ("used", "held_out")}
)
"""How an entry of ``[[recordings]]`` is used: whole, or in two parts."""


@dataclass(frozen=True, slots=True)
class Task:
    """The configuration, the bench it names, and a recording for each of its entries."""

    config: DiagnoseConfig
    bench: Bench
    recordings: tuple[Recording, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """A task that suits a method: what would be compared in words, and how the answer is made."""

    in_words: str
    diagnose: Callable[[StageProgress | None], Diagnosis]


def by_search(
    task: Task,
    view: View,
    candidates: Sequence[str],
    notes: Sequence[str],
    scale_sd: float = 0.0,
) -> Comparison:
    """By the model search around a view of a rigid bench.

    Parameters
    ----------
    candidates
        Effects that may be named.
    notes
        What these recordings cannot show.
    scale_sd
        Relative standard deviation of a factor that all torques have in common.
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
    """Refuse a bench that is not rigid, and a gap in one that is."""
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
    """Refuse torques known from outside."""
    if task.config.comparison.known_torque:
        names = ", ".join(task.config.comparison.known_torque)
        raise ConfigError(
            why,
            where="[comparison] known_torque",
            found=names,
            expected="none",
        )


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
    """Recordings on an even grid; the peaks of the channels ``whole`` must not be cut off."""
    return [even(unclipped(recording, whole), UNEVEN) for recording in task.recordings]


def piece_of(recording: Recording, channel: str) -> Piece:
    """A recording as it is compared."""
    require_enough(recording, channel, recording.excluded)
    values = recording.channels[channel]
    return Piece(recording.name, channel, "used", recording.time_s, values, recording.excluded)


def require_enough(recording: Recording, channel: str, excluded: BoolArray | None) -> None:
    """Refuse a recording of which most samples are lost or strays."""
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
    """The samples of each use: all, or those before a middle and those from there on."""
    rows = [slice(None)] if len(uses) == 1 else [slice(None, middle), slice(middle, None)]
    return list(zip(uses, rows, strict=True))


def unclipped(recording: Recording, channels: Sequence[str]) -> Recording:
    """The recording; raises ``RecordingError`` where the peaks of a channel are cut off."""
    for channel in channels:
        require_unclipped(recording, channel)
    return recording


def notes_of(recordings: Sequence[Recording]) -> list[str]:
    """What was done to each recording, under its name."""
    return [f"{recording.name}: {note}" for recording in recordings for note in recording.notes]


def wanted(
    config: DiagnoseConfig, bench: Bench, laws: Mapping[str, RigidLaw | None]
) -> tuple[str, ...]:
    """Effects that were asked for and that the bench does not have already.

    A name that means the same law here finds an effect too. ``laws``: of those that may be missing;
    ``None`` where the comparison has one of its own.
    """
    had = {effect.name for effect in bench.effects}
    meaning = {
        name: {name} if law is None else {name, *law.same_as}
        for name, law in laws.items()
        if name not in had and (law is None or not {*law.same_as, law.contains} & had)
    }
    asked = config.candidates.effects
    if asked == "all":
        return tuple(meaning)
    quantities = tuple(name for name, names in meaning.items() if names & set(asked))
    known = set().union(*meaning.values())
    for name in asked:
        if name not in known:
            raise ConfigError(
                "This effect does not show in this comparison.",
                where="[candidates] effects",
                found=name,
                expected="one of " + ", ".join(sorted(known)),
            )
    return quantities


def unknown_parameters(task: Task) -> tuple[str, ...]:
    """Declared unknown bench parameters, refused where they cannot be fitted."""
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
    """Of parameters that are fitted: as far as the tolerance, or as far as nothing."""
    return {
        name: max(bench.tolerances.get(name, 0.0), abs(bench.value(name)))
        for name in names
        if bench.value(name) != 0.0
    }
