"""Recordings beside their simulation, those that were fitted and those that were held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.diagnosis.closed_loop.augment import augmented_bench, known_settings
from bayesbl.diagnosis.diagnosis import PieceSignals
from bayesbl.diagnosis.disagreement import PieceResiduals, Use, piece_residuals
from bayesbl.matching.alignment import aligned_starts
from bayesbl.matching.least_squares import fit_simulated
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import SimulatedSignals, Unknown, shift_unknowns, start_angle_unknown
from bayesbl.model_search.refit import Explanation
from bayesbl.recording.types import FloatArray


@dataclass(frozen=True, slots=True)
class SimulatedPair:
    """A recording beside its simulation before and after naming.

    Attributes
    ----------
    before, after
        Simulated channels, shape (c, n), in the channels' units.
    """

    seen: Observed
    use: Use
    before: FloatArray
    after: FloatArray


def simulated_pairs(
    nominal: Explanation, final: Explanation, held_out: Sequence[Observed]
) -> list[SimulatedPair]:
    """All recordings with both simulations; of held-out ones only start and phases are fitted."""
    found = []
    for i, seen in enumerate(final.fit.model.recordings):
        before, after = nominal.fit.simulated(i), final.fit.simulated(i)
        found.append(SimulatedPair(seen, "used", before, after))
    for seen in held_out:
        before, after = predicted(nominal, seen), predicted(final, seen)
        found.append(SimulatedPair(seen, "held_out", before, after))
    return found


def predicted(explanation: Explanation, seen: Observed) -> FloatArray:
    """What an explanation says of a recording that it was not fitted on, shape (c, n)."""
    fit = explanation.fit
    phases = [
        Unknown(u.name, recording=seen.name)
        for u in fit.model.unknowns
        if u.recording == fit.model.recordings[0].name and u.name.endswith("__phase_rad")
    ]
    bench = augmented_bench(explanation)
    named = {u.name for u in fit.model.unknowns}
    shifts = [
        unknown
        for term in bench.learned_terms
        if term.shift_slot in named
        for unknown in shift_unknowns(term, [seen.name])
    ]
    unknowns = [start_angle_unknown(seen.name), *phases, *shifts]
    model = SimulatedSignals(
        bench,
        [seen],
        unknowns,
        [noise_of(seen, seen.signals)],
        fit.model.workers,
        known_settings(explanation),
    )
    start = aligned_starts(model)[0]
    trials = [start]
    if phases:  # four quadrants, as a phase far off has no slope towards the right one
        trials = [start.copy() for _ in range(4)]
        for k, trial in enumerate(trials):
            trial[1 : 1 + len(phases)] = 0.5 * math.pi * k
    fits = [fit_simulated(model, trial) for trial in trials]
    return min(fits, key=lambda f: f.chi_square).simulated(0)


def signals_of(pair: SimulatedPair) -> list[PieceSignals]:
    """One entry for each channel; NaN where nothing was measured."""
    seen = pair.seen
    time = seen.begin_s + np.arange(seen.samples) / seen.sampling_hz
    measured = seen.signals
    if seen.excluded is not None:
        measured = np.where(seen.excluded, np.nan, measured)
    rows = zip(seen.channels, measured, pair.before, pair.after, strict=True)
    return [PieceSignals(seen.name, name, pair.use, time, *signals) for name, *signals in rows]


def residuals_of(pair: SimulatedPair) -> list[PieceResiduals]:
    """One entry for each channel, its RMS that of the samples that are compared."""
    scale = float(np.mean(pair.seen.compared)) ** -0.5
    before, after = (scale * pair.seen.left_by(made) for made in (pair.before, pair.after))
    return [
        piece_residuals(pair.seen.name, channel, pair.use, before[k], after[k], pair.seen.lag)
        for k, channel in enumerate(pair.seen.channels)
    ]
