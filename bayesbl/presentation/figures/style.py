"""One look for every figure: journal widths, colours that survive greyscale, same bytes again."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayesbl.results.folder import figure_title

SINGLE_COLUMN_IN = 3.4
DOUBLE_COLUMN_IN = 7.0
PNG_DPI = 200

MEASURED = "#8c8c8c"
MODEL = "#0072b2"
BAND = "#a6cee3"
LIMIT = "#000000"
WITHHELD = "#b0b0b0"
NEUTRAL = "#404040"

_RC: Mapping[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same figure on every machine
    "font.size": 7.0,  # the least that journals take at printed size
    "axes.titlesize": 7.0,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "mathtext.default": "regular",
    "axes.titley": 1.0,  # a place found anew at each drawing takes a tenth of the time
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.0,
    "lines.markersize": 4.0,
    "patch.linewidth": 0.6,
    "hatch.linewidth": 0.4,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "figure.dpi": PNG_DPI,
    "savefig.dpi": PNG_DPI,
    "pdf.fonttype": 42,  # TrueType: text stays text, as journals ask
    # matplotlib 3.11 splits fonts in PDF by this one; at its default each is embedded twice.
    "ps.fonttype": 42,
}


@dataclass(frozen=True, slots=True)
class Look:
    """What distinguishes one of several things of a kind, in colour and in grey."""

    colour: str
    dashes: str | tuple[float, tuple[float, ...]]
    marker: str


LOOKS = (
    Look("#0072b2", "-", "o"),
    Look("#d55e00", (0.0, (4.0, 1.5)), "s"),
    Look("#009e73", (0.0, (1.0, 1.0)), "^"),
    Look("#cc79a7", (0.0, (5.0, 1.0, 1.0, 1.0)), "D"),
    Look("#56b4e9", (0.0, (6.0, 2.0)), "v"),
    Look("#e69f00", (0.0, (2.0, 1.0)), "P"),
    Look("#000000", (0.0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0)), "X"),
)
"""Okabe and Ito's palette, which colour-blind readers can tell apart, with dashes and markers."""


def look(index: int) -> Look:
    """The look of the ``index``-th snapshot, ensemble or run."""
    return LOOKS[index % len(LOOKS)]


@contextmanager
def publication_style() -> Iterator[None]:
    """All figures are made and saved under these settings; the user's own come back after it."""
    with mpl.rc_context():
        mpl.rcdefaults()
        for name, value in _RC.items():
            mpl.rcParams[name] = value
        yield


class ShownFigure(Figure):
    """A figure that a notebook shows, whether or not it has a backend of its own."""

    def _repr_png_(self) -> bytes:
        image = io.BytesIO()
        with publication_style():
            self.savefig(image, format="png", dpi=PNG_DPI / 2)
        return image.getvalue()


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure that belongs to no window and no global list."""
    figure = ShownFigure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def head_panels(axes: Sequence[Axes], titles: Sequence[str]) -> None:
    """(a), (b), … above the upper left corner of each panel, and its title behind."""
    for index, (panel, title) in enumerate(zip(axes, titles, strict=True)):
        # Regular weight: every further font costs 0.15 s per file to be cut down and embedded.
        panel.set_title(f"({_letters(index)})  {title}", loc="left", pad=4.0)


def legend_above(panel: Axes) -> None:
    """A legend in one line beside the panel's title, where there is never data."""
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        columnspacing=0.7,
        handlelength=1.4,
        handletextpad=0.4,
        borderaxespad=0.2,
    )


def _letters(index: int) -> str:
    first, last = divmod(index, 26)
    return ("" if first == 0 else chr(96 + first)) + chr(97 + last)


def save(figure: Figure, folder: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Write ``name.pdf``, ``name.png`` or both; the same figure gives the same bytes at any time.

    Where one of them cannot be written, none is left. Each has a title by which
    :mod:`bayesbl.results.folder` knows it from a user's file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{ending}" for ending in formats]
    timeless = {"pdf": {"CreationDate": None}}
    # A tenth larger than at PNG's default, in two thirds of the time.
    quick: dict[str, Any] = {"png": {"pil_kwargs": {"compress_level": 3}}}
    try:
        for file, ending in zip(files, formats, strict=True):
            titled = {**timeless.get(ending, {}), "Title": figure_title(name)}
            figure.savefig(file, metadata=titled, **quick.get(ending, {}))
    except BaseException:
        for file in filter(Path.is_file, files):
            file.unlink()  # half a figure would pass for a file of the user's
        raise
    return files
