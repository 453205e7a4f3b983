"""A shaft whose law has another form than the catalogue's, on data of the independent simulator."""

from __future__ import annotations

import math
from functools import partial
from types import ModuleType

import numpy as np
import pytest

from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.predictive_check import agrees, disagreements
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown
from bayesbl.naming.candidates import candidates
from bayesbl.naming.explanation import nominal_explanation
from bayesbl.naming.law_forms import UnnamedLaw, form_sd, is_within_form, unnamed_law
from bayesbl.naming.search import name_missing

GAP_RAD = 3.4e-3
SPEEDS_RPM = (2000.0, -2000.0, 1200.0)
BOUC_WEN_NM = 6.3
"""Of a law that reaches its torque faster than Dahl's: tanh for an exponential."""


def test_a_law_of_another_form_is_named_alone(independent: ModuleType) -> None:
    """Shaft stiffness was named beside the hysteresis before: it mended what Dahl's law left."""
    bench = reference_bench()
    believed = {info.name: bench.value(info.name) for info in BENCH_PARAMETERS}
    rng = np.random.default_rng(48)
    made = independent.random_recordings(
        believed,
        {"outside__bouc_wen_nm": BOUC_WEN_NM},
        rng,
        gap_rad=(GAP_RAD, GAP_RAD),
        speeds_rpm=SPEEDS_RPM,
    )
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(1e-4, 1e-2), *(start_angle_unknown(s.name) for s in seen)]
    naming = name_missing(
        fit_aligned(bench, seen, unknowns), partial(candidates, bench, seen, "all")
    )
    assert naming.final.names == ("shaft_hysteresis",)
    assert is_within_form(naming)
    fit = naming.final.fit
    place = fit.model.index(GAP)
    own = float(np.sqrt(fit.covariance[place, place]))
    error = float(fit.point[place]) - math.log(GAP_RAD)
    assert abs(error) < 2.6 * math.hypot(own, form_sd(naming))  # one false alarm in a hundred


SMALL_GAP_RAD = 2.3e-4


def weakly_damped(
    independent: ModuleType, strength: float, seed: int
) -> tuple[float, bool, UnnamedLaw | None]:
    """Error of ln δ in deviations, whether the check passes, and what may have moved δ.

    The contact damps by the root of its compression besides, by so many N m s/rad.
    """
    bench = reference_bench()
    made = independent.random_recordings(
        {info.name: bench.value(info.name) for info in BENCH_PARAMETERS},
        {"outside__contact_damping_nm_s_per_rad": strength},
        np.random.default_rng(seed),
        gap_rad=(SMALL_GAP_RAD, SMALL_GAP_RAD),
        speeds_rpm=SPEEDS_RPM,
    )
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(1e-4, 4e-3), *(start_angle_unknown(s.name) for s in seen)]
    fit = fit_aligned(bench, seen, unknowns)
    law = unnamed_law(nominal_explanation(fit), candidates(bench, seen, "all"))
    sd = math.hypot(fit.sd(GAP), 0.0 if law is None else law.moves)
    error = math.log(fit.value(GAP) / SMALL_GAP_RAD) / sd
    return error, agrees(disagreements(fit)), law


@pytest.mark.parametrize("seed", [1, 2])
def test_a_damping_that_only_the_gap_shows_widens_its_interval(
    independent: ModuleType, seed: int
) -> None:
    """Nothing repeats that noise does not explain, and δ is two or three deviations too small."""
    error, passes, law = weakly_damped(independent, 1000.0, seed)
    assert passes
    assert law is not None
    assert "damping" in law.name
    assert abs(error) < 1.645


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_shaft_as_believed_widens_nothing(independent: ModuleType, seed: int) -> None:
    """Of six laws, each by chance once in a hundred."""
    error, passes, law = weakly_damped(independent, 0.0, seed)
    assert passes
    assert law is None
    assert abs(error) < 3.0
