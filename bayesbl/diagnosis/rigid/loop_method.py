"""Diagnosis of a rigid drive under its speed controller, from the speed alone at several speeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesbl.diagnosis.diagnosis import (
    Diagnosis,
    Estimate,
    NamedEffect,
    OrderSize,
    ParameterError,
    PieceSignals,
    probability_of,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import PieceResiduals, disagreement_table, piece_residuals
from bayesbl.diagnosis.fitted_parameters import parameter_errors
from bayesbl.diagnosis.inference import MOST_EFFECTS
from bayesbl.diagnosis.residuals.unexplained import Unexplained
from bayesbl.diagnosis.rigid.loop_setting import (
    ECCENTRICITY,
    GAINS,
    RIPPLE,
    Setting,
    loop_setting,
)
from bayesbl.diagnosis.rigid.order_laws import (
    Free,
    Law,
    LawFit,
    Lines,
    chosen_laws,
    fit_laws,
    generalises,
    line_size,
    with_both,
    z_between,
)
from bayesbl.diagnosis.rigid.order_lines import OrderLine, Turning, find_orders, noise_sd
from bayesbl.diagnosis.rigid.speed_loop import LOOP_EFFECTS, torque_of_angle
from bayesbl.diagnosis.task import Task
from bayesbl.naming.criteria import ALIKE
from bayesbl.progress import StageProgress
from bayesbl.recording.moving import VARIES
from bayesbl.recording.types import MOTOR_SPEED, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

LAWS: Mapping[Law, str] = {"torque": RIPPLE, "angle": ECCENTRICITY}

MOST_LINES = 12
"""Looked at: what is beyond them is weaker."""

ONE_SPEED = (
    "All recordings are at one speed: a torque that repeats and an error of the encoder look the "
    "same. A recording at another speed tells them apart."
)


class RigidLoop:
    """Lines of the speed at orders of the motor, and the laws that they follow over the speeds."""

    name = "forward"

    def describe(self, task: Task) -> str:
        """How many pieces, and what may be named."""
        found = loop_setting(task)
        return (
            f"forward, the speed alone of a rigid drive, {len(found.used)} to fit on, "
            f"{len(found.held_out)} held out; candidates {', '.join(found.candidates)}"
        )

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer."""
        setting, asked = loop_setting(task), task.config.candidates
        found = find_orders(setting.used, MOST_LINES, asked.false_alarm)
        if progress is not None:
            progress("Seeking orders", 1, 2)
        return _Answer(task, setting, found).diagnosis()


METHOD = RigidLoop()


@dataclass(frozen=True, slots=True)
class _Added:
    """What the loop must have besides: an effect or a wrong parameter, and what looks the same."""

    name: str
    rivals: tuple[str, ...]
    z: float


@dataclass(slots=True)
class _Answer:
    """From orders to the answer."""

    task: Task
    setting: Setting
    found: list[OrderLine]
    true_angle: bool = False

    def diagnosis(self) -> Diagnosis:
        """Name what follows a law, describe the rest."""
        setting = self.setting
        lines = lines_of(setting.used, [line.order for line in self.found])
        laws = [law for law, name in LAWS.items() if name in setting.candidates]
        notes = list(setting.notes)
        fit: LawFit | None = None
        added: list[_Added] = []
        if self.found and laws and _one_speed(lines.speeds):
            notes.append(ONE_SPEED)
        elif self.found and laws:
            values, free = setting.values, setting.free
            first = [k for k, line in enumerate(self.found) if line.order == 1.0 and len(laws) > 1]
            fit = chosen_laws(lines, laws, values, free)
            for place in first:
                fit = with_both(lines, fit, place, values, free)
            # What follows no law must not bend the loop of what does.
            kept = {k: law for k, law in fit.laws.items() if generalises(lines, fit, k)}
            fit = fit_laws(lines, kept, values, free) if kept else None
            if fit is not None:
                fit, free, added = self._with_loop(lines, fit)
                for place in set(first) & fit.laws.keys():
                    fit = with_both(lines, fit, place, values, free)
                most = self.task.config.candidates.max_effects or MOST_EFFECTS
                fit = _strongest(lines, fit, max(0, most - len(added)))
        if fit is not None and (again := self._by_true_angle(fit)) is not None:
            return again.diagnosis()
        named, remaining = self._named(lines, fit, notes)
        effects, errors = self._of_loop(fit, added)
        effects = (*named, *effects)
        pieces, signals = self._compared(fit)
        return Diagnosis(
            verdict_of(effects=bool(effects), parameters=bool(errors), remains=bool(remaining)),
            effects,
            errors,
            tuple(remaining),
            disagreement_table(pieces, in_units_of_noise=False),
            tuple(notes),
            bench_parameters=_fitted(fit, setting.free.priors) if fit else {},
            signals=tuple(signals),
            order_sizes=tuple(self._sizes(fit)),
        )

    def _by_true_angle(self, fit: LawFit) -> _Answer | None:
        """The same over the angle without the encoder's error, once it is named beside torques.

        Over the measured angle a torque of order n has sidebands of n ε/2 of its size.
        """
        first = [k for k in fit.laws if fit.laws[k] != "torque" and self.found[k].order == 1.0]
        if self.true_angle or not first or len(fit.laws) == 1:
            return None

        def without_error(item: Turning) -> Turning:
            (line,), _ = item.fit([1.0])
            if not np.isfinite(line):
                return item
            torque, angle, phase = fit.sizes[first[0]]
            like = angle * torque_of_angle(fit.values, np.full(1, item.speed_rad_per_s))[0]
            turn = line / (torque * np.exp(1j * phase) + like)
            error = angle * np.real(turn / abs(turn) * np.exp(1j * item.angle))
            return replace(item, angle=item.angle - error, made={})

        setting = replace(
            self.setting,
            used=tuple(map(without_error, self.setting.used)),
            held_out=tuple(map(without_error, self.setting.held_out)),
        )
        alarm = self.task.config.candidates.false_alarm
        return _Answer(self.task, setting, find_orders(setting.used, MOST_LINES, alarm), True)

    def _with_loop(self, lines: Lines, fit: LawFit) -> tuple[LawFit, Free, list[_Added]]:
        """The fit with what else the loop must have, and what of it is then free."""
        effects = [name for name in LOOP_EFFECTS if name in self.setting.candidates]
        wrong = [name for name in ("motor_inertia_kg_m2", *GAINS) if self.setting.values[name]]
        found: list[_Added] = []
        free = self.setting.free
        fastest = float(np.abs(lines.speeds).max()) * max(lines.orders)
        units = {
            name: self.setting.values[GAINS[0]] if "friction" in name else 1.0 / fastest
            for name in effects
        }
        while True:
            trials = {}
            for name in [*effects, *wrong]:
                if name in free.added or name in free.priors:
                    continue
                if name in units:
                    more = replace(free, added={**free.added, name: units[name]})
                else:
                    more = replace(free, priors={**free.priors, name: math.inf})
                made = fit_laws(lines, fit.laws, self.setting.values, more)
                if made.freedom > 0:
                    trials[name] = more, made
            gains = {name: z_between(made, fit) for name, (_, made) in trials.items()}
            good = [name for name in trials if gains[name] >= ALIKE]
            if not good:
                return fit, free, found
            top = trials[max(good, key=lambda name: gains[name])][1]
            first, *rivals = [name for name in good if z_between(top, trials[name][1]) < ALIKE]
            found.append(_Added(first, tuple(rivals), gains[first]))
            free, fit = trials[first]
            if not set(wrong) - free.priors.keys():
                return fit, free, found  # only ratios of inertia and gains show

    def _named(
        self, lines: Lines, fit: LawFit | None, notes: list[str]
    ) -> tuple[list[NamedEffect], list[Unexplained]]:
        """Orders whose law is sure, largest line first, and the others."""
        named, remaining = list[tuple[float, NamedEffect]](), list[Unexplained]()
        for place, line in enumerate(self.found):
            law = None if fit is None else fit.laws.get(place)
            power = float(np.nanmax(lines.size[:, place]))
            if fit is None or law is None:
                remaining.append(self._unexplained(lines, place))
                continue
            first = line.order == 1.0
            rivals = self._rivals(lines, fit, place)
            if law == "angle" and not (first or rivals):
                angle = fit.sizes[place][1]
                notes.append(
                    f"The line at order {line.order:.5g} grows with the speed as an error of the "
                    f"encoder's angle of {1e3 * angle:.2g} mrad does, not as a torque."
                )
            if (law == "angle" or rivals) and not first:
                remaining.append(self._unexplained(lines, place))
                continue
            parts: tuple[Law, ...] = ("torque", "angle") if law == "both" else (law,)
            for part in parts:
                named.append((power, self._effect(fit, place, line, part, rivals)))
        named.sort(key=lambda pair: -pair[0])
        return [effect for _, effect in named], _periodic_in_time(remaining, self.setting.used)

    def _effect(
        self, fit: LawFit, place: int, line: OrderLine, part: Law, rivals: tuple[str, ...]
    ) -> NamedEffect:
        torque, angle, _ = fit.sizes[place]
        sd = fit.deviations[(place, part)]
        z = abs(torque if part == "torque" else angle) / sd
        held = line.order == round(line.order)
        if part == "torque":
            order = Estimate(line.order, math.nan if held else line.sd)
            parameters = {"torque_nm": Estimate(abs(torque), sd), "order": order}
        else:
            parameters = {"angle_rad": Estimate(abs(angle), sd)}
        name = LAWS[part]
        evidence = 0.5 * min(z**2, line.score) - math.log(line.trials)
        return NamedEffect(name, parameters, probability_of(evidence), z, rivals)

    def _rivals(self, lines: Lines, fit: LawFit, place: int) -> tuple[str, ...]:
        """The other law, if it fits as well."""
        law = fit.laws[place]
        if law == "both":
            return ()
        other: Law = "angle" if law == "torque" else "torque"
        name = LAWS[other]
        if name not in self.setting.candidates:
            return ()
        made = fit_laws(lines, {**fit.laws, place: other}, self.setting.values, self.setting.free)
        return (name,) if z_between(fit, made) < ALIKE else ()

    def _unexplained(self, lines: Lines, place: int) -> Unexplained:
        """A line without a law, or with one that the catalogue does not have."""
        line, sizes = self.found[place], lines.size[:, place]
        strongest = np.argsort(-np.nan_to_num(sizes))
        seen = [self.setting.used[i].piece.name for i in strongest if sizes[i] > 0.0]
        top = float(np.nanmax(sizes))
        return Unexplained(
            MOTOR_SPEED,
            "motor angle",
            top,
            "rpm",
            line.order,
            line.order,
            math.nan,
            tuple(seen),
            line.score,
        )

    def _of_loop(
        self, fit: LawFit | None, added: Sequence[_Added]
    ) -> tuple[tuple[NamedEffect, ...], tuple[ParameterError, ...]]:
        effects, errors = list[NamedEffect](), list[ParameterError]()
        if fit is None:
            return (), ()
        for item in added:
            name, rivals = item.name, item.rivals
            if name in LOOP_EFFECTS:
                value = Estimate(fit.values[name], fit.deviations[name])
                parameters = {LOOP_EFFECTS[name]: value}
                chance = probability_of(0.5 * item.z**2)
                effects.append(NamedEffect(name, parameters, chance, item.z, rivals))
            else:
                believed = self.task.bench.parameters[name]
                estimate = _fitted(fit, [name])[name]
                errors.append(
                    ParameterError(name, believed.value, believed.tolerance, estimate, rivals)
                )
        errors += parameter_errors(self.task.bench, _fitted(fit, self.setting.free.priors))
        return tuple(effects), tuple(errors)

    def _sizes(self, fit: LawFit | None) -> Iterator[OrderSize]:
        """Every line as the torque that would make it."""
        values = self.setting.values if fit is None else fit.values
        for item in (*self.setting.used, *self.setting.held_out):
            lines = lines_of([item], [line.order for line in self.found])
            for place, line in enumerate(self.found):
                if not math.isfinite(lines.size[0, place]):
                    continue
                law = None if fit is None else fit.laws.get(place)
                one = float(line_size(values, line.order, lines.speeds, 1.0, 0.0, 0.0)[0])
                made = math.nan
                if fit is not None and law is not None:
                    made = float(fit.predicted(place, line.order, lines.speeds)[0]) / one
                yield OrderSize(
                    line.order,
                    law or "none",
                    item.piece.name,
                    item.piece.use,
                    float(lines.speeds[0]) * RPM_PER_RAD_PER_S,
                    float(lines.size[0, place]) / one,
                    float(lines.sd[0, place]) / one,
                    made,
                )

    def _compared(self, fit: LawFit | None) -> tuple[list[PieceResiduals], list[PieceSignals]]:
        """Residuals and signals of every piece, with a mean alone and with all laws."""
        laws = {} if fit is None else fit.laws
        orders = [self.found[place].order for place in laws]
        pieces, signals = [], []
        for item in (*self.setting.used, *self.setting.held_out):
            speed = np.array([item.speed_rad_per_s])
            sizes = [
                float(fit.predicted(place, self.found[place].order, speed)[0])
                for place in laws
                if fit is not None
            ]
            before = item.predicted((), np.zeros(0))
            after = item.predicted(orders, np.array(sizes))
            piece = item.piece
            kept = [piece.kept(v) for v in (piece.time_s, piece.measured, before, after)]
            time, measured, first, last = kept
            pieces.append(
                piece_residuals(
                    piece.name, MOTOR_SPEED, piece.use, measured - first, measured - last
                )
            )
            signals.append(
                PieceSignals(piece.name, MOTOR_SPEED, piece.use, time, measured, first, last)
            )
        return pieces, signals


def _periodic_in_time(
    lines: Sequence[Unexplained], turning: Sequence[Turning]
) -> list[Unexplained]:
    """Lines at orders that differ but have one frequency, each in another recording, as one."""
    by_name = {item.piece.name: item for item in turning}
    left, found = list(lines), list[Unexplained]()
    while left:
        first = left.pop(0)
        alike = [first]
        for other in list(left):
            for a, b in ((x, y) for x in first.recordings[:1] for y in other.recordings[:1]):
                one, two = by_name[a], by_name[b]
                lasting = min(item.turns / item.turns_per_s for item in (one, two))
                apart = first.lowest_order * one.turns_per_s - other.lowest_order * two.turns_per_s
                if a != b and abs(apart) * lasting < 1.0:
                    alike.append(other)
                    left.remove(other)
        if len(alike) > 1:
            hertz = first.lowest_order * by_name[first.recordings[0]].turns_per_s
            size = max(line.amplitude for line in alike)
            names = tuple(line.recordings[0] for line in alike)
            first = Unexplained(MOTOR_SPEED, "time", size, "rpm", math.nan, math.nan, hertz, names)
        found.append(first)
    return found


def lines_of(turning: Sequence[Turning], orders: Sequence[float]) -> Lines:
    """The lines of every piece, their noise, and the speeds; sizes without what noise adds."""
    sizes, deviations = [], []
    for item in turning:
        found, left = item.fit(orders)
        sd = noise_sd(item, orders, left)
        sizes.append(np.sqrt(np.maximum(np.abs(found) ** 2 - 2.0 * sd**2, 0.0)))
        deviations.append(sd)
    speeds = np.array([item.speed_rad_per_s for item in turning])
    return Lines(tuple(orders), speeds, np.array(sizes), np.array(deviations))


def _strongest(lines: Lines, fit: LawFit, most: int) -> LawFit:
    """The laws of the largest lines; the others are left to be described."""
    kept = sorted(fit.laws, key=lambda place: -float(np.nanmax(lines.size[:, place])))[:most]
    return replace(fit, laws={place: fit.laws[place] for place in sorted(kept)})


def _one_speed(speeds: FloatArray) -> bool:
    sizes = np.abs(speeds)
    return bool(np.ptp(sizes) <= VARIES * sizes.max())


def _fitted(fit: LawFit, names: Iterable[str]) -> dict[str, Estimate]:
    """Loop parameters, lognormal."""
    return {
        name: Estimate(math.log(fit.values[name]), fit.deviations[name], logarithmic=True)
        for name in names
    }
