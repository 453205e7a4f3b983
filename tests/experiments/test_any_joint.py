"""Every command ends in an answer or in a sentence; 500 joints: ``configs/any_joint.toml``."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from experiments.any_joint import Row, run_case


@pytest.mark.long
@pytest.mark.parametrize("joint", ["rigid", "turning"])
@pytest.mark.parametrize("case", range(20))
def test_no_command_ends_in_a_traceback(joint: Literal["rigid", "turning"], case: int) -> None:
    row = Row(cases=20, joint=joint)
    ends = run_case(row, case, np.random.SeedSequence(7, spawn_key=(case,)))
    assert ends["tracebacks"] == 0.0
    assert sum(ends.values()) >= 2.0
