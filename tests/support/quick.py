"""What spares tests time that has nothing to do with what they test."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch


@contextmanager
def without_figures() -> Iterator[None]:
    """Runs inside write no figures: these take longer than a fit."""
    with patch("bayesbl.library.draw", lambda tree, folder, *formats: []):
        yield


def two_ensembles(folder: Path, kind: str) -> Path:
    """A configuration for commands that name their recordings: half of the sampling."""
    path = folder / f"{kind}.toml"
    path.write_text(f'schema = 1\nkind = "{kind}"\n[posterior]\nensembles = 2\n')
    return path
