"""From ramps of the motor's torque, with the output held, to the gap.

δ is half of the play: half the width, at zero torque, between the positions that small ramps leave
on either flank. See ``docs/design.md``, "Torque ramps".
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.errors import RecordingError
from bayesbl.measurement.held_compliance import Held, held_alike
from bayesbl.measurement.measurement import Measurement, Measurer, Route, Snapshot
from bayesbl.measurement.ramp_groups import GROUPS, RampAnswer, ramp_groups
from bayesbl.measurement.ramp_summary import summarise_ramps
from bayesbl.measurement.ramp_words import against, notes_on
from bayesbl.measurement.task import Task, sampler_of
from bayesbl.measurement.verdict import Verdict
from bayesbl.measurement.wear import since_repair
from bayesbl.progress import of_stage
from bayesbl.ramps.flanks import (
    Flanks,
    find_flanks,
    lost_motion,
    observations,
    of_cycles,
    stiffness,
)
from bayesbl.ramps.play import PlayPosterior, Widths, sample_play
from bayesbl.ramps.preload import lifting_torque
from bayesbl.ramps.torque_cycles import Ramps, find_ramps
from bayesbl.recording.checks import require_alive, require_channels
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import (
    MOTOR_POSITION,
    MOTOR_TORQUE,
    FloatArray,
    Recording,
    Source,
)

LOST_MOTION_SHARE = 0.03
"""Of the rated torque: where makers of reducers state lost motion."""

FILE_STARTS = "file_starts"
"""Entry of a recording's metadata: the first sample of each of its files."""


class RampMeasurer(Measurer):
    """The route of torque ramps."""

    def __init__(self, config: SnapshotConfig) -> None:
        self.config = config

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Nothing is swept or searched: from an encoder's step to a tooth's width."""
        return 1e-6, 0.5

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The ratio, as it decides the answer."""
        ratio = self.config.joint.gear_ratio
        given = "1, of the output (no gear_ratio)" if ratio is None else f"{ratio:g}"
        yield "gear ratio", lambda: given

    def read(self, entry: SnapshotRecording) -> Recording:
        """All files of the snapshot one after another, position and torque as in the files."""
        parts = [
            # Between ramps nothing may have been recorded: time does not matter here.
            read_recording(file, name=entry.name, columns=self.config.column_specs, even=False)
            for file in entry.every_file
        ]
        for part in parts:
            require_channels(part, [MOTOR_POSITION, MOTOR_TORQUE])
            require_alive(part, [MOTOR_POSITION, MOTOR_TORQUE])
        seen: dict[str, str] = {}
        for source in (part.source for part in parts if part.source is not None):
            if source.sha256 in seen:
                raise RecordingError(
                    "Two files of a snapshot are alike to the last byte: one position would count "
                    "twice.",
                    file=source.file,
                    found=f"the content of {seen[source.sha256]}",
                    expected="a file for each position round the turn",
                )
            seen[source.sha256] = source.file
        return _joined(entry.name, parts)

    def require_usable(self, recording: Recording) -> None:
        """The torque goes to both sides of zero and back at least once."""
        if self._flanks(recording).level is not None:
            return
        torque = self._output_torque(recording)
        raise RecordingError(
            "The torque does not go to one side of zero, back, to the other side, and back.",
            file=recording.place,
            where=MOTOR_TORQUE,
            found=f"{torque.min():.3g} to {torque.max():.3g} N m at the output",
            expected="ramps of about the same torque both ways, each back to zero: they leave "
            "the joint on one flank and on the other",
        )

    def doubts(self, recording: Recording) -> Iterable[str]:
        """Why δ will be withheld."""
        why = against(self._flanks(recording))
        return () if why is None else (why,)

    def measure(self, task: Task) -> Measurement:
        """The play of all snapshots together."""
        files = [self._ramps(recording) for recording in task.recordings]
        flanks = [
            find_flanks(each, self._resolution(r))
            for each, r in zip(files, task.recordings, strict=True)
        ]
        widths = [
            Widths(r.name, tuple(found.level.widths()), self._resolution(r))
            for r, found in zip(task.recordings, flanks, strict=True)
            if found.level is not None
        ]
        report = of_stage(task.progress, f"Sampling {' and '.join(task.names)}")
        play_seed, *seeds = task.seeds.direct.spawn(1 + len(files))
        elsewhere = _elsewhere(flanks)
        play = sample_play(
            widths, sampler_of(self.config), play_seed, report, round_the_turn=elsewhere
        )
        answers = [
            self._answer(*each, play) for each in zip(task.names, files, flanks, seeds, strict=True)
        ]
        since = since_repair([entry.repaired for entry in self.config.recordings]).start
        return Measurement(
            "torque_ramp",
            [
                self._snapshot(recording, answer, elsewhere=elsewhere)
                for recording, answer in zip(task.recordings, answers, strict=True)
            ],
            same_joint=held_alike(
                *(Held(a.draws, a.measured) for a in (answers[since], answers[-1]))
            ),
        )

    def _answer(
        self,
        name: str,
        files: tuple[Ramps, ...],
        flanks: Flanks,
        seed: np.random.SeedSequence,
        play: PlayPosterior,
    ) -> RampAnswer:
        generator = np.random.default_rng(seed)
        width, scatter = play.width_rad[name], play.scatter_rad[name]
        delta = 0.5 * width
        # Without play, what is left between the flanks is compliance held by friction: a gap is a
        # part of it that nothing shows.
        none = generator.uniform(size=width.shape) > flanks.probability_of_play
        delta = np.where(none, delta * generator.uniform(size=width.shape), delta)
        stated_nm = LOST_MOTION_SHARE * self._rated(flanks)
        found = of_every_cycle(files, flanks, stated_nm)
        draws = {
            "delta_rad": delta,
            "width_rad": width,
            "scatter_rad": scatter,
            **described(found, files, flanks, width.shape, generator),
        }
        if play.shared_pattern is not None:
            draws["shared_pattern"] = play.shared_pattern
        return RampAnswer(
            files,
            flanks,
            draws,
            found,
            play.log_density,
            play.diagnostics,
            _budget(flanks, width, scatter, delta),
            stated_nm,
        )

    def _snapshot(self, recording: Recording, answer: RampAnswer, *, elsewhere: bool) -> Snapshot:
        why = against(answer.flanks)
        outcome = "withheld" if why is not None else answer.diagnostics.outcome
        reasons = [*filter(None, [why]), *answer.diagnostics.reasons]
        given = self.config.joint.gear_ratio is not None
        notes = notes_on(
            answer.files,
            answer.flanks,
            answer.draws,
            ratio_given=given,
            elsewhere=elsewhere,
        )
        return Snapshot(
            recording.name,
            answer.draws["delta_rad"],
            Verdict(
                outcome,
                (*reasons, *notes, *recording.notes),
                " ".join(reasons) if outcome == "withheld" else None,
            ),
            ramp_groups(answer, recording),
        )

    def _rated(self, flanks: Flanks) -> float:
        """The rated torque, or the largest that the ramps reach."""
        rated = self.config.joint.rated_torque_nm
        if rated is not None:
            return rated
        return 0.0 if flanks.largest is None else flanks.largest.amplitude_nm

    @property
    def _ratio(self) -> float:
        return self.config.joint.gear_ratio or 1.0

    def _output_torque(self, recording: Recording) -> FloatArray:
        return np.asarray(recording.channels[MOTOR_TORQUE] * self._ratio)

    def _resolution(self, recording: Recording) -> float:
        """The smallest step of the position at the output, rad."""
        steps = np.abs(np.diff(recording.channels[MOTOR_POSITION]))
        return float(steps[steps > 0.0].min()) / self._ratio

    def _flanks(self, recording: Recording) -> Flanks:
        return find_flanks(self._ramps(recording), self._resolution(recording))

    def _ramps(self, recording: Recording) -> tuple[Ramps, ...]:
        torque = self._output_torque(recording)
        position = recording.channels[MOTOR_POSITION] / self._ratio
        starts = list(recording.metadata[FILE_STARTS])
        stops = [*starts[1:], recording.samples]
        return tuple(
            find_ramps(torque[a:b], position[a:b]) for a, b in zip(starts, stops, strict=True)
        )


def _elsewhere(flanks: Sequence[Flanks]) -> bool:
    """Whether snapshots of one file each were made at different positions of the turn.

    They are at the same where their flanks overlap.
    """
    levels = [found.level for found in flanks if found.level is not None]
    if len(levels) < 2 or any(len(level.widths()) > 1 for level in levels):
        return False
    middles = [level.middle_rad for level in levels]
    widest = max(float(level.widths()[0].mean()) for level in levels)
    return max(middles) - min(middles) > widest


def _joined(name: str, parts: Sequence[Recording]) -> Recording:
    """One recording of several files; its time goes on from each to the next."""
    names = [c for c in parts[0].channels if all(c in part.channels for part in parts)]
    starts = np.cumsum([0, *(part.samples for part in parts)])
    times, begins = [], 0.0
    for part in parts:
        times.append(part.time_s - part.time_s[0] + begins)
        begins = float(times[-1][-1]) + part.sampling_period_s
    sources = [part.source for part in parts if part.source is not None]
    digest = hashlib.sha256("".join(s.sha256 for s in sources).encode()).hexdigest()
    first = sources[0]
    excluded = [np.zeros(p.samples, bool) if p.excluded is None else p.excluded for p in parts]
    return Recording(
        name,
        np.concatenate(times) if len(parts) > 1 else parts[0].time_s,
        {c: np.concatenate([part.channels[c] for part in parts]) for c in names},
        first if len(parts) == 1 else Source(first.file, digest, first.unused_columns),
        {FILE_STARTS: tuple(int(s) for s in starts[:-1])},
        np.concatenate(excluded) if any(e.any() for e in excluded) else None,
        tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def of_every_cycle(
    files: Sequence[Ramps], flanks: Flanks, stated_nm: float
) -> dict[str, list[FloatArray]]:
    """Everything but the play, by file and cycle, rad and N m.

    Lost motion at ±``stated_nm`` N m, compliance, friction, windup that friction holds.
    """
    level, largest = flanks.level, flanks.largest
    assert level is not None
    assert largest is not None
    width = float(np.mean([c.width_rad for c in level.cycles]))
    # Ramps that hardly go beyond the friction do not tell it.
    flank = max(largest.range_rad - width, 0.0)
    beyond = 2.0 * (largest.amplitude_nm - level.friction_nm)
    compliance = flank / beyond if largest is not level and beyond > 0.0 else 0.0
    return {
        "lost_motion_rad": lost_motion(files, largest, stated_nm),
        "stiffness_nm_per_rad": stiffness(files, largest),
        "compliance_rad_per_nm": of_cycles(
            largest, lambda c: max(c.range_rad - width, 0.0) / (2.0 * c.amplitude_nm)
        ),
        "friction_torque_nm": of_cycles(level, lambda c: c.friction_nm),
        "held_windup_rad": of_cycles(
            level, lambda c: 0.5 * min(c.elastic_nm * compliance, max(c.width_rad, 0.0))
        ),
    }


def described(
    found: Mapping[str, Sequence[FloatArray]],
    files: Sequence[Ramps],
    flanks: Flanks,
    shape: tuple[int, ...],
    generator: np.random.Generator,
) -> dict[str, FloatArray]:
    """Draws of everything but the play: means over the files, with their scatter.

    By name, each of ``shape``: what was measured, and the torque up to which a preload lets both
    flanks carry (0 with play, NaN where no flank is seen to lift), N m.
    """
    draws = {name: _mean_draws(each, shape, generator) for name, each in found.items()}
    draws["preload_torque_nm"] = np.zeros(shape)
    if flanks.finding == "preloaded":
        assert flanks.largest is not None
        lifts = lifting_torque(files, flanks.largest)
        draws["preload_torque_nm"] = (
            _mean_draws(lifts, shape, generator) if lifts else np.full(shape, np.nan)
        )
    return draws


def _mean_draws(
    by_file: Sequence[FloatArray], shape: tuple[int, ...], generator: np.random.Generator
) -> FloatArray:
    """Of a mean over files, or over the cycles of one: Student's t, in logarithms where positive.

    One value alone says nothing of its scatter, and is repeated.
    """
    values = observations(by_file)
    positive = bool(np.all(values > 0.0))
    seen = np.log(values) if positive else values
    drawn = np.full(shape, seen.mean())
    if seen.size > 1:
        error = seen.std(ddof=1) / np.sqrt(seen.size)
        drawn = drawn + error * generator.standard_t(seen.size - 1, size=shape)
    return np.exp(drawn) if positive else drawn


def _budget(
    flanks: Flanks, width: FloatArray, scatter: FloatArray, delta: FloatArray
) -> dict[str, float]:
    """Share of each source in the variance of ln δ."""
    level = flanks.level
    assert level is not None
    found = level.widths()
    number = sum(v.size for v in found)
    freedom = sum(v.size - 1 for v in found)
    within = sum(float(v.var()) * v.size for v in found) / freedom / number if freedom else 0.0
    shares = {"repeated_ramps": within if len(found) > 1 else float(np.var(width))}
    if len(found) > 1:
        shares["positions_round_the_turn"] = max(float(np.var(width)) - within, 0.0)
    shares["whether_any_play"] = max(4.0 * float(np.var(delta)) - float(np.var(width)), 0.0)
    total = sum(shares.values())
    return {name: value / total for name, value in shares.items()} if total else {}


def prepare(config: SnapshotConfig) -> RampMeasurer:
    """With nothing but the configuration."""
    return RampMeasurer(config)


ROUTE = Route("torque_ramp", GROUPS, summarise_ramps)
