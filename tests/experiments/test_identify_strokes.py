"""A joint that only strokes and whose sheet lacks its friction, by the independent simulator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from identify import (
    DWELL_S,
    FAST_DIRECT,
    GAP_RANGE_RAD,
    STROKES_ALONE,
    STROKES_RAD,
    STROKES_RPM,
    acceleration_rpm_per_s,
    data_sheet,
)
from independent_bench import plant, simulate_moving, strokes

from bayesbl.config.bench import reference_bench
from bayesbl.identification.identify import identify
from bayesbl.identification.problem import Problem
from bayesbl.identification.verdict import reason_of
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP

GAP_RAD, COULOMB_NM, VISCOUS = 8e-4, 0.12, 4e-4


@pytest.mark.long
def test_friction_of_strokes_alone_is_named_though_it_is_another_at_rest() -> None:
    """Both frictions and no drift; gap and sizes within 3.5 sd: by chance once in 700 seeds."""
    joint, rng = reference_bench(), np.random.default_rng(12)
    sheet, _ = data_sheet(joint, 0.0, rng)
    values = {name: joint.value(name) for name in joint.parameters} | {
        "gap_rad": GAP_RAD,
        "motor_coulomb_friction__torque_nm": COULOMB_NM,
        "motor_viscous_friction__coefficient_nm_s_per_rad": VISCOUS,
    }
    seen = []
    for number, (pace, reach) in enumerate(STROKES_ALONE):
        way = reach * STROKES_RAD[0], reach * STROKES_RAD[1]
        asked = strokes(
            joint.value("gear_ratio"),
            way,
            pace * STROKES_RPM,
            pace**2 * acceleration_rpm_per_s(joint),
            DWELL_S,
        )
        made = simulate_moving(
            plant(values | {"start_angle_rad": way[0]}), asked, 10.0, rng, name=f"{number}"
        )
        seen.append(observed(made.recording, joint))
    problem = Problem(
        sheet, tuple(seen), (), tuple(sheet.tolerances), "catalogue", GAP_RANGE_RAD, shares_gap=True
    )
    found = identify(problem, FAST_DIRECT, np.random.SeedSequence(3))
    assert set(found.missing) == {("motor_coulomb_friction",), ("motor_viscous_friction",)}
    assert reason_of(found, problem) is None
    truth = {
        GAP: math.log(GAP_RAD),
        "motor_coulomb_friction__torque_nm": COULOMB_NM,
        "motor_viscous_friction__coefficient_nm_s_per_rad": VISCOUS,
    }
    for name, value in truth.items():
        draws = found.posterior.values(name)
        draws = np.log(draws) if name == GAP else draws
        assert abs(draws.mean() - value) < 3.5 * draws.std(), name
