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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from bayesbl.bench.effect_declaration import ORDER, PHASE
from bayesbl.bench.effects import effect_named
from bayesbl.diagnosis.comparison import EffectsFit, TestedEffect
from bayesbl.diagnosis.rigid.compared_columns import WIDTH, Columns, ComparedColumns, Values
from bayesbl.diagnosis.rigid.order_rivals import Line, OrderScan, of_angle
from bayesbl.diagnosis.rigid.order_scan import OrderedRest
from bayesbl.diagnosis.rigid.staying_columns import Staying, least_squares, stacked
from bayesbl.diagnosis.rigid.terms import SKEW
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
        """Least squares with these effects; shapes that ``start`` holds are kept."""
        shapes: Values = dict(start.shared) if start is not None else {}
        trials: dict[str, float] = {}
        fresh = [name for name in effects if start is None or name not in start.effects]
        for name in effects:
            if start is not None and name in start.effects:
                shapes |= {
                    f"{name}.{shape}": start.effects[name][shape] for shape in self._scanned(name)
                }
                trials[name] = start.trials.get(name, 1.0)
        directional = self._directional(effects)
        if directional and WIDTH not in shapes:
            plain = tuple(e for e in effects if e not in fresh or not self._scanned(e))
            self._scan_width(plain, shapes)
        for name in fresh:
            trials[name] = self._scan(name, effects, shapes, start)
        if directional and any(self._scanned(name) for name in fresh):
            self._scan_width(effects, shapes)
        linear = self._linear(effects, shapes)
        found = {name: self._catalogue(name, linear, shapes) for name in effects}
        self._share_amplitudes(found, linear)
        predictions = tuple(
            self._prediction(i, effects, shapes, self._own(i, effects, shapes, linear, found))
            for i in range(len(self.pieces))
        )
        names = self._names(effects, shapes, linear)
        columns = tuple(
            self.pieces[i].kept(self._jacobian(i, effects, shapes, linear, names))
            for i in self._used
        )
        bench = {name: self.bench.value(name) + linear[name] for name in self.unknown}
        edges = frozenset(
            name
            for name in effects
            if self._at_edge(name, shapes) or self._is_rather_a_torque(name, effects, shapes)
        )
        shared = {WIDTH: shapes[WIDTH]} if directional else {}
        besides = {name: value for name, value in linear.items() if "." not in name.split("@")[0]}
        return EffectsFit(found, bench, predictions, columns, names, trials, edges, shared, besides)

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

    def _grid(self, name: str) -> tuple[float, ...]:
        """Values of an effect's shape to try, in its own unit."""
        if name == SKEW:
            period = 1.0 / self.views[0].low_pass.cutoff_hz
            return tuple(period * share for share in SKEW_GRID)
        law = self.terms[name].law
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

    def _at_edge(self, name: str, shapes: Values) -> bool:
        """Whether the scan of an effect's shape ended where it ends or shows nothing."""
        widest = 0.99 * WIDTH_GRID[-1] * self.speed_rad_per_s
        if "direction" in effect_named(name).depends_on and shapes.get(WIDTH, 0.0) > widest:
            return True
        scanned = self._scanned(name)
        if not scanned:
            return False
        value = shapes[f"{name}.{scanned[0]}"]
        if name == SKEW and abs(value) < 0.5 * self._period_s:
            return True  # so far apart are samples and what a controller holds between them
        if scanned[0] == ORDER:
            return value == NO_ORDER
        grid = self._grid(name)
        near = 1e-2 * (grid[1] - grid[0])
        return not grid[0] + near < value < grid[-1] - near or self._extrapolates(name, shapes)

    def _extrapolates(self, name: str, shapes: Values) -> bool:
        """Whether no sample shows half of an effect's size: it would be an extrapolation."""
        term = self.terms[name]
        if name == SKEW or self.load or term.periodic or term.law.scanned is None:
            return False
        given = {
            term.candidate.amplitude: 1.0,
            term.law.scanned: shapes[f"{name}.{term.law.scanned}"],
        }
        largest = 0.0
        for i in self._used:
            signal = term.law.signal(self._motion(i, shapes), self.bench, given)
            window = self.views[i].window
            largest = max(
                largest, float(np.abs(signal if window is None else window * signal).max())
            )
        return largest < 0.5

    def _is_rather_a_torque(self, name: str, effects: tuple[str, ...], shapes: Values) -> bool:
        """Whether what an error of the encoder makes is explained better by a torque that turns.

        The one grows with the square of the speed, the other is the same at all. A ripple may be
        named already, of another order: then nothing else would speak for the torque.
        """
        term = self.terms[name]
        if self.load or not term.periodic or term.law.scanned is not None:
            return False
        others = tuple(e for e in effects if e != name)
        left = []
        for held, turning in ((effects, False), (others, True)):
            tables = [
                {
                    **self._kept_columns(i, held, shapes),
                    **(self._kept_turning(i, shapes) if turning else {}),
                }
                for i in self._used
            ]
            rests = [self._rest(i, held, shapes) for i in self._used]
            along = Staying([{} for _ in tables])
            explained = along.explained(tables, rests, along.along(rests))
            left.append(sum(float(rest @ rest) for rest in rests) - explained)
        return left[1] <= left[0]

    def _kept_turning(self, i: int, shapes: Values) -> Columns:
        """Sine and cosine of the motor's angle, with one phase for whatever shares it."""
        where = "" if self.phases_shared else f"@{self.pieces[i].name}"
        waves = replace(self, waves=(1.0,))._allowed_for(i, shapes)
        return {
            f"turning {k}{where}": self.pieces[i].kept(wave)
            for k, wave in enumerate(waves.values())
        }

    def _scan_width(self, effects: tuple[str, ...], shapes: Values) -> None:
        unit = self.speed_rad_per_s
        self._search(WIDTH, [unit * share for share in WIDTH_GRID], effects, shapes)

    def _scan(
        self, name: str, effects: tuple[str, ...], shapes: Values, start: EffectsFit | None
    ) -> float:
        """Put the best shape of an effect into ``shapes``; the number of independent trials."""
        scanned = self._scanned(name)
        if not scanned:
            return 1.0
        key, trials = f"{name}.{scanned[0]}", 3.0
        if scanned[0] == ORDER:
            without = start or self.fit(tuple(e for e in effects if e != name), None)
            line = of_angle(self._clearest(without))
            if line is None:
                shapes[key] = NO_ORDER
                return trials
            step = self.scan_orders(without).step
            grid = (line.order - step, line.order, line.order + step)
            self._search(key, grid, effects, shapes)
            trials = line.trials
        elif name == SKEW and not self.load:
            # A ripple of a motor that yields to it is in the torque and in the motion out of step:
            # without it a delay would take its place.
            without = start or self.fit(tuple(e for e in effects if e != name), None)
            orders = tuple(line.order for line in self._clearest(without))
            replace(self, waves=orders)._search(key, self._grid(name), effects, shapes)
        else:
            self._search(key, self._grid(name), effects, shapes)
        return trials

    def _clearest(self, fit: EffectsFit) -> list[Line]:
        """Lines that stand out of what a fit leaves; those of the last fit are kept."""
        if id(fit) not in self.lines:
            self.lines.clear()
            self.lines[id(fit)] = fit, self.scan_orders(fit).clearest()
        return self.lines[id(fit)][1]

    def _search(
        self, key: str, grid: Sequence[float], effects: tuple[str, ...], shapes: Values
    ) -> None:
        """Put the value of least squares into ``shapes``: a grid, then a search around its best."""
        cost = self._cost(key, effects, shapes)
        costs = [cost(value) for value in grid]
        best = int(np.argmin(costs))
        low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
        found = minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * (high - low)}
        )
        shapes[key] = float(found.x) if found.fun <= costs[best] else float(grid[best])

    # Least squares

    def _cost(self, key: str, effects: tuple[str, ...], shapes: Values) -> Callable[[float], float]:
        """Sum of squares of the fit over a shape; what does not depend on it is fitted once."""
        used, all_move = self._used, key.startswith(SKEW)
        moving = tuple(e for e in effects if all_move or self._depends(e, key))
        others = tuple(e for e in effects if e not in moving)
        stay: list[Columns] = [{} for _ in used]
        if not all_move:
            stay = [self._kept_columns(i, others, shapes) for i in used]
        staying = Staying(stay)

        def cost(value: float) -> float:
            tried = {**shapes, key: value}
            rests = [self._rest(i, effects, tried) for i in used]
            along = staying.along(rests)
            tables = [
                {n: c for n, c in self._kept_columns(i, moving, tried).items() if n not in table}
                for i, table in zip(used, stay, strict=True)
            ]
            left = sum(float(rest @ rest) for rest in rests) - float(along @ along)
            return left - staying.explained(tables, rests, along)

        return cost

    def _depends(self, name: str, key: str) -> bool:
        """Whether an effect's columns change with a shape."""
        if key == WIDTH:
            return "direction" in effect_named(name).depends_on
        return key.startswith(f"{name}.")

    def _rest(self, i: int, effects: tuple[str, ...], shapes: Values) -> FloatArray:
        """What the bench leaves of a piece, at the samples that count, shape (k,)."""
        piece = self.pieces[i]
        return piece.kept(piece.measured - self._base(i, effects, shapes))

    def _kept_columns(self, i: int, effects: tuple[str, ...], shapes: Values) -> Columns:
        columns = self._columns(i, effects, shapes)
        return {name: self.pieces[i].kept(column) for name, column in columns.items()}

    def _linear(self, effects: tuple[str, ...], shapes: Values) -> Values:
        """Linear coefficients by name, fitted on all used pieces."""
        used = self._used
        tables = [self._kept_columns(i, effects, shapes) for i in used]
        names = list(dict.fromkeys(name for table in tables for name in table))
        if not names:
            return {}
        # A piece of which nothing is modelled says nothing of the coefficients.
        chosen = [(i, table) for i, table in zip(used, tables, strict=True) if table]
        matrix = np.vstack([stacked(table, names) for _, table in chosen])
        rest = np.concatenate([self._rest(i, effects, shapes) for i, _ in chosen])
        return dict(zip(names, least_squares(matrix, rest).tolist(), strict=True))

    def _prediction(
        self,
        i: int,
        effects: tuple[str, ...],
        shapes: Mapping[str, float],
        linear: Mapping[str, float],
    ) -> FloatArray:
        """All that is modelled of a piece, in units of its channel."""
        prediction = self._base(i, effects, shapes).copy()
        for name, column in self._columns(i, effects, shapes).items():
            prediction += linear[name] * column
        return prediction

    def _own(
        self,
        i: int,
        effects: tuple[str, ...],
        shapes: Values,
        linear: Values,
        found: Mapping[str, Mapping[str, float]],
    ) -> Values:
        """Coefficients of a piece; what belongs to a held-out recording alone is fitted on it."""
        columns = self._columns(i, effects, shapes)
        own = [name for name in columns if name not in linear]
        if not own:
            return linear
        piece = self.pieces[i]
        rest = piece.measured - self._base(i, effects, shapes)
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

    def _catalogue(self, name: str, linear: Values, shapes: Values) -> Values:
        """An effect's parameters as the catalogue has them; phases of all recordings or none."""
        term, start = self.terms[name], f"{name}."
        given = {k.removeprefix(start): v for k, v in shapes.items() if k.startswith(start)}
        if not term.periodic:
            given |= {k.removeprefix(start): v for k, v in linear.items() if k.startswith(start)}
            return given
        amplitude = 0.0
        for sine in [key for key in linear if key.startswith(f"{name}.sine")]:
            cosine = linear[sine.replace(".sine", ".cosine")]
            where = sine.partition(".sine")[2]
            amplitude += math.hypot(linear[sine], cosine) * self._share(where)
            if not where:
                given[PHASE] = math.atan2(cosine, linear[sine])
        return {term.candidate.amplitude: amplitude, **given}

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

    def _names(self, effects: tuple[str, ...], shapes: Values, linear: Values) -> tuple[str, ...]:
        """Everything fitted, sines and cosines as one amplitude and phases."""
        names: list[str] = []
        for name in linear:
            effect, sine, where = name.partition(".sine")
            if sine:
                names += [f"{effect}.{self.terms[effect].candidate.amplitude}"]
                names += [f"{effect}.{PHASE}{where}"]
            elif ".cosine" not in name:
                names.append(name)
        names += [key for key in shapes if key != WIDTH or self._directional(effects)]
        return tuple(dict.fromkeys(names))

    def _jacobian(
        self,
        i: int,
        effects: tuple[str, ...],
        shapes: Values,
        linear: Values,
        names: Sequence[str],
    ) -> FloatArray:
        """∂prediction/∂value, shape (n, p): columns, and differences for what is scanned."""
        columns = self._columns(i, effects, shapes)
        nothing = np.zeros(self.pieces[i].measured.size)
        made = []
        for name in names:
            if name in shapes:
                step = self._step(name, shapes[name])
                up, down = (
                    self._prediction(i, effects, {**shapes, name: shapes[name] + s}, linear)
                    for s in (step, -step)
                )
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
