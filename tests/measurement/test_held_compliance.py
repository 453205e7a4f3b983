"""A width that friction and compliance explain is not told as wear."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.measurement.ramp_route import (
    CHANGED_SD,
    HELD,
    SOFTER,
    HeldCompliance,
    compliance_check,
)
from bayesbl.sentences import sentence

RNG = np.random.default_rng(1)
CYCLES = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])


def snapshot(
    delta_mrad: float, held_mrad: float, friction_nm: float = 2.0, round_the_turn=(1.0,)
) -> HeldCompliance:
    """A joint, each known to 2 %, at positions whose friction and compliance go as given."""
    values = {
        "delta_rad": 1e-3 * delta_mrad,
        "held_windup_rad": 1e-3 * held_mrad,
        "compliance_rad_per_nm": 1e-3,
        "friction_torque_nm": friction_nm,
    }
    draws = {name: v * (1.0 + 0.02 * RNG.standard_normal(4000)) for name, v in values.items()}
    measured = {
        name: [v * at * (1.0 + 0.02 * CYCLES[n:]) for n, at in enumerate(round_the_turn)]
        for name, v in values.items()
    }
    return HeldCompliance(draws, measured)


@pytest.mark.parametrize(
    ("before", "after", "error_mrad"),
    [
        ((5.0, 1.0), (6.0, 1.4), HELD * 0.4),  # wider, as friction holds more
        ((5.0, 1.4), (6.0, 1.0), None),  # it holds less, so the width would have fallen
        ((6.0, 1.4), (5.0, 1.0), HELD * 0.4),  # narrower, as it holds less
        ((5.0, 1.0), (6.0, 1.0), None),  # nothing changed but the width
    ],
)
def test_what_is_held_explains_a_width_of_its_own_sign_alone(before, after, error_mrad):
    check = compliance_check(snapshot(*before), snapshot(*after, friction_nm=3.0))
    *others, always = check["blind_spots"]
    assert always == SOFTER
    errors = [spot["delta_error_rad"] for spot in others]
    assert len(errors) == (error_mrad is not None)
    if error_mrad is not None:
        assert errors[0] == pytest.approx(1e-3 * error_mrad, rel=0.02)
        text = sentence(check["blind_spots"][0])
        assert "friction of 3 instead of 2 N m" in text
        assert "compliance of" not in text


def test_one_snapshot_is_compared_with_nothing():
    only = snapshot(5.0, 1.0)
    assert not compliance_check(only, only)["items"]


@pytest.mark.parametrize("round_the_turn", [(1.0,) * 3, (1.0, 1.4, 0.6), (0.3, 1.0, 1.7)])
def test_a_pattern_round_the_turn_that_stays_hides_no_change(round_the_turn):
    before = snapshot(5.0, 1.0, 2.0, round_the_turn)
    after = snapshot(6.0, 1.4, 3.0, round_the_turn)
    compliance, friction = compliance_check(before, after)["items"]
    assert friction["z"] > CHANGED_SD > abs(compliance["z"])


def test_positions_that_are_not_the_same_tell_no_change_within_their_scatter():
    before = snapshot(5.0, 1.0, 2.0, (1.0, 1.4, 0.6))
    after = snapshot(6.0, 1.4, 3.0, (0.6, 1.0, 1.4))
    assert all(abs(item["z"]) < CHANGED_SD for item in compliance_check(before, after)["items"])


def test_one_cycle_tells_no_scatter_and_so_no_change():
    before, after = (
        HeldCompliance(s.draws, {name: [v[0][:1]] for name, v in s.measured.items()})
        for s in (snapshot(5.0, 1.0, 2.0), snapshot(6.0, 1.4, 3.0))
    )
    assert all(item["z"] == 0.0 for item in compliance_check(before, after)["items"])
