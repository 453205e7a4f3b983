"""Rank motions by the expected width of a gap's interval.

Near the truth, the whitened signals are linear in all unknowns. So the covariance of a fit is known
before anything is recorded: (JᵀJ + P)⁻¹, with J the Jacobian of the simulated signals and P the
precision of the bench's tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass, replace
from itertools import product

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.kernel import CURRENT, SPEED
from bayesbl.bench.motion import cycle
from bayesbl.bench.simulation import simulate_motions
from bayesbl.errors import BenchError
from bayesbl.matching.least_squares import fit_at
from bayesbl.matching.motions import flank_changes
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import (
    GAP,
    SimulatedSignals,
    effect_unknowns,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.noise.rotation_noise import innovation_share
from bayesbl.progress import Progress, silent

NAME = "planned"

REACH_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Shares of the allowed range that a stroke covers."""

POSTURES = 3
"""Number of positions of a shorter stroke, besides those where gravity changes its sign."""

SPEED_SHARES = (1.0, 0.4)
ACCELERATION_SHARES = (1.0, 0.3)
SHORTEST_REACH_RAD = 0.01

GAPS_TRIED = (0.7, 1.0, 1.4)
"""Multiples of the gap asked for. A motion in which the load barely reaches the other flank shows
one gap precisely, and its neighbours hardly. The root mean square over these gaps is dominated by
the worst."""

LARGEST_CURRENT_SHARE = 0.95
"""Largest share of the current limit: at the limit, the bench does not describe the controller."""


@dataclass(frozen=True, slots=True)
class Strokes:
    """End angles of the load, speed and acceleration of the motor, dwell time, and duration."""

    range_rad: tuple[float, float]
    speed_rpm: float
    acceleration_rpm_per_s: float
    dwell_s: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class PlannedMotion(Strokes):
    """Strokes and their expected precision.

    Attributes
    ----------
    flank_changes
        Number of flank changes of the load.
    expected_relative_sd
        Relative standard deviation of δ from one recording, over gaps around the one asked for;
        ``None`` if one of these has no flank change.
    """

    flank_changes: int
    expected_relative_sd: float | None


def ranked_motions(
    bench: Bench,
    limits: Strokes,
    gap_rad: float,
    sampling_hz: float,
    workers: int = 1,
    progress: Progress = silent,
) -> list[PlannedMotion]:
    """Candidate strokes within the limits, the most precise for δ first.

    Motions that the drive cannot follow are left out.

    Raises
    ------
    BenchError
        If the bench has no noise, or can follow none of the motions.
    """
    tried, planned = list(candidates(bench, limits)), []
    for made, candidate in enumerate(tried):
        progress(made, len(tried))
        motion = _planned(bench, candidate, gap_rad, sampling_hz, workers)
        if motion is not None:
            planned.append(motion)
    if not planned:
        raise BenchError(
            "The drive can follow none of the motions within these limits.",
            where="[limits] acceleration_rpm_per_s",
            found=f"{limits.acceleration_rpm_per_s:g} and less",
            expected="an acceleration for which current_limit_a is enough",
        )
    return sorted(planned, key=lambda motion: motion.expected_relative_sd or math.inf)


def candidates(bench: Bench, limits: Strokes) -> Iterator[Strokes]:
    """All motions that are tried."""
    low, high = limits.range_rad
    upright = [
        k * math.pi - bench.value("gravity_angle_rad")
        for k in range(-4, 5)
        if bench.value("gravity_torque_nm") > 0.0
    ]
    for share in REACH_SHARES:
        half = 0.5 * share * (high - low)
        if half < SHORTEST_REACH_RAD:
            continue
        centres = [0.5 * (low + high)]
        if share < 1.0:
            centres = np.linspace(low + half, high - half, POSTURES).tolist()
            centres += [angle for angle in upright if low + half < angle < high - half]
        centres = list(dict.fromkeys(round(centre, 6) for centre in centres))
        for centre, speed, acceleration in product(centres, SPEED_SHARES, ACCELERATION_SHARES):
            yield replace(
                limits,
                range_rad=(centre - half, centre + half),
                speed_rpm=speed * limits.speed_rpm,
                acceleration_rpm_per_s=acceleration * limits.acceleration_rpm_per_s,
            )


def noise_of_bench(bench: Bench) -> ChannelNoise:
    """Noise of speed and current in the bench file.

    Raises
    ------
    BenchError
        If there is none.
    """
    models = (bench.measurement.speed_noise, bench.measurement.current_noise)
    if not all(model.standard_deviation > 0.0 for model in models):
        raise BenchError(
            "Without noise every motion shows the gap exactly.",
            where="[measurement]",
            found="no noise of the speed or of the current",
            expected='as recordings of this joint have it: speed_noise = {kind = "white", sd_rpm = '
            '1.5} and current_noise = {kind = "white", sd_a = 0.05}',
        )
    order = max(len(model.coefficients) for model in models)
    coefficients = np.zeros((order, 2, 2))
    for channel, model in enumerate(models):
        coefficients[: len(model.coefficients), channel, channel] = model.coefficients
    sd = np.array([model.standard_deviation for model in models])
    shares = [innovation_share(np.array(model.coefficients)) for model in models]
    return ChannelNoise(coefficients, np.diag(sd * np.sqrt(shares)), sd, 0)


def _planned(
    bench: Bench, candidate: Strokes, gap_rad: float, sampling_hz: float, workers: int
) -> PlannedMotion | None:
    """Evaluate strokes; ``None`` if the drive cannot follow them."""
    ends_rad, *profile = astuple(candidate)
    motion = cycle(bench.value("gear_ratio"), ends_rad, *profile)
    start_rad, samples = candidate.range_rad[0], round(candidate.duration_s * sampling_hz)
    row = bench.vector(gap_rad=gap_rad, start_angle_rad=start_rad)
    signals = simulate_motions(row, motion, samples, sampling_hz)[0, [SPEED, CURRENT]]
    if np.max(np.abs(signals[1])) > LARGEST_CURRENT_SHARE * bench.value("current_limit_a"):
        return None
    observation = Observed(
        NAME, signals, sampling_hz, motion.fastest_rpm, samples / sampling_hz, motion=motion
    )
    changes, sds = zip(
        *(
            _expected(bench, observation, start_rad, share * gap_rad, workers)
            for share in GAPS_TRIED
        ),
        strict=True,
    )
    expected = math.sqrt(sum(sd**2 for sd in sds) / len(sds))
    return PlannedMotion(
        **asdict(candidate),
        flank_changes=changes[len(changes) // 2],
        expected_relative_sd=expected if math.isfinite(expected) else None,
    )


def _expected(
    bench: Bench, observation: Observed, start_angle_rad: float, gap_rad: float, workers: int
) -> tuple[int, float]:
    """Number of flank changes at a gap, and standard deviation of ln δ; infinite without any."""
    unknowns = [
        gap_unknown(0.01 * gap_rad, 100.0 * gap_rad),
        start_angle_unknown(NAME),
        reference_delay_unknown(NAME),
        *effect_unknowns(bench, [NAME]),
        *tolerance_unknowns(bench),
    ]
    point = np.array([u.middle for u in unknowns])
    point[:2] = math.log(gap_rad), start_angle_rad
    model = SimulatedSignals(bench, [observation], unknowns, [noise_of_bench(bench)], workers)
    fit = fit_at(model, point)
    changes = len(flank_changes(fit, 0))
    return changes, fit.sd(GAP) if changes else math.inf
