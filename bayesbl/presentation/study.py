"""A study in words: its table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bayesbl.presentation.blocks import Advice, Block, Table, table

if TYPE_CHECKING:
    from bayesbl.runs.study import StudySummary


def headline(summary: StudySummary) -> str:
    """Name and size of the study."""
    rows = summary["rows"]
    cases = sum(int(row["cases"]) for row in rows)
    return f"Study {summary['study']}: {cases} cases in {len(rows)} rows."


def blocks(summary: StudySummary) -> Iterator[Block]:
    """The table with the time of each row; commits are in the files."""
    from bayesbl.runs.study import table_columns

    yield study_table(summary["rows"], [*table_columns(summary["rows"])[:-1], "seconds"])


def study_table(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Table:
    """A line for each row, with these columns; missing values stay empty."""
    from bayesbl.runs.study import cell

    first, *others = columns
    rows = [[cell(line.get(column)) for column in columns] for line in lines]
    return table((first, *(f"#{column}" for column in others)), rows)


ASSUMPTIONS = (
    "Each case has its own random numbers, set by the seed, the row and the case number.",
)


def advice(summary: StudySummary) -> Advice:
    """Whether all cases of a study count."""
    failed = sum(int(row["failed"]) for row in summary["rows"])
    if failed:
        cases = "1 case failed and is" if failed == 1 else f"{failed} cases failed and are"
        why = f"{cases} not counted; result.nc says why."
        return Advice("watch", "Look at the cases that failed first.", (why,))
    return Advice("note", "Read the table below, row by row.", ("No case failed.",))
