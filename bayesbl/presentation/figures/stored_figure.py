"""Declare figures of a stored result, by what they need, and draw all that apply."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from bayesbl.declared import declared
from bayesbl.measurement.stored import Snapshot, routes_of, stored_answers
from bayesbl.presentation import figures
from bayesbl.presentation.figures.style import GAP, WITHHELD, look, publication_style, save
from bayesbl.presentation.words import interval_kind, with_bounds
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import Interval, interval


def route_holding(tree: xr.DataTree, path: str) -> str | None:
    """The route whose group holds this variable (``misfit/mean_rpm``) or group (``loop``)."""
    return next((name for name in routes_of(tree) if holds(tree.children[name], path)), None)


def holds(tree: xr.DataTree, path: str) -> bool:
    """Whether a tree has a group (``wear``), or a variable in its group (``misfit/mean_rpm``)."""
    group, _, variable = path.partition("/")
    if group not in tree.children:
        return False
    return not variable or variable in tree.children[group].variables


def snapshots(tree: xr.DataTree, holding: str | None = None) -> list[Snapshot]:
    """Answers for every recording, by the answering route or the one that holds this."""
    return stored_answers(tree, None if holding is None else route_holding(tree, holding))


def gap_colour(snapshot: Snapshot, index: int) -> str:
    """Colour of a snapshot's δ by its place; grey if withheld."""
    return WITHHELD if snapshot.withheld else look(index).colour


def credible_interval(tree: xr.DataTree, draws: FloatArray) -> Interval:
    """Median and interval of draws, with the level and kind of this result."""
    level, kind = float(tree.attrs["interval_level"]), tree.attrs["interval_kind"]
    return interval(draws, level, kind)


def gap_interval(tree: xr.DataTree, snapshot: Snapshot) -> Interval:
    """Median and interval of a snapshot's δ, in mrad."""
    return credible_interval(tree, 1e3 * snapshot.values("posterior", GAP))


def gap_in_words(tree: xr.DataTree, snapshot: Snapshot) -> str:
    """``after: 0.953 mrad (90 % interval 0.927 to 0.981)``, or that δ is withheld."""
    if snapshot.withheld:
        return f"{snapshot.name}: δ withheld"
    return f"{snapshot.name}: {with_bounds(gap_interval(tree, snapshot), 'mrad')}"


def interval_name(tree: xr.DataTree) -> str:
    """``90 % interval``."""
    return interval_kind(credible_interval(tree, np.zeros(1)))


Parts = Callable[[xr.DataTree], Iterable[tuple[str, tuple[object, ...]]]]
"""From a result to the end of each file's name and what its figure is drawn from."""


def whole(tree: xr.DataTree) -> Iterable[tuple[str, tuple[object, ...]]]:
    """One figure for the whole result."""
    yield "", (tree,)


@dataclass(frozen=True, slots=True)
class StoredFigure:
    """A figure, called like the function that draws it."""

    name: str  # of its files, or the beginning of their names
    caption: str
    order: int  # place on a page
    applies: Callable[[xr.DataTree], bool]  # by groups and variables alone
    make: Callable[..., Figure]
    parts: Parts = whole

    def __call__(self, *drawn_from: object) -> Figure:
        """The figure in the common style."""
        with publication_style():
            return self.make(*drawn_from)


def stored_figure(
    caption: str,
    order: int,
    applies: Callable[[xr.DataTree], bool],
    *,
    name: str = "",
    parts: Parts = whole,
) -> Callable[[Callable[..., Figure]], StoredFigure]:
    """Make a function a :class:`StoredFigure`, with the function's name unless another is given."""

    def declare(make: Callable[..., Figure]) -> StoredFigure:
        own = name or make.__name__
        return StoredFigure(own, caption, order, applies, make, parts)

    return declare


def holding(*paths: str) -> Callable[[xr.DataTree], bool]:
    """Condition that a result, or one of its routes, has these groups and variables."""
    return lambda tree: all(
        holds(tree, path) or route_holding(tree, path) is not None for path in paths
    )


def draw_all(tree: xr.DataTree, folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Write every figure that applies into a folder, in these ``formats``; return the files."""
    return [
        path
        for stored, ending, figure in (drawn(tree) if formats else ())
        for path in save(figure, folder, stored.name + ending, formats)
    ]


def drawn(tree: xr.DataTree) -> Iterator[tuple[StoredFigure, str, Figure]]:
    """Each figure of a result with the end of its file's name, in reading order."""
    with publication_style():
        for stored in figures_of(tree):
            for ending, drawn_from in stored.parts(tree):
                yield stored, ending, stored(*drawn_from)


def figures_of(tree: xr.DataTree) -> list[StoredFigure]:
    """The figures that apply to a result, in reading order."""
    known = sorted(declared(figures, StoredFigure), key=lambda figure: figure.order)
    return [figure for figure in known if figure.applies(tree)]
