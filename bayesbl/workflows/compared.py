"""What every method of diagnosis shares: recordings cut into pieces, candidates, refusals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from bayesbl.config.diagnose import DiagnoseConfig, DiagnosedRecording
from bayesbl.discrepancy.comparison import Candidate, Comparison, Fit, Piece, Use
from bayesbl.discrepancy.report import Remaining
from bayesbl.errors import ConfigError
from bayesbl.physics.bench import Bench
from bayesbl.recording.types import Recording


@dataclass(frozen=True, slots=True)
class Problem:
    """A comparison with its candidates, ready to be diagnosed."""

    comparison: Comparison
    bench: Bench
    remaining: Callable[[Fit], tuple[Remaining, ...]]
    notes: tuple[str, ...]


def pieces_of(
    config: DiagnoseConfig, recordings: list[Recording], channel: str
) -> tuple[tuple[Piece, ...], list[Recording]]:
    """Recordings and halves of them as they are compared, and as recordings beside."""
    pairs = [
        (use, part)
        for entry, recording in zip(config.recordings, recordings, strict=True)
        for use, part in _parts(entry, recording)
    ]
    pieces = tuple(
        Piece(part.name, channel, use, part.time_s, part.channels[channel]) for use, part in pairs
    )
    return pieces, [part for _, part in pairs]


def _parts(entry: DiagnosedRecording, recording: Recording) -> Iterator[tuple[Use, Recording]]:
    """The recording with its use; a split one as its first and its second half."""
    if entry.use != "split":
        yield "used" if entry.use == "fit" else "held_out", recording
        return
    half = recording.samples // 2
    uses: tuple[tuple[Use, slice], ...] = (
        ("used", slice(None, half)),
        ("held_out", slice(half, None)),
    )
    for use, rows in uses:
        channels = {name: values[rows] for name, values in recording.channels.items()}
        yield use, replace(recording, time_s=recording.time_s[rows], channels=channels)


def wanted(config: DiagnoseConfig, bench: Bench, every: Iterable[Candidate]) -> list[Candidate]:
    """Candidates that were asked for and that the bench does not have already.

    A name that means the same law here finds a candidate too.
    """
    had = {effect.name for effect in bench.effects}
    possible = [c for c in every if not {c.name, *c.same_as, c.contains} & had]
    asked = config.candidates.effects
    if asked == "all":
        return possible
    found = [c for c in possible if {c.name, *c.same_as} & set(asked)]
    known = {name for c in possible for name in (c.name, *c.same_as)}
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
