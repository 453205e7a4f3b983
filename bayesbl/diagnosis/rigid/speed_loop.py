"""A rigid drive under its speed controller, from the speed alone at several speeds.

    (J s + b) ω = −τ + L C (ω_ref − ω_meas),   ω_meas = F (ω + s ε),
    C = (K_p + K_i/s)(1 + k_pos/s),   L = 1/(1 + T_i s),   F = 1/(1 + T_ω s)

with a torque τ that brakes and an error ε of the measured angle:

    ω_meas = F (−τ + (J s + b) s ε) / (J s + b + L C F)

An error of the angle is thus what a torque of (J s + b) s ε would be: one amplitude of either gives
lines that differ by the square of the speed, whatever the controller is. The size of each order's
line at each speed is compared with what one torque, or one error, would give, all orders together
and with the loop's own unknowns. Phases are free: where the motor starts is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import HIGHEST_ORDER
from bayesbl.diagnosis.diagnosis import Diagnosis, Estimate, NamedEffect, ParameterError, verdict_of
from bayesbl.diagnosis.disagreement import ComparedPiece, ResidualNoise, Use
from bayesbl.diagnosis.inference import (
    MOST_EFFECTS,
    AffineModel,
    Candidate,
    Discrepancy,
    Inference,
    Look,
    Piece,
    Rows,
    compared_pieces,
    inferred,
)
from bayesbl.diagnosis.rigid.motion import WIDEST
from bayesbl.diagnosis.rigid.orders import FEWEST_CYCLES, OrderedRest, Peak, clearest, spectrum_of
from bayesbl.diagnosis.task import (
    USES_OF,
    Comparison,
    Task,
    even_recordings,
    notes_of,
    parts_of,
    piece_of,
    require_no_known_torque,
    require_rigid,
    wanted,
)
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.model_search.linear import MisfitBand, bounded_least_squares
from bayesbl.model_search.residuals import Unexplained
from bayesbl.progress import StageProgress
from bayesbl.recording.checks import is_one_speed, require_channels
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED, BoolArray, ComplexArray, FloatArray
from bayesbl.units import RPM_PER_RAD_PER_S

LOOP_PARAMETERS = (
    "motor_inertia_kg_m2",
    "load_inertia_kg_m2",
    "speed_gain_nm_s_per_rad",
    "integral_gain_nm_per_rad",
    "position_gain_per_s",
)

FRICTION, CURRENT_LAG, SENSOR_LAG = "motor_viscous_friction", "current_loop_lag", "speed_sensor_lag"
LOOP_EFFECTS = {
    FRICTION: "coefficient_nm_s_per_rad",
    CURRENT_LAG: "time_s",
    SENSOR_LAG: "time_s",
}
"""Effects that change the loop, and the parameter that is zero without each."""

Values = Mapping[str, float]
"""Loop parameters and the sizes of :data:`LOOP_EFFECTS`, by name; ``gear_ratio`` among them."""


def loop_values(bench: Bench) -> dict[str, float]:
    """Of a bench, with what its effects do to the loop."""
    values = {name: bench.value(name) for name in ("gear_ratio", *LOOP_PARAMETERS)}
    values |= dict.fromkeys(LOOP_EFFECTS, 0.0)
    for effect in bench.effects:
        given = effect.complete()
        if effect.name in LOOP_EFFECTS:
            values[effect.name] += given[LOOP_EFFECTS[effect.name]]
        if effect.name == "load_viscous_friction":
            at_motor = given["coefficient_nm_s_per_rad"] / values["gear_ratio"] ** 2
            values[FRICTION] += at_motor
    return values


def speed_of_torque(values: Values, frequency: FloatArray) -> ComplexArray:
    """Measured speed over a braking torque, rpm per N m; ``frequency`` in rad/s, not zero."""
    s = 1j * frequency
    gains = values["speed_gain_nm_s_per_rad"] + values["integral_gain_nm_per_rad"] / s
    controller = gains * (1.0 + values["position_gain_per_s"] / s)
    sensor = 1.0 / (1.0 + values[SENSOR_LAG] * s)
    answer = controller * sensor / (1.0 + values[CURRENT_LAG] * s)
    return np.asarray(-RPM_PER_RAD_PER_S * sensor / (mechanics(values, frequency) + answer))


def torque_of_angle(values: Values, frequency: FloatArray) -> ComplexArray:
    """The torque that would look like an error of the measured angle, N m per rad."""
    return np.asarray(-mechanics(values, frequency) * 1j * frequency)


def mechanics(values: Values, frequency: FloatArray) -> ComplexArray:
    """J s + b at the motor, N m s/rad."""
    inertia = values["motor_inertia_kg_m2"]
    inertia += values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    return np.asarray(inertia * 1j * frequency + values[FRICTION])


WHOLE = 4.0
"""Standard deviations within which an order is a whole one."""


@dataclass(frozen=True, slots=True)
class Turning:
    """The motor's speed over its angle.

    Attributes
    ----------
    angle
        Of the motor, rad, shape (n,).
    response
        What the loop makes of a torque at a frequency in rad/s.
    load_order
        Of the load's turning, where gravity acts on it: what it does to the speed is fitted apart.
    """

    piece: Piece
    angle: FloatArray
    response: Callable[[FloatArray], ComplexArray]
    load_order: float | None = None
    made: dict[float, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def speed_rad_per_s(self) -> float:
        """Mean, with its sign."""
        time = self.piece.time_s
        return float(self.angle[-1] - self.angle[0]) / float(time[-1] - time[0])

    @property
    def turns(self) -> float:
        """Of the motor."""
        return abs(float(self.angle[-1] - self.angle[0])) / (2.0 * math.pi)

    def part(self, rows: slice, use: Use) -> Turning:
        """Some samples of it, with a use of their own."""
        return replace(self, piece=self.piece.part(rows, use), angle=self.angle[rows], made={})

    def shows(self, order: float) -> bool:
        """Whether an order turns often enough, and not too fast for the sampling."""
        per_sample = order * abs(self.speed_rad_per_s) / (2.0 * math.pi) * self.piece.period_s
        is_sampled = order < HIGHEST_ORDER and per_sample < WIDEST
        return is_sampled and order * self.turns >= FEWEST_CYCLES

    def _answer(self, order: float) -> FloatArray:
        """The loop's answer to cos n θ and sin n θ, 1 at the mean speed, shape (n, 2).

        A torque that makes the speed sway makes its own angle sway too: at low speeds the answer
        has harmonics, which would otherwise be taken for other torques.
        """
        if order not in self.made:
            lead = self.angle.size // 2  # in which the loop forgets how it began
            step = self.speed_rad_per_s * self.piece.period_s
            before = self.angle[0] - step * np.arange(lead, 0, -1)
            torque = np.exp(1j * order * np.concatenate((before, self.angle)))
            turning = np.fft.fftfreq(torque.size, self.piece.period_s)
            frequency: FloatArray = np.asarray(2.0 * math.pi * turning, dtype=float)
            frequency[0] = frequency[1]
            answer = self.response(frequency)
            answer[0] = 0.0  # the mean is fitted apart
            mean: FloatArray = np.array([order * self.speed_rad_per_s])
            one = abs(complex(self.response(mean)[0]))
            both = np.fft.fft(np.stack([torque.real, torque.imag]), axis=1) * answer / one
            self.made[order] = np.fft.ifft(both, axis=1).real[:, lead:].T
        return self.made[order]

    def fit(self, orders: Sequence[float]) -> tuple[ComplexArray, FloatArray]:
        """Line c of each order, Re c exp(i n θ), and what all of them leave; NaN where none shows.

        Shapes (m,) and (k,).
        """
        solution, matrix = self._fitted(orders)
        lines = np.full(len(orders), complex(math.nan, math.nan))
        shown = np.array([self.shows(order) for order in orders], bool)
        pairs = solution[: 2 * int(shown.sum())]
        lines[shown] = pairs[0::2] - 1j * pairs[1::2]
        return lines, self.piece.kept(self.piece.measured - matrix @ solution)

    def _fitted(self, orders: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Coefficients, (p,), of cosine and sine of each order that shows and of what is fitted
        apart, and these waves, (n, p)."""
        slow = [] if self.load_order is None else [self.load_order]
        waves = map(self._answer, (*filter(self.shows, orders), *slow))
        matrix = np.column_stack([*waves, np.ones(self.angle.size)])
        kept = self.piece.kept
        solution = np.linalg.lstsq(kept(matrix), kept(self.piece.measured), rcond=1e-10)[0]
        return np.asarray(solution), matrix

    def predicted(self, orders: Sequence[float], sizes: FloatArray) -> FloatArray:
        """The speed with lines of these sizes, rpm, shape (n,); phases and the rest as they fit."""
        solution, matrix = self._fitted(orders)
        shown = [size for order, size in zip(orders, sizes, strict=True) if self.shows(order)]
        for k, size in enumerate(shown):
            pair = solution[2 * k : 2 * k + 2]
            pair *= size / max(float(np.hypot(*pair)), 1e-300)
        return np.asarray(matrix @ solution)

    def rest(self, residual: FloatArray) -> OrderedRest:
        """What lines leave, (k,), to be searched for orders."""
        piece, speed = self.piece, np.full(residual.size, abs(self.speed_rad_per_s))
        time, angle = piece.kept(piece.time_s), piece.kept(self.angle)
        cutoff = WIDEST / piece.period_s
        return OrderedRest(piece.name, time, angle, speed, residual, cutoff, False, piece.period_s)


def find_orders(turning: Sequence[Turning], most: int, false_alarm: float) -> list[Peak]:
    """Orders that stand out of the noise of all pieces together, strongest first.

    The rate of false alarms is that of the whole list: half of what is left goes to each order. A
    whole order within the errors is the whole one, unless every order is near one.
    """
    peaks: list[Peak] = []
    while len(peaks) < most:
        known = [peak.order for peak in peaks]
        rests = [item.rest(item.fit(known)[1]) for item in turning]
        peak = clearest(rests, known, False, highest=HIGHEST_ORDER, coloured=True)
        bound = math.log(false_alarm) - (len(peaks) + 1) * math.log(2.0)
        if peak is None or peak.log_chance > bound:
            break
        whole = peak.behind < WHOLE**2 and peak.order > 0.5 and WHOLE * peak.sd < 0.5
        peaks.append(replace(peak, order=float(round(peak.order))) if whole else peak)
    return peaks


RIPPLE, ECCENTRICITY = "motor_torque_ripple", "encoder_eccentricity"
ANGLE_ERROR, BETWEEN, TIME = "error of the angle", "angle between both", "line in time"
TORQUE, ANGLE, BOTH = range(3)
"""Columns of :func:`law_powers`."""

LOWEST = np.array([0.0, 0.0, -np.inf])
"""Of each."""

GAINS = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
SCALES = ("motor_inertia_kg_m2", *GAINS)
"""Of the loop, that may be wrong: their ratios show."""

WRONG = 0.3
"""Usual error of such a value, in its logarithm. Friction is told in shares of the speed gain, as
to the lines one is the other."""

LAG = 0.3
"""Usual lag, in radians where the gain of the open loop is one: about K_p/J."""

STARTS = (0.1, 0.3, 1.0, 3.0)
"""In usual sizes: a small lag may raise what a larger one lowers."""

LINE_LAW = 0.5
"""Probability beforehand that a line which is there is of a torque, or of an error of the angle."""

ROUNDS = 5
"""Of search and fit: the first finds lines alone, and changes of the loop are linear near them."""

MOST_BESIDE = 3
"""Changes of the loop beside the laws of the lines."""

STEP = 1e-4
"""Of a logarithm, for derivatives."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of recordings, each at one speed.

    ``power``: |c|² of the m orders in the r recordings less what noise adds, shape (r, m), rpm²,
    NaN where not shown; ``noise``: variance of the real part of c, (r, m); ``speeds``: mean speed
    of each recording, rad/s, shape (r,); ``lasting_s``: of each, (r,).
    """

    orders: tuple[float, ...]
    speeds: FloatArray
    power: FloatArray
    noise: FloatArray
    lasting_s: FloatArray

    @property
    def shown(self) -> BoolArray:
        """Which are, (r, m)."""
        return np.isfinite(self.power)

    @property
    def measured(self) -> FloatArray:
        """The same with 0 where not shown."""
        return np.nan_to_num(self.power)

    def sd(self, power: FloatArray) -> FloatArray:
        """Standard deviation of a measured power where this is the true one, (r, m)."""
        return np.asarray(2.0 * np.sqrt(self.noise * (np.maximum(power, 0.0) + self.noise)))


def law_powers(values: Values, orders: Sequence[float], speeds: FloatArray) -> FloatArray:
    """Power of a line by what makes it, rpm², shape (r, m, 3).

    |G (a + Z ε exp(iφ))|² is linear in a² (of a torque), ε² (of an error of the angle) and
    a ε cos φ (where both are there): |G|², |G Z|² and 2 |G|² Re Z. Z is real but for friction.
    """
    frequency = np.multiply.outer(speeds, np.asarray(orders, dtype=float))
    gain = np.abs(speed_of_torque(values, frequency)) ** 2
    angle = torque_of_angle(values, frequency)
    return np.stack([gain, gain * np.abs(angle) ** 2, 2.0 * gain * angle.real], axis=-1)


@dataclass(frozen=True)
class LoopView:
    """Lines of a loop for the model search: powers by order and recording, over their noise.

    Attributes
    ----------
    lines, believed, priors
        What is compared, the loop as the bench has it, and what of that is free: standard
        deviations of logarithms.
    candidates
        Effects that may be named.
    sizes
        Of hypotheses in the fit, by label: a coefficient of :func:`law_powers`, or a change of the
        loop, which is the logarithm of a parameter's factor, or what is added to an effect.
    free
        Changes of what is free.
    named
        Labels of the only hypotheses, once they are told with their sizes.
    """

    lines: Lines
    believed: Values
    priors: Mapping[str, float]
    candidates: Sequence[str]
    sizes: Mapping[str, float] = field(default_factory=dict)
    free: Mapping[str, float] = field(default_factory=dict)
    named: frozenset[str] | None = None

    @cached_property
    def laws(self) -> dict[str, tuple[int, int]]:
        """Order, by its place, and part of its law, of every hypothesis of one line, by label.

        At order 1 an error of the angle is an eccentric encoder, and a torque may stand beside it.
        """
        possible = (*self.candidates, ANGLE_ERROR, BETWEEN)
        every = dict[str, tuple[int, int]]()
        for k, order in enumerate(self.lines.orders):
            names = {TORQUE: RIPPLE, ANGLE: ANGLE_ERROR}
            if order == 1.0:
                names |= {ANGLE: ECCENTRICITY, BOTH: BETWEEN}
            every |= {f"{name}, {k}": (k, part) for part, name in names.items() if name in possible}
        return every

    @cached_property
    def in_time(self) -> dict[str, list[tuple[int, int]]]:
        """Lines that have one frequency, each at the recording where it is strongest and its order;
        by label."""
        lines = self.lines
        at = np.argmax(np.where(lines.shown, lines.measured / lines.noise, -np.inf), axis=0)
        hertz = np.asarray(lines.orders) * np.abs(lines.speeds[at]) / (2.0 * math.pi)
        by_hertz = np.argsort(hertz)
        apart = np.diff(hertz[by_hertz]) * lines.lasting_s[at].min() >= 1.0
        groups = np.split(by_hertz, np.flatnonzero(apart) + 1)
        return {
            f"{TIME}, {group[0]}": [(int(at[k]), int(k)) for k in group]
            for group in groups
            if np.unique(at[group]).size > 1
        }

    @cached_property
    def law_sizes(self) -> FloatArray:
        """Of each order's law, (m, 3); 0 where it lacks a part."""
        sizes = np.zeros((len(self.lines.orders), 3))
        for label, part in self.laws.items():
            sizes[part] = self.sizes.get(label, 0.0)
        return sizes

    @cached_property
    def changes(self) -> dict[str, float]:
        """Of the loop, free and by hypotheses."""
        names = (*self.priors, *LOOP_EFFECTS, *SCALES)
        return {name: self.free.get(name, 0.0) + self.sizes.get(name, 0.0) for name in names}

    def changed(self, changes: Mapping[str, float]) -> dict[str, float]:
        """The loop with these changes."""
        return {
            name: value + changes.get(name, 0.0)
            if name in LOOP_EFFECTS
            else value * math.exp(changes.get(name, 0.0))
            for name, value in self.believed.items()
        }

    def powers(self, changes: Mapping[str, float]) -> FloatArray:
        """:func:`law_powers` with these changes, (r, m, 3)."""
        return law_powers(self.changed(changes), self.lines.orders, self.lines.speeds)

    @cached_property
    def expected(self) -> FloatArray:
        """Power by the laws, as measured where there is none, (r, m)."""
        power = _sum(self.powers(self.changes), self.law_sizes)
        power = np.where(self.law_sizes.any(axis=1), power, self.lines.measured)
        return np.maximum(power, 0.0)

    @cached_property
    def sd(self) -> FloatArray:
        """Of the powers, (r, m)."""
        return self.lines.sd(self.expected)

    def fitted(self, changes: Mapping[str, float]) -> FloatArray:
        """Sizes of the same laws that fit best with such a loop, (m, 3)."""
        powers, sizes = self.powers(changes), np.zeros_like(self.law_sizes)
        for k, own in enumerate(self.law_sizes):
            shown, parts = self.lines.shown[:, k], np.flatnonzero(own)
            sd, columns = self.sd[shown, k], powers[:, k, parts][shown]
            measured = self.lines.power[shown, k] / sd
            sizes[k, parts] = bounded_least_squares(columns / sd[:, None], measured, LOWEST[parts])
        return sizes

    def moved(self, changes: Mapping[str, float]) -> FloatArray:
        """Powers with such a loop by the same laws, (r, m).

        While names are sought, of the sizes that fit best then: what is the same at all speeds is a
        size, so that no change of the loop makes lines.
        """
        sizes = self.fitted(changes) if self.named is None else self.law_sizes
        return _sum(self.powers(changes), sizes)

    def predicted(self, speeds: FloatArray) -> FloatArray:
        """Size of every line at these speeds, rpm, shape (r, m)."""
        powers = law_powers(self.changed(self.changes), self.lines.orders, speeds)
        return np.sqrt(np.maximum(_sum(powers, self.law_sizes), 0.0))

    @cached_property
    def rows(self) -> Rows:
        """A piece for each order that shows, over the recordings."""
        lines, each = self.lines, np.arange(float(self.lines.speeds.size))
        pieces = []
        for k in np.flatnonzero(lines.shown.any(axis=0)):
            measured, excluded = (lines.measured / self.sd)[:, k], ~lines.shown[:, k]
            name = f"order {lines.orders[k]:.5g}"
            pieces.append(Piece(name, MOTOR_SPEED, "used", each, measured, excluded))
        return Rows(tuple(pieces))

    def _counted(self, power: FloatArray) -> FloatArray:
        """Powers, (r, m), as the rows count them, (N,)."""
        return np.asarray((power / self.sd).T[self.lines.shown.T])

    @cached_property
    def model(self) -> AffineModel:
        """Around these changes; sizes are linear anyway."""
        slopes, base = {}, np.zeros(self.rows.measured.size)
        for name in self.priors:
            ends = (self.changes | {name: self.changes[name] + step} for step in (STEP, -STEP))
            up, down = map(self.moved, ends)
            slopes[name] = self._counted(up - down) / (2.0 * STEP)
            base -= slopes[name] * self.free.get(name, 0.0)
        lengths = [rows.stop - rows.start for rows in self.rows.slices]
        every = (*self._of_lines(), *self._of_loop())
        bands = zip(self.rows.pieces, self.rows.slices, lengths, strict=True)
        return AffineModel(
            self.rows,
            base,
            slopes,
            tuple(c for c in every if self.named is None or c.label in self.named),
            (Discrepancy("share of its law", np.diag(self._counted(self.expected))),),
            self.priors,
            bands=tuple(MisfitBand(piece.name, rows, n) for piece, rows, n in bands),
            noises=tuple(ResidualNoise(1.0, np.zeros(0), np.ones(n)) for n in lengths),
            most_terms=len(lengths) + MOST_BESIDE,
        )

    def _of_lines(self) -> Iterator[Candidate]:
        lines, powers = self.lines, np.abs(self.powers(self.free))
        of_lines = {label: (slice(None), k) for label, (k, _) in self.laws.items()}
        of_lines |= {label: tuple(np.transpose(group)) for label, group in self.in_time.items()}
        for label, rows in of_lines.items():
            name, (place, part) = label.rpartition(",")[0], self.laws.get(label, (None, TORQUE))
            made = np.zeros_like(lines.measured)
            made[rows] = np.where(lines.shown, powers[..., part], 0.0)[rows]
            if not made.any():
                continue
            usual = float(np.linalg.norm(lines.measured[rows]) / np.linalg.norm(made))
            alone = place is None or lines.orders[place] != 1.0
            others = frozenset(o for o, (k, _) in self.laws.items() if k == place and o != label)
            yield Candidate(
                label,
                "line",
                name,
                ("size",),
                (Look({}, self._counted(made)[:, None], size=usual),),
                1.0,
                part != BOTH,
                excludes=others if alone else frozenset(),
                requires=others if part == BOTH else frozenset(),
                probability=LINE_LAW,
            )

    def _of_loop(self) -> Iterator[Candidate]:
        """Secants: to the change that the fit has, or else of usual sizes."""
        origin, gain = self.moved(self.free), self.believed[GAINS[0]]
        lag = LAG * float(mechanics(self.believed, np.ones(1))[0].imag) / gain
        usuals = {FRICTION: WRONG * gain, CURRENT_LAG: lag, SENSOR_LAG: lag}
        for name in (*LOOP_EFFECTS, *SCALES):
            effect, usual = name in LOOP_EFFECTS, usuals.get(name, WRONG)
            if not (name in self.candidates if effect else self.believed[name]):
                continue
            tried = [usual * start for start in (STARTS if effect else (1.0, -1.0))]
            if self.sizes.get(name):
                tried = [self.sizes[name]]
            looks = []
            for size in tried:
                moved = self.moved({**self.free, name: self.free.get(name, 0.0) + size})
                column = self._counted(moved - origin)[:, None] / size
                looks.append(Look({}, column, 1.0 / len(tried), usual))
            kind: Literal["effect", "parameter"] = "effect" if effect else "parameter"
            yield Candidate(name, kind, name, ("size",), tuple(looks), 1.0, effect)

    def alone(self, named: frozenset[str]) -> LoopView:
        """Around the same loop with these hypotheses and the lines that have a law of them."""
        places = [self.laws[label][0] for label in named if label in self.laws]
        unnamed = ~np.isin(np.arange(len(self.lines.orders)), places)
        lines = replace(self.lines, power=np.where(unnamed, np.nan, self.lines.power))
        sizes = {label: size for label, size in self.sizes.items() if label in named}
        return replace(self, lines=lines, sizes=sizes, named=named)

    def refined(self, inference: Inference) -> LoopView:
        """Around the most probable set."""
        best = next(iter(inference.posterior.sets))
        sizes, moved = inference.posterior.mean_of(best)
        labels = [inference.terms[k].hypothesis for k in best]
        there = {label: float(size[0]) for label, size in zip(labels, sizes, strict=True)}
        free = dict(zip(inference.model.names, moved.tolist(), strict=True))
        view = replace(self, sizes=there, free=free)
        fitted = view.fitted(view.changes)
        of_lines = {n: float(fitted[part]) for n, part in self.laws.items() if n in there}
        return replace(view, sizes=there | of_lines)


CANDIDATES = (RIPPLE, ECCENTRICITY, *LOOP_EFFECTS)
CONSTANT = ("motor_coulomb_friction", "load_coulomb_friction", "load_viscous_friction")
"""Effects of a bench that are no line at one speed, or are known to the loop."""

LOAD_COUNTS = 0.01
"""Share of the inertia from which the load's is spoken of."""

HIDDEN = (
    "From the speed alone the controller's integral hides what friction is on average: only what "
    "repeats, and what changes how the loop answers, can be named. Its sizes are known as well as "
    "the gains and the inertia are."
)


def loop_setting(task: Task) -> Setting:
    """What a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    require_no_known_torque(task, "The speed alone is compared, without any torque.")
    config, bench = task.config, task.bench
    if not set(config.comparison.channels) <= {MOTOR_SPEED}:
        raise ConfigError(
            "A rigid drive in its closed loop is compared by its speed.",
            where="[comparison] channels",
            found=", ".join(config.comparison.channels),
            expected=f'["{MOTOR_SPEED}"]; or method = "inverse", which compares torque or current; '
            'or drive = "two_mass" in the bench, with its shaft and gap',
        )
    missing = [name for name in GAINS if name in bench.assumed]
    if missing:
        raise ConfigError(
            "The controller's gains decide what the speed shows of a torque.",
            file=config.bench,
            where="[parameters]",
            found=f"no {' and no '.join(missing)}",
            expected=" and ".join(f"{name} = {{value = …}}" for name in missing),
        )
    known = {*LOOP_EFFECTS, *CONSTANT}
    others = [effect.name for effect in bench.effects if effect.name not in known]
    if others:
        raise ConfigError(
            "This method names all that repeats with the motor, so the bench must have none of it.",
            file=config.bench,
            where="[[effects]]",
            found=", ".join(others),
            expected="a bench without them",
        )
    for recording in task.recordings:
        require_channels(recording, [MOTOR_SPEED])
    turning = []
    recordings = even_recordings(task, (MOTOR_SPEED,))
    values = loop_values(bench)
    response = partial(speed_of_torque, values)
    load_order = 1.0 / bench.value("gear_ratio") if bench.value("gravity_torque_nm") else None
    for entry, recording in zip(config.recordings, recordings, strict=True):
        if not is_one_speed(recording.motor_speed_rpm, recording.sampling_period_s):
            raise RecordingError(
                "The speed alone is compared in recordings of one speed each.",
                file=recording.place,
                where=MOTOR_SPEED,
                found=f"a mean of {recording.motor_speed_rpm.mean():.4g} rpm, and parts that "
                "depart from it by more than noise and ripple do",
                expected="one speed; or torque or current beside the motion (inverse)",
            )
        whole = piece_of(recording, MOTOR_SPEED)
        angle = recording.channels.get(MOTOR_POSITION)
        if angle is None:
            speed = whole.measured / RPM_PER_RAD_PER_S
            angle = cumulative_trapezoid(speed, dx=whole.period_s, initial=0.0)
        made = Turning(whole, angle, response, load_order)
        for use, rows in parts_of(USES_OF[entry.use], made.angle.size // 2):
            turning.append(made.part(rows, use))
    unknown = config.unknowns.bench_parameters
    for name in unknown:
        if name not in LOOP_PARAMETERS or not bench.tolerances.get(name):
            raise ConfigError(
                "Only parameters of the loop that have a tolerance can be fitted.",
                where="[unknowns] bench_parameters",
                found=name,
                expected="one with a tolerance of " + ", ".join(LOOP_PARAMETERS),
            )
    priors = {n: bench.tolerances[n] / math.sqrt(3.0) / bench.value(n) for n in unknown}
    names = wanted(config, bench, dict.fromkeys(CANDIDATES))
    notes = (*notes_of(recordings), HIDDEN, *_soft_shaft(values))
    return Setting(task, tuple(turning), values, priors, names, notes)


def _soft_shaft(values: Mapping[str, float]) -> Iterator[str]:
    """What the load's inertia means where a shaft lies between."""
    at_motor = values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    motor = values["motor_inertia_kg_m2"] / (values["motor_inertia_kg_m2"] + at_motor)
    if motor < 1.0 - LOAD_COUNTS:
        yield (
            f"The load holds {100.0 * (1.0 - motor):.2g} % of the inertia. Beyond the resonance of "
            f"a shaft to it only the motor's own moves, and torques are {motor:.2g} times what is "
            'said here: compare with drive = "two_mass" if the joint has a gear.'
        )


MOST_LINES = 12
"""Looked at: what is beyond them is weaker."""

ALIKE = (
    "At order {order:.5g} these recordings do not tell a torque that repeats from an error of the "
    "encoder. A recording at another speed tells them apart."
)
GROWS = (
    "The line at order {order:.5g} grows with the speed as an error of the encoder's angle of "
    "{size_mrad:.2g} mrad does, not as a torque."
)


def comparison(task: Task) -> Comparison:
    """Lines of the speed at orders of the motor, and the laws that they follow over the speeds."""
    setting = loop_setting(task)
    used, held_out = len(setting.used), len(setting.turning) - len(setting.used)
    return Comparison(
        f"forward, the speed alone of a rigid drive, {used} to fit on, {held_out} held out; "
        f"candidates {', '.join(setting.candidates)}",
        setting.diagnosis,
    )


@dataclass(frozen=True)
class Setting:
    """Pieces, the loop, what of it is free (sd of logarithms), what may be named, and notes; from
    these to the answer.

    ``true_angle``: pieces are over the angle without the encoder's error.
    """

    task: Task
    turning: tuple[Turning, ...]
    values: dict[str, float]
    priors: Mapping[str, float]
    candidates: tuple[str, ...]
    notes: tuple[str, ...]
    true_angle: bool = False

    @property
    def used(self) -> tuple[Turning, ...]:
        """Pieces to fit on."""
        return tuple(item for item in self.turning if item.piece.use == "used")

    @cached_property
    def peaks(self) -> list[Peak]:
        """Orders that stand out, the strongest first."""
        return find_orders(self.used, MOST_LINES, self.task.config.candidates.false_alarm)

    def diagnosis(self, progress: StageProgress | None = None) -> Diagnosis:
        """Name what follows a law, describe the rest."""
        if not self.peaks:
            return Diagnosis("nothing_missing", (), (), (), self._compared(None), self.notes)
        notes, lines = list(self.notes), lines_of(self.used, [line.order for line in self.peaks])
        sought = LoopView(lines, self.values, self.priors, self.candidates)
        sought, inference = inferred(sought, progress, ROUNDS)
        named = self._named(sought, inference, notes)
        firsts = {members[0] for members in named}
        every = inference.labels.items()
        both = {label for label, c in every if c.name == BETWEEN and c.requires <= firsts}
        fit, told = replace(sought, sizes={}), inference
        if named:
            fit, told = inferred(sought.alone(frozenset(firsts | both)))
        if (again := self._by_true_angle(fit)) is not None:
            return again.diagnosis()
        effects, errors = list[NamedEffect](), list[ParameterError]()
        unnamed = set(range(len(self.peaks)))
        for first, *rivals in (members for members in named if members[0] in fit.sizes):
            size = told.values(first)["size"]
            others = tuple(dict.fromkeys(inference.labels[label].name for label in rivals))
            if first in SCALES:
                believed = self.task.bench.parameters[first]
                value, tolerance = believed.value, believed.tolerance
                size = self._logarithm(first, size)
                errors.append(ParameterError(first, value, tolerance, size, others))
                continue
            if first in fit.laws:
                place, part = fit.laws[first]
                parameters = self._of_law(place, part, size)
                unnamed.discard(place)
            else:
                parameters = {LOOP_EFFECTS[first]: size}
            name, size = inference.labels[first].name, next(iter(parameters.values()))
            chance, z = inference.probability((first, *rivals)), abs(size.value) / size.sd
            effects.append(NamedEffect(name, parameters, chance, z, others))
        remaining = []
        for group in (sought.in_time[m[0]] for m in inference.sure if m[0] in sought.in_time):
            remaining.append(self._unexplained(lines, group))
            unnamed -= {k for _, k in group}
        remaining += [self._unexplained(lines, [(-1, k)]) for k in sorted(unnamed)]
        return Diagnosis(
            verdict_of(effects=bool(effects), parameters=bool(errors), remains=bool(remaining)),
            tuple(effects),
            tuple(errors),
            tuple(remaining),
            self._compared(fit),
            tuple(notes),
            bench_parameters={n: self._logarithm(n, told.nuisance(n)) for n in self.priors},
        )

    def _named(
        self, view: LoopView, inference: Inference, notes: list[str]
    ) -> list[tuple[str, ...]]:
        """Sets that are named, the loop's last and the largest line first; no error of the angle
        but at order 1 is, and none of the loop without a line that shows how it answers."""
        power, labels = np.nanmax(view.lines.power, axis=0), inference.labels
        laws, loop = list[tuple[str, ...]](), list[tuple[str, ...]]()
        for every in inference.sure:
            members = tuple(label for label in every if labels[label].name != BETWEEN)
            names = [labels[label].name for label in members]
            if not members or TIME in names:
                continue
            if members[0] not in view.laws:
                loop.append(members)
            elif ANGLE_ERROR not in names:
                laws.append(members)
            else:
                order = self.peaks[view.laws[members[0]][0]].order
                size = _root(inference.values(members[0])["size"])
                note = GROWS if len(members) == 1 else ALIKE
                notes.append(note.format(order=order, size_mrad=1e3 * size.value))
        laws.sort(key=lambda members: -power[view.laws[members[0]][0]])
        most = self.task.config.candidates.max_effects or MOST_EFFECTS
        return (laws[: max(1, most - len(loop))] + loop)[:most] if laws else []

    def _by_true_angle(self, fit: LoopView) -> Setting | None:
        """The same over the angle without the encoder's error, once it is named beside torques.

        Over the measured angle a torque of order n has sidebands of n ε/2 of its size.
        """
        sizes = fit.law_sizes
        first = [k for k, order in enumerate(fit.lines.orders) if order == 1.0 and sizes[k, ANGLE]]
        if self.true_angle or not first or np.count_nonzero(sizes.any(axis=1)) == 1:
            return None
        torque, angle, between = sizes[first[0]]
        ratio = between / max(torque * angle, 1e-300) ** 0.5
        phase = math.acos(min(1.0, max(-1.0, ratio)))

        def without_error(item: Turning) -> Turning:
            (line,), _ = item.fit([1.0])
            if not np.isfinite(line):
                return item
            loop, speed = fit.changed(fit.changes), np.full(1, item.speed_rad_per_s)
            like = math.sqrt(angle) * torque_of_angle(loop, speed)
            turn = line / (math.sqrt(torque) * np.exp(1j * phase) + like[0])
            error = math.sqrt(angle) * np.real(turn / abs(turn) * np.exp(1j * item.angle))
            return replace(item, angle=item.angle - error, made={})

        return replace(self, turning=tuple(map(without_error, self.turning)), true_angle=True)

    def _of_law(self, place: int, part: int, power: Estimate) -> dict[str, Estimate]:
        """Parameters of a line's effect, from a coefficient of its powers."""
        size, line = _root(power), self.peaks[place]
        if part == ANGLE:
            return {"angle_rad": size}
        held = line.order == round(line.order)
        return {"torque_nm": size, "order": Estimate(line.order, math.nan if held else line.sd)}

    def _logarithm(self, name: str, change: Estimate) -> Estimate:
        """Of a parameter's value."""
        return replace(change, value=math.log(self.values[name]) + change.value, logarithmic=True)

    def _unexplained(self, lines: Lines, group: Sequence[tuple[int, int]]) -> Unexplained:
        """A line without a law, or with one that the catalogue does not have; or one in time."""
        place = group[0][1]
        sizes = np.sqrt(lines.measured[:, place].clip(0.0))
        order, hertz = self.peaks[place].order, math.nan
        places = [i for i in np.argsort(-sizes) if sizes[i] > 0.0]
        if len(group) > 1:
            hertz = order * abs(float(lines.speeds[places[0]])) / (2.0 * math.pi)
            places, order = [i for i, _ in group], math.nan
        return Unexplained(
            MOTOR_SPEED,
            "motor angle" if len(group) == 1 else "time",
            max(math.sqrt(max(0.0, float(np.nanmax(lines.power[:, k])))) for _, k in group),
            "rpm",
            order,
            order,
            hertz,
            tuple(self.used[i].piece.name for i in places),
            self.peaks[place].score,
        )

    def _compared(self, fit: LoopView | None) -> tuple[ComparedPiece, ...]:
        """Every piece, with a mean alone and with all laws."""
        every = sorted(self.turning, key=lambda item: item.piece.use != "used")
        rows = Rows(tuple(item.piece for item in every))
        before = rows.stack(lambda i: every[i].predicted((), np.zeros(0)))
        after = before
        if fit is not None:
            places = np.flatnonzero(fit.law_sizes.any(axis=1))
            orders = np.asarray(fit.lines.orders)[places].tolist()
            sizes = fit.predicted(np.array([item.speed_rad_per_s for item in every]))[:, places]
            after = rows.stack(lambda i: every[i].predicted(orders, sizes[i]))
        return compared_pieces(rows, before, after)


def _sum(powers: FloatArray, sizes: FloatArray) -> FloatArray:
    """Of the parts of each law, (…, m, 3) and (m, 3) to (…, m)."""
    return np.asarray((powers * sizes).sum(axis=-1))


def _root(power: Estimate) -> Estimate:
    """A torque in N m, or an angle in rad, from its square."""
    size = math.sqrt(max(power.value, np.finfo(float).tiny))
    return Estimate(size, 0.5 * power.sd / size)


def lines_of(turning: Sequence[Turning], orders: Sequence[float]) -> Lines:
    """The lines of every piece, their noise, and the speeds."""
    powers, variances = [], []
    for item in turning:
        coefficients, residual = item.fit(orders)
        spectrum = spectrum_of([item.rest(residual)], False, highest=HIGHEST_ORDER, coloured=True)
        (noise,) = spectrum.powers.values()
        variance = np.full(len(orders), math.nan)
        if np.any(noise > 0.0):
            level = np.interp(orders, spectrum.orders[noise > 0.0], noise[noise > 0.0])
            variance = 4.0 * level / residual.size**2
        variances.append(variance)
        powers.append(np.abs(coefficients) ** 2 - 2.0 * variance)
    speeds = np.array([item.speed_rad_per_s for item in turning])
    lasting = np.array([np.ptp(item.piece.time_s) for item in turning])
    return Lines(tuple(orders), speeds, np.array(powers), np.array(variances), lasting)
