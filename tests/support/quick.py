"""What spares tests time that has nothing to do with what they test."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch


@contextmanager
def without_figures() -> Iterator[None]:
    """Runs inside write no figures: these take longer than a fit."""
    with patch("bayesbl.library.draw", lambda tree, folder: []):
        yield
