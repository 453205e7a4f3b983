"""Run, check and summarise any kind of configuration.

Only this module knows all kinds; the module of a kind is imported when it is used.
"""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

from bayesbl.arguments import Tree, checked
from bayesbl.config.kinds import FILES, KINDS
from bayesbl.config.loading import (
    config_from_options,
    files_of,
    kind_of,
    load_config,
    require_text_names,
)
from bayesbl.config.sections import RunConfig
from bayesbl.errors import ResultError
from bayesbl.results.folder import AUGMENTED_BENCH, CONFIG_FILE, IDENTIFIED_BENCH, require_apart
from bayesbl.results.work import NOTHING_KEPT, STORE, WorkStore
from bayesbl.runs.workflow import Options, Plan, require_output, work_of, write_result
from bayesbl.sentences import with_sentences

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.diagnosis.groups import DiagnosisSummary
    from bayesbl.identification.groups import IdentificationSummary
    from bayesbl.measurement.summary_types import ComparisonSummary, FitSummary
    from bayesbl.progress import StageProgress
    from bayesbl.runs.fleet import FleetSummary
    from bayesbl.runs.plan import PlanSummary
    from bayesbl.runs.study import StudySummary
    from bayesbl.runs.sweep import SweepSummary

    Summary: TypeAlias = (
        FitSummary
        | ComparisonSummary
        | SweepSummary
        | PlanSummary
        | DiagnosisSummary
        | IdentificationSummary
        | StudySummary
        | FleetSummary
    )


_MEASURE = ("fit", "compare")
"""Kinds that share a module; every other kind has a module of its name.

Its ``describe(config, plan)`` makes all checks that come before the first expensive step; ``check``
prints the plan, ``run`` follows it. ``make(config, options, work)`` returns the result and stores
expensive steps in ``work``. Instead, ``run(config, options)`` may write an output folder that it
adds to, and return the summary.
"""


def load_run(path: str | Path, *, kind: str | None = None, **options: object) -> RunConfig:
    """A configuration file with command-line options over it; ``None`` is not given.

    Raises ConfigError as :func:`bayesbl.config.loading.load_config`.
    """
    config = load_config(path, kind=kind)
    given: dict[str, Any] = {o: value for o, value in options.items() if value is not None}
    return config_from_options(config.kind, (), path, **given) if given else config


def run(config: RunConfig, options: Options, file: Path | None = None) -> Summary:
    """Run a configuration and write its output folder; return the summary that was stored.

    Steps that an earlier run finished are reused. ``file``: the configuration's file, if it has
    one. Raises UserError if the folder may not be written, or the configuration cannot be used.
    """
    _require_output_apart(config, file)
    plan = Plan(file)
    workflow = _described(config, plan)
    if plan.problems:
        raise plan.problems[0]
    for sentence in plan.withheld:
        options.say(sentence)
    options = replace(options, recordings=plan.recordings)
    if hasattr(workflow, "run"):
        written: Summary = workflow.run(config, options)
        return written
    with work_of(config, options) as work:
        tree = workflow.make(config, options, work)
        texts = {
            AUGMENTED_BENCH: tree.attrs.get("augmented_bench", ""),
            IDENTIFIED_BENCH: tree.attrs.get("identified_bench", ""),
        }
        summary = summarise(tree)
        write_result(tree, summary, config, options, texts)
    return summary


def result_of_run(config: RunConfig, progress: StageProgress | None = None) -> xr.DataTree:
    """The result of a run without an output folder. UserError if it cannot be run.

    Nothing is kept but the simulations of a sweep.
    """
    kept = WorkStore.shared(config.run.output.parent / STORE)
    work = kept if config.kind == "sweep" else NOTHING_KEPT
    options = Options(progress=progress, say=lambda sentence: None)
    made: xr.DataTree = _workflow(config.kind).make(config, options, work)
    return made


def check(path: str | Path, progress: StageProgress | None = None) -> Plan:
    """Check everything that can be checked without running.

    Raises ConfigError if the file cannot be read or is invalid; all other problems are in the plan.
    """
    kind = kind_of(path)
    plan = Plan(path, [("kind", kind)], is_check=True, progress=progress)
    if kind in FILES.keys() - KINDS.keys():  # without an output folder: the file itself is taken
        _workflow(kind).describe(Path(path), plan)
        return plan
    config = load_run(path)
    plan.lines.append(("seed", str(config.run.seed)))
    plan.add("output", lambda: _require_output_apart(config, path))
    _described(config, plan)
    return plan


def _described(config: RunConfig, plan: Plan) -> ModuleType:
    """The workflow of a configuration, after it has described itself."""
    plan.add("output", partial(require_output, config.run.output))
    workflow = _workflow(config.kind)
    workflow.describe(config, plan)
    return workflow


def _require_output_apart(config: RunConfig, file: str | Path | None) -> None:
    """Require that the output folder is no input and contains none."""
    output, inputs = config.run.output, files_of(config.model_dump(exclude={"run"}))
    # The configuration that a result holds is written again as it is, so it may be run again.
    if file is not None and os.path.realpath(file) != os.path.realpath(output / CONFIG_FILE):
        inputs.append(Path(file))
    require_text_names([output, *inputs])
    require_apart([output], inputs)


def _workflow(kind: str) -> ModuleType:
    return import_module(f"bayesbl.runs.{'measure' if kind in _MEASURE else kind}")


@checked
def summarise(tree: Tree) -> Summary:
    """``summary.json`` of a stored result of any kind, from the result alone.

    δ and the change are ``None`` if the answer is withheld; ``reason`` says why.
    """
    from bayesbl.results.store import summary_of

    summary: Summary = with_sentences(summary_of(tree))
    return summary


def read_result(path: str | Path) -> xr.DataTree:
    """A result of any kind, in memory. ResultError also for an unknown kind."""
    from bayesbl.results.store import read_tree

    tree = read_tree(path)
    kind = tree.attrs.get("kind")
    stored = [name for name in KINDS if name != "fleet"]
    if not isinstance(kind, str) or kind not in stored:
        raise ResultError(
            "The kind of this result is unknown.",
            file=path,
            found=f"kind {kind!r}",
            expected=" or ".join(stored),
        )
    return tree
