"""Free motion of a rigid bench without motor torque: its position is simulated and compared.

Start angle and speed of each recording, and the load's zero if it is unknown, are fitted with the
effects by nonlinear least squares: first with both usual frictions, then with what the posterior
contains. The trajectory is linearised at this fit; without an effect, it is extrapolated to size
zero. With one inertia, friction at the motor and at the load are the same law.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from scipy.optimize import least_squares

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import EffectParameter, RigidLaw
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import MOTOR_ANGLE, MOTOR_SPEED, STATES, Slot
from bayesbl.bench.learned import LearnedTerm
from bayesbl.bench.simulation import simulate_states
from bayesbl.diagnosis.inference import (
    AffineModel,
    Discrepancy,
    Inference,
    Look,
    Piece,
    Rows,
    Series,
    View,
    candidate_of,
)
from bayesbl.diagnosis.rigid.inverse import TORQUE_LAWS, without_load_angle
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
    piece_of,
    require_enough,
    require_no_known_torque,
    require_rigid,
    unknown_parameters,
    wanted,
)
from bayesbl.errors import ConfigError, RecordingError, SimulationError
from bayesbl.recording.types import MOTOR_POSITION, FloatArray, Recording
from bayesbl.units import RPM_PER_RAD_PER_S

ACCURACY = 1e-7
"""Largest error of the simulated speed, relative to the largest speed.

The simulator's steps change with the parameters, so its error jumps. At 1e-5, the jumps were as
large as finite differences by an effect, and fits ended early in different places.
"""

WIDTHS = (1e-3, 0.01, 0.3)
"""Least, first and largest speed over which dry friction changes sign, in RMS speeds."""

SHAPE_RANGE = (0.01, 2.0)
"""Range of a fading speed, in RMS speeds."""

SHAPES = tuple(np.geomspace(0.02, 1.0, 6))
"""Fading speeds to try, in RMS speeds."""

ORDERS = 4
"""Number of orders of a discrepancy torque."""

FIRST = ("motor_coulomb_friction", "motor_viscous_friction")
"""Effects of the first fit: without friction, it is too far off for a linearisation."""

STEP = 0.05
"""Step of a derivative, relative to the first size of a fit."""

FIRST_SHARE = 0.03
"""First size of an effect, relative to the acting torques."""

ZERO, WIDTH = "angle_zero", "friction_width"
_DRIVE = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad", "position_gain_per_s")


FREE_MOTION_LAWS: Mapping[str, RigidLaw] = MappingProxyType(
    {e.name: TORQUE_LAWS[e.name] for e in EFFECTS if e.free_motion}
)
"""Laws of effects that free motion shows."""

Values = Mapping[str, float]
"""Bench parameters, ``effect__parameter``, zero, width, and ``angle@i`` and ``speed@i``."""

Ranges = dict[str, tuple[float, float, float]]
"""First value, lower and upper bound of each."""


@dataclass(frozen=True)
class FreeMotionView(View):
    """Positions, rad, from the moment when the motor torque ends.

    ``effects``: effects that may be named; ``unknown``: free bench parameters; ``fitted``,
    ``values``: effects in the fit at which everything is linearised, and the fit's values;
    ``without``: prediction of the fit without any effect, (N,).
    """

    pieces: tuple[Piece, ...]
    bench: Bench
    effects: tuple[str, ...]
    unknown: tuple[str, ...] = ()
    load_angle_known: bool = True
    fitted: tuple[str, ...] = ()
    values: Values = field(default_factory=dict)
    without: FloatArray | None = None

    def prepared(self) -> FreeMotionView:
        """The view at a fit with the usual frictions."""
        nothing = self.fit((), {})
        view = replace(self, without=self.predictions((), nothing))
        first = tuple(name for name in FIRST if name in self.effects)
        return replace(view, fitted=first, values=self.fit(first, nothing))

    def refined(self, inference: Inference) -> FreeMotionView:
        """The view at a fit with the almost certain effects."""
        sure = {members[0] for members in inference.sure}
        names = tuple(name for name in self.effects if name in sure)
        start = dict(self.values)
        for name in names:
            estimates = inference.values(name)
            start |= {f"{name}__{key}": e.value for key, e in estimates.items()}
        return replace(self, fitted=names, values=self.fit(names, start))

    def settled(self, labels: Sequence[str]) -> FreeMotionView:
        """The view at the fit with these effects."""
        names = tuple(name for name in self.effects if name in labels)
        if names == self.fitted:
            return self
        return replace(self, fitted=names, values=self.fit(names, self.values))

    def reportable(self, inference: Inference, label: str) -> bool:
        """Whether an effect's shapes are inside their range: its end is no optimum."""
        low, high = (share * self._speed for share in SHAPE_RANGE)
        shapes = [v for k, v in self.values.items() if k == f"{label}__speed_rad_per_s"]
        return all(1.01 * low < value < 0.99 * high for value in shapes)

    def fit(self, effects: tuple[str, ...], start: Values) -> dict[str, float]:
        """Values of the least-squares fit with these effects, from those in ``start``."""
        places = range(len(self.pieces))
        used = [i for i in places if self.pieces[i].use == "used"]
        ranges = self._shared(effects)
        for i in used:
            ranges |= self._own(i)
        ranges = {n: (start.get(n, first), a, b) for n, (first, a, b) in ranges.items()}
        values = self._least_squares(used, effects, ranges, {})
        for i in (i for i in places if i not in used):
            values = self._least_squares([i], effects, self._own(i), values)
        return values

    def _least_squares(
        self, pieces: Sequence[int], effects: tuple[str, ...], ranges: Ranges, known: Values
    ) -> dict[str, float]:
        """Known values, and the values within ranges that fit some pieces best."""
        first, low, high = np.transpose(list(ranges.values()))
        # A value that starts at zero is scaled by the largest one.
        scale = np.maximum(np.abs(first), 1e-3 * (np.abs(first).max() or self._speed))

        def values_at(x: FloatArray) -> dict[str, float]:
            return {**known, **dict(zip(ranges, (x * scale).tolist(), strict=True))}

        def misfit(x: FloatArray) -> FloatArray:
            values = values_at(x)
            every = ((self.pieces[i], self._predict(i, effects, values)) for i in pieces)
            return np.concatenate([p.kept(predicted - p.measured) for p, predicted in every])

        optimum = least_squares(
            misfit,
            np.clip(first, low, high) / scale,
            bounds=(low / scale, high / scale),
            diff_step=1e-4,
            xtol=1e-6,
            ftol=1e-8,
            max_nfev=60,
        )
        return values_at(optimum.x)

    @cached_property
    def rows(self) -> Rows:
        """Rows of all pieces."""
        return Rows(self.pieces)

    def predictions(
        self, effects: tuple[str, ...], values: Values, torque: LearnedTerm | None = None
    ) -> FloatArray:
        """Simulated position of every row, (N,)."""
        return self.rows.stack(lambda i: self._predict(i, effects, values, torque))

    @cached_property
    def model(self) -> AffineModel:
        """Trajectories linearised at the fit."""
        at = self.predictions(self.fitted, self.values)

        def slope(effects: tuple[str, ...], changed: Values, step: float) -> FloatArray:
            moved = self.predictions(effects, {**self.values, **changed})
            return np.asarray((moved - at) / step)

        base, nuisances = at.copy(), dict[str, FloatArray]()
        for name in (*self.unknown, *(n for n in (ZERO, WIDTH) if n in self.values)):
            step = 1e-4 * max(abs(self.values[name]), 1e-2)
            nuisances[name] = slope(self.fitted, {name: self.values[name] + step}, step)
            if name in self.unknown:  # a nuisance is the difference from the bench's value
                base -= nuisances[name] * (self.values[name] - self.bench.value(name))
        for key in ("angle", "speed"):
            own = [f"{key}@{i}" for i in range(len(self.pieces))]
            step = 1e-4 * max(1e-2, *(abs(self.values[name]) for name in own))
            every = slope(self.fitted, {name: self.values[name] + step for name in own}, step)
            for name, rows in zip(own, self.rows.slices, strict=True):
                nuisances[name] = np.zeros(at.size)
                nuisances[name][rows] = every[rows]
        candidates = []
        for name in self.effects:
            law, effect = TORQUE_LAWS[name], effect_named(name)
            parameters = (law.amplitude, *law.linear)
            grid: tuple[float | None, ...] = (None,)
            if law.scanned is not None:
                grid = tuple(share * self._speed for share in SHAPES)
                if name in self.fitted:
                    grid = (self.values[f"{name}__{law.scanned}"],)
            effects = tuple(dict.fromkeys((*self.fitted, name)))
            there = {f"{name}__{p}": self.values.get(f"{name}__{p}", 0.0) for p in parameters}
            looks = []
            for value in grid:
                shapes = {} if law.scanned is None or value is None else {law.scanned: value}
                fixed = there | {f"{name}__{k}": v for k, v in shapes.items()}
                columns = []
                for parameter in parameters:
                    step = STEP * self._first(effect.parameter(parameter))
                    key = f"{name}__{parameter}"
                    columns.append(slope(effects, {**fixed, key: there[key] + step}, step))
                    base -= columns[-1] * there[key]
                weight = 1.0 if law.scanned is None else 1.0 / len(SHAPES)
                looks.append(Look(shapes, np.column_stack(columns), weight))
            candidates.append(candidate_of(law, name, parameters, tuple(looks)))
        return AffineModel(
            self.rows,
            base,
            nuisances,
            tuple(candidates),
            tuple(
                Discrepancy(s.kind, self._waves(at, s), s, s.variable == "motor_speed")
                for s in self._series()
            ),
            believed_sds(self.bench, self.unknown),
            without=self.without,
        )

    def _series(self) -> Iterator[Series]:
        """Discrepancy torques over the load's angle and the speed."""
        ratio = self.bench.value("gear_ratio")
        states = [
            self._states(i, self.fitted, self.values)
            for i, piece in enumerate(self.pieces)
            if piece.use == "used"
        ]
        angle = np.concatenate([s[MOTOR_ANGLE] for s in states]) / ratio
        speed = np.concatenate([s[MOTOR_SPEED] for s in states])
        way, fastest = 2.0 * float(np.ptp(angle)), 4.0 * float(np.abs(speed).max())
        ends = [(float(x.min()), float(x.max())) for x in (angle, speed)]
        for reverses in (False, True):
            yield Series("load_angle", way, reverses, ORDERS, ends[0])
        yield Series("motor_speed", fastest, False, ORDERS, ends[1])

    def _waves(self, at: FloatArray, series: Series) -> FloatArray:
        """Derivatives of the trajectories by the coefficients of a torque, (N, 2 orders)."""
        size = STEP * self._torque
        torques = (series.torque(one) for one in size * np.eye(2 * series.orders))
        made = [self.predictions(self.fitted, self.values, torque) - at for torque in torques]
        return np.column_stack(made) / size

    def _shared(self, effects: tuple[str, ...]) -> Ranges:
        """Ranges of what all recordings share."""
        ranges: Ranges = {}
        for name in self.unknown:
            value = self.bench.value(name)
            ranges[name] = value, 1e-6 * value, np.inf
        if not self.load_angle_known:
            ranges[ZERO] = 1e-3, -np.inf, np.inf
        if any("direction" in effect_named(name).depends_on for name in effects):
            least, first, most = (share * self._speed for share in WIDTHS)
            ranges[WIDTH] = first, least, most
        for name in effects:
            effect = effect_named(name)
            for item in effect.parameters:
                if effect.sought_alone not in (None, item.name):
                    continue
                low = 0.0 if item.not_negative else -np.inf
                high = np.inf if item.unit else item.high
                if not item.is_amplitude:
                    low, high = (share * self._speed for share in SHAPE_RANGE)
                ranges[f"{name}__{item.name}"] = self._first(item), low, high
        return ranges

    def _own(self, i: int) -> Ranges:
        """Ranges of angle and speed at a piece's first sample."""
        piece, few = self.pieces[i], max(4, self.pieces[i].measured.size // 100)
        time, angle = piece.time_s[:few] - piece.time_s[0], piece.measured[:few]
        first = zip(("speed", "angle"), np.polyfit(time, angle, 1).tolist(), strict=True)
        return {f"{key}@{i}": (value, -np.inf, np.inf) for key, value in reversed([*first])}

    def _first(self, parameter: EffectParameter) -> float:
        """First value of a parameter: a small share of the acting torques."""
        if not parameter.is_amplitude:
            return 0.3 * self._speed
        return {
            "N m": self._torque,
            "N m s/rad": self._torque / self._speed,
            "": FIRST_SHARE,
            "N m/s": 0.1 * self._torque,
        }[parameter.unit]

    @cached_property
    def _torque(self) -> float:
        """A small share of the acting torques, N m at the motor."""
        ratio = self.bench.value("gear_ratio")
        torque = FIRST_SHARE * self.bench.value("gravity_torque_nm") / ratio
        if torque == 0.0:
            span = max(p.time_s[-1] - p.time_s[0] for p in self.pieces)
            inertia = self.bench.value("load_inertia_kg_m2") / ratio**2
            inertia += self.bench.value("motor_inertia_kg_m2")
            torque = 0.3 * inertia * self._speed / span
        return torque

    @cached_property
    def _speed(self) -> float:
        """Standard deviation of the speed in the fastest piece, rad/s."""
        return max(
            float(np.std(np.diff(p.kept(p.measured)) / np.diff(p.kept(p.time_s))))
            for p in self.pieces
        )

    def _predict(
        self, i: int, effects: tuple[str, ...], values: Values, torque: LearnedTerm | None = None
    ) -> FloatArray:
        """Simulated position of a piece, (n,)."""
        try:
            states = self._states(i, effects, values, torque)
        except SimulationError:
            # A step that cannot be simulated must look bad to the fit.
            return np.full(self.pieces[i].measured.size, 1e3)
        return np.asarray(states[MOTOR_ANGLE] - values.get(ZERO, 0.0))

    def _states(
        self, i: int, effects: tuple[str, ...], values: Values, torque: LearnedTerm | None = None
    ) -> FloatArray:
        piece = self.pieces[i]
        owners = (*self.unknown, *effects)
        settings = {name: x for name, x in values.items() if name.partition("__")[0] in owners}
        bench = self.bench if torque is None else replace(self.bench, learned_torque=torque)
        vector = bench.vector(**settings, **dict.fromkeys(_DRIVE, 0.0))[0]
        state = np.zeros(STATES)
        state[MOTOR_ANGLE] = values[f"angle@{i}"] + values.get(ZERO, 0.0)
        state[MOTOR_SPEED] = values[f"speed@{i}"]
        vector[Slot.reference_speed_rpm] = self._speed * RPM_PER_RAD_PER_S
        return simulate_states(
            vector,
            state,
            piece.measured.size,
            1.0 / piece.period_s,
            accuracy_rpm=ACCURACY * self._speed * RPM_PER_RAD_PER_S,
            friction_width_rad_per_s=values.get(WIDTH, WIDTHS[1] * self._speed),
        )


CHANNELS = (MOTOR_POSITION,)


def pieces_of(task: Task, recordings: Sequence[Recording], channel: str) -> tuple[Piece, ...]:
    """Pieces to fit and to predict; a recording is split after half of its travel."""
    pieces = []
    for entry, recording in zip(task.config.recordings, recordings, strict=True):
        way = np.cumsum(np.abs(np.diff(recording.channels[channel])))
        middle = int(np.searchsorted(way, 0.5 * way[-1]))
        whole = piece_of(recording, channel)
        for use, rows in parts_of(USES_OF[entry.use], middle):
            pieces.append(whole.part(rows, use))
            require_enough(recording, channel, pieces[-1].excluded)
    return tuple(pieces)


def comparison(task: Task) -> Comparison:
    """Comparison of a task; raises ``UserError`` if bench or recordings do not suit the method."""
    require_rigid(task)
    config, bench, compared = task.config, task.bench, task.config.comparison
    channel = compared_channel(task, CHANNELS, "Free motion is compared by the motor's position.")
    recordings = even_recordings(task, ())
    require_no_known_torque(task, "Free motion has no torque but the bench's own.")
    unknown = config.unknowns.bench_parameters
    gravity = bench.value(GRAVITY) > 0.0
    if GRAVITY in unknown and set(INERTIAS) & set(unknown):
        raise ConfigError(
            "Without any measured torque all torques and inertias scaled together look the same.",
            where="[unknowns] bench_parameters",
            found=", ".join(unknown),
            expected="inertia or gravity, not both",
        )
    if GRAVITY not in unknown:
        unknown_parameters(task)
    pieces = pieces_of(task, recordings, channel)
    laws = FREE_MOTION_LAWS
    if not (compared.load_angle_known and gravity):
        laws = without_load_angle(laws)
    effects = wanted(config, bench, laws)
    view = FreeMotionView(pieces, bench, effects, unknown, compared.load_angle_known or not gravity)
    for piece in pieces:
        kept = piece.kept(piece.measured)
        if not kept.size or not np.ptp(kept) > 0.0:
            raise RecordingError(
                "Nothing moves in a part that is to be fitted or predicted.",
                file=next(r.place for r in recordings if r.name == piece.name),
                where=channel,
                found=f"a part of {kept.size} samples in which it never changes",
                expected="a recording of a motion from its start to its end",
            )
    scale = "gravity" if gravity else "the inertia"
    notes = [
        *notes_of(recordings),
        f"No torque is measured: friction is known as well as {scale} of the bench is.",
        "Torque ripple, encoder and shaft effects are not tried in free motion.",
    ]
    return by_search(task, view, effects, notes)
