"""Inverse view of a rigid bench: the torque that the measured motion requires.

    J dω_m/dt + (m g l/N) sin θ_l + effects + known torques = K_t i

Effects have the laws that their modules under ``bench/effects`` declare. A rigid drive has no
shaft. Lags inside the loop do not matter, because the recorded current and motion are the real
ones.

Everything is linear in its amplitudes except a skew between the channels and the speed over which
dry friction changes its sign. This width is fitted first; the skew is linearised. Shapes (orders,
fading speeds, gaps) are alternatives on grids, refined around the probable ones. Grids are in units
of the recordings' own speeds, so that the size of a machine does not matter.
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
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, ParameterError
from bayesbl.diagnosis.disagreement import Use
from bayesbl.diagnosis.inference import (
    SURE_PARAMETER,
    AffineModel,
    Candidate,
    Discrepancy,
    Inference,
    Look,
    Piece,
    Rows,
    Series,
    View,
    candidate_of,
)
from bayesbl.diagnosis.rigid.motion import (
    END_PERIODS,
    LARGEST_SHARE,
    WIDEST,
    LowPass,
    Motion,
    Recorder,
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

SPRING = "torque_in_proportion_to_load_angle"
SKEW, SMOOTHING = "channel_time_skew", "recorder_smoothing"
TORQUE_CONSTANT = "torque_constant_nm_per_a"

TORQUE_LAWS: Mapping[str, RigidLaw] = MappingProxyType(
    {effect.name: effect.torque for effect in EFFECTS if effect.torque is not None}
)
"""Laws of all effects that act as a torque at the motor, N m."""


def without_load_angle(laws: Mapping[str, RigidLaw]) -> dict[str, RigidLaw]:
    """Laws that do not depend on the load's angle."""
    return {n: law for n, law in laws.items() if "load_angle" not in effect_named(n).depends_on}


def within_turns(laws: Mapping[str, RigidLaw], turns: float) -> dict[str, RigidLaw]:
    """Laws without those that repeat once per motor turn, if there are too few turns."""
    return {
        name: law
        for name, law in laws.items()
        if not effect_named(name).is_periodic or law.scanned == ORDER or turns >= FEWEST_CYCLES
    }


def uncomputable(laws: Mapping[str, RigidLaw], bench: Bench, load_angle_known: bool) -> list[str]:
    """Names of laws that need the torque in the gear, which is unknown with gravity's angle."""
    if load_angle_known or bench.value(GRAVITY) <= 0.0:
        return []
    return sorted(n for n in laws if "transmitted_torque" in effect_named(n).depends_on)


def required_torque(motion: Motion, bench: Bench) -> FloatArray:
    """Motor torque that a motion requires, with the effects of the bench, N m.

    (J_m + J_l/N²) dω_m/dt + (m g l/N) sin(θ_m/N) and the losses. Shaft, lags of the loop and a skew
    of the channels are left out.
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
"""Widths of the friction's change of sign, in RMS speeds. A narrower one contains few samples; a
wider one would be viscous friction."""

DELAY = 4.0
"""Usual delay of a recorder, and usual root of its smoothing, in sampling periods."""

RECORDER_ROUNDS, RECORDER_STEP = 8, 1e-3
"""Largest number of steps of the recorder's fit, and relative gain at which it ends."""

QUIET = 0.5
"""Largest noise of the motion over that of the torque. It makes standard deviations an eighth too
small."""

MOST_ORDERS, MOST_LINES = 8, 4
"""Largest numbers of motor orders and of lines in time that are tried, the strongest."""

FINER = 5
"""Number of shapes between the neighbours of a probable one."""

DRIFTING = ("motor_coulomb_friction", "motor_viscous_friction")
"""Friction that differs between recordings, as grease warms up."""

FORM_ORDERS = 3
"""Orders of the torques by which laws depart from their forms: those that look like a law."""

DRIFT_ORDERS = 6
"""Number of cosines over the time of a recording: slower than friction that warms up."""

LINE = 0.3
"""Usual share of a line in time."""

TURNS = 1.0
"""Travel of the load, rad, from which gravity changes direction. On a shorter one it is an offset
and a spring."""

WRONG_VALUE = 0.3
"""Usual share of a wrong value of the data sheet."""


@dataclass(frozen=True, slots=True)
class Compared:
    """A piece with the motion and the known motor torque, N m, (n,), of its whole recording.

    ``window``: makes the compared signal from one over the whole recording.
    """

    piece: Piece
    motion: Motion
    known: FloatArray
    window: Window

    def along(self, signal: FloatArray) -> FloatArray:
        """A signal over the recording, (n,), at the piece's samples, (k,)."""
        return self.piece.kept(signal[self.window.rows])


@dataclass(frozen=True)
class InverseView(View):
    """Motion of each piece and the measured torque or current.

    Attributes
    ----------
    laws
        Laws of the effects that may be named.
    unknown
        Free bench parameters: inertias and the gravity torque.
    load_angle_known
        Whether the motor position gives the load's angle, and with it gravity's direction.
    phases_shared
        Whether the motor position is absolute, so that one phase holds in all recordings.
    recorder, width
        Values around which the model is linear: what the drive does to the torque before it is
        recorded, and the width of dry friction, rad/s.
    slopes
        Change of the prediction per second of the recorder's delay, and per s² of its smoothing, in
        the channel's unit, (N, 2).
    shapes
        Values of a shape that replace its grid, by effect.
    orders, lines
        Motor orders, and lines in time, Hz.
    columns_bench
        Bench with fitted parameters, from which columns are made.
    discrepancy
        Present estimate of the discrepancy, (N,).
    """

    parts: tuple[Compared, ...]
    bench: Bench
    laws: Mapping[str, RigidLaw]
    unknown: tuple[str, ...] = ()
    load_angle_known: bool = False
    phases_shared: bool = False
    recorder: Recorder = field(default_factory=Recorder)
    width: float = 0.0
    slopes: FloatArray | None = None
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    orders: tuple[Line, ...] = ()
    lines: tuple[Line, ...] = ()
    columns_bench: Bench | None = None
    discrepancy: FloatArray | float = 0.0
    cache: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    # Signals

    @cached_property
    def rows(self) -> Rows:
        """Rows of all pieces."""
        return Rows(tuple(part.piece for part in self.parts))

    @cached_property
    def shown(self) -> np.ndarray:
        """Mask of the rows below the cut-off, held out or not, (N,)."""
        return self.rows.where(lambda piece: piece.shown)

    @cached_property
    def unit(self) -> float:
        """N m in one unit of the channel: K_t if current is compared."""
        current = self.rows.pieces[0].channel == MOTOR_CURRENT
        return self.bench.value(TORQUE_CONSTANT) if current else 1.0

    @cached_property
    def gravity_free(self) -> bool:
        """Whether gravity's size and direction are fitted in each recording."""
        return not self.load_angle_known and self.bench.value(GRAVITY) > 0.0

    @cached_property
    def _ripple(self) -> str | None:
        """Name of the effect of any motor order."""
        return next((name for name, law in self.laws.items() if law.scanned == ORDER), None)

    @cached_property
    def used(self) -> list[Compared]:
        """Parts that are fitted."""
        return [part for part in self.parts if part.piece.use == "used"]

    @cached_property
    def _motions(self) -> list[Motion]:
        """Motion of each part."""
        return [replace(part.motion, friction_width=self.width) for part in self.parts]

    def _compared(
        self,
        key: Hashable,
        signal_of: Callable[[int, Motion], FloatArray],
        *,
        width: float = 0.0,
        above: bool = False,
    ) -> FloatArray:
        """A signal along the motion, or columns, as it is compared, (N, …); computed once.

        Above the cut-off it is zero unless ``above``, because only waves are known there.
        """

        def of_piece(i: int) -> FloatArray:
            part, signal = self.parts[i], signal_of(i, self._motions[i])
            if part.window.above and not above:
                return np.zeros((part.piece.measured.size, *signal.shape[1:]))
            period = part.window.low_pass.period_s
            columns = [self.recorder(column, period) for column in np.atleast_2d(signal.T)]
            return part.window(np.stack(columns, axis=1) if signal.ndim > 1 else columns[0])

        whole_key = (key, self.recorder, width)
        if whole_key not in self.cache:
            self.cache[whole_key] = self.rows.stack(of_piece)
        signals: FloatArray = self.cache[whole_key]
        return signals

    def _torque(
        self, key: Hashable, torque_of: Callable[[Motion], FloatArray], **options: Any
    ) -> FloatArray:
        """A torque along the motion, in the unit of the channel, as it is compared, (N, …)."""
        return self._compared(key, lambda _, motion: torque_of(motion) / self.unit, **options)

    def _signal(self, name: str, given: Mapping[str, float], *, above: bool = False) -> FloatArray:
        """An effect with given parameters, (N,)."""
        law, bench = self.laws[name], self.columns_bench or self.bench
        width = self.width if "direction" in effect_named(name).depends_on else 0.0
        key = (name, *given.items(), *(bench.value(fitted) for fitted in (*INERTIAS, GRAVITY)))
        return self._torque(key, lambda m: law.signal(m, bench, given), width=width, above=above)

    def _waves(self, name: str, shapes: Mapping[str, float], *, above: bool = False) -> FloatArray:
        """Sine and cosine of a periodic effect of unit amplitude, (N, 2)."""
        amplitude = self.laws[name].amplitude
        phases = ({amplitude: 1.0, PHASE: phase, **shapes} for phase in (0.0, 0.5 * math.pi))
        return np.column_stack([self._signal(name, given, above=above) for given in phases])

    def _ripples(self, order: float) -> FloatArray:
        """Sine and cosine of a motor order, (N, 2)."""
        assert self._ripple is not None
        return self._waves(self._ripple, {ORDER: order}, above=True)

    def _hum(self, hertz: float) -> FloatArray:
        """Sine and cosine of a line in time, (N, 2)."""

        def waves(_: int, motion: Motion) -> FloatArray:
            phase = 2.0 * math.pi * hertz * motion.time_s
            return np.column_stack([np.sin(phase), np.cos(phase)])

        return self._compared(("line", hertz), waves)

    @cached_property
    def base(self) -> FloatArray:
        """Prediction of the nominal bench at the skew, (N,)."""
        known = {} if self.load_angle_known else {GRAVITY: 0.0}
        bench = self.bench.with_parameters(**known)
        rubs = any("direction" in effect_named(e.name).depends_on for e in bench.effects)

        def torque(i: int, motion: Motion) -> FloatArray:
            return np.asarray(required_torque(motion, bench) + self.parts[i].known) / self.unit

        return self._compared("base", torque, width=self.width if rubs else 0.0, above=True)

    @cached_property
    def _base_above(self) -> FloatArray:
        """Prediction above the cut-off, (N,): ripples of the bench, and the torque of the inertia
        along the orders that are tried.

        A ripple that the loop cannot follow is in the motion, not in the current. The acceleration
        there is mostly noise, but little of the noise lies along one order.
        """
        ripples = [
            (TORQUE_LAWS[e.name], e.complete())
            for e in self.bench.effects
            if e.name in TORQUE_LAWS and TORQUE_LAWS[e.name].scanned == ORDER
        ]

        def waves(motion: Motion) -> FloatArray:
            signals = (law.signal(motion, self.bench, given) for law, given in ripples)
            return np.asarray(sum(signals, np.zeros_like(motion.angle)))

        total = self._torque("own waves", waves, above=True).copy()
        for i, rows in enumerate(self.rows.slices):
            quiet = [line.middle for line in self.orders if self._is_quiet(i, line.middle)]
            if quiet and self.parts[i].window.above:
                matrix = np.hstack([self._ripples(order)[rows] for order in quiet])
                total[rows] += matrix @ least_squares(matrix, self.base[rows])
        return total

    def _is_quiet(self, i: int, order: float) -> bool:
        """Whether J (n ω)² σ, with position noise σ, is small compared with the torque's noise."""
        ratio, part = self.bench.value("gear_ratio"), self.parts[i]
        inertia = self.bench.value("motor_inertia_kg_m2")
        inertia += self.bench.value("load_inertia_kg_m2") / ratio**2
        frequency = order * np.abs(part.along(part.motion.speed))
        above = frequency[frequency > 2.0 * math.pi * part.window.low_pass.cutoff_hz]
        if not above.size:
            return True
        noise = inertia * math.sqrt(float(np.mean(above**4))) * part.window.position_noise_rad
        return noise < QUIET * self.unit * noise_of(self.rows.measured[self.rows.slices[i]])

    @cached_property
    def _nuisances(self) -> dict[str, FloatArray]:
        """Columns of the free bench parameters and of free gravity, (N,) each."""
        columns = {name: self._parameter(name) for name in self.unknown}
        if self.gravity_free:
            for name in dict.fromkeys(piece.name for piece in self.rows.pieces):
                sine, cosine = self._gravity.T * self.rows.of(name)
                columns |= {f"gravity_sine@{name}": sine, f"gravity_cosine@{name}": cosine}
        return columns

    def _parameter(self, name: str) -> FloatArray:
        """Column of an inertia or of gravity, (N,)."""
        ratio, ahead = self.bench.value("gear_ratio"), self.bench.value("gravity_angle_rad")
        laws: dict[str, Callable[[Motion], FloatArray]] = {
            INERTIAS[0]: lambda m: m.acceleration,
            INERTIAS[1]: lambda m: m.acceleration / ratio**2,
            GRAVITY: lambda m: np.sin(m.angle / ratio + ahead) / ratio,
        }
        return self._torque(name, laws[name])

    @property
    def _gravity(self) -> FloatArray:
        """Columns of gravity in its direction and across, (N, 2)."""
        ratio, ahead = self.bench.value("gear_ratio"), self.bench.value("gravity_angle_rad")
        across = self._torque("across", lambda m: np.cos(m.angle / ratio + ahead) / ratio)
        return np.column_stack([self._parameter(GRAVITY), across])

    # The model

    @cached_property
    def model(self) -> AffineModel:
        """Model at the skew and the width."""
        base, nuisances = self.base, dict(self._nuisances)
        sds = believed_sds(self.bench, self.unknown)
        if self.slopes is not None:
            delay, smoothing = self.recorder.delay_s, self.recorder.smoothing_s2
            base = base - self.slopes @ [delay, smoothing]
            nuisances[SMOOTHING] = self.slopes[:, 1]
            sds[SMOOTHING] = max(self._usual_delay_s**2, smoothing)
        return AffineModel(
            self.rows,
            base if self.shown.all() else np.where(self.shown, base, self._base_above),
            nuisances,
            tuple(self._candidates()),
            (*self._torques(), self._spring, self._drift(), *self._between_recordings()),
            sds,
            of_recorder=frozenset({SMOOTHING}),
        )

    def _candidates(self) -> Iterator[Candidate]:
        own_phase = not self.phases_shared
        wave = {"is_wave": True, "own_phase": own_phase}
        for name, law in self.laws.items():
            amplitude = (law.amplitude,)
            if name == SKEW:
                if self.slopes is not None:
                    look = Look({}, self.slopes[:, :1], size=self._usual_delay_s)
                    yield candidate_of(law, name, amplitude, (look,))
            elif law.scanned == ORDER:
                for line in self.orders:
                    looks = _alternatives(ORDER, line, self._ripples)
                    label = f"{name} {line.middle:.6g}"
                    yield candidate_of(law, name, amplitude, looks, label=label, **wave)
            elif effect_named(name).is_periodic:
                yield candidate_of(law, name, amplitude, (Look({}, self._waves(name, {})),), **wave)
            else:
                parameters = (*amplitude, *law.linear)
                yield candidate_of(law, name, parameters, tuple(self._looks(name, parameters)))
        yield from self._wrong_values()
        for line in self.lines:
            looks = _alternatives("frequency_hz", line, self._hum)
            label = f"line {line.middle:.6g} Hz"
            separate = Candidate(
                label, "line", label, ("amplitude",), looks, LINE, is_wave=True, own_phase=True
            )
            yield separate
            if not own_phase and len(self.rows.recordings) > 1:
                # What a motion excites has the same phase in all recordings that begin with it.
                excludes, label = frozenset({label}), f"{label}, in phase"
                yield replace(separate, label=label, own_phase=False, excludes=excludes)

    def _looks(self, name: str, parameters: Sequence[str]) -> Iterator[Look]:
        """A form for each value of an effect's shape."""
        law, grid = self.laws[name], self._values(name)
        for value in grid or (math.nan,):
            shape = {} if law.scanned is None or not grid else {law.scanned: value}
            zero = dict.fromkeys(parameters, 0.0)
            columns = [self._signal(name, {**zero, p: 1.0, **shape}) for p in parameters]
            yield Look(shape, np.column_stack(columns), 1.0 / max(1, len(grid)))

    def _wrong_values(self) -> Iterator[Candidate]:
        """Wrong inertia and gravity, if the bench states them without a tolerance."""
        names = [] if set(self.unknown) & set(INERTIAS) else [INERTIAS[0]]
        if self.load_angle_known and GRAVITY not in self.unknown:
            names.append(GRAVITY)
        for name in names:
            look = Look({}, self._parameter(name)[:, None])
            yield Candidate(name, "parameter", name, (name,), (look,), WRONG_VALUE)
        travel_rad = self._longest_rad / self.bench.value("gear_ratio")
        if not self.load_angle_known and not self.gravity_free and travel_rad > TURNS:
            looks = (Look({}, self._gravity),)
            gravity = Candidate("gravity", "gravity", GRAVITY, (GRAVITY,), looks, WRONG_VALUE)
            yield replace(gravity, is_wave=True, own_phase=True)

    # The discrepancy

    def _torques(self, orders: int = LEARNED_HARMONICS) -> Iterator[Discrepancy]:
        """A torque over each variable."""
        ratio = self.bench.value("gear_ratio")
        for variable, period, reverses in self._kinds():
            values = np.concatenate(
                [
                    part.along(variable_of(variable, motion, ratio))
                    for part, motion in zip(self.parts, self._motions, strict=True)
                    if part.piece.use == "used" and part.piece.shown
                ]
            )
            reach = (float(values.min()), float(values.max()))
            series = Series(variable, period, reverses, orders, reach)

            def columns(motion: Motion, series: Series = series) -> FloatArray:
                waves = series.waves(variable_of(series.variable, motion, ratio))
                return waves * direction(motion)[:, None] if series.reverses else waves

            width = self.width if reverses else 0.0
            torque = self._torque((series.kind, period, orders), columns, width=width)
            yield Discrepancy(series.kind, torque, series, variable == "motor_speed")

    def _kinds(self) -> Iterator[tuple[Variable, float, bool]]:
        """Variable, period, and whether the torque reverses with the speed."""
        turn = 2.0 * math.pi
        # Twice the load's travel; beyond two turns, whatever repeats does so over one.
        angles = np.concatenate([part.motion.angle for part in self.used])
        travel = float(np.ptp(angles)) / self.bench.value("gear_ratio")
        load_period = turn if travel >= 2.0 * turn else 2.0 * travel
        fastest = max(float(np.abs(part.motion.speed).max()) for part in self.used)
        yield from (("load_angle", load_period, reverses) for reverses in (False, True))
        if self._longest_rad >= turn and (self.phases_shared or len(self.rows.recordings) == 1):
            yield "motor_angle", turn, False
        yield "motor_speed", 4.0 * fastest, False

    @cached_property
    def _spring(self) -> Discrepancy:
        """A torque in proportion to the load's angle, as of a cable, a hose or a spring.

        Apart from the other torques over this angle, because most of it looks like gravity. Where
        gravity is fitted, it may be a share of that, and where it vanishes is unknown.
        """
        ratio, own = self.bench.value("gear_ratio"), 0.0
        angles = np.concatenate([part.motion.angle for part in self.used])
        low, high = float(angles.min()), float(angles.max())
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        columns = [self._torque("spring", lambda motion: (motion.angle - middle) / ratio**2)]
        if GRAVITY in self.unknown:
            shown = self.rows.shown
            weight = self.bench.value(GRAVITY) * self._parameter(GRAVITY)[shown]
            own = math.sqrt(float(np.mean(weight**2)))
            columns.append(self._torque("rest", lambda m: np.full_like(m.angle, half / ratio**2)))
        return Discrepancy(SPRING, np.column_stack(columns), is_form=True, own=own)

    def _drift(self) -> Discrepancy:
        """A torque that drifts in each fitted recording."""

        def waves(_: int, motion: Motion) -> FloatArray:
            x = (motion.time_s - motion.time_s[0]) / (motion.time_s[-1] - motion.time_s[0])
            k = np.arange(1, DRIFT_ORDERS + 1)
            return np.asarray(np.cos(math.pi * x[:, None] * k) / k)

        columns = self._compared("drift", waves) * self.rows.used[:, None]
        return Discrepancy("time", self.rows.by_recording(columns))

    def _between_recordings(self) -> Iterator[Discrepancy]:
        """Departures of each recording's friction and load from their means over the recordings."""
        recordings = len(self.rows.recordings)
        if recordings < 2:
            return
        friction = (name for name in DRIFTING if name in self.laws)
        signals = {n: self._signal(n, {self.laws[n].amplitude: 1.0}) for n in friction}
        signals |= {name: self._parameter(name) for name in self.unknown}
        apart = np.eye(recordings) - 1.0 / recordings
        for name, signal in signals.items():
            columns = self.rows.by_recording(signal[:, None]) @ apart
            yield Discrepancy(f"{name}_between_recordings", columns, of=name)

    # Towards the fit

    def coarse(self) -> InverseView:
        """The view with width, recorder, orders and lines."""
        return self._with_width()._with_recorder()._with_width()._with_lines()

    def prepared(self) -> InverseView:
        """The view with width, orders, lines and the slopes of the recorder."""
        return self.coarse()._with_slopes()

    def refined(self, inference: Inference) -> InverseView:
        """The view at the posterior's skew, parameters and shapes."""
        values = {
            label: inference.values(label)
            for label, p in inference.posterior.inclusion.items()
            if p > 0.5 and label in inference.labels
        }
        shapes = dict(self.shapes)
        for name in values:
            if name in self.laws and self._values(name):
                shapes[name] = self._finer(inference, name, self._values(name))
        orders = tuple(_finer_line(inference, line, ORDER) for line in self.orders)
        lines = tuple(_finer_line(inference, line, "frequency_hz") for line in self.lines)
        fitted = {name: inference.change(name).value for name in self.unknown}
        fitted |= {n: values[n][n].value for n in (*INERTIAS, GRAVITY) if n in values}
        fitted = {name: self.bench.value(name) + change for name, change in fitted.items()}
        bench = self.bench.with_parameters(**{k: v for k, v in fitted.items() if v > 0.0})
        recorder = Recorder()
        if SKEW in values:
            (delay,) = values[SKEW].values()
            recorder = Recorder(delay.value, max(inference.change(SMOOTHING).value, 0.0))
        view = replace(
            self,
            shapes=shapes,
            orders=orders,
            lines=lines,
            columns_bench=bench,
            recorder=recorder,
            discrepancy=inference.discrepancy(),
        )
        return view._with_width()._with_slopes()

    def _finer(self, inference: Inference, name: str, grid: tuple[float, ...]) -> tuple[float, ...]:
        """Grid of a shape between the neighbours of its posterior mean."""
        scanned = self.laws[name].scanned
        assert scanned is not None
        near = int(np.searchsorted(grid, inference.values(name)[scanned].value))
        low, high = grid[max(0, near - 1)], grid[min(len(grid) - 1, near + 1)]
        return tuple(np.geomspace(low, high, FINER + 2).tolist()) if low < high else grid

    def _values(self, name: str) -> tuple[float, ...]:
        """Values of an effect's shape that are tried; empty without a shape."""
        return self.shapes.get(name, self._grid(name))

    def _grid(self, name: str) -> tuple[float, ...]:
        return tuple(self.speed_rad_per_s * share for share in self.laws[name].grid)

    @cached_property
    def speed_rad_per_s(self) -> float:
        """RMS speed of the motor in the shown parts that are fitted."""
        speeds = [part.along(part.motion.speed) for part in self.used if part.piece.shown]
        return math.sqrt(float(np.mean(np.concatenate(speeds) ** 2)))

    @cached_property
    def _longest_rad(self) -> float:
        """Longest travel of the motor in a fitted recording."""
        return max(float(np.ptp(part.motion.angle)) for part in self.used)

    @cached_property
    def _linear(self) -> FloatArray:
        """Columns of nuisances, effects with one linear amplitude, forms, and motor orders, last,
        (N, p)."""
        columns = [column[:, None] for column in self._nuisances.values()]
        for name, law in self.laws.items():
            if name == SKEW or effect_named(name).is_periodic:
                continue
            if law.scanned is None and not law.linear:
                columns.append(self._signal(name, {law.amplitude: 1.0})[:, None])
        waves = (self.rows.by_recording(self._ripples(line.middle)) for line in self.orders)
        torques = (*self._torques(FORM_ORDERS), self._spring)
        forms = (torque.columns for torque in torques if torque.is_form)
        return np.hstack([np.zeros((self.base.size, 0)), *columns, *forms, *waves])

    @cached_property
    def _by_linear(self) -> FloatArray:
        """Their coefficients by least squares, (p,)."""
        shown, residual = self.rows.shown, self.rows.measured - self.discrepancy - self.base
        return least_squares(self._linear[shown], residual[shown])

    def fitted(self) -> FloatArray:
        """Prediction of the linear fit, (N,)."""
        return np.asarray(self.base + self._linear @ self._by_linear)

    def _with_width(self) -> InverseView:
        """The view with the best width, if any effect depends on the direction of motion."""
        names = (*self.laws, *(e.name for e in self.bench.effects))
        if not any("direction" in effect_named(n).depends_on for n in names):
            return self

        def cost(width: float) -> float:
            return replace(self, width=width)._misfit

        return replace(self, width=_minimum(cost, [self.speed_rad_per_s * w for w in WIDTH_GRID]))

    def _with_recorder(self) -> InverseView:
        """The view with the recorder that fits best, by Gauss-Newton with the linear fit.

        If it leaves more than half of what the fit without one leaves, it is small, and the search
        may start without.
        """
        view = self._with_slopes()
        for _ in range(RECORDER_ROUNDS):
            if view.slopes is None:
                return self
            shown = view.rows.shown
            matrix = np.hstack([view._linear, view.slopes])[shown]
            residual = (view.rows.measured - view.discrepancy - view.base)[shown]
            by_delay, by_smoothing = least_squares(matrix, residual)[-2:]
            step, old = 1.0, view._misfit
            while step > RECORDER_STEP:
                delay = view.recorder.delay_s + step * by_delay
                smoothing = max(0.0, view.recorder.smoothing_s2 + step * by_smoothing)
                other = replace(view, recorder=Recorder(delay, smoothing), cache={})
                if other._misfit < old:
                    break
                step *= 0.5
            else:
                break
            view = other._with_slopes()
            if other._misfit > (1.0 - RECORDER_STEP) * old:
                break
        return replace(view, slopes=None) if view._misfit < 0.5 * self._misfit else self

    @cached_property
    def _misfit(self) -> float:
        """Sum of squares that the linear fit leaves in the shown rows."""
        residual = self.rows.measured - self.discrepancy - self.fitted()
        return float(np.sum(residual[self.rows.shown] ** 2))

    def _with_slopes(self) -> InverseView:
        """The view with the change of the linear fit by the recorder, if a skew is sought.

        Smoothing makes a ripple smaller, and at one speed it would stand for the whole ripple. The
        size of a ripple is free, so smoothing acts on the rest only.
        """
        if SKEW not in self.laws:
            return self
        delay, smoothing = self.recorder.delay_s, self.recorder.smoothing_s2
        step = 1e-2 / self.parts[0].window.low_pass.cutoff_hz
        pairs = [
            (Recorder(delay + step, smoothing), Recorder(delay - step, smoothing), self.orders),
            (Recorder(delay, smoothing + step**2), Recorder(delay, smoothing), ()),
        ]
        slopes = []
        for more, less, orders in pairs:
            views = (replace(self, recorder=r, orders=orders, cache={}) for r in (more, less))
            high, low = (
                view.base + view._linear @ self._by_linear[: view._linear.shape[1]]
                for view in views
            )
            width = more.delay_s - less.delay_s + more.smoothing_s2 - less.smoothing_s2
            slopes.append(np.where(self.shown, (high - low) / width, 0.0))
        return replace(self, slopes=np.stack(slopes, axis=1))

    @property
    def _usual_delay_s(self) -> float:
        """Usual delay and smoothing of a recorder."""
        return DELAY * self.parts[0].window.low_pass.period_s

    def _rests(self) -> list[OrderedRest]:
        """Residuals of the linear fit over the motor angle."""
        below = replace(self, orders=()).fitted()
        residual = self.rows.measured - np.where(self.shown, below, self._base_above)
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
        """The view with the orders and frequencies that stand out most."""
        rests = self._rests()
        orders = peaks(rests, self.phases_shared, MOST_ORDERS) if self._ripple else []
        turn = 2.0 * math.pi
        clock = [
            replace(
                r,
                angle=turn * (r.time_s - r.time_s[0]),
                speed=np.full(r.time_s.size, turn),
                step_rad=0.0,
            )
            for r in rests
            if not r.above
        ]
        # Speeds are round numbers, and so are the frequencies of mains and clocks: at one speed, a
        # whole order may be such a frequency.
        whole = max((line.anywhere + line.whole for line in orders), default=0.0)
        lines = [
            replace(line, anywhere=max(line.anywhere, whole * len(line.values)))
            for line in peaks(clock, False, MOST_LINES, whole=False)
            if not self._moves_at(line.middle)
        ]
        return replace(self, orders=tuple(orders), lines=tuple(lines))

    def _moves_at(self, hertz: float) -> bool:
        """Whether the axis accelerates at this frequency alone. A torque at this frequency is then
        inertia, friction or a spring rather than a line in time."""
        shown = self.rows.shown
        inertia, waves = self._parameter(INERTIAS[0])[shown], self._hum(hertz)[shown]
        residual = inertia - waves @ least_squares(waves, inertia)
        return float(residual @ residual) < 0.1 * float(inertia @ inertia)

    # The answer

    def reportable(self, inference: Inference, label: str) -> bool:
        """Whether a candidate says something about the joint.

        A skew below half a sample is the controller's hold. A shape at an end of its range is
        another law in disguise.
        """
        if label == SKEW:
            time = self.parts[0].motion.time_s
            (skew,) = inference.values(label).values()
            least = abs(skew.value) - float(norm.ppf(NAMED_AT)) * skew.sd
            return least > 0.5 * float(time[1] - time[0])
        grid = self._grid(label) if label in self.laws else ()
        scanned = self.laws[label].scanned if grid else None
        return scanned is None or grid[0] < inference.values(label)[scanned].value < grid[-1]

    silent = (SKEW,)

    def remarks(self, inference: Inference) -> Iterator[str]:
        """Notes on gravity that the bench lacks, and on a cable or spring."""
        if "gravity" in inference.posterior.named:
            ((name, size),) = inference.values("gravity").items()
            yield (
                "The rest follows the load's angle as gravity does, although the bench has "
                f"{name} = 0: {size.value:.3g} N m at the load were fitted, with their "
                "direction. A balancer that the bench lacks may look the same. Give gravity in "
                "the bench file, if it is that."
            )
        places = (k for k, term in enumerate(inference.terms) if term.hypothesis == SPRING)
        for k in places:
            draws = inference.always(k)[:, 0]
            stiffness, sd = float(draws.mean()), float(draws.std())
            if abs(stiffness) > SURE_PARAMETER * sd:
                yield (
                    "A torque grows with the load's angle as that of a cable, a hose or a spring "
                    f"does, by {stiffness:.3g} ± {sd:.1g} N m per rad at the load. It is fitted "
                    "beside what is named."
                )

    def rivals(
        self, errors: Sequence[ParameterError], estimates: Mapping[str, Estimate]
    ) -> tuple[str, ...]:
        """The scale of the recorded torque, if it would explain all that the bench states."""
        inertia = next((e for e in errors if e.name in INERTIAS), None)
        if inertia is None:
            return ()
        stated = self.bench.value(GRAVITY)
        if self.load_angle_known and stated > 0.0:
            total = sum(self._at_motor(name) * self.bench.value(name) for name in INERTIAS)
            scale = self._at_motor(inertia.name) / total
            factor = 1.0 + scale * (inertia.fitted.value - inertia.believed)
            # Gravity may be off by the same factor within its tolerance.
            gravity = estimates.get(GRAVITY, Estimate(stated, 0.0))
            sd = math.hypot(scale * inertia.fitted.sd, gravity.sd / stated)
            if abs(factor - gravity.value / stated) > SURE_PARAMETER * sd:
                return ()
        current = self.rows.pieces[0].channel == MOTOR_CURRENT
        return (TORQUE_CONSTANT if current else MOTOR_TORQUE,)

    def _at_motor(self, inertia: str) -> float:
        """An inertia at the motor over itself."""
        return 1.0 if inertia == INERTIAS[0] else self.bench.value("gear_ratio") ** -2

    def augmented(
        self, named: Mapping[str, Mapping[str, float]], answer: Diagnosis
    ) -> Bench | None:
        """The bench with everything named and learned; ``None`` if a phase is a recording's own."""
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


def _alternatives(
    shape: str, line: Line, columns_of: Callable[[float], FloatArray]
) -> tuple[Look, ...]:
    """A form for each value of a line's shape; ``columns_of``: its columns at a value."""
    pairs = zip(line.values, line.weights, strict=True)
    return tuple(Look({shape: value}, columns_of(value), weight) for value, weight in pairs)


def _finer_line(inference: Inference, line: Line, shape: str) -> Line:
    """A line around its most probable value, if it is probable."""
    for label, candidate in inference.labels.items():
        is_line = candidate.shapes.get(shape) == line.values[0]
        if is_line and inference.posterior.inclusion[label] > 0.5:
            _, look = inference.terms[inference.posterior.likeliest(label)].source
            return line.finer(look.shapes[shape], inference.values(label)[shape].sd)
    return line


def _minimum(cost: Callable[[float], float], grid: Sequence[float]) -> float:
    """Value of least cost, on a grid and then between its neighbours."""
    costs = [cost(value) for value in grid]
    best = int(np.argmin(costs))
    low, high = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    optimum = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"xatol": 1e-2 * (high - low)}
    )
    return float(optimum.x) if optimum.fun <= costs[best] else float(grid[best])


BANDS_PER_OCTAVE = 3
FEWEST_LINES = 10
"""Smallest number of spectral lines in a band."""


def resolved_hz(positions: Sequence[FloatArray], period_s: float) -> float:
    """Highest frequency below which noise of the position is a small share of the acceleration.

    Noise lowers the inertia by its share in the power of the acceleration (errors in variables):
    Σ f⁴ σ² over Σ f⁴ |θ|², for all lower frequencies.
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
    # Below four times the filter's reach from the ends, no samples would be left to compare.
    duration_s = period_s * max(position.size for position in positions)
    lowest = 4.0 * END_PERIODS / duration_s
    return max(lowest, float(frequency[order][within[-1]]) if within.size else 0.0)


def coherent_hz(resolved: InverseView) -> float | None:
    """Upper end of the highest third of an octave of which the linear fit explains over half.

    With T the spectrum of the measurement and R that of the residual: Σ|R|² < ½ Σ|T|². ``None`` if
    there is no such band. ``resolved``: the view at the highest cut-off that resolves the motion.
    """
    view = resolved.coarse()
    rows, fitted = view.rows, view.fitted()
    frequencies, totals, rests = [], [], []
    for piece, own in zip(rows.pieces, rows.slices, strict=True):
        if piece.use == "used" and piece.shown:
            residual = np.zeros(piece.measured.size)
            counts = slice(None) if piece.excluded is None else ~piece.excluded
            residual[counts] = rows.measured[own] - fitted[own]
            frequencies.append(np.fft.rfftfreq(residual.size, piece.period_s))
            totals.append(_power(piece.measured))
            rests.append(_power(residual))
    frequency, total, rest = (np.concatenate(x) for x in (frequencies, totals, rests))
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
"""Net over total travel from which a set of recordings turns one way."""


def comparison(task: Task) -> Comparison:
    """Comparison of a task; raises ``UserError`` if bench or recordings do not suit the method."""
    require_rigid(task)
    config, bench, asked = task.config, task.bench, task.config.comparison
    channel = compared_channel(task, CHANNELS, MOTION_ALONE)
    recordings = even_recordings(task, [channel])
    _require_position(config, recordings)
    unknown = unknown_parameters(task)
    unit_tolerance = _tolerance_of_unit(task, channel)
    laws: Mapping[str, RigidLaw] = TORQUE_LAWS
    if not (asked.load_angle_known and bench.value(GRAVITY) > 0.0):
        laws = without_load_angle(laws)
    laws = within_turns(laws, turns_of(recordings))
    left_out = uncomputable(laws, bench, asked.load_angle_known)
    laws = {name: law for name, law in laws.items() if name not in left_out}
    chosen = wanted(config, bench, laws)

    def view_below(cutoff_hz: float) -> InverseView:
        parts = [
            part
            for entry, recording in zip(config.recordings, recordings, strict=True)
            for part in compared(
                recording, channel, USES_OF[entry.use], cutoff_hz, asked.known_torque
            )
        ]
        view = InverseView(
            tuple(parts),
            bench,
            {name: laws[name] for name in chosen},
            unknown,
            asked.load_angle_known,
            asked.motor_angle_known,
        )
        _require_motion(view, recordings)
        return view

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
    """Relative tolerance of the torque in one unit of the channel."""
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
    """Frequency up to which the bench explains half of the signal, or the motion is resolved."""
    period = max(recording.sampling_period_s for recording in recordings)
    positions = [r.channels[MOTOR_POSITION] for r in recordings if MOTOR_POSITION in r.channels]
    resolved = WIDEST / period
    if positions:
        resolved = min(resolved_hz(positions, period), resolved)
    return coherent_hz(view_below(resolved)) or resolved


def _notes_on_sources(parts: Sequence[Compared], cutoff_hz: float, *, given: bool) -> Iterator[str]:
    """Notes on the source of speed and acceleration, and on the filter."""
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
    """What is compared of a recording, whole or in halves with a use each.

    The motion is that of the whole recording, so both halves have the same angle and time. What
    lies above the cut-off is compared too, for effects of motor orders, but not shown.
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
    # Bridged samples show no motion, and the filter spreads them.
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
    if len(range(*windows[0].rows.indices(recording.samples))) < FEWEST_SAMPLES:
        raise RecordingError(
            "The cut-off of the filter is too low for so short a recording: its ends reach all of "
            "it.",
            file=recording.place,
            found=f"{cutoff_hz:.3g} Hz in {recording.samples * period:.3g} s",
            expected="a longer recording, or a higher [comparison] cutoff_hz",
        )
    torques = (recording.channels[name] for name in known_torque)
    known = LowPass(sharp, period)(sum(torques, np.zeros(recording.samples)))
    parts = []
    for view in windows:
        signal = recording.channels[channel]
        # Below the cut-off as sharp as the motion, and no sharper.
        measured = view(signal if view.above else LowPass(sharp, period)(signal))
        excluded = None if out is None or not out[view.rows].any() else out[view.rows]
        time = recording.time_s[view.rows]
        white = low_pass.of_white_noise(view.rows.step, HIGHEST_ORDER + 1)
        whole = Piece(
            recording.name,
            channel,
            uses[0],
            time,
            measured,
            excluded,
            not view.above,
            None if view.above else white,
        )
        for use, rows in parts_of(uses, time.size // 2):
            parts.append(Compared(whole.part(rows, use), motion, known, view.part(rows)))
    return parts


def _require_motion(view: InverseView, recordings: Sequence[Recording]) -> None:
    """Refuse a part, fitted or predicted, in which nothing moves."""
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
    """Refuse a known angle without the motor's position."""
    if all(MOTOR_POSITION in recording.channels for recording in recordings):
        return
    for name in ("load_angle_known", "motor_angle_known"):
        if getattr(config.comparison, name):
            raise ConfigError(
                "Without the motor's position no angle is known.",
                where=f"[comparison] {name}",
                found=f"a recording without {MOTOR_POSITION}",
                expected=f"{MOTOR_POSITION} in every recording, or {name} left out",
            )


def _one_way(parts: Sequence[Compared]) -> Iterator[str]:
    """A note if the recordings turn one way only."""
    speed = np.concatenate([p.motion.speed for p in parts if p.piece.use == "used"])
    if abs(speed.sum()) >= ONE_WAY * np.abs(speed).sum():
        yield (
            "The recordings turn one way only: Coulomb friction, an offset and, at one speed, "
            "viscous friction can hardly be told apart; a recording in the other direction would "
            "separate them."
        )
