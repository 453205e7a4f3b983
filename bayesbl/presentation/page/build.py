"""The page of a result: the answer first, then everything that it rests on."""

from __future__ import annotations

import base64
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from bayesbl.errors import UserError
from bayesbl.presentation import answer, words
from bayesbl.presentation.blocks import Block
from bayesbl.presentation.citations import all_bibtex, citations
from bayesbl.presentation.figures.gap import answer_picture
from bayesbl.presentation.figures.stored_figure import caption, figure_of, figures_of, reading_order
from bayesbl.presentation.page.templates import prose, templates
from bayesbl.presentation.subjects import SUBJECTS, blocks
from bayesbl.results.folder import FIGURES
from bayesbl.results.store import texts, write_text
from bayesbl.runs.kinds import read_result, summarise

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import SnapshotSummary

PAGE_FILE = "report.html"

Draw = Callable[[xr.DataTree, Path], Sequence[Path]]
"""Draws all figures of a result into a folder and returns the files it wrote."""

_ORIGIN = {
    "bayesbl_version": "Version",
    "git_commit": "Commit",
    "created_utc": "Made",
    "seed": "Seed",
    "python_version": "Python",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as the page holds it: no file beside it is needed."""

    caption: str
    address: str
    pixels: int = 0
    """How wide it is, where it is drawn in points of a screen."""
    special: bool = False
    """Whether it is of use to specialists only."""


def write_page(result: str | Path, draw: Draw) -> Path:
    """Write ``report.html`` beside a stored result, over an earlier one.

    Parameters
    ----------
    result
        An output folder or its ``result.nc``.
    draw
        Draws the figures where the folder holds none.

    Raises
    ------
    ResultError
        If there is no readable, finished result.
    """
    result = Path(result)
    tree = read_result(result)
    folder = result if os.path.isdir(result) else result.parent
    return write_page_of(tree, folder / PAGE_FILE, draw, folder / FIGURES)


def write_page_of(tree: xr.DataTree, path: Path, draw: Draw, figures: Path | None = None) -> Path:
    """Write the page of a result that need not be stored; the figures of a folder, if it is."""
    write_text(page(tree, _pictures(tree, figures, draw)), path)
    return path


def page(tree: xr.DataTree, pictures: Sequence[Picture]) -> str:
    """The page as HTML; every text that a user may have given is escaped."""
    return templates().get_template("page.html").render(**_content(tree, pictures))


def fragment(headline: str, blocks: Sequence[Block]) -> str:
    """The answer as a piece of HTML without a style of its own, for a notebook."""
    macros: Any = templates().get_template("blocks.html").module
    return f"<p><strong>{prose(headline)}</strong></p>{macros.blocks(blocks)}"


def _content(tree: xr.DataTree, pictures: Sequence[Picture]) -> dict[str, Any]:
    summary = summarise(tree)
    subject = SUBJECTS[summary["kind"]]
    measured = summary if answer.is_measured(summary) else None
    gaps = answer.snapshots(measured) if measured else []
    return {
        "title": subject.title,
        "headline": subject.headline(summary),
        "advice": subject.advice(summary),
        "cards": list(subject.cards(summary)),
        "explained": answer.explained(measured) if measured else "",
        "answer": _answer_picture(gaps) if gaps else None,
        "pictures": [p for p in pictures if not p.special],
        "special": [p for p in pictures if p.special],
        "numbers": list(blocks(summary)),
        "details": list(subject.details(tree, summary)),
        "budget": [(name or "Gap", list(_shares(part["budget"]))) for name, part in gaps],
        "assumptions": list(subject.assumptions(summary)),
        "config": tree.attrs.get("config", ""),
        "origin": [(label, tree.attrs[key]) for key, label in _ORIGIN.items() if key in tree.attrs],
        "inputs": json.loads(tree.attrs.get("input_sha256", "{}")),
        "versions": json.loads(tree.attrs.get("dependency_versions", "{}")),
        "citations": citations(),
        "bibtex": all_bibtex(),
    }


def _shares(budget: Mapping[str, float]) -> Iterator[tuple[str, float, str]]:
    """(source, share in percent, share in words), largest first."""
    for source, share in sorted(budget.items(), key=lambda item: -item[1]):
        yield words.source_in_words(source), 100.0 * share, words.probability(share)


def _answer_picture(gaps: Sequence[tuple[str, SnapshotSummary]]) -> Picture | None:
    """Every gap with its interval and the limit; nothing if all of them are withheld."""
    if all(part["delta_rad"] is None for _, part in gaps):
        return None
    each = "; ".join(
        f"{name or 'gap'}: {words.gap_in_words(part['delta_rad'], part['delta_upper_bound_rad'])}"
        for name, part in gaps
    )
    buffer = io.BytesIO()
    places = words.common_decimals(part["delta_rad"] for _, part in gaps)
    answer_picture(gaps, places).savefig(buffer, format="svg", metadata={"Date": None})
    return Picture(each, _address(buffer.getvalue(), "svg+xml"))


def _pictures(tree: xr.DataTree, stored: Path | None, draw: Draw) -> list[Picture]:
    """The stored figures, and fresh ones of those that a run leaves out."""
    files = {path.stem: path for path in stored.glob("*.png")} if stored else {}
    known = figures_of(tree)
    names = texts(tree.attrs.get("recordings")) if tree.attrs.get("kind") == "compare" else []
    shown = {f.name for f in (figure_of(stem, known) for stem in files) if f is not None}
    with tempfile.TemporaryDirectory() as folder:
        if not files or {figure.name for figure in known} - shown:
            # A study's figure is drawn by its study file, which may be gone.
            with suppress(UserError):
                drawn = draw(tree, Path(folder))
                files = {path.stem: path for path in drawn if path.suffix == ".png"} | files
        return [
            Picture(
                caption(stem, known),
                _address(data := files[stem].read_bytes(), "png"),
                int.from_bytes(data[16:20]),  # in the head of every PNG
                (figure := figure_of(stem, known)) is not None and figure.for_specialists,
            )
            for stem in reading_order(files, known, names)
        ]


def _address(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
