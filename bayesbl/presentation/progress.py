"""Progress of a run: bars on a terminal, nothing in a pipe."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from bayesbl.measurement.task import StageProgress


@contextmanager
def progress(console: Console, *, of_cases: bool = False) -> Iterator[StageProgress]:
    """Bars on ``console`` (standard error's) until the block ends; nothing if it is no terminal.

    Yields what a run calls with a name and how many steps are done of how many: a recording's
    steps of the sampler, which may end before the last one, or a row's cases.
    """
    # Rich takes a pipe for a terminal where FORCE_COLOR asks for colours, as notebooks do.
    if not console.file.isatty():
        yield _silent
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[state]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        yield _Cases(bars) if of_cases else _Sampling(bars)


def _silent(name: str, done: int, count: int, /) -> None:
    """Nothing to show."""


class _Cases:
    """One bar per row of a study, several of which may be running."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, row: str, done: int, count: int, /) -> None:
        if row not in self._tasks:
            self._tasks[row] = self._bars.add_task(row, state="")
        state = f"{done} of {count}"
        self._bars.update(self._tasks[row], completed=done, total=count, state=state)


class _Sampling:
    """One bar per recording; a chain that stops before its allowance is complete all the same."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}
        self._searching: TaskID | None = bars.add_task("Searching", total=None, state="")

    def __call__(self, recording: str, steps: int, allowed: int, /) -> None:
        if recording not in self._tasks:
            self._start(recording)
        state = f"{steps} steps, at most {allowed}"
        self._bars.update(self._tasks[recording], completed=steps, total=allowed, state=state)

    def _start(self, recording: str) -> None:
        if self._searching is not None:
            self._bars.remove_task(self._searching)
            self._searching = None
        for task in self._bars.tasks:
            self._bars.update(task.id, total=task.completed, state=f"{task.completed:.0f} steps")
            self._bars.stop_task(task.id)
        self._tasks[recording] = self._bars.add_task(f"Sampling {recording}", total=None, state="")
