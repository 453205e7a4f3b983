"""What to cite, as BibTeX: the works of ``citations.bib``."""

from __future__ import annotations

from importlib.resources import files

from bayesbl import __version__


def all_bibtex() -> str:
    """The works behind every result; ``annote`` says what each did for it."""
    stored = files("bayesbl.presentation") / "citations.bib"
    return stored.read_text(encoding="utf-8").strip().replace("VERSION", __version__)
