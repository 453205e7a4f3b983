"""The speed that a recording's controller was given, where nobody has stated it."""

from __future__ import annotations

from bayesbl.bench.bench import Bench
from bayesbl.matching.observed import LARGEST_SPEED_ERROR
from bayesbl.recording.types import Recording

WHOLE_SPEED_RPM, WHOLE_SHARE = 0.1, 5e-4
"""How far a mean speed may be from a whole number of rpm that is taken for the reference: over
whole rotations the integral of the controller keeps the mean there but for noise. At a slow speed
as a share of it, for 10.06 rpm is not 10."""


def asked_speed(recording: Recording, bench: Bench) -> tuple[float | None, str]:
    """The reference speed, rpm, with the reason for it; ``None`` for the bench's own."""
    mean = _mean_speed_rpm(recording, bench.value("gear_ratio"))
    own = bench.value("reference_speed_rpm")
    if abs(abs(mean / own) - 1.0) <= LARGEST_SPEED_ERROR:
        return None, ""
    is_whole = abs(mean - round(mean)) <= min(WHOLE_SPEED_RPM, WHOLE_SHARE * abs(mean))
    asked = float(round(mean)) if is_whole else float(f"{mean:.6g}")
    return asked, f"its mean speed, {asked:g} rpm, is taken for its reference"


def _mean_speed_rpm(recording: Recording, gear_ratio: float) -> float:
    """Over whole rotations of the load, for gravity sways the speed once in each."""
    speed_rpm = recording.motor_speed_rpm
    mean = float(speed_rpm.mean())
    rotation = 60.0 * gear_ratio / (max(abs(mean), 1e-9) * recording.sampling_period_s)
    whole = int(speed_rpm.size / rotation)
    return float(speed_rpm[: round(whole * rotation)].mean()) if whole else mean
