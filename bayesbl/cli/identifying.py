"""The command that finds a joint's own bench from its data sheet and recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayesbl.cli import options
from bayesbl.cli.running import run_config
from bayesbl.errors import ConfigError

DataSheet = Annotated[
    Path | None,
    typer.Option(
        "--bench",
        metavar="FILE",
        help="Data sheet of the joint: a bench file with tolerances (`bayesbl init --bench`).",
    ),
]

Effects = Annotated[
    str | None,
    typer.Option(
        "--effects",
        metavar="catalogue|NAME,NAME",
        help="Effects that the data sheet lacks: found where recordings show any, or free by name.",
    ),
]


def identify_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="CONFIG | RECORDING …",
            help="A configuration, or recordings: best in both directions and at two speeds.",
        ),
    ],
    bench: DataSheet = None,
    effects: Effects = None,
    dates: options.Dates = None,
    config: options.BaseConfig = None,
    out: options.Out = None,
    seed: options.Seed = None,
    force: options.Force = False,
    json: options.Json = False,
    level: options.Level = None,
    workers: options.Workers = None,
) -> None:
    """Find the bench of a joint from its data sheet and recordings, with the gap."""
    from bayesbl.config.loading import config_from_options

    given: dict[str, Any] = {"out": out, "seed": seed, "workers": workers}
    if effects is not None:
        given["effects"] = effects if effects == "catalogue" else effects.split(",")
    if len(inputs) == 1 and inputs[0].suffix.lower() == ".toml":
        given |= {"bench": bench, "level": level}
        loaded = config_from_options("identify", (), inputs[0], **given)
        run_config(loaded, force, json, inputs[0])
        return
    if bench is None and config is None:
        raise ConfigError(
            "An identification starts from a data sheet.",
            where="--bench",
            found="nothing",
            expected="--bench datasheet.toml; `bayesbl init --bench` writes one to fill in",
        )
    given |= {"bench": bench, "level": level}
    loaded = config_from_options("identify", inputs, config, dates or (), **given)
    run_config(loaded, force, json, config)
