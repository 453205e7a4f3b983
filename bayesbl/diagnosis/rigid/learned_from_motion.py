"""A torque of no known law on a rigid bench, where the residual over the motion is direct.

    τ = a_0 + Σ_k a_k cos(2π k x/X) + b_k sin(2π k x/X)

over where the axis is or how fast it turns, through the window and the filter that all is compared
behind. X is twice the way, beyond which nothing is known, in whatever unit it is measured; where
the way is longer than a turn, X may be that too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effect_declaration import PHASE
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import LEARNED_HARMONICS
from bayesbl.bench.learned import LearnedTorque, variable_of
from bayesbl.diagnosis.comparison import EffectsFit
from bayesbl.diagnosis.diagnosis import LearnedAnswer, LearnedCurve
from bayesbl.diagnosis.learning import Group, Hypothesis, Trial, alike, learn, tried_orders
from bayesbl.diagnosis.residual_noise import ResidualNoise
from bayesbl.diagnosis.rigid.inverse import InverseComparison
from bayesbl.recording.types import FloatArray

CURVE_POINTS = 181

_NOTHING_ELSE = np.zeros((0, 0))


@dataclass(frozen=True, slots=True)
class LearnedFit:
    """The comparison with the torque in its bench, fitted again, and what is told of it."""

    comparison: InverseComparison
    fit: EffectsFit
    answer: LearnedAnswer

    @property
    def bench(self) -> Bench | None:
        """With what was named too; ``None`` if a phase of it belongs to a recording."""
        effects = [
            BenchEffect(name, {k: EffectParameterValue(v) for k, v in parameters.items()})
            for name, parameters in self.fit.effects.items()
        ]
        own_phase = [
            effect_named(e.name).is_periodic and PHASE not in e.parameters for e in effects
        ]
        if any(own_phase):
            return None
        bench = self.comparison.bench
        return bench.with_parameters(**self.fit.bench).with_effects(*bench.effects, *effects)


def learned_fit(
    comparison: InverseComparison, fit: EffectsFit, false_alarm: float
) -> LearnedFit | None:
    """The torque that predicts most of what a fit leaves; ``None`` if none does.

    A position is taken as recorded: if it means another place in another recording, nothing over
    the position predicts.
    """
    if comparison.load or comparison.bench.learned_torque is not None:
        return None
    tables = {h: _tables(comparison, fit, h) for h in _hypotheses(comparison)}
    if min(map(len, tables.values())) < 2:
        return None
    scales = _noise(tables)
    found = [(h, _groups(parts, scales)) for h, parts in tables.items()]
    trials = learn(found, _NOTHING_ELSE, false_alarm)
    if not trials:
        return None
    best, *others = alike(trials, false_alarm)
    torque = best.hypothesis.term(best.coefficients)
    assert isinstance(torque, LearnedTorque)
    torque = replace(torque, sd_nm=_deviations(dict(found)[best.hypothesis], best))
    bench = replace(comparison.bench, learned_torque=torque)
    with_torque = replace(comparison, bench=bench, seen=())
    return LearnedFit(
        with_torque,
        with_torque.fit(tuple(fit.effects), fit),
        LearnedAnswer(
            torque,
            _largest(torque, comparison),
            tuple(t.hypothesis.term(t.coefficients) for t in others),
            _curve(torque, comparison),
        ),
    )


def _hypotheses(comparison: InverseComparison) -> Iterator[Hypothesis]:
    ratio = comparison.bench.value("gear_ratio")
    way = max(float(np.ptp(motion.angle)) for motion in comparison.motions) / ratio
    turn = 2.0 * math.pi
    top = max(float(np.abs(motion.speed).max()) for motion in comparison.motions)
    for reverses in (False, True):
        yield Hypothesis("motor", "load_angle", 2.0 * way, reverses)
        if way >= turn:
            yield Hypothesis("motor", "load_angle", turn, reverses)
        if way * ratio >= turn:
            yield Hypothesis("motor", "motor_angle", turn, reverses)
    yield Hypothesis("motor", "motor_speed", 4.0 * top)


def _tables(
    comparison: InverseComparison, fit: EffectsFit, hypothesis: Hypothesis
) -> list[FloatArray]:
    """Columns and what is left, of every recording; of the halves of one that is alone.

    What is named keeps its size: the torque is what naming leaves.
    """
    tables: dict[str, list[FloatArray]] = {}
    for i, piece in enumerate(comparison.pieces):
        if piece.use == "used" and piece.shown:
            left = piece.kept(piece.measured - fit.predictions[i])
            columns = piece.kept(_columns(comparison, i, hypothesis))
            tables.setdefault(piece.name, []).append(np.column_stack([columns, left]))
    parts = [np.vstack(own) for own in tables.values()]
    return np.array_split(parts[0], 2) if len(parts) == 1 else parts


def _noise(tables: Mapping[Hypothesis, list[FloatArray]]) -> list[float]:
    """Of each recording, from what the best prediction of it leaves, where it is strongest.

    With s² the largest density of its spectrum, p'Σp ≤ s² p'p for whatever is predicted: no smooth
    prediction gains by noise that is as smooth.
    """
    best: Trial | None = None
    for hypothesis, parts in tables.items():
        groups = _groups(parts, [ResidualNoise.of(part[:, -1]).strongest for part in parts])
        for trial in tried_orders(hypothesis, groups, _NOTHING_ELSE, 1)[:1]:
            if best is None or trial.gain > best.gain:
                best = trial
    assert best is not None
    scales = []
    for part, z in zip(tables[best.hypothesis], best.left_out, strict=True):
        left = part[:, -1]
        if best.gain > 0.0:
            left = left - part[:, _places(best)] @ z[list(best.free)]
        scales.append(ResidualNoise.of(left).strongest)
    return scales


def _groups(parts: Sequence[FloatArray], scales: Sequence[float]) -> list[Group]:
    return [Group(part.T @ part / s**2, ()) for part, s in zip(parts, scales, strict=True)]


def _places(trial: Trial) -> list[int]:
    """Of its coefficients among the columns."""
    return [k if k <= trial.orders else k - trial.orders + LEARNED_HARMONICS for k in trial.free]


def _columns(comparison: InverseComparison, i: int, hypothesis: Hypothesis) -> FloatArray:
    """Of the constant, cosines and sines as piece ``i`` shows them, shape (n, 1 + 2 orders)."""
    motion, view = comparison.motions[i], comparison.views[i]
    x = variable_of(hypothesis.variable, motion, comparison.bench.value("gear_ratio"))
    sign = np.sign(motion.speed) if hypothesis.reverses else np.ones_like(x)
    phase = 2.0 * math.pi * x / hypothesis.period
    orders = range(1, LEARNED_HARMONICS + 1)
    waves = [wave(k * phase) for wave in (np.cos, np.sin) for k in orders]
    return np.column_stack([view(sign * wave) / comparison.unit for wave in (sign**2, *waves)])


def _deviations(groups: list[Group], trial: Trial) -> tuple[float, ...]:
    """Standard deviation of every coefficient; 0 where it is not fitted."""
    total = np.sum([group.products for group in groups], axis=0)
    waves = _places(trial)
    total[np.diag_indices(len(total))] *= 1.0 + 1.0 / max(float(total[-1, -1]), 1.0)
    covariance = np.linalg.pinv(total[np.ix_(waves, waves)], 1e-12, True)
    found = np.zeros(trial.coefficients.size)
    found[list(trial.free)] = np.sqrt(np.diag(covariance))
    return tuple(map(float, found))


def _over(torque: LearnedTorque, comparison: InverseComparison) -> FloatArray:
    """Values of the variable that the recordings reach, shape (CURVE_POINTS,)."""
    ratio = comparison.bench.value("gear_ratio")
    seen = [variable_of(torque.variable, motion, ratio) for motion in comparison.motions]
    low, high = min(float(x.min()) for x in seen), max(float(x.max()) for x in seen)
    if high - low > torque.period:
        low, high = -0.5 * torque.period, 0.5 * torque.period
    return np.linspace(low, high, CURVE_POINTS)


def _curve(torque: LearnedTorque, comparison: InverseComparison) -> LearnedCurve:
    x = _over(torque, comparison)
    phase = 2.0 * math.pi * np.outer(x, np.arange(1, len(torque.cosine_nm) + 1)) / torque.period
    basis = np.hstack([np.ones((x.size, 1)), np.cos(phase), np.sin(phase)])
    return LearnedCurve(x, torque.over(x), np.sqrt(basis**2 @ np.square(torque.sd_nm)))


def _largest(torque: LearnedTorque, comparison: InverseComparison) -> float:
    values = torque.over(_over(torque, comparison))
    return float(np.abs(values if torque.reverses else values - values.mean()).max())
