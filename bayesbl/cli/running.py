"""What commands share once their options are read: run, print, leave with a status."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayesbl.cli.statuses import WITHHELD
from bayesbl.errors import ResultError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID

    from bayesbl.config.sections import RunConfig
    from bayesbl.measurement.task import StageProgress


def run_config(config: RunConfig, force: bool, json: bool) -> None:
    """Run, print the answer, and leave with the status of a withheld one if it is."""
    from bayesbl.library import draw
    from bayesbl.presentation.console import make_console, print_result
    from bayesbl.presentation.progress import progress
    from bayesbl.runs.run import run

    console = make_console(stderr=True)
    bars = _case_progress if config.kind == "study" else progress
    with bars(console) as told:
        summary = run(config, draw, force=force, progress=told, say=console.print)
    if json:
        print_json(config.run.output)
    elif config.kind == "study":
        tell_study(summary, config.run.output)
    else:
        print_result(summary, config.run.output, make_console())
    if summary["outcome"] == "withheld":
        if json:
            typer.echo(f"Withheld: {summary['reason']}", err=True)
        raise typer.Exit(WITHHELD)


def simulate(
    config: Path, out: Path | None, seed: int | None, workers: int | None, force: bool, json: bool
) -> None:
    """Make the recordings, and print the files written."""
    from bayesbl.runs.simulate import run_simulate

    files = run_simulate(config, out, seed, workers, force=force)
    if json:
        import json as encoder

        typer.echo(encoder.dumps({"kind": "simulate", "files": [str(file) for file in files]}))
    else:
        for file in files:
            typer.echo(str(file))


def print_json(folder: Path) -> None:
    """The stored summary, byte for byte."""
    from bayesbl.results.folder import SUMMARY_FILE

    try:
        text = (folder / SUMMARY_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ResultError(
            "There is no summary beside this result.", file=folder, expected=SUMMARY_FILE
        ) from None
    typer.echo(text, nl=False)


def tell_study(summary: Mapping[str, Any], folder: Path | None = None) -> None:
    """The table of a study; the commit of each row stands in the files."""
    from bayesbl.presentation.console import make_console
    from bayesbl.presentation.study import print_study
    from bayesbl.runs.study import table_columns

    lines = summary["rows"]
    print_study(lines, [*table_columns(lines)[:-1], "seconds"], make_console())
    if folder is not None:
        typer.echo(f"Written to {folder}")


@contextmanager
def _case_progress(console: Console) -> Iterator[StageProgress | None]:
    """A bar per row of a study; nothing if the console is no terminal."""
    if not console.is_terminal:
        yield None
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def told(row: str, done: int, count: int, /) -> None:
            if row not in tasks:
                tasks[row] = bars.add_task(row)
            bars.update(tasks[row], completed=done, total=count)

        yield told
