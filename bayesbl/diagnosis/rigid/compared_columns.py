"""What an inverse comparison puts side by side: columns of a piece by name, each computed once."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import ORDER, PHASE
from bayesbl.bench.effects import effect_named
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.rigid.learned_waves import LearnedWaves
from bayesbl.diagnosis.rigid.motion import Motion
from bayesbl.diagnosis.rigid.staying_columns import least_squares
from bayesbl.diagnosis.rigid.terms import (
    SKEW,
    TORQUE_TERMS,
    ShapedEffect,
    ShapedEffects,
    Term,
    required_torque,
)
from bayesbl.diagnosis.rigid.view import View, noise_of
from bayesbl.recording.types import FloatArray

Values = dict[str, float]
Columns = dict[str, FloatArray]

WIDTH = "friction_width"

QUIET = 0.5
"""Of the torque's noise: so much in the motion makes a standard deviation an eighth too small."""


@dataclass(frozen=True, slots=True)
class ComparedColumns:
    """Motion of every piece, and what the bench and every effect make of it.

    Attributes
    ----------
    motions, known
        For every piece, over its whole recording: motion, and known torques at the motor, N m.
    views
        For every piece: what is compared of a signal over its recording.
    terms
        Effects that may take part.
    unknown
        Bench parameters that are fitted: inertias and the gravity torque.
    unit
        N m or rad in one unit of the channel: K_t where current is compared.
    load
        The load's position is compared; its zero is fitted for each recording.
    gravity_free
        Gravity's size and direction are fitted in each recording.
    load_angle_known, phases_shared
        The motor position tells the load's angle, so gravity's direction; it is absolute, so one
        phase holds for all recordings. Without either, sine and cosine are free per recording.
    waves
        Lines that are allowed for, each as an order of the motor's turning with its own size and
        phase in every recording.
    learned
        A torque that is being learned: its waves are fitted with everything else.
    seen, moved
        For every piece, what has been computed of it; its motion by the last skew that it had.
    """

    pieces: tuple[Piece, ...]
    motions: tuple[Motion, ...]
    known: tuple[FloatArray, ...]
    views: tuple[View, ...]
    bench: Bench
    terms: Mapping[str, Term]
    unknown: tuple[str, ...] = ()
    unit: float = 1.0
    load: bool = False
    gravity_free: bool = False
    load_angle_known: bool = False
    phases_shared: bool = False
    waves: tuple[float, ...] = ()
    learned: LearnedWaves | None = None
    seen: tuple[dict[Hashable, FloatArray], ...] = field(default=(), repr=False, compare=False)
    moved: tuple[dict[tuple[float, float], Motion], ...] = field(
        default=(), init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self.seen:
            object.__setattr__(self, "seen", tuple({} for _ in self.pieces))
        object.__setattr__(self, "moved", tuple({} for _ in self.pieces))

    @property
    def _used(self) -> list[int]:
        return [i for i, piece in enumerate(self.pieces) if piece.use == "used"]

    def _directional(self, effects: Collection[str]) -> bool:
        """Whether dry friction takes part, named or in the bench."""
        names = (*effects, *(e.name for e in self.bench.effects))
        return not self.load and any("direction" in effect_named(n).depends_on for n in names)

    def _seen(self, i: int, key: Hashable, make: Callable[[], FloatArray]) -> FloatArray:
        """A signal over a recording as it is compared, computed once."""
        known = self.seen[i]
        if key not in known:
            known[key] = self.views[i](make())
        return known[key]

    def _motion(self, i: int, shaped: ShapedEffects) -> Motion:
        """Motion as the compared channel shows it: a channel that lags shows what was."""
        skew, known = shaped.skew_s, self.moved[i]
        if skew not in known:
            known.clear()
            current_s, position_s = skew
            motion = self.motions[i]
            for late_s in (current_s, -position_s):
                if late_s:
                    motion = motion.shifted(late_s)
            known[skew] = motion
        return replace(known[skew], friction_width=shaped.width)

    def _base(self, i: int, shaped: ShapedEffects) -> FloatArray:
        """The nominal bench, and effects that no coefficient scales, in units of the channel."""
        skew = shaped.skew_s
        if self.load:
            ratio = self.bench.value("gear_ratio")
            base = self._seen(i, ("base", skew), lambda: self._motion(i, shaped).angle / ratio)
            for effect in shaped.effects:
                if effect.name != SKEW and effect.term.candidate.amplitude in effect.shape:
                    base = base + self._signal(i, effect.term, effect.shape, shaped)
            return base
        bench = self.bench
        above = self.views[i].above
        width = shaped.width if self._directional(()) and not above else None

        def torque() -> FloatArray:
            known = {} if self.load_angle_known else {"gravity_torque_nm": 0.0}
            needed = required_torque(self._motion(i, shaped), bench.with_parameters(**known))
            return np.asarray((needed + self.known[i]) / self.unit)

        def waves() -> FloatArray:
            motion = self._motion(i, shaped)
            parts = [
                TORQUE_TERMS[e.name].law.signal(motion, bench, e.complete())
                for e in bench.effects
                if e.name in TORQUE_TERMS and TORQUE_TERMS[e.name].law.scanned == ORDER
            ]
            return np.asarray(sum(parts, np.zeros_like(motion.angle)) / self.unit)

        needed = self._seen(i, ("base", skew, width), torque)
        if not above:
            return needed
        return self._seen(i, ("waves", skew), waves) + self._along(i, shaped, needed)

    def _along(self, i: int, shaped: ShapedEffects, signal: FloatArray) -> FloatArray:
        """The part of what is compared above the cut-off that turns with the motor as effects do.

        A ripple that the loop is too slow for is in the motion, not in the current. Of the
        acceleration up there little but noise is known, yet along one order little of that is left.
        Where that is no small part of the noise of what is compared, nothing is taken.
        """
        made = [
            self._waves(i, effect, shaped)
            for effect in shaped.effects
            if ORDER in effect.shape and self._is_quiet(i, effect.shape[ORDER])
        ]
        if not made:
            return np.zeros_like(signal)
        matrix = np.column_stack([column for columns in made for column in columns])
        kept = self.pieces[i].kept
        return np.asarray(matrix @ least_squares(kept(matrix), kept(signal)))

    def _is_quiet(self, i: int, order: float) -> bool:
        """Whether J (n ω)² σ, by noise σ of the position, is a small part of the torque's noise."""
        ratio, piece, view = self.bench.value("gear_ratio"), self.pieces[i], self.views[i]
        inertia = self.bench.value("motor_inertia_kg_m2")
        inertia += self.bench.value("load_inertia_kg_m2") / ratio**2
        frequency = order * np.abs(piece.kept(self.motions[i].speed[view.rows]))
        shown = frequency[frequency > 2.0 * math.pi * view.low_pass.cutoff_hz]
        if not shown.size:
            return True
        made = inertia * math.sqrt(float(np.mean(shown**4))) * view.position_noise_rad
        return made < QUIET * self.unit * noise_of(piece.kept(piece.measured))

    def _waves(self, i: int, effect: ShapedEffect, shaped: ShapedEffects) -> list[FloatArray]:
        """Sine and cosine of an effect that turns with the motor, of unit size."""
        amplitude = effect.term.candidate.amplitude
        return [
            self._signal(i, effect.term, {amplitude: 1.0, PHASE: phase, **effect.shape}, shaped)
            for phase in (0.0, 0.5 * math.pi)
        ]

    def _signal(
        self, i: int, term: Term, parameters: Mapping[str, float], shaped: ShapedEffects
    ) -> FloatArray:
        """An effect's law with these parameters, in units of the channel, as compared."""
        width = shaped.width if term.has_direction else None
        unit = 1.0 if self.load else self.unit
        return self._seen(
            i,
            (term.candidate.name, *parameters.items(), shaped.skew_s, width),
            lambda: term.law.signal(self._motion(i, shaped), self.bench, parameters) / unit,
        )

    def _columns(
        self, i: int, shaped: ShapedEffects, names: Collection[str] | None = None
    ) -> Columns:
        """Linear coefficients by name to what one of each adds; of all effects or of some."""
        found = self._allowed_for(i, shaped) | self._nuisances(i, shaped)
        where = "" if self.phases_shared else f"@{self.pieces[i].name}"
        for effect in shaped.effects:
            if names is not None and effect.name not in names:
                continue
            name, term, shape = effect.name, effect.term, effect.shape
            amplitude = term.candidate.amplitude
            if amplitude in shape or (self.views[i].above and ORDER not in shape):
                continue
            if term.periodic:
                waves = self._waves(i, effect, shaped)
                found |= {
                    f"{name}.{label}{where}": wave
                    for label, wave in zip(("sine", "cosine"), waves, strict=True)
                }
                continue
            off = dict.fromkeys((amplitude, *term.law.linear), 0.0)
            for parameter in off:
                one = {**off, parameter: 1.0, **shape}
                found[f"{name}.{parameter}"] = self._signal(i, term, one, shaped)
        return found

    def _allowed_for(self, i: int, shaped: ShapedEffects) -> Columns:
        """Sine and cosine of the orders in :attr:`waves`."""
        return {
            f"{label} {order}@{self.pieces[i].name}": self._seen(
                i,
                (label, order, shaped.skew_s),
                lambda order=order, phase=phase: np.sin(  # type: ignore[misc]
                    order * self._motion(i, shaped).angle + phase
                ),
            )
            for order in self.waves
            for label, phase in (("sine", 0.0), ("cosine", 0.5 * math.pi))
        }

    def _nuisances(self, i: int, shaped: ShapedEffects) -> Columns:
        """What is fitted of the bench itself."""
        ratio, where = self.bench.value("gear_ratio"), self.pieces[i].name
        skew = shaped.skew_s
        if self.load:
            ones = np.ones_like(self.motions[i].angle)
            return {f"offset@{where}": self._seen(i, "offset", lambda: ones)}
        if self.views[i].above:
            return {}

        def of(name: str, make: Callable[[Motion], FloatArray]) -> FloatArray:
            return self._seen(i, (name, skew), lambda: make(self._motion(i, shaped)) / self.unit)

        found = {}
        for name in self.unknown:
            if name == "motor_inertia_kg_m2":
                found[name] = of(name, lambda motion: motion.acceleration)
            elif name == "load_inertia_kg_m2":
                found[name] = of(name, lambda motion: motion.acceleration / ratio**2)
            elif self.load_angle_known:
                found[name] = of(name, lambda motion: np.sin(motion.angle / ratio) / ratio)
        if self.gravity_free:
            sine = of("gravity sine", lambda motion: np.sin(motion.angle / ratio) / ratio)
            cosine = of("gravity cosine", lambda motion: np.cos(motion.angle / ratio) / ratio)
            found |= {f"gravity_sine@{where}": sine, f"gravity_cosine@{where}": cosine}
        if self.learned is not None:
            for name, wave in self.learned.by_name(ratio).items():
                found[name] = of(name, wave)
        return found
