"""What could be missing, as it is handed to the search."""

from __future__ import annotations

import numpy as np

from bayesbl.config.bench import reference_bench
from bayesbl.matching.observed import observed
from bayesbl.naming.candidates import candidates
from bayesbl.naming.motor_orders import OrderPeak


def test_candidates_of_one_name_are_told_apart() -> None:
    """Ripples of two orders hold arrays, which have no truth value when compared."""
    bench = reference_bench()
    made = bench.simulate(8e-4, rotations=2.0, seed=np.random.default_rng(1))
    peaks = [OrderPeak(order, 1.0) for order in (1.0, 2.0, 6.0)]
    found = candidates(bench, [observed(made, bench)], "all", peaks)
    ripples = [c for c in found if c.name == "motor_torque_ripple"]
    assert len({c.key for c in ripples}) == 3
    assert [found.index(c) for c in ripples] == [i for i, c in enumerate(found) if c in ripples]
