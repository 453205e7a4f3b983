"""Progress of the sampling: a bar per recording on a terminal, nothing in a pipe."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID


class StageProgress(Protocol):
    """What a workflow calls after every stretch of steps."""

    def __call__(self, recording: str, steps: int, allowed: int, /) -> None:
        """Tell that ``steps`` of at most ``allowed`` were made on a recording."""


@contextmanager
def progress(console: Console) -> Iterator[StageProgress]:
    """Bars on ``console`` (standard error's) until the block ends; nothing if it is no terminal."""
    if not console.is_terminal:
        yield _silent
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[told]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        yield _Bars(bars)


def _silent(recording: str, steps: int, allowed: int, /) -> None:
    """Nothing to show."""


class _Bars:
    """One bar per recording; a chain that stops before its allowance is complete all the same."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}
        self._searching: TaskID | None = bars.add_task("Searching", total=None, told="")

    def __call__(self, recording: str, steps: int, allowed: int, /) -> None:
        if recording not in self._tasks:
            self._begin(recording)
        self._bars.update(
            self._tasks[recording],
            completed=steps,
            total=allowed,
            told=f"{steps} steps, at most {allowed}",
        )

    def _begin(self, recording: str) -> None:
        if self._searching is not None:
            self._bars.remove_task(self._searching)
            self._searching = None
        for task in self._bars.tasks:
            self._bars.update(task.id, total=task.completed, told=f"{task.completed:.0f} steps")
            self._bars.stop_task(task.id)
        self._tasks[recording] = self._bars.add_task(f"Sampling {recording}", total=None, told="")
