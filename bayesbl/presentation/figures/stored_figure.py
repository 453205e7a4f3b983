"""A figure of stored results: what it needs, what it shows, where it comes among the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import xarray as xr
from matplotlib.figure import Figure

from bayesbl.presentation.figures.snapshots import holds, route_holding, snapshots
from bayesbl.presentation.figures.style import publication_style

Parts = Callable[[xr.DataTree], Iterable[tuple[str, tuple[object, ...]]]]
"""From a result to the ending of each file's name and what its figure is drawn from."""


def whole(tree: xr.DataTree) -> Iterable[tuple[str, tuple[object, ...]]]:
    """One figure of the whole result."""
    yield "", (tree,)


def each_snapshot(path: str) -> Parts:
    """One figure per snapshot of the route that holds this; that of a fit has no own name."""

    def parts(tree: xr.DataTree) -> Iterable[tuple[str, tuple[object, ...]]]:
        compared = tree.attrs["kind"] == "compare"
        for snapshot in snapshots(tree, path):
            yield file_ending(snapshot.name) if compared else "", (snapshot,)

    return parts


def file_ending(name: str) -> str:
    """``_wear_before``: the end of the file name of a figure of one recording."""
    return "_" + name.replace(" ", "_")


@dataclass(frozen=True, slots=True)
class StoredFigure:
    """A figure, called like the function that draws it.

    Attributes
    ----------
    name
        Of its files, or the beginning of their names.
    caption
        A sentence.
    order
        Its place among the figures of a page, smallest first.
    applies
        Whether a result holds what it shows, by groups and variables alone.
    for_specialists
        Whether it shows how an answer came about, which nobody needs who only acts on it.
    """

    name: str
    caption: str
    order: int
    applies: Callable[[xr.DataTree], bool]
    make: Callable[..., Figure]
    parts: Parts = whole
    for_specialists: bool = False

    def __call__(self, *drawn_from: object) -> Figure:
        """The figure in the style of all, from what ``parts`` gives."""
        with publication_style():
            return self.make(*drawn_from)


def stored_figure(
    caption: str,
    order: int,
    applies: Callable[[xr.DataTree], bool],
    *,
    name: str = "",
    parts: Parts = whole,
    for_specialists: bool = False,
) -> Callable[[Callable[..., Figure]], StoredFigure]:
    """Make a function a :class:`StoredFigure`, of the function's name unless another is given."""

    def declare(make: Callable[..., Figure]) -> StoredFigure:
        own = name or make.__name__
        return StoredFigure(own, caption, order, applies, make, parts, for_specialists)

    return declare


def holding(*paths: str) -> Callable[[xr.DataTree], bool]:
    """Whether a result has groups (``wear``) and variables (``misfit/mean_rpm``).

    At its root, or in one of its routes.
    """
    return lambda tree: all(
        holds(tree, path) or route_holding(tree, path) is not None for path in paths
    )
