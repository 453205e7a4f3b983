"""Recorded motions matched where the bench can be believed: without standstills, or held."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from bayesbl.errors import RecordingError
from bayesbl.matching.alignment import refitted
from bayesbl.matching.least_squares import SimulatedFit
from bayesbl.matching.observed import Observed, with_held_reference, without_standstill
from bayesbl.matching.predictive_check import is_explained
from bayesbl.matching.signals import REFERENCE_DELAY


def believed(fit: SimulatedFit) -> SimulatedFit:
    """The fit, or the first of three others of its motions that the check passes where it does not.

    A digital drive holds its reference from sample to sample; and what friction does at a
    standstill is not what it does in motion.
    """
    if is_explained(fit) or not _moves(fit):
        return fit
    for other in _others(fit):
        if is_explained(other):
            return other
    return fit


def _others(fit: SimulatedFit) -> Iterator[SimulatedFit]:
    """Without standstills, with a held reference, and both."""
    moving = in_motion(fit)
    if moving is not None:
        yield moving
    yield _held(fit)
    if moving is not None:
        yield _held(moving)


def in_motion(fit: SimulatedFit) -> SimulatedFit | None:
    """The fit without its motions' standstills; ``None`` where that leaves too little or all."""
    moving = [without_standstill(seen, fit.model.bench) for seen in fit.model.recordings]
    if _compared(moving) == _compared(fit.model.recordings):
        return None
    with suppress(RecordingError):
        return refitted(replace(fit.model, recordings=moving), fit)
    return None


def _held(fit: SimulatedFit) -> SimulatedFit:
    model = fit.model
    # The steps of a held reference fall on samples: nothing is late there.
    kept = [k for k, u in enumerate(model.unknowns) if u.name != REFERENCE_DELAY]
    held = replace(
        model,
        recordings=[with_held_reference(seen) for seen in model.recordings],
        unknowns=[model.unknowns[k] for k in kept],
    )
    return refitted(held, replace(fit, point=fit.point[kept], steps=fit.steps[kept]))


def _moves(fit: SimulatedFit) -> bool:
    return any(seen.motion is not None for seen in fit.model.recordings)


def _compared(recordings: Sequence[Observed]) -> int:
    """Samples that are compared, of all recordings."""
    return sum(int(seen.compared.sum()) for seen in recordings)
