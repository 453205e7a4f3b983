"""What commands share once their options are read: run, print, leave with a status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayesbl.errors import ConfigError

if TYPE_CHECKING:
    from bayesbl.config.sections import RunConfig


FAILED, WRONG, WITHHELD = 1, 2, 3
"""A bug or Ctrl-C; wrong usage, configuration or input; an answer that is withheld."""


FIGURES: ContextVar[tuple[str, ...]] = ContextVar("figures", default=("png",))
"""Formats in which a run draws its figures."""

_OPTIONS = ("--no-figures", "--pdf")


def brought_forward(arguments: Sequence[str]) -> list[str]:
    """The same arguments with these options before the command, where they are read."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    ours = [text for text in arguments[:end] if text in _OPTIONS]
    others = [text for text in arguments[:end] if text not in _OPTIONS]
    return [*ours, *others, *arguments[end:]]


def run_file(
    config: Path, force: bool, json: bool, *, kind: str | None = None, **options: Any
) -> None:
    """Run a configuration file, of ``kind`` or of its own, with options over it."""
    from bayesbl.runs.kinds import kind_of, load_run

    if (kind or kind_of(config)) == "simulate":
        _simulate(config, force, json, options)
    else:
        run_config(load_run(config, kind=kind, **options), force, json, config)


def run_config(config: RunConfig, force: bool, json: bool, file: Path | None = None) -> None:
    """Run, print the answer, and leave with the status of a withheld one if it is."""
    from bayesbl.libraries import bare

    with bare(dask=getattr(config.run, "scheduler", None) is not None):
        _run_config(config, force, json, file)


def _run_config(config: RunConfig, force: bool, json: bool, file: Path | None) -> None:
    from bayesbl.library import draw
    from bayesbl.presentation.console import print_result
    from bayesbl.presentation.terminal import make_console, progress, say
    from bayesbl.runs.kinds import run
    from bayesbl.runs.workflow import Options

    console = make_console(stderr=True)
    with progress(console) as tell:
        options = Options(draw, force, tell, console.print, FIGURES.get())
        summary = run(config, options, file)
    if json:
        print_json(summary)
    else:
        print_result(summary, config.run.output, make_console())
    if summary["outcome"] == "withheld":
        if json:
            reason = summary["reason"]
            text = reason if isinstance(reason, str | None) else reason["text"]
            say(f"Withheld: {text}", err=True)
        raise typer.Exit(WITHHELD)


def print_json(summary: Mapping[str, Any]) -> None:
    """A summary in UTF-8, whatever the terminal's encoding, as it is stored."""
    from bayesbl.presentation.terminal import STEERING
    from bayesbl.results.store import json_text

    text = STEERING.sub(lambda match: f"\\u{ord(match[0]):04x}", json_text(summary))
    typer.echo(text.encode(), nl=False)


def _simulate(config: Path, force: bool, json: bool, options: dict[str, Any]) -> None:
    """Make the recordings, and print the files written."""
    from bayesbl.presentation.terminal import say
    from bayesbl.runs.simulate import run_simulate

    given = {name: options.pop(name) for name in ("out", "seed", "workers")}
    unused = [name for name, value in options.items() if value is not None]
    if unused:
        raise ConfigError(
            "This option does not go with a simulation.",
            file=config,
            where=f"--{unused[0]}",
            found=options[unused[0]],
            expected="--out, --seed or --workers",
        )
    files = [str(file) for file in run_simulate(config, **given, force=force)]
    if json:
        import json as encoder

        say(encoder.dumps({"kind": "simulate", "files": files}))
    else:
        for file in files:
            say(file)
