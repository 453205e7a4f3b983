"""Where one value of a data sheet may be wrong by a unit: places from which a fit finds it.

A match climbs down from where it starts, and a value in kg cm² for kg m² is in another valley. So
the factor of each parameter is scanned on its own, the others as on the data sheet: the gap is
scanned and the start angles are aligned again at each place, as at the start of any match.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.bench.steady import contact_rates
from bayesbl.errors import BenchError
from bayesbl.identification.problem import Problem
from bayesbl.matching.alignment import aligned_starts
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.motions import noise_of
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.naming.candidates import Candidate
from bayesbl.naming.criteria import is_gross
from bayesbl.naming.explanation import BEHIND, SCANNED_GAPS, Explanation, extended
from bayesbl.recording.types import FloatArray

KG_CM2_PER_KG_M2 = 1e4

REACH = 3.0
"""Factor, up or down, that a fit may go from the place where it starts."""

STEP = 2.0
"""Between two factors scanned: within reach, so that a fit comes from both sides. With 3 a value
10⁴ times too large was not found on one joint of seven."""

FITTED = 4
"""Places that are fitted at most, the best of the scan."""

FASTEST_PER_S = 5e3
"""Rate of a speed loop or shaft (800 Hz) beyond which a place is not scanned: those of joints reach
some hundred Hz, and what is faster takes as much longer to simulate. A data sheet beyond it is
searched from afar first, and matched as any other where that finds nothing."""


@dataclass(frozen=True, slots=True)
class Place:
    """A point from which one parameter is fitted, its unknown last, and χ² there."""

    candidate: Candidate
    point: FloatArray
    chi_square: float


def furthest(problem: Problem) -> float:
    """Largest factor, up or down, by which a value is sought: of kg cm², or of r²."""
    return max(KG_CM2_PER_KG_M2, problem.bench.value("gear_ratio") ** 2)


def is_plausible(problem: Problem) -> bool:
    """Whether a joint can be as on the data sheet: few that are wrong by a unit pass for one."""
    model = _nothing_fitted(problem)
    return _can_be(model, np.array([u.middle for u in model.unknowns]))


def leaves_most(fit: SimulatedFit) -> bool:
    """Whether some channel of a recording is left with more than half of what it varies by.

    What a joint's bench lacks is smaller: the rest of it still turns, rings and follows gravity.
    """
    for index, seen in enumerate(fit.model.recordings):
        left = seen.left_by(fit.model.signals(fit.point, index)[0])
        varies = np.nanvar(seen.signals, axis=1)
        if np.any(np.nanmean(left**2, axis=1) > 0.5 * varies):
            return True
    return False


def explanations_from_afar(problem: Problem) -> list[Explanation]:
    """Rough fits of one parameter each from the best places, the others within tolerances."""
    model = _nothing_fitted(problem)
    places = sorted(_places(model, problem), key=lambda place: place.chi_square)
    fits: list[Explanation] = []
    for place in _apart(places)[:FITTED]:
        name = place.candidate.name
        if any(e.candidates[-1].name == name and not is_gross(e) for e in fits):
            continue
        beside = extended(model, place.candidate)
        with suppress(BenchError):
            fit = fit_simulated(beside, place.point, rough=True)
            fits.append(Explanation((place.candidate,), fit))
    return fits


def _nothing_fitted(problem: Problem) -> SimulatedSignals:
    noise = [noise_of(seen, seen.signals) for seen in problem.used]
    return SimulatedSignals(problem.bench, problem.used, problem.unknowns, noise, problem.workers)


def _apart(places: list[Place]) -> list[Place]:
    """Best first: those that leave little more than the best, none in reach of a better one."""
    kept: list[Place] = []
    for place in places:
        if place.chi_square > BEHIND * places[0].chi_square:
            break
        here = place.candidate
        reached = (
            k.candidate.name == here.name
            and abs(k.candidate.neutral[0] - here.neutral[0]) < math.log(REACH)
            for k in kept
        )
        if not any(reached):
            kept.append(place)
    return kept


def _places(model: SimulatedSignals, problem: Problem) -> Iterator[Place]:
    """Each parameter at factors of its value, the gap and start angles the best there."""
    steps = math.ceil(math.log(furthest(problem)) / math.log(STEP))
    factors = STEP ** np.arange(-steps, steps + 1.0)
    for name in problem.parameters:
        value = problem.bench.value(name)
        if value <= 0.0:
            continue
        for factor in factors:
            place = _place(model, name, float(factor * value))
            if place is not None:
                yield place


def _place(model: SimulatedSignals, name: str, value: float) -> Place | None:
    """The best gap and start angles with one parameter at this value; ``None`` if it cannot be."""
    at = math.log(value)
    unknown = Unknown(name, at - math.log(REACH), at + math.log(REACH), logarithmic=True)
    candidate = Candidate(name, "parameter", (unknown,), np.array([at]))
    beside = extended(model, candidate)
    middle = np.array([u.middle for u in beside.unknowns])
    if not _can_be(beside, middle):
        return None
    # Gaps of recordings of their own are scanned one by one, as aligned_starts does.
    own = [k for k, u in enumerate(beside.unknowns) if u.name == GAP and u.recording is None]
    gaps = {k: np.linspace(beside.low[k], beside.high[k], SCANNED_GAPS) for k in own}
    point = aligned_starts(beside, gaps)[0]
    residual = beside.whitened(point)[0]
    chi_square = float(residual @ residual)
    return Place(candidate, point, chi_square) if math.isfinite(chi_square) else None


def _can_be(model: SimulatedSignals, point: FloatArray) -> bool:
    """Whether its drive lifts its load, its loop forgets in time, and nothing is too fast.

    In a rotation, or a motion's recording: what does not forget would not repeat.
    """
    row = model.vectors(point[None], model.recordings[0])[0]
    lasting_s = max(
        seen.samples / seen.sampling_hz if seen.motion is not None else seen.rotation_period_s
        for seen in model.recordings
    )
    torque_nm = row[Slot.torque_constant_nm_per_a] * row[Slot.current_limit_a]
    if row[Slot.gravity_torque_nm] > row[Slot.gear_ratio] * torque_nm:
        return False
    slowest_per_s = -float(np.max(contact_rates(row[None]).real))
    return slowest_per_s * lasting_s > 1.0 and _fastest_per_s(row) < FASTEST_PER_S


def _fastest_per_s(row: FloatArray) -> float:
    """K_p/J_m, and of the shaft D_s/J and √(K_s/J) with 1/J = 1/J_l + 1/(r² J_m), the largest."""
    motor, ratio = row[Slot.motor_inertia_kg_m2], row[Slot.gear_ratio]
    shaft = 1.0 / row[Slot.load_inertia_kg_m2] + 1.0 / (ratio**2 * motor)
    loop = row[Slot.speed_gain_nm_s_per_rad] / motor
    damped = row[Slot.shaft_damping_nm_s_per_rad] * shaft
    swinging = math.sqrt(row[Slot.shaft_stiffness_nm_per_rad] * shaft)
    return float(max(loop, damped, swinging))
