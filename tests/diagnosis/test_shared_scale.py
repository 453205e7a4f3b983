"""What is read through a torque constant is no better known than it is."""

from __future__ import annotations

import math

import pytest

from bayesbl.diagnosis.diagnosis import Estimate
from bayesbl.diagnosis.inference import with_shared_scale

UNITS = {"torque_nm": "N m", "speed_rad_per_s": "rad/s", "motor_inertia_kg_m2": "kg m²"}


def test_torques_and_inertias_take_the_relative_error_and_speeds_do_not():
    estimates = {
        "torque_nm": Estimate(0.5, 0.03),
        "speed_rad_per_s": Estimate(20.0, 1.0),
        "motor_inertia_kg_m2": Estimate(2e-3, 0.0),
    }
    found = with_shared_scale(estimates, UNITS, 0.08)
    assert found["torque_nm"].sd == pytest.approx(math.hypot(0.03, 0.04))
    assert found["speed_rad_per_s"].sd == 1.0
    assert found["motor_inertia_kg_m2"].sd == pytest.approx(1.6e-4)


def test_a_factor_that_is_known_changes_nothing():
    parameters = {"motor_inertia_kg_m2": Estimate(2e-3, 1e-5)}
    assert with_shared_scale(parameters, UNITS, 0.0) == parameters
