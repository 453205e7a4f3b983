"""Tables of calibration studies: a row's line from its cases, and several tables in Markdown.

    python experiments/calibration_table.py experiments/results/calibration_main.csv

prints one, with the bands that coverage is held against.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from calibration_statistics import (
    FALSE_ALARM,
    LEVELS,
    coverage,
    coverage_band,
    levels_missed,
    uniformity,
)

WORDS = {
    "delta": "δ",
    "change": "change of δ",
    "amplitude": "A",
    "decay_rate": "τ",
    "frequency": "ω",
}
"""How tables and figures call what is asked for."""


def calibration_line(name: str, cases: xr.Dataset, *, from_prior: bool) -> dict[str, float | str]:
    """What the cases of a row say of one quantity.

    Parameters
    ----------
    cases
        ``NAME_rank`` of each truth, ``NAME_error`` of the posterior median and ``NAME_sd`` of the
        posterior; if they are there, ``NAME_shipped_rank`` beside ``withheld``, and
        ``NAME_emcee_rank``, which cases that lack it have as NaN.
    from_prior
        Whether truths came from the prior, so that their ranks should be uniform.
    """
    ranks = cases[f"{name}_rank"].values
    missed = levels_missed(ranks)
    line: dict[str, float | str] = {f"{name}_{p:.0%}": coverage(ranks, p) for p in LEVELS}
    line[f"{name}_holds"] = "not at " + " ".join(f"{p:.0%}" for p in missed) if missed else "yes"
    if from_prior:
        line[f"{name}_uniform_p"] = uniformity(ranks)
    standardised = cases[f"{name}_error"].values / cases[f"{name}_sd"].values
    line[f"{name}_bias_sd"] = float(np.mean(standardised))
    line[f"{name}_claimed/actual"] = 1.0 / math.sqrt(float(np.mean(standardised**2)))
    if f"{name}_shipped_rank" in cases:
        shipped = cases[f"{name}_shipped_rank"].values
        told = shipped[cases["withheld"].values == 0.0]
        line[f"{name}_told_90%"] = coverage(told, 0.9) if told.size else math.nan
    if f"{name}_emcee_rank" in cases:
        apart = ranks - cases[f"{name}_emcee_rank"].values
        apart = apart[np.isfinite(apart)]
        line["emcee_cases"] = float(apart.size)
        line[f"{name}_rank_off_emcee"] = math.sqrt(float(np.mean(apart**2)))
    return line


def quantities(line: Mapping[str, object]) -> list[str]:
    """Names of the quantities that a line tells the calibration of."""
    return [key.removesuffix("_holds") for key in line if key.endswith("_holds") and line[key]]


def markdown(lines: Iterable[Mapping[str, str]]) -> str:
    """Lines of ``table.csv`` as a Markdown table, one line a row and quantity."""
    head = ["recordings", "n", "", *(f"{p:.0%}".replace("%", " %") for p in LEVELS)]
    head += ["all in the band", "ranks uniform, p", "claimed / actual width", "withheld"]
    written = [head, ["---"] * len(head)]
    for line in lines:
        for index, name in enumerate(quantities(line)):
            p = line.get(f"{name}_uniform_p")
            cells = ["", ""] if index else [line["name"], str(_finished(line))]
            cells += [WORDS[name]]
            cells += [f"{100.0 * float(line[f'{name}_{level:.0%}']):.1f}" for level in LEVELS]
            cells += [line[f"{name}_holds"], f"{float(p):.2g}" if p else ""]
            cells += [f"{float(line[f'{name}_claimed/actual']):.2f}"]
            cells += ["" if index else f"{100.0 * float(line['withheld']):.1f} %"]
            written.append(cells)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in written)


def _finished(line: Mapping[str, str]) -> int:
    return int(line["cases"]) - int(line["failed"])


def bands_in_words(count: int) -> str:
    """What the bands are for so many truths, and what is asked of the ranks."""
    bands = (
        f"{100.0 * low:.1f} to {100.0 * high:.1f} % at {p:.0%}"
        for p in LEVELS
        for low, high in [coverage_band(count, p)]
    )
    return (
        f"Bands of {count}: {', '.join(bands)}. Ranks are uniform where p is at least "
        f"{FALSE_ALARM:g}."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print tables of calibration studies as one in Markdown."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("tables", type=Path, nargs="+", metavar="TABLE.csv")
    lines: list[dict[str, str]] = []
    for table in parser.parse_args(arguments).tables:
        with table.open(newline="", encoding="utf-8") as file:
            lines += csv.DictReader(file)
    print(markdown(lines))
    for count in sorted({_finished(line) for line in lines}):
        print(bands_in_words(count))
    return 0


if __name__ == "__main__":
    sys.exit(main())
