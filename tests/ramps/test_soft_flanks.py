"""Flanks that are soft at small torque look like play: the reader is told where they may be it."""

from __future__ import annotations

import numpy as np
import pytest
from test_preload import loop

from bayesbl.measurement.ramp_route import notes_on
from bayesbl.ramps.flanks import find_flanks
from bayesbl.ramps.torque_cycles import find_ramps


def told_of_soft_flanks(**joint):
    files = [find_ramps(*loop(**joint))]
    found = find_flanks(files)
    assert found.finding == "play"
    draws = {"width_rad": found.level.widths()[0], "preload_torque_nm": np.zeros(1)}
    notes = notes_on(files, found, draws, ratio_given=True, elsewhere=False)
    return [note for note in notes if note.code == "soft_flanks"]


@pytest.mark.parametrize("softer", [2.0, 5.0, 20.0])
def test_soft_flanks_without_play_are_told(softer):
    assert len(told_of_soft_flanks(softer=softer)) == 1


def test_a_gap_that_soft_flanks_cannot_make_is_told_without():
    assert told_of_soft_flanks(gap=1e-2) == []
