"""Callbacks that report the progress of a long computation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

Progress = Callable[[int, int], None]  # called with (steps done, steps allowed)
StageProgress = Callable[[str, int, int], None]  # called with (stage, steps done, steps allowed)


def silent(made: int, allowed: int) -> None:
    """Report nothing."""


def of_stage(progress: StageProgress | None, stage: str) -> Progress:
    """The progress of one stage."""
    return silent if progress is None else partial(progress, stage)


def joined(names: Sequence[str]) -> str:
    """The names of one or two recordings, or the number of more, to name a stage."""
    return " and ".join(names) if len(names) < 3 else f"{len(names)} recordings"
