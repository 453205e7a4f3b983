"""Where the curve from amplitude to gap comes from: a named one, a bench, or nowhere.

A bench is swept for what each recording needs (its rate, speed and length), and what was swept is
kept by content: the same bench with the same needs is read. All curves of a bench are of the same
draws of it, so that its unknown parameters cancel in a change between recordings of other speeds
and rates too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.flank_change import require_flank_change
from bayesbl.config.fields import PUBLISHED
from bayesbl.config.measurement import SnapshotConfig
from bayesbl.curve.gap_curve import GapCurve, published_curve
from bayesbl.curve.sweep import SweepSettings
from bayesbl.curve.swept_curve import swept_curve
from bayesbl.matching.observed import reference_speed
from bayesbl.measurement.bench_of import bench_with
from bayesbl.measurement.bench_sweep import SweepProblem
from bayesbl.measurement.compatibility import (
    other_speed,
    require_one_speed_of_all,
    require_same_estimator,
)
from bayesbl.measurement.measurement import Reason
from bayesbl.measurement.stored_curve import read_curve
from bayesbl.measurement.task import Task, estimator_of
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import speed_in_another_unit
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Estimator, nominal_speed_rpm

GAPS, START_ANGLES = 20, 4
"""Of a curve on demand. Against 40 gaps, 16 start angles and 5 rotations it is off by at most
0.03 % of δ (``experiments/curve_counts.py``), a fiftieth of what the amplitude tells δ to."""

MOST_ROTATIONS = 3
"""Load rotations simulated: a longer recording means the same amplitude within 0.03 % of δ."""

DRAWS_PER_TERM = 3
"""Swept benches for each term of their description, linear in the parameters: with 24 for seven
parameters the width of the curve's band is within 3 % of that by 150 (same command)."""

DEGREE = 3
SEED = 20260301
"""Of all curves on demand: what is kept serves runs of every seed."""

STORE = ".curves"
"""Folder beside the results in which swept rows are kept."""

MOST_KEPT = 5000
"""Rows in the store, some 10 kB each; the oldest go first."""


class CurveSource(ABC):
    """Gives the curve of each recording.

    ``is_of_bench``: the curves are those of the configured bench.
    """

    is_of_bench: ClassVar[bool] = False

    @property
    def gap_range_rad(self) -> tuple[float, float] | None:
        """Gaps that the curves reach; ``None`` without one."""
        return None

    @property
    def warnings(self) -> tuple[str, ...]:
        """What every reader of its gaps must know."""
        return ()

    @abstractmethod
    def describe(self) -> str:
        """Which curve this is."""

    def require_usable(self, recording: Recording) -> None:
        """Raises where no curve means the same amplitude as a fit of this recording."""
        return

    def doubts(self, recording: Recording) -> Iterable[Reason]:
        """Why δ would be withheld whatever the fit finds."""
        return ()

    def question(self, recording: Recording) -> Reason | None:
        """What to ask the user first where δ is withheld."""
        return None

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Raises where these cannot be compared; what they share, where that is worth saying."""
        if len(recordings) < 2:
            return None
        require_one_speed_of_all(recordings)
        return f"{nominal_speed_rpm(recordings[0]):.5g} rpm in all"

    def bench_of(self, recording: Recording) -> Bench | None:
        """The bench that the curve of a recording is of, where that is known."""
        return None

    @abstractmethod
    def curves(self, task: Task) -> list[GapCurve] | None:
        """The curve of each recording, in order; ``None`` without one."""


def curve_source(config: SnapshotConfig, bench: Bench | None) -> CurveSource:
    """Where a configuration has its curves from.

    Raises
    ------
    UserError
        If a named curve cannot be read.
    """
    if config.curve.source == PUBLISHED:
        return NamedCurve(published_curve(), config)
    if config.curve.source is not None:
        return NamedCurve(read_curve(config.curve.source), config)
    if bench is not None:
        return BenchCurves(bench, config)
    return NoCurve()


class NoCurve(CurveSource):
    """No curve: the ringing alone."""

    def describe(self) -> str:
        """That there is none, and what gives one."""
        return "none, so the ringing alone: δ needs --bench FILE, or --curve RESULT of a sweep"

    def curves(self, task: Task) -> None:
        """None."""


@dataclass(frozen=True, slots=True)
class NamedCurve(CurveSource):
    """One curve for all recordings: the published one, or that of a sweep."""

    curve: GapCurve
    config: SnapshotConfig

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps that the curve reaches."""
        return self.curve.gap_range_rad

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the curve."""
        return self.curve.warnings

    def describe(self) -> str:
        """Its name."""
        return self.curve.name

    def require_usable(self, recording: Recording) -> None:
        """The curve means the same amplitude as a fit of this recording."""
        require_same_estimator(self.curve, estimator_of(self.config), recording)

    def doubts(self, recording: Recording) -> Iterator[Reason]:
        """The recording is of another speed than the curve."""
        if not self.config.curve.allow_extrapolation:
            against = other_speed(recording, self.curve)
            question = self.question(recording)
            yield from (reason for reason in (against and question, against) if reason)

    def question(self, recording: Recording) -> Reason | None:
        """Whether the speed is in another unit."""
        text = speed_in_another_unit(recording, self.curve.reference_speed_rpm)
        return None if text is None else Reason.told("speed_unit", text, withholds=True)

    def curves(self, task: Task) -> list[GapCurve]:
        """The same for all."""
        return [self.curve] * len(task.recordings)


@dataclass(frozen=True, slots=True)
class _Need:
    """What decides the curve of a recording, beside bench file and estimator.

    ``known``: bench values that were others when it was made.
    """

    reference_speed_rpm: float
    sampling_hz: float
    rotations: int
    known: tuple[tuple[str, float], ...]

    def __str__(self) -> str:
        return f"{self.sampling_hz:g} Hz at {abs(self.reference_speed_rpm):g} rpm"


@dataclass(frozen=True, slots=True)
class BenchCurves(CurveSource):
    """Curves of the configured bench, swept for what each recording needs."""

    bench: Bench
    config: SnapshotConfig

    is_of_bench: ClassVar[bool] = True

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Gaps that are swept."""
        settings = SweepSettings()
        return settings.low_rad, settings.high_rad

    def describe(self) -> str:
        """Its bench."""
        return f"swept from {self.config.estimator.bench} on demand"

    def require_usable(self, recording: Recording) -> None:
        """The recording is of a speed at which the gap shows: the one given for it, or the bench's.

        Raises
        ------
        UserError
            If it is of another speed, or the load stays on one flank.
        """
        need, bench = self._need(recording), self.bench_of(recording)
        require_flank_change(bench, [need.reference_speed_rpm], self.config.estimator.bench)

    def bench_of(self, recording: Recording) -> Bench:
        """With what is known of it at the time of the recording."""
        return bench_with(self.bench, self.config.entry_of(recording.name).bench)

    def require_together(self, recordings: Sequence[Recording]) -> str | None:
        """Recordings may be of any speeds and rates: each has its own curve."""
        return None

    def curves(self, task: Task) -> list[GapCurve]:
        """Read or swept, one for each need.

        Raises
        ------
        BenchError
            If a simulation fails.
        CurveError
            If A does not grow with δ.
        """
        needs = [self._need(recording) for recording in task.recordings]
        estimator = estimator_of(self.config)
        made = {
            need: self._curve(need, estimator, task, recording)
            for need, recording in dict(zip(needs, task.recordings, strict=True)).items()
        }
        task.swept.keep_latest(count=MOST_KEPT)
        return [made[need] for need in needs]

    def _need(self, recording: Recording) -> _Need:
        entry = self.config.entry_of(recording.name)
        speed = reference_speed(recording, self.bench, entry.reference_speed_rpm)
        turns = recording.duration_s / self.bench.rotation_period_s(speed)
        rotations = min(max(int(turns), 2), MOST_ROTATIONS)
        # To the digits by which the fingerprint of an estimator tells rates apart.
        sampling_hz = float(f"{1.0 / recording.sampling_period_s:.3g}")
        return _Need(speed, sampling_hz, rotations, tuple(sorted(entry.bench.items())))

    def _curve(
        self, need: _Need, estimator: Estimator, task: Task, recording: Recording
    ) -> GapCurve:
        bench = self.bench_of(recording)
        bench = bench.with_parameters(reference_speed_rpm=need.reference_speed_rpm)
        model = replace(estimator.model, ranges=estimator.model.lasting_ranges)
        settings = SweepSettings(
            count=GAPS,
            start_angles=START_ANGLES,
            rotations=need.rotations,
            sampling_hz=need.sampling_hz,
        )
        problem = SweepProblem(bench, model, settings, SEED, task.swept)
        nominal_seed, draw_seed, curve_seed = np.random.SeedSequence(SEED).spawn(3)
        workers = self.config.run.workers
        progress, label = task.progress, f"Making the curve for {need}"
        _report(progress, label, 0, 1)
        nominal = problem.nominal(nominal_seed, workers)
        parameters = len(bench.tolerances)
        count = DRAWS_PER_TERM * (1 + parameters) if parameters else 0
        swept = problem.draws(
            nominal,
            count,
            draw_seed,
            workers,
            lambda _, made, total: _report(progress, label, made, total),
        )
        _report(progress, label, 1, 1)
        curve, _ = swept_curve(
            str(self.config.estimator.bench),
            nominal,
            model,
            DEGREE,
            estimator.fingerprint(recording),
            curve_seed,
            swept,
        )
        return replace(curve, reference_speed_rpm=abs(need.reference_speed_rpm))


def _report(progress: StageProgress | None, label: str, made: int, total: int) -> None:
    if progress is not None:
        progress(label, made, total)
