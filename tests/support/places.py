"""Where the repository's own files lie."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
RECORDINGS = CONFIGS / "recordings"
BEFORE, AFTER = RECORDINGS / "wear_before.csv", RECORDINGS / "wear_after.csv"
EXPERIMENTS = ROOT / "experiments"
