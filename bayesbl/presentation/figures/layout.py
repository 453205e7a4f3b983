"""Where panels go, in inches: the same margins in every figure and no solver that has to guess."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from bayesbl.presentation.figures.style import DOUBLE_COLUMN_IN, SINGLE_COLUMN_IN, new_figure

MOST_COLUMNS = 2

LINE_IN = 0.15
"""Height of a line of a legend."""


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


def one_panel_each(
    count: int, height_in: float = 2.1, *, shared: bool = True, above: float = 0.0
) -> tuple[Figure, list[Axes]]:
    """A figure with one panel per snapshot, at most two in a row, with ``shared`` axes or not.

    ``above`` is room for a legend over all of them, in inches.
    """
    columns = min(count, MOST_COLUMNS)
    rows = math.ceil(count / columns)
    width = SINGLE_COLUMN_IN if count == 1 else DOUBLE_COLUMN_IN
    figure = new_figure(width, rows * height_in + 0.2 + above)
    spec = grid(figure, rows, columns, top=0.3 + above, between=(0.65, 0.35 if shared else 0.55))
    axes: list[Axes] = []
    for i in range(count):
        first = axes[0] if axes and shared else None
        axes.append(figure.add_subplot(spec[divmod(i, columns)], sharex=first, sharey=first))
    return figure, axes
