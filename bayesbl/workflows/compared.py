"""What every method of diagnosis shares: recordings cut into pieces, candidates, refusals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from bayesbl.config.diagnose import DiagnoseConfig
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


def cuts(config: DiagnoseConfig, recordings: list[Recording]) -> list[tuple[int, Use, slice]]:
    """Number of the recording, use and samples of every piece; a split one is cut in the middle."""
    found: list[tuple[int, Use, slice]] = []
    for i, (entry, recording) in enumerate(zip(config.recordings, recordings, strict=True)):
        if entry.use == "split":
            half = recording.samples // 2
            found += [(i, "used", slice(None, half)), (i, "held_out", slice(half, None))]
        else:
            found.append((i, "used" if entry.use == "fit" else "held_out", slice(None)))
    return found


def piece_of(recording: Recording, channel: str, use: Use) -> Piece:
    """A recording, or some samples of it, as it is compared."""
    return Piece(recording.name, channel, use, recording.time_s, recording.channels[channel])


def rows_of(recording: Recording, rows: slice) -> Recording:
    """Some samples of a recording."""
    channels = {name: values[rows] for name, values in recording.channels.items()}
    return replace(recording, time_s=recording.time_s[rows], channels=channels)


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
