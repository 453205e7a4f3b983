"""Whether recordings, gap curve and gear ratio belong together by their speeds."""

from __future__ import annotations

from collections.abc import Sequence

from bayesbl.curve.gap_curve import GapCurve
from bayesbl.errors import RecordingError
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Fit, nominal_speed_rpm
from bayesbl.ringing.symbols import ROTATION

SNAPSHOTS_APART = 0.02
"""Largest relative difference in speed between snapshots.

The published bench reads δ off by the power :data:`SPEED_POWER` of a wrong speed, so this moves a
change of δ by 1 % of δ at most.
"""

CURVE_APART = 0.05
"""The same between a recording and a curve that is not of its bench, and is off by as much anyway.
"""

SPEED_POWER = 0.4
"""d ln δ/d ln v at a given amplitude, of the reference bench: 0.28 at 0.2 mrad, 0.57 at 3.5."""

ROTATION_APART = 0.03
"""Largest relative difference between the rotation found and that by speed and gear ratio."""


def require_one_speed_of_all(recordings: Sequence[Recording]) -> None:
    """All snapshots are of one speed, in either direction.

    Raises
    ------
    RecordingError
        If not: the same gap rings otherwise at another speed, and that would pass for wear.
    """
    first = recordings[0]
    for other in recordings[1:]:
        speeds = nominal_speed_rpm(first), nominal_speed_rpm(other)
        if max(speeds) > (1.0 + SNAPSHOTS_APART) * min(speeds):
            raise RecordingError(
                "The snapshots were recorded at different speeds, and the same gap rings otherwise "
                "at another speed: that would pass for wear.",
                file=other.source.file if other.source else other.name,
                where="motor_speed_rpm",
                found=f"{speeds[1]:.5g} rpm on average, but {speeds[0]:.5g} rpm in {first.name}",
                expected=f"speeds within {100.0 * SNAPSHOTS_APART:g} %, in one unit; record at the "
                'same speed, or give a bench and take route = "direct"',
            )


def other_speed(recording: Recording, curve: GapCurve) -> str | None:
    """Why a curve of another speed gives no gap; ``None`` where it is of this speed."""
    if curve.reference_speed_rpm is None:
        return None
    speed = nominal_speed_rpm(recording)
    ratio = speed / curve.reference_speed_rpm
    if abs(ratio - 1.0) <= CURVE_APART:
        return None
    off = 100.0 * abs(ratio**SPEED_POWER - 1.0)
    side = "small" if ratio < 1.0 else "large"
    return (
        f"The gap curve is of {curve.reference_speed_rpm:g} rpm, the recording of {speed:.4g} rpm, "
        f"where the same gap rings otherwise: δ would be some {off:.0f} % too {side}. Record at "
        f"{curve.reference_speed_rpm:g} rpm, sweep a bench at this speed, or ask for extrapolation "
        "by [curve] allow_extrapolation = true."
    )


def other_rotation(recording: Recording, fit: Fit, gear_ratio: float | None) -> str | None:
    """Why the rotation that was found is not the load's; ``None`` where it may be."""
    if gear_ratio is None:
        return None
    found_s = fit.point.optimum.symbols[ROTATION]
    speed = nominal_speed_rpm(recording)
    expected_s = 60.0 * gear_ratio / speed
    if abs(found_s / expected_s - 1.0) <= ROTATION_APART:
        return None
    fitting = found_s * speed / 60.0
    return (
        f"The speed repeats every {found_s:.4g} s, but with a gear ratio of {gear_ratio:g} the "
        f"load turns once in {expected_s:.4g} s at {speed:.4g} rpm. Is the gear ratio right (the "
        f"recording would fit one of {fitting:.4g}), and the unit of the speed?"
    )
