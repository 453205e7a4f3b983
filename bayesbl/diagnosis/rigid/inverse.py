"""Inverse view of a rigid bench: measured motion in, what it should have needed out.

    J dω_m/dt + (m g l/N) sin θ_l + effects + known torques = K_t i

Effects take part by the laws that their modules under ``bench/effects`` declare. A rigid drive has
no shaft, and lags inside the loop do not enter, since the recorded current is the one that flows
and the motion the one that happened.

All is linear in its amplitudes but a skew between the channels and the width of dry friction's
sign, which move every column: the width is sought first, the skew linearised around. Shapes
(orders, fading speeds, gaps) are alternatives on grids, made finer around those that suit, in units
of the recordings' own, so that a machine of any size has the same answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.effect_declaration import ORDER, PHASE, RigidLaw, direction
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import LEARNED_HARMONICS
from bayesbl.bench.learned import Variable, variable_of
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.disagreement import Use
from bayesbl.diagnosis.inference import (
    AffineModel,
    Candidate,
    Discrepancy,
    Inference,
    Look,
    Piece,
    Rows,
    Series,
    candidate_of,
)
from bayesbl.diagnosis.rigid.motion import (
    END_PERIODS,
    WIDEST,
    LowPass,
    Motion,
    Window,
    inside,
    motion_of,
    noise_of,
    reach,
    sharper,
    standstill,
    step_of,
    thinned,
    turns_of,
)
from bayesbl.diagnosis.rigid.orders import FEWEST_CYCLES, FEWEST_SAMPLES, Line, OrderedRest, peaks
from bayesbl.diagnosis.task import (
    GRAVITY,
    INERTIAS,
    USES_OF,
    Comparison,
    Task,
    believed_sds,
    by_search,
    compared_channel,
    even_recordings,
    notes_of,
    parts_of,
    require_enough,
    require_rigid,
    unknown_parameters,
    wanted,
)
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.model_search.constants import NAMED_AT
from bayesbl.model_search.linear import least_squares
from bayesbl.noise.rotation_noise import HIGHEST_ORDER
from bayesbl.recording.repairs import widened
from bayesbl.recording.types import (
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    FloatArray,
    Recording,
)

SKEW = "channel_time_skew"
TORQUE_CONSTANT = "torque_constant_nm_per_a"


TORQUE_LAWS: Mapping[str, RigidLaw] = MappingProxyType(
    {effect.name: effect.torque for effect in EFFECTS if effect.torque is not None}
)
"""Of effects in the torque at the motor, N m."""


def without_load_angle(laws: Mapping[str, RigidLaw]) -> dict[str, RigidLaw]:
    """The laws that do not ask where the load hangs."""
    return {n: law for n, law in laws.items() if "load_angle" not in effect_named(n).depends_on}


def within_turns(laws: Mapping[str, RigidLaw], turns: float) -> dict[str, RigidLaw]:
    """The laws without those that repeat once a turn of the motor, and so too rarely."""
    return {
        name: law
        for name, law in laws.items()
        if not effect_named(name).is_periodic or law.scanned == ORDER or turns >= FEWEST_CYCLES
    }


def uncomputable(laws: Mapping[str, RigidLaw], bench: Bench, load_angle_known: bool) -> list[str]:
    """Names of laws for which the angles do not give enough, sorted.

    Without the load's angle gravity is unknown, and with it the torque that the gear passes on.
    """
    if load_angle_known or bench.value("gravity_torque_nm") <= 0.0:
        return []
    return sorted(n for n in laws if "transmitted_torque" in effect_named(n).depends_on)


def required_torque(motion: Motion, bench: Bench) -> FloatArray:
    """Torque that this motion asks of the motor, effects of the bench included, N m.

    (J_m + J_l/N²) dω_m/dt + (m g l/N) sin(θ_m/N) and the losses. What a rigid drive cannot show
    (shaft, loop lags) is left out; a skew is the comparison's business.
    """
    torque = bench.value("motor_inertia_kg_m2") * motion.acceleration
    torque = torque + bench.transmitted_torque(motion)
    for present in bench.effects:
        effect = effect_named(present.name)
        if effect.torque is not None and effect.load_torque is None:
            torque = torque + effect.torque.signal(motion, bench, present.complete())
    if bench.learned_torque is not None:
        torque = torque + bench.learned_torque.along(motion, bench.value("gear_ratio"))
    return np.asarray(torque)


WIDTH_GRID = tuple(np.geomspace(1e-3, 0.3, 13))
"""In RMS speeds: narrower, the samples in between are few; wider, dry friction would be viscous."""

DELAY = 4.0
"""Usual skew, in sampling periods."""

QUIET = 0.5
"""Of the torque's noise: so much in the motion makes a standard deviation an eighth too small."""

MOST_ORDERS, MOST_LINES = 8, 4
"""Lines that are tried, of the motor's angle and of time: the strongest."""

FINER = 5
"""Shapes tried between the neighbours of one that suits."""

DRIFT_ORDERS = 6
"""Cosines over the time of a recording: slower than friction that warms up in it."""

LINE = 0.3
"""Usual share of a line in time."""

TURNS = 1.0
"""Way of the load, rad, from which gravity's direction turns: on a shorter one it is an offset and
a spring."""

WRONG_VALUE = 0.3
"""Usual share of a wrong value of the data sheet in what is compared."""


@dataclass(frozen=True, slots=True)
class Compared:
    """A piece; over its whole recording its motion and what is known of the torque at the motor,
    N m, (n,); and what is compared of a signal over that."""

    piece: Piece
    motion: Motion
    known: FloatArray
    window: Window

    def along(self, signal: FloatArray) -> FloatArray:
        """A signal over the recording, (n,), at the samples that count, (k,)."""
        return self.piece.kept(signal[self.window.rows])


@dataclass(frozen=True)
class InverseView:
    """Motion of every piece against what was measured of torque or current.

    Attributes
    ----------
    laws
        Of the effects that may take part.
    unknown
        Bench parameters that are fitted: inertias and the gravity torque.
    load_angle_known, phases_shared
        The motor position tells the load's angle, so gravity's direction; it is absolute, so one
        phase holds for all recordings. Without either, sine and cosine are free per recording.
    skew_s, width
        Around which all is linear: lag of the current or position, s; of dry friction, rad/s.
    slope
        Change of the prediction by one second of skew, in the channel's unit, (N,).
    shapes
        Of effects with a shape, values tried in place of the grid over all there may be.
    orders, lines
        Of the motor's turning, and frequencies in Hz.
    columns_bench, discrepancy, cache
        The bench as fitted, that columns are made of; what nothing explains, as it is known so far,
        (N,); signals that were computed.
    """

    parts: tuple[Compared, ...]
    bench: Bench
    laws: Mapping[str, RigidLaw]
    unknown: tuple[str, ...] = ()
    load_angle_known: bool = False
    phases_shared: bool = False
    skew_s: float = 0.0
    width: float = 0.0
    slope: FloatArray | None = None
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    orders: tuple[Line, ...] = ()
    lines: tuple[Line, ...] = ()
    columns_bench: Bench | None = None
    discrepancy: FloatArray | float = 0.0
    cache: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    # Signals

    @cached_property
    def rows(self) -> Rows:
        """Of the pieces without their motion."""
        return Rows(tuple(part.piece for part in self.parts))

    @cached_property
    def unit(self) -> float:
        """N m in one unit of the channel: K_t where current is compared."""
        current = self.rows.pieces[0].channel == MOTOR_CURRENT
        return self.bench.value(TORQUE_CONSTANT) if current else 1.0

    @cached_property
    def gravity_free(self) -> bool:
        """Whether gravity's size and direction are fitted in each recording."""
        return not self.load_angle_known and self.bench.value(GRAVITY) > 0.0

    @cached_property
    def _ripple(self) -> str | None:
        """The effect of any order of the motor."""
        return next((name for name, law in self.laws.items() if law.scanned == ORDER), None)

    @cached_property
    def used(self) -> list[Compared]:
        """Parts that are fitted."""
        return [part for part in self.parts if part.piece.use == "used"]

    @cached_property
    def _moved(self) -> list[Motion]:
        """Motion as the compared channel shows it: a channel that lags shows what was."""
        key = ("motions", self.skew_s)
        if key not in self.cache:
            every = (part.motion for part in self.parts)
            self.cache[key] = [m.shifted(self.skew_s) if self.skew_s else m for m in every]
        return [replace(m, friction_width=self.width) for m in self.cache[key]]

    def _seen(
        self,
        key: Hashable,
        make: Callable[[int, Motion], FloatArray],
        *,
        width: float = 0.0,
        above: bool = False,
    ) -> FloatArray:
        """A signal along the motion, or columns, as compared, (N, …); computed once.

        Zero above the cut-off, where little but waves is known, unless ``above``.
        """

        def of_piece(i: int) -> FloatArray:
            part, made = self.parts[i], make(i, self._moved[i])
            if part.window.above and not above:
                return np.zeros((part.piece.measured.size, *made.shape[1:]))
            return part.window(made)

        whole = (key, self.skew_s, width)
        if whole not in self.cache:
            self.cache[whole] = self.rows.stack(of_piece)
        signals: FloatArray = self.cache[whole]
        return signals

    def _torque(
        self, key: Hashable, make: Callable[[Motion], FloatArray], **how: Any
    ) -> FloatArray:
        """The same of a torque, in the unit of the channel."""
        return self._seen(key, lambda _, motion: make(motion) / self.unit, **how)

    def _signal(self, name: str, given: Mapping[str, float], *, above: bool = False) -> FloatArray:
        law, bench = self.laws[name], self.columns_bench or self.bench
        width = self.width if "direction" in effect_named(name).depends_on else 0.0
        key = (name, *given.items(), *(bench.value(fitted) for fitted in (*INERTIAS, GRAVITY)))
        return self._torque(key, lambda m: law.signal(m, bench, given), width=width, above=above)

    def _waves(self, name: str, shapes: Mapping[str, float], *, above: bool = False) -> FloatArray:
        """Sine and cosine of an effect's, of unit size, (N, 2)."""
        amplitude = self.laws[name].amplitude
        phases = ({amplitude: 1.0, PHASE: phase, **shapes} for phase in (0.0, 0.5 * math.pi))
        return np.column_stack([self._signal(name, given, above=above) for given in phases])

    def _ripples(self, order: float) -> FloatArray:
        """Those of the effect of any order, (N, 2)."""
        assert self._ripple is not None
        return self._waves(self._ripple, {ORDER: order}, above=True)

    @cached_property
    def base(self) -> FloatArray:
        """The nominal bench at the skew, (N,)."""
        known = {} if self.load_angle_known else {GRAVITY: 0.0}
        bench = self.bench.with_parameters(**known)
        rubs = any("direction" in effect_named(e.name).depends_on for e in bench.effects)

        def torque(i: int, motion: Motion) -> FloatArray:
            return np.asarray(required_torque(motion, bench) + self.parts[i].known) / self.unit

        return self._seen("base", torque, width=self.width if rubs else 0.0, above=True)

    @cached_property
    def _base_above(self) -> FloatArray:
        """Above the cut-off: the bench's own ripples, and the part of the inertia's torque along
        the orders that are tried, (N,).

        A ripple that the loop is too slow for is in the motion, not in the current. Of the
        acceleration up there little but noise is known, yet along one order little of that is left.
        """
        own = [
            (TORQUE_LAWS[e.name], e.complete())
            for e in self.bench.effects
            if e.name in TORQUE_LAWS and TORQUE_LAWS[e.name].scanned == ORDER
        ]

        def waves(motion: Motion) -> FloatArray:
            every = (law.signal(motion, self.bench, given) for law, given in own)
            return np.asarray(sum(every, np.zeros_like(motion.angle)))

        total = self._torque("own waves", waves, above=True).copy()
        for i, rows in enumerate(self.rows.slices):
            quiet = [line.middle for line in self.orders if self._is_quiet(i, line.middle)]
            if quiet and self.parts[i].window.above:
                matrix = np.hstack([self._ripples(order)[rows] for order in quiet])
                total[rows] += matrix @ least_squares(matrix, self.base[rows])
        return total

    def _is_quiet(self, i: int, order: float) -> bool:
        """Whether J (n ω)² σ, by noise σ of the position, is a small part of the torque's noise."""
        ratio, part = self.bench.value("gear_ratio"), self.parts[i]
        inertia = self.bench.value("motor_inertia_kg_m2")
        inertia += self.bench.value("load_inertia_kg_m2") / ratio**2
        frequency = order * np.abs(part.along(part.motion.speed))
        shown = frequency[frequency > 2.0 * math.pi * part.window.low_pass.cutoff_hz]
        if not shown.size:
            return True
        made = inertia * math.sqrt(float(np.mean(shown**4))) * part.window.position_noise_rad
        return made < QUIET * self.unit * noise_of(self.rows.measured[self.rows.slices[i]])

    @cached_property
    def _nuisances(self) -> dict[str, FloatArray]:
        """What is fitted of the bench itself, (N,) each."""
        names = dict.fromkeys(piece.name for piece in self.rows.pieces)
        made = {name: self._parameter(name) for name in self.unknown}
        if self.gravity_free:
            for name in names:
                sine, cosine = self._gravity.T * self.rows.of(name)
                made |= {f"gravity_sine@{name}": sine, f"gravity_cosine@{name}": cosine}
        return made

    def _parameter(self, name: str) -> FloatArray:
        """Of one unit of an inertia or of gravity, (N,)."""
        ratio, ahead = self.bench.value("gear_ratio"), self.bench.value("gravity_angle_rad")
        laws: dict[str, Callable[[Motion], FloatArray]] = {
            INERTIAS[0]: lambda m: m.acceleration,
            INERTIAS[1]: lambda m: m.acceleration / ratio**2,
            GRAVITY: lambda m: np.sin(m.angle / ratio + ahead) / ratio,
        }
        return self._torque(name, laws[name])

    @property
    def _gravity(self) -> FloatArray:
        """Of one N m, down and across, (N, 2)."""
        ratio, ahead = self.bench.value("gear_ratio"), self.bench.value("gravity_angle_rad")
        across = self._torque("across", lambda m: np.cos(m.angle / ratio + ahead) / ratio)
        return np.column_stack([self._parameter(GRAVITY), across])

    # The model

    @cached_property
    def model(self) -> AffineModel:
        """Around the skew and the width."""
        base = self.base if self.slope is None else self.base - self.skew_s * self.slope
        if not all(part.piece.shown for part in self.parts):
            base = np.where(self.rows.where(lambda piece: piece.shown), base, self._base_above)
        return AffineModel(
            self.rows,
            base,
            self._nuisances,
            tuple(self._candidates()),
            (*self._torques(), self._drift()),
            believed_sds(self.bench, self.unknown),
        )

    def _candidates(self) -> Iterator[Candidate]:
        own_phase = not self.phases_shared
        wave = {"is_wave": True, "own_phase": own_phase}
        for name, law in self.laws.items():
            amplitude = (law.amplitude,)
            if name == SKEW:
                if self.slope is not None:
                    period = self.parts[0].window.low_pass.period_s
                    look = Look({}, self.slope[:, None], size=DELAY * period)
                    yield candidate_of(law, name, amplitude, (look,))
            elif law.scanned == ORDER:
                for line in self.orders:
                    looks = self._alternatives(ORDER, line, self._ripples)
                    label = f"{name} {line.middle:.6g}"
                    yield candidate_of(law, name, amplitude, looks, label=label, **wave)
            elif effect_named(name).is_periodic:
                yield candidate_of(law, name, amplitude, (Look({}, self._waves(name, {})),), **wave)
            else:
                parameters = (*amplitude, *law.linear)
                yield candidate_of(law, name, parameters, tuple(self._looks(name, parameters)))
        yield from self._wrong_values()
        for line in self.lines:
            looks = self._alternatives("frequency_hz", line, self._hum)
            label = f"line {line.middle:.6g} Hz"
            apart = Candidate(
                label, "line", label, ("amplitude",), looks, LINE, is_wave=True, own_phase=True
            )
            yield apart
            if not own_phase and len(self.rows.recordings) > 1:
                # What a motion excites has one phase in all recordings that begin with it.
                excludes = frozenset({label})
                yield replace(apart, label=f"{label}, in phase", own_phase=False, excludes=excludes)

    def _alternatives(
        self, shape: str, line: Line, make: Callable[[float], FloatArray]
    ) -> tuple[Look, ...]:
        """Of a wave; ``make``: its columns by a value of its shape."""
        every = zip(line.values, line.weights, strict=True)
        return tuple(Look({shape: value}, make(value), weight) for value, weight in every)

    def _looks(self, name: str, parameters: Sequence[str]) -> Iterator[Look]:
        law = self.laws[name]
        grid = self._values(name)
        for value in grid or (math.nan,):
            shape = {} if law.scanned is None or not grid else {law.scanned: value}
            off = dict.fromkeys(parameters, 0.0)
            every = [self._signal(name, {**off, one: 1.0, **shape}) for one in parameters]
            yield Look(shape, np.column_stack(every), 1.0 / max(1, len(grid)))

    def _wrong_values(self) -> Iterator[Candidate]:
        """Inertia and gravity that the bench states without a tolerance, as they might be wrong."""
        names = [] if set(self.unknown) & set(INERTIAS) else [INERTIAS[0]]
        if self.load_angle_known and GRAVITY not in self.unknown:
            names.append(GRAVITY)
        for name in names:
            look = Look({}, self._parameter(name)[:, None])
            yield Candidate(name, "parameter", name, (name,), (look,), WRONG_VALUE)
        if not self.load_angle_known and not self.gravity_free and self._travel_rad > TURNS:
            yield Candidate(
                "gravity",
                "gravity",
                GRAVITY,
                (GRAVITY,),
                (Look({}, self._gravity),),
                WRONG_VALUE,
                is_wave=True,
                own_phase=True,
            )

    def _hum(self, hertz: float) -> FloatArray:
        """Sine and cosine of a line in time, as compared, (N, 2)."""

        def waves(_: int, motion: Motion) -> FloatArray:
            phase = 2.0 * math.pi * hertz * motion.time_s
            return np.column_stack([np.sin(phase), np.cos(phase)])

        return self._seen(("line", hertz), waves)

    # What nothing explains

    def _torques(self) -> Iterator[Discrepancy]:
        """Over each variable."""
        ratio = self.bench.value("gear_ratio")
        for variable, period, reverses in self._kinds():
            every = np.concatenate(
                [
                    part.along(variable_of(variable, motion, ratio))
                    for part, motion in zip(self.parts, self._moved, strict=True)
                    if part.piece.use == "used" and part.piece.shown
                ]
            )
            reach = (float(every.min()), float(every.max()))
            series = Series(variable, period, reverses, LEARNED_HARMONICS, reach)

            def columns(motion: Motion, series: Series = series) -> FloatArray:
                waves = series.waves(variable_of(series.variable, motion, ratio))
                return waves * direction(motion)[:, None] if series.reverses else waves

            key = (series.kind, period, self.width)
            yield Discrepancy(series.kind, self._torque(key, columns), series)

    def _kinds(self) -> Iterator[tuple[Variable, float, bool]]:
        longest = max(float(np.ptp(part.motion.angle)) for part in self.used)
        turn = 2.0 * math.pi
        for reverses in (False, True):
            yield "load_angle", self._load_period, reverses
        if longest >= turn and (self.phases_shared or len(self.rows.recordings) == 1):
            yield "motor_angle", turn, False
        fastest = max(float(np.abs(part.motion.speed).max()) for part in self.used)
        for reverses in (False, True):
            yield "motor_speed", 4.0 * fastest, reverses

    @cached_property
    def _load_period(self) -> float:
        """Twice the way of the load, rad; where that is longer, what repeats with it does over its
        turn."""
        angles = np.concatenate([part.motion.angle for part in self.used])
        way, turn = float(np.ptp(angles)) / self.bench.value("gear_ratio"), 2.0 * math.pi
        return turn if way >= 2.0 * turn else 2.0 * way

    def _drift(self) -> Discrepancy:
        """A torque that drifts in each recording; where that is held out, nothing says how."""

        def waves(_: int, motion: Motion) -> FloatArray:
            x = (motion.time_s - motion.time_s[0]) / (motion.time_s[-1] - motion.time_s[0])
            k = np.arange(1, DRIFT_ORDERS + 1)
            return np.asarray(np.cos(math.pi * x[:, None] * k) / k)

        columns = self._seen("drift", waves) * self.rows.used[:, None]
        return Discrepancy("time", self.rows.by_recording(columns))

    # Towards the fit

    def coarse(self) -> InverseView:
        """With width and orders."""
        return self._with_width()._with_lines()

    def prepared(self) -> InverseView:
        """With width, orders and the slope of a skew."""
        view = self.coarse()
        if SKEW in view.laws:
            view = replace(view, slope=view._slopes())
        return view

    def refined(self, inference: Inference) -> InverseView:
        """Around the posterior's skew, inertia and shapes."""
        values = {
            label: inference.values(label)
            for label, p in inference.posterior.inclusion.items()
            if p > 0.5 and label in inference.labels
        }
        shapes = dict(self.shapes)
        for name in values:
            if name in self.laws and self._values(name):
                shapes[name] = self._finer(inference, name, self._values(name))
        orders = tuple(self._finer_line(inference, line, ORDER) for line in self.orders)
        lines = tuple(self._finer_line(inference, line, "frequency_hz") for line in self.lines)
        fitted = {
            name: self.bench.value(name) + inference.nuisance(name).value for name in self.unknown
        }
        for name in (*INERTIAS, GRAVITY):
            if name in values:
                fitted[name] = self.bench.value(name) + values[name][name].value
        bench = self.bench.with_parameters(**{k: v for k, v in fitted.items() if v > 0.0})
        view = replace(self, shapes=shapes, orders=orders, lines=lines, columns_bench=bench)
        skew = next(iter(values[SKEW].values())).value if SKEW in values else 0.0
        view = replace(view, skew_s=skew, discrepancy=inference.discrepancy())._with_width()
        return replace(view, slope=view._slopes()) if SKEW in self.laws else view

    def _finer(self, inference: Inference, name: str, grid: tuple[float, ...]) -> tuple[float, ...]:
        law = self.laws[name]
        assert law.scanned is not None
        best = inference.values(name)[law.scanned].value
        near = int(np.searchsorted(grid, best))
        low, high = grid[max(0, near - 1)], grid[min(len(grid) - 1, near + 1)]
        if not low < high:
            return grid
        return tuple(np.geomspace(low, high, FINER + 2).tolist())

    def _finer_line(self, inference: Inference, line: Line, shape: str) -> Line:
        for label, candidate in inference.labels.items():
            mine = candidate.looks[0].shapes.get(shape) == line.values[0]
            if mine and inference.posterior.inclusion[label] > 0.5:
                sd = inference.values(label)[shape].sd
                _, look = inference.terms[inference.posterior.likeliest(label)].source
                return line.finer(look.shapes[shape], sd)
        return line

    def _values(self, name: str) -> tuple[float, ...]:
        """Of the shape of an effect that has one, those that are tried."""
        return self.shapes.get(name, self._grid(name))

    def _grid(self, name: str) -> tuple[float, ...]:
        return tuple(self.speed_rad_per_s * share for share in self.laws[name].grid)

    @cached_property
    def speed_rad_per_s(self) -> float:
        """RMS speed of the motor over what is fitted."""
        speeds = [part.along(part.motion.speed) for part in self.used if part.piece.shown]
        return math.sqrt(float(np.mean(np.concatenate(speeds) ** 2)))

    @cached_property
    def _travel_rad(self) -> float:
        """Way of the load over what is fitted."""
        way = max(float(np.ptp(part.motion.angle)) for part in self.used)
        return way / self.bench.value("gear_ratio")

    @cached_property
    def _linear(self) -> FloatArray:
        """Nuisances, effects linear in one amplitude, waves of the orders found, (N, p)."""
        columns = [column[:, None] for column in self._nuisances.values()]
        for name, law in self.laws.items():
            if name == SKEW or effect_named(name).is_periodic:
                continue
            if law.scanned is None and not law.linear:
                columns.append(self._signal(name, {law.amplitude: 1.0})[:, None])
        waves = (self.rows.by_recording(self._ripples(line.middle)) for line in self.orders)
        return np.hstack([np.zeros((self.base.size, 0)), *columns, *waves])

    @cached_property
    def _by_linear(self) -> FloatArray:
        """Of these that fit the shown rows best beside what nothing explains, (p,)."""
        shown, residual = self.rows.shown, self.rows.measured - self.discrepancy - self.base
        return least_squares(self._linear[shown], residual[shown])

    def fitted(self) -> FloatArray:
        """Prediction by all that is linear, (N,)."""
        return np.asarray(self.base + self._linear @ self._by_linear)

    def least_residual(self) -> float:
        """Sum of squares that these leave."""
        residual = self.rows.measured - self.discrepancy - self.fitted()
        return float(np.sum(residual[self.rows.shown] ** 2))

    def _with_width(self) -> InverseView:
        names = (*self.laws, *(e.name for e in self.bench.effects))
        if not any("direction" in effect_named(n).depends_on for n in names):
            return self
        unit = self.speed_rad_per_s
        width = _minimum(
            lambda w: replace(self, width=w).least_residual(), [unit * w for w in WIDTH_GRID]
        )
        return replace(self, width=width)

    def _slopes(self) -> FloatArray:
        """Change of the prediction by a second of skew, all that is linear as it fits, (N,)."""
        step = 1e-2 / self.parts[0].window.low_pass.cutoff_hz
        made = [
            view.base + view._linear @ self._by_linear
            for view in (replace(self, skew_s=self.skew_s + s) for s in (step, -step))
        ]
        slopes = (made[0] - made[1]) / (2.0 * step)
        return np.where(self.rows.where(lambda piece: piece.shown), slopes, 0.0)

    def _rests(self) -> list[OrderedRest]:
        """What all that is linear leaves, over the motor's angle."""
        below = replace(self, orders=()).fitted()
        shown = self.rows.where(lambda piece: piece.shown)
        residual = self.rows.measured - np.where(shown, below, self._base_above)
        return [
            OrderedRest(
                part.piece.name,
                part.piece.kept(part.piece.time_s),
                part.along(part.motion.angle),
                np.abs(part.along(part.motion.speed)),
                residual[rows],
                part.window.low_pass.cutoff_hz,
                part.window.above,
                part.window.low_pass.period_s,
                part.window.step_rad,
            )
            for part, rows in zip(self.parts, self.rows.slices, strict=True)
            if part.piece.use == "used"
        ]

    def _with_lines(self) -> InverseView:
        """With the orders and frequencies that stand out most."""
        rests = self._rests()
        turning = peaks(rests, self.phases_shared, MOST_ORDERS) if self._ripple else []
        clock = [
            replace(
                r,
                angle=2.0 * math.pi * (r.time_s - r.time_s[0]),
                speed=np.full(r.time_s.size, 2.0 * math.pi),
                step_rad=0.0,
            )
            for r in rests
            if not r.above
        ]
        # Speeds are round numbers as mains and clocks are: at one speed what is a whole order may
        # be such a frequency as well.
        round_one = max((line.anywhere + line.whole for line in turning), default=0.0)
        passing = [
            replace(line, anywhere=max(line.anywhere, round_one * len(line.values)))
            for line in peaks(clock, False, MOST_LINES, whole=False)
            if not self._moves_at(line.middle)
        ]
        return replace(self, orders=tuple(turning), lines=tuple(passing))

    def _moves_at(self, hertz: float) -> bool:
        """Whether the axis itself accelerates at one frequency alone: a torque there is inertia,
        friction or a spring before it is a line in time."""
        shown = self.rows.shown
        own, waves = self._parameter(INERTIAS[0])[shown], self._hum(hertz)[shown]
        residual = own - waves @ least_squares(waves, own)
        return float(residual @ residual) < 0.1 * float(own @ own)

    # What is told

    def reportable(self, inference: Inference, label: str) -> bool:
        """Not a skew that may be below half a sample, which is what a controller holds between
        samples; nor a shape at an end of its range, which is another law in disguise."""
        if label == SKEW:
            time = self.parts[0].motion.time_s
            (skew,) = inference.values(label).values()
            surely = abs(skew.value) - float(norm.ppf(NAMED_AT)) * skew.sd
            return surely > 0.5 * float(time[1] - time[0])
        whole = self._grid(label) if label in self.laws else ()
        scanned = self.laws[label].scanned if whole else None
        if scanned is None:
            return True
        value = inference.values(label)[scanned].value
        return whole[0] < value < whole[-1]

    def settled(self, labels: Sequence[str]) -> InverseView:
        """Itself: it is linear but for shapes, which are as the posterior has them."""
        return self

    def augmented(
        self, named: Mapping[str, Mapping[str, float]], answer: Diagnosis
    ) -> Bench | None:
        """With what was named and learned; ``None`` if a phase of it belongs to a recording."""
        effects = [
            BenchEffect(name, {k: EffectParameterValue(v) for k, v in parameters.items()})
            for name, parameters in named.items()
        ]
        if any(effect_named(e.name).is_periodic and PHASE not in e.parameters for e in effects):
            return None
        assert answer.learned is not None
        bench = replace(self.bench, learned_torque=answer.learned.term)
        fitted = {k: v.value for k, v in answer.bench_parameters.items()}
        return bench.with_parameters(**fitted).with_effects(*bench.effects, *effects)


def _minimum(cost: Callable[[float], float], grid: Sequence[float]) -> float:
    """The value of the least cost: a grid, then a search around its best."""
    costs = [cost(value) for value in grid]
    best = int(np.argmin(costs))
    low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    optimum = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": 1e-2 * (high - low)}
    )
    return float(optimum.x) if optimum.fun <= costs[best] else float(grid[best])


LARGEST_SHARE = 0.01
"""Of noise in the power of the acceleration: so much too small an inertia comes out."""

BANDS_PER_OCTAVE = 3
FEWEST_LINES = 10
"""Of a spectrum in a band."""


def resolved_hz(positions: Sequence[FloatArray], period_s: float) -> float:
    """The frequency up to which noise of the position has no more than a share in the acceleration.

    Noise of the acceleration lowers the inertia by its share in the acceleration's power (errors in
    variables): Σ f⁴ σ² over the frequencies below, over Σ f⁴ |θ|².
    """
    frequencies, powers, noises = [], [], []
    for position in positions:
        trend = np.linspace(position[0], position[-1], position.size)
        taper = np.hanning(position.size)
        frequency = np.fft.rfftfreq(position.size, period_s)
        frequencies.append(frequency)
        powers.append(frequency**4 * np.abs(np.fft.rfft(taper * (position - trend))) ** 2)
        noises.append(frequency**4 * noise_of(position) ** 2 * float(taper @ taper))
    frequency = np.concatenate(frequencies)
    order = np.argsort(frequency, kind="stable")
    power, noise = (np.cumsum(np.concatenate(parts)[order]) for parts in (powers, noises))
    within = np.flatnonzero(noise <= LARGEST_SHARE * power)
    # Below four times what the filter carries from the ends nothing would be left to compare.
    lasting = period_s * max(position.size for position in positions)
    least = 4.0 * END_PERIODS / lasting
    return max(least, float(frequency[order][within[-1]]) if within.size else 0.0)


def coherent_hz(resolved: InverseView) -> float | None:
    """The end of the highest third of an octave that the prediction explains more than half of.

    With T the spectrum of the measurement and R that of what all that is linear, and the motor
    orders that stand out, leave of it: Σ|R|² < ½ Σ|T|². ``None`` if no band has that.

    Parameters
    ----------
    resolved
        The view behind the highest cut-off that resolves the motion.
    """
    view = resolved.coarse()
    rows, fitted = view.rows, view.fitted()
    frequencies, measured, residual_power = [], [], []
    for piece, own in zip(rows.pieces, rows.slices, strict=True):
        if piece.use == "used" and piece.shown:
            rest = np.zeros(piece.measured.size)
            counts = slice(None) if piece.excluded is None else ~piece.excluded
            rest[counts] = rows.measured[own] - fitted[own]
            frequencies.append(np.fft.rfftfreq(rest.size, piece.period_s))
            measured.append(_power(piece.measured))
            residual_power.append(_power(rest))
    frequency, total = np.concatenate(frequencies), np.concatenate(measured)
    rest = np.concatenate(residual_power)
    top = view.parts[0].window.low_pass.cutoff_hz
    ratio = 2.0 ** (1.0 / BANDS_PER_OCTAVE)
    while np.count_nonzero(band := (frequency > top / ratio) & (frequency <= top)) >= FEWEST_LINES:
        if 2.0 * rest[band].sum() < total[band].sum():
            return top
        top /= ratio
    return None


def _power(values: FloatArray) -> FloatArray:
    tapered = np.hanning(values.size) * (values - values.mean())
    return np.asarray(np.abs(np.fft.rfft(tapered)) ** 2)


CHANNELS = (MOTOR_TORQUE, MOTOR_CURRENT)
MOTION_ALONE = (
    "There is neither torque nor current of the motor. "
    "From motion alone the torque of the motor is unknown, and with it friction, offsets, "
    "ripple and inertia. Motion alone is enough when the motor is switched off "
    "(free_motion)."
)

ONE_WAY = 0.9
"""Net over total travel from which on a set of recordings turns one way."""


def comparison(task: Task) -> Comparison:
    """What a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    config, bench, asked = task.config, task.bench, task.config.comparison
    channel = compared_channel(task, CHANNELS, MOTION_ALONE)
    recordings = even_recordings(task, [channel])
    _require_position(config, recordings)
    unknown = unknown_parameters(task)
    unit_tolerance = _tolerance_of_unit(task, channel)
    every = TORQUE_LAWS
    if not (asked.load_angle_known and bench.value(GRAVITY) > 0.0):
        every = without_load_angle(every)
    every = within_turns(every, turns_of(recordings))
    left_out = uncomputable(every, bench, asked.load_angle_known)
    laws = {name: law for name, law in every.items() if name not in left_out}
    chosen = wanted(config, bench, laws)

    def view_below(cutoff_hz: float) -> InverseView:
        pieces = [
            part
            for entry, recording in zip(config.recordings, recordings, strict=True)
            for part in compared(
                recording, channel, USES_OF[entry.use], cutoff_hz, config.comparison.known_torque
            )
        ]
        made = InverseView(
            tuple(pieces),
            bench,
            {name: laws[name] for name in chosen},
            unknown,
            asked.load_angle_known,
            asked.motor_angle_known,
        )
        _require_motion(made, recordings)
        return made

    cutoff = asked.cutoff_hz or _cutoff_hz(recordings, view_below)
    view = view_below(cutoff)
    notes = [*notes_of(recordings), *_one_way(view.parts)]
    notes += _notes_on_sources(view.parts, cutoff, given=asked.cutoff_hz is not None)
    if left_out:
        notes.append(f"Not tried, as the load's angle is unknown: {', '.join(left_out)}.")
    if unit_tolerance:
        notes.append(
            f"The current is compared by the torque constant, which the bench knows to ± "
            f"{100.0 * unit_tolerance:.2g} %: all torques and inertias found are as uncertain, "
            "together."
        )
    return by_search(task, view, chosen, notes, unit_tolerance / math.sqrt(3.0))


def _tolerance_of_unit(task: Task, channel: str) -> float:
    """Relative tolerance of the torque of one unit of the channel."""
    bench = task.bench
    if channel != MOTOR_CURRENT:
        return 0.0
    if TORQUE_CONSTANT in bench.assumed:
        raise ConfigError(
            "Current can be compared only through the torque constant.",
            file=task.config.bench,
            where="[parameters]",
            found="no torque_constant_nm_per_a",
            expected="torque_constant_nm_per_a = {value = …}",
        )
    return bench.tolerances.get(TORQUE_CONSTANT, 0.0) / bench.value(TORQUE_CONSTANT)


def _cutoff_hz(
    recordings: Sequence[Recording], view_below: Callable[[float], InverseView]
) -> float:
    """Up to where the bench explains half of what is measured, or the motion is resolved."""
    period = max(recording.sampling_period_s for recording in recordings)
    positions = [r.channels[MOTOR_POSITION] for r in recordings if MOTOR_POSITION in r.channels]
    resolved = WIDEST / period
    if positions:
        resolved = min(resolved_hz(positions, period), resolved)
    return coherent_hz(view_below(resolved)) or resolved


def _notes_on_sources(parts: Sequence[Compared], cutoff_hz: float, *, given: bool) -> Iterator[str]:
    """Where speed and acceleration are from, and behind which filter both sides are compared."""
    sources = sorted({part.motion.source for part in parts})
    beyond = "." if given else ", beyond which the bench explains less than half."
    for source in sources:
        yield (
            f"Speed and acceleration come from the {source}; both sides are compared behind a "
            f"zero-phase Butterworth low pass of order 4 at {cutoff_hz:.3g} Hz{beyond}"
        )
    if "speed" in sources:
        yield (
            "Without position the motor angle is the integral of the speed: where it starts is "
            "unknown, so a ripple has its own phase in every recording, and gravity's direction "
            "is fitted."
        )


def compared(
    recording: Recording,
    channel: str,
    uses: Sequence[Use],
    cutoff_hz: float,
    known_torque: Sequence[str] = (),
) -> list[Compared]:
    """What is compared of a recording: whole, or its halves, each with a use of its own.

    All of a recording has one motion, so that both halves of a split one have one angle and one
    time. Above the cut-off it is compared too, for what turns with the motor, but not shown.
    """
    period = recording.sampling_period_s
    sharp = sharper(cutoff_hz, period)
    motion = motion_of(recording, sharp)
    if not np.any(motion.speed):
        raise RecordingError(
            "The motor does not move, so there is nothing to compare.",
            file=recording.place,
            found=f"{motion.source} that never changes",
            expected="a recording of a motion",
        )
    # A bridge is no motion, and the filter spreads it.
    out = widened(recording.excluded, reach(recording, sharp))
    require_enough(recording, channel, out)
    position = recording.channels.get(MOTOR_POSITION)
    noise = 0.0 if position is None else noise_of(position)
    resting = standstill(motion, noise, cutoff_hz)
    out = resting if out is None else out if resting is None else out | resting
    window = None if out is None else np.where(out, 0.0, 1.0)
    low_pass = LowPass(cutoff_hz, period)
    step = 0.0 if position is None else step_of(position)
    windows = [
        Window(low_pass, window, thinned(recording, cutoff_hz), step_rad=step),
        Window(low_pass, window, inside(recording, cutoff_hz), True, step, noise),
    ]
    compared_samples = len(range(*windows[0].rows.indices(recording.samples)))
    if compared_samples < FEWEST_SAMPLES:
        raise RecordingError(
            "The cut-off of the filter is too low for so short a recording: its ends reach all of "
            "it.",
            file=recording.place,
            found=f"{cutoff_hz:.3g} Hz in {recording.samples * period:.3g} s",
            expected="a longer recording, or a higher [comparison] cutoff_hz",
        )
    torques = (recording.channels[name] for name in known_torque)
    known = LowPass(sharp, period)(sum(torques, np.zeros(recording.samples)))
    pieces = []
    for view in windows:
        signal = recording.channels[channel]
        # As sharp as the motion, and no sharper, where the motion has a part in it.
        passband = view(signal if view.above else LowPass(sharp, period)(signal))
        excluded = None if out is None or not out[view.rows].any() else out[view.rows]
        time = recording.time_s[view.rows]
        white = low_pass.of_white_noise(view.rows.step, HIGHEST_ORDER + 1)
        shown = not view.above
        whole = Piece(
            recording.name,
            channel,
            uses[0],
            time,
            passband,
            excluded,
            shown,
            white if shown else None,
        )
        for use, rows in parts_of(uses, time.size // 2):
            pieces.append(Compared(whole.part(rows, use), motion, known, view.part(rows)))
    return pieces


def _require_motion(view: InverseView, recordings: Sequence[Recording]) -> None:
    """Refuse where nothing moves in a part that is fitted or predicted."""
    for piece in view.rows.pieces:
        moving = piece.kept(piece.time_s).size
        if moving < FEWEST_SAMPLES:
            (place,) = {r.place for r in recordings if r.name == piece.name}
            raise RecordingError(
                "The axis rests or reverses nearly all of the time in a part that is to be fitted "
                "or predicted.",
                file=place,
                where=f"{piece.time_s[0]:.3g} to {piece.time_s[-1]:.3g} s",
                found=f"{moving} of {piece.time_s.size} samples of a motion",
                expected=f"{FEWEST_SAMPLES} or more: a recording that moves throughout, or one "
                "to fit on and another that is held out",
            )


def _require_position(config: DiagnoseConfig, recordings: Sequence[Recording]) -> None:
    if all(MOTOR_POSITION in recording.channels for recording in recordings):
        return
    compared = config.comparison
    for name, claimed in (
        ("load_angle_known", compared.load_angle_known),
        ("motor_angle_known", compared.motor_angle_known),
    ):
        if claimed:
            raise ConfigError(
                "Without the motor's position no angle is known.",
                where=f"[comparison] {name}",
                found=f"a recording without {MOTOR_POSITION}",
                expected=f"{MOTOR_POSITION} in every recording, or {name} left out",
            )


def _one_way(parts: Sequence[Compared]) -> Iterator[str]:
    speed = np.concatenate([p.motion.speed for p in parts if p.piece.use == "used"])
    if abs(speed.sum()) >= ONE_WAY * np.abs(speed).sum():
        yield (
            "The recordings turn one way only: Coulomb friction, an offset and, at one speed, "
            "viscous friction can hardly be told apart; a recording in the other direction would "
            "separate them."
        )
