"""Sentences and tables as the terminal gets them: plain text, never wider than it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bayesbl.presentation import words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_BETWEEN = 2
"""What a table takes between two columns."""

_NARROWEST_NAME = 12
"""To which the first column of a table may be folded."""

_INDENT = "  "


def say(console: Console, sentence: str, style: str = "", *, label: str = "") -> None:
    """A sentence, broken between words; its label in bold before it."""
    from rich.text import Text

    whole = f"{label}: {sentence}" if label else sentence
    text = Text(words.wrapped(whole, console.width), style=style)
    if label:
        text.stylize("bold", 0, len(label) + 1)
    console.print(text, soft_wrap=True)


def new_table(*headers: tuple[str, str]) -> Table:
    """An empty table; headers with their justification. Only the first column may fold."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for i, (title, justify) in enumerate(headers):
        table.add_column(
            Text(title),
            justify=justify,  # type: ignore[arg-type]
            overflow="fold",
            no_wrap=i > 0,
        )
    return table


def print_table(table: Table, console: Console) -> None:
    """A table with an empty line on either side."""
    console.print()
    print_rows(table, console)
    console.print()


def print_rows(table: Table, console: Console) -> None:
    """One line a row where the terminal is wide enough, else one block a row; all values whole."""
    from rich.text import Text

    columns = [[str(text) for text in (c.header, *c.cells)] for c in table.columns]
    name, *others = (max(map(len, "\n".join(column).splitlines())) for column in columns)
    if min(name, _NARROWEST_NAME) + sum(others) + _BETWEEN * len(others) <= console.width:
        console.print(table)
        return
    heads, *rows = zip(*columns, strict=True)
    titles = [head.replace("\n", " ") for head in heads]
    # A name speaks for itself, a number does not.
    first = f"{titles[0]} " if table.columns[0].justify == "right" else ""
    for row in rows:
        console.print(Text(first + row[0], style="bold"), soft_wrap=True)
        pairs = [f"{title} {cell}" for title, cell in zip(titles[1:], row[1:], strict=True) if cell]
        for line in filled(pairs, console.width - len(_INDENT)):
            console.print(Text(_INDENT + line), soft_wrap=True)


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


def add_row(table: Table, *cells: str) -> None:
    """A row of plain text."""
    from rich.text import Text

    table.add_row(*(Text(cell) for cell in cells))
