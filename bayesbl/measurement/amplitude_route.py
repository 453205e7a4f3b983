"""Recordings of one joint in, gaps and their change out: ``fit`` and ``compare``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.config.measurement import CompareConfig, SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.curve.gap_curve import GapCurve, published_curve
from bayesbl.errors import ConfigError, CurveError
from bayesbl.measurement.amplitude_groups import amplitude_groups
from bayesbl.measurement.change import Gap, MeasuredRinging, changes, gaps
from bayesbl.measurement.fits import FitJob, StageProgress, earlier_of, run_fits
from bayesbl.measurement.maintenance import wear_of
from bayesbl.measurement.shared_groups import change_group
from bayesbl.measurement.speeds import other_rotation, other_speed, require_one_speed_of_all
from bayesbl.measurement.stored_curve import curve_group, read_curve
from bayesbl.recording.checks import (
    ready_for_fit,
    require_reference_speed,
    speed_in_another_unit,
)
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.earlier import read_earlier
from bayesbl.results.provenance import provenance_of
from bayesbl.results.tree import stack_snapshots
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator, Fit, nominal_speed_rpm
from bayesbl.ringing.second_sampler import require_second_sampler
from bayesbl.ringing.symbols import AMPLITUDE, DisturbanceModel
from bayesbl.sampling.chains import SamplerSettings

__all__ = ["StageProgress", "measure"]

SPEED_TOLERANCE = 0.01
"""Largest relative difference in speed between a recording and the curve that δ is read from.

On the reference bench ∂ln δ/∂ln v at a given A is 0.28 to 0.57 for gaps of 2e-4 to 3.5e-3 rad, so
this moves δ by 0.6 % at most: no more than the lack of fit that a curve may have, and a quarter of
the 2 % that an amplitude tells δ to.
"""

SPEED = "nominal_speed_rpm"
"""Entry of a fingerprint that is compared within the tolerance, not digit by digit."""

LIMIT_BEYOND = 10.0
"""A limit that lies beyond the gaps that can be measured by more than this factor is a mistake."""


@dataclass(frozen=True, slots=True)
class Seeds:
    """One seed sequence per stage, all spawned from the run's."""

    curve: np.random.SeedSequence
    gap: np.random.SeedSequence
    wear: np.random.SeedSequence
    recordings: tuple[np.random.SeedSequence, ...]

    @classmethod
    def spawn(cls, seed: int, recordings: int) -> Seeds:
        """The same seeds whatever the number of workers."""
        # The fourth is the direct route's.
        curve, gap, fits, _, wear = np.random.SeedSequence(seed).spawn(5)
        return cls(curve, gap, wear, tuple(fits.spawn(recordings)))


def measure(
    config: SnapshotConfig,
    progress: StageProgress | None = None,
    work: WorkStore = NOTHING_KEPT,
    say: Callable[[str], None] = lambda sentence: None,
) -> xr.DataTree:
    """Run a fit or a comparison as configured.

    Parameters
    ----------
    work
        Keeps what is finished, and gives back what an earlier run had finished.
    say
        Told, in a sentence, what each search started from, if from an earlier optimum.

    Returns
    -------
    The whole result (see :mod:`bayesbl.results.tree`); nothing is written but finished work.

    Raises
    ------
    UserError
        If a recording cannot be read or used, the curve does not belong to the estimator, there
        is nothing to start from in the earlier result, or the second sampler is not installed.
    """
    estimator, curve = estimator_of(config), curve_of(config)
    start_from, check = config.estimator.search.start_from, config.posterior.check_sampler
    earlier = {} if start_from is None else read_earlier(start_from)
    if check:
        require_second_sampler()
    require_plausible_limit(config.joint.limit_rad, curve.gap_range_rad)
    recordings = read_recordings(config)
    require_one_speed_of_all(recordings)
    for recording in recordings:
        require_same_estimator(curve, estimator, recording)
    seeds = Seeds.spawn(config.run.seed, len(recordings))
    jobs = [
        FitJob(
            estimator,
            curve,
            recording,
            seed,
            config.joint.gear_ratio,
            earlier_of(recording.name, earlier),
            check,
            work,
        )
        for recording, seed in zip(recordings, seeds.recordings, strict=True)
    ]
    fits = run_fits(jobs, config.run.workers, progress)
    for fit in fits:
        if fit.point.start:
            say(f"{fit.point.recording.name}: {fit.point.start}")
    found = gaps(
        curve,
        [MeasuredRinging(f.posterior.draws[AMPLITUDE], *f.point.ringing) for f in fits],
        seeds.gap,
        allow_extrapolation=config.curve.allow_extrapolation,
        level=config.interval.level,
    )
    return _tree(config, curve, recordings, fits, found, seeds)


def read_recordings(config: SnapshotConfig) -> list[Recording]:
    """All recordings of a configuration, in its order, each ready for a fit."""
    return [recording_of(entry, config) for entry in config.recordings]


def recording_of(entry: SnapshotRecording, config: SnapshotConfig) -> Recording:
    """The recording of an entry, ready for a fit.

    Raises
    ------
    RecordingError
        If it cannot be read, or lacks what a fit needs.
    """
    recording = read_recording(entry.file, name=entry.name, columns=config.column_specs)
    if entry.reference_speed_rpm is not None:
        require_reference_speed(recording, entry.reference_speed_rpm)
    return ready_for_fit(recording, config.joint.gear_ratio)


def estimator_of(config: SnapshotConfig) -> Estimator:
    """The estimator that a configuration describes."""
    section = config.estimator
    return Estimator(
        model=DisturbanceModel(
            section.model.baseline_harmonics, section.model.fixed, section.model.ranges
        ),
        search=section.search.method,
        noise_kind=section.noise.kind,
        noise_order=section.noise.order,
        sampler=SamplerSettings(
            config.posterior.ensembles, config.posterior.max_steps, config.interval.level
        ),
    )


def curve_of(config: SnapshotConfig) -> GapCurve:
    """The gap curve that a configuration names."""
    if config.curve.source == "published":
        return published_curve()
    return read_curve(config.curve.source)


def require_plausible_limit(limit_rad: float | None, range_rad: tuple[float, float]) -> None:
    """The limit is not far from all gaps that can be measured: most likely another unit."""
    low, high = range_rad
    if limit_rad is None or low / LIMIT_BEYOND <= limit_rad <= LIMIT_BEYOND * high:
        return
    raise ConfigError(
        "The limit is far from every gap that can be measured here.",
        where="limit_rad",
        found=f"{limit_rad:g} rad = {1e3 * limit_rad:.4g} mrad",
        expected=f"a limit near {1e3 * low:.3g} to {1e3 * high:.3g} mrad, given in rad "
        "(1.2e-3 = 1.2 mrad)",
    )


def same_files(recordings: Sequence[Recording]) -> list[str]:
    """A sentence for every group of recordings whose files are alike byte for byte."""
    names: dict[str, list[str]] = {}
    for recording in recordings:
        if recording.source is not None:
            names.setdefault(recording.source.sha256, []).append(recording.name)
    return [
        f"{', '.join(alike[:-1])} and {alike[-1]} are one and the same recording: their files are "
        "alike to the last byte, so no change between them means anything. Was a file copied by "
        "mistake?"
        for alike in names.values()
        if len(alike) > 1
    ]


def require_same_estimator(curve: GapCurve, estimator: Estimator, recording: Recording) -> None:
    """The curve means the same A as the fit; raises :class:`CurveError` with the difference."""
    if curve.fingerprint is None:
        return
    mine, theirs = json.loads(estimator.fingerprint(recording)), json.loads(curve.fingerprint)
    # A fingerprint has two digits of the speed; the curve's file has all of them beside it.
    mine[SPEED] = nominal_speed_rpm(recording)
    theirs[SPEED] = curve.reference_speed_rpm or theirs[SPEED]
    different = {k for k in {*mine, *theirs} if mine.get(k) != theirs.get(k)}
    if abs(mine[SPEED] / theirs[SPEED] - 1.0) <= SPEED_TOLERANCE:
        different.discard(SPEED)
    if different:
        told = sorted(different)
        problem = (
            "This gap curve was swept at another speed, where the same gap rings otherwise."
            if told == [SPEED]
            else "This gap curve was made with another estimator, so it means another amplitude."
        )
        raise CurveError(
            problem,
            file=curve.name,
            where=", ".join(told),
            found="; ".join(f"{_told(k, theirs)} in the curve" for k in told),
            expected="; ".join(f"{_told(k, mine)} as in {recording.name}" for k in told),
        )


def _told(key: str, meaning: Mapping[str, Any]) -> str:
    """An entry of a fingerprint in words."""
    if key not in meaning:
        return f"no {key}"
    value = meaning[key]
    return f"{key} = {value:.6g}" if isinstance(value, float) else f"{key} = {value}"


def _tree(
    config: SnapshotConfig,
    curve: GapCurve,
    recordings: Sequence[Recording],
    fits: Sequence[Fit],
    found: Sequence[Gap],
    seeds: Seeds,
) -> xr.DataTree:
    level = config.interval.level
    groups = {
        recording.name: amplitude_groups(fit, gap, level)
        for recording, fit, gap in zip(recordings, fits, found, strict=True)
    }
    verdicts = {
        r.name: verdict(
            f,
            g,
            unsuited(r, f, curve, config),
            speed_in_another_unit(r, curve.reference_speed_rpm),
        )
        for r, f, g in zip(recordings, fits, found, strict=True)
    }
    if isinstance(config, CompareConfig):
        whole = stack_snapshots(groups)
        total, steps = changes(
            {r.name: g.delta_rad for r, g in zip(recordings, found, strict=True)}
        )
        whole["change"] = change_group(total, steps)
        wear = wear_of(config, [gap.delta_rad for gap in found], verdicts, seeds.wear)
        if wear is not None:
            whole["wear"] = wear
    else:
        whole = groups[recordings[0].name]
        verdicts = {"fit": verdicts[recordings[0].name]}
    whole["diagnostics"].attrs["verdicts"] = json.dumps(verdicts, ensure_ascii=False)
    whole["curve"] = curve_group(curve, level, seeds.curve)
    tree = xr.DataTree.from_dict(whole)
    tree.attrs = {
        "kind": config.kind,
        "recordings": [r.name for r in recordings],
        "interval_level": level,
        "interval_kind": config.interval.kind,
        "outcome": overall([v["outcome"] for v in verdicts.values()]),
        "reason": " ".join(
            v["reason"] if len(verdicts) == 1 else f"{name}: {v['reason']}"
            for name, v in verdicts.items()
            if v["reason"]
        ),
        "warnings": [*same_files(recordings), *curve.warnings],
        **provenance_of(config),
    }
    if config.joint.limit_rad is not None:
        tree.attrs["limit_rad"] = config.joint.limit_rad
    return tree


def unsuited(recording: Recording, fit: Fit, curve: GapCurve, config: SnapshotConfig) -> list[str]:
    """Reasons why recording, curve and gear ratio do not belong together."""
    reasons = [other_rotation(recording, fit, config.joint.gear_ratio)]
    if not config.curve.allow_extrapolation:
        reasons.append(other_speed(recording, curve))
    return [reason for reason in reasons if reason]


def verdict(
    fit: Fit, gap: Gap, unsuited: Sequence[str] = (), question: str | None = None
) -> dict[str, Any]:
    """Outcome of one snapshot with its reasons; ``reason``, where δ is withheld, says why alone.

    Parameters
    ----------
    unsuited
        Reasons beside the fit's and the gap's own.
    question
        What to ask the user before anything else where δ is withheld.
    """
    diagnostics = fit.posterior.diagnostics
    disagreement = None if fit.check is None else fit.check.reason
    notes = (*fit.point.notes, *gap.notes)
    against = [*unsuited, *(reason for reason in (gap.reason, disagreement) if reason)]
    outcome = diagnostics.outcome
    if notes and outcome == "converged":
        outcome = "usable"
    if outcome == "withheld":
        # What is made of draws that fail, fails with them: the cause comes first.
        against = [*diagnostics.reasons, *against]
        reasons = [*against]
    else:
        reasons = [*against, *diagnostics.reasons]
        outcome = "withheld" if against else outcome
    reasons += [*notes, *fit.point.recording.notes]
    if question and outcome == "withheld":
        against.insert(0, question)
        reasons.insert(0, question)
    return {"outcome": outcome, "reasons": reasons, "reason": " ".join(against) or None}


def overall(outcomes: Sequence[str]) -> str:
    """The worst of several outcomes."""
    return max(outcomes, key=["converged", "usable", "withheld"].index)
