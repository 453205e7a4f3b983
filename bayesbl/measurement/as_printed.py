"""The paper's own search and model: what they give of a recording, and why no δ is read off it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayesbl.curve.gap_curve import GapCurve, published_curve
from bayesbl.measurement.measurement import Reason
from bayesbl.ringing.estimator import Fit, PointEstimate
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.refine import refine
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.ringing.table_2 import BoxSearch

WAVE_MATTERS = 0.5
"""Standard deviations of A by which a load-angle harmonic may move it.

An estimate that is off by half of its standard deviation is still held by 86 % of intervals of
90 %; by a whole one, 74 %.
"""


def reasons_as_printed(fit: Fit, curve: GapCurve | None) -> Iterator[Reason]:
    """Why the answer of the paper's search, or by the paper's model, is withheld."""
    point = fit.point
    box = point.optimum.box_search
    if box is not None and not has_pulses_of_optimum(box, point):
        values = {
            "searched": box.searched,
            "amplitude_rpm": box.symbols[AMPLITUDE],
            "rmse_rpm": box.rmse_rpm,
            "gap_as_printed_rad": gap_as_printed_rad(box),
            "optimum_amplitude_rpm": point.optimum.symbols[AMPLITUDE],
            "optimum_rmse_rpm": point.optimum.rmse_rpm,
        }
        yield Reason("box_search_missed", values, withholds=True)
    without = point.optimum.model.baseline_harmonics == 0
    if without and curve is not None and curve.fingerprint is None:
        alone, beside = point.optimum.symbols[AMPLITUDE], amplitude_with_baseline_rpm(point)
        if abs(beside - alone) > WAVE_MATTERS * math.sqrt(fit.point.spread.sandwich[0, 0]):
            values = {"amplitude_rpm": alone, "with_baseline_rpm": beside}
            yield Reason("no_baseline", values, withholds=True)


def has_pulses_of_optimum(box: BoxSearch, point: PointEstimate) -> bool:
    """Whether a search in Table 2's ranges found the pulses of the optimum."""
    return box.has_pulses_of(point.optimum.symbols, point.objective.duration_s)


def gap_as_printed_rad(box: BoxSearch) -> float:
    """Eq. 4 at the amplitude found, whatever its sign and however far beyond the curve's range."""
    return float(published_curve(draws=1).gap(np.array(abs(box.symbols[AMPLITUDE]))))


def amplitude_with_baseline_rpm(point: PointEstimate) -> float:
    """A at the optimum next to this one where one load-angle harmonic is fitted beside the pulses.

    A symbol's range holds there too.
    """
    own = point.objective
    objective = Objective(
        replace(own.model, baseline_harmonics=1),
        own.time_s,
        own.speed_rpm,
        excluded=None if own.used.all() else ~own.used,
    )
    end = refine(objective, point.optimum.searched)
    return float(objective.solve(end[None]).coefficients[0, -1])
