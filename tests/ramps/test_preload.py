"""Laws of the torque at which one flank of a preloaded joint lifts, on loops of the play operator.

Flanks of stiffness k, pressed together by F at rest, both carry up to 2F; beyond, one does.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_torque_ramps import STAND

from bayesbl.ramps.flanks import find_flanks, lifting_torque
from bayesbl.ramps.torque_cycles import find_ramps
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.readers import read_recording

COMPLIANCE, SMALL, LARGE = 5e-4, 3.0, 40.0


def loop(pressed_nm=0.0, *, friction=0.5, gap=0.0, softer=1.0, seed=0):
    """Torque and position; each flank is ``softer`` times as compliant where it is first touched.

    ``pressed_nm``: by how much a linear flank of ``COMPLIANCE`` would be pressed at rest.
    """
    phase = np.arange(1200) / 1200
    triangle = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase))
    torque = np.concatenate([a * triangle for a in (*[SMALL] * 5, *[LARGE] * 3)])
    grid = np.linspace(-0.2, 0.2, 400_001)
    pressed = pressed_nm * COMPLIANCE

    def flank(compression):
        x = np.maximum(compression, 0.0)
        scale = COMPLIANCE  # as 1 N m of the stiff flank presses it
        return (x - (1.0 - 1.0 / softer) * scale * (1.0 - np.exp(-x / scale))) / COMPLIANCE

    force = flank(grid - gap + pressed) - flank(-grid - gap + pressed) + 1e-6 * grid
    lower, upper = (np.interp(torque + side * friction, force, grid) for side in (-1.0, 1.0))
    at, position = 0.0, []
    for least, most in zip(lower, upper, strict=True):
        at = min(max(at, least), most)
        position.append(at)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(torque.size)
    return torque + noise, np.array(position)


def lifts_at(*loops):
    files = [find_ramps(*each) for each in loops]
    found = find_flanks(files)
    return found, lifting_torque(found.largest)


@pytest.mark.parametrize("friction", [0.1, 0.5, 1.2])
@pytest.mark.parametrize("pressed_nm", [0.5, 3.0, 7.0])
def test_one_linear_flank_lifts_at_twice_the_force_at_rest_whatever_the_friction(
    pressed_nm, friction
):
    found, (torque,) = lifts_at(loop(pressed_nm, friction=friction))
    assert found.finding == "preloaded"
    assert np.median(torque) == pytest.approx(2.0 * pressed_nm, rel=0.1)


def test_a_flank_that_hardens_lifts_where_its_force_is_that_of_the_joint():
    """At a compression of 2 x it bears 2x − (1 − 1/softer)(1 − e^−2x), in N m, with x in N m."""
    pressed, softer = 2.0, 3.0
    expected = 2.0 * pressed - (1.0 - 1.0 / softer) * (1.0 - np.exp(-2.0 * pressed))
    _, (torque,) = lifts_at(loop(pressed, softer=softer))
    assert np.median(torque) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(
    "joint", [{}, {"gap": 3e-3}, {"softer": 5.0}, {"gap": 3e-3, "softer": 5.0}, {"friction": 1.4}]
)
def test_without_preload_no_flank_is_seen_to_lift(joint):
    assert lifts_at(loop(**joint))[1] == []


@pytest.mark.parametrize("pressed_nm", [12.0, 25.0, 60.0])
def test_a_preload_beyond_the_ramps_has_no_torque(pressed_nm):
    assert lifts_at(loop(pressed_nm))[1] == []


def test_one_position_that_does_not_show_it_leaves_no_torque():
    assert lifts_at(loop(3.0), loop(3.0, seed=1))[1] != []
    assert lifts_at(loop(3.0), loop(0.0, seed=1))[1] == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_torque_goes_with_units_and_not_with_direction_or_origin(sign):
    torque, position = loop(3.0)
    (plain,) = lifts_at((torque, position))[1]
    (other,) = lifts_at((sign * 30.0 * torque, sign * position + 7.0))[1]
    assert other == pytest.approx(30.0 * plain, rel=1e-6)


@pytest.mark.skipif(not STAND.is_dir(), reason="the recordings of the test stand are not here")
@pytest.mark.parametrize("state", ["preload_increase_2", "preload_increase_3"])
def test_a_preloaded_gearbox_that_softens_nowhere_has_no_torque(state):
    """Its compliance falls from zero torque on at every position."""
    columns = {
        "time_s": ColumnSpec("TIME", "s"),
        "motor_position_rad": ColumnSpec("POSITION", "rev"),
        "motor_torque_nm": ColumnSpec("TORQUE", "N m"),
    }
    files = [STAND / "split_pinwheel_pc_cf" / f"{state}_{place}.csv.gz" for place in (1, 5, 6)]
    channels = [read_recording(file, columns=columns).channels for file in files]
    found, torque = lifts_at(*((c["motor_torque_nm"], c["motor_position_rad"]) for c in channels))
    assert found.finding == "preloaded"
    assert torque == []
