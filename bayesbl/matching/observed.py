"""Recordings as compared with the simulation: which signals, from which sample on, how they repeat.

The state at the start of a recorded motion is unknown: the joint may be moving, in the gap, or at
rest on the flank where friction or the last move left it. This state is forgotten once the teeth
have met and the transients have died out. Everything before is left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import CURRENT, SPEED, Slot
from bayesbl.bench.motion import Motion, held_motion, recorded_motion
from bayesbl.bench.simulation import ACCURACY
from bayesbl.bench.steady import settling_time_s
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.matching.motor_lines import MotorLines
from bayesbl.noise.quantisation import Rounding, speed_steps
from bayesbl.probabilities import FALSE_ALARM
from bayesbl.recording.checks import (
    SPEED_AVERAGED_S,
    cycle_of,
    first_move,
    moves,
    require_plausible_current,
    require_same_motion,
    speed_in_another_unit,
)
from bayesbl.recording.repairs import EVEN, UNEVEN_STAMPS, even
from bayesbl.recording.repetition import Repetition, repetition
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    REFERENCE_POSITION,
    REFERENCE_SPEED,
    BoolArray,
    ComplexArray,
    FloatArray,
    Recording,
)
from bayesbl.units import RPM_PER_RAD_PER_S

WHOLE_SPEED_RPM, WHOLE_SHARE = 0.1, 5e-4
"""Largest distance of a mean speed from a whole number of rpm that is taken for the reference,
absolute and relative. The controller's integral keeps the mean over whole rotations at the
reference, except for noise. The relative limit is for slow speeds: 10.06 rpm is not 10."""

LARGEST_SPEED_ERROR = 0.01
"""Largest relative difference of a recording's mean speed from the simulated one. On the reference
bench, δ at a given amplitude is proportional to the speed to the power 0.28 to 0.57, so δ is off by
0.6 % at most."""

SURELY_OTHER = 5.0
"""Standard deviations of a mean speed, and the root of a period's χ², beyond which they differ from
the stated values. Of some sixty distinct periods, one in 30,000 does so by chance."""

LARGEST_CLOCK_ERROR = 1e-3
"""Largest assumed relative error of clock and speed together. Crystals are within 1e-4, and a
logger paced by software within a few times that. Every rate of the joint is off by as much, and δ
by about as little. A larger error of the gear ratio means a rounded ratio, or another joint."""

FAST_S = 0.25
"""In a motion that does not repeat, noise is what is faster than a mean over this time. It covers
at least two periods of any ringing, and is long compared with the correlation of sensor noise."""

LEAST_NOISE = ACCURACY
"""Relative to the reference speed: agreement of simulated speeds with an independent solver."""
RINGING_BAND = 4.0
"""Upper end of the band relative to the loop's corner, two octaves, or twice the ringing frequency
if that is higher. With a 16-bit encoder sampled at 1 kHz, the current seems to rise by 0.22 of the
gain over all frequencies, but falls by 0.44 to 0.80 of it in this band."""
SURE_SLOPE, LEAST_SLOPE = 4.0, 0.02
"""Slope of current on speed beyond which the sign is wrong, in standard errors and relative to the
controller's gain. Noise outside the loop makes the slope smaller, but never changes its sign."""
ROUNDING = 0.02
"""Share of the last rotation that a recording may lack: its own rounding, and the samples that
whitening takes."""
FEWEST_MOTOR_TURNS = 10.0
"""Fewest motor turns per load rotation: marginalising the motor's lines removes one load line in
this many."""
MOST_LEFT_OUT = 0.3
"""Largest share of a recording that is left out at its start."""


@dataclass(frozen=True, slots=True)
class Observed:
    """A recording as it is compared with the simulation.

    Attributes
    ----------
    signals
        Shape (c, n): motor speed in rpm and, if recorded, motor current in A.
    reference_speed_rpm
        Of the motor, negative for reverse.
    known
        Other known values of this recording, named as in :meth:`Bench.vector`.
    excluded
        Shape (n,): samples that are lost or unreliable; ``None`` for none.
    motor_angle_rad
        Shape (n,): absolute encoder of the motor; ``None`` for none.
    motion
        Reference motion instead of one speed; ``reference_speed_rpm`` is then its largest.
    cycle
        Period of the motion in samples; ``None`` if it does not repeat.
    rounding
        Rounding of each channel; empty if they are exact.
    begin_s
        Time from the recording's first sample to the first compared one, so that part of a
        recording has the drift of the whole.
    motor_lines
        Functions of the motor angle that are marginalised; ``None`` if nothing is.
    notes
        Notes for the reader on values that differ from the stated ones.
    """

    name: str
    signals: FloatArray
    sampling_hz: float
    reference_speed_rpm: float
    rotation_period_s: float
    known: Mapping[str, float] = field(default_factory=dict)
    excluded: BoolArray | None = None
    motor_angle_rad: FloatArray | None = None
    motion: Motion | None = None
    cycle: int | None = None
    rounding: tuple[Rounding, ...] = ()
    begin_s: float = 0.0
    motor_lines: MotorLines | None = None
    notes: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Number of samples n."""
        return int(self.signals.shape[1])

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the rows of ``signals``."""
        return ("motor_speed_rpm", "motor_current_a")[: len(self.signals)]

    @property
    def rows(self) -> list[int]:
        """Indices of the simulator's channels that ``signals`` has."""
        return [SPEED, CURRENT][: len(self.signals)]

    @property
    def lag(self) -> int:
        """Samples in one load rotation, or in one cycle of a motion, rounded.

        A quarter of the recording for a motion that does not repeat.
        """
        if self.motion is not None:
            return self.cycle or self.samples // 4
        return round(self.rotation_period_s * self.sampling_hz)

    @property
    def repeats(self) -> bool:
        """Whether the signals repeat, after a rotation or a cycle of the motion."""
        return self.motion is None or self.cycle is not None

    @property
    def compared(self) -> BoolArray:
        """Mask of samples that are not excluded, shape (n,)."""
        return np.ones(self.samples, dtype=bool) if self.excluded is None else ~self.excluded

    @property
    def first_compared(self) -> int:
        """First compared sample of a motion."""
        return 0 if self.motion is None else int(np.argmax(self.compared))

    def residual_of(self, simulated: FloatArray) -> FloatArray:
        """Recording − simulation, shape (c, n); 0 where excluded.

        Marginalised motor lines are projected out.
        """
        residual = self.signals - simulated
        if self.excluded is not None:
            residual[:, self.excluded] = 0.0
        if self.motor_lines is not None:
            self.motor_lines.project_out(residual)
        return residual

    @property
    def motor_start_rad(self) -> float | None:
        """Angle of the motor's encoder at the first sample; ``None`` if it is not absolute."""
        return None if self.motor_angle_rad is None else float(self.motor_angle_rad[0])


def reference_speed(recording: Recording, bench: Bench, stated_rpm: float | None = None) -> float:
    """Reference speed of a recording, rpm, negative in reverse.

    Parameters
    ----------
    stated_rpm
        If ``None``, the bench's own speed in the recording's direction; if the recording had
        another speed, that one.

    Raises
    ------
    RecordingError
        If the recording's mean speed is not the stated one, or in another unit.
    """
    mean = float(recording.motor_speed_rpm.mean())
    reference = stated_rpm or math.copysign(bench.value("reference_speed_rpm"), mean)
    if abs(mean / reference - 1.0) <= LARGEST_SPEED_ERROR:
        return reference
    unit = speed_in_another_unit(recording, reference)
    if stated_rpm is None and unit is None:
        return asked_speed(recording, bench)[0] or reference
    raise RecordingError(
        " ".join(filter(None, ["The recording was made at another speed than stated.", unit])),
        file=recording.place,
        found=f"{mean:.6g} rpm on average",
        expected=f"{reference:g} rpm, or the right reference_speed_rpm",
    )


def asked_speed(recording: Recording, bench: Bench) -> tuple[float | None, str]:
    """Reference speed of a recording, rpm, and the reason; ``None`` if it is the bench's."""
    # Over whole load rotations: gravity makes the speed oscillate once per rotation.
    mean = float(recording.motor_speed_rpm.mean())
    per_sample = max(abs(mean), 1e-9) * recording.sampling_period_s
    turn = 60.0 * bench.value("gear_ratio") / per_sample
    if turns := int(recording.samples / turn):
        mean = float(recording.motor_speed_rpm[: round(turns * turn)].mean())
    bench_rpm = bench.value("reference_speed_rpm")
    if abs(abs(mean / bench_rpm) - 1.0) <= LARGEST_SPEED_ERROR:
        return None, ""
    is_whole = abs(mean - round(mean)) <= min(WHOLE_SPEED_RPM, WHOLE_SHARE * abs(mean))
    reference_rpm = float(round(mean)) if is_whole else float(f"{mean:.6g}")
    return reference_rpm, f"Its mean speed, {reference_rpm:g} rpm, is taken for its reference."


def observed(
    recording: Recording, bench: Bench, reference_speed_rpm: float | None = None
) -> Observed:
    """Prepare a recording for the comparison with the bench.

    Parameters
    ----------
    reference_speed_rpm
        If ``None``, the bench's own, with the recording's direction. A motion has its own.

    Raises
    ------
    RecordingError
        If the speed is not the reference's, or a recording at one speed has fewer than two load
        rotations.
    ConfigError
        If the recording repeats after another number of motor turns than the gear ratio.
    """
    stamped, recording = recording, even(recording, EVEN)
    notes: tuple[str, ...] = ()
    if stamped.channels is not recording.channels:
        notes = (UNEVEN_STAMPS,)
    speed, period = recording.motor_speed_rpm, recording.sampling_period_s
    known = _known(recording, bench)
    if moves(recording):
        observation = _motion(recording, bench, period)
        return replace(observation, known=known, notes=(*notes, *observation.notes))
    reference = reference_speed(recording, bench, reference_speed_rpm)
    if reference_speed_rpm is None:
        notes += tuple(filter(None, [asked_speed(recording, bench)[1]]))
    reference, period, period_notes = _as_it_repeats(recording, bench, reference, period)
    rotation = bench.rotation_period_s(reference)
    if speed.size * period < 1.9 * rotation:
        raise RecordingError(
            "The recording is too short to tell noise from what repeats every load rotation.",
            file=recording.place,
            found=f"{speed.size * period / rotation:.3g} load rotations",
            expected="at least two",
        )
    _require_current_sign(recording, bench)
    signals = _signals(recording, bench)
    return Observed(
        recording.name,
        signals,
        1.0 / period,
        reference,
        rotation,
        excluded=recording.excluded,
        rounding=_rounding(signals, bench, reference),
        notes=(*notes, *period_notes),
        known=known,
    )


def _known(recording: Recording, bench: Bench) -> dict[str, float]:
    """Values that replace the bench's: a derived speed is an average."""
    averaged_s = recording.metadata.get(SPEED_AVERAGED_S)
    if averaged_s is None or bench.measurement.speed_source == "encoder":
        return {}
    return {Slot.speed_averaging__time_s.name: float(averaged_s)}


def _as_it_repeats(
    recording: Recording, bench: Bench, stated_rpm: float, period_s: float
) -> tuple[float, float, tuple[str, ...]]:
    """Reference speed and sampling period by the recording itself, and notes on them.

    The controller's integral keeps the mean over whole rotations at the reference. If impacts do
    not come when speed and gear ratio say, the clock is off. Then every impact would be compared
    with another one, and the error would be mistaken for friction or for external motion of the
    joint.

    Raises
    ------
    ConfigError
        If the period is so different that the gear ratio is wrong.
    """
    ratio = bench.value("gear_ratio")

    def repeats_after(reference_rpm: float) -> Repetition | None:
        stated_s = bench.rotation_period_s(reference_rpm)
        rounding = _rounding(recording.motor_speed_rpm[None], bench, reference_rpm)[0]
        return repetition(recording.motor_speed_rpm, 1.0 / period_s, stated_s, rounding.sd)

    repeating = repeats_after(stated_rpm)
    if repeating is None:
        return stated_rpm, period_s, ()
    reference, notes = stated_rpm, []
    speed_error = abs(repeating.mean_rpm - abs(stated_rpm))
    if (
        speed_error > SURELY_OTHER * repeating.mean_sd_rpm
        and bench.value("integral_gain_nm_per_rad") > 0.0
    ):
        reference = math.copysign(repeating.mean_rpm, stated_rpm)
        notes.append(
            f"Its mean speed over whole rotations, {reference:.6g} rpm, is taken for its "
            f"reference, not {stated_rpm:g} rpm."
        )
        repeating = repeats_after(reference) or repeating
    if repeating.gain > SURELY_OTHER**2:
        clock_error = repeating.period_s / bench.rotation_period_s(reference) - 1.0
        if abs(clock_error) > LARGEST_CLOCK_ERROR:
            # The error is the bench's, not the recording's: everything else based on this bench is
            # wrong too.
            raise ConfigError(
                "The recording does not repeat when the bench's load has turned once.",
                file=recording.place,
                where="gear_ratio",
                found=f"{repeating.motor_turns:.5g} turns of the motor until the impacts come "
                "again",
                expected=f"{ratio:g}, the bench's gear ratio: correct it in the bench file, or "
                "record again if a machine shakes the joint",
            )
        period_s /= 1.0 + clock_error
        side = "later" if clock_error > 0.0 else "earlier"
        notes.append(
            f"Its impacts come {100.0 * abs(clock_error):.2g} % {side} than speed and gear ratio "
            "say. Its clock is taken to be off by that."
        )
    return reference, period_s, tuple(notes)


def _motion(recording: Recording, bench: Bench, period_s: float) -> Observed:
    """Prepare a recorded motion for the comparison with the bench."""
    channels = recording.channels
    time = period_s * np.arange(recording.samples, dtype=np.float64)
    motion = recorded_motion(time, channels.get(REFERENCE_SPEED), channels.get(REFERENCE_POSITION))
    reference_rpm = motion.speed_rpm(time)
    require_same_motion(recording, reference_rpm)
    _require_current_sign(recording, bench, reference_rpm)
    cycle = cycle_of(reference_rpm)
    signals = _signals(recording, bench)
    fastest = float(np.max(np.abs(reference_rpm)))
    observation = Observed(
        recording.name,
        signals,
        1.0 / period_s,
        fastest,
        period_s * (cycle or recording.samples),
        excluded=recording.excluded,
        motion=motion,
        cycle=cycle,
        rounding=_rounding(signals, bench, fastest),
    )
    return without_start(observation, first_move(reference_rpm) + _recovery(observation, bench))


def _signals(recording: Recording, bench: Bench) -> FloatArray:
    """Speed and, if recorded, current, shape (c, n)."""
    rows = [recording.motor_speed_rpm]
    if MOTOR_CURRENT in recording.channels:
        require_plausible_current(recording, bench.value("current_limit_a"))
        rows.append(recording.channels[MOTOR_CURRENT])
    return np.stack(rows)


def _require_current_sign(
    recording: Recording, bench: Bench, reference_rpm: FloatArray | None = None
) -> None:
    """Require that the current falls with the speed, as a speed loop makes it.

    ``reference_rpm``: of a motion. The loop responds to the speed error. A drive may feed the
    reference and its acceleration forward, so parts that follow these say nothing about the sign.

    Above the corners of the loop's integrators, 2 K_i/K_p and 3 √(K_pos K_i/K_p), the slope of i on
    e is −K_p/K_t, or smaller if e contains noise outside the loop. Below them, ∫e and the position
    loop may reverse the sign. Far above them there is no ringing. There, the noise of a
    differentiated encoder, which a digital loop answers a tick later, alternates from tick to tick.
    Sampled more slowly, it looks white: frequencies that do not stand out of the octave above are
    left out.
    """
    if MOTOR_CURRENT not in recording.channels:
        return
    proportional, integral, position_gain = (
        bench.value(name)
        for name in (
            "speed_gain_nm_s_per_rad",
            "integral_gain_nm_per_rad",
            "position_gain_per_s",
        )
    )
    kept = np.ones(recording.samples) if recording.excluded is None else 1.0 - recording.excluded
    taper = kept * np.hanning(recording.samples)
    reference = np.zeros(recording.samples) if reference_rpm is None else reference_rpm
    error = (recording.motor_speed_rpm - reference) / RPM_PER_RAD_PER_S
    speed, current, reference_spectrum = (
        np.fft.rfft(taper * (row - row[kept > 0.0].mean()))
        for row in (error, recording.channels[MOTOR_CURRENT], reference)
    )
    rate = 2.0 * math.pi * np.fft.rfftfreq(taper.size, recording.sampling_period_s)
    corner = max(
        2.0 * integral / proportional, 3.0 * math.sqrt(position_gain * integral / proportional)
    )
    motor = bench.value("motor_inertia_kg_m2") * bench.value("gear_ratio") ** 2
    inverse_inertia = 1.0 / motor + 1.0 / bench.value("load_inertia_kg_m2")
    ringing = math.sqrt(bench.value("shaft_stiffness_nm_per_rad") * inverse_inertia)
    highest = max(RINGING_BAND * corner, 2.0 * ringing)
    rings = (rate > corner) & (rate < highest)
    power = np.abs(speed) ** 2
    octave_above = power[(rate >= highest) & (rate < 2.0 * highest)]
    noise = float(np.median(octave_above)) / math.log(2.0) if octave_above.size else 0.0
    rings &= power > noise * math.log(rate.size / FALSE_ALARM)
    speed, current = speed[rings], current[rings]
    if reference_rpm is not None:
        feedforward = np.stack(
            [reference_spectrum[rings], 1j * rate[rings] * reference_spectrum[rings]]
        )
        speed, current = (_without_feedforward(row, feedforward) for row in (speed, current))
    squares = max(float(np.sum(np.abs(speed) ** 2)), 1e-300)
    slope = float(np.real(np.vdot(speed, current))) / squares
    residual_power = np.abs(current - slope * speed) ** 2
    sd = math.sqrt(float(np.sum(residual_power * np.abs(speed) ** 2))) / squares
    gain = proportional / bench.value("torque_constant_nm_per_a")
    if slope < max(SURE_SLOPE * sd, LEAST_SLOPE * gain):
        return
    raise RecordingError(
        "The motor current has the other sign: it rises with the speed.",
        file=recording.place,
        where=MOTOR_CURRENT,
        found=f"{slope:+.3g} A for each rad/s at {corner / (2.0 * math.pi):.3g} to "
        f"{highest / (2.0 * math.pi):.3g} Hz",
        expected=f"down to {-gain:.3g}, as the bench's controller answers; reverse it under "
        "[columns]: motor_current_a = {name = …, reversed = true}",
    )


def _without_feedforward(spectrum: ComplexArray, feedforward: ComplexArray) -> ComplexArray:
    """Residual of a spectrum (k,) after regression on others, (m, k), with real coefficients."""
    columns = np.concatenate([feedforward.real, feedforward.imag], axis=1).T
    real = np.concatenate([spectrum.real, spectrum.imag])
    return np.asarray(spectrum - np.linalg.lstsq(columns, real, rcond=None)[0] @ feedforward)


def _rounding(signals: FloatArray, bench: Bench, reference_rpm: float) -> tuple[Rounding, ...]:
    """Rounding of each channel; the controller makes the current as inexact as the speed."""
    gain = bench.value("speed_gain_nm_s_per_rad") / bench.value("torque_constant_nm_per_a")
    least = LEAST_NOISE * abs(reference_rpm)
    accuracies = least, least / RPM_PER_RAD_PER_S * gain
    return tuple(
        Rounding(speed_steps(row), sd) for row, sd in zip(signals, accuracies, strict=False)
    )


def marginalising_motor_lines(observation: Observed, bench: Bench) -> Observed:
    """Marginalise everything that repeats with the motor in a steady rotation.

    Lines of the bench itself are simulated instead, so that their response on either side of a
    flank change counts too. If the motor turns only a few times per load rotation, the load's own
    lines would be lost, so nothing is done.
    """
    ratio = bench.value("gear_ratio")
    has_lines = any(effect_named(e.name).is_periodic for e in bench.effects) or bench.learned_terms
    if observation.motion is not None or has_lines or ratio < FEWEST_MOTOR_TURNS:
        return observation
    # Fix the number of turns by the load's rotations: an error of the mean speed adds up over them.
    speed = np.where(
        observation.compared,
        observation.signals[0],
        observation.signals[0][observation.compared].mean(),
    )
    rotation = observation.rotation_period_s * observation.sampling_hz
    whole_samples = round(speed.size // rotation * rotation)
    turns = np.cumsum(speed / speed[:whole_samples].mean()) * ratio / rotation
    return replace(observation, motor_lines=MotorLines(turns, observation.compared))


def without_start(observation: Observed, samples: int) -> Observed:
    """Exclude the first samples, at most ``MOST_LEFT_OUT`` of the recording."""
    begin = min(samples, int(MOST_LEFT_OUT * observation.samples))
    left_out = np.arange(observation.samples) < begin
    if observation.excluded is not None:
        left_out |= observation.excluded
    return replace(observation, excluded=left_out)


def with_held_reference(observation: Observed) -> Observed:
    """The same recording with its reference held from sample to sample, as by a digital drive."""
    if observation.motion is None:
        return observation
    return replace(
        observation,
        motion=held_motion(observation.motion, observation.samples, observation.sampling_hz),
    )


def _recovery(observation: Observed, bench: Bench) -> int:
    """Samples after which the bench has forgotten its past, to a tenth of the noise."""
    fastest = bench.vector(reference_speed_rpm=observation.reference_speed_rpm)
    # Second differences hardly contain the motion; correlated noise counts as a little less.
    second_differences = np.abs(np.diff(observation.signals[0], 2))
    noise = float(np.median(second_differences)) / (0.6745 * math.sqrt(6.0))
    accuracy_rpm = max(noise, LEAST_NOISE * abs(observation.reference_speed_rpm))
    settled = float(settling_time_s(fastest, accuracy_rpm)[0])
    return math.ceil(settled * observation.sampling_hz)


def whole_rotations(rows: FloatArray, lag: int) -> FloatArray:
    """Whitened residuals (n, …) by rotation, (r, lag, …).

    Samples missing from the last rotation, by rounding or whitening, are zero.
    """
    rotations = math.floor(len(rows) / lag + ROUNDING)
    missing = max(rotations * lag - len(rows), 0)
    padded = np.pad(rows, [(0, missing), *[(0, 0)] * (rows.ndim - 1)])
    return np.asarray(padded[: rotations * lag].reshape(rotations, lag, *rows.shape[1:]))
