"""Run, check and summarise any kind of configuration; what all kinds of runs share.

Only this module knows all kinds; the module of a kind is imported when it is used.
"""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

from bayesbl.arguments import Tree, checked
from bayesbl.config.kinds import FILES, KINDS
from bayesbl.config.loading import (
    config_from_options,
    dump_config,
    files_of,
    load_config,
    require_text_names,
)
from bayesbl.config.sections import RESULT_FILE, RunConfig
from bayesbl.errors import ConfigError, ResultError, UserError
from bayesbl.recording.input_bytes import read_input
from bayesbl.results.folder import (
    AUGMENTED_BENCH,
    CONFIG_FILE,
    FIGURES,
    IDENTIFIED_BENCH,
    SUMMARY_FILE,
    is_finished,
    locked_sibling,
    new_result,
    require_apart,
    require_free,
    require_no_file,
    unwritable,
)
from bayesbl.results.work import LARGEST_STORE_BYTES, NOTHING_KEPT, STORE, WorkStore
from bayesbl.sentences import with_sentences

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.diagnosis.groups import DiagnosisSummary
    from bayesbl.identification.groups import IdentificationSummary
    from bayesbl.measurement.summary_types import ComparisonSummary, FitSummary
    from bayesbl.progress import StageProgress
    from bayesbl.recording.types import Recording
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

Draw = Callable[["xr.DataTree", Path, Sequence[str]], object]
"""Draws the figures of a result into a folder, in these formats (png, pdf)."""

RUNNING = ".running"  # suffix of the hidden folder whose lock a run holds
LONGEST_S = 7 * 24 * 3600.0  # longest duration of a run


@dataclass(frozen=True, slots=True)
class Options:
    """How to run, for any kind."""

    draw: Draw = lambda tree, folder, formats: None
    force: bool = False  # replace a finished result
    progress: StageProgress | None = None
    say: Callable[[str], None] = print  # prints sentences for the user
    formats: Sequence[str] = ("png",)  # of figures
    recordings: Sequence[Recording] = ()  # of a measurement, as they were read to be described


@dataclass(slots=True)
class Plan:
    """What a configuration would do (label and text), and what speaks against it."""

    file: str | Path | None = None  # named by problems that name no other
    lines: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    withheld: list[str] = field(default_factory=list)  # why answers would be withheld
    problems: list[UserError] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)  # so that a run need not read them
    is_check: bool = False  # whether no run follows
    progress: StageProgress | None = None  # of a check

    def add(self, label: str, text: Callable[[], str | None]) -> None:
        """Add a line, unless it is ``None``, or the problem met while making it."""
        try:
            line = text()
        except UserError as problem:
            if self.file is not None:
                problem.name_file(self.file)
            self.problems.append(problem)
        else:
            if line is not None:
                self.lines.append((label, line))


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


def kind_of(path: str | Path) -> str:
    """The kind that a file states; empty if it cannot be read, which loading then reports."""
    try:
        kind = tomllib.loads(read_input(Path(path)).decode("utf-8-sig")).get("kind")
    except (OSError, ValueError, RecursionError):
        return ""
    return kind if isinstance(kind, str) else ""


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


@contextmanager
def work_of(config: RunConfig, options: Options) -> Iterator[WorkStore]:
    """The finished steps of this and earlier runs, and the output folder for this run alone.

    Raises ResultError if the output folder holds a result to keep, or may not be written, or
    another run is writing it.
    """
    output = config.run.output
    with locked_sibling(output, RUNNING):
        require_free(output, force=options.force)
        work = WorkStore.shared(output.parent / STORE)
        if work.folder is None:
            options.say(f"Others may write to {output.parent / STORE}, so no step is kept.")
        yield work
        work.keep_latest(size_bytes=LARGEST_STORE_BYTES)


def require_output(folder: Path) -> str:
    """Require that a result can be written into this folder, perhaps in place of another.

    Raises ResultError if something else is there, or no folder can be made.
    """
    require_free(folder, force=True)
    require_writable(folder.absolute().parent)
    return f"{folder} (holds a finished result)" if is_finished(folder) else str(folder)


def require_writable(folder: Path) -> None:
    """Require that a folder can be made here, or in the nearest existing folder above."""
    require_no_file(folder)
    existing = next(place for place in (folder, *folder.parents) if os.path.isdir(place))
    try:
        # Asked by doing: permissions do not tell of a file system that is full or of another kind.
        os.rmdir(tempfile.mkdtemp(prefix=".bayesbl-", dir=existing))
    except OSError as error:
        raise unwritable(folder, error) from None


def require_affordable(what: str, expected: str, memory_bytes: float, seconds: float) -> None:
    """Require that a run fits into memory and ends; the ConfigError has both estimates."""
    largest = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    if memory_bytes <= largest and seconds <= LONGEST_S:
        return
    raise ConfigError(
        f"{what} would take more memory or time than is allowed.",
        found=f"about {memory_bytes / 1e9:.2g} GB of memory and {seconds / 3600.0:.2g} hours",
        expected=f"at most {largest / 1e9:.3g} GB and {LONGEST_S / 3600.0:g} hours: {expected}",
    )


def settings_of(config: RunConfig) -> dict[str, Any]:
    """The tables of a configuration without those that change no number."""
    return config.model_dump(
        by_alias=True, exclude_none=True, exclude={"run": {"workers", "output"}}
    )


def write_result(
    tree: xr.DataTree,
    summary: Mapping[str, Any],
    config: RunConfig,
    options: Options,
    texts: Mapping[str, str],
) -> None:
    """Write the output folder of a result, whole or not at all.

    If drawing fails, the result is stored with the figures drawn so far, because these can be drawn
    again, and the failure is raised afterwards with a note. ``texts``: further files by name,
    unless empty.
    """
    from bayesbl.results.store import write_json, write_text, write_tree

    failure: Exception | None = None
    with new_result(config.run.output, force=options.force) as folder:
        write_tree(tree, folder / RESULT_FILE)
        write_json(summary, folder / SUMMARY_FILE)
        for name, text in {CONFIG_FILE: dump_config(config), **texts}.items():
            if text:
                write_text(text, folder / name)
        try:
            if options.formats:
                options.draw(tree, folder / FIGURES, options.formats)
        except Exception as error:
            failure = error
    if failure is not None:
        failure.add_note(
            f"The result is stored in {config.run.output}; only figures are missing. To draw them "
            f"again: bayesbl figures {config.run.output}"
        )
        raise failure
