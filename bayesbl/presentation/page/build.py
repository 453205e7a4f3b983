"""The page of a result: the answer first, then all that it rests on."""

from __future__ import annotations

import base64
import html
import io
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr
from markupsafe import Markup

from bayesbl.arguments import File, checked
from bayesbl.presentation import answer, words
from bayesbl.presentation.blocks import Block
from bayesbl.presentation.console import SUBJECTS, all_bibtex, blocks, details, origin
from bayesbl.presentation.figures.stored_figure import drawn
from bayesbl.results.folder import FIGURES
from bayesbl.results.store import write_text
from bayesbl.runs.kinds import read_result, summarise

if TYPE_CHECKING:
    from jinja2 import Environment

PAGE_FILE = "report.html"

TITLES = {
    "fit": "Backlash gap of a joint",
    "compare": "Backlash gap of a joint and its change",
    "diagnose": "What a bench lacks",
    "identify": "Bench of a joint, from its data sheet and recordings",
    "sweep": "Gap curve of a virtual bench",
    "plan": "Motions that would show the gap",
    "study": "Study",
}
"""Title of the page by kind of result; a fleet has pages of its own."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure embedded in the page."""

    caption: str
    address: str
    pixels: int
    """How wide it is drawn."""


@checked
def write_page(result: File) -> Path:
    """Write ``report.html`` beside a stored result, over an earlier one; its path.

    Parameters
    ----------
    result
        An output folder or its ``result.nc``.

    Raises
    ------
    ResultError
        If there is no readable, finished result.
    """
    result = Path(result)
    tree = read_result(result)
    folder = result if os.path.isdir(result) else result.parent
    return write_page_of(tree, folder / PAGE_FILE, folder / FIGURES)


def write_page_of(tree: xr.DataTree, path: Path, figures: Path | None = None) -> Path:
    """Write the page of a result; ``figures``: the folder of its stored figures."""
    write_text(page(tree, list(_pictures(tree, figures))), path)
    return path


def page(tree: xr.DataTree, pictures: Sequence[Picture]) -> str:
    """The page as HTML; every text from a user is escaped."""
    summary = summarise(tree)
    subject = SUBJECTS[summary["kind"]]
    headline, advice = subject.headline(summary), subject.advice(summary)
    assumptions = (
        answer.assumptions(summary) if answer.is_measured(summary) else subject.ASSUMPTIONS
    )
    said = {headline, *advice.sentences}
    content = {
        "title": TITLES[summary["kind"]],
        "headline": headline,
        "advice": advice,
        "pictures": pictures,
        "numbers": [block for block in blocks(summary) if getattr(block, "text", "") not in said],
        "details": list(details(tree, summary)),
        "assumptions": list(assumptions),
        "config": tree.attrs.get("config", ""),
        "origin": list(origin(tree)),
        "bibtex": all_bibtex(),
    }
    return templates().get_template("page.html").render(content)


def fragment(headline: str, blocks: Sequence[Block]) -> str:
    """The answer as HTML without a style, for a notebook."""
    macros: Any = templates().get_template("blocks.html").module
    return f"<p><strong>{prose(headline)}</strong></p>{macros.blocks(blocks)}"


def _pictures(tree: xr.DataTree, stored: Path | None) -> Iterator[Picture]:
    """Every figure, drawn anew; a study's figure as stored, because only its file can draw it."""
    if tree.attrs["kind"] == "study":
        for file in sorted(stored.glob("*.png")) if stored else ():
            yield _picture(f"{file.stem}.", file.read_bytes())
        return
    for known, ending, figure in drawn(tree):
        png = io.BytesIO()
        figure.savefig(png, format="png")
        part = ending.strip("_").replace("_", " ")
        text = f"{part}: {known.caption[0].lower()}{known.caption[1:]}" if part else known.caption
        yield _picture(text, png.getvalue())


def _picture(caption: str, png: bytes) -> Picture:
    address = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
    return Picture(caption, address, int.from_bytes(png[16:20]))  # as its head says


def templates(*sheets: str) -> Environment:
    """The templates; pages use the common style and these sheets."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("bayesbl.presentation.page", ".")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["glued"] = prose
    environment.globals["style"] = Markup(
        "".join(source(environment, name) for name in ("page.css", *sheets))
    )
    return environment


def source(environment: Environment, name: str) -> str:
    """A file beside the templates, unchanged."""
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]


def prose(sentence: str) -> Markup:
    """A sentence as HTML: commands as code, no line break inside a quantity or an option."""
    text = html.escape(words.glued(sentence), quote=False)
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", text)
    return Markup(re.sub(r"(?<![\w-])--[a-z][\w-]*", r'<span class="option">\g<0></span>', text))
