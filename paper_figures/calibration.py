"""Calibration: what the intervals cover, and how ranks are distributed.

Drawn from the tables of the studies, and from the counts of ranks that

    python paper_figures/calibration.py --write-ranks experiments/results/calibration_ranks.csv

takes from the results of studies that were run here.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from common import ROOT, PaperFigure, Stored, arrays, main
from matplotlib.figure import Figure

sys.path.append(str(ROOT / "experiments"))

from calibration_figure import draw_calibration
from calibration_statistics import FALSE_ALARM, LEVELS, POINTS
from calibration_table import WORDS

from bayesbl.results.store import read_tree
from bayesbl.runs.study import stored_rows

STUDIES = ("calibration_main", "calibration")
RANKS = "calibration_ranks"


def data(stored: Stored) -> xr.Dataset:
    """Coverage at each level, and how many ranks lie in each hundredth, by row and quantity."""
    studies = [study for study in STUDIES if stored.has_table(study)] or STUDIES[:1]
    lines = [line for study in studies for line in stored.table(study)]
    counted = {
        (line["row"], line["quantity"]): np.array(line["counts"].split(), dtype=float)
        for line in stored.table(RANKS)
    }
    asked = [n for n in WORDS if any(line.get(f"{n}_holds") for line in lines)]
    coverage = [
        [[float(line.get(f"{n}_{p:.0%}") or "nan") for p in LEVELS] for n in asked]
        for line in lines
    ]
    uniform = [[float(line.get(f"{n}_uniform_p") or "nan") for n in asked] for line in lines]
    none = np.full(POINTS, np.nan)
    counts = [[counted.get((line["name"], n), none) for n in asked] for line in lines]
    return arrays(
        coverage=(("row", "quantity", "level"), coverage, "1"),
        uniform_p=(("row", "quantity"), uniform, "1"),
        counts=(("row", "quantity", "hundredth"), counts, "1"),
        cases=("row", [int(line["cases"]) - int(line["failed"]) for line in lines], "1"),
    ).assign_coords(row=[line["name"] for line in lines], quantity=asked, level=list(LEVELS))


def draw(shown: xr.Dataset) -> Figure:
    """As ``bayesbl figures`` draws a study, which asks ranks for nothing finer than hundredths."""
    table, cases = [], {}
    for row in shown["row"].values:
        part, ranks = shown.sel(row=row), {}
        line: dict[str, object] = {"name": row, "cases": int(part["cases"]), "failed": 0}
        for name in map(str, shown["quantity"].values):
            one = part.sel(quantity=name)
            if np.isnan(one["coverage"]).any():
                continue
            line |= {f"{name}_{p:.0%}": float(one["coverage"].sel(level=p)) for p in LEVELS}
            line[f"{name}_holds"] = "yes"
            if np.isfinite(one["uniform_p"]) and np.isfinite(one["counts"]).all():
                line[f"{name}_uniform_p"] = float(one["uniform_p"])
                middles = (np.arange(POINTS) + 0.5) / POINTS
                drawn = np.repeat(middles, one["counts"].values.astype(int))
                ranks[f"{name}_rank"] = ("case", drawn)
        table.append(line)
        cases[str(row)] = xr.Dataset(ranks)
    return draw_calibration(table, cases, list(WORDS))


def caption(shown: xr.Dataset) -> str:
    """What is seen, with how many rows are outside."""
    p = shown["uniform_p"].values
    asked = np.isfinite(p)
    covered = shown["coverage"].sel(level=0.9).values
    return (
        "Calibration on simulated recordings, truths drawn from the prior where no gap is given. "
        "Above, coverage of the intervals less what they promise, with the range that exact "
        "intervals leave in 1 % of studies; 90 % intervals cover "
        f"{100.0 * np.nanmin(covered):.1f} to {100.0 * np.nanmax(covered):.1f} %. "
        "Below, the distribution of the truths' ranks less the uniform one, with its "
        f"simultaneous 99 % band; ranks depart from uniform (p below {FALSE_ALARM:g}) in "
        f"{int(np.sum(p[asked] < FALSE_ALARM))} of {int(asked.sum())}."
    )


def write_ranks(results: Sequence[Path], file: Path) -> None:
    """Counts of the ranks in each hundredth, a line for each row and quantity."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["row", "quantity", "counts"])
        for folder in results:
            for row, cases in stored_rows(read_tree(folder))[1].items():
                for name in WORDS:
                    if f"{name}_rank" in cases:
                        ranks = cases[f"{name}_rank"].values
                        counts = rank_counts(ranks[np.isfinite(ranks)])
                        writer.writerow([row, name, " ".join(map(str, counts))])


def rank_counts(ranks: np.ndarray) -> np.ndarray:
    """How many ranks lie in each hundredth of [0, 1]: all that the figure and the test ask."""
    return np.histogram(ranks, POINTS, (0.0, 1.0))[0]


FIGURE = PaperFigure("calibration", data, draw, caption)


def _main() -> int:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--write-ranks", type=Path)
    given, rest = parser.parse_known_args()
    if given.write_ranks is None:
        return main(FIGURE, arguments=rest)
    folders = [ROOT / "results" / study for study in STUDIES]
    write_ranks([folder for folder in folders if folder.exists()], given.write_ranks)
    print(given.write_ranks)
    return 0


if __name__ == "__main__":
    sys.exit(_main())
