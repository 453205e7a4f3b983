"""From the amplitude of the ringing, through a gap curve, to the gap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from bayesbl.bench.bench import Bench
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.errors import RecordingError
from bayesbl.measurement.amplitude_groups import GROUPS, amplitude_groups
from bayesbl.measurement.amplitude_summary import summarise_amplitude
from bayesbl.measurement.bench_of import bench_of
from bayesbl.measurement.change import Gap
from bayesbl.measurement.compatibility import unsuited
from bayesbl.measurement.curves import curve_source
from bayesbl.measurement.earlier import read_earlier
from bayesbl.measurement.fits import (
    FitJob,
    earlier_of,
    gaps_of_fits,
    measured_ringing,
    run_fits,
)
from bayesbl.measurement.joint_check import NOTHING_COMPARED, JointCheck
from bayesbl.measurement.measurement import Measurement, Measurer, Route, Snapshot
from bayesbl.measurement.ringing_check import ringing_check
from bayesbl.measurement.same_joint import change_reason, same_joint
from bayesbl.measurement.task import Task, estimator_of
from bayesbl.measurement.verdict import Verdict
from bayesbl.recording.moving import moves
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Fit
from bayesbl.ringing.second_sampler import require_second_sampler


class AmplitudeMeasurer(Measurer):
    """The amplitude route with its estimator and where its gap curves come from."""

    def __init__(self, config: SnapshotConfig, bench: Bench | None) -> None:
        self.config = config
        self.estimator = estimator_of(config)
        self.source = curve_source(config, bench)

    @property
    def gap_range_rad(self) -> tuple[float, float] | None:
        """Gaps that the curve reaches; ``None`` without one."""
        return self.source.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The curve, and what else a run needs: an earlier optimum, the second sampler."""
        estimator = self.estimator
        yield "estimator", lambda: f"search {estimator.search}, noise {estimator.noise_kind}"
        yield "curve", self.source.describe
        start_from = self.config.estimator.search.start_from
        if start_from is not None:
            yield "start from", lambda: _earlier_in_words(start_from)
        if self.config.posterior.check_sampler:
            yield "second sampler", _second_sampler

    def notes(self) -> Iterator[str]:
        """What the run alone will find out."""
        if self.config.joint.gear_ratio is None:
            yield (
                "Without [joint] gear_ratio the load's rotations are counted only by the run, "
                "which refuses a recording of fewer than two."
            )

    def require_usable(self, recording: Recording) -> None:
        """A curve means the same amplitude as a fit of this recording, or can be swept to."""
        if moves(recording):
            raise RecordingError(
                "This joint does not turn at one speed, and no gap curve belongs to the ringing of "
                "a motion.",
                file=recording.place,
                found="a reference that varies over time",
                expected="the direct route, which needs a bench (--bench FILE); `bayesbl init "
                "--bench` begins one, and `bayesbl identify` of three such motions completes it",
            )
        self.source.require_usable(recording)

    def doubts(self, recording: Recording) -> Iterable[str]:
        """Why δ would be withheld whatever the fit finds."""
        return self.source.doubts(recording)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """All recordings are of one speed, unless each has a curve of its own."""
        return self.source.require_together(recordings)

    def measure(self, task: Task) -> Measurement:
        """Fit every recording and read its gap from its curve, if there is one."""
        curves = self.source.curves(task)
        fits = run_fits(self._jobs(task, curves), task.config.run.workers, task.progress)
        for fit in fits:
            if fit.point.start:
                task.say(f"{fit.point.recording.name}: {fit.point.start}")
        found = [None] * len(fits) if curves is None else gaps_of_fits(task, curves, fits)
        of_each: Sequence[GapCurve | None] = curves or [None] * len(fits)
        entries = task.config.recordings
        check = same_joint(
            [fit.point for fit in fits],
            [entry.repaired for entry in entries],
            [tuple(sorted(entry.bench.items())) for entry in entries],
        )
        return Measurement(
            "amplitude",
            [
                Snapshot(
                    recording.name,
                    None if gap is None else gap.delta_rad,
                    verdict(
                        fit,
                        gap,
                        unsuited(recording, fit, curve, task.config),
                        self.source.question(recording),
                    ),
                    amplitude_groups(fit, gap, task.config.interval.level),
                    model_check=_model_check(curve, fit, gap),
                )
                for recording, fit, gap, curve in zip(
                    task.recordings, fits, found, of_each, strict=True
                )
            ],
            curves or (),
            warnings=self.source.warnings,
            same_joint=check,
            change_reason=None if curves is None else change_reason(check),
        )

    def _jobs(self, task: Task, curves: Sequence[GapCurve] | None) -> list[FitJob]:
        of_each: Sequence[GapCurve | None] = curves or [None] * len(task.recordings)
        start_from = task.config.estimator.search.start_from
        earlier = {} if start_from is None else read_earlier(start_from)
        check = task.config.posterior.check_sampler
        if check:
            require_second_sampler()
        return [
            FitJob(
                self.estimator,
                curve,
                recording,
                seed,
                task.config.joint.gear_ratio,
                earlier_of(recording.name, earlier) or task.earlier.get(recording.name),
                check,
                task.work,
            )
            for recording, seed, curve in zip(
                task.recordings,
                task.seeds.recordings,
                of_each,
                strict=True,
            )
        ]


def _model_check(curve: GapCurve | None, fit: Fit, gap: Gap | None) -> JointCheck:
    if curve is None or gap is None:
        return NOTHING_COMPARED
    return ringing_check(curve, measured_ringing(fit), gap)


def _earlier_in_words(path: Path) -> str:
    return f"{', '.join(read_earlier(path))} in {path}"


def _second_sampler() -> str:
    require_second_sampler()
    return "dynesty"


def verdict(
    fit: Fit, gap: Gap | None, unsuited: Sequence[str] = (), question: str | None = None
) -> Verdict:
    """Outcome of one snapshot with its reasons; ``reason``, where δ is withheld, says why alone.

    Parameters
    ----------
    gap
        ``None`` without a curve: then the ringing's amplitude is what is answered.
    unsuited
        Reasons beside the fit's and the gap's own.
    question
        What to ask the user before anything else where δ is withheld.
    """
    diagnostics = fit.posterior.diagnostics
    disagreement = None if fit.check is None else fit.check.reason
    notes = (*fit.point.notes, *(() if gap is None else gap.notes))
    beyond = None if gap is None else gap.reason
    against = [*unsuited, *(reason for reason in (beyond, disagreement) if reason)]
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
    return Verdict(outcome, tuple(reasons), " ".join(against) or None)


def prepare(config: SnapshotConfig) -> AmplitudeMeasurer:
    """With the bench, if one is configured and no curve is named."""
    file = config.estimator.bench
    swept = file is not None and config.curve.source is None
    return AmplitudeMeasurer(config, bench_of(config) if swept else None)


ROUTE = Route("amplitude", GROUPS, summarise_amplitude)
