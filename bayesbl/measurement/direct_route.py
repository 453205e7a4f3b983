"""``fit`` and ``compare`` by the direct route: recordings and their bench in, gaps and change out.

All snapshots of a joint are fitted at once. They share the bench, so what is not known of it
largely cancels in the change.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.config.measurement import CompareConfig, SnapshotConfig
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.errors import BenchError, ConfigError, UserError
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.posterior import DirectPosterior, sample_direct
from bayesbl.matching.predictive_check import Disagreement, agrees, disagreements
from bayesbl.matching.signals import (
    GAP,
    Observed,
    Unknown,
    effect_unknowns,
    gap_unknown,
    observed,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.measurement.amplitude_route import (
    Seeds,
    StageProgress,
    curve_of,
    estimator_of,
    overall,
    read_recordings,
    require_plausible_limit,
    require_same_estimator,
    same_files,
    unsuited,
)
from bayesbl.measurement.change import MeasuredRinging, changes, gaps
from bayesbl.measurement.direct_groups import ByAmplitude, direct_groups
from bayesbl.measurement.fits import FitJob
from bayesbl.measurement.maintenance import wear_of
from bayesbl.measurement.shared_groups import change_group
from bayesbl.measurement.stored_curve import curve_group
from bayesbl.recording.checks import require_alive
from bayesbl.recording.types import MOTOR_CURRENT, Recording
from bayesbl.results.provenance import provenance_of
from bayesbl.results.tree import stack_snapshots
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator, Fit
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import Diagnostics

FALSE_ALARM = 0.01
"""Of the predictive check, over all channels and bands of a run."""


@dataclass(frozen=True, slots=True)
class DirectMeasurement:
    """A joint posterior with the predictive check of its optimum."""

    posterior: DirectPosterior
    check: tuple[Disagreement, ...]

    @property
    def shares_unknowns(self) -> bool:
        """Whether anything unknown belongs to all recordings."""
        return any(u.recording is None for u in self.posterior.fit.model.unknowns)

    def repeating(self, recording: str) -> list[Disagreement]:
        """Entries that noise does not explain and that touch the answer of one recording.

        Through shared unknowns a misfit in one recording moves the gap of all.
        """
        entries = list(self.check)
        return [
            entry
            for entry in entries
            if not agrees([entry], FALSE_ALARM / len(entries))
            and (self.shares_unknowns or entry.recording == recording)
        ]


def measure_direct(
    config: SnapshotConfig,
    progress: StageProgress | None = None,
    work: WorkStore = NOTHING_KEPT,
) -> xr.DataTree:
    """Run a fit or a comparison by the direct route, and the amplitude route beside it.

    Returns
    -------
    The whole result (see :mod:`bayesbl.results.direct_tree`); nothing is written.

    Raises
    ------
    UserError
        If the bench or a recording cannot be read or used, or the curve does not belong to the
        estimator.
    """
    bench = bench_of(config)
    estimator, curve = estimator_of(config), curve_of(config)
    require_plausible_limit(config.joint.limit_rad, config.estimator.gap_rad)
    recordings = read_recordings(config)
    seen = [observed_of(config, bench, recording) for recording in recordings]
    for recording in recordings:
        require_same_estimator(curve, estimator, recording)
    seeds = Seeds.spawn(config.run.seed, len(recordings))
    problem = (bench, seen, config.estimator.gap_rad, estimator.sampler)
    seed = np.random.SeedSequence(config.run.seed).spawn(4)[3]
    found = work.get(
        "direct route",
        (problem, seed),
        lambda: fit_directly(*problem, seed, config.run.workers, progress),
        DirectMeasurement,
    )
    beside = _amplitude_route(config, estimator, curve, recordings, seeds, progress, work)
    return _tree(config, bench, curve, recordings, found, beside, seeds)


def bench_of(config: SnapshotConfig) -> Bench:
    """The bench of a direct fit.

    Raises
    ------
    ConfigError
        If there is none, or it has no gap to measure.
    """
    file = config.estimator.bench
    if file is None:
        raise ConfigError("The direct route needs a bench.", expected="--bench FILE")
    bench = load_bench(file)
    if bench.drive == "rigid":
        raise ConfigError(
            "A rigid bench has no gap to measure.",
            file=file,
            found='drive = "rigid"',
            expected='drive = "two_mass"',
        )
    low, high = config.estimator.gap_rad
    try:
        bench.simulate_many(np.array([low, high]), rotations=0.1)
    except BenchError as error:
        raise BenchError(
            f"The bench cannot be simulated at the ends of the range of gaps. {error.problem}",
            file=file,
            where="[estimator] gap_rad",
            found=error.found,
            expected=error.expected,
        ) from None
    return bench


def observed_of(config: SnapshotConfig, bench: Bench, recording: Recording) -> Observed:
    """A recording as the simulator is compared with it, at the speed that the config gives."""
    require_alive(recording, (MOTOR_CURRENT,))
    speeds = {entry.name: entry.reference_speed_rpm for entry in config.recordings}
    return observed(recording, bench, speeds[recording.name])


def direct_unknowns(
    bench: Bench, names: Sequence[str], gap_rad: tuple[float, float]
) -> list[Unknown]:
    """A gap and a start angle for each recording, and what is not known of their bench."""
    return [
        *(replace(gap_unknown(*gap_rad), recording=name) for name in names),
        *(start_angle_unknown(name) for name in names),
        *effect_unknowns(bench, names),
        *tolerance_unknowns(bench),
    ]


def fit_directly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    sampler: SamplerSettings,
    seed: np.random.SeedSequence,
    workers: int = 1,
    progress: StageProgress | None = None,
    *,
    corrected: bool = True,
) -> DirectMeasurement:
    """Optimum, predictive check and posterior of all recordings together.

    ``corrected`` as :func:`bayesbl.matching.posterior.sample_direct` takes it.
    """
    unknowns = direct_unknowns(bench, [r.name for r in recordings], gap_rad)
    fit = fit_aligned(bench, recordings, unknowns, workers)
    name = " and ".join(r.name for r in recordings)
    told = None if progress is None else partial(progress, name)
    posterior = sample_direct(fit, sampler, seed, told, corrected=corrected)
    return DirectMeasurement(posterior, tuple(disagreements(fit)))


def _amplitude_route(
    config: SnapshotConfig,
    estimator: Estimator,
    curve: GapCurve,
    recordings: Sequence[Recording],
    seeds: Seeds,
    progress: StageProgress | None,
    work: WorkStore,
) -> list[ByAmplitude]:
    """The same as by ``route = "amplitude"``; where it cannot answer, the reason in its place."""
    fits: list[Fit | None] = []
    refusals: list[str | None] = []
    for recording, seed in zip(recordings, seeds.recordings, strict=True):
        job = FitJob(estimator, curve, recording, seed, config.joint.gear_ratio, work=work)
        try:
            fits.append(job.run(progress, f"{recording.name} by amplitude"))
            refusals.append(None)
        except UserError as error:
            fits.append(None)
            refusals.append(str(error))
    ringing = [MeasuredRinging(f.posterior.draws[AMPLITUDE], *f.point.ringing) for f in fits if f]
    found = iter(
        gaps(
            curve,
            ringing,
            seeds.gap,
            allow_extrapolation=config.curve.allow_extrapolation,
            level=config.interval.level,
        )
        if ringing
        else []
    )
    routes = []
    for recording, fit, refusal in zip(recordings, fits, refusals, strict=True):
        gap = next(found) if fit else None
        reason = refusal
        against = unsuited(recording, fit, curve, config) if fit else []
        if against:
            reason = " ".join(against)
        elif fit is not None and fit.posterior.diagnostics.outcome == "withheld":
            reason = " ".join(fit.posterior.diagnostics.reasons)
        elif gap is not None and gap.reason:
            reason = gap.reason
        routes.append(ByAmplitude(fit, gap, reason))
    return routes


def direct_verdict(
    found: DirectMeasurement, recording: Observed, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """Outcome of one snapshot with its reasons; ``reason``, where δ is withheld, says why alone.

    ``notes``: what was done to the recording.
    """
    diagnostics: Diagnostics = found.posterior.diagnostics
    outcome, reasons = diagnostics.outcome, list(diagnostics.reasons)
    repeating = found.repeating(recording.name)
    if repeating:
        outcome = "withheld"
        reasons.insert(0, _disagreement_in_words(repeating))
    reason = " ".join(reasons) if outcome == "withheld" else None
    if len(recording.signals) == 1:
        reasons.append(
            "There is no motor current in the recording, so the speed alone was used: with the "
            "current δ would be several times sharper."
        )
    reasons += notes
    return {"outcome": outcome, "reasons": reasons, "reason": reason}


def _disagreement_in_words(entries: Sequence[Disagreement]) -> str:
    worst = max(entries, key=lambda entry: entry.ratio)
    others = sorted({f"{e.channel} of {e.recording}" for e in entries})
    which = f"up to load order {worst.highest_order}" if worst.highest_order else "in the mean"
    return (
        "Simulation and recording disagree beyond noise, so δ cannot be trusted: in "
        f"{worst.channel} of {worst.recording}, {which}, what repeats every rotation has "
        f"{worst.ratio:.3g} times the power that noise would leave (disagreement in "
        f"{', '.join(others)}). The bench file lacks an effect or has wrong "
        "values; `bayesbl diagnose` looks for what is missing."
    )


def _tree(
    config: SnapshotConfig,
    bench: Bench,
    curve: GapCurve,
    recordings: Sequence[Recording],
    found: DirectMeasurement,
    beside: Sequence[ByAmplitude],
    seeds: Seeds,
) -> xr.DataTree:
    level = config.interval.level
    posterior = found.posterior
    names = [r.name for r in recordings]
    groups = {
        recording.name: direct_groups(
            posterior,
            recording,
            i,
            [entry for entry in found.check if entry.recording == recording.name],
            beside[i],
        )
        for i, recording in enumerate(recordings)
    }
    verdicts = {
        seen.name: direct_verdict(found, seen, recording.notes)
        for seen, recording in zip(posterior.fit.model.recordings, recordings, strict=True)
    }
    reasons = {name: route.reason for name, route in zip(names, beside, strict=True)}
    if isinstance(config, CompareConfig):
        whole = stack_snapshots(groups)
        drawn = {name: posterior.values(GAP, name) for name in names}
        whole["change"] = change_group(*changes(drawn))
        wear = wear_of(config, list(drawn.values()), verdicts, seeds.wear)
        if wear is not None:
            whole["wear"] = wear
    else:
        whole = groups[names[0]]
        verdicts, reasons = {"fit": verdicts[names[0]]}, {"fit": reasons[names[0]]}
    whole["diagnostics"].attrs["verdicts"] = json.dumps(verdicts, ensure_ascii=False)
    whole["amplitude_route"].attrs["reasons"] = json.dumps(reasons, ensure_ascii=False)
    whole["curve"] = curve_group(curve, level, seeds.curve)
    tree = xr.DataTree.from_dict(whole)
    tree.attrs = {
        "kind": config.kind,
        "route": "direct",
        "bench": bench.fingerprint(),
        "recordings": names,
        "interval_level": level,
        "interval_kind": config.interval.kind,
        "outcome": overall([v["outcome"] for v in verdicts.values()]),
        "reason": " ".join(dict.fromkeys(v["reason"] for v in verdicts.values() if v["reason"])),
        "warnings": same_files(recordings),
        **provenance_of(config),
    }
    if config.joint.limit_rad is not None:
        tree.attrs["limit_rad"] = config.joint.limit_rad
    return tree
