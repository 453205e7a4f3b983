"""What every kind of run shares: its options, its finished work, and the folder it writes."""

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
from bayesbl.results.atomic import unwritable
from bayesbl.results.folder import (
    CONFIG_FILE,
    FIGURES,
    SUMMARY_FILE,
    is_finished,
    new_result,
    require_free,
    require_no_file,
)
from bayesbl.results.work import WorkStore

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.config.sections import RunConfig
    from bayesbl.progress import StageProgress
    from bayesbl.recording.types import Recording

Draw = Callable[["xr.DataTree", Path, Sequence[str]], object]
"""Draws the figures of a result into a folder in the formats given, png and pdf.

Passed in, as figures are made from results.
"""

LONGEST_S = 7 * 24 * 3600.0
"""Of a run."""


@dataclass(frozen=True, slots=True)
class Options:
    """How a run is to be made, whatever its kind.

    ``force``: replace a finished result; start over where a run was left unfinished. ``say``:
    called with sentences for the user. ``recordings``: of a fit or a comparison, as they were read
    to be described.
    """

    draw: Draw = lambda tree, folder, formats: None
    force: bool = False
    progress: StageProgress | None = None
    say: Callable[[str], None] = print
    formats: Sequence[str] = ("png",)
    recordings: Sequence[Recording] = ()


@dataclass(slots=True)
class Plan:
    """What a configuration would do, in pairs of label and text, and what speaks against it.

    ``is_check``: a user asks, and no run follows. ``withheld``: why an answer would be withheld,
    where that is known beforehand. ``file`` is named by problems that name no other.
    ``recordings``: what was read, so that a run need not.
    """

    file: str | Path | None = None
    lines: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    withheld: list[str] = field(default_factory=list)
    problems: list[UserError] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)
    is_check: bool = False

    def add(self, label: str, text: Callable[[], str | None]) -> None:
        """A line, or the problem that making it met; no line for ``None``."""
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
    """The finished work of an unfinished run of a configuration.

    Raises ResultError if the output folder holds a finished result that is not given up, or may not
    be written.
    """
    output = config.run.output
    # A run may have been killed when its result was there, and its work not yet forgotten.
    with WorkStore.beside(output, fresh=options.force or is_finished(output)) as work:
        require_free(output, force=options.force)
        yield work


def require_output(folder: Path) -> str:
    """A result can be written into this folder; one that is there already is no fault of it.

    Raises ResultError if something else is there, or no folder can be made where it would be.
    """
    require_free(folder, force=True)
    require_writable(folder.absolute().parent)
    return f"{folder} (holds a finished result)" if is_finished(folder) else str(folder)


def require_writable(folder: Path) -> None:
    """A folder can be made here, or in the nearest folder above that exists.

    Raises ResultError if not.
    """
    require_no_file(folder)
    existing = next(place for place in (folder, *folder.parents) if os.path.isdir(place))
    try:
        # Asked by doing: permissions do not tell of a file system that is full or of another kind.
        os.rmdir(tempfile.mkdtemp(prefix=".bayesbl-", dir=existing))
    except OSError as error:
        raise unwritable(folder, error) from None


def require_affordable(what: str, expected: str, memory_bytes: float, seconds: float) -> None:
    """A run fits into the memory of this machine, and ends.

    Raises ConfigError with both estimates.
    """
    largest = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    if memory_bytes <= largest and seconds <= LONGEST_S:
        return
    raise ConfigError(
        f"{what} would take more memory or time than is allowed.",
        found=f"about {memory_bytes / 1e9:.2g} GB of memory and {seconds / 3600.0:.2g} hours",
        expected=f"at most {largest / 1e9:.3g} GB and {LONGEST_S / 3600.0:g} hours: {expected}",
    )


def settings_of(config: RunConfig) -> dict[str, Any]:
    """The tables of a configuration, without what changes no number."""
    return config.model_dump(
        by_alias=True, exclude_none=True, exclude={"run": {"workers", "output"}}
    )


def write_result(
    tree: xr.DataTree,
    summary: Mapping[str, Any],
    config: RunConfig,
    options: Options,
    texts: Mapping[str, str],
    work: WorkStore,
) -> None:
    """The output folder of a result, whole or not at all; finished work is then forgotten.

    Figures can be made again at once, what was computed cannot: where drawing fails, the result is
    stored with the figures drawn so far, and the failure raised only then, with a note that says
    so.

    ``texts``: further files by name; empty ones are not written.
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
    work.clear()
    if failure is not None:
        failure.add_note(
            f"The result is stored in {config.run.output}; only figures are missing. To draw them "
            f"again: bayesbl figures {config.run.output}"
        )
        raise failure
