"""All figures here, from a fresh clone: quick experiments that are missing are run first.

    python paper_figures/make_all.py            # a few minutes; tables of studies as committed
    python paper_figures/make_all.py --remake   # the studies too: many hours

What is stored under ``results`` is used as it is; delete a folder there to make it again.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from common import COUNTED, RESULTS, ROOT, STUDIES, PaperFigure, Stored, options, write_all

NAMES = (
    *(f"figure_{number}" for number in (3, 5, 6, 7, 8, 9, 10)),
    "uncertainty_budget",
    "shared_estimator",
    "shared_curve",
    "confusion",
    "calibration",
    "wear_detection",
    "efficiency",
    "time_to_limit",
)

FIGURES: list[PaperFigure[Any]] = [import_module(name).FIGURE for name in NAMES]


def run_missing(results: Path) -> None:
    """Run the quick experiments that ``results`` lacks.

    Raises
    ------
    subprocess.CalledProcessError
        If one of them fails.
    """
    for name, made in RESULTS.items():
        if not (results / name / "result.nc").exists():
            for config in made.configs:
                _run(config)


def remake_studies(results: Path) -> Path:
    """Run every study that is not finished; a folder with their tables."""
    for config in STUDIES.values():
        _run(config)
    tables = results / "tables"
    tables.mkdir(exist_ok=True)
    for name in STUDIES:
        shutil.copy(results / name / "table.csv", tables / f"{name}.csv")
    for name, command in COUNTED.items():
        committed = f"experiments/results/{name}.csv"
        _, *line = shlex.split(command.replace(committed, str(tables / f"{name}.csv")))
        subprocess.run([sys.executable, *line], cwd=ROOT, check=True)
    return tables


def _run(config: str) -> None:
    print(f"bayesbl run {config}", flush=True)
    begun = time.monotonic()
    line = [sys.executable, "-m", "bayesbl", "run", config]
    subprocess.run(line, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    print(f"  {time.monotonic() - begun:.0f} s", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, then draw."""
    parser = options("All figures, from a fresh clone.")
    parser.add_argument("--remake", action="store_true", help="run the studies too")
    given = parser.parse_args(arguments)
    tables = given.tables
    try:
        if given.results == ROOT / "results":
            run_missing(given.results)
        if given.remake:
            tables = remake_studies(given.results)
    except subprocess.CalledProcessError as failed:
        print(f"This failed: {shlex.join(failed.cmd)}", file=sys.stderr)
        return 1
    return write_all(FIGURES, Stored(given.results, tables), given.out)


if __name__ == "__main__":
    sys.exit(main())
