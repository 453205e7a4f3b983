"""From a configuration of any kind to its output folder, and what can be said before it runs."""

from __future__ import annotations

import importlib
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

from bayesbl.config.files import require_text_names
from bayesbl.config.loading import config_from_options, files_of, load_config
from bayesbl.config.sections import RunConfig
from bayesbl.errors import ConfigError
from bayesbl.recording.input_bytes import read_input
from bayesbl.results.folder import CONFIG_FILE
from bayesbl.results.inputs import require_apart
from bayesbl.runs.workflow import Draw, Options, Plan, Workflow

if TYPE_CHECKING:
    from bayesbl.progress import StageProgress
    from bayesbl.runs.summary import Summary

WORKFLOWS: Mapping[str, str] = MappingProxyType(
    {
        "fit": "measure",
        "compare": "measure",
        "sweep": "sweep",
        "plan": "plan",
        "diagnose": "diagnose",
        "identify": "identify",
        "study": "study",
        "fleet": "fleet",
        "simulate": "simulate",
        "bench": "bench",
    }
)
"""Kind to the module of :mod:`bayesbl.runs` that runs it, imported when it is needed."""

_FILES = ("simulate", "bench")
"""Kinds without an output folder: their workflow takes the file itself."""


def load_run(path: str | Path, *, kind: str | None = None, **options: object) -> RunConfig:
    """A configuration file with the options of the command line over it; ``None`` is not given.

    Raises
    ------
    ConfigError
        As :func:`bayesbl.config.loading.load_config`.
    """
    if kind_of(path) == "bench":
        raise ConfigError(
            "A bench is simulated on, not run.",
            file=path,
            found='kind = "bench"',
            expected='a configuration that names this bench, e.g. of kind = "simulate"',
        )
    config = load_config(path, kind=kind)
    given: dict[str, Any] = {o: value for o, value in options.items() if value is not None}
    return config_from_options(config.kind, (), path, **given) if given else config


def kind_of(path: str | Path) -> str:
    """What a file says of its kind; empty where it cannot, and loading will tell why."""
    try:
        kind = tomllib.loads(read_input(Path(path)).decode("utf-8-sig")).get("kind")
    except (OSError, ValueError, RecursionError):
        return ""
    return kind if isinstance(kind, str) else ""


def run(
    config: RunConfig,
    draw: Draw,
    *,
    force: bool = False,
    progress: StageProgress | None = None,
    say: Callable[[str], None] = print,
    file: Path | None = None,
    formats: Sequence[str] = ("png",),
) -> Summary:
    """Run a configuration and write its output folder; the summary that was stored.

    Parameters
    ----------
    force
        Replace a finished result; start over where a run was left unfinished.
    say
        Called with sentences: what a study takes over or computes again, what a run goes on from,
        and what a search starts from.
    file
        Where the configuration comes from, if from a file.
    formats
        Of the figures: ``"png"``, ``"pdf"``, both or none.

    Raises
    ------
    UserError
        If the folder may not be written, or anything in the configuration cannot be used.
    """
    _require_output_apart(config, file)
    workflow = _workflow(config.kind)
    plan = Plan(file)
    workflow.describe(config, plan)
    plan.require_sound()
    for sentence in plan.withheld:
        say(sentence)
    return workflow.run(config, Options(draw, force, progress, say, formats, plan.recordings))


def check(path: str | Path) -> Plan:
    """Everything that can be checked of a configuration without running it.

    Raises
    ------
    ConfigError
        If the file itself cannot be read or is not valid; what is wrong beyond it is in the plan.
    """
    kind = kind_of(path)
    plan = Plan(path, [("kind", kind)])
    if kind in _FILES:
        _workflow(kind).describe(Path(path), plan)
        return plan
    config = load_run(path)
    plan.lines.append(("seed", str(config.run.seed)))
    plan.add("output", lambda: _require_output_apart(config, path))
    _workflow(kind).describe(config, plan)
    return plan


def _require_output_apart(config: RunConfig, file: str | Path | None) -> None:
    """The output folder is none of the inputs, nor holds one."""
    output, inputs = config.run.output, files_of(config.model_dump(exclude={"run"}))
    # The configuration that a result holds is written again as it is, so it may be run again.
    if file is not None and os.path.realpath(file) != os.path.realpath(output / CONFIG_FILE):
        inputs.append(Path(file))
    require_text_names([output, *inputs])
    require_apart([output], inputs)


def _workflow(kind: str) -> Workflow:
    return cast(Workflow, importlib.import_module(f"bayesbl.runs.{WORKFLOWS[kind]}"))
