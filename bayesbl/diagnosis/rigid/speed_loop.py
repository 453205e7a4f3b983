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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import median_filter
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import gammaln, logsumexp
from scipy.stats import chi2

from bayesbl.bench.bench import Bench
from bayesbl.bench.effect_declaration import HIGHEST_ORDER, LOWEST_ORDER
from bayesbl.diagnosis.comparison import Piece
from bayesbl.diagnosis.diagnosis import (
    Diagnosis,
    Estimate,
    NamedEffect,
    OrderSize,
    ParameterError,
    PieceSignals,
    probability_of,
    verdict_of,
)
from bayesbl.diagnosis.disagreement import DisagreementTable, Use
from bayesbl.diagnosis.inference import MOST_EFFECTS, compared_signals, parameter_errors
from bayesbl.diagnosis.residuals.analysis import Unexplained
from bayesbl.diagnosis.rigid.motion import WIDEST
from bayesbl.diagnosis.rigid.orders import FEWEST_CYCLES
from bayesbl.diagnosis.rigid.preparation import even_recordings, require_rigid
from bayesbl.diagnosis.task import USES_OF, Task, notes_of, parts_of, piece_of, refused, wanted
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.model_search.constants import INDISTINGUISHABLE_Z
from bayesbl.progress import StageProgress
from bayesbl.recording.moving import VARIES, is_one_speed
from bayesbl.recording.types import MOTOR_POSITION, MOTOR_SPEED, ComplexArray, FloatArray
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
    seen = 1.0 / (1.0 + values[SENSOR_LAG] * s)
    answer = controller * seen / (1.0 + values[CURRENT_LAG] * s)
    return np.asarray(-RPM_PER_RAD_PER_S * seen / (mechanics(values, frequency) + answer))


def torque_of_angle(values: Values, frequency: FloatArray) -> ComplexArray:
    """The torque that would look like an error of the measured angle, N m per rad."""
    return np.asarray(-mechanics(values, frequency) * 1j * frequency)


def mechanics(values: Values, frequency: FloatArray) -> ComplexArray:
    """J s + b at the motor, N m s/rad."""
    inertia = values["motor_inertia_kg_m2"]
    inertia += values["load_inertia_kg_m2"] / values["gear_ratio"] ** 2
    return np.asarray(inertia * 1j * frequency + values[FRICTION])


FINER = 4
"""Steps of a spectrum in one resolved order."""

LEVEL_ORDERS = 40
"""Resolved orders over which the noise around a line is taken, by its median."""

RESOLVED_CYCLES = 2.0
"""By which an order must differ from a stronger one in a piece that is to show it."""

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

    @property
    def turns_per_s(self) -> float:
        """Of the motor."""
        return abs(self.speed_rad_per_s) / (2.0 * math.pi)

    @property
    def highest_order(self) -> float:
        """That the sampling shows."""
        return min(HIGHEST_ORDER, WIDEST / self.piece.period_s / self.turns_per_s)

    def part(self, rows: slice, use: Use) -> Turning:
        """Some samples of it, with a use of their own."""
        return replace(self, piece=self.piece.part(rows, use), angle=self.angle[rows], made={})

    def shows(self, order: float) -> bool:
        """Whether an order turns often enough, and not too fast for the sampling."""
        return order < self.highest_order and order * self.turns >= FEWEST_CYCLES

    def waves(self, orders: Sequence[float]) -> FloatArray:
        """Cosine and sine of each order that shows, then what is fitted apart, (k, p)."""
        slow = [] if self.load_order is None else [self.load_order]
        waves = [self._answer(o) for o in (*(o for o in orders if self.shows(o)), *slow)]
        return self.piece.kept(np.column_stack([*waves, np.ones(self.angle.size)]))

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
        found, matrix = self._waves_fitted(orders)
        lines = np.full(len(orders), complex(math.nan, math.nan))
        shown = np.array([self.shows(order) for order in orders], bool)
        pairs = found[: 2 * int(shown.sum())]
        lines[shown] = pairs[0::2] - 1j * pairs[1::2]
        return lines, self.piece.kept(self.piece.measured) - matrix @ found

    def _waves_fitted(self, orders: Sequence[float]) -> tuple[FloatArray, FloatArray]:
        """Coefficients of the waves, (p,), and the waves, (k, p)."""
        matrix = self.waves(orders)
        found = np.linalg.lstsq(matrix, self.piece.kept(self.piece.measured), rcond=1e-10)[0]
        return np.asarray(found), matrix

    def predicted(self, orders: Sequence[float], sizes: FloatArray) -> FloatArray:
        """The speed with lines of these sizes, rpm, shape (n,); phases and the rest as they fit."""
        shown = [order for order in orders if self.shows(order)]
        found, _ = self._waves_fitted(shown)
        for k, order in enumerate(shown):
            pair = found[2 * k : 2 * k + 2]
            pair *= sizes[list(orders).index(order)] / max(float(np.hypot(*pair)), 1e-300)
        whole = replace(self, piece=replace(self.piece, excluded=None))
        return whole.waves(shown) @ found

    def spectrum(self, left: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Orders, |Σ x exp(−i n θ)|², and what noise makes of it around; evenly over the angle."""
        way = np.maximum.accumulate(np.abs(self.piece.kept(self.angle) - self.angle[0]))
        grid = np.linspace(way[0], way[-1], left.size)
        power = np.abs(np.fft.rfft(np.interp(grid, way, left), FINER * left.size)) ** 2
        orders = np.arange(power.size) / (FINER * self.turns)
        size = min(FINER * LEVEL_ORDERS, power.size)
        level = median_filter(power, size) / (chi2.median(2) / 2.0)
        return orders, power, np.asarray(level)


@dataclass(frozen=True, slots=True)
class OrderLine:
    """An order that stands out.

    Attributes
    ----------
    sd
        Of the order.
    score, trials
        χ² over the recordings that show it, and how many orders were looked at.
    """

    order: float
    sd: float
    score: float
    trials: float


def find_orders(turning: Sequence[Turning], most: int, false_alarm: float) -> list[OrderLine]:
    """Orders that stand out of the noise of all pieces together, strongest first.

    The rate of false alarms is that of the whole list: half of what is left goes to each order.
    """
    found: list[OrderLine] = []
    top = max(item.highest_order for item in turning)
    turns = max(item.turns for item in turning)
    grid = np.arange(LOWEST_ORDER, top, 1.0 / (FINER * turns))
    trials = max(1.0, (top - LOWEST_ORDER) * turns)
    while len(found) < most and grid.size:
        score, pieces = np.zeros(grid.size), np.zeros(grid.size)
        levels = []
        for item in turning:
            _, left = item.fit([line.order for line in found])
            orders, power, level = item.spectrum(left)
            seen = (grid < item.highest_order) & (grid * item.turns >= FEWEST_CYCLES)
            for line in found:  # what a piece does not resolve belongs to the stronger line
                seen &= np.abs(grid - line.order) * item.turns >= RESOLVED_CYCLES
            score += np.where(seen, np.interp(grid, orders, 2.0 * power / level), 0.0)
            pieces += seen
            levels.append((item, left, orders, level))
        rarity = _log_rarity(score, pieces)
        k = int(np.argmin(rarity))
        rise = trials * math.sqrt(max(1.0, 0.5 * float(score[k])))  # Baluev 2008
        if rarity[k] + math.log(rise) > math.log(false_alarm * 0.5 ** (len(found) + 1)):
            break
        order, sd = _refined(float(grid[k]), 1.0 / turns, levels)
        found.append(OrderLine(order, sd, float(score[k]), rise))
    return found


def _log_rarity(score: FloatArray, pieces: FloatArray) -> FloatArray:
    """Logarithm of the probability of a larger χ² with 2 degrees of freedom for each piece.

    exp(−x/2) Σ_{j<m} (x/2)ʲ/j!, in logarithms: scores of a thousand are usual.
    """
    j = np.arange(max(1, int(pieces.max())))[:, None]
    half = np.maximum(0.5 * score, 1e-12)
    terms = np.where(j < np.maximum(pieces, 1), j * np.log(half) - gammaln(j + 1.0), -np.inf)
    return np.asarray(logsumexp(terms, axis=0) - half)


def _refined(
    order: float,
    width: float,
    levels: Sequence[tuple[Turning, FloatArray, FloatArray, FloatArray]],
) -> tuple[float, float]:
    """The order of the highest score nearby, and its standard deviation by the curvature.

    A whole order within the errors is the whole one, unless every order is near one.
    """
    parts = [
        (item.piece.kept(item.angle), left, float(np.interp(order, orders, level)))
        for item, left, orders, level in levels
        if item.shows(order)
    ]

    def misfit(value: float) -> float:
        return -sum(float(abs(np.vdot(np.exp(1j * value * a), x))) ** 2 / v for a, x, v in parts)

    best = float(
        minimize_scalar(
            misfit,
            bounds=(order - width, order + width),
            method="bounded",
            options={"xatol": 1e-4 * width},
        ).x
    )
    step = 0.1 * width
    bend = (misfit(best + step) - 2.0 * misfit(best) + misfit(best - step)) / step**2
    # The logarithm of the likelihood is the score over the level: its second derivative.
    sd = 1.0 / math.sqrt(bend) if bend > 0.0 else width
    whole = round(best)
    # By the likelihood itself: of a weak line it has several peaks, and a bend of each.
    near = 2.0 * (misfit(float(whole)) - misfit(best)) < WHOLE**2
    return (float(whole) if near and whole > 0 and WHOLE * sd < 0.5 else best), sd


def noise_sd(item: Turning, orders: Sequence[float], left: FloatArray) -> FloatArray:
    """Standard deviation of the real part of the line at each order, shape (m,)."""
    grid, _, level = item.spectrum(left)
    return np.asarray(np.sqrt(2.0 * np.interp(orders, grid, level)) / left.size)


Law = Literal["torque", "angle", "both"]

FEWEST_FOR_BOTH = 4
"""Speeds at which two sizes and the angle between them still leave something to be wrong."""

STARTS = (0.1, 1.0, 10.0)
"""Of what is added to the loop, in sizes that would count: a small lag may raise what a larger one
lowers."""

EXPLAINED = 0.5
"""Largest share of a line's power that its law may leave at speeds that it was not fitted to."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Lines of recordings, each at one speed.

    ``size``, ``sd``: of the m orders in the r recordings, shape (r, m), rpm, NaN where not shown;
    ``speeds``: mean speed of each recording, rad/s, shape (r,).
    """

    orders: tuple[float, ...]
    speeds: FloatArray
    size: FloatArray
    sd: FloatArray


@dataclass(frozen=True, slots=True)
class Free:
    """What of the loop is fitted.

    ``priors``: parameter to the sd of its logarithm; infinite where it has none. ``added``: effect
    to a size that would count, in its own unit.
    """

    priors: Mapping[str, float] = field(default_factory=dict)
    added: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LawFit:
    """Least squares of laws to lines.

    Attributes
    ----------
    lines, laws, believed, free
        What was fitted: lines, order's place to its law, the loop as the bench has it, and what of
        that is free.
    values
        Of the loop, as fitted.
    sizes
        Order's place to its torque, N m, its angle, rad, and the phase between them.
    scatter, freedom
        Of the lines around their laws, in noise, 1 where noise explains it; and the number of those
        beyond what is fitted.
    deviations
        Standard deviations: of a logarithm for a parameter, else in its unit; for an order under
        ``(place, "torque")`` and ``(place, "angle")``.
    cost
        χ² with what the priors add.
    """

    lines: Lines
    laws: Mapping[int, Law]
    believed: Values
    free: Free
    values: Values
    sizes: Mapping[int, tuple[float, float, float]]
    scatter: float
    freedom: int
    deviations: Mapping[object, float]
    cost: float

    def predicted(self, place: int, speeds: FloatArray) -> FloatArray:
        """Size of a line at these speeds, rpm, shape (r,)."""
        return line_size(self.values, self.lines.orders[place], speeds, *self.sizes[place])

    def again(self, laws: Mapping[int, Law], free: Free | None = None) -> LawFit:
        """Fitted with other laws of some orders, and with as much of the loop free if not said."""
        return fit_laws(self.lines, {**self.laws, **laws}, self.believed, free or self.free)


def line_size(
    values: Values,
    order: float,
    speeds: FloatArray,
    torque: float,
    angle: float,
    phase: float,
) -> FloatArray:
    """|G (a exp(iφ) + Z ε)| of a torque a, N m, and an error of the angle ε, rad; rpm."""
    frequency = order * speeds
    driving = torque * np.exp(1j * phase) + angle * torque_of_angle(values, frequency)
    return np.asarray(np.abs(speed_of_torque(values, frequency) * driving))


def fit_laws(lines: Lines, laws: Mapping[int, Law], believed: Values, free: Free) -> LawFit:
    """Fit sizes, and what of the loop is free."""
    loops = [*free.priors, *free.added]
    keys = [
        (place, part)
        for place, law in laws.items()
        for part in (("torque", "angle", "phase") if law == "both" else (law,))
    ]
    every = np.ones(lines.speeds.size, bool)
    one: dict[str, tuple[float, float, float]] = {"torque": (1, 0, 0), "angle": (0, 1, 0)}
    first = {
        (place, part): _alone(lines, believed, place, one[part], every) if part in one else 1.0
        for place, part in keys
    }

    def unpacked(x: FloatArray) -> tuple[dict[str, float], dict[int, tuple[float, float, float]]]:
        values = dict(believed)
        for name, value in zip(loops, x, strict=False):
            if name in free.added:
                values[name] += float(value) * free.added[name]
            else:
                values[name] *= math.exp(float(value))
        parts = {key: float(v) * first[key] for key, v in zip(keys, x[len(loops) :], strict=True)}

        def size(place: int, part: str) -> float:
            return parts.get((place, part), 0.0)

        return values, {
            place: (size(place, "torque"), size(place, "angle"), size(place, "phase"))
            for place in laws
        }

    shown = {place: np.isfinite(lines.size[:, place]) for place in laws}
    priors = np.array([free.priors.get(name, math.inf) for name in loops])

    def misfit(x: FloatArray) -> FloatArray:
        values, sizes = unpacked(x)
        parts = [x[: len(loops)] / priors]
        for place, seen in shown.items():
            made = line_size(values, lines.orders[place], lines.speeds[seen], *sizes[place])
            parts.append((lines.size[seen, place] - made) / lines.sd[seen, place])
        return np.concatenate(parts)

    low = np.array([*(0.0 if name in free.added else -3.0 for name in loops), *[-8.0] * len(keys)])
    high = np.array([*(50.0 if name in free.added else 3.0 for name in loops), *[1e4] * len(keys)])
    found = min(
        (
            least_squares(
                misfit,
                np.array([*(size * (n in free.added) for n in loops), *np.ones(len(keys))]),
                bounds=(low, high),
                x_scale="jac",
            )
            for size in (STARTS if free.added else STARTS[:1])
        ),
        key=lambda trial: float(trial.cost),
    )
    values, sizes = unpacked(found.x)
    rows = sum(int(seen.sum()) for seen in shown.values())
    chi_squared = float(np.sum(found.fun[len(loops) :] ** 2))
    freedom = rows - len(keys) - int(np.count_nonzero(np.isinf(priors)))
    # Lines scatter around their laws by more than noise where the laws are not quite right.
    scatter = math.sqrt(max(1.0, chi_squared / max(1, freedom)))
    jacobian = found.jac.copy()
    jacobian[len(loops) :] /= scatter
    spread = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)))
    scale = [free.added.get(name, 1.0) for name in loops] + [abs(first[key]) for key in keys]
    names: list[object] = [*loops, *keys]
    deviations = dict(zip(names, (spread * scale).tolist(), strict=True))
    cost = 2.0 * float(found.cost)
    return LawFit(lines, laws, believed, free, values, sizes, scatter, freedom, deviations, cost)


def _alone(
    lines: Lines,
    values: Values,
    place: int,
    unit: tuple[float, float, float],
    chosen: FloatArray,
) -> float:
    """The size of one law for one order, from the recordings chosen."""
    seen = np.isfinite(lines.size[:, place]) & chosen
    made = line_size(values, lines.orders[place], lines.speeds[seen], *unit)
    weight = lines.sd[seen, place] ** -2
    return float(np.sum(weight * made * lines.size[seen, place]) / np.sum(weight * made**2))


def chosen_laws(lines: Lines, single: Sequence[Law], believed: Values, free: Free) -> LawFit:
    """The law of each order that fits all lines best together."""
    laws: dict[int, Law] = dict.fromkeys(range(len(lines.orders)), single[0])
    best = fit_laws(lines, laws, believed, free)
    for _ in range(3):
        before = dict(best.laws)
        for place in before:
            for law in single:
                best = min(best, best.again({place: law}), key=lambda fit: fit.cost)
        if best.laws == before:
            break
    return best


def with_both(fit: LawFit, place: int) -> LawFit:
    """A fit in which one order's line is of a torque and an angle, if it must be; else of one."""
    best = min(fit.again({place: "torque"}), fit.again({place: "angle"}), key=lambda f: f.cost)
    if np.unique(np.round(fit.lines.speeds)).size < FEWEST_FOR_BOTH:
        return best
    both = fit.again({place: "both"})
    return both if z_between(both, best) >= INDISTINGUISHABLE_Z else best


def generalises(fit: LawFit, place: int) -> bool:
    """Whether an order's law predicts its line at each speed from the others.

    Of at least two speeds; of two laws together the ratio is kept.
    """
    lines, sizes = fit.lines, fit.lines.size[:, place]
    speeds = np.round(lines.speeds / (1e-2 * np.abs(lines.speeds).max()))
    seen = np.isfinite(sizes)
    left = whole = 0.0
    for speed in np.unique(speeds[seen]):
        others = (speeds != speed) & seen
        if not others.any():
            return False
        here = (speeds == speed) & seen
        scale = _alone(lines, fit.values, place, fit.sizes[place], others)
        made = scale * fit.predicted(place, lines.speeds[here])
        left += float(np.sum((sizes[here] - made) ** 2))
        whole += float(np.sum(sizes[here] ** 2))
    return left < EXPLAINED * whole


def z_between(first: LawFit, other: LawFit) -> float:
    """How far the first fits better, in standard deviations of what is left around it."""
    return math.sqrt(max(0.0, other.cost - first.cost)) / first.scatter


RIPPLE, ECCENTRICITY = "motor_torque_ripple", "encoder_eccentricity"
GAINS = ("speed_gain_nm_s_per_rad", "integral_gain_nm_per_rad")
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


@dataclass(frozen=True, slots=True)
class Setting:
    """Pieces, what of the loop is free, what may be named, and notes."""

    turning: tuple[Turning, ...]
    values: dict[str, float]
    free: Free
    candidates: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def used(self) -> tuple[Turning, ...]:
        """Pieces to fit on."""
        return tuple(item for item in self.turning if item.piece.use == "used")

    @property
    def every(self) -> tuple[Turning, ...]:
        """These, and then those to predict."""
        return tuple(sorted(self.turning, key=lambda item: item.piece.use != "used"))


def loop_setting(task: Task) -> Setting:
    """What a configuration asks for.

    Raises
    ------
    UserError
        If bench, recordings or unknowns do not suit the method.
    """
    require_rigid(task)
    task.require_no_known_torque("The speed alone is compared, without any torque.")
    config, bench = task.config, task.bench
    if not set(config.comparison.channels) <= {MOTOR_SPEED}:
        raise refused(
            "A rigid drive in its closed loop is compared by its speed.",
            "[comparison] channels",
            ", ".join(config.comparison.channels),
            f'["{MOTOR_SPEED}"]; or method = "inverse", which compares torque or current; or '
            'drive = "two_mass" in the bench, with its shaft and gap',
        )
    missing = [name for name in GAINS if name in bench.assumed]
    if missing:
        raise ConfigError(
            "What the speed shows of a torque is decided by the controller's gains.",
            file=config.bench,
            where="[parameters]",
            found=f"no {' and no '.join(missing)}",
            expected=" and ".join(f"{name} = {{value = …}}" for name in missing),
        )
    known = {*LOOP_EFFECTS, *CONSTANT}
    others = [effect.name for effect in bench.effects if effect.name not in known]
    if others:
        raise ConfigError(
            "What repeats with the motor is named afresh here, not beside what the bench has.",
            file=config.bench,
            where="[[effects]]",
            found=", ".join(others),
            expected="a bench without them",
        )
    task.require_channels_of([MOTOR_SPEED])
    turning = []
    recordings = even_recordings(task, [(MOTOR_SPEED,)] * len(task.recordings), (MOTOR_SPEED,))
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
            raise refused(
                "A parameter of the loop is free within its tolerance, and this one is none or "
                "has none.",
                "[unknowns] bench_parameters",
                name,
                "one with a tolerance of " + ", ".join(LOOP_PARAMETERS),
            )
    priors = {n: bench.tolerances[n] / math.sqrt(3.0) / bench.value(n) for n in unknown}
    names = wanted(config, bench, dict.fromkeys(CANDIDATES))
    notes = (*notes_of(recordings), HIDDEN, *_soft_shaft(values))
    return Setting(tuple(turning), values, Free(priors), names, notes)


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


LAWS: Mapping[Law, str] = {"torque": RIPPLE, "angle": ECCENTRICITY}

MOST_LINES = 12
"""Looked at: what is beyond them is weaker."""

ONE_SPEED = (
    "All recordings are at one speed: a torque that repeats and an error of the encoder look the "
    "same. A recording at another speed separates them."
)


class RigidLoop:
    """Lines of the speed at orders of the motor, and the laws that they follow over the speeds."""

    name = "forward"

    def describe(self, task: Task) -> str:
        """How many pieces, and what may be named."""
        found = loop_setting(task)
        used, held_out = len(found.used), len(found.turning) - len(found.used)
        return (
            f"forward, the speed alone of a rigid drive, {used} to fit on, {held_out} held out; "
            f"candidates {', '.join(found.candidates)}"
        )

    def diagnose(self, task: Task, progress: StageProgress | None = None) -> Diagnosis:
        """The answer."""
        setting, asked = loop_setting(task), task.config.candidates
        found = find_orders(setting.used, MOST_LINES, asked.false_alarm)
        if progress is not None:
            progress("Seeking orders", 1, 2)
        return _Answer(task, setting, found).diagnosis()


METHOD = RigidLoop()


@dataclass(frozen=True, slots=True)
class _Added:
    """What the loop must have besides: an effect or a wrong parameter, and what looks the same."""

    name: str
    rivals: tuple[str, ...]
    z: float


@dataclass(slots=True)
class _Answer:
    """From orders to the answer."""

    task: Task
    setting: Setting
    found: list[OrderLine]
    true_angle: bool = False

    def diagnosis(self) -> Diagnosis:
        """Name what follows a law, describe the rest."""
        setting = self.setting
        lines = lines_of(setting.used, [line.order for line in self.found])
        laws = [law for law, name in LAWS.items() if name in setting.candidates]
        notes = list(setting.notes)
        fit: LawFit | None = None
        added: list[_Added] = []
        if self.found and laws and _one_speed(lines.speeds):
            notes.append(ONE_SPEED)
        elif self.found and laws:
            first = [k for k, line in enumerate(self.found) if line.order == 1.0 and len(laws) > 1]
            fit = chosen_laws(lines, laws, setting.values, setting.free)
            for place in first:
                fit = with_both(fit, place)
            # What follows no law must not bend the loop of what does.
            kept = {k: law for k, law in fit.laws.items() if generalises(fit, k)}
            fit = replace(fit, laws=kept).again({}) if kept else None
            if fit is not None:
                fit, added = self._with_loop(fit)
                for place in set(first) & fit.laws.keys():
                    fit = with_both(fit, place)
                most = self.task.config.candidates.max_effects or MOST_EFFECTS
                fit = _strongest(fit, max(0, most - len(added)))
        if fit is not None and (again := self._by_true_angle(fit)) is not None:
            return again.diagnosis()
        named, remaining = self._named(lines, fit, notes)
        effects, errors = self._of_loop(fit, added)
        effects = (*named, *effects)
        table, signals = self._compared(fit)
        return Diagnosis(
            verdict_of(effects=bool(effects), parameters=bool(errors), remains=bool(remaining)),
            effects,
            errors,
            tuple(remaining),
            table,
            tuple(notes),
            bench_parameters=_fitted(fit, setting.free.priors) if fit else {},
            signals=signals,
            order_sizes=tuple(self._sizes(fit)),
        )

    def _by_true_angle(self, fit: LawFit) -> _Answer | None:
        """The same over the angle without the encoder's error, once it is named beside torques.

        Over the measured angle a torque of order n has sidebands of n ε/2 of its size.
        """
        first = [k for k in fit.laws if fit.laws[k] != "torque" and self.found[k].order == 1.0]
        if self.true_angle or not first or len(fit.laws) == 1:
            return None

        def without_error(item: Turning) -> Turning:
            (line,), _ = item.fit([1.0])
            if not np.isfinite(line):
                return item
            torque, angle, phase = fit.sizes[first[0]]
            like = angle * torque_of_angle(fit.values, np.full(1, item.speed_rad_per_s))[0]
            turn = line / (torque * np.exp(1j * phase) + like)
            error = angle * np.real(turn / abs(turn) * np.exp(1j * item.angle))
            return replace(item, angle=item.angle - error, made={})

        turning = tuple(map(without_error, self.setting.turning))
        setting = replace(self.setting, turning=turning)
        alarm = self.task.config.candidates.false_alarm
        return _Answer(self.task, setting, find_orders(setting.used, MOST_LINES, alarm), True)

    def _with_loop(self, fit: LawFit) -> tuple[LawFit, list[_Added]]:
        """The fit with what else the loop must have free, and that."""
        effects = [name for name in LOOP_EFFECTS if name in self.setting.candidates]
        wrong = [name for name in ("motor_inertia_kg_m2", *GAINS) if self.setting.values[name]]
        found: list[_Added] = []
        fastest = float(np.abs(fit.lines.speeds).max()) * max(fit.lines.orders)
        units = {
            name: self.setting.values[GAINS[0]] if "friction" in name else 1.0 / fastest
            for name in effects
        }
        while True:
            trials, free = {}, fit.free
            for name in [*effects, *wrong]:
                if name in free.added or name in free.priors:
                    continue
                if name in units:
                    more = replace(free, added={**free.added, name: units[name]})
                else:
                    more = replace(free, priors={**free.priors, name: math.inf})
                made = fit.again({}, more)
                if made.freedom > 0:
                    trials[name] = made
            gains = {name: z_between(made, fit) for name, made in trials.items()}
            good = [name for name in trials if gains[name] >= INDISTINGUISHABLE_Z]
            if not good:
                return fit, found
            top = trials[max(good, key=lambda name: gains[name])]
            first, *rivals = [
                name for name in good if z_between(top, trials[name]) < INDISTINGUISHABLE_Z
            ]
            found.append(_Added(first, tuple(rivals), gains[first]))
            fit = trials[first]
            if not set(wrong) - fit.free.priors.keys():
                return fit, found  # only ratios of inertia and gains show

    def _named(
        self, lines: Lines, fit: LawFit | None, notes: list[str]
    ) -> tuple[list[NamedEffect], list[Unexplained]]:
        """Orders whose law is sure, largest line first, and the others."""
        named, remaining = list[tuple[float, NamedEffect]](), list[Unexplained]()
        for place, line in enumerate(self.found):
            law = None if fit is None else fit.laws.get(place)
            power = float(np.nanmax(lines.size[:, place]))
            if fit is None or law is None:
                remaining.append(self._unexplained(lines, place))
                continue
            first = line.order == 1.0
            rivals = self._rivals(fit, place)
            if law == "angle" and not (first or rivals):
                angle = fit.sizes[place][1]
                notes.append(
                    f"The line at order {line.order:.5g} grows with the speed as an error of the "
                    f"encoder's angle of {1e3 * angle:.2g} mrad does, not as a torque."
                )
            if (law == "angle" or rivals) and not first:
                remaining.append(self._unexplained(lines, place))
                continue
            parts: tuple[Law, ...] = ("torque", "angle") if law == "both" else (law,)
            for part in parts:
                named.append((power, self._effect(fit, place, line, part, rivals)))
        named.sort(key=lambda pair: -pair[0])
        return [effect for _, effect in named], _periodic_in_time(remaining, self.setting.used)

    def _effect(
        self, fit: LawFit, place: int, line: OrderLine, part: Law, rivals: tuple[str, ...]
    ) -> NamedEffect:
        torque, angle, _ = fit.sizes[place]
        sd = fit.deviations[(place, part)]
        z = abs(torque if part == "torque" else angle) / sd
        held = line.order == round(line.order)
        if part == "torque":
            order = Estimate(line.order, math.nan if held else line.sd)
            parameters = {"torque_nm": Estimate(abs(torque), sd), "order": order}
        else:
            parameters = {"angle_rad": Estimate(abs(angle), sd)}
        name = LAWS[part]
        evidence = 0.5 * min(z**2, line.score) - math.log(line.trials)
        return NamedEffect(name, parameters, probability_of(evidence), z, rivals)

    def _rivals(self, fit: LawFit, place: int) -> tuple[str, ...]:
        """The other law, if it fits as well."""
        law = fit.laws[place]
        if law == "both":
            return ()
        other: Law = "angle" if law == "torque" else "torque"
        name = LAWS[other]
        if name not in self.setting.candidates:
            return ()
        made = fit.again({place: other}, self.setting.free)
        return (name,) if z_between(fit, made) < INDISTINGUISHABLE_Z else ()

    def _unexplained(self, lines: Lines, place: int) -> Unexplained:
        """A line without a law, or with one that the catalogue does not have."""
        line, sizes = self.found[place], lines.size[:, place]
        strongest = np.argsort(-np.nan_to_num(sizes))
        seen = [self.setting.used[i].piece.name for i in strongest if sizes[i] > 0.0]
        top = float(np.nanmax(sizes))
        return Unexplained(
            MOTOR_SPEED,
            "motor angle",
            top,
            "rpm",
            line.order,
            line.order,
            math.nan,
            tuple(seen),
            line.score,
        )

    def _of_loop(
        self, fit: LawFit | None, added: Sequence[_Added]
    ) -> tuple[tuple[NamedEffect, ...], tuple[ParameterError, ...]]:
        effects, errors = list[NamedEffect](), list[ParameterError]()
        if fit is None:
            return (), ()
        for item in added:
            name, rivals = item.name, item.rivals
            if name in LOOP_EFFECTS:
                value = Estimate(fit.values[name], fit.deviations[name])
                parameters = {LOOP_EFFECTS[name]: value}
                chance = probability_of(0.5 * item.z**2)
                effects.append(NamedEffect(name, parameters, chance, item.z, rivals))
            else:
                believed = self.task.bench.parameters[name]
                estimate = _fitted(fit, [name])[name]
                errors.append(
                    ParameterError(name, believed.value, believed.tolerance, estimate, rivals)
                )
        errors += parameter_errors(self.task.bench, _fitted(fit, self.setting.free.priors))
        return tuple(effects), tuple(errors)

    def _sizes(self, fit: LawFit | None) -> Iterator[OrderSize]:
        """Every line as the torque that would make it."""
        values = self.setting.values if fit is None else fit.values
        for item in self.setting.every:
            lines = lines_of([item], [line.order for line in self.found])
            for place, line in enumerate(self.found):
                if not math.isfinite(lines.size[0, place]):
                    continue
                law = None if fit is None else fit.laws.get(place)
                one = float(line_size(values, line.order, lines.speeds, 1.0, 0.0, 0.0)[0])
                made = math.nan
                if fit is not None and law is not None:
                    made = float(fit.predicted(place, lines.speeds)[0]) / one
                yield OrderSize(
                    line.order,
                    law or "none",
                    item.piece.name,
                    item.piece.use,
                    float(lines.speeds[0]) * RPM_PER_RAD_PER_S,
                    float(lines.size[0, place]) / one,
                    float(lines.sd[0, place]) / one,
                    made,
                )

    def _compared(self, fit: LawFit | None) -> tuple[DisagreementTable, tuple[PieceSignals, ...]]:
        """Every piece, with a mean alone and with all laws."""
        every = self.setting.every
        before = [item.predicted((), np.zeros(0)) for item in every]
        after = before
        if fit is not None:
            orders = [self.found[place].order for place in fit.laws]
            speeds: FloatArray = np.array([item.speed_rad_per_s for item in every])
            sizes = np.reshape(
                [fit.predicted(place, speeds) for place in fit.laws], (-1, len(every))
            )
            after = [item.predicted(orders, own) for item, own in zip(every, sizes.T, strict=True)]
        return compared_signals([item.piece for item in every], before, after)


def _periodic_in_time(
    lines: Sequence[Unexplained], turning: Sequence[Turning]
) -> list[Unexplained]:
    """Lines at orders that differ but have one frequency, each in another recording, as one."""
    by_name = {item.piece.name: item for item in turning}
    left, found = list(lines), list[Unexplained]()
    while left:
        first = left.pop(0)
        alike = [first]
        for other in list(left):
            for a, b in ((x, y) for x in first.recordings[:1] for y in other.recordings[:1]):
                one, two = by_name[a], by_name[b]
                lasting = min(item.turns / item.turns_per_s for item in (one, two))
                apart = first.lowest_order * one.turns_per_s - other.lowest_order * two.turns_per_s
                if a != b and abs(apart) * lasting < 1.0:
                    alike.append(other)
                    left.remove(other)
        if len(alike) > 1:
            hertz = first.lowest_order * by_name[first.recordings[0]].turns_per_s
            size = max(line.amplitude for line in alike)
            names = tuple(line.recordings[0] for line in alike)
            first = Unexplained(MOTOR_SPEED, "time", size, "rpm", math.nan, math.nan, hertz, names)
        found.append(first)
    return found


def lines_of(turning: Sequence[Turning], orders: Sequence[float]) -> Lines:
    """The lines of every piece, their noise, and the speeds; sizes without what noise adds."""
    sizes, deviations = [], []
    for item in turning:
        found, left = item.fit(orders)
        sd = noise_sd(item, orders, left)
        sizes.append(np.sqrt(np.maximum(np.abs(found) ** 2 - 2.0 * sd**2, 0.0)))
        deviations.append(sd)
    speeds = np.array([item.speed_rad_per_s for item in turning])
    return Lines(tuple(orders), speeds, np.array(sizes), np.array(deviations))


def _strongest(fit: LawFit, most: int) -> LawFit:
    """The laws of the largest lines; the others are left to be described."""
    kept = sorted(fit.laws, key=lambda place: -float(np.nanmax(fit.lines.size[:, place])))[:most]
    return replace(fit, laws={place: fit.laws[place] for place in sorted(kept)})


def _one_speed(speeds: FloatArray) -> bool:
    sizes = np.abs(speeds)
    return bool(np.ptp(sizes) <= VARIES * sizes.max())


def _fitted(fit: LawFit, names: Iterable[str]) -> dict[str, Estimate]:
    """Loop parameters, lognormal."""
    return {
        name: Estimate(math.log(fit.values[name]), fit.deviations[name], logarithmic=True)
        for name in names
    }
