"""Figure 8: the gap curve of the sweep, with eq. 4 beside it."""

from __future__ import annotations

import sys

from common import Stored, main
from matplotlib.figure import Figure

from bayesbl.figures import curve


def draw(stored: Stored) -> Figure:
    """As ``bayesbl figures`` draws it."""
    return curve(stored.sweep)


if __name__ == "__main__":
    sys.exit(main([("figure_8", draw)]))
