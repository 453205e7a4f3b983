"""Flanks that are soft at small torque look like play: the reader is told where they may be it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_preload import loop

from bayesbl.measurement.ramp_route import HELD, gap_draws, notes_on
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


def test_the_gap_is_given_less_an_unknown_share_of_what_friction_holds():
    found = find_flanks([find_ramps(*loop(gap=5e-3))])
    width, held = np.full((1, 4000), 1e-2), np.full((1, 4000), 2e-4)
    draws = {"width_rad": width, "held_windup_rad": held}
    generator = np.random.default_rng(0)
    shares = generator.uniform(size=(2, *width.shape))
    delta = gap_draws(replace(found, left_by_larger=1.0), draws, shares, generator)
    low, high = np.quantile(delta, (0.05, 0.95))
    assert low == pytest.approx(5e-3 - 0.95 * HELD * 2e-4, rel=0.01)
    assert high == pytest.approx(5e-3 - 0.05 * HELD * 2e-4, rel=0.01)


@pytest.mark.parametrize("left", [1.0, 3.0, 30.0])
def test_no_bound_is_below_what_larger_ramps_leave_unless_a_flank_lifts(left):
    found = replace(
        find_flanks([find_ramps(*loop(3.0))]), left_by_larger=left, probability_of_play=0.0
    )
    width, shares = np.full((1, 4000), 1e-2), np.zeros((2, 1, 4000))
    for lifts_nm, most in ((np.nan, left), (6.0, 1.0)):
        draws = {
            "width_rad": width,
            "held_windup_rad": 0.0 * width,
            "preload_torque_nm": np.full(width.shape, lifts_nm),
        }
        delta = gap_draws(found, draws, shares, np.random.default_rng(0))
        assert np.quantile(delta, 0.95) == pytest.approx(0.95 * 5e-3 * most, rel=0.02)
