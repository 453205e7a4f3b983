"""A torque of no known law, or the encoder's error, learned from what the simulation leaves.

Which of them, and over what, :mod:`..learning` decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.bench.kernel import LEARNED_HARMONICS
from bayesbl.bench.learned import EncoderError, LearnedTerm, LearnedTorque, waves_over
from bayesbl.bench.steady import ringing_hz
from bayesbl.diagnosis.closed_loop.augment import learned_terms
from bayesbl.diagnosis.diagnosis import CURVE_POINTS, LearnedAnswer, LearnedCurve
from bayesbl.diagnosis.learning import Group, Hypothesis, Trial, alike, learn
from bayesbl.diagnosis.residuals import Unexplained, What
from bayesbl.errors import BenchError
from bayesbl.matching.alignment import aligned_starts, with_shifts
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.observed import Observed
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.model_search.constants import UNEXPLAINED_SHARE
from bayesbl.model_search.refit import Explanation, with_own_noise
from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

LONGEST_PERIOD = 5.0
"""Turns of the motor: what repeats more rarely belongs to the load or to time."""

MOST_BASES = 3

WHOLE = 0.02
"""Of an order: lines this close to a whole multiple of another belong to it."""

SAME_ORDER = 2e-3
"""Of an order: lines of two channels this close are one."""

RANGE = 10.0
"""Of every coefficient's flat prior, in the largest coefficient of the linear solution."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What was learned, fitted jointly with all else.

    Attributes
    ----------
    explanation
        With the coefficients among its unknowns.
    kind
        Torque or error of the encoder.
    alike
        Other variables or sides that the recordings do not tell from it.
    """

    explanation: Explanation
    kind: type[LearnedTerm]
    alike: tuple[LearnedTerm, ...]

    @property
    def term(self) -> LearnedTerm:
        """As fitted, with standard deviations."""
        found = learned_terms(self.explanation.fit)
        return next(term for term in found if isinstance(term, self.kind))

    @property
    def gap_share(self) -> float:
        """Share of the information on ln δ that it leaves; 1 where the gap is known.

        With the term's coefficients free over that with them known.
        """
        fit = self.explanation.fit
        names = [u.name for u in fit.model.unknowns]
        if GAP not in names:
            return 1.0
        gap, coefficients = names.index(GAP), self.term.names
        held = [i for i, name in enumerate(names) if name not in coefficients]
        precision = np.linalg.inv(fit.covariance)
        known = np.linalg.inv(precision[np.ix_(held, held)])[held.index(gap), held.index(gap)]
        return float(known / fit.covariance[gap, gap])

    @property
    def reaches_ringing(self) -> bool:
        """Whether its orders repeat with the load, as impacts do, up to the ringing of one: it
        could be taken for impacts, and these for it."""
        term, model = self.term, self.explanation.fit.model
        if term.variable != "load_angle":
            return False
        fastest = max(1.0 / seen.rotation_period_s for seen in model.recordings)
        return term.orders * fastest >= ringing_hz(model.bench.vector())

    def alone(self) -> Learned:
        """The same without the names that it was learned beside, fitted again."""
        fit, idle = self.explanation.fit, self.explanation.candidates
        if not idle:
            return self
        at = {place for candidate in idle for place in self.explanation.places(candidate)}
        kept = [i for i in range(fit.point.size) if i not in at]
        bench, names = fit.model.bench, {candidate.name for candidate in idle}
        model = replace(
            fit.model,
            bench=bench.with_effects(*(e for e in bench.effects if e.name not in names)),
            unknowns=tuple(fit.model.unknowns[i] for i in kept),
        )
        alone = fit_simulated(model, fit.point[kept], fit.steps[kept])
        return replace(self, explanation=Explanation((), alone))


def learned_term(
    base: Explanation,
    remaining: Sequence[Unexplained],
    false_alarm: float,
    motor_angle_known: bool,
) -> Learned | None:
    """What predicts most of what an explanation leaves; ``None`` if nothing does.

    Parameters
    ----------
    remaining
        What still repeats: its lines propose motor orders and frequencies.
    """
    fit = base.fit
    known = {term.block for term in fit.model.bench.learned_terms}
    found = []
    for proposed in _hypotheses(remaining, motor_angle_known):
        hypothesis = replace(proposed, most=_shown(fit.model, proposed))
        if _kind_of(hypothesis).block in known:
            continue
        groups = _groups(fit, hypothesis)
        if groups is not None:
            found.append((hypothesis, groups))
    trials = alike(learn(found, fit.model.prior_precision(), false_alarm), false_alarm)
    for trial in trials:
        with suppress(BenchError):
            explanation = _fitted(base, trial)
            if explanation is None:
                continue
            others = tuple(t.hypothesis.term(t.coefficients) for t in trials if t is not trial)
            return Learned(explanation, _kind_of(trial.hypothesis), others)
    return None


def _kind_of(hypothesis: Hypothesis) -> type[LearnedTerm]:
    return EncoderError if hypothesis.side == EncoderError.side else LearnedTorque


def _hypotheses(remaining: Sequence[Unexplained], motor_angle_known: bool) -> Iterator[Hypothesis]:
    turn = 2.0 * math.pi
    for side in ("load", "motor"):
        for reverses in (False, True):
            yield Hypothesis(side, "load_angle", turn, reverses)
    own = not motor_angle_known
    orders = _bases(remaining, "motor angle", lambda entry: entry.lowest_order)
    for order in orders:
        if order * LONGEST_PERIOD >= 1.0:
            yield Hypothesis("motor", "motor_angle", turn / order, False, own)
    whole = [order for order in orders if order == round(order)]
    for order in whole[:1]:
        yield Hypothesis("encoder", "motor_angle", turn / order, False, own)
    for frequency in _bases(remaining, "time", lambda entry: entry.frequency_hz):
        yield Hypothesis("motor", "time", 1.0 / frequency, False, True)


def _shown(model: SimulatedSignals, hypothesis: Hypothesis) -> int:
    """Orders below half of the sampling frequency in some recording; steps follow the highest."""

    def base_hz(seen: Observed) -> float:
        if hypothesis.variable == "time":
            return 1.0 / hypothesis.period
        turns = 1.0 / seen.rotation_period_s
        if hypothesis.variable == "motor_angle":
            turns = abs(seen.reference_speed_rpm) / 60.0
        return turns * 2.0 * math.pi / hypothesis.period

    most = max(0.5 * seen.sampling_hz / base_hz(seen) for seen in model.recordings)
    return max(1, min(int(most), LEARNED_HARMONICS))


def _bases(
    remaining: Sequence[Unexplained], dependence: What, value: Callable[[Unexplained], float]
) -> list[float]:
    """Orders or frequencies that what is left could be made of, at most a few.

    Its lines, the smallest distance between two of them and, of whole orders, one. First those
    whose multiples hold most of the lines' power; of equal ones the largest: it needs the fewest
    orders.
    """
    powers = {
        channel: sum(e.amplitude**2 for e in remaining if e.channel == channel)
        for channel in {entry.channel for entry in remaining}
    }
    lines: dict[float, float] = {}
    for entry in remaining:
        if entry.dependence in (dependence, "angle or time") and value(entry) > 0.0:
            line = value(entry)
            if dependence == "motor angle" and abs(line - round(line)) < 0.1 * WHOLE:
                line = float(round(line))
            line = next((x for x in lines if abs(line / x - 1.0) <= SAME_ORDER), line)
            share = entry.amplitude**2 / powers[entry.channel]
            lines[line] = lines.get(line, 0.0) + share
    between = [abs(a - b) for a in lines for b in lines if abs(a - b) > WHOLE]
    bases = [*lines, *sorted(between)[:1]]
    if dependence == "motor angle" and any(line == round(line) for line in lines):
        bases.append(1.0)

    def held(base: float) -> float:
        return sum(
            power
            for line, power in lines.items()
            if abs(line / base - round(line / base)) < WHOLE
            and 1 <= round(line / base) <= LEARNED_HARMONICS
        )

    found: list[float] = []
    for base in sorted(bases, key=lambda base: (-round(held(base), 2), -base)):
        if all(abs(base / other - 1.0) > WHOLE for other in found):
            found.append(base)
    return found[:MOST_BASES]


def _groups(fit: SimulatedFit, hypothesis: Hypothesis) -> list[Group] | None:
    """Products of the columns of every recording; of the halves of one that is alone."""
    most = hypothesis.most
    names = _names(hypothesis, most)
    model = _with_term(fit.model, hypothesis, most, [Unknown(name) for name in names.values()])
    size = len(fit.point)
    moved = np.repeat(np.concatenate([fit.point, np.zeros(len(names))])[None], len(names) + 1, 0)
    step = _typical_size(fit, hypothesis)
    moved[np.arange(len(names)) + 1, np.arange(len(names)) + size] = step
    z = model.whitened(moved)
    columns = np.zeros((1 + 2 * LEARNED_HARMONICS, z.shape[1]))
    places = [k if k <= most else k - most + LEARNED_HARMONICS for k in names]
    columns[places] = (z[0] - z[1:]) / step
    if not np.all(np.isfinite(columns)):
        return None
    parts = [model.by_recording(row) for row in (*columns, *fit.derivatives().T, fit.residual)]
    unknowns = fit.model.unknowns
    groups = []
    for i, seen in enumerate(fit.model.recordings):
        table = np.stack([part[i] for part in parts])  # (p, channels, samples)
        own = [k for k, u in enumerate(unknowns) if u.recording == seen.name]
        halves = [slice(None)]
        if len(fit.model.recordings) == 1:
            middle = table.shape[2] // 2
            halves, own = [slice(None, middle), slice(middle, None)], []
        for rows in halves:
            matrix = table[:, :, rows].reshape(len(table), -1)
            groups.append(Group(matrix @ matrix.T, tuple(own)))
    return groups


def _names(hypothesis: Hypothesis, orders: int) -> dict[int, str]:
    """Slots of the coefficients by their place among constant, cosines and sines."""
    names = hypothesis.term(np.zeros(2 * orders + 1)).names
    return dict(enumerate(names, start=2 * orders + 1 - len(names)))


def _typical_size(fit: SimulatedFit, hypothesis: Hypothesis) -> float:
    """Size that what is left would have as this, N m or rad: a step for derivatives."""
    model = fit.model
    seen = model.recordings[0]
    left = np.sqrt(np.mean(fit.unexplained(0) ** 2, axis=1))
    if hypothesis.side == "encoder":
        return float(left[0]) / abs(seen.reference_speed_rpm)
    if len(left) > 1:
        torque = float(left[1]) * model.bench.value("torque_constant_nm_per_a")
    else:
        torque = float(left[0]) / RPM_PER_RAD_PER_S * model.bench.value("speed_gain_nm_s_per_rad")
    return torque * (model.bench.value("gear_ratio") if hypothesis.side == "load" else 1.0)


def _with_term(
    model: SimulatedSignals, hypothesis: Hypothesis, orders: int, unknowns: Sequence[Unknown]
) -> SimulatedSignals:
    """The comparison with a term of so many orders, all zero, and these unknowns more."""
    term = hypothesis.term(np.zeros(2 * orders + 1))
    return model.beside(model.bench.with_learned(term), unknowns)


def _fitted(base: Explanation, trial: Trial) -> Explanation | None:
    """All unknowns jointly with the coefficients, twice, the noise estimated again between."""
    hypothesis, model = trial.hypothesis, base.fit.model
    reach = RANGE * float(np.abs(trial.coefficients).max())
    names, kind = _names(hypothesis, trial.orders), _kind_of(hypothesis)
    unknowns = [Unknown(names[k], -reach, reach) for k in trial.free]
    start = [float(trial.coefficients[k]) for k in trial.free]
    if hypothesis.own_zero:
        period = hypothesis.period
        whole = abs(2.0 * math.pi / hypothesis.period % 1.0) < 1e-6
        if not (hypothesis.variable == "motor_angle" and whole):
            half = 0.5 * WHOLE * hypothesis.period
            unknowns.append(Unknown(kind.period_slot, period - half, period + half))
            start.append(period)
        for seen, shift in zip(model.recordings[1:], trial.shifts[1:], strict=False):
            reach = 1.5 * period
            unknowns.append(Unknown(kind.shift_slot, -reach, reach, recording=seen.name))
            start.append((shift + 0.5 * period) % period - 0.5 * period)
    extended = _with_term(model, hypothesis, trial.orders, unknowns)
    own = base.fit.point.size
    starts = [np.concatenate([base.fit.point, start])]
    # What was missing may have drawn the gap away: also from where it is with the torque known.
    for aligned in aligned_starts(extended):
        aligned[own:] = start
        starts.append(with_shifts(extended, aligned))
    left = [float(z @ z) for z in extended.whitened(np.stack(starts))]
    begin = starts[int(np.argmin(np.nan_to_num(left, nan=np.inf)))]
    fit = fit_simulated(extended, begin, base.fit.steps, rough=True)
    if fit.chi_square >= base.fit.chi_square:
        return None
    return with_own_noise(replace(base, fit=fit))


def band_of(fit: SimulatedFit, term: LearnedTerm, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A term at these values of its variable and its standard deviation, each as ``x``."""
    basis = np.hstack([np.ones((x.size, 1)), *waves_over(x, term.period, term.orders)])
    basis = basis[:, -len(term.names) :]  # an encoder has no constant
    places = {u.name: i for i, u in enumerate(fit.model.unknowns) if u.recording is None}
    free = [k for k, name in enumerate(term.names) if name in places]
    at = [places[term.names[k]] for k in free]
    covariance = fit.covariance[np.ix_(at, at)]
    variance = np.einsum("xi,ij,xj->x", basis[:, free], covariance, basis[:, free])
    return term.over(x), np.sqrt(variance)


def answer_of(learned: Learned, closed: float, remains: bool) -> LearnedAnswer:
    """What is told of it.

    ``closed``: share of what repeated that is gone; ``remains``: whether anything still stands out.
    """
    term = learned.term
    lowest = 0.0 if term.belongs_to_recordings else -0.5 * term.period
    x = lowest + term.period * np.linspace(0.0, 1.0, CURVE_POINTS)
    values, sd = band_of(learned.explanation.fit, term, x)
    withheld = ""
    if learned.reaches_ringing:
        withheld = (
            "What was learned repeats with the load at orders that reach the ringing of an "
            "impact: it could be taken for impacts, so no gap is given."
        )
    elif remains and closed < (1.0 - UNEXPLAINED_SHARE):
        withheld = (
            f"What was learned removes {100.0 * closed:.0f} % of what repeats; from "
            f"{100.0 * (1.0 - UNEXPLAINED_SHARE):g} % on a gap would be given."
        )
    elif len({other.block for other in (term, *learned.alike)}) > 1:
        withheld = (
            "These recordings do not tell an error of the motor's encoder from a torque at the "
            "motor, nor either from a transmission error, which moves the gap: so no gap is given. "
            "Record a second speed, and the other direction."
        )
    elif learned.explanation.candidates:
        withheld = (
            "Beside a torque of no known law a name of the catalogue may be wrong and bias the "
            "gap, so no gap is given. Add known effects of the joint to the bench, and diagnose "
            "again."
        )
    return LearnedAnswer(
        term,
        learned.alike,
        LearnedCurve(x, values, sd),
        learned.gap_share,
        withheld,
    )
