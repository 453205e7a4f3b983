"""What every script here shares: where stored results are, and where figures go.

Run any of them from the root of the repository, for instance

    python paper_figures/figure_8.py
    python paper_figures/make_all.py --sweep results/sweep_tolerances/result.nc
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import xarray as xr
from matplotlib.figure import Figure

from bayesbl.config.bench import load_bench
from bayesbl.errors import ResultError, UserError
from bayesbl.figures.style import publication_style, save
from bayesbl.physics.bench import Bench
from bayesbl.results.store import read_tree

ROOT = Path(__file__).parents[1]

MADE_BY = {
    "sweep": "bayesbl sweep configs/sweep.toml",
    "wear": "bayesbl compare configs/recordings/wear_before.csv configs/recordings/wear_after.csv "
    "--curve results/sweep/result.nc --out results/wear",
}
"""The command, at the root of the repository, that makes each stored result."""


@dataclass
class Stored:
    """The stored results; each is read when a figure first asks for it."""

    sweep_path: Path
    wear_path: Path

    @cached_property
    def sweep(self) -> xr.DataTree:
        """The sweep of the virtual bench."""
        return _read("sweep", self.sweep_path)

    @cached_property
    def wear(self) -> xr.DataTree:
        """The comparison of the two example recordings."""
        return _read("wear", self.wear_path)

    @cached_property
    def bench(self) -> Bench:
        """The bench that was swept, from the sweep's own result."""
        text = self.sweep.attrs.get("bench")
        if text is None:
            raise ResultError(
                "This sweep was stored without its bench.",
                file=self.sweep_path,
                expected=f"a sweep made anew: {MADE_BY['sweep']} --force",
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "bench.toml"
            path.write_text(text, encoding="utf-8")
            return load_bench(path)


def _read(name: str, path: Path) -> xr.DataTree:
    kind = {"sweep": "sweep", "wear": "compare"}[name]
    if not path.exists():
        raise ResultError(
            "There is no such result.",
            file=path,
            expected=f"what this command makes: {MADE_BY[name]}",
        )
    tree = read_tree(path)
    if tree.attrs["kind"] != kind:
        raise ResultError(
            "This result is of another kind.",
            file=path,
            found=tree.attrs["kind"],
            expected=f"a {kind}, as this command makes: {MADE_BY[name]}",
        )
    return tree


def main(
    figures: Sequence[tuple[str, Callable[[Stored], Figure]]],
    arguments: Sequence[str] | None = None,
) -> int:
    """Draw figures by name and say what was written; exit status 2 if a result was missing."""
    parser = argparse.ArgumentParser(description="Figures of the paper, from stored results.")
    parser.add_argument("--sweep", type=Path, default=ROOT / "results/sweep/result.nc")
    parser.add_argument("--wear", type=Path, default=ROOT / "results/wear/result.nc")
    parser.add_argument("--out", type=Path, default=ROOT / "results/paper_figures")
    given = parser.parse_args(arguments)
    stored = Stored(given.sweep, given.wear)
    lacking: dict[str, list[str]] = {}
    for name, draw in figures:
        try:
            with publication_style():
                for path in save(draw(stored), given.out, name):
                    print(path)
        except UserError as problem:
            lacking.setdefault(str(problem), []).append(name)
    for problem, names in lacking.items():
        print(f"Not drawn: {', '.join(names)}. {problem}", file=sys.stderr)
    return 2 if lacking else 0
