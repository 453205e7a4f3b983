"""Convert posteriors of the ringing to draws of δ.

If the gap of a snapshot is known from another measurement, draws of every δ are scaled by known gap
/ gap by the curve. A constant factor by which curve or bench are wrong then cancels, so only the
shape of the curve must be right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesbl.config.measurement import KnownGap
from bayesbl.curve.gap_curve import CurveDraws, GapCurve
from bayesbl.measurement.measurement import Reason, upper_bound
from bayesbl.probabilities import FALSE_ALARM, TOO_FEW, normal_isf
from bayesbl.recording.types import FloatArray
from bayesbl.sampling.importance import effective_size, resampled

CANDIDATES_PER_DRAW = 20
CONTRADICTED = "ringing_contradicts_bench"
"""Code of the reason that frequency and decay contradict the curve's bench."""

BENCHES_DRAWN = 10_000
"""Draws behind the chance of such a contradiction: one in a thousand is then good to a third."""

FEWEST_EFFECTIVE = 200.0
"""Fewest effective curve draws for which the ringing is used to weight them. At 200 the actual
level of a 90 % interval is 90 ± 2 %: √(p (1 − p)/n)."""


@dataclass(frozen=True, slots=True)
class MeasuredRinging:
    """What one snapshot's fit measured of (A, ln ω, ln τ).

    ``amplitude_rpm``: posterior draws of A, shape (chain, draw), rpm. ``centre``: optimum of (A, ln
    ω, ln τ), shape (3,). ``covariance``: covariance of these three, shape (3, 3).
    """

    amplitude_rpm: FloatArray
    centre: FloatArray
    covariance: FloatArray

    def given_amplitude(self, scatter: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope of (ln ω, ln τ) over A, (2,), and their covariance at a known A, (2, 2).

        ``scatter``: covariance of (A, ln ω, ln τ) beyond that of the fit, (3, 3).
        """
        total = self.covariance + scatter
        slope = total[1:, 0] / total[0, 0]
        return slope, total[1:, 1:] - np.outer(slope, total[0, 1:])


@dataclass(frozen=True, slots=True)
class Gap:
    """The gap of one snapshot.

    ``delta_rad``: draws of δ, shape (chain, draw), rad. ``index``: for each draw of δ, the
    posterior draw it belongs to (flattened over (chain, draw)), shape (chain, draw). Weighting
    resamples all symbols, not δ alone. ``outside_curve``: −1, 0, +1 for draws of A below, inside,
    above the curve's range, shape (chain, draw). ``curve_amplitude_rpm``: amplitude that the curve
    was evaluated at: A with its scatter over start angles, shape (chain, draw). ``rows``: for each
    source of the curve's uncertainty, the curve draw used, shape (chain, draw). ``curve_scale``:
    Factor by which δ of the curve was multiplied, shape (chain, draw); ``None`` without a known
    gap. ``budget``: share of the variance of ln δ by source; sums to 1. ``reasons``: why δ is
    withheld. ``notes``: other remarks on how δ was computed.
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
        """Upper bound of δ at 95 %, if some draws of A lie below the curve's range."""
        if float(np.mean(self.outside_curve < 0.0)) < TOO_FEW:
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
    """Convert the ringing of every snapshot of one joint to δ, all with the same curve draws.

    Curves of one bench at different speeds or rates share the draws of the bench in the same order,
    so each draw is one bench for all. Other uncertainties of two curves are independent.

    Importance sampling: each draw of A is evaluated on several draws of the curve, with start-angle
    scatter drawn per snapshot, and then resampled with weights. The weights contain the prior, flat
    in ln δ, by its Jacobian d ln δ/dA. For a curve with bench draws they also contain the
    likelihood of the measured frequency and decay, given the drawn bench.

    ``curves``: one for all snapshots, or one per snapshot, all of one bench. ``known``: the known
    gap of each snapshot or ``None``; empty if no gap is known. ``level``: level of the one-sided
    bound of a withheld answer.
    """
    if isinstance(curves, GapCurve):
        curves = [curves] * len(snapshots)
    shared_seed, pick_seed, *own_seeds = seed.spawn(2 + len(snapshots))
    known_seed, check_seed = pick_seed.spawn(2)
    chains, count = snapshots[0].amplitude_rpm.shape
    has_ringing = all(curve.ringing is not None for curve in curves)
    can_weight = has_ringing and all("bench" in curve.sources for curve in curves)
    copies = CANDIDATES_PER_DRAW if can_weight else 1
    total = chains * count * copies
    shared = _shared_draws(curves, total, np.random.default_rng(shared_seed))
    amplitudes = [
        a + c.start_angle_sd(a) * np.random.default_rng(child).standard_normal(a.size)
        for c, s, child in zip(curves, snapshots, own_seeds, strict=True)
        for a in [np.repeat(s.amplitude_rpm.ravel(), copies)]
    ]
    prior = np.sum([_log(c.log_slope(a)) for c, a in zip(curves, amplitudes, strict=True)], axis=0)
    weights, notes = prior, tuple[Reason, ...]()
    contradictions = [False] * len(snapshots)
    if has_ringing:
        matches = [_log_match(*each) for each in zip(shared, snapshots, amplitudes, strict=True)]
        check_generator = np.random.default_rng(check_seed)
        contradictions = [
            # The sweep must cover this amplitude, so that its ringing is known there.
            float(np.mean(curve.outside(amplitude) != 0.0)) < TOO_FEW
            and _chance(curve, snapshot, check_generator) < FALSE_ALARM / len(snapshots)
            for curve, amplitude, snapshot in zip(curves, amplitudes, snapshots, strict=True)
        ]
        posterior_weights = prior + np.sum(matches, axis=0)
        effective = effective_size(posterior_weights)
        if can_weight and effective >= FEWEST_EFFECTIVE:
            weights = posterior_weights
        elif can_weight and not any(contradictions):
            notes = (Reason("few_curve_draws", {"effective": float(effective), "total": total}),)
    sampled = resampled(weights.reshape(chains, -1), count, np.random.default_rng(pick_seed))
    index = (sampled + weights.size // chains * np.arange(chains)[:, None]).ravel()
    chosen = [draws.take(index) for draws in shared]
    chosen_amplitudes = [candidates[index] for candidates in amplitudes]
    by_curve = [draws.gap(a) for draws, a in zip(chosen, chosen_amplitudes, strict=True)]
    calibration = Calibration.of(known, by_curve, np.random.default_rng(known_seed))
    scale = np.ones(index.size) if calibration is None else calibration.scale
    if calibration is not None:
        notes += (Reason("curve_scaled", {"scale": float(np.median(scale))}),)
        if not calibration.agrees:
            notes += (Reason("known_gaps_disagree"),)
    budgets = _budgets(chosen, [s.amplitude_rpm for s in snapshots], calibration)
    result = []
    for curve, curve_draws, amplitude, curve_gap, contradiction, budget in zip(
        curves, chosen, chosen_amplitudes, by_curve, contradictions, budgets, strict=True
    ):
        delta = (scale * curve_gap).reshape(chains, count)
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
                {name: rows.reshape(chains, count) for name, rows in curve_draws.rows.items()},
                None if calibration is None else scale.reshape(chains, count),
                budget,
                tuple(reasons),
                notes,
            )
        )
    return result


def _shared_draws(
    curves: Sequence[GapCurve], count: int, generator: np.random.Generator
) -> list[CurveDraws]:
    """Draws of each curve; equal curves share all draws, different ones the bench draws."""
    drawn = {id(curves[0]): curves[0].draw(count, generator)}
    (first,) = drawn.values()
    for curve in curves[1:]:
        if id(curve) not in drawn:
            draws = curve.draw(count, generator)
            bench_rows = {name: rows for name, rows in first.rows.items() if name == "bench"}
            drawn[id(curve)] = CurveDraws(curve, {**draws.rows, **bench_rows})
    return [drawn[id(curve)] for curve in curves]


def _log_match(
    draws: CurveDraws, snapshot: MeasuredRinging, amplitude_rpm: FloatArray
) -> FloatArray:
    """ln p(ω, τ measured | A, bench draw), shape (count,), up to a constant. Normal, with the
    covariance of the fit and of the start angle. It is conditional on A, which is already drawn
    from its own posterior."""
    curve = draws.curve
    _, scatter, _ = curve.ringing_at(snapshot.centre[0])
    slope, covariance = snapshot.given_amplitude(scatter)
    rows = draws.rows.get("bench", np.zeros(amplitude_rpm.size, dtype=np.int64))
    measured = snapshot.centre[1:, None] + slope[:, None] * (amplitude_rpm - snapshot.centre[0])
    return -0.5 * _squared(measured - _ringing_of(curve, rows, amplitude_rpm), covariance)


def _ringing_of(curve: GapCurve, rows: NDArray[np.int64], amplitude_rpm: FloatArray) -> FloatArray:
    """(ln ω, ln τ) of drawn benches at amplitudes, (k,) each to (2, k)."""
    ringing = curve.ringing
    assert ringing is not None
    tables = (
        ringing.log_frequency + ringing.frequency_draws,
        ringing.log_decay + ringing.decay_draws,
    )
    return np.stack([curve.at_rows(table, rows, amplitude_rpm) for table in tables])


def _squared(difference: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared distance of each difference (2, k) in units of a covariance (2, 2), shape (k,)."""
    precision = np.linalg.inv(covariance)
    return np.asarray(np.einsum("ik,ij,jk->k", difference, precision, difference))


def _chance(curve: GapCurve, snapshot: MeasuredRinging, generator: np.random.Generator) -> float:
    """Probability that a bench within its tolerances seems to ring at least as unlike the expected
    one, at the measured amplitude."""
    assert curve.ringing is not None
    amplitude = np.full(BENCHES_DRAWN, snapshot.centre[0])
    _, scatter, _ = curve.ringing_at(snapshot.centre[0])
    _, covariance = snapshot.given_amplitude(scatter)
    rows = generator.integers(len(curve.ringing.frequency_draws), size=BENCHES_DRAWN)
    drawn = _ringing_of(curve, rows, amplitude)
    drawn += generator.multivariate_normal(np.zeros(2), covariance, BENCHES_DRAWN).T
    expected = drawn.mean(axis=1, keepdims=True)
    spread = np.cov(drawn)
    (measured,) = _squared(snapshot.centre[1:, None] - expected, spread)
    return float(np.mean(_squared(drawn - expected, spread) >= measured))


def _log(values: FloatArray) -> FloatArray:
    return np.log(values, where=values > 0.0, out=np.full_like(values, -np.inf))


def _extrapolation(
    range_rad: tuple[float, float], outside: FloatArray, delta_rad: FloatArray, level: float
) -> list[Reason]:
    """Why an answer outside the curve's range is withheld, with a one-sided bound."""
    share = float(np.mean(outside != 0.0))
    if share < TOO_FEW:
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
    """Scale of a joint's curves, from its known gaps.

    ``scale``: draws of the scale, shape (n,). ``weights``: weight of each snapshot's ln δ in ln
    scale, shape (snapshots,); 0 where no gap is known. ``known_variance``: variance of ln scale due
    to the known gaps alone. ``agrees``: whether the known gaps are consistent with one curve.
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
        """Scale by ``by_curve``, draws (n,) of each snapshot's δ; ``None`` if no gap is known."""
        stated = {k: gap for k, gap in enumerate(known) if gap is not None}
        if not stated:
            return None
        relative_sd = np.array([gap.sd_rad / gap.delta_rad for gap in stated.values()])
        share = relative_sd**-2.0 / np.sum(relative_sd**-2.0)
        noise = relative_sd[:, None] * generator.standard_normal((len(stated), by_curve[0].size))
        centre = np.log([gap.delta_rad for gap in stated.values()])
        log_scales = centre[:, None] + noise - np.log([by_curve[k] for k in stated])
        weights = np.zeros(len(by_curve))
        weights[list(stated)] = share
        log_scale = share @ log_scales
        departures = log_scales - log_scale
        tolerance = normal_isf(0.5 * FALSE_ALARM / len(stated)) * departures.std(axis=1)
        return cls(
            np.exp(log_scale),
            weights,
            float(share**2 @ relative_sd**2),
            len(stated) == 1 or bool(np.all(np.abs(departures.mean(axis=1)) <= tolerance)),
        )


def _budgets(
    chosen: Sequence[CurveDraws],
    amplitudes_rpm: Sequence[FloatArray],
    calibration: Calibration | None,
) -> list[dict[str, float]]:
    """For each snapshot, shares of the variance of ln δ with one source active at a time. The
    variance includes the snapshot's ln δ and, through the scale, that of snapshots with known
    gaps."""
    weights = np.zeros(len(chosen)) if calibration is None else calibration.weights
    zero = np.zeros(1)
    one_source = [_one_at_a_time(*each) for each in zip(chosen, amplitudes_rpm, strict=True)]
    budgets: list[dict[str, float]] = []
    for k, (curve_draws, (scatter, sources)) in enumerate(zip(chosen, one_source, strict=True)):
        if not sources:
            budgets.append({})
            continue
        factors = -weights
        factors[k] += 1.0
        active = [(f, a) for f, a in zip(factors, one_source, strict=True) if f]
        variances = {}
        for name in sources:
            log_gap = sum((f * logs.get(name, zero) for f, (_, logs) in active), start=zero)
            finite = log_gap[np.isfinite(log_gap)]
            variances[name] = float(np.var(finite)) if finite.size else 0.0
        if scatter > 0.0:
            variances["start_angle"] = sum((f * sd) ** 2 for f, (sd, _) in active)
        if calibration is not None:
            variances["known_gap"] = calibration.known_variance
        order = ["noise", "start_angle", *curve_draws.rows, "known_gap"]
        total = sum(variances.values())
        budgets.append({n: variances[n] / total if total else 0.0 for n in order if n in variances})
    return budgets


def _one_at_a_time(
    chosen: CurveDraws, amplitude_rpm: FloatArray
) -> tuple[float, dict[str, FloatArray]]:
    """Standard deviation of ln δ by the start angle, and draws of ln δ for each other source."""
    curve, median = chosen.curve, float(np.median(amplitude_rpm))
    if median <= 0.0:
        return 0.0, {}
    slope = float(curve.log_slope(np.array(median)))
    delta_by_source = {"noise": curve.gap(amplitude_rpm.ravel())}
    for name, rows in chosen.rows.items():
        delta_by_source[name] = chosen.only(name).gap(np.full(rows.size, median))
    scatter = slope * float(curve.start_angle_sd(np.array(median)))
    return scatter, {name: _log(delta_rad) for name, delta_rad in delta_by_source.items()}
