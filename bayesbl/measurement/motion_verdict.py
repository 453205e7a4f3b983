"""What a motion shows of its gap, and what it does not."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.motions import flank_changes, remembered_start
from bayesbl.matching.observed import standstills
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.signals import GAP, REFERENCE_DELAY
from bayesbl.measurement.measurement import UPPER_BOUND_LEVEL
from bayesbl.units import RPM_PER_RAD_PER_S

EXCLUDED_END = 0.1
EXCLUDED_SHARE = 0.01
"""Less than this share of the posterior in this share of the range of ln δ, at an end: the
recording excludes that end, and there is a bound. A flat posterior has a tenth there."""

REMEMBERED = 1.0
"""χ² left of an unknown start in what is compared: one standard deviation of δ at most."""


def unseen_gap(posterior: DirectPosterior, index: int) -> str | None:
    """Why a motion does not tell δ of a recording, with the bound that it leaves; ``None`` if it
    does, or turns at one speed."""
    fit = posterior.fit
    seen = fit.model.recordings[index]
    if seen.motion is None or flank_changes(fit, index):
        return None
    asked = largest_pull(fit, index)
    sentences = [
        "In this motion the load never passes from one tooth flank to the other, so δ leaves no "
        "trace that could be measured.",
        _bound(posterior, index),
        "Record a motion that takes the load through the angle at which gravity's torque changes "
        "its sign (hanging straight down or standing upright), or one that brakes and accelerates "
        f"the load harder than gravity pulls at it: here by more than {asked:.3g} rpm/s of the "
        "motor."
        if asked > 0.0
        else "Record a motion that brakes and accelerates the load both ways.",
        "`bayesbl plan --bench FILE` ranks motions.",
    ]
    return " ".join(filter(None, sentences))


def unknown_start(fit: SimulatedFit, index: int) -> str | None:
    """Why how a motion began keeps δ unknown; ``None`` if it does not."""
    seen = fit.model.recordings[index]
    if seen.motion is None or remembered_start(fit, index)[seen.first_compared] <= REMEMBERED:
        return None
    return (
        "The flank at the start of the recording is unknown, because nothing presses the teeth "
        "together there, and the compared part still depends on it. Record the same motion for "
        "longer, or begin where gravity presses the load against its flank."
    )


def largest_pull(fit: SimulatedFit, index: int) -> float:
    """Acceleration of the motor, rpm/s, that would lift the load off its flank where that is
    easiest in this motion: N |m g l sin(θ + φ_g)| / J_l at its smallest."""
    model, seen = fit.model, fit.model.recordings[index]
    assert seen.motion is not None
    row = model.vectors(fit.point[None], seen)[0]
    time = np.arange(seen.samples) / seen.sampling_hz
    angle = row[Slot.start_angle_rad] + seen.motion.position_rad(time) / row[Slot.gear_ratio]
    pull = np.abs(row[Slot.gravity_torque_nm] * np.sin(angle + row[Slot.gravity_angle_rad]))
    least = row[Slot.gear_ratio] * pull.min() / row[Slot.load_inertia_kg_m2]
    return float(least * RPM_PER_RAD_PER_S)


def _bound(posterior: DirectPosterior, index: int) -> str | None:
    """The one-sided bound that the posterior leaves, in words; ``None`` where it leaves none."""
    name = posterior.fit.model.recordings[index].name
    draws = posterior.values(GAP, name).ravel()
    match excluded_ends(posterior, name):
        case True, False:
            side, share = "larger", 1.0 - UPPER_BOUND_LEVEL
        case False, True:
            side, share = "smaller", UPPER_BOUND_LEVEL
        case _:
            return None
    bound_rad = float(np.quantile(draws, share))
    return f"It is {side} than {1e3 * bound_rad:.2g} mrad ({UPPER_BOUND_LEVEL:.0%})."


def excluded_ends(posterior: DirectPosterior, recording: str) -> tuple[bool, bool]:
    """Whether a recording excludes the lower, and the upper, end of the range of its δ."""
    model = posterior.fit.model
    place = model.index(GAP, recording)
    unknown, draws = model.unknowns[place], posterior.draws[..., place]
    end = EXCLUDED_END * (unknown.high - unknown.low)
    at_low = float(np.mean(draws < unknown.low + end))
    at_high = float(np.mean(draws > unknown.high - end))
    return at_low < EXCLUDED_SHARE, at_high < EXCLUDED_SHARE


def motion_notes(fit: SimulatedFit, index: int) -> list[str]:
    """What a reader has to know of how a motion was compared."""
    seen = fit.model.recordings[index]
    if seen.motion is None:
        return []
    notes = []
    if seen.cycle is None:
        notes.append(
            "The motion does not repeat, so the noise is taken from what is faster than the "
            "motion, and only slow disagreement with the bench can be seen: a motion recorded "
            "twice or more in a row is checked better."
        )
    if all(u.name != REFERENCE_DELAY for u in fit.model.unknowns):
        notes.append(
            "The reference is taken as held from each sample to the next, as a digital drive has "
            "it: a straight line between samples does not explain the recording."
        )
    begin = seen.first_compared
    stands = standstills(seen, fit.model.bench)[begin:]
    if seen.excluded is not None and stands.any() and seen.excluded[begin:][stands].all():
        notes.append("Standstills are left out, because friction at rest is not that of motion.")
    if begin > 0:
        notes.append(
            f"The first {begin / seen.sampling_hz:.2g} s are left out, because the state "
            "of teeth and controller at the start is unknown."
        )
    return notes
