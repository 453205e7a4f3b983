"""What the console would print, kept as headings, sentences and tables for the page.

The page thereby says what the terminal says, word for word, without a second place for it.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

_ENDLESS = 100_000


@dataclass(frozen=True, slots=True)
class Block:
    """A heading, a sentence with its label, or a table; ``kind`` tells which.

    Attributes
    ----------
    header
        (title, whether its column holds numbers) of each column.
    """

    kind: str
    text: str = ""
    label: str = ""
    header: tuple[tuple[str, bool], ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


class Collector(Console):
    """A console that keeps what it is given instead of printing it."""

    def __init__(self) -> None:
        super().__init__(file=io.StringIO(), width=_ENDLESS, markup=False, emoji=False)
        self.blocks: list[Block] = []

    def print(self, *objects: Any, **how: Any) -> None:
        """Keep sentences and tables; empty lines are the page's own affair."""
        for item in objects:
            if isinstance(item, Table):
                self.blocks.append(_table(item))
            elif isinstance(item, Text):
                self.blocks.append(_sentence(item))
            else:
                self.blocks.append(Block("sentence", str(item)))


def _sentence(text: Text) -> Block:
    if str(text.style).startswith("bold"):
        return Block("heading", text.plain)
    for span in text.spans:
        if span.start == 0 and str(span.style) == "bold":
            return Block("sentence", text.plain[span.end :].strip(), text.plain[: span.end - 1])
    return Block("sentence", text.plain)


def _table(table: Table) -> Block:
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    header = tuple(
        (str(column.header).replace("\n", " "), column.justify == "right")
        for column in table.columns
    )
    return Block("table", header=header, rows=tuple(zip(*columns, strict=True)))
