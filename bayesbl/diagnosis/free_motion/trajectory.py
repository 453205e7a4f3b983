"""Free motion of a rigid bench: let go without motor torque, the position simulated and compared.

Start angle and speed of every recording are fitted with the effects, and where the load's zero is
unless it is known: nonlinear least squares on the simulated position. On one inertia friction at
the motor and at the load are the same law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import EffectParameter, Shape
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import MOTOR_ANGLE, MOTOR_SPEED, STATES, Slot
from bayesbl.bench.simulation import simulate_states
from bayesbl.diagnosis.comparison import EffectsFit, Piece, TestedEffect
from bayesbl.diagnosis.rigid.compared_columns import WIDTH
from bayesbl.diagnosis.rigid.terms import TORQUE_TERMS
from bayesbl.errors import BenchError
from bayesbl.recording.types import MOTOR_SPEED as SPEED_CHANNEL
from bayesbl.recording.types import FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

ACCURACY = 1e-7
"""Largest error of the simulated speed, as a share of the largest speed.

The simulation's steps change with the parameters, so its error jumps: at 1e-5 as much as the finite
differences see of an effect, and searches ended early, each elsewhere.
"""

WIDTHS = (1e-3, 0.01, 0.3)
"""Speed over which dry friction changes its sign, in RMS speeds: least, first and largest."""

SHAPE_RANGE = (0.01, 2.0)
"""Of a fading speed, in RMS speeds."""

_ZERO = "angle_zero"
_FIRST_SHARE = 0.03
_DRIVE = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad", "position_gain_per_s")


def free_motion_candidates(load_angle_known: bool) -> tuple[TestedEffect, ...]:
    """Catalogue effects in the order they are tried: one at a time, each fit takes simulations."""
    return tuple(
        replace(TORQUE_TERMS[effect.name].candidate, is_plain=False)
        for effect in EFFECTS
        if effect.free_motion and (load_angle_known or "load_angle" not in effect.depends_on)
    )


@dataclass(frozen=True, slots=True)
class FreeMotionComparison:
    """Pieces that begin when the motor lets go; position in rad, or speed in rpm, of the motor.

    ``starts`` holds angle and speed near each start, shape (2,), rad and rad/s.
    """

    pieces: tuple[Piece, ...]
    starts: tuple[FloatArray, ...]
    bench: Bench
    candidates: tuple[TestedEffect, ...]
    unknown: tuple[str, ...] = ()
    load_angle_known: bool = True

    def fit(self, effects: tuple[str, ...], start: EffectsFit | None = None) -> EffectsFit:
        """Least squares with these effects, from what ``start`` found."""
        shared = self._shared(effects, start)
        used = [i for i, piece in enumerate(self.pieces) if piece.use == "used"]
        names = [*shared, *(f"{key}@{i}" for i in used for key in ("angle", "speed"))]
        first = [
            *(value for value, _, _ in shared.values()),
            *np.concatenate([self.starts[i] for i in used]),
        ]
        low = [*(bound for _, bound, _ in shared.values()), *[-np.inf] * (2 * len(used))]
        high = [*(bound for _, _, bound in shared.values()), *[np.inf] * (2 * len(used))]
        # What begins at rest at zero has the size of its motion.
        scale = np.maximum(np.abs(first), 1e-3 * (np.abs(first).max() or self._speed))

        def misfit(x: FloatArray) -> FloatArray:
            values = dict(zip(names, x * scale, strict=True))
            parts = [
                self._misfit(i, effects, values, values[f"angle@{i}"], values[f"speed@{i}"])
                for i in used
            ]
            return np.concatenate(parts)

        found = least_squares(
            misfit,
            np.clip(np.array(first) / scale, np.array(low) / scale, np.array(high) / scale),
            bounds=(np.array(low) / scale, np.array(high) / scale),
            diff_step=1e-4,
            xtol=1e-6,
            ftol=1e-8,
            max_nfev=60,
        )
        values = dict(zip(names, (found.x * scale).tolist(), strict=True))
        predictions = [self._own_start(i, effects, values) for i in range(len(self.pieces))]
        sizes = np.cumsum([self.pieces[i].kept(self.pieces[i].measured).size for i in used])[:-1]
        columns = tuple(np.split(found.jac / scale, sizes))
        return EffectsFit(
            {
                name: {
                    key.partition(".")[2]: value
                    for key, value in values.items()
                    if key.startswith(name + ".")
                }
                for name in effects
            },
            {name: values[name] for name in self.unknown},
            tuple(predictions),
            columns,
            tuple(names),
            at_edge=frozenset(
                name.partition(".")[0]
                for name, active in zip(names, found.active_mask, strict=True)
                if active and "." in name
            ),
            shared={WIDTH: values[WIDTH]} if WIDTH in values else {},
        )

    def folds(self) -> list[FreeMotionComparison]:
        """The used pieces twice, one half of them to fit on and the other to predict."""
        used = [i for i, piece in enumerate(self.pieces) if piece.use == "used"]
        chosen = [(self.pieces[i], self.starts[i]) for i in used]
        if len(used) == 1:
            piece, start = chosen[0]
            first, second = piece.half(False), piece.half(True)
            chosen = [(first, start), (second, start_of(second))]
        return [
            replace(
                self,
                pieces=tuple(
                    replace(piece, use="used" if k % 2 == turn else "held_out")
                    for k, (piece, _) in enumerate(chosen)
                ),
                starts=tuple(start for _, start in chosen),
            )
            for turn in (0, 1)
        ]

    def _shared(
        self, effects: tuple[str, ...], start: EffectsFit | None
    ) -> dict[str, tuple[float, float, float]]:
        """Name to (first value, lower, upper bound) of what all recordings share."""
        shared = {}
        for name in self.unknown:
            value = self.bench.value(name) if start is None else start.bench[name]
            shared[name] = (value, 1e-6 * value, np.inf)
        if not self.load_angle_known:
            shared[_ZERO] = (1e-3, -np.inf, np.inf)
        if any("direction" in effect_named(name).depends_on for name in effects):
            low, first, high = (share * self._speed for share in WIDTHS)
            known_width = start.shared.get(WIDTH, first) if start else first
            shared[WIDTH] = (known_width, low, high)
        for name in effects:
            candidate = next(c for c in self.candidates if c.name == name)
            known: Mapping[str, float] = start.effects.get(name, {}) if start else {}
            for item in effect_named(name).parameters:
                lower = 0.0 if candidate.not_negative else -np.inf
                upper = np.inf if item.unit else item.high
                if isinstance(item, Shape):
                    lower, upper = (share * self._speed for share in SHAPE_RANGE)
                value = known.get(item.name, self._first(item))
                shared[f"{name}.{item.name}"] = (value, lower, upper)
        return shared

    def _first(self, parameter: EffectParameter) -> float:
        """A small share of the torques at work: where a search for an effect starts."""
        speed = self._speed
        if isinstance(parameter, Shape):
            return 0.3 * speed
        ratio = self.bench.value("gear_ratio")
        torque = _FIRST_SHARE * self.bench.value("gravity_torque_nm") / ratio
        if torque == 0.0:
            span = max(p.time_s[-1] - p.time_s[0] for p in self.pieces)
            inertia = self.bench.value("load_inertia_kg_m2") / ratio**2
            inertia += self.bench.value("motor_inertia_kg_m2")
            torque = 0.3 * inertia * speed / span
        scales = {
            "N m": torque,
            "N m s/rad": torque / speed,
            "": _FIRST_SHARE,
            "N m/s": 0.1 * torque,
        }
        return scales[parameter.unit]

    @property
    def _speed(self) -> float:
        """Standard deviation of the speed in the fastest piece, rad/s."""
        if self.pieces[0].channel == SPEED_CHANNEL:
            return max(float(np.std(p.kept(p.measured))) for p in self.pieces) / RPM_PER_RAD_PER_S
        return max(
            float(np.std(np.diff(p.kept(p.measured)) / np.diff(p.kept(p.time_s))))
            for p in self.pieces
        )

    def _own_start(
        self, i: int, effects: tuple[str, ...], values: Mapping[str, float]
    ) -> FloatArray:
        """Prediction of a piece; the start of a held-out one is fitted on it first."""
        if f"angle@{i}" in values:
            return self._predict(i, effects, values, values[f"angle@{i}"], values[f"speed@{i}"])
        found = least_squares(
            lambda x: self._misfit(i, effects, values, *x),
            self.starts[i],
            diff_step=1e-4,
            x_scale=[0.1, 1.0],
        )
        return self._predict(i, effects, values, *found.x)

    def _misfit(
        self, i: int, effects: tuple[str, ...], values: Mapping[str, float], *start: float
    ) -> FloatArray:
        """Prediction less measurement from a start (angle in rad, speed in rad/s), shape (k,)."""
        piece = self.pieces[i]
        return piece.kept(self._predict(i, effects, values, *start) - piece.measured)

    def _predict(
        self,
        i: int,
        effects: tuple[str, ...],
        values: Mapping[str, float],
        angle: float,
        speed: float,
    ) -> FloatArray:
        piece = self.pieces[i]
        settings = {name: values[name] for name in self.unknown}
        for name in effects:
            settings |= {
                key.replace(".", "__"): value
                for key, value in values.items()
                if key.startswith(name + ".")
            }
        vector = self.bench.vector(**settings, **dict.fromkeys(_DRIVE, 0.0))[0]
        zero = values.get(_ZERO, 0.0)
        state = np.zeros(STATES)
        state[MOTOR_ANGLE], state[MOTOR_SPEED] = angle + zero, speed
        vector[Slot.reference_speed_rpm] = self._speed * RPM_PER_RAD_PER_S
        try:
            states = simulate_states(
                vector,
                state,
                piece.measured.size,
                1.0 / piece.period_s,
                accuracy_rpm=ACCURACY * self._speed * RPM_PER_RAD_PER_S,
                friction_width_rad_per_s=values.get(WIDTH, WIDTHS[1] * self._speed),
            )
        except BenchError:
            # A step of the search beyond what can be simulated: far off, and so turned back.
            return np.full(piece.measured.size, 1e3)
        if piece.channel == SPEED_CHANNEL:
            return np.asarray(states[MOTOR_SPEED] * RPM_PER_RAD_PER_S)
        return np.asarray(states[MOTOR_ANGLE] - zero)


def start_of(piece: Piece) -> FloatArray:
    """Angle and speed near the first sample, where the fit of the start begins; rad, rad/s."""
    if piece.channel == SPEED_CHANNEL:
        return np.array([0.1, piece.measured[0] / RPM_PER_RAD_PER_S])
    few = max(4, piece.measured.size // 100)
    slope, angle = np.polyfit(piece.time_s[:few] - piece.time_s[0], piece.measured[:few], 1)
    return np.array([angle, slope])
