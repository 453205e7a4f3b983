"""How the bench is seen: encoder counts, noise, and which sensor the speed is of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesbl.bench.kernel import Slot
from bayesbl.bench.steady import noise_through_loop
from bayesbl.noise.process import NO_NOISE, NoiseModel, quantised
from bayesbl.recording.types import MOTOR_CURRENT, MOTOR_POSITION, MOTOR_SPEED, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

SpeedSource = Literal["sensor", "encoder"]


@dataclass(frozen=True, slots=True)
class Measurement:
    """How the bench is seen.

    Attributes
    ----------
    encoder_counts
        Counts per motor revolution; ``None`` for an ideal encoder.
    speed_source
        ``sensor``: the speed the controller sees, with noise. ``encoder``: backward difference
        of the recorded position over one sample (the first sample repeats the second), no noise
        of its own.
    speed_noise, current_noise
        In rpm and A.
    noise_through_controller
        The speed noise is inside the loop: the controller answers it, on the linear bench in
        contact, and the recorded speed holds the motor's answer too.
    """

    encoder_counts: int | None = None
    speed_source: SpeedSource = "sensor"
    speed_noise: NoiseModel = NO_NOISE
    current_noise: NoiseModel = NO_NOISE
    noise_through_controller: bool = False

    def seen_by(self, matrix: FloatArray, sampling_hz: float) -> FloatArray:
        """Benches, shape (m, SLOTS), with the speed averaged as its source does at this rate.

        A difference of the encoder's positions is an average over a sampling period; where a bench
        states an average, that is all of it.
        """
        if self.speed_source != "encoder":
            return matrix
        matrix = matrix.copy()
        averaging = matrix[:, Slot.speed_averaging__time_s]
        averaging[averaging == 0.0] = 1.0 / sampling_hz
        return matrix

    def channels(
        self,
        position: FloatArray,
        speed: FloatArray,
        current: FloatArray,
        loop: FloatArray | None,
        sampling_hz: float,
        rng: np.random.Generator | None,
    ) -> dict[str, FloatArray]:
        """As recorded, from what happened, each (n,).

        ``loop`` has the parameters of the speed loop, ``None`` where there is none; without
        ``rng`` there is no noise.
        """
        if rng is not None:
            noise = self.speed_noise.draw(speed.size, rng)
            current = current + self.current_noise.draw(speed.size, rng)
            if self.noise_through_controller and loop is not None:
                motion, answer = noise_through_loop(loop, noise, 1.0 / sampling_hz)
                noise = noise + motion
                current = current + answer
            speed = speed + noise
        if self.encoder_counts is not None:
            position = quantised(position, self.encoder_counts)
        if self.speed_source == "encoder":
            difference = np.diff(position) * sampling_hz * RPM_PER_RAD_PER_S
            speed = np.concatenate((difference[:1], difference))
        return {MOTOR_POSITION: position, MOTOR_SPEED: speed, MOTOR_CURRENT: current}


PERFECT = Measurement()
