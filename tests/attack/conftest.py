"""The originals that the attack damages, made once; and a case by itself."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from attack.engine import Child, Finding, Prepare, run_case
from attack.workshop import Originals


@pytest.fixture(scope="session")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Originals:
    return Originals(tmp_path_factory.mktemp("originals"))


@pytest.fixture
def open_path(tmp_path: Path) -> Path:
    """A folder that cases still reach once they have given up root's rights."""
    if os.geteuid() == 0:
        for folder in (tmp_path, *list(tmp_path.parents)[:2]):
            folder.chmod(0o755)
    return tmp_path


@pytest.fixture
def findings(open_path: Path) -> Callable[[Prepare], list[Finding]]:
    """Runs one case in a child of its own; what is wrong with it."""

    def run(prepare: Prepare) -> list[Finding]:
        place = open_path / "case"
        place.mkdir()
        child = Child(lambda: run_case(prepare, place, np.random.default_rng(16)))
        while (found := child.poll()) is None:
            time.sleep(0.01)
        if found and found[0][0] == "skipped":
            pytest.skip(found[0][1])
        return found

    return run
