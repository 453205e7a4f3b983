"""Strokes of the independent simulator, answered as the study of strokes answers them."""

from __future__ import annotations

import numpy as np
import pytest
from places import CONFIGS
from strokes import Row, run_case


@pytest.mark.long
def test_a_flank_at_the_start_that_only_moves_the_load_is_forgotten():
    """Fast strokes about hanging: gravity hardly presses at the start, against what they need.

    The other flank leaves the load 2δ further for good, which the unknown start angle takes up.
    """
    row = Row(
        name="±5° about hanging, 0.2 s",
        bench=CONFIGS / "bench.toml",
        cases=1,
        reach_deg=5.0,
        stroke_s=0.2,
        duration_s=10.0,
    )
    found = run_case(row, 0, np.random.SeedSequence(1))
    for name in ("first", "second"):
        assert found[f"withheld_{name}"] == 0.0
        # Off by more than four standard deviations in 1 of 16,000 recordings.
        assert abs(found[f"error_{name}"]) < 4.0 * found[f"sd_{name}"]
