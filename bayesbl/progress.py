"""What a long computation calls to tell how far it is."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

Progress = Callable[[int, int], None]
"""Called with (steps made, steps allowed)."""

StageProgress = Callable[[str, int, int], None]
"""Called with (what is being done, steps made, steps allowed)."""


def silent(made: int, allowed: int) -> None:
    """Nobody is told."""


def of_stage(progress: StageProgress | None, stage: str) -> Progress:
    """The progress of one stage."""
    return silent if progress is None else partial(progress, stage)
