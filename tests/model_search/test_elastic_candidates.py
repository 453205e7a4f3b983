"""Elastic parts as hypotheses: which frequencies are sought."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesbl.bench.effects import effect_named
from bayesbl.config.bench import reference_bench
from bayesbl.matching.observed import Observed, observed
from bayesbl.model_search.catalogue import candidates

BENCH = reference_bench()
PARTS = ("belt", "arm", "base")


def _recorded(sampling_hz: float) -> Observed:
    made = BENCH.simulate(
        8e-4,
        rotations=3,
        sampling_hz=sampling_hz,
        seed=np.random.default_rng(5),
        name=f"{sampling_hz:g} Hz",
    )
    return observed(made, BENCH)


@pytest.mark.parametrize("sampling_hz", [100.0, 250.0, 1000.0])
def test_no_part_is_sought_beyond_what_the_recorder_resolves(sampling_hz: float) -> None:
    """The highest frequency that a hypothesis allows, at the inertia that makes it lowest."""
    parts = [c for c in candidates(BENCH, [_recorded(sampling_hz)], PARTS) if c.name in PARTS]
    assert {c.name for c in parts} == set(PARTS)
    for part in parts:
        resonance = effect_named(part.name).resonance
        assert resonance is not None
        ranges = {u.name.partition("__")[2]: (u.low, u.high) for u in part.unknowns}
        stiffest, _ = ranges["compliance_rad_per_nm"]
        inertia = max(start[list(ranges).index(resonance.part)] for start in part.starts)
        if resonance.is_share:
            inertia *= (1.0 - inertia) * BENCH.value(resonance.inertia)
        highest_hz = 1.0 / (2.0 * math.pi * math.sqrt(stiffest * inertia))
        assert highest_hz <= 0.5 * sampling_hz * (1.0 + 1e-9)
