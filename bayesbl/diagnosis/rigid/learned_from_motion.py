"""A torque of no known law on a rigid bench, where the residual over the motion is direct.

    τ = a_0 + Σ_k a_k cos(2π k x/X) + b_k sin(2π k x/X)

over where the axis is or how fast it turns, through the window and the filter that all is compared
behind. X is twice the way, beyond which nothing is known, in whatever unit it is measured; where
the way is longer than a turn, X may be that too. What it depends on is found in what the names
leave; then the names are found again beside it.
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
from bayesbl.bench.learned import LearnedTerm, LearnedTorque, variable_of, waves_over
from bayesbl.diagnosis.comparison import EffectsFit, residuals
from bayesbl.diagnosis.diagnosis import CURVE_POINTS, LearnedAnswer, LearnedCurve
from bayesbl.diagnosis.learning import (
    LEAST_OF_ITS_OWN,
    Group,
    Hypothesis,
    Trial,
    alike,
    learn,
    tried_orders,
)
from bayesbl.diagnosis.residual_noise import ResidualNoise, sandwich
from bayesbl.diagnosis.rigid.inverse import InverseComparison
from bayesbl.diagnosis.rigid.learned_waves import LearnedWaves, wave_of
from bayesbl.diagnosis.rigid.preparation import GRAVITY
from bayesbl.recording.types import FloatArray

MEAN_POINTS = 1000

_NOTHING_ELSE = np.zeros((0, 0))


@dataclass(frozen=True, slots=True)
class LearnedFromMotion:
    """A torque, and comparisons with it.

    Attributes
    ----------
    comparison
        Where its coefficients are fitted with all else, by ``waves``; without those it is in the
        bench as it was found.
    held
        The torque is in the bench: effects are named again beside it.
    same
        A fit of ``held`` with the names as they were, where they cannot be found again beside it.
    others
        Dependences that are not told from it.
    as_found
        The same where nothing is named again.
    """

    comparison: InverseComparison
    held: InverseComparison
    same: EffectsFit | None
    waves: LearnedWaves | None
    torque: LearnedTorque
    others: tuple[LearnedTerm, ...]
    as_found: LearnedFromMotion | None = None

    def answer(self, fit: EffectsFit) -> LearnedAnswer:
        """What is told of the torque beside what a fit of the comparison names."""
        torque = self.beside(fit)
        made = self.comparison
        return LearnedAnswer(torque, _largest(torque, made), self.others, _curve(torque, made))

    def beside(self, fit: EffectsFit) -> LearnedTorque:
        """The torque as a fit of the comparison has it."""
        if self.waves is None:
            return self.torque
        noises = [ResidualNoise.of(part) for part in residuals(self.comparison, fit, "used")]
        places = [fit.names.index(name) for name in self.waves.names]
        covariance = sandwich(fit.columns, noises)[np.ix_(places, places)]
        return self.waves.torque(fit.besides, covariance)

    def notes(self, fit: EffectsFit) -> tuple[str, ...]:
        """Over the load's angle: how near it is to a spring, and what was held."""
        torque = self.beside(fit)
        if torque.variable != "load_angle" or torque.reverses:
            return ()
        x = _over(torque, self.comparison)
        line = straight_line(x, self.comparison.bench.value("gear_ratio") * torque.over(x))
        return (
            f"What was learned over the load's angle is {line}. Gravity is held as the bench has "
            "it, so its error, and any offset, is in what was learned.",
        )

    def bench(self, fit: EffectsFit) -> Bench | None:
        """With the torque and what was named; ``None`` if a phase of it belongs to a recording."""
        effects = [
            BenchEffect(name, {k: EffectParameterValue(v) for k, v in parameters.items()})
            for name, parameters in fit.effects.items()
        ]
        own_phase = [
            effect_named(e.name).is_periodic and PHASE not in e.parameters for e in effects
        ]
        if any(own_phase):
            return None
        bench = replace(self.comparison.bench, learned_torque=self.beside(fit))
        return bench.with_parameters(**fit.bench).with_effects(*bench.effects, *effects)


def straight_line(x: FloatArray, torque: FloatArray) -> str:
    """How much of a torque at the load over its angle, N m and rad, (n,), a spring would be."""
    over, way = torque - torque.mean(), x - x.mean()
    slope = float(over @ way / (way @ way))
    left = over - slope * way
    share = 100.0 * (1.0 - float(left @ left) / max(float(over @ over), np.finfo(float).tiny))
    return f"to {share:.3g} % a straight line of {slope:.3g} N m/rad at the load, as of a spring"


def learning_of(
    comparison: InverseComparison,
    fit: EffectsFit,
    false_alarm: float,
    gravity_nm: float | None = None,
) -> LearnedFromMotion | None:
    """The torque that predicts most of what a fit leaves; ``None`` if none does.

    Over the load's angle it is then free in the comparison. Over the speed and the motor's angle it
    is held as found: free, it could take the place of every friction or ripple.

    A position is taken as recorded: if it means another place in another recording, nothing over
    the position predicts. ``gravity_nm``: gravity beside which a torque over the load's angle is
    learned, if not the comparison's, N m.
    """
    if comparison.load or comparison.bench.learned_torque is not None:
        return None
    every = _beside_all(comparison, fit)
    tables = {h: _tables(comparison, every, h) for h in _hypotheses(comparison)}
    if min(map(len, tables.values())) < 2:
        return None
    scales = _noise(tables)
    found = [(h, _groups(parts, scales)) for h, parts in tables.items()]
    trials = learn(found, _NOTHING_ELSE, false_alarm)
    if not trials:
        return None
    best, *others = alike(trials, false_alarm)
    alternatives = tuple(t.hypothesis.term(t.coefficients) for t in others)
    as_found = _as_found(comparison, fit, best.hypothesis, alternatives)
    if best.hypothesis.variable != "load_angle":
        # Beside a free torque over the speed no friction would be known; over the motor's angle no
        # ripple.
        return as_found
    without = _without_its_laws(comparison, best.hypothesis, gravity_nm)
    waves = _waves(without, best, tables[best.hypothesis])
    free = replace(without, learned=waves)
    torque = waves.torque(free.fit(tuple(e for e in every.effects if e in free.terms)).besides)
    held = _with(without, torque)
    return LearnedFromMotion(free, held, None, waves, torque, alternatives, as_found)


def _without_its_laws(
    comparison: InverseComparison, over: Hypothesis, gravity_nm: float | None
) -> InverseComparison:
    """The comparison without laws of the same variable: what is learned holds them.

    Over the load's angle also without gravity and an offset. A spring has its rest somewhere; its
    mean over the places recorded would be told as an offset that nothing has.
    """
    if over.variable != "load_angle" or over.reverses:
        return comparison
    terms = {
        name: term
        for name, term in comparison.terms.items()
        if not (term.candidate.is_plain and set(effect_named(name).depends_on) <= {"load_angle"})
    }
    unknown = tuple(name for name in comparison.unknown if name != GRAVITY)
    bench = comparison.bench
    if gravity_nm is not None:
        bench = bench.with_parameters(**{GRAVITY: gravity_nm})
    return replace(
        comparison, bench=bench, terms=terms, unknown=unknown, gravity_free=False, seen=()
    )


def _as_found(
    comparison: InverseComparison,
    fit: EffectsFit,
    hypothesis: Hypothesis,
    others: tuple[LearnedTerm, ...],
) -> LearnedFromMotion:
    """What a fit leaves over a variable; what is named keeps its size."""
    parts = _tables(comparison, fit, hypothesis)
    groups = _groups(parts, [ResidualNoise.of(part[:, -1]).strongest for part in parts])
    best = tried_orders(hypothesis, groups, _NOTHING_ELSE, 1)[0]
    torque = best.hypothesis.term(best.coefficients)
    assert isinstance(torque, LearnedTorque)
    torque = replace(torque, sd_nm=_deviations(groups, best))
    made = _with(comparison, torque)
    same = made.fit(tuple(fit.effects), fit)
    return LearnedFromMotion(made, made, same, None, torque, others)


def _with(comparison: InverseComparison, torque: LearnedTorque) -> InverseComparison:
    """The comparison with this torque in its bench."""
    return replace(comparison, bench=replace(comparison.bench, learned_torque=torque), seen=())


def _waves(
    comparison: InverseComparison, trial: Trial, parts: Sequence[FloatArray]
) -> LearnedWaves:
    """What is fitted of a torque: the mean is an effect's, where one may have it."""
    hypothesis, orders = trial.hypothesis, trial.orders
    alone = {"direction"} if hypothesis.reverses else set[str]()
    named = any(
        c.is_plain and set(effect_named(c.name).depends_on) == alone for c in comparison.candidates
    )
    ratio = comparison.bench.value("gear_ratio")
    used = [
        variable_of(hypothesis.variable, motion, ratio)
        for piece, motion in zip(comparison.pieces, comparison.motions, strict=True)
        if piece.use == "used" and piece.shown
    ]
    low = min(float(x.min()) for x in used)
    high = min(max(float(x.max()) for x in used), low + hypothesis.period)
    x = low + (high - low) * (np.arange(MEAN_POINTS) + 0.5) / MEAN_POINTS
    table = np.vstack(parts)
    constant = table[:, 0]
    places = [p for p in range(1, 2 * orders + 1) if p in trial.free]
    means = np.array([float(wave_of(hypothesis, orders, p, x).mean()) for p in places])
    columns = table[:, [k for k in _places(trial) if k > 0]] - np.outer(constant, means)
    changes = np.zeros((2 * orders + 1, len(places)))
    changes[places, range(len(places))] = 1.0
    changes[0] = -means
    if not named and 0 in trial.free:
        columns = np.column_stack([constant, columns])
        changes = np.column_stack([np.eye(2 * orders + 1)[0], changes])
    return LearnedWaves(hypothesis, orders, changes @ _seen(columns))


def _seen(columns: FloatArray) -> FloatArray:
    """Combinations of columns, (n, p), that are seen for themselves, of one size, shape (p, q).

    Over half of a period sines and cosines are much the same: a combination with less than
    :data:`LEAST_OF_ITS_OWN` of a column's power would only spread what is sure of the others.
    """
    size = np.sqrt((columns**2).mean(axis=0))
    size = np.where(size > 0.0, size, np.inf)
    powers, turned = np.linalg.eigh((columns / size).T @ (columns / size) / len(columns))
    kept = powers > LEAST_OF_ITS_OWN
    return np.asarray(turned[:, kept] / np.sqrt(powers[kept]) / size[:, None])


def _hypotheses(comparison: InverseComparison) -> Iterator[Hypothesis]:
    ratio, motions = comparison.bench.value("gear_ratio"), comparison.motions
    ends = [(float(motion.angle.min()), float(motion.angle.max())) for motion in motions]
    every = (max(high for _, high in ends) - min(low for low, _ in ends)) / ratio
    longest = max(high - low for low, high in ends) / ratio
    # A period of twice one recording's way needs fewer orders, if no place is taken for another.
    ways = {every, longest} if 2.0 * longest >= every else {every}
    turn = 2.0 * math.pi
    top = max(float(np.abs(motion.speed).max()) for motion in motions)
    for reverses in (False, True):
        for way in sorted(ways):
            yield Hypothesis("motor", "load_angle", 2.0 * way, reverses)
        if every >= turn:
            yield Hypothesis("motor", "load_angle", turn, reverses)
        if longest * ratio >= turn:
            yield Hypothesis("motor", "motor_angle", turn, reverses)
    yield Hypothesis("motor", "motor_speed", 4.0 * top)


def _beside_all(comparison: InverseComparison, fit: EffectsFit) -> EffectsFit:
    """The fit with every plain effect in it: what is still missing may be what hides its name."""
    inside = {c.contains for c in comparison.candidates if c.name in fit.effects}
    plain = [c.name for c in comparison.candidates if c.is_plain]
    return comparison.fit(
        (*fit.effects, *(name for name in plain if name not in {*fit.effects, *inside})), fit
    )


def _tables(
    comparison: InverseComparison, fit: EffectsFit, hypothesis: Hypothesis
) -> list[FloatArray]:
    """Columns and what is left, of every recording; of the halves of one that is alone.

    All that a fit has keeps its size: what the torque depends on is sought in what it leaves.
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
    basis = np.hstack([np.ones((x.size, 1)), *waves_over(x, torque.period, torque.orders)])
    return LearnedCurve(x, torque.over(x), np.sqrt(basis**2 @ np.square(torque.sd_nm)))


def _largest(torque: LearnedTorque, comparison: InverseComparison) -> float:
    values = torque.over(_over(torque, comparison))
    return float(np.abs(values if torque.reverses else values - values.mean()).max())
