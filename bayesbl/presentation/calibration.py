"""Tables of calibration studies as one in Markdown.

    python -m bayesbl.presentation.calibration experiments/results/calibration_main.csv

prints it, with the bands that coverage is held against.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from bayesbl.sampling.calibration import FALSE_ALARM, LEVELS, coverage_band
from bayesbl.sampling.calibration_table import WORDS


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
