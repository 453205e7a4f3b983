"""What else may have changed besides the gap, in sentences."""

from __future__ import annotations

import numpy as np

from bayesbl.measurement.model_check import undecided
from bayesbl.model_search.joint_change import ChangedParameter, JointFindings, Rival

DAMPING = "shaft_damping_nm_s_per_rad"


def test_rivals_of_one_name_are_told_by_their_recordings() -> None:
    changed = ChangedParameter(DAMPING, "before", 231.0, 280.0, 5.0)
    rival = Rival(DAMPING, "after", np.array([8.0e-4, 7.6e-4]))
    found = JointFindings(("before", "after"), True, (changed,), (), (rival,), ())
    draws = 8.0e-4 + 1e-6 * np.linspace(-1.0, 1.0, 101)
    told = undecided(found, draws, 0.9, 1)
    assert told is not None
    assert f"({DAMPING}) in before, δ is 0.8 mrad" in told
    assert f"({DAMPING}) in after, 0.76 mrad" in told
