"""Figure 10: the two gaps and their change."""

from __future__ import annotations

import sys

from common import Stored, main
from matplotlib.figure import Figure

from bayesbl.figures import gap


def draw(stored: Stored) -> Figure:
    """As ``bayesbl figures`` draws it."""
    return gap(stored.wear)


if __name__ == "__main__":
    sys.exit(main([("figure_10", draw)]))
