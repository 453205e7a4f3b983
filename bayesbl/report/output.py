"""Sentences and tables as the terminal gets them: plain text, never wider than it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.report import words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


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
    console.print(table)
    console.print()


def add_row(table: Table, *cells: str) -> None:
    """A row of plain text."""
    from rich.text import Text

    table.add_row(*(Text(cell) for cell in cells))
