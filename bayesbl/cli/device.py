"""Commands for a device at each robot, and for the machine that collects what they answer."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.errors import ConfigError

_WATCHED = "_watched"

Credentials = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="user, password and ca for the broker, in TOML that nobody else can read.",
    ),
]


def watch_command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Where recordings appear, named by the pattern."),
    ],
    config: Annotated[Path, typer.Option(metavar="CONFIG", help="Configuration of the fleet.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Of recordings.parquet. [default: [run] output + _watched]"
        ),
    ] = None,
    publish: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Send each answer to a broker too: mqtts://broker/topic."),
    ] = None,
    credentials: Credentials = None,
    once: Annotated[
        bool, typer.Option("--once", help="End when all that is there is measured and sent.")
    ] = False,
    settled_s: Annotated[
        float,
        typer.Option(
            metavar="S", min=0.0, help="A file is complete when it has not changed for so long."
        ),
    ] = 5.0,
    keep_latest: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, help="Delete measured recordings, but for each joint's latest N."
        ),
    ] = None,
    mean_rotation: Annotated[
        bool,
        typer.Option(
            "--mean-rotation", help="Send the mean rotation of each recording with its noise too."
        ),
    ] = False,
) -> None:
    """Measure recordings as they appear, on a device at the robot."""
    from bayesbl.libraries import bare

    with bare():
        from bayesbl.config.fleet import FleetConfig
        from bayesbl.fleet.broker import read_address, read_credentials
        from bayesbl.fleet.plant_tables import RECORDINGS_FILE
        from bayesbl.runs.kinds import load_run
        from bayesbl.runs.watch import Watched, watch

        address = None if publish is None else read_address(publish)
        if address is None and credentials is not None:
            raise ConfigError(
                "Credentials are for a broker.", where="--credentials", expected="--publish URL too"
            )
        if address is None and mean_rotation:
            raise ConfigError(
                "Mean rotations are sent to a broker.",
                where="--mean-rotation",
                expected="--publish URL too",
            )
        found = load_run(config, kind="fleet")
        assert isinstance(found, FleetConfig)
        output = found.run.output
        asked = Watched(
            folder,
            out or output.with_name(output.name + _WATCHED),
            address,
            read_credentials(credentials),
            once,
            settled_s,
            keep_latest,
            mean_rotation,
        )
        _log(None if address is None else address.open_to_others)
        table = asked.output / RECORDINGS_FILE
        _log(f"Watching {folder}; each recording becomes a row of {table}.")
        with _ended_by_signals():
            watch(found, asked, _log, _tell)


def collect_command(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="mqtts://broker/topic; those below it count too.")
    ],
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Of recordings.parquet.")],
    credentials: Credentials = None,
    once: Annotated[
        bool, typer.Option("--once", help="End when nothing more comes for 5 s.")
    ] = False,
) -> None:
    """Collect what devices publish into one recordings.parquet."""
    from bayesbl.fleet.broker import read_address, read_credentials
    from bayesbl.runs.collect import collect

    address = read_address(url)
    _log(address.open_to_others)
    with _ended_by_signals():
        collect(address, read_credentials(credentials), out, _log, _tell, once=once)


def _log(text: str | None) -> None:
    """On standard error, at once: a service's journal shows it as it happens."""
    from bayesbl.presentation.terminal import say

    if text is not None:
        say(text, err=True)


def _tell(row: Mapping[str, Any]) -> None:
    from bayesbl.presentation.recording_line import recording_line

    _log(recording_line(row))


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Ctrl-C and the end of a service are how these commands end: cleanly, with status 0."""
    before: Callable[..., Any] | int | None = signal.signal(
        signal.SIGTERM, signal.default_int_handler
    )
    try:
        yield
    except KeyboardInterrupt:
        _log("Stopped; what has a row is safe.")
    finally:
        signal.signal(signal.SIGTERM, before)
