"""The torque-ramp route: the gap from ramps of the motor's torque with the output held.

δ is half of the play. The play is the distance, at zero torque, between the positions at which
ramps leave the joint on either flank, less the unknown part that is compliance held by friction.
See ``docs/design.md``, "Torque ramps".

The width between the flanks consists of the dead zone and the compliance that friction holds. If
that compliance changed from the first recording to the last, the width changes without wear.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri, stdtr

from bayesbl.config.sections import SnapshotRecording
from bayesbl.errors import RecordingError
from bayesbl.matching.posterior import MATTERS
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.measurement import (
    UPPER_BOUND_LEVEL,
    Answer,
    JointCheck,
    Measurement,
    Measurer,
    Reason,
    Task,
    blind_spot,
    check_item,
    joint_check,
    outcome_of,
    sampler_of,
    sampling_reasons,
    upper_bound,
)
from bayesbl.measurement.summary_types import RampsSummary
from bayesbl.measurement.wear import since_repair
from bayesbl.progress import of_stage
from bayesbl.ramps.flanks import (
    HELD,
    Flanks,
    find_flanks,
    lifting_torque,
    lost_motion,
    observations,
    of_cycles,
    stiffness,
)
from bayesbl.ramps.play import PlayPosterior, Widths, sample_play
from bayesbl.ramps.torque_cycles import Ramps, find_ramps, left_rad
from bayesbl.recording.checks import require_alive, require_channels
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_TORQUE, FloatArray, Recording, Source
from bayesbl.results.variables import Group, columns, table

UNREACHED = 0.5
"""Share of the width by which small ramps may understate the play, at most.

If the joint creeps in presliding, small ramps stop short of the flanks, by less than the extra
width that larger ramps leave. A judgement: on the gearboxes of the test stand, larger ramps leave
up to four times the play, because they bend the flanks.
"""

CHANGED_SD = 2.0
"""Standard deviations from which friction or compliance counts as changed: 5 % each by chance."""

ROUNDING = float(np.finfo(float).eps)
"""Rounding of a logarithm, so that changes without scatter have a finite size too."""

LOG_FINITE = 0.5 * float(np.log(np.finfo(float).max)) - 10.0
"""Logarithm whose square is finite: Student's t of two files goes farther."""

COMPARED = {
    "compliance_rad_per_nm": ("compliance", "rad/N m"),
    "friction_torque_nm": ("friction", "N m"),
}


SOFTER = blind_spot("softer_flanks_unseen")


@dataclass(frozen=True, slots=True)
class HeldCompliance:
    """Friction and compliance of a snapshot, and the gap, for the comparison with others.

    ``draws``: draws of ``delta_rad``, ``held_windup_rad`` and the quantities in :data:`COMPARED`,
    rad and N m. ``measured``: the quantities in :data:`COMPARED`, by file and cycle.
    """

    draws: Mapping[str, FloatArray]
    measured: Mapping[str, Sequence[FloatArray]]


def compliance_check(first: HeldCompliance, last: HeldCompliance) -> JointCheck:
    """Changes of friction and compliance, and how far they may have moved the change of δ."""
    if first.draws is last.draws:
        return joint_check()
    before, after = first.draws, last.draws
    items = [
        check_item(
            quantity,
            float(np.median(after[name])),
            float(np.median(before[name])),
            unit,
            _deviations(last.measured[name], first.measured[name]),
        )
        for name, (quantity, unit) in COMPARED.items()
    ]
    held = float(np.median(after["held_windup_rad"]) - np.median(before["held_windup_rad"]))
    low, middle, high = np.quantile(after["delta_rad"] - before["delta_rad"], (0.05, 0.5, 0.95))
    # Less held compliance cannot pass for growth. The width falls with it, but also if more
    # friction keeps the ramps from the flanks.
    error = HELD * (max(held, 0.0) if middle > 0.0 else abs(held))
    changed = [item for item in items if abs(item["z"]) > CHANGED_SD]
    if not changed or error <= MATTERS * (high - low):
        return joint_check(True, items, blind_spots=(SOFTER,))
    held_more = blind_spot("held_compliance_unseen", error, items=changed)
    return joint_check(True, items, blind_spots=(held_more, SOFTER))


def _deviations(last: Sequence[FloatArray], first: Sequence[FloatArray]) -> float:
    """Change over its scatter (Student's t), converted to a normal deviate of equal probability.
    Positions around the turn are paired by their order, as their widths are, so a lasting pattern
    hides no change. Without scatter from repetitions, the result is 0."""
    after, before = observations(last), observations(first)
    if np.all(after > 0.0) and np.all(before > 0.0):
        after, before = np.log(after), np.log(before)
    change = float(after.mean() - before.mean())
    paired = len(last) == len(first) > 1
    samples = [after - before] if paired else [after, before]
    if change == 0.0 or min(sample.size for sample in samples) < 2:
        return 0.0
    errors = np.array([sample.var(ddof=1) / sample.size + ROUNDING**2 for sample in samples])
    freedoms = np.array([sample.size - 1.0 for sample in samples])
    variance = float(errors.sum())
    freedom = variance**2 / float(np.sum(errors**2 / freedoms))  # Welch's, for two samples
    probability = float(stdtr(freedom, -abs(change) / np.sqrt(variance)))
    return float(-np.sign(change) * ndtri(max(probability, ROUNDING**2)))


LOST_MOTION_SHARE = 0.03
"""Share of the rated torque at which makers of reducers state lost motion; of the largest torque
of the ramps if that is not known."""

GOOD_PART = 0.5
"""Share of the gap that soft flanks may cause, from which the reader is told."""

PRELOAD = "preload_torque_nm"

FILE_STARTS = "file_starts"
"""Key of a recording's metadata: the first sample of each of its files."""


class RampMeasurer(Measurer):
    """The torque-ramp route."""

    gap_range_rad = (1e-6, 0.5)
    """From an encoder's step to a tooth's width; nothing is swept or searched."""

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """Yield the gear ratio, because it decides the answer."""
        ratio = self.config.joint.gear_ratio
        ratio_text = "1, of the output (no gear_ratio)" if ratio is None else f"{ratio:g}"
        yield "gear ratio", lambda: ratio_text

    def read(self, entry: SnapshotRecording) -> Recording:
        """Read and join all files of the snapshot, with position and torque as in the files."""
        parts = [
            # Recording may pause between ramps: time does not matter here.
            read_recording(
                file, name=entry.name, columns=self.config.column_specs, even=False, timed=False
            )
            for file in entry.every_file
        ]
        for part in parts:
            require_channels(part, [MOTOR_POSITION, MOTOR_TORQUE])
            require_alive(part, [MOTOR_POSITION, MOTOR_TORQUE])
        by_content: dict[str, str] = {}
        for source in (part.source for part in parts if part.source is not None):
            if source.sha256 in by_content:
                raise RecordingError(
                    "Two files of a snapshot are identical: one position would count twice.",
                    file=source.file,
                    found=f"the content of {by_content[source.sha256]}",
                    expected="a file for each position around the turn",
                )
            by_content[source.sha256] = source.file
        return _joined(entry.name, parts)

    def require_usable(self, recording: Recording) -> None:
        """Require that the torque goes to both sides of zero and back at least once."""
        self._flanks(recording)

    def doubts(self, recording: Recording) -> Iterable[Reason]:
        """Reasons why δ will be withheld."""
        _, flanks = self._flanks(recording)
        return against(flanks)

    def measure(self, task: Task) -> Measurement:
        """Measure the play of all snapshots together."""
        files, flanks = zip(*map(self._flanks, task.recordings), strict=True)
        widths = [
            Widths(r.name, tuple(flank.level.widths()), self._resolution(r))
            for r, flank in zip(task.recordings, flanks, strict=True)
        ]
        report = of_stage(task.progress, f"Sampling {' and '.join(task.names)}")
        play_seed, shares_seed, *seeds = task.seeds.direct.spawn(2 + len(files))
        # One file each, at different positions of the turn: their flanks do not overlap.
        levels = [flank.level for flank in flanks]
        middles = [level.middle_rad for level in levels]
        elsewhere = len(levels) > 1 and all(len(level.widths()) == 1 for level in levels)
        if elsewhere:
            widest = max(float(level.widths()[0].mean()) for level in levels)
            elsewhere = max(middles) - min(middles) > widest
        play = sample_play(
            widths, sampler_of(self.config), play_seed, report, round_the_turn=elsewhere
        )
        shares = np.random.default_rng(shares_seed).uniform(size=(2, *play.log_density.shape))
        snapshot_parts = zip(task.recordings, files, flanks, seeds, strict=True)
        answers, held = zip(
            *(self._answer(*parts, play, shares, elsewhere=elsewhere) for parts in snapshot_parts),
            strict=True,
        )
        first_used = since_repair([entry.repaired for entry in self.config.recordings]).start
        check = compliance_check(held[first_used], held[-1])
        return Measurement("torque_ramp", answers, same_joint=check)

    def _answer(
        self,
        recording: Recording,
        files: tuple[Ramps, ...],
        flanks: Flanks,
        seed: np.random.SeedSequence,
        play: PlayPosterior,
        shares: FloatArray,
        *,
        elsewhere: bool,
    ) -> tuple[Answer, HeldCompliance]:
        generator = np.random.default_rng(seed)
        width, rated = play.width_rad[recording.name], self.config.joint.rated_torque_nm
        stated_nm = LOST_MOTION_SHARE * (rated or flanks.largest.amplitude_nm)
        of_cycles = of_every_cycle(flanks, stated_nm)
        draws = {
            "width_rad": width,
            "scatter_rad": play.scatter_rad[recording.name],
            **described(of_cycles, flanks, width, generator),
        }
        gap = draws["delta_rad"] = gap_draws(flanks, draws, shares, generator)
        # Flanks may be soft enough at small torque to be the whole width.
        is_play = HELD * shares[0] * draws["held_windup_rad"] < 0.5 * width
        sure = flanks.probability_of_play * float(np.mean(is_play))
        flanks = replace(flanks, probability_of_play=sure)
        if play.shared_pattern is not None:
            draws["shared_pattern"] = play.shared_pattern
        reasons = [*against(flanks), *sampling_reasons(play.diagnostics)]
        withheld = outcome_of(reasons) == "withheld"
        has_ratio = self.config.joint.gear_ratio is not None
        reasons += notes_on(files, flanks, draws, ratio_given=has_ratio, elsewhere=elsewhere)
        reasons += [Reason.of_text("recording", text) for text in recording.notes]
        groups, numbers = shared.stored(
            ramp_groups(recording, files, flanks, draws, play, stated_nm), self.config.interval
        )
        has_play = flanks.probability_of_play >= UPPER_BOUND_LEVEL
        answer = Answer(
            recording.name,
            gap,
            reasons,
            groups,
            {
                **numbers,
                "preloaded": flanks.finding == "preloaded",
                "ramps": _ramps(flanks),
                "noise": shared.no_speed_noise("repeated"),
            },
            upper_bound_rad=None if has_play or withheld else upper_bound(gap),
        )
        return answer, HeldCompliance(draws, of_cycles)

    @property
    def _ratio(self) -> float:
        return self.config.joint.gear_ratio or 1.0

    def _resolution(self, recording: Recording) -> float:
        """Smallest step of the position, at the output, rad."""
        steps = np.abs(np.diff(recording.channels[MOTOR_POSITION]))
        return float(steps[steps > 0.0].min()) / self._ratio

    def _flanks(self, recording: Recording) -> tuple[tuple[Ramps, ...], Flanks]:
        """The ramps of each file and the flanks that they show, at the output.

        Raises RecordingError if the torque does not go to both sides of zero and back at least
        once.
        """
        torque = recording.channels[MOTOR_TORQUE] * self._ratio
        position = recording.channels[MOTOR_POSITION] / self._ratio
        starts = list(recording.metadata[FILE_STARTS])
        stops = [*starts[1:], recording.samples]
        files = tuple(
            find_ramps(torque[a:b], position[a:b]) for a, b in zip(starts, stops, strict=True)
        )
        flanks = find_flanks(files, self._resolution(recording))
        if flanks is None:
            raise RecordingError(
                "The torque does not go to one side of zero, back, to the other side, and back.",
                file=recording.place,
                where=MOTOR_TORQUE,
                found=f"{torque.min():.3g} to {torque.max():.3g} N m at the output",
                expected="ramps of about the same torque both ways, each back to zero: they leave "
                "the joint on one flank and on the other",
            )
        return files, flanks


def against(flanks: Flanks) -> list[Reason]:
    """The reason why δ is withheld, if it is."""
    if flanks.answered:
        return []
    values = {
        "skipped_nm": list(flanks.skipped_nm),
        "amplitude_nm": flanks.level.amplitude_nm,
        "needed_nm": flanks.needed_nm,
        "friction_nm": flanks.level.friction_nm,
    }
    return [Reason("ramps_held", values)]


def notes_on(
    files: Sequence[Ramps],
    flanks: Flanks,
    draws: Mapping[str, FloatArray],
    *,
    ratio_given: bool,
    elsewhere: bool,
) -> Iterator[Reason]:
    """Yield notes on how δ was obtained: on flanks, torque and positions.

    ``draws``: those of ``width_rad`` and ``preload_torque_nm``. ``elsewhere``: each snapshot has
    one file, and these are at different positions of the turn.
    """
    level, relative = flanks.level, flanks.relative_compliance
    if flanks.finding == "preloaded":
        lifting_nm = float(np.median(draws[PRELOAD]))
        values = {
            "relative_compliance": relative,
            "lifts_nm": None if np.isnan(lifting_nm) else lifting_nm,
            "width_rad": float(np.median(draws["width_rad"])) * without_play(flanks, draws),
        }
        yield Reason("no_play", values)
    soft = HELD / relative
    if flanks.finding == "play" and soft > GOOD_PART:
        values = {"probability": flanks.probability_of_play, "relative_compliance": relative}
        yield Reason("soft_flanks", {**values, "times": HELD, "share": soft})
    if flanks.skipped_nm and flanks.answered:
        skipped = {"skipped_nm": list(flanks.skipped_nm), "amplitude_nm": level.amplitude_nm}
        yield Reason("ramps_skipped", skipped)
    # Less than the friction leaves the joint where it is.
    moved = [o for o in (file.offset_nm for file in files) if abs(o) > level.friction_nm]
    if moved:
        yield Reason("torque_offset", {"low_nm": min(moved), "high_nm": max(moved)})
    if any(file.turned for file in files):
        yield Reason("torque_turned")
    if not ratio_given:
        yield Reason("no_gear_ratio")
    missing = sum(not file for file in level.files)
    if missing:
        values = {"missing": missing, "files": len(files), "amplitude_nm": level.amplitude_nm}
        yield Reason("files_without_cycle", values)
    if elsewhere:
        yield Reason("positions_differ")
    elif len(files) - missing == 1:
        yield Reason("one_position")
        if len(level.cycles) == 1:
            yield Reason("one_cycle")


def _ramps(flanks: Flanks) -> RampsSummary:
    """The ramps that show the play."""
    used = [file for file in flanks.level.files if file]
    return {
        "positions": len(used),
        "cycles": len(flanks.level.cycles),
        "torque_nm": float(np.mean([cycle.amplitude_nm for cycle in flanks.level.cycles])),
        "width_rad": [float(np.mean([c.width_rad for c in file])) for file in used],
    }


def _joined(name: str, parts: Sequence[Recording]) -> Recording:
    """Join several files to one recording, with continuous time."""
    names = [c for c in parts[0].channels if all(c in part.channels for part in parts)]
    starts = np.cumsum([0, *(part.samples for part in parts)])
    times, begin_s = [], 0.0
    for part in parts:
        times.append(part.time_s - part.time_s[0] + begin_s)
        begin_s = float(times[-1][-1]) + part.sampling_period_s
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


def of_every_cycle(flanks: Flanks, stated_nm: float) -> dict[str, list[FloatArray]]:
    """All quantities but the play, by file and cycle, rad and N m.

    These are lost motion at ±``stated_nm`` N m, stiffness, compliance, friction, and the wind-up
    that friction holds.
    """
    level, largest, width = flanks.level, flanks.largest, flanks.level.width_rad
    return {
        "lost_motion_rad": of_cycles(largest, lambda c: lost_motion(c, stated_nm)),
        "stiffness_nm_per_rad": of_cycles(largest, stiffness),
        "compliance_rad_per_nm": of_cycles(
            largest, lambda c: max(c.range_rad - width, 0.0) / (2.0 * c.amplitude_nm)
        ),
        "friction_torque_nm": of_cycles(level, lambda c: c.friction_nm),
        "held_windup_rad": [0.5 * np.minimum(w, width) for w in flanks.windup_rad if w.size],
    }


def gap_draws(
    flanks: Flanks,
    draws: Mapping[str, FloatArray],
    shares: FloatArray,
    generator: np.random.Generator,
) -> FloatArray:
    """Draws of δ, rad, of the same shape as ``draws``.

    With play, for u and v uniform between 0 and 1,

        δ = (1 + v² more)/2 · width − u HELD · held windup        at least 0

    where ``more`` is the extra width after larger ramps, as a share, up to ``UNREACHED``.
    ``shares``, of shape (2, chain, draw), are u and v: properties of the joint, so the same for all
    snapshots.

    Without play, the width between the flanks is compliance held by friction, and a gap is an
    unseen part of it. It is bounded by the width after larger ramps, unless a preload explains the
    loop.
    """
    width, held = draws["width_rad"], draws["held_windup_rad"]
    soft, unreached = shares
    more = min(flanks.left_by_larger - 1.0, UNREACHED)
    delta = 0.5 * (1.0 + unreached**2 * more) * width - HELD * soft * held
    no_play = generator.uniform(size=width.shape) > flanks.probability_of_play
    bound = 0.5 * width * without_play(flanks, draws)
    return np.where(no_play, bound * generator.uniform(size=width.shape), np.maximum(delta, 0.0))


def without_play(flanks: Flanks, draws: Mapping[str, FloatArray]) -> float:
    """Bound of a gap without play, as a multiple of the width; 1 if a flank is seen to lift."""
    is_preloaded = flanks.finding == "preloaded" and np.isfinite(draws[PRELOAD]).any()
    return 1.0 if is_preloaded else flanks.left_by_larger


def described(
    of_cycles: Mapping[str, Sequence[FloatArray]],
    flanks: Flanks,
    width: FloatArray,
    generator: np.random.Generator,
) -> dict[str, FloatArray]:
    """Draws of all quantities but the play: means over the files, with their scatter.

    By name, each of the shape of ``width``: the measured quantities, and the torque (N m) up to
    which a preload keeps both flanks in contact (0 with play, NaN if no flank is seen to lift).
    """
    shape = width.shape
    draws = {name: _mean_draws(by_file, shape, generator) for name, by_file in of_cycles.items()}
    draws[PRELOAD] = np.zeros(shape)
    if flanks.finding == "preloaded":
        lifting_nm = lifting_torque(flanks.largest)
        draws[PRELOAD] = (
            _mean_draws(lifting_nm, shape, generator) if lifting_nm else np.full(shape, np.nan)
        )
    return draws


def _mean_draws(
    by_file: Sequence[FloatArray], shape: tuple[int, ...], generator: np.random.Generator
) -> FloatArray:
    """Draws of a mean over files, or over cycles of one file: Student's t, of logarithms if
    positive. A single value has no known scatter, and is repeated."""
    values = observations(by_file)
    positive = bool(np.all(values > 0.0))
    transformed = np.log(values) if positive else values
    drawn = np.full(shape, transformed.mean())
    if transformed.size > 1:
        error = transformed.std(ddof=1) / np.sqrt(transformed.size)
        drawn = drawn + error * generator.standard_t(transformed.size - 1, size=shape)
    return np.exp(np.clip(drawn, -LOG_FINITE, LOG_FINITE)) if positive else drawn


def _budget(flanks: Flanks, width: FloatArray, delta: FloatArray) -> dict[str, float]:
    """Share of each source in the variance of ln δ."""
    widths = flanks.level.widths()
    count = sum(v.size for v in widths)
    freedom = sum(v.size - 1 for v in widths)
    within = sum(float(v.var()) * v.size for v in widths) / freedom / count if freedom else 0.0
    shares = {"repeated_ramps": within if len(widths) > 1 else float(np.var(width))}
    if len(widths) > 1:
        shares["positions_round_the_turn"] = max(float(np.var(width)) - within, 0.0)
    shares["held_windup"] = max(4.0 * float(np.var(delta)) - float(np.var(width)), 0.0)
    total = sum(shares.values())
    return {name: value / total for name, value in shares.items()} if total else {}


# What is stored.

MOST_POINTS = 1500
"""Points of a file's path in ``loop``, at most."""

POSTERIOR = Group(
    "posterior",
    (
        shared.DELTA,
        *table("""
            width_rad (chain, draw) | rad
                | angle between the positions at which ramps to either side leave the joint
            scatter_rad (chain, draw) | rad
                | standard deviation of that width around the turn, or of repeated ramps of one file
            shared_pattern? (chain, draw) | 1
                | correlation of the widths around the turn between snapshots
            lost_motion_rad! (chain, draw) | rad
                | angle between the positions at the stated torques, without friction
            compliance_rad_per_nm! (chain, draw) | rad/(N m) | compliance of the loaded joint
            stiffness_nm_per_rad! (chain, draw) | N m/rad
                | position over torque by least squares along the largest ramps, both sides
            friction_torque_nm! (chain, draw) | N m | friction over the range of the ramps
            held_windup_rad! (chain, draw) | rad
                | wind-up held by friction, in half the width, by the compliance behind the play
            preload_torque_nm! (chain, draw) | N m
                | torque at which a preloaded joint's flank lifts; 0 with play, NaN where not seen
        """),
    ),
    (shared.CHAIN, shared.DRAW),
)

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log density of the scatter, widths integrated out, all snapshots
        """),
        shared.ACCEPTANCE,
    ),
)

CYCLES = Group(
    "cycles",
    table("""
        file (cycle) | 1 | number of the file, from 0
        amplitude_nm (cycle) | N m | largest torque
        width_rad (cycle) | rad | angle between the positions left at zero torque
        range_rad (cycle) | rad | angle between the farthest positions
        elastic_nm (cycle) | N m | torque without friction between the positions left
        friction_nm (cycle) | N m | half the mean height of the loop
        used (cycle) | 1 | whether the width counts (1): the smallest ramps that reach both flanks
        relative_compliance! | 1 | compliance between the positions left, over that behind them
        probability_of_play! | 1 | probability that softer flanks are not the whole width
        lost_motion_torque_nm! | N m | torque, both ways, at which lost motion is stated
    """),
)

LOOP = Group(
    "loop",
    table("""
        torque_nm (point) | N m | averaged torque along the cycles of each file, at the output
        position_rad (point) | rad | averaged position
        file (point) | 1 | number of the file, from 0
        left_low_rad (position) | rad | mean position left by torque below zero
        left_high_rad (position) | rad | mean position left by torque above zero
    """),
)


def ramp_groups(
    recording: Recording,
    files: Sequence[Ramps],
    flanks: Flanks,
    draws: Mapping[str, FloatArray],
    play: PlayPosterior,
    stated_nm: float,
) -> dict[Group, object]:
    """Data of all groups of one snapshot.

    ``draws``: those of all of :data:`POSTERIOR`; ``stated_nm``: the torque of the lost motion.
    """
    lengths = [ramps.torque_nm.size for ramps in files]
    numbered_cycles = [(n, cycle) for n, file in enumerate(files) for cycle in file.cycles]
    is_used = [any(cycle is other for other in flanks.level.cycles) for _, cycle in numbered_cycles]
    return {
        POSTERIOR: draws,
        SAMPLE_STATS: {"lp": play.log_density, "acceptance_rate": play.diagnostics.acceptance},
        **shared.common_groups(
            recording,
            (MOTOR_POSITION, MOTOR_TORQUE),
            play.diagnostics,
            _budget(flanks, draws["width_rad"], draws["delta_rad"]),
            file=np.repeat(np.arange(len(lengths), dtype=float), lengths),
        ),
        CYCLES: (
            columns(CYCLES, [cycle for _, cycle in numbered_cycles]),
            flanks,
            {
                "file": np.array([n for n, _ in numbered_cycles], dtype=float),
                "used": np.array(is_used, dtype=float),
                "lost_motion_torque_nm": stated_nm,
            },
        ),
        LOOP: _loop(flanks),
    }


def _loop(flanks: Flanks) -> dict[str, FloatArray]:
    level = flanks.level
    numbers = [float(n) for n, cycles in enumerate(level.files) if cycles]
    files = list(filter(None, level.files))
    torque, position = [], []
    for cycles in files:  # the path along all cycles of a file, in order, thinned
        path = slice(cycles[0].first.begin, cycles[-1].last.back + 1)
        step = max(1, -(-(path.stop - path.start) // MOST_POINTS))
        torque.append(cycles[0].torque_nm[path][::step])
        position.append(cycles[0].position_rad[path][::step])
    low, high = zip(*map(left_rad, files), strict=True)
    return {
        "torque_nm": np.concatenate(torque),
        "position_rad": np.concatenate(position),
        "file": np.repeat(numbers, [part.size for part in torque]),
        "left_low_rad": np.array(low),
        "left_high_rad": np.array(high),
    }
