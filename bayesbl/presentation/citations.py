"""What to cite, as text and as BibTeX."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from bayesbl import __version__


@dataclass(frozen=True, slots=True)
class Citation:
    """A work that a result rests on.

    Attributes
    ----------
    key, kind
        BibTeX's key and kind of entry.
    used_for
        What it did for the result, as part of a sentence.
    fields
        BibTeX's fields in order; ``author`` with "and" between names, special letters as Unicode.
    """

    key: str
    kind: str
    used_for: str
    fields: Mapping[str, str]

    @property
    def text(self) -> str:
        """One line for a list of references."""
        fields = self.fields
        authors = fields.get("author", "").replace(" and ", ", ").replace("{", "").replace("}", "")
        title = fields["title"].replace("{", "").replace("}", "")
        where = [
            fields[name]
            for name in ("journal", "booktitle", "publisher", "version", "year")
            if name in fields
        ]
        if "volume" in fields:
            pages = f", {fields['pages']}" if "pages" in fields else ""
            where.insert(1, f"{fields['volume']}{pages}")
        link = f" doi:{fields['doi']}" if "doi" in fields else ""
        parts = [authors, title, ", ".join(where)]
        return ". ".join(part for part in parts if part) + "." + link

    @property
    def bibtex(self) -> str:
        """The entry as it goes into a ``.bib`` file."""
        lines = [f"  {name} = {{{value}}}," for name, value in self.fields.items()]
        return "\n".join([f"@{self.kind}{{{self.key},", *lines, "}"])


def citations() -> tuple[Citation, ...]:
    """The works behind every result, the source paper first and this package last."""
    return (
        Citation(
            "backlash_gap",
            "misc",
            "the method: the disturbance model and the curve from amplitude to gap",
            {
                "title": "Virtual Measurement of the Backlash Gap in Industrial Manipulators",
            },
        ),
        Citation(
            "hansen2001",
            "article",
            "the search (CMA-ES)",
            {
                "author": "Hansen, Nikolaus and Ostermeier, Andreas",
                "title": "Completely Derandomized Self-Adaptation in Evolution Strategies",
                "journal": "Evolutionary Computation",
                "volume": "9(2)",
                "pages": "159-195",
                "year": "2001",
                "doi": "10.1162/106365601750190398",
            },
        ),
        Citation(
            "pycma",
            "misc",
            "the implementation of CMA-ES",
            {
                "author": "Hansen, Nikolaus and Akimoto, Youhei and Baudis, Petr",
                "title": "{CMA-ES/pycma} on {GitHub}",
                "publisher": "Zenodo",
                "year": "2019",
                "doi": "10.5281/zenodo.2559634",
            },
        ),
        Citation(
            "emcee",
            "article",
            "the sampling of the posterior",
            {
                "author": "Foreman-Mackey, Daniel and Hogg, David W. and Lang, Dustin and "
                "Goodman, Jonathan",
                "title": "emcee: The {MCMC} Hammer",
                "journal": "Publications of the Astronomical Society of the Pacific",
                "volume": "125",
                "pages": "306-312",
                "year": "2013",
                "doi": "10.1086/670067",
            },
        ),
        Citation(
            "arviz",
            "article",
            "convergence diagnostics and the layout of results",
            {
                "author": "Kumar, Ravin and Carroll, Colin and Hartikainen, Ari and "
                "Martin, Osvaldo",
                "title": "{ArviZ} a unified library for exploratory analysis of {Bayesian} models "
                "in {Python}",
                "journal": "Journal of Open Source Software",
                "volume": "4(33)",
                "pages": "1143",
                "year": "2019",
                "doi": "10.21105/joss.01143",
            },
        ),
        Citation(
            "bayesbl",
            "software",
            "this package",
            {
                "title": "bayesbl: sensorless measurement of the backlash gap in robot joints, "
                "with honest uncertainty",
                "version": __version__,
            },
        ),
    )


def told_citations() -> Iterator[str]:
    """Every reference as a line, with what it is cited for."""
    for citation in citations():
        yield f"{citation.text} For {citation.used_for}."


def all_bibtex() -> str:
    """All entries, an empty line between them."""
    return "\n\n".join(citation.bibtex for citation in citations())
