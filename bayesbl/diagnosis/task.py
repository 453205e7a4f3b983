"""What a method of diagnosis is given, and what all of them ask of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from bayesbl.bench.bench import Bench, Drive
from bayesbl.bench.effect_declaration import RigidLaw
from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.disagreement import Use
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.recording.checks import require_channels, require_unclipped
from bayesbl.recording.types import BoolArray, Recording

MOST_EXCLUDED = 0.5
"""Largest share of a piece that may be left out: what remains should still be a recording."""

USES_OF: Mapping[str, tuple[Use, ...]] = MappingProxyType(
    {"fit": ("used",), "hold_out": ("held_out",), "split": ("used", "held_out")}
)
"""How an entry of ``[[recordings]]`` is used: whole, or in two parts."""

OTHER_METHODS = {
    "two_mass": '"two_mass", or [comparison] method = "inverse" or "free_motion"',
    "rigid": '"rigid", or [comparison] method = "forward"',
}
"""Drive of a bench that a method asks for to what may be changed."""


@dataclass(frozen=True, slots=True)
class Task:
    """The configuration, the bench it names, and a recording for each of its entries."""

    config: DiagnoseConfig
    bench: Bench
    recordings: tuple[Recording, ...]

    def require_drive(self, drive: Drive, why: str) -> None:
        """Refuse a bench of another kind."""
        if self.bench.drive != drive:
            raise ConfigError(
                why,
                file=self.config.bench,
                where="drive",
                found=f'"{self.bench.drive}"',
                expected=OTHER_METHODS[drive],
            )

    def require_no_known_torque(self, why: str) -> None:
        """Refuse torques known from outside."""
        if self.config.comparison.known_torque:
            names = ", ".join(self.config.comparison.known_torque)
            raise refused(why, "[comparison] known_torque", names, "none")

    def require_channels_of(self, channels: Sequence[str]) -> None:
        """Refuse recordings without these channels."""
        for recording in self.recordings:
            require_channels(recording, channels)


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
    found = tuple(name for name, names in meaning.items() if names & set(asked))
    known = set().union(*meaning.values())
    for name in asked:
        if name not in known:
            raise refused(
                "This effect does not show in this comparison.",
                "[candidates] effects",
                name,
                "one of " + ", ".join(sorted(known)),
            )
    return found


def refused(problem: str, where: str, found: str | None, expected: str) -> ConfigError:
    """The error for a field of the configuration."""
    return ConfigError(problem, where=where, found=found, expected=expected)
