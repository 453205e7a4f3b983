"""A bench file: it is simulated on, not run; only what it is can be said."""

from __future__ import annotations

from pathlib import Path

from bayesbl.config.bench import load_bench
from bayesbl.runs.workflow import Plan


def describe(path: Path, plan: Plan) -> None:
    """Which virtual bench the file holds."""
    bench = load_bench(path)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))
