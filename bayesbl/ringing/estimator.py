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
from typing import Any

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.noise import outside_lines
from bayesbl.noise.outside_lines import without_outside_lines
from bayesbl.noise.quantisation import speed_steps
from bayesbl.noise.rotation_noise import NoiseKind, estimate_noise
from bayesbl.progress import Progress
from bayesbl.recording.checks import ready_for_fit, require_no_drift, require_rotations
from bayesbl.recording.repairs import UNEVEN_STAMPS, even
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_SPEED, Recording
from bayesbl.ringing.cleaning import in_words, without_drift, without_motor_lines
from bayesbl.ringing.covariance import PointEstimate as PointEstimate
from bayesbl.ringing.covariance import covariance, objective_of, residual_of
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
from bayesbl.ringing.symbols import ROTATION, DisturbanceModel
from bayesbl.sampling.chains import SamplerSettings
from bayesbl.sampling.convergence import WEAKEST_SIGNAL_TO_NOISE

EVEN_TOLERANCE = 0.1
"""Largest distance of a time stamp from an even grid, in sampling periods, that counts as even.

Time stamps rounded to a tenth of the period are as common as real jitter of that size is harmless:
it moves a 10 Hz ringing of 30 rpm by less than 0.2 rpm at 1 kHz.
"""

HARMLESS_JITTER_S = 5e-4
"""RMS distance σ from the grid up to which time stamps count as even, whatever it is in periods.

It averages out as noise does; what stays is a ringing that is smaller by (ωσ)²/2, 0.05 % at 10 Hz.
"""


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
        if not point.signal_to_noise >= WEAKEST_SIGNAL_TO_NOISE:
            strength = f"{point.signal_to_noise:.1f} standard deviations strong"
            raise NoLongerFits(f"the ringing is only {strength}")
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
        posterior = sample_posterior(point, self.sampler, sample_seed, progress)
        second = check_sampler(point, posterior, check_seed) if check else None
        return Fit(point, posterior, second)


def nominal_speed_rpm(recording: Recording) -> float:
    """Mean motor speed without its sign, rpm."""
    return abs(float(recording.motor_speed_rpm.mean()))
