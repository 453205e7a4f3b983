"""A candidate replaced by a simpler one that it holds."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from bayesbl.naming.candidates import candidates, held_by
from bayesbl.naming.explanation import explain, nominal_explanation, polished, simplified

from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import gap_unknown, start_angle_unknown

HELD = ["friction_drift", "motor_coulomb_friction", "load_viscous_friction"]


@pytest.fixture(scope="module")
def fitted(independent: ModuleType):
    """A joint with friction of the motor, as believed, and candidates by name."""
    bench = reference_bench()
    believed = {info.name: bench.value(info.name) for info in BENCH_PARAMETERS}
    made = independent.random_recordings(
        believed,
        {"motor_coulomb_friction__torque_nm": 0.1},
        np.random.default_rng(7),
        speeds_rpm=(2000.0, -1200.0),
        rotations=3.0,
    )
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(1e-4, 4e-3), *(start_angle_unknown(s.name) for s in seen)]
    found = {c.name: c for c in candidates(bench, seen, HELD)}
    return nominal_explanation(fit_aligned(bench, seen, unknowns)), found


def test_it_is_the_fit_that_the_simpler_one_has_by_itself(fitted) -> None:
    nominal, found = fitted
    drift, coulomb = found["friction_drift"], found["motor_coulomb_friction"]
    assert held_by(drift) == (coulomb.name, None)
    assert held_by(coulomb) is None
    alone = polished(explain(nominal, coulomb))
    one = simplified(nominal, polished(explain(nominal, drift)), 0, coulomb)
    assert one.names == (coulomb.name,)
    # Two fits end within 1e-2 of χ² of their optimum each.
    assert one.fit.chi_square == pytest.approx(alone.fit.chi_square, abs=0.1)


def test_the_others_keep_their_places(fitted) -> None:
    nominal, found = fitted
    drift, other = found["friction_drift"], found["load_viscous_friction"]
    for first, second, place in ((drift, other, 0), (other, drift, 1)):
        both = polished(explain(explain(nominal, first), second))
        one = simplified(nominal, both, place, found["motor_coulomb_friction"])
        names = [first.name, second.name]
        names[place] = "motor_coulomb_friction"
        assert list(one.names) == names
        # A drift that is not there gains what its one unknown gains by chance.
        assert 0.0 <= one.fit.chi_square - both.fit.chi_square < 11.0
