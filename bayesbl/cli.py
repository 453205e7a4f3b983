"""The command line: options to configurations, workflows run, results printed, exit statuses.

``--help`` has to answer at once, so nothing heavy is imported before a command needs it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesbl import __version__
from bayesbl.errors import ResultError, UserError

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console
    from rich.progress import TaskID

    from bayesbl.config.sections import RunConfig
    from bayesbl.workflows.measure import StageProgress

FAILED, WRONG, WITHHELD, INTERRUPTED = 1, 2, 3, 130
"""Exit statuses besides 0: what no user can mend; usage, config or input; no answer; Ctrl-C."""

app = typer.Typer(
    help="The backlash gap of a robot joint, and how it changed, from recordings of motor speed.",
    epilog="Exit status: 0 done, 2 wrong usage, configuration or input, 3 answer withheld, "
    "1 anything else.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    add_completion=False,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _whole_number(text: str) -> int:
    """An option's value; what it may be is the schema's to say."""
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"Found: {text}. Expected: a whole number.") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(f"Found: {text}. Expected: a number.") from None


def _day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(f"Found: {text}. Expected: a date, e.g. 2026-03-01.") from None


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration in TOML.")]
ResultPath = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Output folder of a run, or its result.nc.")
]
BaseConfig = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Configuration that the options go over."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="FOLDER", help="Output folder. [default: results/<name>]"),
]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        parser=_whole_number,
        metavar="N",
        help="Seed of all random numbers. [default: 1]",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        parser=_whole_number,
        metavar="N",
        help="Most processes at a time, where there is work for them; the numbers do not "
        "depend on it. [default: all cores]",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace a finished result, or start over.")]
Json = Annotated[bool, typer.Option("--json", help="Print the summary as JSON, nothing else.")]
Curve = Annotated[
    str | None,
    typer.Option("--curve", metavar="published|FILE", help="Gap curve. [default: published]"),
]
BenchFile = Annotated[
    Path | None,
    typer.Option("--bench", metavar="FILE", help="Bench of the joint, for the direct route."),
]
Route = Annotated[
    str | None,
    typer.Option(
        "--route",
        metavar="amplitude|direct",
        help="From the ringing's amplitude by a curve, or from the simulated bench. "
        "[default: amplitude]",
    ),
]
StartFrom = Annotated[
    Path | None,
    typer.Option(
        "--start-from",
        metavar="RESULT",
        help="Earlier result of this joint, from whose optimum the search starts.",
    ),
]
CheckSampler = Annotated[
    bool,
    typer.Option(
        "--check-sampler", help="Sample again by a nested sampler, and tell where both differ."
    ),
]
LimitRad = Annotated[
    float | None,
    typer.Option(
        "--limit-rad",
        parser=_number,
        metavar="RAD",
        help="Gap at which the joint is to be repaired.",
    ),
]
Before = Annotated[
    date | None,
    typer.Option(
        "--before",
        parser=_day,
        metavar="DATE",
        help="Also tell how probably the gap passes its limit before this date.",
    ),
]
Dates = Annotated[
    list[date] | None,
    typer.Option(
        "--date",
        parser=_day,
        metavar="DATE",
        help="When a recording was taken; once for each, in their order.",
    ),
]
GearRatio = Annotated[
    float | None,
    typer.Option(
        "--gear-ratio", parser=_number, metavar="N", help="Motor turns per turn of the load."
    ),
]
Level = Annotated[
    float | None,
    typer.Option(
        "--level",
        parser=_number,
        metavar="P",
        help="Level of the credible intervals. [default: 0.9]",
    ),
]


def main() -> None:
    """The installed command."""
    # The matrices are small: threads of linear algebra cost more than they bring, and round
    # differently on other numbers of cores.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    sys.exit(status())


def status(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, ``sys.argv``'s by default, and return its exit status."""
    from bayesbl.report.console import error, make_console

    try:
        app(arguments, prog_name="bayesbl")
    except SystemExit as end:
        # Usage errors, --help and Ctrl-C end inside typer.
        code = end.code if isinstance(end.code, int) else FAILED
        if code == INTERRUPTED:
            print("Interrupted; nothing was written over.", file=sys.stderr)
        return code
    except UserError as problem:
        error(make_console(stderr=True), problem)
        return WRONG
    except OSError as problem:
        place = f"{problem.filename}: " if problem.filename else ""
        print(f"Error: {place}{problem.strerror or problem}.", file=sys.stderr)
        return FAILED
    except Exception:
        import traceback

        print(f"This is a bug in bayesbl {__version__}; please report it:\n", file=sys.stderr)
        traceback.print_exc()
        return FAILED
    return 0


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"bayesbl {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Options before the command."""


@app.command("run")
def run_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    before: Before = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run a configuration, whatever its kind."""
    from bayesbl.workflows.run import kind_of, load_run

    if kind_of(config) == "simulate":
        _simulate(config, out, seed, workers, force, json)
    else:
        _run(load_run(config, out=out, seed=seed, workers=workers, before=before), force, json)


@app.command("check")
def check_command(config: ConfigPath) -> None:
    """Check all that can be checked without running."""
    from bayesbl.report.console import error, make_console
    from bayesbl.workflows.run import check

    plan = check(config)
    for label, text in plan.lines:
        typer.echo(f"{label}: {text}")
    for problem in plan.problems:
        error(make_console(stderr=True), problem)
    if plan.problems:
        raise typer.Exit(WRONG)
    typer.echo("Nothing stands against a run.")


@app.command("fit")
def fit_command(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording, CSV.")],
    config: BaseConfig = None,
    out: Out = None,
    seed: Seed = None,
    force: Force = False,
    json: Json = False,
    curve: Curve = None,
    route: Route = None,
    bench: BenchFile = None,
    limit_rad: LimitRad = None,
    gear_ratio: GearRatio = None,
    level: Level = None,
    workers: Workers = None,
    start_from: StartFrom = None,
    check_sampler: CheckSampler = False,
) -> None:
    """Measure the gap in one recording."""
    options = {"out": out, "seed": seed, "curve": curve, "limit_rad": limit_rad}
    options |= {"route": route, "bench": bench}
    options |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    options |= {"start_from": start_from, "check_sampler": check_sampler or None}
    _measure("fit", [recording], config, options, force, json)


@app.command("compare")
def compare_command(
    first: Annotated[Path, typer.Argument(metavar="FIRST", help="The oldest recording, CSV.")],
    later: Annotated[
        list[Path], typer.Argument(metavar="SECOND", help="Later ones of the same joint, in order.")
    ],
    config: BaseConfig = None,
    out: Out = None,
    seed: Seed = None,
    force: Force = False,
    json: Json = False,
    curve: Curve = None,
    route: Route = None,
    bench: BenchFile = None,
    dates: Dates = None,
    limit_rad: LimitRad = None,
    before: Before = None,
    gear_ratio: GearRatio = None,
    level: Level = None,
    workers: Workers = None,
    start_from: StartFrom = None,
    check_sampler: CheckSampler = False,
) -> None:
    """Measure each gap, the change from first to last, and with dates how fast it grows."""
    options: dict[str, Any] = {"out": out, "seed": seed, "curve": curve, "limit_rad": limit_rad}
    options |= {"route": route, "bench": bench}
    options |= {"gear_ratio": gear_ratio, "level": level, "workers": workers}
    options |= {"start_from": start_from, "check_sampler": check_sampler or None}
    options |= {"before": before, "dates": dates or ()}
    _measure("compare", [first, *later], config, options, force, json)


@app.command("simulate")
def simulate_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Make recordings on a virtual bench."""
    _simulate(config, out, seed, workers, force, False)


@app.command("sweep")
def sweep_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Sweep a virtual bench over its gap, for a gap curve of its own."""
    from bayesbl.workflows.run import load_run

    loaded = load_run(config, kind="sweep", out=out, seed=seed, workers=workers)
    _run(loaded, force, json)


@app.command("diagnose")
def diagnose_command(
    config: ConfigPath,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find what a bench lacks that recordings show."""
    from bayesbl.workflows.run import load_run

    loaded = load_run(config, kind="diagnose", out=out, seed=seed, workers=workers)
    _run(loaded, force, json)


@app.command("effects")
def effects_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="An effect to show in full.")
    ] = None,
) -> None:
    """Print the catalogue of physical effects, or one entry in full."""
    from bayesbl.physics.effects import EFFECTS, effect_named
    from bayesbl.report.catalogue import print_catalogue, print_effect
    from bayesbl.report.console import make_console

    if name is None:
        print_catalogue(EFFECTS, make_console())
    else:
        print_effect(effect_named(name), make_console())


@app.command("figures")
def figures_command(result: ResultPath) -> None:
    """Draw the figures of a result again."""
    from bayesbl.results.folder import FIGURES
    from bayesbl.results.store import read_tree

    tree = read_tree(result)
    folder = (result if result.is_dir() else result.parent) / FIGURES
    for path in _draw_in_place(tree, folder):
        typer.echo(str(path))


@app.command("report")
def report_command(result: ResultPath) -> None:
    """Write a result as one HTML page, report.html, that opens anywhere."""
    from bayesbl.report.page.build import write_page

    typer.echo(str(write_page(result, _draw)))


@app.command("inspect")
def inspect_command(result: ResultPath, json: Json = False) -> None:
    """Print what a result says."""
    from bayesbl.report.console import make_console, print_summary
    from bayesbl.results.store import read_tree

    tree = read_tree(result)
    if json:
        _print_json(result if result.is_dir() else result.parent)
    elif tree.attrs["kind"] == "study":
        from bayesbl.workflows.study import summarise_study

        _print_study(summarise_study(tree))
    else:
        print_summary(tree, make_console())


@app.command("init")
def init_command(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING", help="One to be fitted, several to be compared."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="The file to write. [default: RECORDING.toml]"),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
) -> None:
    """Write a first configuration for recordings, columns and units guessed."""
    from bayesbl.report.console import error, make_console
    from bayesbl.report.started import print_guess
    from bayesbl.workflows.run import check
    from bayesbl.workflows.start import start_config

    path, guess = start_config(recordings, out, force=force)
    print_guess(guess, path, make_console())
    problems = check(path).problems
    for problem in problems:
        error(make_console(stderr=True), problem)
    if problems:
        raise typer.Exit(WRONG)


@app.command("cite")
def cite_command(
    bibtex: Annotated[bool, typer.Option("--bibtex", help="Print BibTeX, nothing else.")] = False,
) -> None:
    """Print what to cite, as text and as BibTeX."""
    from bayesbl.report.citations import all_bibtex, told_citations

    if not bibtex:
        for line in told_citations():
            typer.echo(f"{line}\n")
    typer.echo(all_bibtex())


def _measure(
    kind: str,
    recordings: Sequence[Path],
    config: Path | None,
    options: dict[str, Any],
    force: bool,
    json: bool,
) -> None:
    from bayesbl.config.loading import config_from_options

    _run(config_from_options(kind, recordings, config, **options), force, json)


def _run(config: RunConfig, force: bool, json: bool) -> None:
    """Run, print the answer, and leave with the status of a withheld one if it is."""
    from bayesbl.report.console import make_console, print_result
    from bayesbl.report.progress import progress
    from bayesbl.workflows.run import run

    console = make_console(stderr=True)
    bars = _case_progress if config.kind == "study" else progress
    with bars(console) as told:
        summary = run(config, _draw, force=force, progress=told, say=console.print)
    if json:
        _print_json(config.run.output)
    elif config.kind == "study":
        _print_study(summary, config.run.output)
    else:
        print_result(summary, config.run.output, make_console())
    if summary["outcome"] == "withheld":
        if json:
            typer.echo(f"Withheld: {summary['reason']}", err=True)
        raise typer.Exit(WITHHELD)


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


def _simulate(
    config: Path, out: Path | None, seed: int | None, workers: int | None, force: bool, json: bool
) -> None:
    from bayesbl.workflows.simulate import run_simulate

    files = run_simulate(config, out, seed, workers, force=force)
    if json:
        import json as encoder

        typer.echo(encoder.dumps({"kind": "simulate", "files": [str(file) for file in files]}))
    else:
        for file in files:
            typer.echo(str(file))


def _print_json(folder: Path) -> None:
    """The stored summary, byte for byte."""
    from bayesbl.results.folder import SUMMARY_FILE

    try:
        text = (folder / SUMMARY_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ResultError(
            "There is no summary beside this result.", file=folder, expected=SUMMARY_FILE
        ) from None
    typer.echo(text, nl=False)


def _print_study(summary: dict[str, Any], folder: Path | None = None) -> None:
    """The table of a study; the commit of each row stands in the files."""
    from bayesbl.report.console import make_console
    from bayesbl.report.study import print_study
    from bayesbl.workflows.study import table_columns

    lines = summary["rows"]
    print_study(lines, [*table_columns(lines)[:-1], "seconds"], make_console())
    if folder is not None:
        typer.echo(f"Written to {folder}")


def _draw(tree: xr.DataTree, folder: Path) -> list[Path]:
    from bayesbl.library import draw

    return draw(tree, folder)


def _draw_in_place(tree: xr.DataTree, folder: Path) -> list[Path]:
    """Draw beside and move: an interrupted command leaves the figures that were there."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix=".figures.", dir=folder.parent) as beside:
        drawn = _draw(tree, Path(beside))
        folder.mkdir(exist_ok=True)
        for path in drawn:
            os.replace(path, folder / path.name)
    return [folder / path.name for path in drawn]
