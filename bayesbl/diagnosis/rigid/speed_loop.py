"""A rigid drive under its speed controller, from its speed alone at several speeds.

    (J s + b) ω = −τ + L C (ω_ref − ω_meas),   ω_meas = F (ω + s ε),
    C = (K_p + K_i/s)(1 + k_pos/s),   L = 1/(1 + T_i s),   F = 1/(1 + T_ω s)

with a braking torque τ and an error ε of the measured angle:

    ω_meas = F (−τ + (J s + b) s ε) / (J s + b + L C F)

So an error of the angle acts like the torque (J s + b) s ε: for one amplitude of each, the lines
differ by the square of the speed, whatever the controller. The power of each order's line at each
speed is compared with that of one torque, or one error, for all orders together with the unknowns
of the loop. Phases are free, because the motor's start angle is unknown.
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
    View,
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
LOOP_EFFECTS = {FRICTION: "coefficient_nm_s_per_rad", CURRENT_LAG: "time_s", SENSOR_LAG: "time_s"}
"""Effects that change the loop, each with the parameter that is zero without it."""

Values = Mapping[str, float]
"""Loop parameters with ``gear_ratio``, and the sizes of :data:`LOOP_EFFECTS`, by name."""


def loop_values(bench: Bench) -> dict[str, float]:
    """Loop of a bench with its effects."""
    values = {name: bench.value(name) for name in ("gear_ratio", *LOOP_PARAMETERS)}
    values |= dict.fromkeys(LOOP_EFFECTS, 0.0)
    for effect in bench.effects:
        parameters = effect.complete()
        if effect.name in LOOP_EFFECTS:
            values[effect.name] += parameters[LOOP_EFFECTS[effect.name]]
        if effect.name == "load_viscous_friction":
            coefficient = parameters["coefficient_nm_s_per_rad"]
            values[FRICTION] += coefficient / values["gear_ratio"] ** 2
    return values


def speed_of_torque(values: Values, frequency: FloatArray) -> ComplexArray:
    """Measured speed per braking torque, rpm/(N m), at frequencies in rad/s, not zero."""
    s = 1j * frequency
    gains = values["speed_gain_nm_s_per_rad"] + values["integral_gain_nm_per_rad"] / s
    controller = gains * (1.0 + values["position_gain_per_s"] / s)
    sensor = 1.0 / (1.0 + values[SENSOR_LAG] * s)
    feedback = controller * sensor / (1.0 + values[CURRENT_LAG] * s)
    return np.asarray(-RPM_PER_RAD_PER_S * sensor / (mechanics(values, frequency) + feedback))


def torque_of_angle(values: Values, frequency: FloatArray) -> ComplexArray:
    """Torque that acts like an error of the measured angle, N m/rad."""
    return np.asarray(-mechanics(values, frequency) * 1j * frequency)


def mechanics(values: Values, frequency: FloatArray) -> ComplexArray:
    """J s + b at the motor, N m s/rad."""
    inertia = values["motor_inertia_kg_m2"]
    inertia += values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    return np.asarray(inertia * 1j * frequency + values[FRICTION])


WHOLE = 4.0
"""Distance in standard deviations within which an order counts as whole."""


@dataclass(frozen=True, slots=True)
class Turning:
    """The motor's speed over its angle.

    ``angle``: motor angle, rad, shape (n,). ``response``: speed per torque of the loop, at
    frequencies in rad/s. ``load_order``: order of the load's rotation if gravity acts on it. Its
    line is fitted separately.
    """

    piece: Piece
    angle: FloatArray
    response: Callable[[FloatArray], ComplexArray]
    load_order: float | None = None
    cache: dict[float, FloatArray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def travel(self) -> float:
        """Signed motor angle covered, rad."""
        return float(self.angle[-1] - self.angle[0])

    @property
    def speed_rad_per_s(self) -> float:
        """Signed mean speed."""
        return self.travel / float(self.piece.time_s[-1] - self.piece.time_s[0])

    def part(self, rows: slice, use: Use) -> Turning:
        """Some of its samples, for another use."""
        return replace(self, piece=self.piece.part(rows, use), angle=self.angle[rows], cache={})

    def shows(self, order: float) -> bool:
        """Whether enough cycles of an order are recorded, and sampled densely enough."""
        per_sample = order * abs(self.speed_rad_per_s) / (2.0 * math.pi) * self.piece.period_s
        cycles = order * abs(self.travel) / (2.0 * math.pi)
        return order < HIGHEST_ORDER and per_sample < WIDEST and cycles >= FEWEST_CYCLES

    def _response(self, order: float) -> FloatArray:
        """Response of the loop to cos n θ and sin n θ, 1 at the mean speed, shape (n, 2).

        A torque that changes the speed changes its own angle too. At low speeds the response then
        has harmonics, which would otherwise look like other torques.
        """
        if order not in self.cache:
            lead = self.angle.size // 2  # in which the loop forgets its initial state
            step = self.speed_rad_per_s * self.piece.period_s
            before = self.angle[0] - step * np.arange(lead, 0, -1)
            torque = np.exp(1j * order * np.concatenate((before, self.angle)))
            cycles = np.fft.fftfreq(torque.size, self.piece.period_s)
            frequency: FloatArray = np.asarray(2.0 * math.pi * cycles, dtype=float)
            frequency[0] = frequency[1]
            response = self.response(frequency)
            response[0] = 0.0  # the mean is fitted separately
            mean: FloatArray = np.array([order * self.speed_rad_per_s])
            response /= abs(complex(self.response(mean)[0]))
            both = np.fft.fft(np.stack([torque.real, torque.imag]), axis=1) * response
            self.cache[order] = np.fft.ifft(both, axis=1).real[:, lead:].T
        return self.cache[order]

    def _fitted(self, orders: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Coefficients (p,) of the waves of all shown orders, the load's order and the mean, and
        these waves, (n, p)."""
        load = [] if self.load_order is None else [self.load_order]
        waves = map(self._response, (*filter(self.shows, orders), *load))
        matrix = np.column_stack([*waves, np.ones(self.angle.size)])
        kept = self.piece.kept
        solution = np.linalg.lstsq(kept(matrix), kept(self.piece.measured), rcond=1e-10)[0]
        return np.asarray(solution), matrix

    def fit(self, orders: Sequence[float]) -> tuple[ComplexArray, FloatArray]:
        """Line c of each order, Re c exp(i n θ), (m,), and the residual, (k,); NaN if not shown."""
        solution, matrix = self._fitted(orders)
        lines = np.full(len(orders), complex(math.nan, math.nan))
        shown = np.array([self.shows(order) for order in orders], bool)
        pairs = solution[: 2 * int(shown.sum())]
        lines[shown] = pairs[0::2] - 1j * pairs[1::2]
        return lines, self.piece.kept(self.piece.measured - matrix @ solution)

    def predicted(self, orders: Sequence[float], sizes: FloatArray) -> FloatArray:
        """Speed with lines of these sizes, rpm, shape (n,); phases and mean are fitted."""
        solution, matrix = self._fitted(orders)
        shown = [size for order, size in zip(orders, sizes, strict=True) if self.shows(order)]
        for k, size in enumerate(shown):
            pair = solution[2 * k : 2 * k + 2]
            pair *= size / max(float(np.hypot(*pair)), 1e-300)
        return np.asarray(matrix @ solution)

    def rest(self, residual: FloatArray) -> OrderedRest:
        """A residual, (k,), in which orders can be sought."""
        piece, speed = self.piece, np.full(residual.size, abs(self.speed_rad_per_s))
        time, angle = piece.kept(piece.time_s), piece.kept(self.angle)
        cutoff = WIDEST / piece.period_s
        return OrderedRest(piece.name, time, angle, speed, residual, cutoff, False, piece.period_s)


def find_orders(turning: Sequence[Turning], most: int, false_alarm: float) -> list[Peak]:
    """Orders that stand out of the noise of all pieces together, the strongest first.

    ``false_alarm``: probability of any false order; half of what remains of it goes to each. An
    order within its error of a whole one is that one, unless it is known already.
    """
    peaks: list[Peak] = []
    while len(peaks) < most:
        known = [peak.order for peak in peaks]
        rests = [item.rest(item.fit(known)[1]) for item in turning]
        peak = clearest(rests, known, False, highest=HIGHEST_ORDER, coloured=True)
        limit = math.log(false_alarm) - (len(peaks) + 1) * math.log(2.0)
        if peak is None or peak.log_chance > limit:
            break
        nearest = float(round(peak.order))
        is_whole = peak.behind < WHOLE**2 and nearest > 0.0 and WHOLE * peak.sd < 0.5
        peaks.append(replace(peak, order=nearest) if is_whole and nearest not in known else peak)
    return peaks


RIPPLE, ECCENTRICITY = "motor_torque_ripple", "encoder_eccentricity"
ANGLE_ERROR, BETWEEN, TIME = "error of the angle", "angle between both", "line in time"
TORQUE, ANGLE, BOTH = range(3)
"""Columns of :func:`law_powers`."""

LOWEST = np.array([0.0, 0.0, -np.inf])
"""Lower bounds of their coefficients."""

GAINS = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
SCALES = ("motor_inertia_kg_m2", *GAINS)
"""Parameters that may be wrong. Only their ratios can be determined."""

WRONG = 0.3
"""Usual error of the logarithm of such a parameter, and usual friction over the speed gain: a line
does not distinguish the two."""

LAG = 0.3
"""Usual lag in radians at unit gain of the open loop, which is at about K_p/J."""

STARTS = (0.1, 0.3, 1.0, 3.0)
"""Lags that are tried, in usual lags: a small one may raise a line that a larger one lowers."""

LINE_LAW = 0.5
"""Prior probability that an existing line comes from a torque, or from an error of the angle."""

ROUNDS = 5
"""Rounds of search and fit. The first finds only lines, near which changes of the loop are linear.
"""

MOST_BESIDE = 3
"""Largest number of changes of the loop in one set."""

STEP = 1e-4
"""Step of a logarithm for derivatives."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of r recordings at one speed each.

    ``power``: |c|² of the m orders without the part of the noise, rpm², (r, m), NaN if not shown;
    ``noise``: variance of the real part of c, (r, m); ``speeds``: mean speeds, rad/s, (r,);
    ``lasting_s``: durations, (r,).
    """

    orders: tuple[float, ...]
    speeds: FloatArray
    power: FloatArray
    noise: FloatArray
    lasting_s: FloatArray

    @property
    def shown(self) -> BoolArray:
        """Mask of the lines that are shown, (r, m)."""
        return np.isfinite(self.power)

    @property
    def measured(self) -> FloatArray:
        """Power, 0 if not shown, (r, m)."""
        return np.nan_to_num(self.power)

    def sd(self, power: FloatArray) -> FloatArray:
        """Standard deviation of a measurement of this power, (r, m)."""
        return np.asarray(2.0 * np.sqrt(self.noise * (np.maximum(power, 0.0) + self.noise)))


def law_powers(values: Values, orders: Sequence[float], speeds: FloatArray) -> FloatArray:
    """Power of a line per coefficient of its law, rpm², shape (r, m, 3).

    |G (a + Z ε exp(iφ))|² is linear in a² (torque), ε² (error of the angle) and a ε cos φ (both):
    |G|², |G Z|² and 2 |G|² Re Z. Z is real without friction.
    """
    frequency = np.multiply.outer(speeds, np.asarray(orders, dtype=float))
    gain = np.abs(speed_of_torque(values, frequency)) ** 2
    angle = torque_of_angle(values, frequency)
    return np.stack([gain, gain * np.abs(angle) ** 2, 2.0 * gain * angle.real], axis=-1)


@dataclass(frozen=True)
class LoopView(View):
    """Powers of lines by order and recording, in units of their noise.

    Attributes
    ----------
    believed
        Loop of the bench.
    priors
        Standard deviations of the logarithms of free parameters.
    candidates
        Effects that may be named.
    sizes
        Sizes of the fit's hypotheses by label: a coefficient of :func:`law_powers`, the logarithm
        of a parameter's factor, or the size added to an effect of the loop.
    free
        Changes of the logarithms of free parameters.
    named
        The only hypotheses by label, once their sizes are inferred with the loop; ``None`` before.
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
        """Index of the order and column of its law, for each hypothesis about one line, by label.

        At order 1, an error of the angle is an eccentric encoder, and a torque may act with it.
        """
        possible = (*self.candidates, ANGLE_ERROR, BETWEEN)
        laws = dict[str, tuple[int, int]]()
        for k, order in enumerate(self.lines.orders):
            names = {TORQUE: RIPPLE, ANGLE: ANGLE_ERROR}
            if order == 1.0:
                names |= {ANGLE: ECCENTRICITY, BOTH: BETWEEN}
            laws |= {f"{name}, {k}": (k, part) for part, name in names.items() if name in possible}
        return laws

    @cached_property
    def in_time(self) -> dict[str, list[tuple[int, int]]]:
        """Lines at one frequency, each as (strongest recording, order), by label."""
        lines = self.lines
        at = np.argmax(np.where(lines.shown, lines.measured / lines.noise, -np.inf), axis=0)
        hertz = np.asarray(lines.orders) * np.abs(lines.speeds[at]) / (2.0 * math.pi)
        by_hertz = np.argsort(hertz)
        is_apart = np.diff(hertz[by_hertz]) * lines.lasting_s[at].min() >= 1.0
        groups = np.split(by_hertz, np.flatnonzero(is_apart) + 1)
        return {
            f"{TIME}, {group[0]}": [(int(at[k]), int(k)) for k in group]
            for group in groups
            if np.unique(at[group]).size > 1
        }

    @cached_property
    def law_sizes(self) -> FloatArray:
        """Coefficients of each order's law, (m, 3)."""
        sizes = np.zeros((len(self.lines.orders), 3))
        for label, part in self.laws.items():
            sizes[part] = self.sizes.get(label, 0.0)
        return sizes

    @cached_property
    def changes(self) -> dict[str, float]:
        """Changes of the loop, free and by hypotheses."""
        names = (*self.priors, *LOOP_EFFECTS, *SCALES)
        return {name: self.free.get(name, 0.0) + self.sizes.get(name, 0.0) for name in names}

    def changed(self, changes: Mapping[str, float]) -> dict[str, float]:
        """Values of the loop with these changes."""
        return {
            name: value + changes.get(name, 0.0)
            if name in LOOP_EFFECTS
            else value * math.exp(changes.get(name, 0.0))
            for name, value in self.believed.items()
        }

    def powers(self, changes: Mapping[str, float]) -> FloatArray:
        """:func:`law_powers` of the loop with these changes, (r, m, 3)."""
        return law_powers(self.changed(changes), self.lines.orders, self.lines.speeds)

    @cached_property
    def expected(self) -> FloatArray:
        """Power by the laws, or as measured for lines without one, (r, m)."""
        power = (self.powers(self.changes) * self.law_sizes).sum(axis=-1)
        power = np.where(self.law_sizes.any(axis=1), power, self.lines.measured)
        return np.maximum(power, 0.0)

    @cached_property
    def sd(self) -> FloatArray:
        """Standard deviations of the powers, (r, m)."""
        return self.lines.sd(self.expected)

    def fitted(self, changes: Mapping[str, float]) -> FloatArray:
        """Coefficients of the same laws that fit best with these changes of the loop, (m, 3)."""
        powers, sizes = self.powers(changes), np.zeros_like(self.law_sizes)
        for k, law in enumerate(self.law_sizes):
            shown, parts = self.lines.shown[:, k], np.flatnonzero(law)
            sd, columns = self.sd[shown, k], powers[:, k, parts][shown]
            measured = self.lines.power[shown, k] / sd
            sizes[k, parts] = bounded_least_squares(columns / sd[:, None], measured, LOWEST[parts])
        return sizes

    def moved(self, changes: Mapping[str, float]) -> FloatArray:
        """Power by the same laws with these changes of the loop, (r, m).

        While names are sought, the sizes are fitted again. A change of the loop that acts equally
        at all speeds is then a size, so no change of the loop creates lines.
        """
        sizes = self.fitted(changes) if self.named is None else self.law_sizes
        return np.asarray((self.powers(changes) * sizes).sum(axis=-1))

    def predicted(self, speeds: FloatArray) -> FloatArray:
        """Size of every line at these speeds, rpm, shape (r, m)."""
        powers = law_powers(self.changed(self.changes), self.lines.orders, speeds)
        return np.asarray(np.sqrt(np.maximum((powers * self.law_sizes).sum(axis=-1), 0.0)))

    @cached_property
    def rows(self) -> Rows:
        """A piece for each order that is shown, with a sample for each recording."""
        lines, numbers = self.lines, np.arange(float(self.lines.speeds.size))
        pieces = []
        for k in np.flatnonzero(lines.shown.any(axis=0)):
            measured, excluded = (lines.measured / self.sd)[:, k], ~lines.shown[:, k]
            name = f"order {lines.orders[k]:.5g}"
            pieces.append(Piece(name, MOTOR_SPEED, "used", numbers, measured, excluded))
        return Rows(tuple(pieces))

    def _whitened(self, power: FloatArray) -> FloatArray:
        """Powers (r, m) as rows in standard deviations, (N,)."""
        return np.asarray((power / self.sd).T[self.lines.shown.T])

    @cached_property
    def model(self) -> AffineModel:
        """Model around the present changes of the loop."""
        slopes, base = {}, np.zeros(self.rows.measured.size)
        for name in self.priors:
            ends = (self.changes | {name: self.changes[name] + step} for step in (STEP, -STEP))
            up, down = map(self.moved, ends)
            slopes[name] = self._whitened(up - down) / (2.0 * STEP)
            base -= slopes[name] * self.free.get(name, 0.0)
        lengths = [rows.stop - rows.start for rows in self.rows.slices]
        candidates = (*self._of_lines(), *self._of_loop())
        bands = zip(self.rows.pieces, self.rows.slices, lengths, strict=True)
        return AffineModel(
            self.rows,
            base,
            slopes,
            tuple(c for c in candidates if self.named is None or c.label in self.named),
            (Discrepancy("share of its law", np.diag(self._whitened(self.expected))),),
            self.priors,
            bands=tuple(MisfitBand(piece.name, rows, n) for piece, rows, n in bands),
            noises=tuple(ResidualNoise(1.0, np.zeros(0), np.ones(n)) for n in lengths),
            most_terms=len(lengths) + MOST_BESIDE,
        )

    def _of_lines(self) -> Iterator[Candidate]:
        """A candidate for each law of a line, and for each line in time."""
        lines, powers = self.lines, np.abs(self.powers(self.free))
        of_lines = {label: (slice(None), k) for label, (k, _) in self.laws.items()}
        of_lines |= {label: tuple(np.transpose(group)) for label, group in self.in_time.items()}
        for label, rows in of_lines.items():
            name, (place, part) = label.rpartition(",")[0], self.laws.get(label, (None, TORQUE))
            power = np.zeros_like(lines.measured)
            power[rows] = np.where(lines.shown, powers[..., part], 0.0)[rows]
            if not power.any():
                continue
            usual = float(np.linalg.norm(lines.measured[rows]) / np.linalg.norm(power))
            is_alone = place is None or lines.orders[place] != 1.0
            others = frozenset(o for o, (k, _) in self.laws.items() if k == place and o != label)
            yield Candidate(
                label,
                "line",
                name,
                ("size",),
                (Look({}, self._whitened(power)[:, None], size=usual),),
                1.0,
                part != BOTH,
                excludes=others if is_alone else frozenset(),
                requires=others if part == BOTH else frozenset(),
                probability=LINE_LAW,
            )

    def _of_loop(self) -> Iterator[Candidate]:
        """Changes of the loop: secants to the size in the fit, or to usual sizes."""
        origin, gain = self.moved(self.free), self.believed[GAINS[0]]
        lag = LAG * float(mechanics(self.believed, np.ones(1))[0].imag) / gain
        usual_sizes = {FRICTION: WRONG * gain, CURRENT_LAG: lag, SENSOR_LAG: lag}
        possible = [*(n for n in LOOP_EFFECTS if n in self.candidates)]
        for name in (*possible, *(n for n in SCALES if self.believed[n])):
            is_effect, usual = name in LOOP_EFFECTS, usual_sizes.get(name, WRONG)
            tried = [usual * start for start in (STARTS if is_effect else (1.0, -1.0))]
            if self.sizes.get(name):
                tried = [self.sizes[name]]
            looks = []
            for size in tried:
                moved = self.moved({**self.free, name: self.free.get(name, 0.0) + size})
                column = self._whitened(moved - origin)[:, None] / size
                looks.append(Look({}, column, 1.0 / len(tried), usual))
            kind: Literal["effect", "parameter"] = "effect" if is_effect else "parameter"
            yield Candidate(name, kind, name, ("size",), tuple(looks), 1.0, is_effect)

    def alone(self, named: frozenset[str]) -> LoopView:
        """The same loop with these hypotheses only, and their lines."""
        places = [self.laws[label][0] for label in named if label in self.laws]
        unnamed = ~np.isin(np.arange(len(self.lines.orders)), places)
        lines = replace(self.lines, power=np.where(unnamed, np.nan, self.lines.power))
        sizes = {label: size for label, size in self.sizes.items() if label in named}
        return replace(self, lines=lines, sizes=sizes, named=named)

    def refined(self, inference: Inference) -> LoopView:
        """The view at the most probable set."""
        best = next(iter(inference.posterior.sets))
        means, shift = inference.posterior.mean_of(best)
        labels = [inference.terms[k].hypothesis for k in best]
        sizes = {label: float(mean[0]) for label, mean in zip(labels, means, strict=True)}
        free = dict(zip(inference.model.names, shift.tolist(), strict=True))
        view = replace(self, sizes=sizes, free=free)
        fitted = view.fitted(view.changes)
        of_lines = {n: float(fitted[part]) for n, part in self.laws.items() if n in sizes}
        return replace(view, sizes=sizes | of_lines)


CANDIDATES = (RIPPLE, ECCENTRICITY, *LOOP_EFFECTS)
CONSTANT = ("motor_coulomb_friction", "load_coulomb_friction", "load_viscous_friction")
"""Effects of a bench that make no line at constant speed, or that the loop includes."""

LOAD_COUNTS = 0.01
"""Share of the load in the inertia from which a note mentions it."""

HIDDEN = (
    "From the speed alone the controller's integral hides what friction is on average: only what "
    "repeats, and what changes how the loop answers, can be named. Its sizes are known as well as "
    "the gains and the inertia are."
)


def loop_setting(task: Task) -> Setting:
    """Setting of a task; raises ``UserError`` if bench or recordings do not suit the method."""
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
    others = [e.name for e in bench.effects if e.name not in (*LOOP_EFFECTS, *CONSTANT)]
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
        item = Turning(whole, angle, response, load_order)
        turning += [
            item.part(rows, use) for use, rows in parts_of(USES_OF[entry.use], angle.size // 2)
        ]
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
    """A note on what the load's inertia means behind a shaft."""
    at_motor = values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    motor = values["motor_inertia_kg_m2"] / (values["motor_inertia_kg_m2"] + at_motor)
    if motor < 1.0 - LOAD_COUNTS:
        yield (
            f"The load holds {100.0 * (1.0 - motor):.2g} % of the inertia. Beyond the resonance of "
            f"a shaft to it only the motor's own moves, and torques are {motor:.2g} times what is "
            'said here: compare with drive = "two_mass" if the joint has a gear.'
        )


MOST_LINES = 12
"""Largest number of lines that are analysed, the strongest."""

ALIKE = (
    "At order {order:.5g} these recordings do not tell a torque that repeats from an error of the "
    "encoder. A recording at another speed tells them apart."
)
GROWS = (
    "The line at order {order:.5g} grows with the speed as an error of the encoder's angle of "
    "{size_mrad:.2g} mrad does, not as a torque."
)


def comparison(task: Task) -> Comparison:
    """Compare lines of the speed at motor orders with the laws that they follow over the speeds."""
    setting = loop_setting(task)
    used, held_out = len(setting.used), len(setting.turning) - len(setting.used)
    return Comparison(
        f"forward, the speed alone of a rigid drive, {used} to fit on, {held_out} held out; "
        f"candidates {', '.join(setting.candidates)}",
        setting.diagnosis,
    )


@dataclass(frozen=True)
class Setting:
    """What a task compares: pieces, loop, and candidates.

    ``priors``: standard deviations of the logarithms of free parameters. ``true_angle``: whether
    the encoder's error has been subtracted from the angles.
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
        """Pieces that are fitted."""
        return tuple(item for item in self.turning if item.piece.use == "used")

    @cached_property
    def peaks(self) -> list[Peak]:
        """Orders that stand out, the strongest first."""
        return find_orders(self.used, MOST_LINES, self.task.config.candidates.false_alarm)

    def diagnosis(self, progress: StageProgress | None = None) -> Diagnosis:
        """Name the lines that follow a law, and describe the others."""
        if not self.peaks:
            return Diagnosis("nothing_missing", (), (), (), self._compared(None), self.notes)
        notes, lines = list(self.notes), lines_of(self.used, [line.order for line in self.peaks])
        searched = LoopView(lines, self.values, self.priors, self.candidates)
        searched, inference = inferred(searched, progress, ROUNDS)
        named = self._named(searched, inference, notes)
        firsts = {members[0] for members in named}
        between = {
            label
            for label, c in inference.labels.items()
            if c.name == BETWEEN and c.requires <= firsts
        }
        fit, final = replace(searched, sizes={}), inference
        if named:
            fit, final = inferred(searched.alone(frozenset(firsts | between)))
        if (again := self._by_true_angle(fit)) is not None:
            return again.diagnosis()
        effects, errors = list[NamedEffect](), list[ParameterError]()
        unnamed = set(range(len(self.peaks)))
        for first, *rivals in (members for members in named if members[0] in fit.sizes):
            others = tuple(dict.fromkeys(inference.labels[label].name for label in rivals))
            if first in SCALES:
                believed = self.task.bench.parameters[first]
                value = self._logarithm(first, final.change(first))
                error = ParameterError(first, believed.value, believed.tolerance, value, others)
                errors.append(error)
                continue
            size = final.values(first)["size"]
            if first in fit.laws:
                place, part = fit.laws[first]
                parameters = self._of_law(place, part, size)
                unnamed.discard(place)
            else:
                parameters = {LOOP_EFFECTS[first]: size}
            name, size = inference.labels[first].name, next(iter(parameters.values()))
            probability, z = inference.probability((first, *rivals)), abs(size.value) / size.sd
            effects.append(NamedEffect(name, parameters, probability, z, others))
        remaining = []
        groups = (searched.in_time.get(members[0]) for members in inference.sure)
        for group in (group for group in groups if group is not None):
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
            bench_parameters={n: self._logarithm(n, final.change(n)) for n in self.priors},
        )

    def _named(
        self, view: LoopView, inference: Inference, notes: list[str]
    ) -> list[tuple[str, ...]]:
        """Sets to name: lines by decreasing power, then the loop, if any line shows its response.

        An error of the angle is named only at order 1; at other orders a note describes it.
        """
        power, labels = np.nanmax(view.lines.power, axis=0), inference.labels
        laws, loop = list[tuple[str, ...]](), list[tuple[str, ...]]()
        for group in inference.sure:
            members = tuple(label for label in group if labels[label].name != BETWEEN)
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
        """The same over the true angle, if an error of the encoder is named beside torques.

        Over the measured angle, a torque of order n has sidebands of n ε/2 of its size.
        """
        sizes = fit.law_sizes
        first = [k for k, order in enumerate(fit.lines.orders) if order == 1.0 and sizes[k, ANGLE]]
        if self.true_angle or not first or np.count_nonzero(sizes.any(axis=1)) == 1:
            return None
        torque, angle, between = sizes[first[0]]
        cosine = between / max(torque * angle, 1e-300) ** 0.5
        phase = math.acos(min(1.0, max(-1.0, cosine)))

        def without_error(item: Turning) -> Turning:
            (line,), _ = item.fit([1.0])
            if not np.isfinite(line):
                return item
            loop, speed = fit.changed(fit.changes), np.full(1, item.speed_rad_per_s)
            like_torque = math.sqrt(angle) * torque_of_angle(loop, speed)
            turn = line / (math.sqrt(torque) * np.exp(1j * phase) + like_torque[0])
            error = math.sqrt(angle) * np.real(turn / abs(turn) * np.exp(1j * item.angle))
            return replace(item, angle=item.angle - error, cache={})

        return replace(self, turning=tuple(map(without_error, self.turning)), true_angle=True)

    def _of_law(self, place: int, part: int, power: Estimate) -> dict[str, Estimate]:
        """Parameters of a line's effect, from the coefficient of its law."""
        size, line = _root(power), self.peaks[place]
        if part == ANGLE:
            return {"angle_rad": size}
        is_whole = line.order == round(line.order)
        return {"torque_nm": size, "order": Estimate(line.order, math.nan if is_whole else line.sd)}

    def _logarithm(self, name: str, change: Estimate) -> Estimate:
        """Logarithm of a parameter with this change."""
        return replace(change, value=math.log(self.values[name]) + change.value, logarithmic=True)

    def _unexplained(self, lines: Lines, group: Sequence[tuple[int, int]]) -> Unexplained:
        """A line without an effect of the catalogue, or several that are one line in time."""
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
        """Every piece, with its mean alone and with all laws."""
        turning = sorted(self.turning, key=lambda item: item.piece.use != "used")
        rows = Rows(tuple(item.piece for item in turning))
        before = after = rows.stack(lambda i: turning[i].predicted((), np.zeros(0)))
        if fit is not None:
            places = np.flatnonzero(fit.law_sizes.any(axis=1))
            orders = np.asarray(fit.lines.orders)[places].tolist()
            sizes = fit.predicted(np.array([item.speed_rad_per_s for item in turning]))[:, places]
            after = rows.stack(lambda i: turning[i].predicted(orders, sizes[i]))
        return compared_pieces(rows, before, after)


def _root(power: Estimate) -> Estimate:
    """A torque in N m or an angle in rad, from its square."""
    size = math.sqrt(max(power.value, np.finfo(float).tiny))
    return Estimate(size, 0.5 * power.sd / size)


def lines_of(turning: Sequence[Turning], orders: Sequence[float]) -> Lines:
    """Powers of the lines of every piece, and their noise."""
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
