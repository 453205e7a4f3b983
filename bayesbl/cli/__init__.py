"""Command line and exit statuses. ``--help`` answers at once: heavy imports wait for a command."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from bayesbl import __version__
from bayesbl.cli.commands import COMMANDS, FAILED, FIGURES, WITHHELD, WRONG, brought_forward
from bayesbl.errors import UserError
from bayesbl.presentation.terminal import (
    error,
    make_console,
    plain,
    replace_what_cannot_be_printed,
    say,
)

__all__ = ["FAILED", "WITHHELD", "WRONG", "app", "main", "status"]
_UsageError: Any = typer.BadParameter.__bases__[0]  # click's, or that of typer's own copy of click
INTERRUPTED = 130  # status with which typer ends after Ctrl-C

app = typer.Typer(
    help="Measure the backlash gap of a robot joint, and its growth, from recordings of the motor.",
    epilog="Exit status: 0 done, 2 wrong usage, configuration or input, 3 answer withheld, "
    "1 anything else.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for command in COMMANDS:
    app.command(command.__name__.removesuffix("_command"))(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        from bayesbl.results.provenance import UNKNOWN, git_commit

        commit = git_commit()
        typer.echo(f"bayesbl {__version__}" + ("" if commit == UNKNOWN else f" ({commit})"))
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print version and commit."
        ),
    ] = False,
    no_figures: Annotated[
        bool,
        typer.Option("--no-figures", help="Draw no figures; `bayesbl figures` draws them later."),
    ] = False,
    pdf: Annotated[bool, typer.Option("--pdf", help="Draw figures as PDF too.")] = False,
) -> None:
    """Options of every command."""
    if no_figures and pdf:
        raise typer.BadParameter("--no-figures and --pdf exclude each other.")
    FIGURES.set(() if no_figures else ("pdf", "png") if pdf else ("png",))


def main() -> None:
    """The installed command."""
    # The matrices are small: threads of linear algebra cost more than they bring, and round
    # differently on other numbers of cores.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    # Imports and figures make many objects and hardly any garbage: to look for it after every 700
    # of them took a fifth of a fit's time, and found no memory.
    gc.set_threshold(50_000)
    _open_what_is_closed()
    code = status()
    gc.freeze()  # what is left ends with the process, and need not be looked through once more
    sys.exit(code)


def _open_what_is_closed() -> None:
    """Open missing standard streams, as of a service, so that files never get their numbers."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        if number > 0:
            name = ("stdout", "stderr")[number - 1]
            setattr(sys, name, os.fdopen(number, "w", encoding="utf-8", closefd=False))
    os.close(number)


def status(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default ``sys.argv``, and return its exit status."""
    replace_what_cannot_be_printed()
    try:
        # --help, --version and Ctrl-C end inside typer, with the status as value.
        given = brought_forward(sys.argv[1:] if arguments is None else arguments)
        code = app(given, prog_name="bayesbl", standalone_mode=False)
    except _UsageError as usage:
        usage.message = plain(usage.message)
        usage.show()
        return WRONG
    except SystemExit as end:  # typer's for a pipe that nobody reads any more
        return end.code if isinstance(end.code, int) else FAILED
    except UserError as problem:
        error(make_console(stderr=True), problem)
        return WRONG
    except OSError as problem:
        place = f"{problem.filename}: " if problem.filename else ""
        say(f"Error: {place}{problem.strerror or problem}.", err=True)
        for note in getattr(problem, "__notes__", ()):
            say(note, err=True)
        return FAILED
    except Exception:
        import traceback

        say(f"This is a bug in bayesbl {__version__}; please report it:\n", err=True)
        say(traceback.format_exc(), err=True)
        return FAILED
    if code == INTERRUPTED:
        say("Interrupted; nothing was overwritten.", err=True)
        return FAILED
    return code or 0
