"""What all kinds of runs share: options, finished work, and the output folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.config.loading import dump_config
from bayesbl.config.sections import RESULT_FILE
from bayesbl.errors import ConfigError, UserError
from bayesbl.results.folder import (
    CONFIG_FILE,
    FIGURES,
    SUMMARY_FILE,
    is_finished,
    locked_sibling,
    new_result,
    require_free,
    require_no_file,
    unwritable,
)
from bayesbl.results.work import LARGEST_STORE_BYTES, STORE, WorkStore

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.config.sections import RunConfig
    from bayesbl.progress import StageProgress
    from bayesbl.recording.types import Recording

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
