"""All figures of a stored result, from its tree alone."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import xarray as xr
from matplotlib.figure import Figure

from bayesbl.errors import ResultError
from bayesbl.presentation.figures import named_effects, recorded_and_predicted, residuals_by_angle
from bayesbl.presentation.figures.bench_draws import bench_draws
from bayesbl.presentation.figures.convergence import convergence
from bayesbl.presentation.figures.corner import corner
from bayesbl.presentation.figures.curve import curve
from bayesbl.presentation.figures.degrees import degrees
from bayesbl.presentation.figures.direct_gap import direct_change, direct_gap
from bayesbl.presentation.figures.disturbance import disturbance
from bayesbl.presentation.figures.gap import gap
from bayesbl.presentation.figures.misfit import misfit
from bayesbl.presentation.figures.noise import noise
from bayesbl.presentation.figures.overlay import overlay
from bayesbl.presentation.figures.signal import signal
from bayesbl.presentation.figures.snapshots import snapshots
from bayesbl.presentation.figures.style import publication_style, save
from bayesbl.presentation.figures.trace import trace
from bayesbl.presentation.figures.wear import wear


@publication_style()
def draw_all(tree: xr.DataTree, folder: Path) -> list[Path]:
    """Write every figure as PDF and PNG.

    Parameters
    ----------
    tree
        A fit, a comparison, a sweep or a diagnosis, as
        :func:`bayesbl.results.store.read_tree` gives it.
    folder
        Is made if it is missing.

    Returns
    -------
    The files written.

    Raises
    ------
    ResultError
        If the result is of another kind.
    """
    kind = tree.attrs["kind"]
    if kind not in _FIGURES:
        raise ResultError(
            "There are no figures for a result of this kind.",
            found=kind,
            expected="a fit, a comparison, a sweep or a diagnosis",
        )
    draw = _direct_figures if tree.attrs.get("route") == "direct" else _FIGURES[kind]
    written: list[Path] = []
    for name, figure in draw(tree):
        written += save(figure, folder, name)
        del figure
        # A figure holds itself in circles, and up to 15 MB: freed before the next one is made.
        gc.collect()
    return written


def _diagnosis_figures(tree: xr.DataTree) -> Iterator[tuple[str, Figure]]:
    for module in (recorded_and_predicted, residuals_by_angle, named_effects):
        if module.can_be_drawn(tree):
            yield from module.figures(tree)


def _sweep_figures(tree: xr.DataTree) -> Iterator[tuple[str, Figure]]:
    for draw in (curve, disturbance, degrees):
        yield draw.__name__, draw(tree)
    if "bench_draws" in tree.children:
        yield bench_draws.__name__, bench_draws(tree)


def _direct_figures(tree: xr.DataTree) -> Iterator[tuple[str, Figure]]:
    yield "signal", overlay(tree)
    yield "gap", direct_gap(tree)
    if "change" in tree.children:
        yield "change", direct_change(tree)
    if "wear" in tree.children:
        yield wear.__name__, wear(tree)


def _snapshot_figures(tree: xr.DataTree) -> Iterator[tuple[str, Figure]]:
    """File name and figure, made one at a time: a corner holds megabytes while it is open."""
    for draw in (signal, gap, misfit, noise, convergence):
        yield draw.__name__, draw(tree)
    if "wear" in tree.children:
        yield wear.__name__, wear(tree)
    alone = tree.attrs["kind"] != "compare"
    for draw_one in (corner, trace):
        for snapshot in snapshots(tree):
            of_which = "" if alone else "_" + snapshot.name.replace(" ", "_")
            yield draw_one.__name__ + of_which, draw_one(snapshot)


_FIGURES = {
    "fit": _snapshot_figures,
    "compare": _snapshot_figures,
    "sweep": _sweep_figures,
    "diagnose": _diagnosis_figures,
}
"""Kind of a result to what draws its figures, one at a time."""
