"""Prints the table of a study, which has as many columns as its study file gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bayesbl.report.output import add_row, new_table

if TYPE_CHECKING:
    from rich.console import Console

_BETWEEN = 1
_INDENT = "  "


def print_study(
    lines: Sequence[Mapping[str, Any]], columns: Sequence[str], console: Console
) -> None:
    """One line a row where the terminal is wide enough, else one block a row; all values whole.

    Parameters
    ----------
    lines
        The rows of the study, column to value; what a row lacks stays empty.
    columns
        What is shown, in this order; the first one names the row.
    """
    from rich.text import Text

    from bayesbl.workflows.study import cell

    cells = [[cell(line.get(column)) for column in columns] for line in lines]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    if sum(widths) + _BETWEEN * len(widths) <= console.width:
        table = new_table(*((c, "right" if i else "left") for i, c in enumerate(columns)))
        for row in cells:
            add_row(table, *row)
        console.print(table)
        return
    for row in cells:
        console.print(Text(row[0], style="bold"), soft_wrap=True)
        pairs = [f"{c} {v}" for c, v in zip(columns[1:], row[1:], strict=True) if v]
        for line in filled(pairs, console.width - len(_INDENT)):
            console.print(Text(_INDENT + line), soft_wrap=True)


def study_headline(summary: Mapping[str, Any]) -> str:
    """Which study, and how much of it."""
    rows = summary["rows"]
    cases = sum(int(row["cases"]) for row in rows)
    return f"Study {summary['study']}: {cases} cases in {len(rows)} rows."


def filled(pairs: Sequence[str], width: int) -> list[str]:
    """Pairs set side by side with commas, broken between them alone."""
    lines: list[str] = []
    for index, pair in enumerate(pairs):
        text = pair if index == len(pairs) - 1 else f"{pair},"
        if lines and len(lines[-1]) + 1 + len(text) <= width:
            lines[-1] += f" {text}"
        else:
            lines.append(text)
    return lines
