"""What is read through a torque constant is no better known than it is."""

from __future__ import annotations

import math

import pytest

from bayesbl.diagnosis.diagnosis import Estimate, NamedEffect
from bayesbl.diagnosis.inference import scaled_parameters, with_shared_scale


def test_torques_and_inertias_take_the_relative_error_and_speeds_do_not():
    stribeck = NamedEffect(
        "motor_stribeck_friction",
        {"torque_nm": Estimate(0.5, 0.03), "speed_rad_per_s": Estimate(20.0, 1.0)},
        0.99,
        9.0,
    )
    found = with_shared_scale(stribeck, 0.08).parameters
    assert found["torque_nm"].sd == pytest.approx(math.hypot(0.03, 0.04))
    assert found["speed_rad_per_s"].sd == 1.0
    inertia = scaled_parameters({"motor_inertia_kg_m2": Estimate(2e-3, 0.0)}, 0.08)
    assert inertia["motor_inertia_kg_m2"].sd == pytest.approx(1.6e-4)


def test_a_factor_that_is_known_changes_nothing():
    parameters = {"motor_inertia_kg_m2": Estimate(2e-3, 1e-5)}
    assert scaled_parameters(parameters, 0.0) == parameters
