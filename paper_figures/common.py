"""What every script here shares: which stored results there are, and what a figure is.

A script is a module with a :class:`PaperFigure` called ``FIGURE``: ``data`` takes arrays from
stored results and tables, ``draw`` puts them on paper, ``caption`` says what is seen with the
numbers of the very arrays. Run one or all of them from the root of the repository:

    python paper_figures/figure_8.py
    python paper_figures/make_all.py
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.errors import ResultError, UserError
from bayesbl.measurement.stored import routes_of
from bayesbl.presentation.figures.style import publication_style, save
from bayesbl.results.store import read_tree

ROOT = Path(__file__).parents[1]
TABLES = ROOT / "experiments/results"

Arrays = TypeVar("Arrays", bound=xr.Dataset | xr.DataTree)
"""What a figure shows: arrays with units, nothing else."""


@dataclass(frozen=True)
class Made:
    """How a stored result comes about: its kind, and the configurations to be run for it.

    What these need is listed before it in :data:`RESULTS`.
    """

    kind: str
    configs: tuple[str, ...]

    @property
    def told(self) -> str:
        """The commands as one types them at the root of the repository."""
        return " && ".join(f"bayesbl run {config}" for config in self.configs)


RESULTS: Mapping[str, Made] = {
    "sweep": Made("sweep", ("configs/sweep.toml",)),
    "sweep_tolerances": Made("sweep", ("configs/sweep_tolerances.toml",)),
    "wear_published": Made("compare", ("configs/wear_published.toml",)),
    "wear_swept": Made("compare", ("configs/wear_swept.toml",)),
    "wear_tolerances": Made("compare", ("configs/wear_tolerances.toml",)),
    "wear_dates": Made("compare", ("configs/simulate_wear_dates.toml", "configs/wear_dates.toml")),
}
"""The quick experiments by the name of their folder in ``results``, in an order that works."""

STUDIES: Mapping[str, str] = {
    "calibration_main": "configs/calibration_main.toml",
    "calibration": "configs/calibration.toml",
    "efficiency": "configs/efficiency.toml",
    "estimator_mismatch": "configs/estimator_mismatch.toml",
    "hidden_effects": "configs/hidden_effects.toml",
    "shared_curve": "configs/shared_curve.toml",
    "wear_detection": "configs/wear_detection.toml",
}
"""The studies whose tables are committed, with the configuration that makes each again."""


COUNTED: Mapping[str, str] = {
    "calibration_ranks": "python paper_figures/calibration.py --write-ranks "
    "experiments/results/calibration_ranks.csv",
    "hidden_effects_confusion": "python experiments/hidden_effects.py "
    "results/hidden_effects/result.nc experiments/results/hidden_effects_confusion.csv",
}
"""Tables that are counted from a study's cases: the command, once the study was run."""


@dataclass
class Stored:
    """Stored results and tables; each is read when a figure first asks for it.

    Parameters
    ----------
    results
        Folder that holds a folder for each of :data:`RESULTS`.
    tables
        Folder of the tables, ``NAME.csv``.
    """

    results: Path = ROOT / "results"
    tables: Path = TABLES
    _trees: dict[str, xr.DataTree] = field(default_factory=dict, repr=False)

    def tree(self, name: str) -> xr.DataTree:
        """A result of :data:`RESULTS`.

        Raises
        ------
        ResultError
            If it is not there or of another kind; the message holds the command that makes it.
        """
        if name not in self._trees:
            self._trees[name] = self._read(name)
        return self._trees[name]

    def table(self, *names: str) -> list[dict[str, str]]:
        """Lines of the first of some tables that is there.

        Raises
        ------
        ResultError
            If none is.
        """
        files = [f for f in map(self._file, names) if f.is_file()]
        if not files:
            made_by = COUNTED.get(names[0]) or f"bayesbl run {STUDIES[names[0]]}"
            raise ResultError(
                "There is no such table.",
                file=self._file(names[0]),
                expected=f"what this command makes: {made_by}",
            )
        with files[0].open(encoding="utf-8", newline="") as stream:
            return list(csv.DictReader(stream))

    def has_table(self, name: str) -> bool:
        """Whether a table is there."""
        return self._file(name).is_file()

    @cached_property
    def bench(self) -> Bench:
        """The bench that was swept, from the sweep's own result."""
        text = self.tree("sweep").attrs.get("bench")
        if text is None:
            raise ResultError(
                "This sweep was stored without its bench.",
                file=self.results / "sweep/result.nc",
                expected=f"a new sweep: {RESULTS['sweep'].told} --force",
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "bench.toml"
            path.write_text(text, encoding="utf-8")
            return load_bench(path)

    def _file(self, name: str) -> Path:
        return self.tables / f"{name}.csv"

    def _read(self, name: str) -> xr.DataTree:
        path, made = self.results / name / "result.nc", RESULTS[name]
        if not path.exists():
            raise ResultError(
                "There is no such result.",
                file=path,
                expected=f"what this command makes: {made.told}",
            )
        tree = read_tree(path)
        if tree.attrs["kind"] != made.kind:
            raise ResultError(
                "This result is of another kind.",
                file=path,
                found=tree.attrs["kind"],
                expected=f"a {made.kind}, as this command makes: {made.told}",
            )
        return tree


@dataclass(frozen=True)
class PaperFigure(Generic[Arrays]):
    """One figure.

    Attributes
    ----------
    name
        Of its files.
    data
        The arrays that are shown, from what is stored; they are held by ``tests``.
    draw
        From these arrays alone.
    caption
        In words, with numbers from these arrays.
    """

    name: str
    data: Callable[[Stored], Arrays]
    draw: Callable[[Arrays], Figure]
    caption: Callable[[Arrays], str]

    def write(self, stored: Stored, folder: Path) -> list[Path]:
        """Write ``name.pdf``, ``name.png`` and the caption, ``name.txt``."""
        arrays = self.data(stored)
        with publication_style():
            files = save(self.draw(arrays), folder, self.name, ("pdf", "png"))
        caption = folder / f"{self.name}.txt"
        caption.write_text(textwrap.fill(self.caption(arrays), 100) + "\n", encoding="utf-8")
        return [*files, caption]


def arrays(**variables: tuple[object, ...]) -> xr.Dataset:
    """A dataset from ``name=(dimensions, values, unit)``."""
    return xr.Dataset({n: (d, np.asarray(v), {"units": u}) for n, (d, v, u) in variables.items()})


def picked(tree: xr.DataTree, **variables: Collection[str] | None) -> xr.DataTree:
    """Some variables of some groups with all attributes; ``None`` for every variable of a group.

    Groups are at the root, or of the first route that holds them.
    """
    groups = {}
    for name, names in variables.items():
        routes = [r for r in routes_of(tree) if name in tree.children[r].children]
        group = name if name in tree.children or not routes else f"{routes[0]}/{name}"
        data = tree[group].to_dataset()
        left = [] if names is None else [n for n in data.data_vars if n not in names]
        groups[group] = data.drop_vars(left)  # labels stay, though nothing may be left to label
    kept = xr.DataTree.from_dict(groups)
    kept.attrs = dict(tree.attrs)
    return kept


def numbers(lines: Sequence[Mapping[str, str]], column: str) -> np.ndarray:
    """A column of a table as numbers, NaN where it is empty, shape (lines,)."""
    return np.array([float(line[column]) if line[column] else np.nan for line in lines])


def options(description: str) -> argparse.ArgumentParser:
    """Where to read, where to write."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--results", type=Path, default=ROOT / "results")
    parser.add_argument("--tables", type=Path, default=TABLES)
    parser.add_argument("--out", type=Path, default=ROOT / "results/paper_figures")
    return parser


def write_all(figures: Sequence[PaperFigure[Any]], stored: Stored, folder: Path) -> int:
    """Write figures and say which files; exit status 2 if something they need is missing."""
    lacking: dict[str, list[str]] = {}
    for figure in figures:
        try:
            for path in figure.write(stored, folder):
                print(path)
        except UserError as problem:
            lacking.setdefault(str(problem), []).append(figure.name)
    for reason, names in lacking.items():
        print(f"Not drawn: {', '.join(names)}. {reason}", file=sys.stderr)
    return 2 if lacking else 0


def main(*figures: PaperFigure[Any], arguments: Sequence[str] | None = None) -> int:
    """Draw from what is stored already."""
    given = options("Figures from stored results.").parse_args(arguments)
    return write_all(figures, Stored(given.results, given.tables), given.out)
