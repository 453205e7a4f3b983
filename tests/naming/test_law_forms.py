"""A shaft whose law has another form than the catalogue's, on data of the independent simulator."""

from __future__ import annotations

import math
from functools import partial
from types import ModuleType

import numpy as np
from bayesbl.naming.candidates import candidates
from bayesbl.naming.law_forms import form_sd, is_within_form
from bayesbl.naming.search import name_missing

from bayesbl.bench.parameters import BENCH_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP, gap_unknown, start_angle_unknown

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
