"""Figure 7: the disturbance at increasing gap."""

from __future__ import annotations

import sys

from common import Stored, main
from matplotlib.figure import Figure

from bayesbl.figures import disturbance


def draw(stored: Stored) -> Figure:
    """As ``bayesbl figures`` draws it."""
    return disturbance(stored.sweep)


if __name__ == "__main__":
    sys.exit(main([("figure_7", draw)]))
