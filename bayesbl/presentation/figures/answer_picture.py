"""The answer as one small picture: every gap with its interval, and the limit."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.figure import Figure

from bayesbl.measurement.summary_types import SnapshotSummary
from bayesbl.presentation.figures import layout, style

_WIDTH_IN, _ROW_IN, _MARGINS_IN = 3.7, 0.42, 0.95
_LONGEST_NAME = 18


@style.publication_style()
def answer_picture(parts: Sequence[tuple[str, SnapshotSummary]], decimals: int = 2) -> Figure:
    """A line per snapshot, large enough to be read on a phone.

    Parameters
    ----------
    parts
        (name, ``summary.json``'s part) of each snapshot in order; ``delta_rad`` may be ``None``.
    decimals
        Of the gaps written beside their marks, in mrad.
    """
    mpl.rcParams.update(
        {"font.size": 9.0, "axes.labelsize": 9.0, "xtick.labelsize": 8.0, "ytick.labelsize": 9.0}
    )
    figure = style.new_figure(_WIDTH_IN, _MARGINS_IN + _ROW_IN * len(parts))
    panel = figure.add_subplot(
        layout.grid(figure, 1, 1, left=1.15, right=0.2, top=0.3, bottom=0.48)[0, 0]
    )
    limit = next((part["limit_rad"] for _, part in parts if part.get("limit_rad")), None)
    for row, (_, part) in enumerate(parts):
        found, own = part["delta_rad"], style.look(row)
        if found is None:
            panel.annotate(
                "withheld", (0.5, row), xycoords=("axes fraction", "data"), ha="center", va="center"
            )
            continue
        low, middle, high = (1e3 * found[key] for key in ("low", "median", "high"))
        # A tick for the median: a round mark would hide an interval that is narrower than it.
        panel.plot(
            [low, high],
            [row, row],
            color=own.colour,
            linewidth=6.0,
            solid_capstyle="butt",
            alpha=0.5,
        )
        panel.plot([middle], [row], color=own.colour, marker="|", markersize=15.0, mew=1.4)
        panel.annotate(
            f"{middle:.{decimals}f}", (middle, row), (0.0, 9.0), textcoords="offset points",
            ha="center", bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip
    if limit is not None:
        panel.axvline(1e3 * limit, color=style.LIMIT, linewidth=1.2, linestyle=(0.0, (6.0, 2.0)))
        panel.annotate(
            "limit", (1e3 * limit, 1.0), (0.0, 3.0), xycoords=("data", "axes fraction"),
            textcoords="offset points", ha="center", va="bottom",
        )  # fmt: skip
    panel.set_ylim(len(parts) - 0.5, -0.7)
    left, right = panel.get_xlim()
    panel.set_xlim(left - 0.06 * (right - left), right + 0.06 * (right - left))
    panel.set_yticks(range(len(parts)), [_shortened(name) or "gap" for name, _ in parts])
    panel.tick_params(left=False)
    panel.spines["left"].set_visible(False)
    panel.grid(axis="x", color=style.NEUTRAL, alpha=0.15, linewidth=0.6)
    panel.set_xlabel("Gap δ (mrad)")
    return figure


def _shortened(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else name[: _LONGEST_NAME - 1] + "…"
