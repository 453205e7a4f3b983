"""The whole answer of a forward comparison: located, named, added, shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.diagnosis.closed_loop.augment import augmented_bench
from bayesbl.diagnosis.closed_loop.candidates import candidates
from bayesbl.diagnosis.closed_loop.criteria import Verdict, enough_closed
from bayesbl.diagnosis.closed_loop.evaluate import (
    ChannelGap,
    Compared,
    channel_gaps,
    compared,
    whitened_gaps,
)
from bayesbl.diagnosis.closed_loop.explain import Explanation, with_noise
from bayesbl.diagnosis.closed_loop.naming import Naming, Progress, name_missing
from bayesbl.diagnosis.closed_loop.suggest import Suggestion, suggested_recording
from bayesbl.diagnosis.report import Estimate
from bayesbl.diagnosis.residuals.locate import Located, locate
from bayesbl.diagnosis.residuals.unexplained import Unexplained, describe_unexplained
from bayesbl.matching.alignment import fit_aligned, remaining_noise
from bayesbl.matching.signals import GAP, START_ANGLE, Observed, Unknown


@dataclass(frozen=True, slots=True)
class ForwardSettings:
    """What may be named, and how surely; as ``[candidates]`` and ``[comparison]`` say."""

    effects: Sequence[str] | None = None
    max_effects: int = 3
    false_alarm: float = 0.01
    load_angle_known: bool = False
    motor_angle_known: bool = False
    workers: int = 1


@dataclass(frozen=True, slots=True)
class ForwardDiagnosis:
    """What was found, with everything the result stores.

    Attributes
    ----------
    delta_before, delta_after
        ln δ and its standard deviation with the bench as believed and with what was named;
        ``None`` where the gap is not unknown.
    gaps, overall
        For each recording and channel; for each use in units of the noise.
    bench
        The bench with what was named in it; ``None`` if nothing was.
    remaining
        What still stands out after naming.
    """

    verdict: Verdict
    naming: Naming
    final: Explanation
    delta_before: Estimate | None
    delta_after: Estimate | None
    recordings: tuple[Compared, ...]
    gaps: tuple[ChannelGap, ...]
    overall: tuple[ChannelGap, ...]
    located_before: Located
    located_after: Located
    remaining: tuple[Unexplained, ...]
    suggestion: Suggestion | None
    bench: Bench | None


def diagnose_forward(
    bench: Bench,
    used: Sequence[Observed],
    held_out: Sequence[Observed],
    unknowns: Sequence[Unknown],
    settings: ForwardSettings,
    progress: Progress | None = None,
) -> ForwardDiagnosis:
    """Align, locate, name, add, and show the gap close.

    Parameters
    ----------
    used, held_out
        Recordings to fit on, and to predict.
    unknowns
        Declared: gap, start angles, bench parameters.

    Raises
    ------
    UserError
        If the bench cannot be simulated or a recording is too short.
    """
    nominal = fit_aligned(bench, used, unknowns, settings.workers)
    naming = name_missing(
        nominal,
        partial(
            candidates,
            bench,
            used,
            "all" if settings.effects is None else settings.effects,
            declared=[u.name for u in unknowns],
            load_angle_known=settings.load_angle_known,
            motor_angle_known=settings.motor_angle_known,
            gap_is_unknown=any(u.name == GAP for u in unknowns),
        ),
        max_effects=settings.max_effects,
        false_alarm=settings.false_alarm,
        progress=progress,
    )
    # What was missing is not noise: intervals rest on the noise that is left without it.
    final = naming.final
    if final.candidates:
        final = with_noise(final, remaining_noise(final.fit))
    pairs = compared(naming.nominal, final, held_out)
    located_before = _located(pairs, naming.nominal, "before")
    located_after = _located(pairs, final, "after")
    remaining = tuple(describe_unexplained(located_after))
    if (
        final.candidates
        and remaining
        and _share_gone(located_before, located_after) < enough_closed(final)
    ):
        # It helps a little, as a parameter may where a line in time is left: no explanation.
        final = naming.nominal
        naming = replace(naming, verdict="unexplained", final=final, effects=())
        pairs = compared(final, final, held_out)
        located_after = located_before
        remaining = tuple(describe_unexplained(located_before))
    verdict = naming.verdict
    if verdict == "nothing_missing" and remaining:
        verdict = "unexplained"
    rivals = [rival for effect in naming.effects for rival in effect.indistinguishable]
    return ForwardDiagnosis(
        verdict,
        naming,
        final,
        _delta(naming.nominal),
        _delta(final),
        tuple(pairs),
        tuple(channel_gaps(pairs)),
        tuple(whitened_gaps(pairs)),
        located_before,
        located_after,
        remaining,
        suggested_recording(naming.final, rivals),
        augmented_bench(final) if final.candidates else None,
    )


def estimates(explanation: Explanation, name: str) -> dict[str, Estimate]:
    """Fitted values of one named effect or parameter, with what its bench entry holds fixed.

    A phase that every recording has of its own stands under the recording's name.
    """
    fit = explanation.fit
    found: dict[str, Estimate] = {}
    for effect in fit.model.bench.effects:
        if effect.name == name:
            found |= {k: Estimate(v.value, math.nan) for k, v in effect.parameters.items()}
    for key, i in places(explanation, name).items():
        sd = float(np.sqrt(fit.covariance[i, i]))
        found[key] = Estimate(float(fit.model.unknowns[i].value(fit.point[i])), sd)
        found.pop(key.partition(" (")[0] if " (" in key else "", None)
    return found


def places(explanation: Explanation, name: str) -> dict[str, int]:
    """Where the unknowns of one named effect or parameter stand in a point."""
    found = {}
    for i, unknown in enumerate(explanation.fit.model.unknowns):
        owner, _, parameter = unknown.name.rpartition("__")
        if name in (owner, unknown.name):
            own = unknown.recording
            found[parameter if own is None else f"{parameter} ({own})"] = i
    return found


def _delta(explanation: Explanation) -> Estimate | None:
    fit = explanation.fit
    names = [u.name for u in fit.model.unknowns]
    if GAP not in names:
        return None
    i = names.index(GAP)
    return Estimate(float(fit.point[i]), float(np.sqrt(fit.covariance[i, i])))


def _located(pairs: Sequence[Compared], explanation: Explanation, stage: str) -> Located:
    used = [pair for pair in pairs if pair.use == "used"]
    angles = [_start_angle(explanation, pair.seen) for pair in used]
    predictions = [pair.before if stage == "before" else pair.after for pair in used]
    # What a bridge leaves is nothing that repeats.
    seen = [
        replace(pair.seen, signals=made + pair.seen.left_by(made))
        for pair, made in zip(used, predictions, strict=True)
    ]
    return locate(seen, predictions, angles)


def _share_gone(before: Located, after: Located) -> float:
    """Of the power, in units of the noise, that is no noise: repeating or not."""
    first, last = (
        sum(
            (c.split.offset + c.repeating_rms**2 + c.split.other) / c.noise_sd**2
            for recording in located.recordings
            for c in recording.channels
        )
        for located in (before, after)
    )
    return 1.0 - last / first if first > 0.0 else 0.0


def _start_angle(explanation: Explanation, seen: Observed) -> float:
    fit = explanation.fit
    for unknown, x in zip(fit.model.unknowns, fit.point, strict=True):
        if unknown.name == START_ANGLE and unknown.recording == seen.name:
            return float(x)
    return float(seen.known.get(START_ANGLE, 0.0))


def halves(seen: Observed) -> tuple[Observed, Observed]:
    """A recording cut in two at a whole sample; both halves have its name."""
    middle = seen.samples // 2
    return _rows(seen, slice(None, middle)), _rows(seen, slice(middle, None))


def _rows(seen: Observed, rows: slice) -> Observed:
    excluded, angle = seen.excluded, seen.motor_angle_rad
    return replace(
        seen,
        signals=seen.signals[:, rows],
        excluded=None if excluded is None else excluded[rows],
        motor_angle_rad=None if angle is None else angle[rows],
    )
