"""Calibration: what the intervals cover, and how ranks are distributed, from stored studies.

Not a figure of the paper, so ``make_all.py`` leaves it out. Run from the root of the repository:

    python paper_figures/calibration.py
    python paper_figures/calibration.py --results results/calibration_model --name calibration_model
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from common import ROOT
from matplotlib.figure import Figure

from bayesbl.errors import ResultError, UserError
from bayesbl.figures.calibration import draw_calibration
from bayesbl.figures.style import publication_style, save
from bayesbl.results.calibration import WORDS
from bayesbl.results.store import read_tree
from bayesbl.workflows.study import stored_rows


def draw(results: Sequence[Path]) -> Figure:
    """The rows of several studies in one figure.

    Raises
    ------
    ResultError
        If there is no such study, or two of them have a row of the same name.
    """
    lines, cases = [], {}
    for folder in results:
        if not folder.exists():
            made_by = f"bayesbl run configs/{folder.name}.toml"
            raise ResultError(
                "There is no such result.", file=folder, expected=f"made by: {made_by}"
            )
        more, their_cases = stored_rows(read_tree(folder))
        if twice := sorted(cases.keys() & their_cases.keys()):
            raise ResultError("Two studies have the same row.", file=folder, found=", ".join(twice))
        lines += more
        cases |= their_cases
    return draw_calibration(lines, cases, list(WORDS))


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw and say what was written; exit status 2 without a result."""
    parser = argparse.ArgumentParser(description="Calibration of stored studies.")
    default = [ROOT / "results/calibration_main", ROOT / "results/calibration"]
    parser.add_argument("--results", type=Path, nargs="+", default=default, metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=ROOT / "results/paper_figures")
    parser.add_argument("--name", default="calibration")
    given = parser.parse_args(arguments)
    try:
        with publication_style():
            for path in save(draw(given.results), given.out, given.name):
                print(path)
    except UserError as problem:
        print(f"Not drawn. {problem}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
