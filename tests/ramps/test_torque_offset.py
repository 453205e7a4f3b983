"""A torque that is counted from another zero, or a load that hangs at the joint, moves no play."""

from __future__ import annotations

import numpy as np
import pytest
from test_preload import loop
from test_torque_ramps import operator

from bayesbl.measurement.ramp_route import notes_on
from bayesbl.ramps.flanks import HELD, find_flanks
from bayesbl.ramps.torque_cycles import find_ramps

FRICTION, GAP = 0.5, 5e-3
TRIANGLE = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * np.arange(600) / 600.0))


def left(offset_nm, **joint):
    """What ramps leave between the flanks, with what was taken off the torque."""
    torque, position = loop(friction=FRICTION, **joint)
    ramps = find_ramps(torque + offset_nm, position)
    return find_flanks([ramps]), ramps


@pytest.mark.parametrize("times_friction", [-3.0, -1.5, -0.5, 0.5, 1.5, 3.0])
@pytest.mark.parametrize("softer", [1.0, 3.0])
def test_the_zero_of_the_torque_does_not_matter(times_friction, softer):
    offset = times_friction * FRICTION
    (there, _), (found, ramps) = (left(o, gap=5e-3, softer=softer) for o in (0.0, offset))
    widths = [each.level.widths()[0].mean() for each in (there, found)]
    assert there.finding == found.finding == "play"
    assert widths[1] == pytest.approx(widths[0], rel=0.05)
    assert ramps.offset_nm == pytest.approx(offset, abs=0.2 * FRICTION)
    draws = {"width_rad": widths[1:], "preload_torque_nm": np.zeros(1)}
    notes = notes_on([ramps], found, draws, ratio_given=True, elsewhere=False)
    is_noted = any(note.code == "torque_offset" for note in notes)
    assert is_noted == (abs(times_friction) > 1.0)


@pytest.mark.parametrize("times_friction", [-5.0, -2.0, 2.0, 5.0])
def test_one_large_cycle_shows_the_zero_of_the_torque(times_friction):
    offset = times_friction * FRICTION
    torque, position = loop(friction=FRICTION, gap=5e-3)
    once = slice(0, 6 * 1200 + 300)  # the sixth cycle is the first large one; the next stops short
    ramps = find_ramps(torque[once] + offset, position[once])
    assert ramps.offset_nm == pytest.approx(offset, abs=0.6 * FRICTION)


def test_ramps_farther_to_one_side_are_no_offset():
    """A linear joint without play is free at zero torque, however far it is bent to either side."""
    triangle = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * np.arange(6000) / 1000.0))
    torque = np.where(triangle > 0.0, 8.0, 4.0) * triangle
    at, position = 0.0, []
    for value in torque:
        at = min(max(at, value - FRICTION), value + FRICTION)
        position.append(1e-3 * at)
    assert abs(find_ramps(torque, np.array(position)).offset_nm) < 0.05 * FRICTION


@pytest.mark.parametrize("offset_nm", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("steps", [4, 9])
def test_steps_of_torque_leave_the_play_that_uniform_ramps_leave(steps, offset_nm):
    """The zero of the sensor is within a step, so the torque passes zero as the joint moves."""
    torque = np.concatenate([np.full(60, np.round(x)) for x in steps * TRIANGLE[::10]] * 4)
    found = find_flanks([find_ramps(torque + offset_nm, operator(torque, GAP, FRICTION))])
    assert found.finding == "play"
    least = found.level.width_rad - HELD * np.concatenate(found.windup_rad).mean()
    assert least < 2.0 * GAP < found.level.width_rad * 1.001
