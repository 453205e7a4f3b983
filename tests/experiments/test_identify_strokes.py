"""A joint that only strokes and whose sheet lacks its friction, by the independent simulator."""

from __future__ import annotations

import math

import numpy as np
import pytest
from identify import FAST_DIRECT, GAP_RANGE_RAD, STROKES_ALONE, data_sheet, stroked

from bayesbl.config.bench import reference_bench
from bayesbl.identification.groups import reason_of
from bayesbl.identification.identify import Problem, identify
from bayesbl.matching.signals import GAP
from bayesbl.model_search.always_in import with_friction

GAP_RAD = 8e-4
FRICTION = {
    "motor_coulomb_friction__torque_nm": 0.12,
    "motor_viscous_friction__coefficient_nm_s_per_rad": 4e-4,
}


@pytest.mark.long
def test_friction_of_strokes_alone_is_measured_though_it_is_another_at_rest() -> None:
    """Always in, as in a run; gap and sizes within 3.5 sd: by chance once in 700 seeds."""
    joint, rng = reference_bench(), np.random.default_rng(12)
    sheet, _ = data_sheet(joint, 0.0, rng)
    seen = [
        stroked(joint, GAP_RAD, f"{number}", rng, pace, reach, **FRICTION)
        for number, (pace, reach) in enumerate(STROKES_ALONE)
    ]
    sheet = with_friction(sheet, seen)
    problem = Problem(sheet, tuple(seen), (), tuple(sheet.tolerances), "catalogue", GAP_RANGE_RAD)
    found = identify(problem, FAST_DIRECT, np.random.SeedSequence(3))
    assert reason_of(found) is None
    for name, value in ({GAP: math.log(GAP_RAD)} | FRICTION).items():
        draws = found.posterior.values(name, seen[0].name if name == GAP else None)
        draws = np.log(draws) if name == GAP else draws
        assert abs(draws.mean() - value) < 3.5 * draws.std(), name
