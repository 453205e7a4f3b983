"""Marginalise, never select, laws that bias δ before they show in the residuals; and drift.

No test at any level detects a law that moves δ by two standard deviations and the residuals by one.
So its presence is not tested: its size is marginalised, with a prior of its usual size
(:attr:`bayesbl.bench.effect_declaration.Effect.always_in`). All snapshots share this size. Each but
the first also has its own deviation, as for everything that drifts
(:mod:`bayesbl.bench.parameters`). So the change between snapshots stays sharp where possible.

Between snapshots, people may change payload, gains, filters and the recorder; damage may change
other parameters; a cable may pull. These are hypotheses with a small probability and a wide size,
averaged over. One cause may change several parameters: gravity's torque changes together with the
inertia, although the visible part may look like drift.

Everything is linear at a fit (:mod:`bayesbl.model_search.linear`). A term far from its value in the
fit becomes one of its unknowns; the others stay linear. Laws that act alike may be far from zero
together although none is alone. Then the one that explains most by itself becomes an unknown.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effects import EFFECTS, effect_named, parameters_on, sampled_lateness_s
from bayesbl.bench.kernel import RPM, Slot
from bayesbl.bench.parameters import (
    BENCH_PARAMETERS,
    CORRECTABLE_PARAMETERS,
    drift_of,
    simulated_range,
)
from bayesbl.errors import BenchError
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated, prior_pull
from bayesbl.matching.observed import Observed
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.matching.predictive_check import RepeatingPower, agrees, disagreements
from bayesbl.matching.signals import GAP, SimulatedSignals, Unknown
from bayesbl.model_search.constants import FORM_SHARE
from bayesbl.model_search.linear import Linearised, ModelPosterior, Term, search
from bayesbl.model_search.refit import SHARES_TRIED, fitted_from, slopes
from bayesbl.probabilities import FALSE_ALARM, chi2_isf, normal_isf
from bayesbl.progress import Progress, silent
from bayesbl.recording.types import FloatArray

FIRST_STEP, LARGEST_STEP = 0.3, 2.0
"""Steps of derivatives, in usual sizes, changes or drift budgets."""

SHAFT_DAMPING_SHARE = 0.25
"""Relative standard deviation of the shaft's damping, which no data sheet states and every bench
takes from somewhere."""

CHANGED_TOGETHER: dict[str, tuple[str, ...]] = {
    "payload": ("gravity_torque_nm", "load_inertia_kg_m2"),
    "controller_gains": ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad"),
}
"""Bench parameters that one cause changes together."""

CAUSES = CHANGED_TOGETHER | {
    name: (name,) for name in CORRECTABLE_PARAMETERS if name != "gravity_torque_nm"
}
"""Bench parameters that each cause may change. Inertia changes alone with the posture of the axes
behind the joint; gravity changes with a mass, so never alone. Effects declare their own changes."""

CHANGED_SHARE = 0.1
"""Usual relative size of a change that is not drift."""

CHANGED = 0.05
"""Prior probability of one unreported cause before a snapshot. A judgement: with 14 causes, half of
all joints are unchanged. It costs nothing if the data support no change. If drift explains a change
nearly as well, it decides the change's share of the interval."""

MOST_CHANGED = 3
"""Largest number of causes in one set."""

ONE_SPEED = 0.02
"""Largest relative difference of speeds that does not distinguish the laws of friction."""

FAR = 3.0
"""Distance of a size from zero, in posterior standard deviations, beyond which it becomes an
unknown of the fit."""

MOST_AGREEING = 2.0
"""Largest χ² per sample of a fit that may agree with the recordings: 1 by the recorder's noise,
more by noise in the loop and repeating rounding. A fit above it explains nothing."""

ABSENT = 0.5
"""Prior probability that a law which a joint either has or has not is absent. A judgement: even
odds."""

LEAST_SHARE = 0.01
"""Smallest share of a positive parameter that remains after any drift or change."""

SAMPLED = "sampled_control"
DEAD_TIME = Slot.sampled_control__delay_periods.name
INSTANT_SHARE = Slot.sampled_control__instant_share.name
CURRENT_SKEW = Slot.channel_time_skew__current_s.name
UNIFORM_SD = 1.0 / math.sqrt(3.0)
"""Root mean square of a share that may be anything between 0 and 1."""

UNSTATED_PERIODS = 1.0
"""Standard deviation of a sampled controller's dead time, in periods. A manual states the period,
but hardly ever the delay of buses. A judgement: one more stage on the same clock."""

USUAL_PERIODS_S = (2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3)
"""Usual periods of the speed controllers of drives and robots."""

USUAL_DELAYS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Dead times in periods from which a controller is fitted, with instantaneous speed and without."""

NEAR_REST = (
    Slot.motor_coulomb_friction__width_rad_per_s.name,
    Slot.motor_coulomb_friction__presliding_rad.name,
)

EDGE_VARIANCE = Slot.contact_softness__variance_rad2.name

USEFUL_RATIO, USEFUL_LEVEL = 2.0, 0.9
"""Ratio of the interval's ends beyond which it says too little about a gap, and the interval's
level. A judgement: it no longer distinguishes a worn joint from one twice as worn."""

WIDTH_DRAWS = 1000

MOST_MORE = 20.0
"""Excess of χ² over the best loop, up to which another loop is fitted fully. It limits time:
beyond, a loop is at most e⁻¹⁰ as likely by itself, though laws may make up for some of this."""

MOST_ROUNDS = 6
"""Largest number of laws freed in turn. It only limits time: the check decides on any that are
still far."""

MOST_TRIES = 20
SIZES_DRAWN = 1000


@dataclass(frozen=True, slots=True)
class Direction:
    """One way in which a joint may differ from its bench.

    Attributes
    ----------
    slot
        Parameter name as :meth:`Bench.vector` takes it.
    usual, drift, changed
        Standard deviations in the slot's unit, 0 for none: of the size that all snapshots share, of
        a snapshot's own drift from the first, and of a change by people.
    positive
        Whether the shared size has a half-normal prior.
    least
        Smallest size that the simulator takes without tiny steps.
    effect
        Effect that the bench lacks; ``None`` if it has the slot.
    is_fitted
        Whether the bench already has the most probable value.
    instead_of, per_unit
        An unknown of the fit that is reduced by ``per_unit`` for each unit of this, or none.
        Otherwise their common effect would drown their difference.
    """

    slot: str
    usual: float
    drift: float
    changed: float = 0.0
    positive: bool = False
    least: float = 0.0
    effect: str | None = None
    is_fitted: bool = False
    instead_of: str = ""
    per_unit: float = 0.0

    @property
    def size(self) -> float:
        """Order of magnitude of the deviation."""
        return self.usual or self.drift or self.changed

    @property
    def is_law(self) -> bool:
        """Whether it is a law that the bench lacks and whose size cannot be negative."""
        return self.effect is not None and self.is_not_negative

    @property
    def is_not_negative(self) -> bool:
        """Whether the simulator takes no negative size."""
        return simulated_range(self.slot)[0] >= 0.0


def directions(bench: Bench, stated: Mapping[str, float]) -> list[Direction]:
    """All directions in which a joint may differ from a bench.

    ``stated``: relative standard deviations of drift by name, in place of the defaults; 0 for none.
    Parameters with a tolerance have their shared uncertainty there.
    """
    return [d for d in _directions(bench, stated) if d.usual + d.drift + d.changed > 0.0]


def laws(bench: Bench) -> list[Direction]:
    """Directions for recordings made at one time, between which nothing drifts."""
    return [replace(d, drift=0.0, changed=0.0) for d in directions(bench, {}) if d.usual > 0.0]


def _directions(bench: Bench, stated: Mapping[str, float]) -> Iterator[Direction]:
    known = set(bench.tolerances) | set(() if bench.identified is None else bench.identified.names)
    for info in BENCH_PARAMETERS:
        size = abs(bench.value(info.name))
        share = SHAFT_DAMPING_SHARE if info.name == "shaft_damping_nm_s_per_rad" else 0.0
        usual = 0.0 if info.name in known else share * size
        drift = drift_of(info.name, stated) * size
        yield Direction(info.name, usual, drift, CHANGED_SHARE * size if info.correctable else 0.0)
    present = {effect.name: effect for effect in bench.effects}
    for effect in EFFECTS:
        main = effect.main_amplitude
        changed = _usual(bench, effect.name) if effect.may_change else 0.0
        if effect.name in present:
            existing = present[effect.name]
            values = existing.complete()
            for item in effect.parameters:
                stated_value = existing.parameters.get(item.name)
                sd = 0.0 if stated_value is None else stated_value.sd or 0.0
                size = max(abs(values[item.name]), sd) if item.is_amplitude else sd
                drift = drift_of(f"{effect.name}.{item.name}", stated) * size
                by_change = changed if item is main else 0.0
                yield Direction(f"{effect.name}__{item.name}", 0.0, drift, by_change)
            if existing.name == SAMPLED and "delay_periods" not in existing.parameters:
                yield Direction(DEAD_TIME, UNSTATED_PERIODS, 0.0)
                if "instant_share" not in existing.parameters:
                    yield Direction(INSTANT_SHARE, UNIFORM_SD, 0.0, positive=True)
        elif effect.always_in or effect.may_change:
            usual = _usual(bench, effect.name) if effect.always_in else 0.0
            slot = f"{effect.name}__{main.name}"
            if slot == CURRENT_SKEW and SAMPLED in present:
                # A drive measures the current before the new torque acts, or logs a later demand.
                usual = present[SAMPLED].complete()["period_s"]
            yield Direction(
                slot,
                usual,
                drift_of(effect.name, stated) * usual,
                changed,
                # A bench includes the lag that its drive compensates.
                positive=main.not_negative and effect.enters != "loop",
                least=main.sought_from or 0.0,
                effect=effect.name,
            )


def _usual(bench: Bench, name: str) -> float:
    """Usual size of an effect."""
    effect = effect_named(name)
    main = effect.main_amplitude.name
    return next(abs(p.typical) for p in parameters_on(bench, effect) if p.name == main)


def with_friction(bench: Bench, recordings: Sequence[Observed]) -> Bench:
    """Add the friction of motor and load, which every joint has and few data sheets state.

    Half-normal from zero, with the usual size. At a single speed all friction is viscous, and
    :func:`_dry_shares` allows for a dry part. Motions also show how dry friction builds up from
    rest. Friction that the bench already has stays.
    """
    laws = ["viscous"]
    speeds = [r.reference_speed_rpm for r in recordings]
    moves = any(r.motion is not None for r in recordings)
    if moves or max(speeds) - min(speeds) > ONE_SPEED * max(map(abs, speeds)):
        laws.append("coulomb")
    effects = {effect.name: effect for effect in bench.effects}
    for side, law in itertools.product(("motor", "load"), laws):
        effect = effect_named(f"{side}_{law}_friction")
        existing = effects.get(effect.name, BenchEffect(effect.name, {}))
        unstated = {
            p.name: EffectParameterValue(0.0, p.typical)
            for p in parameters_on(bench, effect)
            if moves or p.is_amplitude
        }
        effects[effect.name] = replace(existing, parameters={**unstated, **existing.parameters})
    return bench.with_effects(*effects.values())


@dataclass(frozen=True, slots=True)
class Label:
    """Directions of one linear term, in all snapshots (``recording`` is ``None``) or in one.

    In one, it is a deviation from the others. ``cause``: of a change; empty for a law or drift,
    which has one direction.
    """

    directions: tuple[Direction, ...]
    recording: str | None
    cause: str = ""

    @property
    def scales(self) -> list[float]:
        """Standard deviations, in the slots' units."""
        if self.cause:
            return [d.changed for d in self.directions]
        return [d.usual if self.recording is None else d.drift for d in self.directions]

    def can_be_simulated(self, sizes: FloatArray) -> bool:
        """Whether the term can be an unknown, with these sizes in standard deviations, (k,).

        A law stays linear if its size is negative, or below the smallest that the simulator takes.
        """
        direction = self.directions[0]
        is_too_small = (
            self.recording is None
            and direction.is_law
            and sizes[0] * direction.usual <= direction.least
        )
        return not (direction.is_fitted or is_too_small)

    @property
    def is_lag(self) -> bool:
        """Whether it is a lag of the speed loop in all snapshots."""
        if self.cause or self.recording is not None:
            return False
        name, _, parameter = self.directions[0].slot.partition("__")
        return bool(parameter) and effect_named(name).enters == "loop"

    @property
    def is_positive(self) -> bool:
        """Whether a negative size would be something else."""
        return self.directions[0].is_law and not self.is_lag

    @property
    def hypothesis(self) -> str:
        """Name, followed by the snapshot if it acts in one only."""
        name = self.directions[0].slot.replace("__", ".")
        if self.cause:
            name = f"{self.cause} changed"
        return name if self.recording is None else f"{name} ({self.recording})"

    def term(self, columns: FloatArray, bench: Bench) -> Term:
        """The term for the linear search; ``columns``, (N, k), are per standard deviation.

        One snapshot cannot have less of what the fit's ``bench`` lacks.
        """
        direction = self.directions[0]
        is_lacking = all(effect.name != direction.effect for effect in bench.effects)
        is_shared = self.recording is None
        # Part of the friction is dry in any joint.
        may_be_absent = is_shared and bool(direction.effect) and not direction.instead_of
        positive = direction.positive and (is_shared or (bool(self.cause) and is_lacking))
        return Term(
            self.hypothesis,
            columns,
            positive,
            always=not self.cause,
            absent=ABSENT if positive and may_be_absent else 0.0,
            excludes=frozenset(self._rival_hypotheses()) if self.cause else frozenset(),
        )

    def _rival_hypotheses(self) -> Iterator[str]:
        """Other hypotheses that change one of the same parameters: each is changed once."""
        changed_slots = {d.slot for d in self.directions}
        for cause, slots in CAUSES.items():
            if cause != self.cause and changed_slots & set(slots):
                yield replace(self, cause=cause).hypothesis

    def unknowns(self, vector: FloatArray, sizes: FloatArray) -> list[Unknown]:
        """Unknowns of a fit for this term.

        Their normal prior is as wide as a Cauchy prior near these sizes, (k,), in standard
        deviations, so a law many times larger than usual is not pulled back. ``vector``, (slots,):
        the reference values, of the bench or of the first snapshot.
        """
        unknowns = []
        widths = np.sqrt(0.5 * (1.0 + sizes**2)) * self.scales
        for direction, scale in zip(self.directions, widths.tolist(), strict=True):
            value = float(vector[Slot[direction.slot]])
            # A lag that is far from zero is at least what the simulator takes without tiny steps.
            is_bounded = direction.is_not_negative or direction.positive or value > 0.0
            lower = direction.least if is_bounded else -math.inf
            if self.recording is None:
                high = simulated_range(direction.slot)[1]
                unknowns.append(Unknown(direction.slot, lower, high, centre=value, sd=scale))
                continue
            # The recordings alone decide the size of a change.
            sd = scale / CHANGED_SHARE if self.cause else scale
            low = max(LEAST_SHARE * value, lower) - value if is_bounded else -math.inf
            # In proportion to the value of this range, not to the bench's value.
            unknowns.append(
                Unknown(
                    direction.slot,
                    low,
                    sd=sd,
                    recording=self.recording,
                    added=True,
                    reference=value,
                )
            )
        return unknowns


@dataclass(frozen=True, eq=False)
class LinearisedFit:
    """A fit with the terms linearised at it: laws, drift and changes.

    Attributes
    ----------
    labels
        One for each term.
    posterior
        Posterior of the sizes, in standard deviations.
    sizes
        Draws of the sizes, shape (n, columns of all terms).
    residual
        Residual with all terms at their posterior mean, shape (N,).
    loops
        Pairs of rough fits, made when the loop was chosen: with the chosen loop, and with another
        that fits about as well (:func:`other_loops`).
    """

    fit: SimulatedFit
    labels: tuple[Label, ...]
    posterior: ModelPosterior
    sizes: FloatArray
    residual: FloatArray
    loops: tuple[tuple[SimulatedFit, SimulatedFit], ...] = ()

    def far_terms(self) -> list[tuple[Label, FloatArray]]:
        """Terms far from their values in the fit, with their best sizes alone, in prior deviations.

        A term is far if its mean is far from zero, or if a change is almost certain. If only all
        terms together are significant, any shared law may be. Lags act alike when linear: if one is
        far, with either sign, any lag may be. The term that alone lowers χ² most comes first.
        """
        indices = {k for k in range(len(self.labels)) if self._is_far(k, self.by_label()[k])}
        shared = {k for k, label in enumerate(self.labels) if label.recording is None}
        least_gain = -math.inf
        if not indices and self.posterior.always_gain > chi2_isf(FALSE_ALARM, len(self.labels)):
            indices, least_gain = shared, FAR**2
        if any(self.labels[k].is_lag for k in indices):
            indices |= {k for k in shared if self.labels[k].is_lag}
        linearised, covariance = self.posterior.linearised, self.posterior.covariance
        gains = []
        for k in indices:
            columns = linearised.terms[k].columns
            cross, pull = linearised.jacobian.T @ columns, columns.T @ linearised.residual
            precision = np.eye(pull.size) + columns.T @ columns - cross.T @ covariance @ cross
            sizes = np.asarray(np.linalg.solve(precision, pull), dtype=np.float64)
            if self.labels[k].can_be_simulated(sizes) and float(pull @ sizes) > least_gain:
                gains.append((float(pull @ sizes), k, sizes))
        return [(self.labels[k], sizes) for _, k, sizes in sorted(gains, reverse=True)]

    def _is_far(self, k: int, drawn: FloatArray) -> bool:
        label = self.labels[k]
        if label.cause:
            named = itertools.chain(self.posterior.named, *self.posterior.confounded)
            return label.hypothesis in named
        mean = float(drawn[:, 0].mean())
        if label.recording is not None and abs(mean) < FIRST_STEP:
            # Drift within the step of its derivative is linear, and its prior is the same.
            return False
        # A negative size of a law means something else, so it stays linear.
        return (mean if label.is_positive else abs(mean)) > FAR * float(drawn[:, 0].std())

    @property
    def has_discrepancy(self) -> bool:
        """Whether the posterior includes a discrepancy that no law explains."""
        return bool(self.posterior.linearised.groups)

    @property
    def is_possible(self) -> bool:
        """Whether no law has a surely negative size: then it would stand for something else.

        Negative means by more than the error of the law's form, because the other laws are inexact
        too. Only the sum of all lags counts, including those in the fit: one part of a loop
        compensates the delay of another.
        """
        sizes: dict[str, FloatArray] = {"lag": np.full(len(self.sizes), _lag_s(self.fit))}
        tolerances: dict[str, float] = {}
        for label, drawn in zip(self.labels, self.by_label(), strict=True):
            if label.recording is None and label.directions[0].is_law:
                kind = "lag" if label.is_lag else label.hypothesis
                sizes[kind] = sizes.get(kind, 0.0) + drawn[:, 0] * label.scales[0]
                tolerances[kind] = FORM_SHARE * label.scales[0]
        return not any(
            sizes[kind].mean() < -max(FAR * sizes[kind].std(), tolerance)
            for kind, tolerance in tolerances.items()
        )

    @cached_property
    def check(self) -> tuple[RepeatingPower, ...]:
        """Predictive check of the residual with all terms."""
        return tuple(disagreements(replace(self.fit, residual=self.residual)))

    @property
    def explains(self) -> bool:
        """Whether the fit with all terms agrees with the recordings and is physically possible."""
        return self.is_possible and agrees(self.check)

    @property
    def is_useful(self) -> bool:
        """Whether the gaps are useful although something unexplained repeats.

        If χ² is more than twice what noise leaves, a linearisation at the fit is meaningless.
        Without a discrepancy term, the draws do not include what repeats.
        """
        fit = self.fit
        if not self.has_discrepancy or fit.chi_square > MOST_AGREEING * fit.residual.size:
            return False
        drawn = self.posterior.draw(np.random.default_rng(0), WIDTH_DRAWS).shift
        misfit_variance = misfit_shift_sd(fit, self.posterior) ** 2
        for index, unknown in enumerate(fit.model.unknowns):
            if unknown.name != GAP:
                continue
            mean_square_shift = float(np.mean(drawn[:, index] ** 2))
            sd = math.sqrt(
                float(fit.covariance[index, index]) + mean_square_shift + misfit_variance
            )
            reach = normal_isf(0.5 * (1.0 - USEFUL_LEVEL)) * sd
            low, high = unknown.value(fit.point[index] + np.array([-reach, reach]))
            if not 0.0 < high < USEFUL_RATIO * low:
                return False
        return True

    def by_label(self) -> list[FloatArray]:
        """Draws of each label's sizes, shape (n, directions) each."""
        return _by_label(self.labels, self.sizes)


def _by_label(labels: Sequence[Label], columns: FloatArray) -> list[FloatArray]:
    """Columns of each label, (n, directions) each."""
    ends = np.cumsum([0, *(len(label.directions) for label in labels)])
    return [columns[:, a:b] for a, b in itertools.pairwise(ends)]


def linearised_fit(fit: SimulatedFit, nuisances: Sequence[Direction]) -> LinearisedFit:
    """Linearise laws, drift and changes at a fit, except those that are its unknowns."""
    model, d = fit.model, fit.point.size
    labels = _labels(fit, nuisances)
    width = sum(len(label.directions) for label in labels)
    ends = np.cumsum([part.size for part in model.by_recording(fit.residual)])[:-1]
    jacobians, residuals = np.split(fit.derivatives(), ends), np.split(fit.residual, ends)
    rows, acting, columns = [], [], []
    for index, (jacobian, residual) in enumerate(zip(jacobians, residuals, strict=True)):
        active, active_columns = _columns(fit, index, labels)
        # Only inner products matter, so the R factor replaces all samples.
        r_factor = np.linalg.qr(np.column_stack([jacobian, active_columns, residual]), mode="r")
        row = np.zeros((len(r_factor), d + width + 1))
        row[:, [*range(d), *(d + k for k in active), d + width]] = r_factor
        rows.append(row)
        acting.append(active)
        columns.append(active_columns)
    stacked = np.concatenate(rows)
    by_label = zip(labels, _by_label(labels, stacked[:, d:-1]), strict=True)
    linearised = Linearised(
        stacked[:, -1],
        stacked[:, :d],
        model.prior_precision(),
        prior_pull(model, fit.point),
        [label.term(term_columns, model.bench) for label, term_columns in by_label],
        np.zeros((len(stacked), 0)),
    )
    changed = {label.hypothesis: CHANGED for label in labels if label.cause}
    posterior = search(linearised, MOST_CHANGED, changed)
    drawn = posterior.draw(np.random.default_rng(0), SIZES_DRAWN)
    mean_sizes, mean_shift = drawn.sizes.mean(axis=0), drawn.shift.mean(axis=0)
    residual_parts = [
        residual - jacobian @ mean_shift - active_columns @ mean_sizes[active]
        for residual, jacobian, active, active_columns in zip(
            residuals, jacobians, acting, columns, strict=True
        )
    ]
    return LinearisedFit(fit, labels, posterior, drawn.sizes, np.concatenate(residual_parts))


def _lag_s(fit: SimulatedFit) -> float:
    """Total delay of the fitted loop: lags, and the periods of a sampled controller."""
    matrix = fit.model.vectors(fit.point[None], fit.model.recordings[0])
    lags = matrix[:, [Slot.current_loop_lag__time_s, Slot.speed_sensor_lag__time_s]]
    return float(lags.sum() + sampled_lateness_s(matrix)[0])


def always_terms(
    fit: SimulatedFit, nuisances: Sequence[Direction]
) -> tuple[tuple[Label, ...], list[FloatArray]]:
    """Labels and columns, (N, k) each, of laws and drift at a fit; without causes of a change."""
    labels = tuple(label for label in _labels(fit, nuisances) if not label.cause)
    stacked = np.zeros((fit.residual.size, sum(len(label.directions) for label in labels)))
    begin = 0
    for index in range(len(fit.model.recordings)):
        active, columns = _columns(fit, index, labels)
        stacked[begin : begin + len(columns), active] = columns
        begin += len(columns)
    return labels, _by_label(labels, stacked)


def _dry_shares(fit: SimulatedFit) -> Iterator[Direction]:
    """Dry share of each side's friction, for a fit at one speed that takes it all for viscous.

    Dry friction does not brake a load more when it crosses the gap faster, and it does not damp the
    motor's ringing. Half-normal.
    """
    model = fit.model
    stated = {effect.name for effect in model.bench.effects}
    # Viscous friction that the bench states has no dry share.
    open_names = {u.name for u in model.unknowns if u.recording is None and u.centre == 0.0}
    motor_rad_per_s = (
        max(abs(observation.reference_speed_rpm) for observation in model.recordings) / RPM
    )
    load_rad_per_s = motor_rad_per_s / model.bench.value("gear_ratio")
    for side, speed_rad_per_s in (("motor", motor_rad_per_s), ("load", load_rad_per_s)):
        effect, viscous = f"{side}_coulomb_friction", f"{side}_viscous_friction"
        viscous = Slot[f"{viscous}__coefficient_nm_s_per_rad"].name
        if viscous in open_names and effect not in stated:
            yield Direction(
                Slot[f"{effect}__torque_nm"].name,
                UNIFORM_SD * fit.value(viscous) * speed_rad_per_s,
                0.0,
                positive=True,
                effect=effect,
                instead_of=viscous,
                per_unit=1.0 / speed_rad_per_s,
            )


def _labels(fit: SimulatedFit, nuisances: Sequence[Direction]) -> tuple[Label, ...]:
    """Labels of each direction in all snapshots, and of drift and causes in each but the first."""
    model, nuisances = fit.model, [*nuisances, *_dry_shares(fit)]
    free_keys = {(u.name, u.recording) for u in model.unknowns}
    owners = [observation.name for observation in model.recordings[1:]]
    labels = [Label((d,), None) for d in nuisances if d.usual > 0.0]
    labels += [Label((d,), owner) for d in nuisances if d.drift > 0.0 for owner in owners]
    for owner in owners:
        for cause, slots in CAUSES.items():
            changed = tuple(d for d in nuisances if d.slot in slots and d.changed > 0.0)
            if changed:
                labels.append(Label(changed, owner, cause))
        effects = (d for d in nuisances if "__" in d.slot and d.changed > 0.0)
        labels += [Label((d,), owner, d.slot.partition("__")[0]) for d in effects]
    return tuple(
        label
        for label in labels
        if not any((d.slot, label.recording) in free_keys for d in label.directions)
    )


def _columns(
    fit: SimulatedFit, index: int, labels: Sequence[Label]
) -> tuple[list[int], FloatArray]:
    """Indices of the columns that act in a recording, and these columns of its whitened signals.

    Returns the columns with shape (N, acting).
    """
    model, observation = fit.model, fit.model.recordings[index]
    entries = [
        (label.recording, direction, scale)
        for label in labels
        for direction, scale in zip(label.directions, label.scales, strict=True)
    ]
    acting = [
        k
        for k, (owner, direction, _) in enumerate(entries)
        if owner in (None, observation.name) and direction.slot not in observation.known
    ]
    if not acting:
        return [], np.zeros((fit.model.by_recording(fit.residual)[index].size, 0))
    nuisances = list(dict.fromkeys(entries[k][1] for k in acting))
    unknowns = [Unknown(d.slot, recording=observation.name, added=True) for d in nuisances]
    point = np.concatenate([fit.point, np.zeros(len(unknowns))])
    slopes = _slopes(
        model.with_unknowns(with_neutral(model.bench, nuisances), unknowns), point, index, nuisances
    )
    rows = [nuisances.index(entries[k][1]) for k in acting]
    return acting, np.asarray(slopes[rows].T * [entries[k][2] for k in acting])


def _slopes(
    model: SimulatedSignals,
    point: FloatArray,
    index: int,
    nuisances: Sequence[Direction],
) -> FloatArray:
    """Derivatives of a recording's whitened signals by the last unknowns of its model, (k, N)."""
    values = model.vectors(point[None], model.recordings[index])[0]
    current = values[[Slot[d.slot] for d in nuisances]]
    # Step towards the farther end of the simulator's range if there is no room above.
    low, high = np.array([simulated_range(d.slot) for d in nuisances]).T
    sizes, least = np.array([(d.size, d.least) for d in nuisances]).T
    longest = LARGEST_STEP * sizes
    signs = np.where((high - current < longest) & (current - low > high - current), -1.0, 1.0)
    longest = np.minimum(longest, np.where(signs > 0.0, high - current, current - low))
    moves, share = np.zeros((len(nuisances), point.size)), np.ones(len(nuisances))
    moves[:, point.size - len(nuisances) :] = np.eye(len(nuisances))
    for k, direction in enumerate(nuisances):
        if direction.instead_of:
            reduced = model.index(direction.instead_of)
            moves[k, reduced] = -direction.per_unit
            # A share of the friction in this recording, which may have changed.
            share[k] = max(values[Slot[direction.instead_of]], 0.0) / point[reduced]
            room = min(share[k], 1.0) * point[reduced] - model.low[reduced]
            longest[k] = min(longest[k], room / direction.per_unit)
    steps = np.maximum(FIRST_STEP * sizes, least), np.minimum(least, longest), longest
    derivatives = slopes(model, index, point, signs[:, None] * moves, steps)
    return np.nan_to_num(derivatives, nan=0.0) * (signs * share)[:, None]


def with_neutral(bench: Bench, nuisances: Sequence[Direction]) -> Bench:
    """The bench with every law that it lacks, at size zero."""
    present = {effect.name for effect in bench.effects}
    added = [
        BenchEffect(
            name, {p.name: EffectParameterValue(p.neutral) for p in effect_named(name).parameters}
        )
        for name in dict.fromkeys(d.effect for d in nuisances if d.effect is not None)
        if name not in present
    ]
    return bench.with_effects(*bench.effects, *added) if added else bench


def with_far_terms_freed(
    fit: SimulatedFit, nuisances: Sequence[Direction], progress: Progress = silent
) -> LinearisedFit:
    """Free the terms that are far, one after another, and linearise the others at the new fit.

    A term may be far only because another is missing, so one is freed at a time. If the result does
    not explain the recordings, nothing is freed: a misfit moved the terms, and would move the gaps
    too.
    """
    nominal = linear_fit = _with_other_friction(linearised_fit(fit, nuisances), nuisances)
    loops: list[tuple[SimulatedFit, SimulatedFit]] = []
    for rounds in range(MOST_ROUNDS):
        progress(rounds, MOST_ROUNDS)
        trials = _with_next_freed(linear_fit, nuisances)
        if not trials:
            break
        freed = trials[0]
        limit = freed.chi_square + MOST_MORE
        stripped = [trial.without_derivatives() for trial in trials if trial.chi_square < limit]
        loops += [(stripped[0], trial) for trial in stripped[1:]]
        fit = fit_simulated(freed.model, freed.point, freed.steps, one_sided=True)
        linear_fit = _with_other_friction(linearised_fit(fit, nuisances), nuisances)
        fit = linear_fit.fit
    if linear_fit is not nominal and linear_fit.explains:
        # One-sided differences rank fits; the one that answers is made and checked with central.
        linear_fit = linearised_fit(fit_simulated(fit.model, fit.point, fit.steps), nuisances)
        if linear_fit.explains:
            return replace(linear_fit, loops=tuple(loops))
    return nominal


def _with_other_friction(
    linear_fit: LinearisedFit, nuisances: Sequence[Direction]
) -> LinearisedFit:
    """The same fit, or a better one from another friction near rest if it explains too little.

    χ² has a minimum for friction that builds up over a speed, and one for an angle.
    """
    fit = linear_fit.fit
    unknowns = fit.model.unknowns
    places = [k for k, u in enumerate(unknowns) if u.name in NEAR_REST and u.recording is None]
    if not places or linear_fit.explains:
        return linear_fit
    better = fit
    for place in places:
        start = fit.point.copy()
        start[places] = 0.0
        start[place] = unknowns[place].sd
        with suppress(BenchError):
            trial = fit_simulated(
                fit.model, start, fit.steps, one_sided=True, goal=better.chi_square
            )
            better = min(better, trial, key=lambda fit: fit.chi_square)
    return linear_fit if better is fit else linearised_fit(better, nuisances)


def other_loops(linear_fit: LinearisedFit) -> list[SimulatedFit]:
    """Fits with the other loops that may be the joint's, and everything freed after them."""
    fit, fits = linear_fit.fit, []
    for chosen, rival in linear_fit.loops:
        chosen_size = chosen.point.size
        freed = fit.model.unknowns[chosen_size:]
        if {u.key for u in freed} & {u.key for u in rival.model.unknowns}:
            continue
        added_effects = [e for e in fit.model.bench.effects if e not in chosen.model.bench.effects]
        bench = rival.model.bench.with_effects(*rival.model.bench.effects, *added_effects)
        model = replace(rival.model.with_unknowns(bench, freed), noise=fit.model.noise)
        common = sum(1 for _ in common_unknowns(fit.model, rival.model))
        start = np.concatenate([rival.point, fit.point[chosen_size:]])
        start[:common] += fit.point[:common] - chosen.point[:common]
        with suppress(BenchError):
            fits.append(fit_simulated(model, start, rival.steps))
    return fits


def common_unknowns(first: SimulatedSignals, second: SimulatedSignals) -> Iterator[Unknown]:
    """The common leading unknowns of two models."""
    pairs = zip(first.unknowns, second.unknowns, strict=False)
    return (
        unknown
        for unknown, _ in itertools.takewhile(lambda pair: pair[0].key == pair[1].key, pairs)
    )


def _with_next_freed(
    linear_fit: LinearisedFit, nuisances: Sequence[Direction]
) -> list[SimulatedFit]:
    """Free one more of the far terms: the best fit and its rivals; empty if no fit is better.

    A size that is ``FAR`` from zero is worth ``FAR``² of χ², or the linear term was wrong.

    Linear lags are much alike. So if a lag promises most, or the fit is far off, all lags are
    fitted, and also controllers with usual periods. If the bench states a sampled controller, its
    dead time comes first.
    """
    fit, far_terms = linear_fit.fit.with_derivatives(), linear_fit.far_terms()
    lags = [term for term in far_terms if term[0].is_lag]
    if lags and (far_terms[0][0].is_lag or fit.chi_square > _goal(fit)):
        trials: list[SimulatedFit | None] = [*_sampled_loops(fit, nuisances)]
        if not trials or all(e.name != SAMPLED for e in fit.model.bench.effects):
            trials += [_freed(fit, *term) for term in lags]
        rivals = sorted((f for f in trials if f is not None), key=lambda f: f.chi_square)
        if rivals and rivals[0].chi_square < fit.chi_square:
            return rivals
    freed = (_freed(fit, *term) for term in far_terms if not term[0].is_lag)
    better = (f for f in freed if f is not None and f.chi_square < fit.chi_square - FAR**2)
    return list(itertools.islice(better, 1))


def _freed(fit: SimulatedFit, label: Label, sizes: FloatArray) -> SimulatedFit | None:
    """Free one label, starting from these sizes; ``None`` if no start can be simulated."""
    bench = with_neutral(fit.model.bench, label.directions)
    first_vector = fit.model.vectors(fit.point[None], fit.model.recordings[0])
    added = label.unknowns((bench.vector() if label.recording is None else first_vector)[0], sizes)
    offsets = sizes * label.scales
    model = fit.model.with_unknowns(bench, added)
    move = np.concatenate([np.zeros(fit.point.size), offsets])
    for k, direction in enumerate(label.directions, fit.point.size):
        if direction.instead_of:
            reduced = model.index(direction.instead_of)
            room = (fit.point[reduced] - model.low[reduced]) / direction.per_unit
            move[k] = min(move[k], room)
            move[reduced] = -move[k] * direction.per_unit
    point = np.concatenate([fit.point, [unknown.centre for unknown in added]])
    return fitted_from(fit, model, [point + share * move for share in SHARES_TRIED], _goal(fit))


def _sampled_loops(fit: SimulatedFit, nuisances: Sequence[Direction]) -> list[SimulatedFit]:
    """Fits with a sampled controller, each from its own dead time: χ² has many minima in it.

    The period is the bench's, or each of the usual ones. The most promising is fitted first; the
    others start from it with the same delay. The period itself is not fitted, because χ² changes
    from tick to tick. There are no fits if a dead time is stated or fitted already, nor of usual
    periods for motions, whose reference is in steps as well.
    """
    moving = any(observation.motion is not None for observation in fit.model.recordings)
    stated = next((e for e in fit.model.bench.effects if e.name == SAMPLED), None)
    free_names = {unknown.name for unknown in fit.model.unknowns}
    with_current = {CURRENT_SKEW for o in fit.model.recordings if len(o.signals) > 1}
    if stated is None:
        periods_s: tuple[float, ...] = () if moving else USUAL_PERIODS_S
    else:
        is_known = DEAD_TIME in free_names or "delay_periods" in stated.parameters
        periods_s = () if is_known else (stated.complete()["period_s"],)
    minimal_chi_square, models, promises = _minimal_chi_square(fit, nuisances), {}, []
    for period_s in periods_s:
        bench = fit.model.bench
        if stated is None:
            ticks = BenchEffect(SAMPLED, {"period_s": EffectParameterValue(period_s)})
            bench = bench.with_effects(*bench.effects, ticks)
        loop_slots = {DEAD_TIME, INSTANT_SHARE, *with_current} - free_names
        freed = [d for d in directions(bench, {}) if d.slot in loop_slots and d.usual > 0.0]
        bench = with_neutral(bench, freed)
        added = [
            u for d in freed for u in Label((d,), None).unknowns(bench.vector()[0], np.ones(1))
        ]
        models[period_s] = fit.model.with_unknowns(bench, added)
        shares = (0.0, 1.0) if any(u.name == INSTANT_SHARE for u in added) else (0.0,)
        for delay, share in itertools.product(USUAL_DELAYS, shares):
            values = {DEAD_TIME: delay, INSTANT_SHARE: share}
            point = np.append(fit.point, [values.get(u.name, 0.0) for u in added])
            residual = models[period_s].whitened(point)[0]
            if np.all(np.isfinite(residual)):
                chi_square, shift = minimal_chi_square(residual)
                point[: shift.size] += shift
                promises.append((chi_square, period_s, point))
    fits: list[SimulatedFit] = []
    if not promises:
        return fits
    _, first_s, point = min(promises, key=lambda promise: promise[:2])
    steps, goal, first_added = fit.steps, _goal(fit), fit.point.size
    for period_s in sorted(models, key=lambda period_s: abs(math.log(period_s / first_s))):
        model, start = models[period_s], point.copy()
        late_s = sampled_lateness_s(models[first_s].vectors(point[None], model.recordings[0]))
        later_s = late_s - sampled_lateness_s(model.vectors(point[None], model.recordings[0]))
        start[first_added] += later_s[0] / period_s
        with suppress(BenchError):
            fits.append(fit_simulated(model, start, steps, rough=True, goal=goal))
            if period_s == first_s:
                point, steps, goal = fits[0].point, fits[0].steps, min(goal, fits[0].chi_square)
    return fits


def _goal(fit: SimulatedFit) -> float:
    """Largest χ² of a fit that may agree with the recordings."""
    return MOST_AGREEING * fit.residual.size


def misfit_shift_sd(fit: SimulatedFit, linear_posterior: ModelPosterior) -> float:
    """Standard deviation of a common shift of all gaps by a misfit, in their coordinates.

    What a bench lacks in a motion shows where the motor reverses, as the gap does: friction near
    rest, for example. So the misfit is not spread evenly over all directions, and its part along
    the gaps is unknown. The shift is uniform within √E/|J g|: that of the whole excess E of χ²,
    with J g the derivative by a shift of all gaps, orthogonal to the other unknowns.

    Zero at constant speed, and if the posterior has no discrepancy.
    """
    moving = any(observation.motion is not None for observation in fit.model.recordings)
    if not (moving and linear_posterior.linearised.groups):
        return 0.0
    gaps = [k for k, unknown in enumerate(fit.model.unknowns) if unknown.name == GAP]
    precision = float(np.linalg.inv(fit.covariance[np.ix_(gaps, gaps)]).sum())
    return UNIFORM_SD * math.sqrt(max(linear_posterior.excess_chi_square, 0.0) / precision)


def marginalised(
    posterior: DirectPosterior, linear_posterior: ModelPosterior, seed: np.random.SeedSequence
) -> DirectPosterior:
    """Marginalise the laws and bench parameters that the draws hold fixed.

    ``linear_posterior``: posterior of the terms linearised at the fit.

    δ is as uncertain as the gap's edges are wide: where teeth begin to touch depends on the contact
    law, which no recording shows. The arctan has edges of 1/α, and the recordings may show wider
    ones. All snapshots share this error.

    A draw that would leave the ranges of the unknowns gets another draw's shift. If nearly every
    shift leaves them, it stops at the ends of the ranges: without a shift, δ would be as certain as
    if nothing were missing.
    """
    model, rng = posterior.fit.model, np.random.default_rng(seed)
    flat = posterior.draws.reshape(-1, posterior.draws.shape[-1])
    gaps = [k for k, unknown in enumerate(model.unknowns) if unknown.name == GAP]
    sharp_rad = 0.0
    if model.bench.gap_form == "arctan":
        sharp_rad = 1.0 / model.bench.value("stiffness_sharpness_per_rad")
    edge_sd_rad = np.sqrt(edge_variances(posterior).ravel() + sharp_rad**2)
    misfit_sd = misfit_shift_sd(posterior.fit, linear_posterior)
    shifts = linear_posterior.draw(rng, len(flat)).shift
    moved, outside = flat.copy(), np.arange(len(flat))
    for _ in range(MOST_TRIES):
        trial = flat[outside] + shifts[rng.permutation(len(flat))[: outside.size]]
        if linear_posterior.linearised.groups:
            # A discrepancy is in no catalogue, so the direction in which it moves δ is unknown too.
            mean_shift = shifts[:, gaps].mean(axis=0)
            trial[:, gaps] += np.outer(rng.standard_normal(outside.size) - 1.0, mean_shift)
        if misfit_sd > 0.0:
            trial[:, gaps] += misfit_sd * rng.standard_normal((outside.size, 1))
        edge_rad = edge_sd_rad[outside] * rng.standard_normal(outside.size)
        for k in gaps:
            unknown = model.unknowns[k]
            trial[:, k] = unknown.coordinate(unknown.value(trial[:, k]) + edge_rad)
        within = np.all((trial > model.low) & (trial < model.high), axis=1)
        moved[outside[within]] = trial[within]
        moved[outside[~within]] = np.clip(trial[~within], model.low, model.high)
        outside = outside[~within]
        if not outside.size:
            break
    return posterior.with_model(moved)


def edge_variances(posterior: DirectPosterior) -> FloatArray:
    """Draws of the variance of the gap's edges, rad², shape (chain, draw).

    Zero if the recordings do not show that the edges are soft.
    """
    names = [unknown.name for unknown in posterior.fit.model.unknowns]
    if EDGE_VARIANCE not in names:
        return np.zeros(posterior.draws.shape[:-1])
    return posterior.draws[..., names.index(EDGE_VARIANCE)]


def _minimal_chi_square(
    fit: SimulatedFit, nuisances: Sequence[Direction]
) -> Callable[[FloatArray], tuple[float, FloatArray]]:
    """Function from a residual (N,) to its minimal χ² and the shift of the fit's unknowns, (d,).

    Unknowns, laws and drift vary within their priors.
    """
    _, columns = always_terms(fit, nuisances)
    jacobian, prior = fit.derivatives(), np.linalg.cholesky(fit.model.prior_precision()).T
    laws = np.hstack([np.zeros((jacobian.shape[0], 0)), *columns])
    stacked = np.vstack([np.hstack([jacobian, laws]), block_diag(prior, np.eye(laws.shape[1]))])
    orthogonal, triangle = np.linalg.qr(stacked)

    def minimise(residual: FloatArray) -> tuple[float, FloatArray]:
        residual = np.concatenate([residual, np.zeros(len(triangle))])
        projection = orthogonal.T @ residual
        shift = np.linalg.solve(triangle, projection)[: fit.point.size]
        return float(residual @ residual - projection @ projection), np.asarray(shift)

    return minimise
