"""What could be missing, as it is handed to the search, and explanations by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesbl.bench.bench import BenchEffect, EffectParameterValue
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import gap_unknown, start_angle_unknown
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.joint_change import _own_effects
from bayesbl.model_search.refit import Explanation


def test_candidates_of_one_name_are_told_apart() -> None:
    """Ripples of two orders hold arrays, which have no truth value when compared."""
    bench = reference_bench()
    made = bench.simulate(8e-4, rotations=2.0, seed=np.random.default_rng(1))
    peaks = [1.0, 2.0, 6.0]
    found = candidates(bench, [observed(made, bench)], "all", peaks)
    ripples = [c for c in found if c.name == "motor_torque_ripple"]
    assert len({c.key for c in ripples}) == 3
    assert [found.index(c) for c in ripples] == [i for i, c in enumerate(found) if c in ripples]


def test_every_parameter_of_an_effect_may_have_changed() -> None:
    """A search keeps candidates by their keys: none may replace another."""
    control = BenchEffect("sampled_control", {"period_s": EffectParameterValue(1e-3)})
    changed = _own_effects(reference_bench().with_effects(control))
    by_key = {candidate.key: candidate for candidate in changed}
    names = {unknown.name for candidate in by_key.values() for unknown in candidate.unknowns}
    parameters = ("period_s", "delay_periods", "instant_share")
    assert names == {f"sampled_control__{parameter}" for parameter in parameters}


def test_explanations_by_the_same_names_are_told_apart() -> None:
    bench = reference_bench()
    seen = observed(bench.simulate(8e-4, rotations=2.0, seed=np.random.default_rng(1)), bench)
    unknowns = [gap_unknown(1e-4, 1e-2), start_angle_unknown(seen.name)]
    fit = fit_aligned(bench, [seen], unknowns)
    first, second = Explanation((), fit), Explanation((), replace(fit))
    assert [first, second].index(second) == 1
