"""Progress of a run: bars on a terminal; in a pipe a line now and then, where it takes long."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from bayesbl.progress import StageProgress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

EVERY_S = 20.0
"""Between two lines in a pipe, and before the first: what ends sooner needs none."""


@contextmanager
def progress(console: Console, *, of_cases: bool = False) -> Iterator[StageProgress]:
    """Shown on ``console`` (standard error's) until the block ends.

    Yields what a run calls with what it does and how many steps are done of how many: a stage,
    which may end before the last one, or a row's cases.
    """
    # Rich takes a pipe for a terminal where FORCE_COLOR asks for colours, as notebooks do.
    if not console.file.isatty():
        yield _Lines(console)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[state]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        yield _Cases(bars) if of_cases else _Stages(bars)


class _Lines:
    """A line with the time since the begin, for logs."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._begin_s = self._last_s = time.monotonic()

    def __call__(self, stage: str, done: int, count: int, /) -> None:
        now_s = time.monotonic()
        if now_s - self._last_s < EVERY_S:
            return
        self._last_s = now_s
        line = f"{stage}: {done} of {count}, after {now_s - self._begin_s:.0f} s"
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


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


class _Stages:
    """One bar per stage; one that stops before its allowance is complete all the same."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}
        self._searching: TaskID | None = bars.add_task("Searching", total=None, state="")

    def __call__(self, stage: str, done: int, count: int, /) -> None:
        if stage not in self._tasks:
            self._start(stage)
        state = f"{done}, at most {count}"
        self._bars.update(self._tasks[stage], completed=done, total=count, state=state)

    def _start(self, stage: str) -> None:
        if self._searching is not None:
            self._bars.remove_task(self._searching)
            self._searching = None
        for task in self._bars.tasks:
            self._bars.update(task.id, total=task.completed, state=f"{task.completed:.0f}")
            self._bars.stop_task(task.id)
        self._tasks[stage] = self._bars.add_task(stage, total=None, state="")
