"""The common style of figures: sizes, colours, margins, scales and marks.

Colours survive greyscale, and a figure always gives the same bytes. Margins are in inches and the
same everywhere, so no solver has to find them.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from bayesbl.recording.types import FloatArray
from bayesbl.results.folder import figure_title, replacing
from bayesbl.results.store import Interval

SINGLE_COLUMN_IN = 3.4
DOUBLE_COLUMN_IN = 7.0
PNG_DPI = 200

MEASURED = "#8c8c8c"
MODEL = "#0072b2"
BAND = "#a6cee3"
LIMIT = "#000000"
WITHHELD = "#b0b0b0"
NEUTRAL = "#404040"
GAP = "delta_rad"  # name of the gap in a posterior
_TEXTS = [f"{of}size" for of in ("font.", "axes.title", "axes.label", "xtick.label", "ytick.label")]
_TEXTS += ["legend.fontsize"]
_LINES = ("axes.linewidth", "patch.linewidth", "xtick.major.width", "ytick.major.width")
_RC: Mapping[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same figure on every machine
    **dict.fromkeys(_TEXTS, 7.0),  # the least that journals take at printed size
    **dict.fromkeys(_LINES, 0.6),
    "mathtext.default": "regular",
    "axes.titley": 1.0,  # a place found anew at each drawing takes a tenth of the time
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "lines.linewidth": 1.0,
    "lines.markersize": 4.0,
    "hatch.linewidth": 0.4,
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
    """What distinguishes one of several similar things, in colour and in grey."""

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
"""Okabe and Ito's palette for colour-blind readers, with dashes and markers."""


def look(index: int) -> Look:
    """The look of the ``index``-th snapshot, ensemble or run."""
    return LOOKS[index % len(LOOKS)]


@contextmanager
def publication_style() -> Iterator[None]:
    """Use these settings within the block, whatever the user's own are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        yield


class ShownFigure(Figure):
    """A figure that a notebook shows with any backend."""

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
    """Write (a), (b), … and a title above each panel."""
    for index, (panel, title) in enumerate(zip(axes, titles, strict=True)):
        # Regular weight: every further font costs 0.15 s per file to be cut down and embedded.
        first, last = divmod(index, 26)
        letters = chr(96 + first) * (first > 0) + chr(97 + last)
        panel.set_title(f"({letters})  {title}", loc="left", pad=4.0)


def legend_over(figure: Figure, panel: Axes, columns: int = 4) -> None:
    """Put a panel's legend above all panels."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", bbox_to_anchor=(0.01, 1.0), ncols=columns)


def save(figure: Figure, folder: Path, name: str, formats: Sequence[str]) -> list[Path]:
    """Write ``name.pdf``, ``name.png`` or both, each whole or not at all.

    A figure always gives the same bytes. The file's title marks it as ours for
    :mod:`bayesbl.results.folder`.
    """
    files = [folder / f"{name}.{ending}" for ending in formats]
    timeless = {"pdf": {"CreationDate": None}}
    # A tenth larger than at PNG's default, in two thirds of the time.
    quick: dict[str, Any] = {"png": {"pil_kwargs": {"compress_level": 3}}}
    for file, ending in zip(files, formats, strict=True):
        titled = {**timeless.get(ending, {}), "Title": figure_title(name)}
        with replacing(file) as new:
            figure.savefig(new, metadata=titled, **quick.get(ending, {}))
    return files


LINE_IN = 0.15  # height of a legend's line


def grid(
    figure: Figure,
    rows: int,
    columns: int,
    *,
    left: float = 0.55,
    right: float = 0.1,
    top: float = 0.3,
    bottom: float = 0.42,
    between: tuple[float, float] = (0.5, 0.55),
    widths: Sequence[float] | None = None,
) -> GridSpec:
    """A grid with margins and gaps (vertical, horizontal) in inches."""
    width, height = (float(size) for size in figure.get_size_inches())
    row = (height - top - bottom - (rows - 1) * between[0]) / rows
    column = (width - left - right - (columns - 1) * between[1]) / columns
    return GridSpec(
        rows,
        columns,
        figure=figure,
        left=left / width,
        right=1.0 - right / width,
        top=1.0 - top / height,
        bottom=bottom / height,
        hspace=between[0] / row,
        wspace=between[1] / column,
        width_ratios=widths,
    )


def envelope(
    time: FloatArray, values: FloatArray, bins: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middle time, minimum and maximum of at most ``bins`` stretches of equal sample count, each
    (m,).

    Neighbouring stretches share a sample, so that the outline has no gaps. NaN is ignored.
    """
    edges = np.unique(np.linspace(0, values.size - 1, min(bins, values.size) + 1).round())
    starts = edges[:-1].astype(int)
    ends = edges[1:].astype(int)
    low = np.fmin(np.fmin.reduceat(values, starts), values[ends])
    high = np.fmax(np.fmax.reduceat(values, starts), values[ends])
    return 0.5 * (time[starts] + time[ends]), low, high


LIMIT_DASHES = (0.0, (6.0, 2.0, 1.0, 2.0))


def reach(interval: Interval, scale: float = 1.0) -> list[list[float]]:
    """How far an interval reaches below and above its median, as for error bars."""
    below = interval["median"] - interval["low"]
    above = interval["high"] - interval["median"]
    return [[scale * below], [scale * above]]


def band_in_words(curve: xr.Dataset) -> str:
    """``90 % band ± 0.02 %`` at a curve's widest place; it is often too narrow to be seen."""
    reach = 0.5 * (curve["high_rad"].values - curve["low_rad"].values) / curve["delta_rad"].values
    return f"{100.0 * float(curve.attrs['level']):g} % band ± {100.0 * float(reach.max()):.2g} %"


def draw_curve(panel: Axes, curve: xr.Dataset, colour: str, label: str, band: str | None) -> None:
    """A stored gap curve with its band, in mrad over rpm."""
    amplitude, low, high = (curve[n].values for n in ("amplitude", "low_rad", "high_rad"))
    panel.fill_between(amplitude, 1e3 * low, 1e3 * high, color="#c8c8c8", linewidth=0.0, label=band)
    panel.plot(amplitude, 1e3 * curve["delta_rad"].values, color=colour, label=label)


def limit_line(panel: Axes, tree: xr.DataTree) -> None:
    """Draw the limit, if there is one, across a panel of gaps in mrad."""
    if "limit_rad" in tree.attrs:
        limit = 1e3 * float(tree.attrs["limit_rad"])
        panel.axhline(
            limit, color=LIMIT, linewidth=0.9, linestyle=LIMIT_DASHES, label=f"limit {limit:g} mrad"
        )


def shade(panel: Axes, start: float, end: float) -> None:
    """Shade a stretch of the horizontal axis."""
    panel.axvspan(start, end, color="#f5edc0", linewidth=0.0, zorder=0.0)


def plain_log_axis(axis: Axis, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Make an axis logarithmic, with ``steps`` of each decade as plain numbers."""
    name = "x" if isinstance(axis, XAxis) else "y"
    axis.axes.set(**{f"{name}scale": "log"})
    axis.set_major_locator(FixedLocator([m * 10.0**k for k in range(-6, 7) for m in steps]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
