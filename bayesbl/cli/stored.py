"""Commands on stored results: their figures, page and summary, and what to cite."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayesbl.cli.options import Json, ResultPath

if TYPE_CHECKING:
    import xarray as xr


def figures_command(
    result: ResultPath,
    study: Annotated[
        Path | None,
        typer.Option("--study", metavar="FILE", help="Run this study file to draw its figure."),
    ] = None,
) -> None:
    """Draw the figures of a result again, as PDF and PNG."""
    from bayesbl.library import require_study_file
    from bayesbl.presentation.terminal import say
    from bayesbl.results.folder import FIGURES
    from bayesbl.runs.kinds import read_result

    tree = read_result(result)
    require_study_file(tree, study, result)
    folder = (result if os.path.isdir(result) else result.parent) / FIGURES
    for path in _draw_in_place(tree, folder, study):
        say(str(path))


def report_command(result: ResultPath) -> None:
    """Write a result as one HTML page, report.html, that opens anywhere."""
    from bayesbl.library import draw
    from bayesbl.presentation.page.build import write_page
    from bayesbl.presentation.terminal import say

    def draw_or_say(tree: xr.DataTree, folder: Path) -> list[Path]:
        if tree.attrs["kind"] != "study":
            return draw(tree, folder)
        command = f"bayesbl figures {shlex.quote(str(result))} --study FILE"
        say(f"The page has no figure: none is stored. To draw it: {command}", err=True)
        return []

    say(str(write_page(result, draw_or_say)))


def inspect_command(result: ResultPath, json: Json = False) -> None:
    """Print what a result says."""
    from bayesbl.presentation.console import print_summary
    from bayesbl.presentation.terminal import make_console
    from bayesbl.results.store import json_text
    from bayesbl.runs.kinds import read_result, summarise

    tree = read_result(result)
    if json:
        # Not the summary.json beside it: only what is in result.nc is verified.
        typer.echo(json_text(summarise(tree)), nl=False)
    else:
        print_summary(tree, make_console())


def cite_command(
    bibtex: Annotated[bool, typer.Option("--bibtex", help="Print BibTeX, nothing else.")] = False,
) -> None:
    """Print what to cite, as text and as BibTeX."""
    from bayesbl.presentation.citations import all_bibtex, cited
    from bayesbl.presentation.terminal import say

    if not bibtex:
        for line in cited():
            say(f"{line}\n")
    say(all_bibtex())


def _draw_in_place(tree: xr.DataTree, folder: Path, study: Path | None) -> list[Path]:
    """Draw beside and move: an interrupted command leaves the figures that were there."""
    import tempfile

    from bayesbl.library import draw

    with tempfile.TemporaryDirectory(prefix=".figures.", dir=folder.parent) as beside:
        drawn = draw(tree, Path(beside), ("pdf", "png"), study)
        folder.mkdir(exist_ok=True)
        for path in drawn:
            os.replace(path, folder / path.name)
    return [folder / path.name for path in drawn]
