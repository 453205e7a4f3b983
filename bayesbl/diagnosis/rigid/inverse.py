"""Inverse comparison on a rigid bench: measured motion in, what it should have needed out.

    J dω_m/dt + (m g l/N) sin θ_l + effects + known torques = K_t i          (torque, current)
    θ_l = θ_m/N + offset + effects                                          (load position)

Every effect is linear in its amplitude, so a fit is linear least squares around a scan of the few
parameters that are not (orders, fading speeds, a gap, a skew). Nothing is weighted: the fit
minimises the RMSE that is reported, and coloured noise widens its covariance instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import HIGHEST_ORDER, LOWEST_ORDER, ORDER, PHASE
from bayesbl.diagnosis.comparison import EffectsFit, Piece, TestedEffect
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.diagnosis.rigid.order_scan import OrderScan, scan_orders
from bayesbl.diagnosis.rigid.terms import SKEW, Term, required_torque
from bayesbl.recording.types import FloatArray

Values = dict[str, float]

SKEW_GRID_S = tuple(np.linspace(-0.01, 0.01, 21))


@dataclass(frozen=True, slots=True)
class InverseComparison:
    """Motion of every piece against what was measured of torque, current or load position.

    Attributes
    ----------
    motions, known
        For every piece: its motion, and known torques at the motor, N m, shape (n,).
    terms
        Effects that may take part.
    unknown
        Bench parameters that are fitted: inertias and the gravity torque.
    unit
        N m or rad in one unit of the channel: K_t where current is compared.
    load
        The load's position is compared; its zero is fitted for each recording.
    load_angle_known, phases_shared
        The motor position tells the load's angle, so gravity's direction; it is absolute, so one
        phase holds for all recordings. Without either, sine and cosine are free per recording.
    """

    pieces: tuple[Piece, ...]
    motions: tuple[Motion, ...]
    known: tuple[FloatArray, ...]
    bench: Bench
    terms: Mapping[str, Term]
    unknown: tuple[str, ...] = ()
    unit: float = 1.0
    load: bool = False
    load_angle_known: bool = False
    phases_shared: bool = False

    @property
    def candidates(self) -> tuple[TestedEffect, ...]:
        """All effects that may take part."""
        return tuple(term.candidate for term in self.terms.values())

    def fit(self, effects: tuple[str, ...], start: EffectsFit | None = None) -> EffectsFit:
        """Least squares with these effects; shapes that ``start`` holds are kept."""
        shapes: Values = {}
        trials: dict[str, float] = {}
        fresh = [name for name in effects if start is None or name not in start.effects]
        for name in effects:
            if start is not None and name in start.effects:
                shapes |= {
                    f"{name}.{shape}": start.effects[name][shape] for shape in self._scanned(name)
                }
                trials[name] = start.trials.get(name, 1.0)
        for name in fresh:
            trials[name] = self._scan(name, effects, shapes, start)
        values, used = self._solve(effects, shapes)
        predictions = self._predictions(effects, values, used)
        names = [name for name in values if self._is_used(name)]
        columns = tuple(
            piece.kept(self._columns(i, effects, values, names))
            for i, piece in enumerate(self.pieces)
            if piece.use == "used"
        )
        bench = {name: self.bench.value(name) + values[name] for name in self.unknown}
        found = {name: _catalogue_parameters(self.terms[name], values) for name in effects}
        edges = frozenset(name for name in effects if self._at_edge(name, values))
        return EffectsFit(found, bench, tuple(predictions), columns, tuple(names), trials, edges)

    def _at_edge(self, name: str, values: Mapping[str, float]) -> bool:
        """Whether the scan of an effect's shape ended where the scan ends."""
        term, scanned = self.terms[name], self._scanned(name)
        grid = SKEW_GRID_S if name == SKEW else term.law.grid
        if not scanned or not grid:
            return False
        near = 1e-2 * (grid[1] - grid[0])
        value = values[f"{name}.{scanned[0]}"]
        return not grid[0] + near < value < grid[-1] - near

    def scan_orders(self, fit: EffectsFit) -> OrderScan:
        """Residuals of a fit on the used pieces, order by order of the motor's turning."""
        used = [i for i, piece in enumerate(self.pieces) if piece.use == "used"]
        angles = [self.pieces[i].kept(self.motions[i].angle) for i in used]
        rests = [self.pieces[i].kept(self.pieces[i].measured - fit.predictions[i]) for i in used]
        return scan_orders(angles, rests, self.phases_shared, LOWEST_ORDER, HIGHEST_ORDER)

    def _scanned(self, name: str) -> list[str]:
        """Parameters of an effect that the linear solution does not give."""
        term = self.terms[name]
        if name == SKEW:
            return [term.candidate.amplitude]
        return [term.law.scanned] if term.law.scanned else []

    def _scan(
        self, name: str, effects: tuple[str, ...], shapes: Values, start: EffectsFit | None
    ) -> float:
        """Put the best shape of an effect into ``shapes``; the number of independent trials."""
        scanned = self._scanned(name)
        if not scanned:
            return 1.0
        term, key = self.terms[name], f"{name}.{scanned[0]}"
        trials = 1.0
        if scanned[0] == ORDER:
            without = start or self.fit(tuple(e for e in effects if e != name), None)
            order, step, trials = self.scan_orders(without).best()
            grid: Sequence[float] = (order - step, order, order + step)
        elif name == SKEW:
            grid = SKEW_GRID_S
        else:
            grid = term.law.grid
            trials = 3.0

        def cost(value: float) -> float:
            return self._cost(effects, {**shapes, key: float(value)})

        costs = [cost(value) for value in grid]
        best = int(np.argmin(costs))
        low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
        found = minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": 1e-4 * (high - low)}
        )
        shapes[key] = float(found.x) if found.fun <= costs[best] else float(grid[best])
        return trials

    def _cost(self, effects: tuple[str, ...], shapes: Values) -> float:
        _, residual = self._linear(effects, shapes)
        return float(residual @ residual)

    def _linear(self, effects: tuple[str, ...], shapes: Values) -> tuple[Values, FloatArray]:
        """Linear coefficients by name, and the residual over all used pieces."""
        used = [i for i, piece in enumerate(self.pieces) if piece.use == "used"]
        tables = [dict(self._linear_columns(i, effects, shapes)) for i in used]
        names = list(dict.fromkeys(name for table in tables for name in table))
        pieces = [self.pieces[i] for i in used]
        target = np.concatenate(
            [
                piece.kept(piece.measured - self._base(i, effects, shapes))
                for i, piece in zip(used, pieces, strict=True)
            ]
        )
        if not names:
            return {}, target
        matrix = np.vstack(
            [
                piece.kept(
                    np.column_stack(
                        [table.get(name, np.zeros(piece.measured.size)) for name in names]
                    )
                )
                for table, piece in zip(tables, pieces, strict=True)
            ]
        )
        coefficients = _least_squares(matrix, target)
        residual = target - matrix @ coefficients
        return dict(zip(names, coefficients.tolist(), strict=True)), residual

    def _motion(self, i: int, values: Mapping[str, float]) -> Motion:
        """Motion as the compared channel shows it: a channel that lags shows what was."""
        for key, sign in ((f"{SKEW}.current_s", 1.0), (f"{SKEW}.position_s", -1.0)):
            if values.get(key):
                return self.motions[i].shifted(sign * values[key])
        return self.motions[i]

    def _base(self, i: int, effects: tuple[str, ...], values: Mapping[str, float]) -> FloatArray:
        """The nominal bench, and effects that no coefficient scales, in units of the channel."""
        motion = self._motion(i, values)
        if self.load:
            base = motion.angle / self.bench.value("gear_ratio")
            for name in effects:
                term = self.terms[name]
                if term.law.scanned == term.candidate.amplitude:
                    base = base + term.law.signal(
                        motion, self.bench, _catalogue_parameters(term, values)
                    )
            return base
        bench = self.bench
        if not self.load_angle_known:
            bench = bench.with_parameters(gravity_torque_nm=0.0)
        return np.asarray((required_torque(motion, bench) + self.known[i]) / self.unit)

    def _nuisances(self, i: int, motion: Motion) -> Iterator[tuple[str, FloatArray]]:
        ratio, where = self.bench.value("gear_ratio"), self.pieces[i].name
        if self.load:
            yield f"offset@{where}", np.ones_like(motion.angle)
            return
        for name in self.unknown:
            if name == "motor_inertia_kg_m2":
                yield name, motion.acceleration / self.unit
            elif name == "load_inertia_kg_m2":
                yield name, motion.acceleration / ratio**2 / self.unit
            elif self.load_angle_known:
                yield name, np.sin(motion.angle / ratio) / ratio / self.unit
        if not self.load_angle_known and self.bench.value("gravity_torque_nm") > 0.0:
            yield f"gravity_sine@{where}", np.sin(motion.angle / ratio) / ratio / self.unit
            yield f"gravity_cosine@{where}", np.cos(motion.angle / ratio) / ratio / self.unit

    def _linear_columns(
        self, i: int, effects: tuple[str, ...], shapes: Mapping[str, float]
    ) -> Iterator[tuple[str, FloatArray]]:
        motion = self._motion(i, shapes)
        yield from self._nuisances(i, motion)
        where = "" if self.phases_shared else f"@{self.pieces[i].name}"
        for name in effects:
            term = self.terms[name]
            amplitude = term.candidate.amplitude
            if name == SKEW or term.law.scanned == amplitude:
                continue
            shape = (
                {term.law.scanned: shapes[f"{name}.{term.law.scanned}"]} if term.law.scanned else {}
            )
            off = dict.fromkeys((amplitude, *term.law.linear), 0.0)
            if term.periodic:
                for label, phase in (("sine", 0.0), ("cosine", 0.5 * math.pi)):
                    given = {amplitude: 1.0, PHASE: phase, **shape}
                    column = term.law.signal(motion, self.bench, given)
                    yield f"{name}.{label}{where}", column / self.unit
                continue
            for parameter in off:
                column = term.law.signal(motion, self.bench, {**off, parameter: 1.0, **shape})
                yield f"{name}.{parameter}", column / self.unit

    def _solve(self, effects: tuple[str, ...], shapes: Values) -> tuple[Values, Values]:
        """Values in the catalogue's parameters, and the linear coefficients behind them."""
        linear, _ = self._linear(effects, shapes)
        values: Values = {}
        for name, value in linear.items():
            if ".cosine" in name:
                continue
            if ".sine" not in name:
                values[name] = value
                continue
            effect, _, where = name.partition(".sine")
            cosine = linear[f"{effect}.cosine{where}"]
            values[f"{effect}.{PHASE}{where}"] = math.atan2(cosine, value)
            key = f"{effect}.{self.terms[effect].candidate.amplitude}"
            values.setdefault(key, 0.0)
            values[key] += math.hypot(value, cosine) * self._share(where)
        return {**values, **shapes}, linear

    def _share(self, where: str) -> float:
        """Weight of a recording in an amplitude common to all: its share of the samples."""
        if not where:
            return 1.0
        sizes = {f"@{p.name}": p.measured.size for p in self.pieces if p.use == "used"}
        return sizes[where] / sum(sizes.values())

    def _predict(self, i: int, effects: tuple[str, ...], values: Mapping[str, float]) -> FloatArray:
        """All that is modelled of a piece, in units of its channel."""
        motion = self._motion(i, values)
        prediction = self._base(i, effects, values).copy()
        for name, column in self._nuisances(i, motion):
            prediction += values.get(name, 0.0) * column
        for name in effects:
            term = self.terms[name]
            if name != SKEW and term.law.scanned != term.candidate.amplitude:
                given = _catalogue_parameters(term, values, f"@{self.pieces[i].name}")
                prediction += term.law.signal(motion, self.bench, given) / self.unit
        return prediction

    def _predictions(
        self, effects: tuple[str, ...], values: Values, linear: Mapping[str, float]
    ) -> list[FloatArray]:
        """For every piece; what belongs to a held-out recording alone is fitted on it first."""
        predictions = []
        for i, piece in enumerate(self.pieces):
            own = [
                (name, column)
                for name, column in self._linear_columns(i, effects, values)
                if "@" in name and name not in linear
            ]
            if own:
                shared = {**values, **{name: 0.0 for name, _ in own}}
                for name, _ in own:
                    effect, periodic, where = name.partition(".sine")
                    if periodic:  # away while the phase is looked for
                        shared[f"{effect}.{self.terms[effect].candidate.amplitude}"] = 0.0
                        shared[f"{effect}.{PHASE}{where}"] = 0.0
                rest = piece.measured - self._predict(i, effects, shared)
                columns = np.column_stack([column for _, column in own])
                found = _least_squares(piece.kept(columns), piece.kept(rest))
                fitted = dict(zip((name for name, _ in own), found.tolist(), strict=True))
                for name, value in fitted.items():
                    effect, periodic, where = name.partition(".sine")
                    if periodic:
                        cosine = fitted[f"{effect}.cosine{where}"]
                        values[f"{effect}.{PHASE}{where}"] = math.atan2(cosine, value)
                    elif ".cosine" not in name:
                        values[name] = value
            predictions.append(self._predict(i, effects, values))
        return predictions

    def _is_used(self, name: str) -> bool:
        """Whether a value was fitted on used pieces, and so has a variance."""
        where = name.partition("@")[2]
        return not where or any(p.use == "used" and p.name == where for p in self.pieces)

    def _columns(
        self, i: int, effects: tuple[str, ...], values: Mapping[str, float], names: Sequence[str]
    ) -> FloatArray:
        """∂prediction/∂value by central differences, shape (n, p); exact for the linear ones."""
        columns = []
        for name in names:
            step = self._step(name, values[name])
            up, down = (
                self._predict(i, effects, {**values, name: values[name] + s}) for s in (step, -step)
            )
            columns.append((up - down) / (2.0 * step))
        size = self.pieces[i].measured.size
        return np.column_stack(columns) if columns else np.zeros((size, 0))

    def _step(self, name: str, value: float) -> float:
        effect, _, parameter = name.partition("@")[0].partition(".")
        if parameter == PHASE:
            return 1e-3
        if effect == SKEW:
            return 1e-4
        if parameter and self.terms[effect].law.scanned == parameter:
            return 1e-5 * value if parameter == ORDER else 1e-2 * value
        return max(abs(value), 1e-6)


def _catalogue_parameters(
    term: Term, values: Mapping[str, float], where: str = ""
) -> dict[str, float]:
    """An effect's catalogue parameters out of all values, phases of one recording or of all."""
    start = term.candidate.name + "."
    found = {
        name.removeprefix(start): value
        for name, value in values.items()
        if name.startswith(start) and "@" not in name
    }
    if term.periodic and PHASE not in found and where:
        found[PHASE] = values.get(f"{start}{PHASE}{where}", 0.0)
    return found


def _least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / scale, target, rcond=1e-10)[0] / scale)
