"""Where one value of a data sheet may be wrong by far: places from which a fit finds it.

A match climbs down from where it starts, and a value in kg cm² for kg m² is in another valley. So
the factor of each parameter is scanned on its own, from the middle of the data sheet. What is left
there says little: gravity's current makes nearly all of it, and is off by the tolerances of others.
Places are ranked by what one step of all unknowns, within their ranges, promises to leave.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.bench.steady import contact_rates
from bayesbl.errors import SimulationError
from bayesbl.identification.problem import Problem
from bayesbl.matching.alignment import aligned_starts
from bayesbl.matching.least_squares import fit_simulated, promised_within
from bayesbl.matching.motions import noise_of
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.model_search.catalogue import Candidate
from bayesbl.model_search.constants import LEAVES_MOST, SLACK
from bayesbl.model_search.refit import SCANNED_GAPS, Explanation, extended
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray

KG_CM2_PER_KG_M2 = 1e4

STEP = math.sqrt(10.0)
"""Between two factors scanned: two in a decade. The promise falls over more than that to either
side of the true value. At one in a decade a stiffness between two places was not found."""

REACH = STEP**2
"""Factor, up or down, that a fit may go: to the next place but one. Without an end, fits of what is
not wrong ran off to where a joint takes minutes to simulate."""

FASTEST_PER_S = 5e3
"""Rate of a speed loop or shaft (800 Hz) beyond which a place is not scanned: those of joints reach
some hundred Hz, and what is faster takes as much longer to simulate. A data sheet beyond it is
searched from afar first, and matched as any other where that finds nothing."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fit of one parameter begins, its unknown last, and χ² beyond noise promised."""

    candidate: Candidate
    point: FloatArray
    left: float


def freed(name: str, value: float) -> Candidate:
    """A parameter on its own, sought about a value."""
    at, reach = math.log(value), math.log(REACH)
    unknown = Unknown(name, at - reach, at + reach, logarithmic=True)
    usual = np.array([math.log(STEP)])
    return Candidate(name, "parameter", (unknown,), np.array([at]), usual=usual)


def is_plausible(problem: Problem) -> bool:
    """Whether a joint can be as on the data sheet: few that are wrong by a unit pass for one."""
    model = _nothing_fitted(problem)
    return _can_be(model, _middle(model))


def may_be_wrong_by_far(problem: Problem) -> bool:
    """Whether a value that is wrong by far is sought before effects.

    Recordings of motions take so long to scan that all else is sought first; so are effects that
    are asked for.
    """
    asked = problem.effects not in ("catalogue", ())
    return not asked and all(seen.motion is None for seen in problem.used)


def explanations_from_afar(problem: Problem, progress: Progress) -> list[Explanation]:
    """Rough fits of one parameter each from its best place, the others within tolerances.

    Of all parameters that contend: a promise is off by as much as signals bend. ``progress``:
    called with (places scanned, places in all).
    """
    model = _nothing_fitted(problem)
    candidates = _candidates(problem)
    best: dict[str, Place] = {}
    for scanned, candidate in enumerate(candidates):
        progress(scanned, len(candidates))
        place = _place(model, candidate)
        known = best.get(candidate.name)
        if place is not None and (known is None or place.left < known.left):
            best[candidate.name] = place
    least = min((place.left for place in best.values()), default=math.inf)
    fits: list[Explanation] = []
    for place in best.values():
        if place.left < LEAVES_MOST * max(least, 0.0) + SLACK:
            with suppress(SimulationError):
                beside = extended(model, place.candidate)
                fit = fit_simulated(beside, place.point, rough=True)
                fits.append(Explanation((place.candidate,), fit))
    return fits


def _nothing_fitted(problem: Problem) -> SimulatedSignals:
    noise = [noise_of(seen, seen.signals) for seen in problem.used]
    return SimulatedSignals(problem.bench, problem.used, problem.unknowns, noise, problem.workers)


def _middle(model: SimulatedSignals) -> FloatArray:
    return np.array([u.middle for u in model.unknowns])


def _candidates(problem: Problem) -> list[Candidate]:
    """Each parameter at factors of its value, up and down to the largest that is sought."""
    largest = max(KG_CM2_PER_KG_M2, problem.bench.value("gear_ratio") ** 2)
    most = math.ceil(math.log(largest) / math.log(STEP))
    values = {name: problem.bench.value(name) for name in problem.parameters}
    return [
        freed(name, value * STEP**step)
        for name, value in values.items()
        if value > 0.0
        for step in range(-most, most + 1)
    ]


def _place(model: SimulatedSignals, candidate: Candidate) -> Place | None:
    """The best gap and start angles with one parameter at a value; ``None`` if it cannot be."""
    beside = extended(model, candidate)
    at = float(candidate.neutral[0])
    if not _can_be(beside, np.append(_middle(model), at)):
        return None
    # Gaps of recordings of their own are scanned one by one, as aligned_starts does.
    own = [k for k, u in enumerate(beside.unknowns) if u.name == GAP and u.recording is None]
    grids = {k: np.linspace(beside.low[k], beside.high[k], SCANNED_GAPS) for k in own}
    point = aligned_starts(beside, grids | {len(beside.unknowns) - 1: np.array([at])})[0]
    low, high = beside.low, beside.high
    low[-1], high[-1] = at - math.log(STEP), at + math.log(STEP)
    left = promised_within(beside, point, low, high) - beside.size
    return Place(candidate, point, left) if math.isfinite(left) else None


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
