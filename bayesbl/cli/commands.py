"""Every command with its options."""

from __future__ import annotations

import inspect
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from bayesbl.errors import ConfigError, NeedsBench, UserError
from bayesbl.libraries import bare
from bayesbl.presentation.terminal import STEERING, error, make_console, print_blocks, progress, say
from bayesbl.recording import formats

if TYPE_CHECKING:
    from bayesbl.config.sections import RunConfig
    from bayesbl.runs.workflow import Plan

FAILED, WRONG, WITHHELD = 1, 2, 3  # statuses: a bug or Ctrl-C; wrong input; a withheld answer


FIGURES: ContextVar[tuple[str, ...]] = ContextVar("figures", default=("png",))
"""Formats in which a run draws its figures."""

_ANYWHERE = ("--no-figures", "--pdf")


def brought_forward(arguments: Sequence[str]) -> list[str]:
    """The arguments with global options moved in front of the command."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    ours = [text for text in arguments[:end] if text in _ANYWHERE]
    others = [text for text in arguments[:end] if text not in _ANYWHERE]
    return [*ours, *others, *arguments[end:]]


def run_file(
    config: Path, force: bool, json: bool, *, kind: str | None = None, **options: Any
) -> None:
    """Run a configuration file, of this kind or of its own, with options over it."""
    from bayesbl.config.loading import kind_of
    from bayesbl.runs.kinds import load_run

    if (kind or kind_of(config)) == "simulate":
        _simulate(config, force, json, options)
    else:
        run_config(load_run(config, kind=kind, **options), force, json, config)


def run_config(config: RunConfig, force: bool, json: bool, file: Path | None = None) -> None:
    """Run, print the answer, and exit with the status of a withheld one if it is."""
    with bare(dask=getattr(config.run, "scheduler", None) is not None):
        from bayesbl.library import draw
        from bayesbl.presentation.console import print_result
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
    """Print a summary as stored, in UTF-8 whatever the terminal's encoding."""
    from bayesbl.results.store import json_text

    text = STEERING.sub(lambda match: f"\\u{ord(match[0]):04x}", json_text(summary))
    typer.echo(text.encode(), nl=False)


def _simulate(config: Path, force: bool, json: bool, options: dict[str, Any]) -> None:
    """Make the recordings and print their files."""
    from bayesbl.runs.simulate import run_simulate

    given = {name: options.pop(name) for name in ("out", "seed", "workers")}
    unused = [name for name, value in options.items() if value is not None]
    if unused:
        raise ConfigError(
            "This option cannot be used with a simulation.",
            file=config,
            where=f"--{unused[0]}",
            found=options[unused[0]],
            expected="--out, --seed or --workers",
        )
    files = [str(file) for file in run_simulate(config, **given, force=force)]
    if json:
        import json as encoder

        files = [encoder.dumps({"kind": "simulate", "files": files})]
    for file in files:
        say(file)


_Value = TypeVar("_Value")


def _parser(read: Callable[[str], _Value], expected: str) -> Callable[[str], _Value]:
    """Parse an option's value with ``read``; its range is checked by the configuration."""

    def parse(text: str) -> _Value:
        try:
            return read(text)
        except ValueError:
            raise typer.BadParameter(f"Found: {text}. Expected: {expected}.") from None

    return parse


_DATE = _parser(date.fromisoformat, "a date, e.g. 2026-03-01")
_IN_RAD = "a number in rad, with a decimal point, e.g. 1.2e-3 for 1.2 mrad"
_TYPES: Mapping[str, tuple[Any, Callable[[str], Any] | None]] = {
    "path": (Path, None),
    "text": (str, None),
    "flag": (bool, None),
    "whole": (int, _parser(int, "a whole number")),
    "number": (float, _parser(float, "a number, with a decimal point")),
    "rad": (float, _parser(float, _IN_RAD)),
    "pair": (tuple[float, float], None),
    "date": (date, _DATE),
    "dates": (list[date], _DATE),
}
"""Type and parser."""

_OPTIONS = """
config | path | FILE | Configuration; options override it.
out | path | FOLDER | Output folder. [default: the configuration's, else results/CONFIG or
    results/COMMAND_RECORDING; simulate: beside the configuration]
seed | whole | N | Seed of all random numbers. [default: 1]
workers | whole | N | Largest number of processes; results do not depend on it. [default: all
    cores; simulate: 1]
scheduler | text | ADDRESS | Run a study or a fleet on the Dask cluster of this scheduler, e.g.
    tcp://host:8786.
force | flag | - | Replace a finished result.
json | flag | - | Print the summary as JSON, nothing else.
curve | text | published|RESULT | Gap curve: the result of a sweep, its folder or result.nc; or
    the paper's, by name. [default: swept from the bench; none without one]
bench | path | FILE|RESULT | Bench of the joint: its file, or a result of identify.
route | text | auto|amplitude|direct|torque_ramp|two_encoders | How to measure: by
    simulations of the bench (direct), by the ringing's amplitude and a curve (amplitude), by both
    (auto), by ramps of torque with the output held, or by encoders of motor and load. [default:
    auto with a bench]
start_from | path | RESULT | Earlier result of this joint, from whose optimum the search of the
    ringing starts (--route amplitude).
check_sampler | flag | - | Sample the posterior again by nested sampling, and withhold the answer
    if the two differ (--route amplitude).
limit | text | LIMIT | Repair limit as data sheets state it: "3 arcmin play", "0.5 mm play at
    0.4 m", "1 arcmin lost_motion at 3 %" (of the rated torque).
limit_rad | rad | RAD | Repair limit for the gap δ, in rad at the load (1.2e-3 = 1.2 mrad); δ
    is half the total play.
before | date | DATE | Also report the probability that the gap passes its limit before this
    date.
dates | dates | DATE | When a recording was taken; once per recording, in the same order.
gear_ratio | number | N | Motor turns per turn of the load.
upright | flag | - | Gravity does not turn the joint: its axis is vertical or its load is
    balanced.
level | number | P | Level of the credible intervals. [default: 0.9]
range_rad | pair | LOW HIGH | Load angles that a planned motion may reach, in rad; 0 hangs
    straight down. [default: -0.5 0.5]
speed_rpm | number | RPM | Largest speed of the motor. [default: 1500]
acceleration_rpm_per_s | number | RPM/S | Largest acceleration of the motor. [default: 6000]
duration_s | number | S | Length of the recording. [default: 20]
gap_rad | rad | RAD | Gap that the plan is calculated for. [default: 0.0008]
init.bench | flag | - | Write joint.toml instead, a data sheet of the joint to fill in.
init.out | path | FILE | The file to write. [default: RECORDING.toml]
init.joint | text | NAME | The joint to choose, if a file has several.
init.force | flag | - | Replace the file.
watch.out | path | FOLDER | Folder of recordings.parquet. [default: [run] output + _watched]
watch.publish | text | URL | Send each answer to a broker too: mqtts://broker/topic.
credentials | path | FILE | user, password and ca for the broker, in TOML that nobody else can
    read.
watch.once | flag | - | Stop when every recording is measured and sent.
watch.settled_s | number | S | A file is complete when it has not changed for this long.
    [default: 5]
collect.once | flag | - | Stop when nothing arrives for 5 s.
identify.bench | path | FILE | Data sheet of the joint: a bench file with tolerances (`bayesbl
    init --bench`).
identify.effects | text | catalogue|NAME,NAME | Effects that the data sheet lacks: those that
    the recordings show (catalogue), or these by name.
diagnose.bench | path | FILE|RESULT | The bench that should describe the recordings: its file,
    or a result of identify.
figures.study | path | FILE | Run this study file to draw its figure.
export.bench | path | FILE|RESULT | The bench it was measured with. [default: that of its
    configuration]
export.out | path | FOLDER | Output folder. [default: RESULT_export]
export.force | flag | - | Replace files that exist.
"""
"""Options: name (with a command if it has its own), type, unit and help. Indented lines continue
the help."""

_ROWS = _OPTIONS.strip().replace("\n    ", " ").splitlines()
OPTIONS = {name: row for name, *row in (line.split(" | ") for line in _ROWS)}


def _parameter(name: str, command: str) -> inspect.Parameter:
    of, unit, what = OPTIONS.get(f"{command}.{name}") or OPTIONS[name]
    kind, parser = _TYPES[of]
    flag = "--date" if name == "dates" else "--" + name.replace("_", "-")
    default: bool | None = False
    annotation: Any = Annotated[bool, typer.Option(flag, help=what)]
    if kind is not bool:
        option = typer.Option(flag, metavar=unit, help=what, parser=parser)
        default, annotation = None, Annotated[kind | None, option]
    only = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, only, default=default, annotation=annotation)


def _takes(options: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace a command's ``**given`` by these options."""

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        *own, _ = inspect.signature(command, eval_str=True).parameters.values()
        name = command.__name__.removesuffix("_command")
        parameters = [*own, *(_parameter(option, name) for option in options.split())]
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in parameters}
        return command

    return with_options


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration in TOML.")]
ResultPath = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Output folder of a run, or its result.nc.")
]


@_takes("out seed workers scheduler before force json")
def run_command(config: ConfigPath, **given: Any) -> None:
    """Run a configuration, whatever its kind."""
    run_file(config, **given)


def check_command(config: ConfigPath) -> None:
    """Check a configuration or a bench file without running it."""
    from bayesbl.runs.kinds import check

    with progress(make_console(stderr=True)) as tell:
        plan = check(config, tell)
    for label, text in plan.lines:
        say(f"{label}: {text}")
    _print_findings(plan)
    say("The bench can be used." if ("kind", "bench") in plan.lines else "Ready to run.")


@_takes("bench out joint force")
def init_command(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="RECORDING", help="One recording to fit, or several to compare."),
    ] = None,
    **given: Any,
) -> None:
    """Write a first configuration for recordings, or a joint's data sheet to fill in."""
    if given.pop("bench"):
        _init_bench(recordings, given["out"], given["force"])
        return
    if not recordings:
        raise ConfigError(
            "There is nothing to write a configuration for.",
            where="RECORDING",
            found="nothing",
            expected="one or more recordings; or --bench for a joint's data sheet to fill in",
        )
    from bayesbl.presentation.console import guess_blocks, what_next
    from bayesbl.runs.first_configuration import start_config
    from bayesbl.runs.kinds import check

    path, guess = start_config(recordings, **given)
    print_blocks(guess_blocks(guess), make_console())
    if guess.is_open:
        say(
            f"{recordings[0]} does not state everything that is needed. Written to {path}. "
            'It cannot run yet: fill in each "?" in it, or delete its line, then: '
            f"bayesbl check {path}",
            err=True,
        )
        raise typer.Exit(WRONG)
    with progress(make_console(stderr=True)) as tell:
        plan = check(path, tell)
    route = guess.route
    if plan.problems and all(problem.code == NeedsBench.code for problem in plan.problems):
        route, plan.problems = "motion", []
    say(what_next(path, sound=not plan.problems, route=route))
    _print_findings(plan)


def _init_bench(recordings: list[Path] | None, out: Path | None, force: bool) -> None:
    from bayesbl.runs.first_configuration import write_first_bench

    if recordings:
        raise ConfigError(
            "A data sheet needs no recordings.",
            where="--bench",
            found=", ".join(map(str, recordings)),
            expected="bayesbl init --bench, and bayesbl init RECORDING for their columns",
        )
    path = write_first_bench(out, force=force)
    say(f"Written to {path}. Fill in your numbers, then: bayesbl check {path}")


def _print_findings(plan: Plan) -> None:
    """Print warnings and problems; exit if there is a problem."""
    for warning in plan.warnings:
        say(f"warning: {warning}")
    alike: dict[str, list[UserError]] = {}
    for problem in plan.problems:
        alike.setdefault(str(problem).removeprefix(problem.file or ""), []).append(problem)
    for first, *others in alike.values():
        error(make_console(stderr=True), first)
        if others:
            say(f"The same applies to {', '.join(str(other.file) for other in others)}.", err=True)
    if plan.problems:
        raise typer.Exit(WRONG)


FORMATS = formats.names()

_RUN = "config out seed force json"
_MEASURED = (
    "curve route bench limit limit_rad gear_ratio upright level workers start_from check_sampler"
)


@_takes(f"{_RUN} {_MEASURED}")
def fit_command(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help=f"A recording: {FORMATS}.")
    ],
    **given: Any,
) -> None:
    """Measure the gap in one recording."""
    _run_options("fit", [recording], **given)


@_takes(f"{_RUN} {_MEASURED} dates before")
def compare_command(
    first: Annotated[
        Path, typer.Argument(metavar="FIRST", help=f"The oldest recording: {FORMATS}.")
    ],
    later: Annotated[
        list[Path],
        typer.Argument(metavar="SECOND", help="Later ones of the same joint, in order of date."),
    ],
    **given: Any,
) -> None:
    """Measure each gap, the change from first to last and, with dates, how fast the gap grows."""
    _run_options("compare", [first, *later], **given)


def _run_options(
    kind: str,
    recordings: Sequence[Path],
    *,
    config: Path | None,
    force: bool,
    json: bool,
    dates: Sequence[date] | None = None,
    **options: Any,
) -> None:
    """Run options over a configuration; an unset flag states nothing."""
    from bayesbl.config.loading import config_from_options

    stated = {name: None if value is False else value for name, value in options.items()}
    loaded = config_from_options(kind, recordings, config, dates or (), **stated)
    run_config(loaded, force, json, config)


_WATCHED = "_watched"


@_takes("out publish credentials once settled_s")
def watch_command(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder where recordings appear.")
    ],
    config: Annotated[Path, typer.Option(metavar="CONFIG", help="Configuration of the fleet.")],
    **given: Any,
) -> None:
    """Measure recordings as they appear, on a device at the robot."""
    with bare():
        from bayesbl.config.kinds import FleetConfig
        from bayesbl.fleet.broker import read_address, read_credentials
        from bayesbl.fleet.plant_tables import RECORDINGS_FILE
        from bayesbl.runs.kinds import load_run
        from bayesbl.runs.watch import SETTLED_S, Watched, watch

        address = None if given["publish"] is None else read_address(given["publish"])
        if address is None and given["credentials"] is not None:
            raise ConfigError(
                "Credentials are for a broker.", where="--credentials", expected="--publish URL too"
            )
        plant_config = load_run(config, kind="fleet")
        assert isinstance(plant_config, FleetConfig)
        output = plant_config.run.output
        output = given["out"] or output.with_name(output.name + _WATCHED)
        settled_s = SETTLED_S if given["settled_s"] is None else given["settled_s"]
        credentials = read_credentials(given["credentials"])
        asked = Watched(folder, output, address, credentials, given["once"], settled_s)
        _log(None if address is None else address.open_to_others)
        _log(f"Watching {folder}; each recording becomes a row of {output / RECORDINGS_FILE}.")
        with _ended_by_signals():
            watch(plant_config, asked, _log, _tell)


@_takes("credentials once")
def collect_command(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="mqtts://broker/topic; includes all topics below.")
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of recordings.parquet.")],
    **given: Any,
) -> None:
    """Collect what devices publish into one recordings.parquet."""
    from bayesbl.fleet.broker import read_address, read_credentials
    from bayesbl.runs.watch import collect

    address = read_address(url)
    _log(address.open_to_others)
    with _ended_by_signals():
        credentials = read_credentials(given["credentials"])
        collect(address, credentials, out, _log, _tell, once=given["once"])


def _log(text: str | None) -> None:
    """Print to standard error at once, for a service's journal."""
    if text is not None:
        say(text, err=True)


def _tell(row: Mapping[str, Any]) -> None:
    from bayesbl.presentation.console import recording_line

    _log(recording_line(row))


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """End cleanly, with status 0, on Ctrl-C or when a service is stopped."""
    before: Callable[..., Any] | int | None = signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )
    try:
        yield
    except KeyboardInterrupt:
        _log("Stopped; every recording with a row is safe.")
    finally:
        signal.signal(signal.SIGTERM, before)


def _command(kind: str, what: str, scheduler: str = "") -> Callable[..., None]:
    """The command that runs configurations of one kind; ``what`` is its help."""

    @_takes(f"out seed workers {scheduler} force json")
    def command(config: ConfigPath, **given: Any) -> None:
        run_file(config, kind=kind, **given)

    command.__name__, command.__doc__ = f"{kind}_command", what
    return command


simulate_command = _command("simulate", "Make recordings on a virtual bench.")
sweep_command = _command("sweep", "Simulate a bench over a range of gaps to make its gap curve.")
fleet_command = _command(
    "fleet", "Measure new recordings of many joints, and write their tables and pages.", "scheduler"
)


@_takes(
    "bench range_rad speed_rpm acceleration_rpm_per_s duration_s gap_rad out workers force json"
)
def plan_command(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration in TOML.")
    ] = None,
    **given: Any,
) -> None:
    """Rank motions within limits by how precisely they would show the gap."""
    if given["out"] is None and config is None:
        given["out"] = Path("results", "plan")
    _run_options("plan", (), config=config, **given)


def effects_command(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="An effect to show in full.")
    ] = None,
) -> None:
    """Print the catalogue of physical effects, or one entry in full."""
    from bayesbl.bench.effects import EFFECTS, effect_named
    from bayesbl.presentation.console import catalogue, entry

    print_blocks(catalogue(EFFECTS) if name is None else entry(effect_named(name)), make_console())


Inputs = Annotated[
    list[Path],
    typer.Argument(
        metavar="CONFIG | RECORDING …",
        help="A configuration, or recordings: best in both directions and at two speeds.",
    ),
]


@_takes("bench effects dates config out seed force json level workers")
def identify_command(inputs: Inputs, **given: Any) -> None:
    """Find the bench of a joint, and its gap, from its data sheet and recordings."""
    if given["effects"] not in (None, "catalogue"):
        given["effects"] = given["effects"].split(",")
    if _is_configuration(inputs):
        inputs, given["config"], given["dates"] = [], inputs[0], None
    elif given["bench"] is None and given["config"] is None:
        raise _without_bench("An identification starts from a data sheet.", "datasheet.toml")
    _run_options("identify", inputs, **given)


@_takes("bench config out seed force json level workers")
def diagnose_command(inputs: Inputs, **given: Any) -> None:
    """Find what the bench of a joint lacks, from recordings."""
    config, force, json = (given.pop(name) for name in ("config", "force", "json"))
    if _is_configuration(inputs):
        run_file(inputs[0], force, json, kind="diagnose", **given)
        return
    if given["bench"] is None and config is None:
        raise _without_bench("A diagnosis needs the bench to examine.", "bench.toml")
    from bayesbl.runs.diagnose import diagnosis_of

    loaded, guess = diagnosis_of(inputs, config, **given)
    console = make_console(stderr=True)
    for choice in guess:
        console.print(f"Guessed: {choice.told}", markup=False, highlight=False)
    run_config(loaded, force, json, config)


def _is_configuration(inputs: list[Path]) -> bool:
    return len(inputs) == 1 and inputs[0].suffix.lower() == ".toml"


def _without_bench(problem: str, example: str) -> ConfigError:
    return ConfigError(
        problem,
        where="--bench",
        found="nothing",
        expected=f"--bench {example}; `bayesbl init --bench` writes one to fill in",
    )


@_takes("study")
def figures_command(result: ResultPath, **given: Any) -> None:
    """Draw the figures of a result again, as PDF and PNG."""
    from bayesbl.library import draw, require_study_file
    from bayesbl.results.folder import FIGURES
    from bayesbl.runs.kinds import read_result

    tree = read_result(result)
    require_study_file(tree, given["study"], result)
    folder = (result if os.path.isdir(result) else result.parent) / FIGURES
    for path in draw(tree, folder, ("pdf", "png"), given["study"]):
        say(str(path))


@_takes("bench out force")
def export_command(result: ResultPath, **given: Any) -> None:
    """Write a measured joint as MuJoCo models and tables of draws."""
    from bayesbl.runs.export import export

    for path in export(result, given["bench"], given["out"], force=given["force"]):
        say(str(path))


def report_command(result: ResultPath) -> None:
    """Write a result as one HTML page, report.html, that opens anywhere."""
    from bayesbl.presentation.page.build import write_page

    say(str(write_page(result)))


@_takes("json")
def inspect_command(result: ResultPath, **given: Any) -> None:
    """Print what a result says."""
    from bayesbl.presentation.console import print_summary
    from bayesbl.runs.kinds import read_result, summarise

    tree = read_result(result)
    if given["json"]:
        # Not the summary.json beside it: only what is in result.nc is verified.
        print_json(summarise(tree))
    else:
        print_summary(tree, make_console())


def cite_command() -> None:
    """Print what to cite, as BibTeX, with what each work did."""
    from bayesbl.presentation.console import all_bibtex

    say(all_bibtex())


COMMANDS: tuple[Callable[..., None], ...] = (
    run_command,
    check_command,
    fit_command,
    compare_command,
    fleet_command,
    watch_command,
    collect_command,
    simulate_command,
    sweep_command,
    diagnose_command,
    plan_command,
    identify_command,
    effects_command,
    figures_command,
    report_command,
    inspect_command,
    export_command,
    init_command,
    cite_command,
)
"""In the order of the help."""
