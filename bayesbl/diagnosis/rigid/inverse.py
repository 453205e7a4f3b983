"""Inverse comparison on a rigid bench: measured motion in, what it should have needed out.

    J dω_m/dt + (m g l/N) sin θ_l + effects + known torques = K_t i          (torque, current)
    θ_l = θ_m/N + offset + effects                                          (load position)

Every effect is linear in its amplitude, so a fit is linear least squares around a scan of the few
parameters that are not (orders, fading speeds, a gap, a skew, the speed over which dry friction
changes its sign). All of them are scanned in units of the recordings' own, so that a machine of any
size has the same answer. Nothing is weighted: the fit minimises the RMSE that is reported, and
coloured noise widens its covariance instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from bayesbl.bench.effect_declaration import ORDER, PHASE
from bayesbl.diagnosis.comparison import EffectsFit, TestedEffect
from bayesbl.diagnosis.rigid.compared_columns import WIDTH, Columns, ComparedColumns, Values
from bayesbl.diagnosis.rigid.order_rivals import Line, OrderScan, of_angle
from bayesbl.diagnosis.rigid.order_scan import OrderedRest
from bayesbl.diagnosis.rigid.staying_columns import Staying, least_squares, stacked
from bayesbl.diagnosis.rigid.terms import SKEW, ShapedEffect, ShapedEffects, Term
from bayesbl.recording.types import FloatArray

ROUNDING = 1e-12
"""What two predictions may differ by, as a share of the larger, and still be the same."""
WIDTH_GRID = tuple(np.geomspace(1e-3, 0.3, 13))
"""In RMS speeds: narrower, the samples in between are few; wider, dry friction would be viscous."""

SKEW_GRID = tuple(np.linspace(-0.4, 0.4, 21))
"""In periods of the cut-off: beyond half of one a delay has no sign."""

NO_ORDER = 0.0
"""Where no line of the residual is of the motor's angle."""


@dataclass(frozen=True, slots=True)
class InverseComparison(ComparedColumns):
    """Motion of every piece against what was measured of torque, current or load position.

    ``lines``: those that stand out of what the last fit leaves.
    """

    lines: dict[int, tuple[EffectsFit, list[Line]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def candidates(self) -> tuple[TestedEffect, ...]:
        """All effects that may take part."""
        return tuple(term.candidate for term in self.terms.values())

    def folds(self) -> list[InverseComparison]:
        """The used pieces twice, one half of them to fit on and the other to predict."""
        used = self._used
        names = list(dict.fromkeys(self.pieces[i].name for i in used))
        if len(names) > 1:
            turn = {name: k % 2 for k, name in enumerate(names)}
            return [
                self._of([(i, None, turn[self.pieces[i].name] == first) for i in used])
                for first in (0, 1)
            ]
        halves = [(i, second) for i in used for second in (False, True)]
        return [self._of([(*half, half[1] == first) for half in halves]) for first in (0, 1)]

    def _of(self, chosen: Sequence[tuple[int, bool | None, bool]]) -> InverseComparison:
        """Some pieces, or their first or second halves, and whether each is fitted."""
        pieces, views, seen = [], [], []
        for i, half, is_used in chosen:
            piece, view = self.pieces[i], self.views[i]
            if half is not None:
                piece, view = piece.half(half), view.half(half)
            pieces.append(replace(piece, use="used" if is_used else "held_out"))
            views.append(view)
            seen.append(self.seen[i] if half is None else {})
        return replace(
            self,
            pieces=tuple(pieces),
            motions=tuple(self.motions[i] for i, *_ in chosen),
            known=tuple(self.known[i] for i, *_ in chosen),
            views=tuple(views),
            seen=tuple(seen),
        )

    def fit(self, effects: tuple[str, ...], start: EffectsFit | None = None) -> EffectsFit:
        """Least squares with these effects; shapes that ``start`` holds are kept.

        What has to be scanned is added one by one, beside all that has its shape already.
        """
        known = {} if start is None else start.effects
        trials = {name: start.trials.get(name, 1.0) for name in effects if name in known and start}
        shaped, scanned = ShapedEffects(), []
        for term in (self.terms[name] for name in effects):
            name = term.candidate.name
            if term.scanned is None:
                shaped = shaped.plus(term)
            elif name in known:
                shaped = shaped.plus(term, known[name][term.scanned])
            else:
                scanned.append(term)
        width = None if start is None else start.shared.get(WIDTH)
        if width is not None:
            shaped = replace(shaped, width=width)
        elif self._directional(effects):
            shaped = self._with_width(shaped)
        before = start
        for term in scanned:
            before = before or self._fitted(shaped, trials)
            shaped, tried = self._with_shape(shaped, term, before)
            trials, before = {**trials, term.candidate.name: tried}, None
        if scanned and self._directional(effects):
            shaped = self._with_width(shaped)
        in_order = tuple(shaped.only((name,)).effects[0] for name in effects)
        return self._fitted(replace(shaped, effects=in_order), trials)

    def _fitted(self, shaped: ShapedEffects, trials: Mapping[str, float]) -> EffectsFit:
        """Least squares with shapes as they are."""
        effects, directional = shaped.names, self._directional(shaped.names)
        linear = self._linear(shaped)
        found = {effect.name: self._catalogue(effect, linear) for effect in shaped.effects}
        self._share_amplitudes(found, linear)
        predictions = tuple(
            self._prediction(i, shaped, self._own(i, shaped, linear, found))
            for i in range(len(self.pieces))
        )
        names = self._names(shaped, linear)
        columns = tuple(
            self.pieces[i].kept(self._jacobian(i, shaped, linear, names)) for i in self._used
        )
        bench = {name: self.bench.value(name) + linear[name] for name in self.unknown}
        edges = frozenset(
            effect.name
            for effect in shaped.effects
            if self._at_edge(effect, shaped) or self._is_rather_a_torque(effect.term, shaped)
        )
        tried = {name: trials.get(name, 1.0) for name in effects}
        shared = {WIDTH: shaped.width} if directional else {}
        besides = {name: value for name, value in linear.items() if "." not in name.split("@")[0]}
        return EffectsFit(found, bench, predictions, columns, names, tried, edges, shared, besides)

    def scan_orders(self, fit: EffectsFit) -> OrderScan:
        """Residuals of a fit on the used pieces, order by order of the motor's turning."""
        rests = [
            OrderedRest(
                piece.name,
                piece.kept(piece.time_s),
                piece.kept(motion.angle[view.rows]),
                piece.kept(np.abs(motion.speed[view.rows])),
                piece.kept(piece.measured - fit.predictions[i]),
                view.low_pass.cutoff_hz,
                view.above,
                view.low_pass.period_s,
                view.step_rad,
            )
            for i, piece, motion, view in zip(
                range(len(self.pieces)), self.pieces, self.motions, self.views, strict=True
            )
            if piece.use == "used"
        ]
        return OrderScan(tuple(rests), self.phases_shared)

    # Shapes

    def _grid(self, term: Term) -> tuple[float, ...]:
        """Values of a term's shape to try, in its own unit."""
        if term.candidate.name == SKEW:
            period = 1.0 / self.views[0].low_pass.cutoff_hz
            return tuple(period * share for share in SKEW_GRID)
        law = term.law
        unit = self.speed_rad_per_s if law.grid_unit == "speed" else self._travel_rad
        return tuple(unit * share for share in law.grid)

    @property
    def speed_rad_per_s(self) -> float:
        """RMS speed of the motor over what is fitted."""
        speeds = np.concatenate(
            [
                self.pieces[i].kept(self.motions[i].speed[self.views[i].rows])
                for i in self._used
                if not self.views[i].above
            ]
        )
        return math.sqrt(float(np.mean(speeds**2)))

    @property
    def _travel_rad(self) -> float:
        """Way of the load over what is fitted."""
        angles = [self.motions[i].angle for i in self._used]
        way = max(float(np.ptp(angle)) for angle in angles)
        return way / self.bench.value("gear_ratio")

    @property
    def _period_s(self) -> float:
        """Sampling period of the recordings."""
        times = self.motions[0].time_s
        return float(times[-1] - times[0]) / (times.size - 1)

    def _at_edge(self, effect: ShapedEffect, shaped: ShapedEffects) -> bool:
        """Whether the scan of an effect's shape ended where it ends or shows nothing."""
        widest = 0.99 * WIDTH_GRID[-1] * self.speed_rad_per_s
        if effect.term.has_direction and shaped.width > widest:
            return True
        if effect.value is None:
            return False
        if effect.name == SKEW and abs(effect.value) < 0.5 * self._period_s:
            return True  # so far apart are samples and what a controller holds between them
        if ORDER in effect.shape:
            return effect.value == NO_ORDER
        grid = self._grid(effect.term)
        near = 1e-2 * (grid[1] - grid[0])
        inside = grid[0] + near < effect.value < grid[-1] - near
        return not inside or self._extrapolates(effect, shaped)

    def _extrapolates(self, effect: ShapedEffect, shaped: ShapedEffects) -> bool:
        """Whether no sample shows half of an effect's size: it would be an extrapolation."""
        term = effect.term
        if effect.name == SKEW or self.load or term.periodic:
            return False
        one = {term.candidate.amplitude: 1.0, **effect.shape}
        largest = 0.0
        for i in self._used:
            signal = term.law.signal(self._motion(i, shaped), self.bench, one)
            window = self.views[i].window
            largest = max(
                largest, float(np.abs(signal if window is None else window * signal).max())
            )
        return largest < 0.5

    def _is_rather_a_torque(self, term: Term, shaped: ShapedEffects) -> bool:
        """Whether what an error of the encoder makes is explained better by a torque that turns.

        The one grows with the square of the speed, the other is the same at all. A ripple may be
        named already, of another order: then nothing else would speak for the torque.
        """
        if self.load or not term.periodic or term.law.scanned is not None:
            return False
        others = shaped.only({*shaped.names} - {term.candidate.name})
        left = []
        for held, turning in ((shaped, False), (others, True)):
            tables = [
                {
                    **self._kept_columns(i, held),
                    **(self._kept_turning(i, shaped) if turning else {}),
                }
                for i in self._used
            ]
            rests = [self._rest(i, held) for i in self._used]
            along = Staying([{} for _ in tables])
            explained = along.explained(tables, rests, along.along(rests))
            left.append(sum(float(rest @ rest) for rest in rests) - explained)
        return left[1] <= left[0]

    def _kept_turning(self, i: int, shaped: ShapedEffects) -> Columns:
        """Sine and cosine of the motor's angle, with one phase for whatever shares it."""
        where = "" if self.phases_shared else f"@{self.pieces[i].name}"
        waves = replace(self, waves=(1.0,))._allowed_for(i, shaped)
        return {
            f"turning {k}{where}": self.pieces[i].kept(wave)
            for k, wave in enumerate(waves.values())
        }

    def _with_width(self, shaped: ShapedEffects) -> ShapedEffects:
        """With the width of least squares."""
        unit = self.speed_rad_per_s
        moving = [effect.name for effect in shaped.effects if effect.term.has_direction]
        return self._best(
            [unit * share for share in WIDTH_GRID], lambda x: replace(shaped, width=x), moving
        )

    def _with_shape(
        self, shaped: ShapedEffects, term: Term, before: EffectsFit
    ) -> tuple[ShapedEffects, float]:
        """With an effect in its best shape; the number of independent trials.

        ``before``: a fit without it.
        """
        grid: Sequence[float] = self._grid(term)
        trials, comparison, moving = 3.0, self, [term.candidate.name]
        if term.scanned == ORDER:
            line = of_angle(self._clearest(before))
            if line is None:
                return shaped.plus(term, NO_ORDER), trials
            step, trials = self.scan_orders(before).step, line.trials
            grid = (line.order - step, line.order, line.order + step)
        elif term.candidate.name == SKEW:
            moving = [*shaped.names, *moving]
            if not self.load:
                # A ripple of a motor that yields to it is in the torque and in the motion out of
                # step: without it a delay would take its place.
                orders = tuple(line.order for line in self._clearest(before))
                comparison = replace(self, waves=orders)
        return comparison._best(grid, lambda x: shaped.plus(term, x), moving), trials

    def _clearest(self, fit: EffectsFit) -> list[Line]:
        """Lines that stand out of what a fit leaves; those of the last fit are kept."""
        if id(fit) not in self.lines:
            self.lines.clear()
            self.lines[id(fit)] = fit, self.scan_orders(fit).clearest()
        return self.lines[id(fit)][1]

    def _best(
        self,
        grid: Sequence[float],
        shaped: Callable[[float], ShapedEffects],
        moving: Collection[str],
    ) -> ShapedEffects:
        """Of least squares over a value: a grid, then a search around its best.

        ``moving``: effects whose columns change with the value. Where those are all, what else is
        fitted moves too.
        """
        cost = self._cost(shaped, shaped(grid[0]), moving)
        costs = [cost(value) for value in grid]
        best = int(np.argmin(costs))
        low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
        found = minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * (high - low)}
        )
        return shaped(float(found.x) if found.fun <= costs[best] else float(grid[best]))

    # Least squares

    def _cost(
        self,
        shaped: Callable[[float], ShapedEffects],
        one: ShapedEffects,
        moving: Collection[str],
    ) -> Callable[[float], float]:
        """Sum of squares of the fit over a value; what does not depend on it is fitted once."""
        used = self._used
        stay: list[Columns] = [{} for _ in used]
        if SKEW not in moving:
            held = {*one.names} - {*moving}
            stay = [self._kept_columns(i, one, held) for i in used]
        staying = Staying(stay)

        def cost(value: float) -> float:
            tried = shaped(value)
            rests = [self._rest(i, tried) for i in used]
            along = staying.along(rests)
            tables = [
                {n: c for n, c in self._kept_columns(i, tried, moving).items() if n not in table}
                for i, table in zip(used, stay, strict=True)
            ]
            left = sum(float(rest @ rest) for rest in rests) - float(along @ along)
            return left - staying.explained(tables, rests, along)

        return cost

    def _rest(self, i: int, shaped: ShapedEffects) -> FloatArray:
        """What the bench leaves of a piece, at the samples that count, shape (k,)."""
        piece = self.pieces[i]
        return piece.kept(piece.measured - self._base(i, shaped))

    def _kept_columns(
        self, i: int, shaped: ShapedEffects, names: Collection[str] | None = None
    ) -> Columns:
        """Columns at the samples that count, of all effects or of some."""
        columns = self._columns(i, shaped, names)
        return {name: self.pieces[i].kept(column) for name, column in columns.items()}

    def _linear(self, shaped: ShapedEffects) -> Values:
        """Linear coefficients by name, fitted on all used pieces."""
        used = self._used
        tables = [self._kept_columns(i, shaped) for i in used]
        names = list(dict.fromkeys(name for table in tables for name in table))
        if not names:
            return {}
        # A piece of which nothing is modelled says nothing of the coefficients.
        chosen = [(i, table) for i, table in zip(used, tables, strict=True) if table]
        matrix = np.vstack([stacked(table, names) for _, table in chosen])
        rest = np.concatenate([self._rest(i, shaped) for i, _ in chosen])
        return dict(zip(names, least_squares(matrix, rest).tolist(), strict=True))

    def _prediction(self, i: int, shaped: ShapedEffects, linear: Mapping[str, float]) -> FloatArray:
        """All that is modelled of a piece, in units of its channel."""
        prediction = self._base(i, shaped).copy()
        for name, column in self._columns(i, shaped).items():
            prediction += linear[name] * column
        return prediction

    def _own(
        self,
        i: int,
        shaped: ShapedEffects,
        linear: Values,
        found: Mapping[str, Mapping[str, float]],
    ) -> Values:
        """Coefficients of a piece; what belongs to a held-out recording alone is fitted on it."""
        columns = self._columns(i, shaped)
        own = [name for name in columns if name not in linear]
        if not own:
            return linear
        piece = self.pieces[i]
        rest = piece.measured - self._base(i, shaped)
        for name, column in columns.items():
            if name in linear:
                rest = rest - linear[name] * column
        matrix = np.column_stack([columns[name] for name in own])
        fitted = least_squares(piece.kept(matrix), piece.kept(rest)).tolist()
        complete = {**linear, **dict(zip(own, fitted, strict=True))}
        self._share_amplitudes(found, complete)
        return complete

    def _share_amplitudes(self, found: Mapping[str, Mapping[str, float]], linear: Values) -> None:
        """Waves with a phase for each recording have one amplitude."""
        for name, parameters in found.items():
            amplitude = abs(parameters[self.terms[name].candidate.amplitude])
            for sine in [key for key in linear if key.startswith(f"{name}.sine@")]:
                cosine = sine.replace(".sine@", ".cosine@")
                size = math.hypot(linear[sine], linear[cosine])
                if size > 0.0:
                    linear[sine] *= amplitude / size
                    linear[cosine] *= amplitude / size

    def _catalogue(self, effect: ShapedEffect, linear: Values) -> Values:
        """An effect's parameters as the catalogue has them; phases of all recordings or none."""
        name, term, start = effect.name, effect.term, f"{effect.name}."
        parameters = effect.shape
        if not term.periodic:
            own = {k.removeprefix(start): v for k, v in linear.items() if k.startswith(start)}
            return parameters | own
        amplitude = 0.0
        for sine in [key for key in linear if key.startswith(f"{name}.sine")]:
            cosine = linear[sine.replace(".sine", ".cosine")]
            where = sine.partition(".sine")[2]
            amplitude += math.hypot(linear[sine], cosine) * self._share(where)
            if not where:
                parameters[PHASE] = math.atan2(cosine, linear[sine])
        return {term.candidate.amplitude: amplitude, **parameters}

    def _share(self, where: str) -> float:
        """Weight of a recording in an amplitude common to all: its share of the samples."""
        if not where:
            return 1.0
        sizes: Values = {}
        for i in self._used:
            key = f"@{self.pieces[i].name}"
            sizes[key] = sizes.get(key, 0.0) + self.pieces[i].measured.size
        return sizes[where] / sum(sizes.values())

    # Derivatives

    def _names(self, shaped: ShapedEffects, linear: Values) -> tuple[str, ...]:
        """Everything fitted, sines and cosines as one amplitude and phases."""
        names: list[str] = []
        for name in linear:
            effect, sine, where = name.partition(".sine")
            if sine:
                names += [f"{effect}.{self.terms[effect].candidate.amplitude}"]
                names += [f"{effect}.{PHASE}{where}"]
            elif ".cosine" not in name:
                names.append(name)
        names += [*shaped.values, *([WIDTH] if self._directional(shaped.names) else [])]
        return tuple(dict.fromkeys(names))

    def _jacobian(
        self,
        i: int,
        shaped: ShapedEffects,
        linear: Values,
        names: Sequence[str],
    ) -> FloatArray:
        """∂prediction/∂value, shape (n, p): columns, and differences for what is scanned."""
        columns, around = self._columns(i, shaped), _around(shaped)
        nothing = np.zeros(self.pieces[i].measured.size)
        made = []
        for name in names:
            if name in around:
                value, moved = around[name]
                step = self._step(name, value)
                up, down = (self._prediction(i, moved(value + s), linear) for s in (step, -step))
                # What is rounding alone must be no column: scaled, it would blur the others.
                is_seen = np.abs(up - down).max() > ROUNDING * np.abs(up).max()
                made.append((up - down) / (2.0 * step) if is_seen else nothing)
                continue
            effect, _, parameter = name.partition("@")[0].partition(".")
            waves = [k for k in columns if k.startswith(f"{effect}.sine")] if parameter else []
            if not waves:
                made.append(columns.get(name, nothing))
                continue
            (wave,) = waves
            where = wave.partition(".sine")[2]
            sine, cosine = columns[wave], columns[f"{effect}.cosine{where}"]
            a, b = linear[wave], linear[f"{effect}.cosine{where}"]
            size = math.hypot(a, b) or 1.0
            if parameter != PHASE:
                made.append((a * sine + b * cosine) / size)
            elif name.partition("@")[1] and f"@{name.partition('@')[2]}" != where:
                made.append(nothing)
            else:
                made.append(a * cosine - b * sine)
        return np.column_stack(made) if made else np.zeros((nothing.size, 0))

    def _step(self, name: str, value: float) -> float:
        effect, _, parameter = name.partition(".")
        if effect == SKEW:
            return 1e-3 / self.views[0].low_pass.cutoff_hz
        return 1e-5 * value if parameter == ORDER else 1e-2 * value


def _around(shaped: ShapedEffects) -> dict[str, tuple[float, Callable[[float], ShapedEffects]]]:
    """Everything scanned by name: its value, and the effects with another."""

    def moved(effect: ShapedEffect) -> Callable[[float], ShapedEffects]:
        return lambda value: shaped.plus(effect.term, value)

    scanned = [(e, key, value) for e in shaped.effects for key, value in e.shape.items()]
    return {
        WIDTH: (shaped.width, lambda value: replace(shaped, width=value)),
        **{f"{e.name}.{key}": (value, moved(e)) for e, key, value in scanned},
    }
