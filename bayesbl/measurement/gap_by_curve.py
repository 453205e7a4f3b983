"""From posteriors of the ringing to draws of δ.

Where the gap of a snapshot is known otherwise, the curve only has to be right in its form: draws of
every δ are scaled by the known gap over the curve's. What is wrong with the curve or with its bench
by a factor then cancels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesbl.config.measurement import KnownGap
from bayesbl.curve.gap_curve import CurveDraws, GapCurve, interpolate_rows
from bayesbl.measurement.measurement import Reason, upper_bound
from bayesbl.probabilities import chi2_isf, normal_isf
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.importance import effective_size, resampled

LARGEST_SHARE_OUTSIDE = 0.01
CANDIDATES_PER_DRAW = 20
FALSE_ALARM = 0.005
"""Of a ringing that contradicts the bench, over the snapshots of a run."""

CONTRADICTED = "ringing_contradicts_bench"
"""Code of the reason that frequency and decay are not those of the curve's bench."""

FEWEST_EFFECTIVE = 200.0
"""Effective curve draws below which the ringing is not used to weigh them.

At 200 the actual level of a 90 % interval is 90 ± 2 %: √(p (1 − p)/n).
"""


@dataclass(frozen=True, slots=True)
class MeasuredRinging:
    """What one snapshot's fit says of (A, ln ω, ln τ).

    Attributes
    ----------
    amplitude_rpm
        Posterior draws of A, shape (chain, draw), rpm.
    centre
        Optimum of (A, ln ω, ln τ), shape (3,).
    covariance
        Of these three, shape (3, 3).
    """

    amplitude_rpm: FloatArray
    centre: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Gap:
    """The gap of one snapshot.

    Attributes
    ----------
    delta_rad
        Draws of δ, shape (chain, draw), rad.
    index
        Which of the snapshot's posterior draws, flattened over (chain, draw), each draw of δ
        belongs to, shape (chain, draw): weighting moves all symbols, not δ alone.
    outside_curve
        −1, 0, +1 for draws of A below, inside, above the curve's range, shape (chain, draw).
    curve_amplitude_rpm
        What was put through the curve: A with its scatter over start angles, shape (chain, draw).
    rows
        By source of the curve's uncertainty, which of its draws, shape (chain, draw).
    curve_scale
        By which δ of the curve was multiplied, shape (chain, draw); ``None`` without a known gap.
    budget
        Share of the variance of ln δ by source; sums to 1.
    reasons
        Why δ is withheld.
    notes
        What else the reader should know of how δ came about.
    """

    delta_rad: FloatArray
    index: NDArray[np.int64]
    outside_curve: FloatArray
    curve_amplitude_rpm: FloatArray
    rows: Mapping[str, NDArray[np.int64]]
    curve_scale: FloatArray | None
    budget: dict[str, float]
    reasons: tuple[Reason, ...] = ()
    notes: tuple[Reason, ...] = ()

    @property
    def upper_bound_rad(self) -> float | None:
        """The gap that δ is below with 95 %, where the curve does not reach down to it."""
        if float(np.mean(self.outside_curve < 0.0)) < LARGEST_SHARE_OUTSIDE:
            return None
        return upper_bound(self.delta_rad)


def gaps(
    curves: GapCurve | Sequence[GapCurve],
    snapshots: Sequence[MeasuredRinging],
    seed: np.random.SeedSequence,
    known: Sequence[KnownGap | None] = (),
    *,
    allow_extrapolation: bool = False,
    level: float = 0.9,
) -> list[Gap]:
    """δ of every snapshot of one joint, each through its curve, all through the same draws of it.

    Curves of one bench at other speeds or rates have the same draws of the bench in the same order,
    so a draw is of one bench for all; what else is uncertain of two curves is independent.

    Importance sampling: each draw of A is put through several draws of the curve, start-angle
    scatter drawn per snapshot, and then resampled with weights. The weights carry the prior, flat
    in ln δ, by its Jacobian d ln δ/dA; and, for a curve with bench draws, how well the bench that
    a draw stands for explains the frequency and decay that were measured beside A.

    Parameters
    ----------
    curves
        One for all snapshots, or each one's own of one bench.
    known
        Of each snapshot, what else measured its gap; nothing for none of any.
    level
        Of the one-sided bound that a withheld answer gives.
    """
    if isinstance(curves, GapCurve):
        curves = [curves] * len(snapshots)
    shared_seed, pick_seed, *own_seeds = seed.spawn(2 + len(snapshots))
    (known_seed,) = pick_seed.spawn(1)
    chains, count = snapshots[0].amplitude_rpm.shape
    rings = all(curve.ringing is not None for curve in curves)
    narrows = rings and all("bench" in curve.sources for curve in curves)
    copies = CANDIDATES_PER_DRAW if narrows else 1
    total = chains * count * copies
    shared = _shared_draws(curves, total, np.random.default_rng(shared_seed))
    amplitudes = [
        _scattered(curve, np.repeat(s.amplitude_rpm.ravel(), copies), np.random.default_rng(own))
        for curve, s, own in zip(curves, snapshots, own_seeds, strict=True)
    ]
    prior = np.sum([_log(c.log_slope(a)) for c, a in zip(curves, amplitudes, strict=True)], axis=0)
    weights, notes = prior, tuple[Reason, ...]()
    against = [False] * len(snapshots)
    if rings:
        matches = [_log_match(*each) for each in zip(shared, snapshots, amplitudes, strict=True)]
        least = float(chi2_isf(FALSE_ALARM / len(snapshots), 2))
        against = [
            bool(-2.0 * match.max() > least and _is_inside(curve, amplitude))
            for curve, amplitude, match in zip(curves, amplitudes, matches, strict=True)
        ]
        matched = prior + np.sum(matches, axis=0)
        effective = effective_size(matched)
        if narrows and effective >= FEWEST_EFFECTIVE:
            weights = matched
        elif narrows and not any(against):
            notes = (Reason("few_curve_draws", {"effective": float(effective), "total": total}),)
    own = resampled(weights.reshape(chains, -1), count, np.random.default_rng(pick_seed))
    index = (own + weights.size // chains * np.arange(chains)[:, None]).ravel()
    chosen = [draws.take(index) for draws in shared]
    through = [candidates[index] for candidates in amplitudes]
    by_curve = [own.gap(amplitude) for own, amplitude in zip(chosen, through, strict=True)]
    calibration = Calibration.of(known, by_curve, np.random.default_rng(known_seed))
    scale = np.ones(index.size) if calibration is None else calibration.scale
    if calibration is not None:
        notes += (Reason("curve_scaled", {"scale": float(np.median(scale))}),)
        if not calibration.agrees:
            notes += (Reason("known_gaps_disagree"),)
    result = []
    for curve, own_draws, amplitude, by_own, contradiction in zip(
        curves, chosen, through, by_curve, against, strict=True
    ):
        delta = (scale * by_own).reshape(chains, count)
        outside = curve.outside(amplitude).reshape(chains, count)
        reasons = [Reason(CONTRADICTED)] if contradiction else []
        if not allow_extrapolation:
            low, high = (float(np.median(scale)) * end for end in curve.gap_range_rad)
            reasons += _extrapolation((low, high), outside, delta, level)
        result.append(
            Gap(
                delta,
                (index // copies).reshape(chains, count),
                outside,
                amplitude.reshape(chains, count),
                {name: rows.reshape(chains, count) for name, rows in own_draws.rows.items()},
                None if calibration is None else scale.reshape(chains, count),
                {},
                tuple(reasons),
                notes,
            )
        )
    budgets = _budgets(chosen, [s.amplitude_rpm for s in snapshots], calibration)
    return [replace(gap, budget=budget) for gap, budget in zip(result, budgets, strict=True)]


def _shared_draws(
    curves: Sequence[GapCurve], count: int, generator: np.random.Generator
) -> list[CurveDraws]:
    """Draws of each curve, the same for the same curve and of the same benches for all."""
    made = {id(curves[0]): curves[0].draw(count, generator)}
    (first,) = made.values()
    for curve in curves[1:]:
        if id(curve) not in made:
            own = curve.draw(count, generator)
            bench = {name: rows for name, rows in first.rows.items() if name == "bench"}
            made[id(curve)] = CurveDraws(curve, {**own.rows, **bench})
    return [made[id(curve)] for curve in curves]


def _scattered(
    curve: GapCurve, amplitude_rpm: FloatArray, generator: np.random.Generator
) -> FloatArray:
    noise = generator.standard_normal(amplitude_rpm.size)
    return amplitude_rpm + curve.start_angle_sd(amplitude_rpm) * noise


def _log_match(
    draws: CurveDraws, snapshot: MeasuredRinging, amplitude_rpm: FloatArray
) -> FloatArray:
    """ln p(ω, τ measured | A, bench draw), shape (count,), up to a constant.

    Normal, with the covariance of the fit and of the start angle; conditional on A, which is
    already drawn from its own posterior.
    """
    curve = draws.curve
    ringing = curve.ringing
    assert ringing is not None
    nearest = int(np.argmin(np.abs(curve.knots_rpm - snapshot.centre[0])))
    covariance = snapshot.covariance + ringing.scatter[nearest]
    gain = covariance[1:, 0] / covariance[0, 0]
    conditional = covariance[1:, 1:] - np.outer(gain, covariance[0, 1:])
    every = np.zeros(amplitude_rpm.size, dtype=np.int64)
    of_bench = draws.rows.get("bench", every)
    expected = [
        interpolate_rows(curve.knots_rpm, nominal[None], every, amplitude_rpm)
        + interpolate_rows(curve.knots_rpm, departures, of_bench, amplitude_rpm)
        for nominal, departures in (
            (ringing.log_frequency, ringing.frequency_draws),
            (ringing.log_decay, ringing.decay_draws),
        )
    ]
    measured = snapshot.centre[1:, None] + gain[:, None] * (amplitude_rpm - snapshot.centre[0])
    difference = measured - np.stack(expected)
    return np.asarray(
        -0.5 * np.einsum("ik,ij,jk->k", difference, np.linalg.inv(conditional), difference)
    )


def _is_inside(curve: GapCurve, amplitude_rpm: FloatArray) -> bool:
    """Whether the sweep tells how the bench rings there."""
    return float(np.mean(curve.outside(amplitude_rpm) != 0.0)) < LARGEST_SHARE_OUTSIDE


def _log(values: FloatArray) -> FloatArray:
    return np.log(values, where=values > 0.0, out=np.full_like(values, -np.inf))


def _extrapolation(
    range_rad: tuple[float, float], outside: FloatArray, delta_rad: FloatArray, level: float
) -> list[Reason]:
    """Why an answer beyond the curve's range is withheld, with a bound in its place."""
    share = float(np.mean(outside != 0.0))
    if share < LARGEST_SHARE_OUTSIDE:
        return []
    low, high = range_rad
    above = bool(np.sum(outside > 0.0) >= np.sum(outside < 0.0))
    if above:
        bound = min(float(np.quantile(delta_rad, 1.0 - level)), high)
    else:
        bound = max(float(np.quantile(delta_rad, level)), low)
    values = {"share": share, "low_rad": low, "high_rad": high, "level": level}
    values |= {"bound_rad": bound, "is_above": above}
    return [Reason("beyond_curve", values)]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What known gaps say of the scale of a joint's curves.

    Attributes
    ----------
    scale
        Draws of it, shape (n,).
    weights
        Of each snapshot's ln δ by its curve in ln scale, shape (snapshots,); 0 where none is known.
    known_variance
        Of ln scale by the known gaps alone.
    agrees
        Whether the known gaps are on one curve.
    """

    scale: FloatArray
    weights: FloatArray
    known_variance: float
    agrees: bool

    @classmethod
    def of(
        cls,
        known: Sequence[KnownGap | None],
        by_curve: Sequence[FloatArray],
        generator: np.random.Generator,
    ) -> Calibration | None:
        """``by_curve``: draws of each snapshot's δ, (n,) each; ``None`` if nothing is known."""
        given = {k: gap for k, gap in enumerate(known) if gap is not None}
        if not given:
            return None
        relative_sd = np.array([gap.sd_rad / gap.delta_rad for gap in given.values()])
        share = relative_sd**-2.0 / np.sum(relative_sd**-2.0)
        noise = relative_sd[:, None] * generator.standard_normal((len(given), by_curve[0].size))
        centre = np.log([gap.delta_rad for gap in given.values()])
        log_scales = centre[:, None] + noise - np.log([by_curve[k] for k in given])
        weights = np.zeros(len(by_curve))
        weights[list(given)] = share
        log_scale = share @ log_scales
        departures = log_scales - log_scale
        limit = normal_isf(0.5 * FALSE_ALARM / len(given)) * departures.std(axis=1)
        return cls(
            np.exp(log_scale),
            weights,
            float(share**2 @ relative_sd**2),
            len(given) == 1 or bool(np.all(np.abs(departures.mean(axis=1)) <= limit)),
        )


def _budgets(
    chosen: Sequence[CurveDraws],
    amplitudes_rpm: Sequence[FloatArray],
    calibration: Calibration | None,
) -> list[dict[str, float]]:
    """Of each snapshot the variance of ln δ with one source at work at a time, as shares.

    Of the ln δ of all curves that go into it: its own, and through its scale those of known gaps.
    """
    weights = np.zeros(len(chosen)) if calibration is None else calibration.weights
    none = np.zeros(1)
    alone = [_one_at_a_time(*each) for each in zip(chosen, amplitudes_rpm, strict=True)]
    budgets: list[dict[str, float]] = []
    for k, (own, (scatter, sources)) in enumerate(zip(chosen, alone, strict=True)):
        if not sources:
            budgets.append({})
            continue
        factors = -weights
        factors[k] += 1.0
        acting = [(f, a) for f, a in zip(factors, alone, strict=True) if f]
        variances = {
            name: _variance(sum((f * logs.get(name, none) for f, (_, logs) in acting), start=none))
            for name in sources
        }
        if scatter > 0.0:
            variances["start_angle"] = sum((f * sd) ** 2 for f, (sd, _) in acting)
        if calibration is not None:
            variances["known_gap"] = calibration.known_variance
        order = ["noise", "start_angle", *own.rows, "known_gap"]
        total = sum(variances.values())
        budgets.append({n: variances[n] / total if total else 0.0 for n in order if n in variances})
    return budgets


def _one_at_a_time(
    chosen: CurveDraws, amplitude_rpm: FloatArray
) -> tuple[float, dict[str, FloatArray]]:
    """Standard deviation of ln δ by the start angle, and draws of ln δ by each other source."""
    curve, middle = chosen.curve, float(np.median(amplitude_rpm))
    if middle <= 0.0:
        return 0.0, {}
    slope = float(curve.log_slope(np.array(middle)))
    alone = {"noise": curve.gap(amplitude_rpm.ravel())}
    for name, rows in chosen.rows.items():
        alone[name] = chosen.only(name).gap(np.full(rows.size, middle))
    scatter = slope * float(curve.start_angle_sd(np.array(middle)))
    return scatter, {name: _log(delta_rad) for name, delta_rad in alone.items()}


def _variance(log_gap: FloatArray) -> float:
    finite = log_gap[np.isfinite(log_gap)]
    return float(np.var(finite)) if finite.size else 0.0
