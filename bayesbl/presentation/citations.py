"""What to cite, as text and as BibTeX: the works of ``citations.bib``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files

from bayesbl import __version__


@dataclass(frozen=True, slots=True)
class Citation:
    """A work that a result rests on.

    Attributes
    ----------
    fields
        BibTeX's, by name; ``annote`` is what the work did for the result, as part of a sentence.
    bibtex
        The entry as it goes into a ``.bib`` file.
    """

    fields: Mapping[str, str]
    bibtex: str

    @property
    def text(self) -> str:
        """One line for a list of references."""
        fields = {name: re.sub("[{}]", "", value) for name, value in self.fields.items()}
        authors = fields.get("author", "").replace(" and ", ", ")
        where = [
            fields[name]
            for name in ("journal", "booktitle", "publisher", "version", "year")
            if name in fields
        ]
        if "volume" in fields:
            pages = f", {fields['pages']}" if "pages" in fields else ""
            where.insert(1, f"{fields['volume']}{pages}")
        link = f" doi:{fields['doi']}" if "doi" in fields else ""
        parts = [authors, fields["title"], ", ".join(where)]
        return ". ".join(part for part in parts if part) + "." + link

    @property
    def used_for(self) -> str:
        """What it is cited for, as part of a sentence."""
        return self.fields["annote"]


def citations() -> tuple[Citation, ...]:
    """The works behind every result, the source paper first and this package last."""
    return tuple(
        Citation(dict(re.findall(r"^  (\w+) = \{(.*)\},$", entry, re.MULTILINE)), entry)
        for entry in all_bibtex().split("\n\n")
    )


def cited() -> Iterator[str]:
    """Every reference as a line, with what it is cited for."""
    for citation in citations():
        yield f"{citation.text} For {citation.used_for}."


def all_bibtex() -> str:
    """All entries, an empty line between them."""
    stored = files("bayesbl.presentation") / "citations.bib"
    return stored.read_text(encoding="utf-8").strip().replace("VERSION", __version__)
