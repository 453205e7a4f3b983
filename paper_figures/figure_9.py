"""Figure 9: the two recordings with the fitted model."""

from __future__ import annotations

import sys

from common import Stored, main
from matplotlib.figure import Figure

from bayesbl.figures import signal


def draw(stored: Stored) -> Figure:
    """As ``bayesbl figures`` draws it."""
    return signal(stored.wear)


if __name__ == "__main__":
    sys.exit(main([("figure_9", draw)]))
