"""From the amplitude of the ringing, through a gap curve, to the gap."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.measurement.amplitude_groups import GROUPS, amplitude_groups
from bayesbl.measurement.amplitude_summary import summarise_amplitude
from bayesbl.measurement.change import Gap
from bayesbl.measurement.compatibility import (
    other_speed,
    require_one_speed_of_all,
    require_same_estimator,
    unsuited,
)
from bayesbl.measurement.earlier import read_earlier
from bayesbl.measurement.fits import FitJob, earlier_of, gaps_of_fits, run_fits
from bayesbl.measurement.measurement import Measurement, Route, Snapshot
from bayesbl.measurement.task import Task, curve_of, estimator_of
from bayesbl.measurement.verdict import Verdict
from bayesbl.recording.checks import speed_in_another_unit
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Fit, nominal_speed_rpm
from bayesbl.ringing.second_sampler import require_second_sampler


class AmplitudeMeasurer:
    """The amplitude route with its estimator and gap curve."""

    def __init__(self, config: SnapshotConfig) -> None:
        self.config = config
        self.estimator = estimator_of(config)
        self.curve = curve_of(config)

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps that the curve reaches."""
        return self.curve.gap_range_rad

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """What else a run needs: an earlier optimum, the second sampler."""
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
        """The curve means the same amplitude as a fit of this recording."""
        require_same_estimator(self.curve, self.estimator, recording)

    def doubts(self, recording: Recording) -> Iterator[str]:
        """Why δ would be withheld whatever the fit finds."""
        if not self.config.curve.allow_extrapolation:
            against = other_speed(recording, self.curve)
            question = speed_in_another_unit(recording, self.curve.reference_speed_rpm)
            yield from (sentence for sentence in (against and question, against) if sentence)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """All recordings are of one speed, which is said where there are several."""
        if len(recordings) < 2:
            return None
        require_one_speed_of_all(recordings)
        return f"{nominal_speed_rpm(recordings[0]):.5g} rpm in all"

    def measure(self, task: Task) -> Measurement:
        """Fit every recording and read its gap from the curve."""
        fits = run_fits(self._jobs(task), task.config.run.workers, task.progress)
        for fit in fits:
            if fit.point.start:
                task.say(f"{fit.point.recording.name}: {fit.point.start}")
        found = gaps_of_fits(task, self.curve, fits)
        return Measurement(
            "amplitude",
            [
                Snapshot(
                    recording.name,
                    gap.delta_rad,
                    verdict(
                        fit,
                        gap,
                        unsuited(recording, fit, self.curve, task.config),
                        speed_in_another_unit(recording, self.curve.reference_speed_rpm),
                    ),
                    amplitude_groups(fit, gap, task.config.interval.level),
                )
                for recording, fit, gap in zip(task.recordings, fits, found, strict=True)
            ],
            self.curve,
            warnings=self.curve.warnings,
        )

    def _jobs(self, task: Task) -> list[FitJob]:
        start_from = task.config.estimator.search.start_from
        earlier = {} if start_from is None else read_earlier(start_from)
        check = task.config.posterior.check_sampler
        if check:
            require_second_sampler()
        return [
            FitJob(
                self.estimator,
                self.curve,
                recording,
                seed,
                task.config.joint.gear_ratio,
                earlier_of(recording.name, earlier),
                check,
                task.work,
            )
            for recording, seed in zip(task.recordings, task.seeds.recordings, strict=True)
        ]


def _earlier_in_words(path: Path) -> str:
    return f"{', '.join(read_earlier(path))} in {path}"


def _second_sampler() -> str:
    require_second_sampler()
    return "dynesty"


def verdict(
    fit: Fit, gap: Gap, unsuited: Sequence[str] = (), question: str | None = None
) -> Verdict:
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
    return Verdict(outcome, tuple(reasons), " ".join(against) or None)


ROUTE = Route("amplitude", GROUPS, AmplitudeMeasurer, summarise_amplitude)
