"""Prints the table of a study, which has as many columns as its study file gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bayesbl.presentation.terminal import add_row, new_table, print_rows

if TYPE_CHECKING:
    from rich.console import Console


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
    from bayesbl.runs.study import cell

    table = new_table(*((c, "right" if i else "left") for i, c in enumerate(columns)))
    for line in lines:
        add_row(table, *(cell(line.get(column)) for column in columns))
    print_rows(table, console)


def study_headline(summary: Mapping[str, Any]) -> str:
    """Which study, and how much of it."""
    rows = summary["rows"]
    cases = sum(int(row["cases"]) for row in rows)
    return f"Study {summary['study']}: {cases} cases in {len(rows)} rows."
