"""The estimator: everything between a recording and the draws of A, as one object.

What A means is decided by the model, what is fixed in it, the window, the baseline, the sampling
and the nominal speed; that part has a fingerprint, which a gap curve stores. How the optimum is
searched and what the noise is assumed to be do not affect the meaning and are not part of it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.noise import outside_lines
from bayesbl.noise.impact_scatter import normal_quantiles
from bayesbl.noise.outside_lines import OutsideLine, without_outside_lines
from bayesbl.noise.quantisation import speed_steps
from bayesbl.noise.rotation_noise import Noise, NoiseKind, estimate_noise
from bayesbl.progress import Progress
from bayesbl.recording.checks import ready_for_fit, require_no_drift, require_rotations
from bayesbl.recording.lost_samples import UNEVEN_STAMPS, even
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.cleaning import MotorLine, in_words, without_drift, without_motor_lines
from bayesbl.ringing.covariance import Covariance, covariance, signal_to_noise
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import (
    EarlierOptimum,
    NoLongerFits,
    Optimum,
    Rival,
    SearchMethod,
    find_optimum,
    promoted,
    warm_optimum,
)
from bayesbl.ringing.posterior import Posterior, SamplerCheck, check_sampler, sample_posterior
from bayesbl.ringing.symbols import AMPLITUDE, DECAY, FREQUENCY, ROTATION, DisturbanceModel
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import WEAKEST_SIGNAL_TO_NOISE, Contender

EVEN_TOLERANCE = 0.1
"""Largest distance of a time stamp from an even grid, in sampling periods, that counts as even.

Time stamps rounded to a tenth of the period are as common as real jitter of that size is harmless:
it moves a 10 Hz ringing of 30 rpm by less than 0.2 rpm at 1 kHz.
"""

HARMLESS_JITTER_S = 5e-4
"""RMS distance σ from the grid up to which time stamps count as even, whatever it is in periods.

It averages out as noise does; what stays is a ringing that is smaller by (ωσ)²/2, 0.05 % at 10 Hz.
"""

LEAST_LEFT = 0.05
"""Share of A that shaking leaves at least."""


NO_RECORDING = Recording("", np.zeros(0), {})


@dataclass(frozen=True)  # without slots, for what is made of it once
class PointEstimate:
    """Optimum, noise and covariance of one recording: all but the sampling.

    Attributes
    ----------
    recording
        As it was fitted. It is not kept with a finished fit: what was read is there already.
    notes
        What the reader should know about how the optimum was found.
    start
        What the search started from, in a sentence; empty for the full search alone.
    contenders
        Other optima weighed against this one; by their likelihood alone where ``None``.
    mended
        The recording that was fitted, where it is not the one given: lines or drift were removed.
    lines
        Of the motor that were removed.
    shaking
        Lines in time that were removed.
    """

    optimum: Optimum
    noise: Noise
    spread: Covariance
    recording: Recording = field(default=NO_RECORDING, compare=False)
    notes: tuple[str, ...] = ()
    start: str = ""
    contenders: tuple[Contender, ...] | None = None
    mended: Recording | None = None
    lines: tuple[MotorLine, ...] = ()
    shaking: tuple[OutsideLine, ...] = ()

    @cached_property
    def objective(self) -> Objective:
        """Sum of squares between the recording and the optimum's model."""
        return objective_of(self.optimum.model, self.recording)

    @cached_property
    def residual_rpm(self) -> FloatArray:
        """Recording minus optimum, shape (n,), rpm; NaN at samples left out."""
        return residual_of(self.objective, self.optimum)

    def shaken(self, by: tuple[OutsideLine, ...]) -> PointEstimate:
        """Beside lines that were removed: A may be another by their RMS in the speed."""
        if not by:
            return self
        rms_rpm = math.sqrt(0.5 * sum(line.size_rpm**2 for line in by))
        size = rms_rpm / self.optimum.symbols[AMPLITUDE]
        losses = self.spread.losses
        moved = size * np.random.default_rng(0).permutation(normal_quantiles(losses.size))
        losses = np.maximum(losses + moved, LEAST_LEFT - 1.0)
        return replace(self, spread=replace(self.spread, losses=losses), shaking=by)

    @property
    def misfit(self) -> RepeatingMisfit:
        """The part of the residual that repeats every load rotation."""
        return repeating_misfit(
            self.objective.time_s, self.residual_rpm, self.optimum.symbols[ROTATION]
        )

    @property
    def ringing(self) -> tuple[FloatArray, FloatArray]:
        """Optimum of (A, ln ω, ln τ), shape (3,), and its covariance, shape (3, 3).

        With what impacts lose that come early and late given back to A.

        A fixed frequency or decay has zero variance.
        """
        symbols, spread = self.optimum.symbols, self.spread
        values = (symbols[AMPLITUDE], symbols[FREQUENCY], symbols[DECAY])
        centre = np.array([values[0], np.log(values[1]), np.log(values[2])])
        scale = np.array([1.0, 1.0 / values[1], 1.0 / values[2]])
        covariance = np.zeros((3, 3))
        names = (AMPLITUDE, FREQUENCY, DECAY)
        free = [i for i, name in enumerate(names) if name in spread.names]
        places = [spread.names.index(names[i]) for i in free]
        covariance[np.ix_(free, free)] = spread.sandwich[np.ix_(places, places)]
        covariance *= np.outer(scale, scale)
        covariance[0, 0] += float(np.var(centre[0] * spread.losses))
        centre[0] *= 1.0 + float(spread.losses.mean())
        return centre, covariance


@dataclass(frozen=True, slots=True)
class Fit:
    """A point estimate with its posterior, and a second sampler's verdict on it, if asked for."""

    point: PointEstimate
    posterior: Posterior
    check: SamplerCheck | None = None

    def of(self, recording: Recording, gear_ratio: float | None = None) -> Fit:
        """The finished fit of a recording that was kept, with that recording as it was fitted."""
        fitted = self.point.mended or even(
            ready_for_fit(recording, gear_ratio), EVEN_TOLERANCE, HARMLESS_JITTER_S
        )
        return replace(self, point=replace(self.point, recording=fitted))


@dataclass(frozen=True, slots=True)
class Estimator:
    """From a recording to the posterior of the disturbance model.

    Attributes
    ----------
    model
        Free and fixed symbols, ranges, baseline.
    search
        As :func:`find_optimum` takes it.
    noise_kind, noise_order
        As :func:`estimate_noise` takes them.
    sampler
        Ensembles, steps and the level whose bounds must be stable.
    """

    model: DisturbanceModel = field(default_factory=DisturbanceModel)
    search: SearchMethod = "guess"
    noise_kind: NoiseKind = "auto"
    noise_order: int | None = None
    sampler: SamplerSettings = field(default_factory=SamplerSettings)

    def fingerprint(self, recording: Recording) -> str:
        """What decides the meaning of A in this recording, as readable JSON."""
        meaning: dict[str, Any] = {
            "waveform": "eq. 3, edges resolved to the sampling",
            "baseline_harmonics": self.model.baseline_harmonics,
            "fixed": dict(sorted(self.model.fixed.items())),
            "sampling_hz": float(f"{1.0 / recording.sampling_period_s:.3g}"),
            # For the reader only: two digits may separate equal speeds.
            "nominal_speed_rpm": float(f"{nominal_speed_rpm(recording):.2g}"),
        }
        if ranges := self.model.lasting_ranges:
            meaning["ranges"] = ranges
        return json.dumps(meaning, sort_keys=True)

    def estimate(
        self,
        recording: Recording,
        seed: np.random.SeedSequence,
        gear_ratio: float | None = None,
        earlier: EarlierOptimum | None = None,
    ) -> PointEstimate:
        """RMSE optimum with the noise's covariance around it.

        Lines of the motor and a drift of the speed are removed first where the recording shows
        them; the notes say so.

        Parameters
        ----------
        earlier
            Optimum to start from; where it no longer fits, the full search is made.

        Raises
        ------
        RecordingError
            If the recording lacks what a fit needs: channels, sampling, rotations, variation.
        """
        ready = ready_for_fit(recording, gear_ratio)
        stamped = even(ready, EVEN_TOLERANCE, HARMLESS_JITTER_S)
        notes = [] if stamped.channels is ready.channels else [UNEVEN_STAMPS]
        recording, lines = without_motor_lines(stamped)
        notes += [in_words(lines)] if lines else []
        loop = {
            n: row for n, row in recording.channels.items() if n in (MOTOR_SPEED, MOTOR_CURRENT)
        }
        turns_s = 60.0 * (gear_ratio or math.inf) / nominal_speed_rpm(recording)
        loop, shaking = without_outside_lines(loop, recording.sampling_period_s, turns_s)
        if shaking:
            recording = replace(recording, channels={**recording.channels, **loop})
            notes.append(outside_lines.in_words(shaking))
        point = self._optimal(recording, seed, gear_ratio, earlier)
        # Rotations with the same rounding are the same.
        if not point.noise.rounding_repeats:
            steady = without_drift(point.recording, point.optimum, point.residual_rpm)
            if steady is not None:
                recording, note = steady
                point = self._optimal(recording, seed, gear_ratio, earlier)
                notes.append(note)
        mended = point.recording if notes else None
        point = replace(point, notes=tuple(notes), mended=mended, lines=lines)
        return point.shaken(shaking)

    def _optimal(
        self,
        recording: Recording,
        seed: np.random.SeedSequence,
        gear_ratio: float | None,
        earlier: EarlierOptimum | None,
    ) -> PointEstimate:
        """The optimum of a recording as it is, from an earlier one if that still fits."""
        objective = objective_of(self.model, recording)
        start = ""
        if earlier is not None:
            try:
                point = self._warm(recording, objective, earlier)
                return replace(point, start=f"The search started from {earlier.told}.")
            except NoLongerFits as reason:
                start = (
                    f"{earlier.told[:1].upper()}{earlier.told[1:]} no longer fits: {reason}. "
                    "The full search was made."
                )
        optimum = find_optimum(objective, self.search, np.random.default_rng(seed))
        try:
            if gear_ratio is None:
                require_rotations(recording, recording.duration_s / optimum.symbols[ROTATION])
            point = self.around(recording, objective, optimum)
        except RecordingError as error:
            require_no_drift(recording)  # the search mistakes one for part of a long rotation
            error.name_file(recording.place)
            raise
        return replace(point, start=start)

    def _warm(
        self, recording: Recording, objective: Objective, earlier: EarlierOptimum
    ) -> PointEstimate:
        """The optimum from an earlier one, if its ringing also stands out of the noise."""
        try:
            point = self.around(recording, objective, warm_optimum(objective, earlier))
        except RecordingError as error:
            raise NoLongerFits(error.problem) from None
        ratio = signal_to_noise(point.optimum, point.spread)
        if not ratio >= WEAKEST_SIGNAL_TO_NOISE:
            raise NoLongerFits(f"the ringing is only {ratio:.1f} standard deviations strong")
        return point

    def around(self, recording: Recording, objective: Objective, optimum: Optimum) -> PointEstimate:
        """Noise and covariance around an optimum already found."""
        residual = residual_of(objective, optimum)
        noise = estimate_noise(
            residual,
            optimum.symbols[ROTATION],
            objective.period_s,
            self.noise_kind,
            self.noise_order,
            speed_steps(recording.motor_speed_rpm),
        )
        spread = covariance(optimum, objective.time_s, residual, noise)
        return PointEstimate(optimum, noise, spread, recording)

    def at_rival(self, point: PointEstimate, rival: Rival) -> PointEstimate:
        """A rival of the optimum in its place, of the recording as it was prepared for that."""
        objective = point.objective
        other = self.around(point.recording, objective, promoted(objective, point.optimum, rival))
        moved = replace(point, optimum=other.optimum, noise=other.noise, spread=other.spread)
        return moved.shaken(point.shaking)

    def fit(
        self,
        recording: Recording,
        seed: np.random.SeedSequence,
        gear_ratio: float | None = None,
        progress: Progress | None = None,
        choose: Callable[[PointEstimate], PointEstimate] | None = None,
        *,
        earlier: EarlierOptimum | None = None,
        check: bool = False,
    ) -> Fit:
        """Optimum and posterior; one child seed for each.

        Parameters
        ----------
        choose
            Picks among the optimum and its rivals; the optimum itself by default.
        earlier
            Optimum to start from.
        check
            Whether a nested sampler samples the posterior too.

        Raises
        ------
        RecordingError
            As :meth:`estimate`.
        """
        search_seed, sample_seed, check_seed = seed.spawn(3)
        point = self.estimate(recording, search_seed, gear_ratio, earlier)
        if choose is not None:
            point = choose(point)
        posterior = sample_posterior(
            point.objective,
            point.optimum,
            point.spread,
            self.sampler,
            sample_seed,
            progress,
            contenders=point.contenders,
        )
        if not check:
            return Fit(point, posterior)
        second = check_sampler(point.objective, point.optimum, point.spread, posterior, check_seed)
        return Fit(point, posterior, second)


def objective_of(model: DisturbanceModel, recording: Recording) -> Objective:
    """Sum of squares between a recording and a model, without excluded samples."""
    return Objective(
        model, recording.time_s, recording.motor_speed_rpm, excluded=recording.excluded
    )


def residual_of(objective: Objective, optimum: Optimum) -> FloatArray:
    """Recording minus optimum, shape (n,), rpm; NaN at samples left out."""
    residual = objective.speed_rpm - optimum.predict(objective.time_s)
    return np.where(objective.used, residual, np.nan)


def nominal_speed_rpm(recording: Recording) -> float:
    """Mean motor speed without its sign, rpm."""
    return abs(float(recording.motor_speed_rpm.mean()))


PHASE_BINS = 360


@dataclass(frozen=True, slots=True)
class RepeatingMisfit:
    """Rotation-averaged residual.

    Attributes
    ----------
    phase_rad
        Load phase from the start of the recording, bin centres, shape (b,), in [0, 2π).
    mean_rpm, standard_error_rpm
        Average of the residual over rotations and its standard error from their scatter,
        shape (b,), rpm.
    """

    phase_rad: FloatArray
    mean_rpm: FloatArray
    standard_error_rpm: FloatArray

    @property
    def rms_rpm(self) -> float:
        """RMS of what repeats, without the noise that survives averaging, rpm."""
        excess = float(np.mean(self.mean_rpm**2 - self.standard_error_rpm**2))
        return math.sqrt(max(excess, 0.0))

    def at(
        self, since_begin_s: FloatArray, rotation_period_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Average and standard error at times since the recording's start, shape (n,) each, rpm."""
        phase = 2.0 * np.pi / rotation_period_s * since_begin_s
        turn = 2.0 * np.pi
        mean = np.interp(phase, self.phase_rad, self.mean_rpm, period=turn)
        return mean, np.interp(phase, self.phase_rad, self.standard_error_rpm, period=turn)


def repeating_misfit(
    time_s: FloatArray, residual_rpm: FloatArray, rotation_period_s: float
) -> RepeatingMisfit:
    """Average the residual, NaN where left out, at equal load phase over the rotations.

    Within a rotation each bin is averaged first; the scatter between rotations, which are
    independent but for noise slower than a rotation, gives the standard error.
    """
    known = np.isfinite(residual_rpm)
    turns = (time_s[known] - time_s[0]) / rotation_period_s
    residual_rpm = residual_rpm[known]
    rotation = np.floor(turns).astype(int)
    bins = np.minimum((PHASE_BINS * (turns - rotation)).astype(int), PHASE_BINS - 1)
    cell = rotation * PHASE_BINS + bins
    cells = (rotation[-1] + 1) * PHASE_BINS
    count = np.bincount(cell, minlength=cells).reshape(-1, PHASE_BINS)
    total = np.bincount(cell, residual_rpm, minlength=cells).reshape(-1, PHASE_BINS)
    filled = count > 0
    mean_by_rotation = np.where(filled, total / np.maximum(count, 1), np.nan)
    rotations = filled.sum(axis=0)
    mean = np.nansum(mean_by_rotation, axis=0) / np.maximum(rotations, 1)
    scatter = np.nansum((mean_by_rotation - mean) ** 2, axis=0)
    error = np.sqrt(scatter / np.maximum(rotations - 1, 1) / np.maximum(rotations, 1))
    phase = 2.0 * np.pi * (np.arange(PHASE_BINS) + 0.5) / PHASE_BINS
    return RepeatingMisfit(phase, mean, error)
