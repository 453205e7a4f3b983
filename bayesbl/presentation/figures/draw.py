"""All figures of a stored result, from its tree alone."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import xarray as xr

from bayesbl.declared import declared
from bayesbl.errors import ResultError
from bayesbl.presentation import figures
from bayesbl.presentation.figures.stored_figure import StoredFigure, file_ending
from bayesbl.presentation.figures.style import publication_style, save


def draw_all(
    tree: xr.DataTree,
    folder: Path,
    formats: Sequence[str] = ("png",),
    *,
    for_specialists: bool = True,
) -> list[Path]:
    """Write every figure that applies to a result.

    Parameters
    ----------
    tree
        As :func:`bayesbl.results.store.read_tree` gives it.
    folder
        Is made if there is a figure and it is missing.
    formats
        As of :func:`bayesbl.presentation.figures.style.save`.
    for_specialists
        Whether those that nobody needs who only acts on the answer are among them.

    Returns
    -------
    The files written.

    Raises
    ------
    ResultError
        If there is no figure for such a result.
    """
    found = figures_of(tree)
    if not found:
        raise ResultError(
            "There are no figures for a result of this kind.",
            found=tree.attrs.get("kind"),
            expected="a fit, a comparison, a sweep or a diagnosis",
        )
    written: list[Path] = []
    if not formats:
        return written
    with publication_style(), _collecting_the_new_alone():
        for figure in found:
            if figure.for_specialists and not for_specialists:
                continue
            for ending, drawn_from in figure.parts(tree):
                written += save(figure(*drawn_from), folder, figure.name + ending, formats)
                # A figure holds itself in circles, and up to 15 MB: freed before the next one.
                gc.collect()
                gc.freeze()
    return written


@contextmanager
def _collecting_the_new_alone() -> Iterator[None]:
    """Collections do not look through what was there before: most of the time that they take."""
    frozen_for_good = gc.get_freeze_count() > 0  # what a command imported
    gc.freeze()
    try:
        yield
    finally:
        if not frozen_for_good:
            gc.unfreeze()


def figures_of(tree: xr.DataTree) -> list[StoredFigure]:
    """The figures that apply to a result, in reading order."""
    known = sorted(declared(figures, StoredFigure), key=lambda figure: figure.order)
    return [figure for figure in known if figure.applies(tree)]


def reading_order(
    stems: Iterable[str], known: Sequence[StoredFigure], snapshots: Sequence[str]
) -> list[str]:
    """Stems of figure files in the order of the figures, then snapshot by snapshot."""
    endings = [file_ending(snapshot) for snapshot in snapshots]

    def place(stem: str) -> tuple[int, int, str]:
        figure = figure_of(stem, known)
        if figure is None:
            return len(known), 0, stem
        ending = stem.removeprefix(figure.name)
        at = endings.index(ending) if ending in endings else len(endings)
        return list(known).index(figure), at, stem

    return sorted(stems, key=place)


def caption(stem: str, known: Sequence[StoredFigure]) -> str:
    """The caption of a figure file; of an unknown figure its name in words."""
    figure = figure_of(stem, known)
    if figure is None:
        return stem.replace("_", " ").capitalize() + "."
    ending = stem.removeprefix(figure.name).strip("_").replace("_", " ")
    text = figure.caption
    return f"{ending}: {text[0].lower()}{text[1:]}" if ending else text


def figure_of(stem: str, known: Sequence[StoredFigure]) -> StoredFigure | None:
    """The figure that a file of this name shows; ``None`` if it is none of these."""
    return next((f for f in known if stem == f.name or stem.startswith(f"{f.name}_")), None)
