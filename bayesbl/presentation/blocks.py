"""What a result says, as headings, sentences and tables: terminal and page render the same ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

Tone = Literal["", "answer", "withheld", "aside", "warning"]


@dataclass(frozen=True, slots=True)
class Heading:
    """The title of what follows."""

    kind: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence, with a label before it or none."""

    kind: ClassVar[str] = "sentence"
    text: str
    tone: Tone = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """The head of a column; a line break in ``title`` is for the terminal alone."""

    title: str
    numeric: bool


@dataclass(frozen=True, slots=True)
class Table:
    """Columns, and rows with a text for each of them."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]


Block = Heading | Sentence | Table


def labelled(lines: Mapping[str, object]) -> Iterator[Sentence]:
    """Sentences by their labels; those that say nothing are left out."""
    yield from (
        Sentence(str(said), label=label) for label, said in lines.items() if said not in (None, "")
    )


def aside(sentence: str) -> Sentence:
    """What need not be read."""
    return Sentence(sentence, "aside")


def text(title: str) -> Column:
    """A column of text, set to the left."""
    return Column(title, numeric=False)


def numbers(title: str) -> Column:
    """A column of numbers, set to the right."""
    return Column(title, numeric=True)


def table(columns: Iterable[Column], rows: Iterable[Iterable[object]]) -> Table:
    """A table; cells as text."""
    return Table(tuple(columns), tuple(tuple(str(cell) for cell in row) for row in rows))


AdviceTone = Literal["fine", "watch", "act", "withheld", "note"]


@dataclass(frozen=True, slots=True)
class Advice:
    """A short order and why; ``tone`` decides the colour, never the meaning alone."""

    tone: AdviceTone
    title: str
    sentences: tuple[str, ...]
