"""Headings, sentences and tables of a result; terminal and page render the same ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

Tone = Literal["", "heading", "answer", "withheld", "aside", "warning"]


@dataclass(frozen=True, slots=True)
class Sentence:
    """A heading, or a sentence with an optional label."""

    text: str
    tone: Tone = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Titles of columns, whose line breaks are for the terminal only, and rows of texts."""

    titles: tuple[str, ...]
    numeric: tuple[bool, ...]  # columns of numbers, aligned to the right
    rows: tuple[tuple[str, ...], ...]


Block = Sentence | Table


def labelled(lines: Mapping[str, object]) -> Iterator[Sentence]:
    """Sentences with labels; empty ones are left out."""
    yield from (
        Sentence(str(said), label=label) for label, said in lines.items() if said not in (None, "")
    )


def aside(sentence: str) -> Sentence:
    """A sentence of secondary importance."""
    return Sentence(sentence, "aside")


def table(titles: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table with cells converted to text; ``#`` before the title of a column of numbers."""
    shown, numeric = zip(*((t.removeprefix("#"), t.startswith("#")) for t in titles), strict=True)
    return Table(shown, numeric, tuple(tuple(map(str, row)) for row in rows))


AdviceTone = Literal["fine", "watch", "act", "withheld", "note"]


@dataclass(frozen=True, slots=True)
class Advice:
    """A short instruction and its reasons; ``tone`` only chooses the colour."""

    tone: AdviceTone
    title: str
    sentences: tuple[str, ...]
