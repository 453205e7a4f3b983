"""Detection curves of wear, from the table that ``experiments/wear_detection.py`` makes.

Not a figure of the paper, so ``make_all.py`` leaves it out. Run from the root of the repository:

    python paper_figures/wear_detection.py
    python paper_figures/wear_detection.py --table results/wear_detection/table.csv
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from common import ROOT
from matplotlib.figure import Figure

from bayesbl.figures.style import publication_style, save
from bayesbl.workflows.study_file import load_study


def draw(table: Path) -> Figure:
    """As ``bayesbl figures results/wear_detection`` draws it."""
    with table.open(encoding="utf-8", newline="") as stream:
        lines = list(csv.DictReader(stream))
    figure = load_study(ROOT / "experiments/wear_detection.py").figure
    assert figure is not None
    return figure(lines, {})


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw and say what was written; exit status 2 without a table."""
    parser = argparse.ArgumentParser(description="Detection curves of wear.")
    default = ROOT / "experiments/results/wear_detection.csv"
    parser.add_argument("--table", type=Path, default=default)
    parser.add_argument("--out", type=Path, default=ROOT / "results/paper_figures")
    given = parser.parse_args(arguments)
    if not given.table.is_file():
        made_by = "bayesbl run configs/wear_detection.toml"
        print(f"{given.table}: there is no such table. Made by: {made_by}", file=sys.stderr)
        return 2
    with publication_style():
        for path in save(draw(given.table), given.out, "wear_detection"):
            print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
