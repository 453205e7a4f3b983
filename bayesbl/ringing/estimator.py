"""The estimator: all steps from a recording to the draws of A, as one object.

The meaning of A is defined by the model, its fixed symbols, the window, the baseline, the sampling
and the nominal speed. These have a fingerprint, which a gap curve stores. The search method and the
noise model do not affect the meaning and are not part of it.
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
from bayesbl.recording.repairs import EVEN, UNEVEN_STAMPS, even
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

HARMLESS_JITTER_S = 5e-4
"""RMS distance σ from the grid up to which time stamps count as even, whatever the period. Such
jitter averages out like noise, except that the ringing appears smaller by (ωσ)²/2, 0.05 % at 10
Hz."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A point estimate with its posterior, and the check by a second sampler if requested."""

    point: PointEstimate
    posterior: Posterior
    check: SamplerCheck | None = None


@dataclass(frozen=True, slots=True)
class Estimator:
    """Estimates the posterior of the disturbance model from a recording.

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
        """All that defines the meaning of A in this recording, as readable JSON."""
        meaning: dict[str, Any] = {
            "waveform": "eq. 3, edges resolved to the sampling",
            "baseline_harmonics": self.model.baseline_harmonics,
            "fixed": dict(sorted(self.model.fixed.items())),
            "sampling_hz": float(f"{1.0 / recording.sampling_period_s:.3g}"),
            # For the reader only: rounded to two digits, equal speeds may differ.
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
        """Find the RMSE optimum, with its covariance under the noise.

        Lines of the motor and a drift of the speed are removed first if the recording shows them.
        The notes say so.

        Parameters
        ----------
        earlier
            Optimum to start from; if it no longer fits, the full search is made.

        Raises
        ------
        RecordingError
            If the recording lacks what a fit needs: channels, sampling, rotations, variation.
        """
        ready = ready_for_fit(recording, gear_ratio)
        evenly_sampled = even(ready, EVEN, HARMLESS_JITTER_S)
        notes = [] if evenly_sampled.channels is ready.channels else [UNEVEN_STAMPS]
        recording, lines = without_motor_lines(evenly_sampled)
        notes += [in_words(lines)] if lines else []
        loop_channels = {
            n: row for n, row in recording.channels.items() if n in (MOTOR_SPEED, MOTOR_CURRENT)
        }
        rotation_s = 60.0 * (gear_ratio or math.inf) / nominal_speed_rpm(recording)
        loop_channels, shaking = without_outside_lines(
            loop_channels, recording.sampling_period_s, rotation_s
        )
        if shaking:
            recording = replace(recording, channels={**recording.channels, **loop_channels})
            notes.append(outside_lines.in_words(shaking))
        point = self._optimal(recording, seed, gear_ratio, earlier)
        # With repeating rounding, differences between rotations vanish and show no drift.
        if not point.noise.rounding_repeats:
            drift_removed = without_drift(point.recording, point.optimum, point.residual_rpm)
            if drift_removed is not None:
                recording, note = drift_removed
                point = self._optimal(recording, seed, gear_ratio, earlier)
                notes.append(note)
        point = replace(point, notes=tuple(notes), mended=bool(notes), lines=lines)
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
                point = self._warm_start(recording, objective, earlier)
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
            require_no_drift(recording)  # a drift can look like part of a long rotation
            error.name_file(recording.place)
            raise
        return replace(point, start=start)

    def _warm_start(
        self, recording: Recording, objective: Objective, earlier: EarlierOptimum
    ) -> PointEstimate:
        """Start from an earlier optimum; the ringing must also stand out of the noise."""
        try:
            point = self.around(recording, objective, warm_optimum(objective, earlier))
        except RecordingError as error:
            raise NoLongerFits(error.problem) from None
        if not point.signal_to_noise >= WEAKEST_SIGNAL_TO_NOISE:
            strength = f"{point.signal_to_noise:.1f} standard deviations strong"
            raise NoLongerFits(f"the ringing is only {strength}")
        return point

    def around(self, recording: Recording, objective: Objective, optimum: Optimum) -> PointEstimate:
        """Estimate noise and covariance around a known optimum."""
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
        """The point estimate at a rival optimum, of the same prepared recording."""
        objective = point.objective
        new = self.around(point.recording, objective, promoted(objective, point.optimum, rival))
        result = replace(point, optimum=new.optimum, noise=new.noise, spread=new.spread)
        return result.shaken(point.shaking)

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
        """Find optimum and posterior, with one child seed for each.

        Parameters
        ----------
        choose
            Chooses among the optimum and its rivals; by default the optimum itself.
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
        sampler_check = check_sampler(point, posterior, check_seed) if check else None
        return Fit(point, posterior, sampler_check)


def nominal_speed_rpm(recording: Recording) -> float:
    """Absolute value of the mean motor speed, rpm."""
    return abs(float(recording.motor_speed_rpm.mean()))
