"""What a configuration gives every route: recordings, estimator, curve and seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import ready_for_fit, require_reference_speed
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.results.work import NOTHING_KEPT, WorkStore
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.symbols import DisturbanceModel
from bayesbl.ringing.warm_start import EarlierOptimum
from bayesbl.sampling.chains import SamplerSettings


@dataclass(frozen=True, slots=True)
class Seeds:
    """One seed sequence per stage, all spawned from the run's."""

    curve: np.random.SeedSequence
    gap: np.random.SeedSequence
    recordings: tuple[np.random.SeedSequence, ...]
    direct: np.random.SeedSequence
    wear: np.random.SeedSequence
    predictive: np.random.SeedSequence

    @classmethod
    def spawn(cls, seed: int, recordings: int) -> Seeds:
        """The same seeds whatever the number of workers."""
        curve, gap, fits, direct, wear, predictive = np.random.SeedSequence(seed).spawn(6)
        return cls(curve, gap, tuple(fits.spawn(recordings)), direct, wear, predictive)


@dataclass(frozen=True, slots=True)
class Task:
    """Recordings to be measured, and who is to hear of it.

    Attributes
    ----------
    work
        Keeps what is finished, and gives back what an earlier run had finished.
    say
        Called with a sentence on what each search started from, if from an earlier optimum.
    swept
        Keeps swept benches for this run and others.
    earlier
        Optima to start searches from, by recording, where the configuration names no result.
    """

    config: SnapshotConfig
    recordings: tuple[Recording, ...]
    seeds: Seeds
    progress: StageProgress | None = None
    work: WorkStore = NOTHING_KEPT
    say: Callable[[str], None] = lambda sentence: None
    swept: WorkStore = NOTHING_KEPT
    earlier: Mapping[str, EarlierOptimum] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Of the recordings, in their order."""
        return [recording.name for recording in self.recordings]


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
        sampler=sampler_of(config),
    )


def sampler_of(config: SnapshotConfig) -> SamplerSettings:
    """How a configuration has posteriors sampled."""
    sampling = config.posterior
    return SamplerSettings(sampling.ensembles, sampling.max_steps, config.interval.level)
