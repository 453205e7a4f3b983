"""Headings, sentences and tables of a result; terminal and page render the same ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

Tone = Literal["", "answer", "withheld", "aside", "warning"]


@dataclass(frozen=True, slots=True)
class Heading:
    """A title."""

    kind: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence with an optional label."""

    kind: ClassVar[str] = "sentence"
    text: str
    tone: Tone = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """Head of a column; a line break in ``title`` is for the terminal only."""

    title: str
    numeric: bool


@dataclass(frozen=True, slots=True)
class Table:
    """Columns, and rows of texts."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]


Block = Heading | Sentence | Table


def labelled(lines: Mapping[str, object]) -> Iterator[Sentence]:
    """Sentences with labels; empty ones are left out."""
    yield from (
        Sentence(str(said), label=label) for label, said in lines.items() if said not in (None, "")
    )


def aside(sentence: str) -> Sentence:
    """A sentence of secondary importance."""
    return Sentence(sentence, "aside")


def table(titles: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table with cells converted to text; ``#`` before a title: numbers, aligned to the right."""
    columns = (Column(title.removeprefix("#"), title.startswith("#")) for title in titles)
    return Table(tuple(columns), tuple(tuple(map(str, row)) for row in rows))


AdviceTone = Literal["fine", "watch", "act", "withheld", "note"]


@dataclass(frozen=True, slots=True)
class Advice:
    """A short instruction and its reasons; ``tone`` only chooses the colour."""

    tone: AdviceTone
    title: str
    sentences: tuple[str, ...]
