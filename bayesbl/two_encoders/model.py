"""The model of one recording: what the load's encoder reads behind a motor, a play and a gear.

    θ_l = x − s + H β + e

s is the lag of :func:`bayesbl.two_encoders.paths.load_lag` on one course of the load. H has an
offset, how that wanders over many strokes, what the ratio is off by (x), the skew of the channels
(ẋ), inertia that winds the joint up (ẍ), and the transmission error: harmonics of motor and load
angle (one curve of the angle, the same both ways, where the load makes less than a turn). β is
normal and integrated out. The noise e is white beside a process with a correlation time (Ornstein
and Uhlenbeck), both by the largest evidence: a drift from stroke to stroke so counts once a stroke,
not once a sample. Counts of the encoders and motion between two samples add to it
(:meth:`bayesbl.two_encoders.paths.Paths.reading_variance`). In the gap the load is where it likes,
so the noise is as wide as the gap there. Misfit that lasts for a stroke is no noise: it moves h, β
and all together (:class:`Final`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from bayesbl.compiled import compiled
from bayesbl.recording.types import FloatArray
from bayesbl.two_encoders.paths import Channels, Paths, load_lag

CURVE_ORDERS, MOTOR_ORDERS, LOAD_ORDERS = 16, 4, 8
"""Of the transmission error: of the travel, and of each angle where it makes a turn."""

ECCENTRIC_RAD, ENCODER_ORDERS = 0.015, (1, 2, 3)
"""Standard deviation of what an encoder's ring or magnet that is not centred makes once a turn, and
orders of its curve, n times a turn, which fall by 1/n².

Over a part of a turn they look like another gear ratio.
"""

WANDERS_RAD, WANDER_ORDERS, WANDER_STROKES = 1e-3, 4, 4
"""Standard deviation of the first order of what warmth and creep move one reading against the other
over a recording (orders fall by 1/n²), orders at most, and strokes that one has at least: a faster
one would take the place of the lag.
"""

ALIKE_RAD = 1e-3
"""Lag up to which the transmission error is the same at the motor's and the load's angle."""

MOST_CURVE_RAD, STEEPEST = 8e-3, 0.02
"""Largest standard deviation of the first order of the transmission error, and over the travel:
more is another motion.
"""

USUAL_SKEW_S, LATE_S = 5e-3, 5e-2
"""Standard deviation of the skew of the channels: of one recorder, and of one that a network is
between."""

RATIO, RATIO_STATED = 0.3, 0.01
"""Relative standard deviation of a gear ratio, and of one that is stated."""

SAME_RATIO, FAR_RATIO = 0.1, 2.3
"""ln of what the load's motion differs from the motor's by, up to which it is that of a stated
ratio, and from which it is not: a wide play, or a load that is moved, is between."""

INERTIA_S2 = 3e-4
"""Standard deviation of (1/2πf)², by which inertia winds up a joint that rings at f = 9 Hz."""

ANYWHERE, VISIBLE, CHANGE = 0.8, 8.0, np.log(3.0)
"""Of a load whose way through the gap is not known: its standard deviation there over h (that of a
normal density as high as the uniform one), the least h over the noise, and the cost of a change
between flank and gap."""

WEIGHT, RUBBED, HALF = (3.0, 120.0), (0.03, 1.0), (0.5, 4.0)
"""Deceleration by the load's weight, rad/s² (gravity over 3 m to 8 cm), parts of it that friction
makes, and h over half of what the encoders differ by: to begin with."""

PLACES = 24
"""Along the travel, at which misfits of one pass and the next are compared."""

MODEL = 1e-2
"""Relative standard deviation of h for all that the model leaves out: flanks that are not straight,
impacts, motion between two samples."""

ENDS = (0.005, 0.995)
"""Quantiles of a misfit between which a hidden play would show."""

LOOSE = 0.3
"""Standard deviation midway between the flanks, over h."""

COMMON, TOUCHES = 0.1, 0.999
"""The same, of what all passages of a load that coasts have in common, and the lag over h from
which it is on a flank.
"""

LEAST_RAD = 1e-8
"""Noise beside that of the encoders' counts."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations and correlation time of e, and the size of the transmission error."""

    white_rad: float
    drift_rad: float
    drift_s: float
    curve_rad: float


FIRST_NOISE = Noise(1e-3, 3e-4, 0.1, 1e-3)


@dataclass(frozen=True, slots=True)
class Scaling:
    """How the motor's path is scaled and shifted to be the load's.

    ``slope``, θ_l over θ_m, is about ``first_slope``, closely if that is ``stated``; the load's
    stamps are ``skew_s`` late, beforehand about none with ``skew_sd_s``. ``edge_s`` is left out at
    both ends, so that all skews up to it have the same samples; without one all samples count.
    """

    slope: float
    first_slope: float
    stated: bool
    skew_s: float = 0.0
    skew_sd_s: float = USUAL_SKEW_S
    edge_s: float = 0.0


def scalings(channels: Channels, ratio: float | None) -> list[Scaling]:
    """What the motor's path may be scaled by: the stated ratio, if any, or one; else as it moves
    the load.

    The motor's position may be divided by the ratio already, and either sign may be turned. Both
    are tried where a wide play, or a load that is moved, hides which of them it is.
    """
    slope = channels.slope()
    stated = [] if ratio is None else [float(np.copysign(s, slope)) for s in (1.0 / ratio, 1.0)]
    off = {s: abs(np.log(slope / s)) for s in stated}
    near = [s for s in off if off[s] < FAR_RATIO]
    if near and min(off.values()) < SAME_RATIO:
        near = [min(near, key=off.__getitem__)]
    if not near:
        return [Scaling(slope, slope, stated=False)]
    return [Scaling(s, s, stated=True) for s in near]


class Design:
    """H at the bins with the prior standard deviations of β.

    ``curve`` are the columns of the transmission error, whose size is a parameter of the noise.
    """

    def __init__(self, paths: Paths, scaling: Scaling) -> None:
        self.motor_rad = paths.binned(paths.motor_rad)
        self.load_rad = paths.binned(paths.load_rad)
        self.time_s = paths.binned(paths.time_s)
        self.travel_rad = float(np.ptp(self.motor_rad))
        motor_turn = 2.0 * np.pi * abs(paths.slope)
        moves = paths.binned(paths.speed), paths.binned(paths.acceleration)
        plain = [np.ones_like(self.motor_rad), self.motor_rad, *moves]
        names = ["offset", "ratio", "skew", "inertia"]
        sd = [1e3, RATIO_STATED if scaling.stated else RATIO, scaling.skew_sd_s, INERTIA_S2]
        wanders = range(1, 1 + min((paths.reversals + 1) // WANDER_STROKES, WANDER_ORDERS))
        when = 2.0 * (self.time_s - self.time_s[0]) / max(np.ptp(self.time_s), 1e-300) - 1.0
        plain += list(legvander(when, len(wanders)).T[1:])
        names += [f"wander {n}" for n in wanders]
        sd += [WANDERS_RAD / n**2 for n in wanders]
        self.turns = self.travel_rad > 2.0 * np.pi
        first = len(names)
        orders = [np.arange(1, LOAD_ORDERS + 1)] * 2
        if self.turns:
            names += [f"load {n} {part}" for part in ("cos", "sin") for n in orders[0]]
        else:
            names += [f"encoder, {part} {n}" for part in ("cos", "sin") for n in ENCODER_ORDERS]
            sd += [ECCENTRIC_RAD / n**2 for _ in range(2) for n in ENCODER_ORDERS]
            first = len(names)
            orders = [np.arange(1, CURVE_ORDERS + 1)]
            names += [f"curve {n}" for n in orders[0]]
        sd += [1.0 / n for group in orders for n in group]
        if self.travel_rad > motor_turn:
            phase = 2.0 * np.pi / motor_turn * self.motor_rad
            counted = range(1, MOTOR_ORDERS + 1)
            motor = [wave(n * phase) for wave in (np.cos, np.sin) for n in counted]
            names += [f"motor {n} {part}" for part in ("cos", "sin") for n in counted]
            sd += [1.0 / n for _ in range(2) for n in counted]
        else:
            motor = []
        self.plain, self.names, self.sd = len(plain), tuple(names), np.array(sd)
        between = np.zeros((self.time_s.size, len(names) - len(plain) - len(motor)))
        self.base = np.column_stack([*plain, between, *motor])
        self.held = False
        self._follow(self.base, self.motor_rad)
        self.curve = slice(first, len(names))
        self.centre = np.zeros(len(names))
        # The first ratio, wherever the motion is scaled to since, and channels of one clock.
        self.centre[1], self.centre[2] = scaling.first_slope / paths.slope, paths.skew_s
        self.sd[1] *= abs(self.centre[1])

    def columns(self, lag: FloatArray) -> FloatArray:
        """H, shape (bins, k), where the load lags the motor by ``lag``."""
        return self.beside(lag)[:, :-1]

    def beside(self, lag: FloatArray) -> FloatArray:
        """H, and beside it what β about its centre has to explain, shape (bins, k + 1)."""
        both = np.empty((lag.size, len(self.names) + 1))
        both[:, :-1] = self.base
        both[:, 1] = self.motor_rad - lag
        both[:, -1] = self.load_rad - both[:, 1:3] @ self.centre[1:3]
        if not self.held and float(np.abs(lag).max()) > ALIKE_RAD:
            self._follow(both, both[:, 1])
        return both

    def hold(self, lag: FloatArray) -> None:
        """From now on take the transmission error where the load is with this lag.

        Another lag with another skew, which cannot be told from it, has the load at the same angle.
        """
        self._follow(self.base, self.motor_rad - lag)
        self.held = True

    def _follow(self, base: FloatArray, angle: FloatArray) -> None:
        """Take the transmission error at this angle of the load, in place.

        Powers of one wave: not at the load's own reading, which is what H has to explain.
        """
        if self.turns:
            phase, orders = angle, LOAD_ORDERS
        else:
            phase = np.pi * (angle - angle.min()) / max(float(np.ptp(angle)), 1e-300)
            orders = CURVE_ORDERS
        wave, power = np.exp(1j * phase), np.ones(angle.size, dtype=complex)
        column = self.plain
        if not self.turns:
            for wave_of in (np.cos, np.sin):
                for n in ENCODER_ORDERS:
                    base[:, column] = wave_of(n * angle)
                    column += 1
        for n in range(orders):
            power = power * wave
            base[:, column + n] = power.real
            if self.turns:
                base[:, column + orders + n] = power.imag

    def slopes(self, columns: FloatArray) -> FloatArray:
        """Slope over the angle of what each column of H is of the angle, shape (k,)."""
        angle = columns[:, 1] - columns[:, 1].mean()
        slopes = np.asarray(angle @ columns / (angle @ angle))
        slopes[[0, *range(2, self.plain)]] = 0.0
        return slopes

    def precision(self, noise: Noise) -> FloatArray:
        """Of the prior of β."""
        sd = self.sd.copy()
        sd[self.curve] *= min(noise.curve_rad, STEEPEST * self.travel_rad)
        return sd**-2.0


@compiled()
def whitened(
    values: FloatArray, step_s: FloatArray, white: FloatArray, drift: float, drift_s: float
) -> float:  # pragma: no cover (compiled)
    """Turn columns (bins, k) into innovations of unit variance, in place; −½ ln of their variance.

    Kalman's filter of a process of Ornstein and Uhlenbeck seen through white noise.
    """
    bins, k = values.shape
    mean = np.zeros(k)
    variance, log = drift * drift, 0.0
    for i in range(bins):
        if i:
            keep = np.exp(-step_s[i - 1] / drift_s)
            variance = keep * keep * variance + (1.0 - keep * keep) * drift * drift
            for j in range(k):
                mean[j] *= keep
        total = variance + white[i]
        gain, scale = variance / total, 1.0 / np.sqrt(total)
        log -= 0.5 * np.log(total)
        for j in range(k):
            innovation = values[i, j] - mean[j]
            mean[j] += gain * innovation
            values[i, j] = innovation * scale
        variance *= 1.0 - gain
    return log


@dataclass(frozen=True, slots=True)
class Course:
    """How the load gets from flank to flank.

    By its free deceleration through friction and weight, rad/s²; or in no way that is known
    (``free``): the lag is then what was measured, wherever that is well within the gap. Or the
    load is moved and drags the motor (``drives``).
    """

    drag: float
    prior: float
    free: bool = False
    weight: complex = 0j
    drives: bool = False


@dataclass(slots=True)
class Cell:
    """The model at one course and h: log evidence, mean of β and root of its precision."""

    course: int
    half_rad: float
    log_evidence: float
    beta: FloatArray
    root: FloatArray
    lag: FloatArray


@dataclass(frozen=True, slots=True)
class Final:
    """What all cells have that are compared.

    Misfit that does not average out; the h by which the load's place between the flanks is known,
    so that a load in no place that is known makes no gap likely; and the variance of that place
    over the bins if it coasts there, rad²: what it does at one passage it does at all, which count
    once.
    """

    misfit_rad: float
    half_rad: float
    passing: FloatArray


class Model:
    """The model of one recording at one scaling of the paths."""

    def __init__(self, paths: Paths, design: Design, courses: Sequence[Course]) -> None:
        self.paths, self.design, self.courses = paths, design, list(courses)
        self.step_s = np.diff(design.time_s)
        self.reading = paths.reading_variance()
        samples = np.diff(paths.bins)
        # White noise is that of a bin in the middle.
        self.share = np.median(samples) / samples
        # Of a lag that follows the load's own readings: it follows their noise too.
        self.visible = VISIBLE * float(paths.scatter_rad + paths.load_step_rad)
        self.measured_lag = design.motor_rad - design.load_rad
        self.counted = 1.0
        self.lead = float(np.mean(paths.motor_rad[:5] - paths.load_rad[:5]))

    def measure_lag(self, cell: Cell) -> None:
        """Take the lag from the measurement, with all else as in a cell."""
        rest = cell.beta.copy()
        rest[1] = 0.0
        other = self.design.columns(cell.lag) @ rest
        self.measured_lag = self.design.motor_rad - (self.design.load_rad - other) / cell.beta[1]

    def lag(self, course: int, half_rad: float) -> FloatArray:
        """s at every sample."""
        if half_rad <= 0.0:
            return np.zeros(self.paths.motor_rad.size)
        path, how = self.paths, self.courses[course]
        start = float(np.clip(self.lead, -half_rad, half_rad))
        if how.drives:
            motion = path.load_rad, path.speed, path.time_s
            return -np.asarray(load_lag(*motion, half_rad, how.drag, -start))
        motion = path.fine_motor_rad, path.fine_speed, path.fine_time_s
        return np.asarray(load_lag(*motion, half_rad, how.drag, start, how.weight))[:: path.every]

    def cell(self, course: int, half_rad: float, noise: Noise, final: Final | None = None) -> Cell:
        """The evidence there, and β; ``final`` where cells are compared.

        A misfit that is the same at all bins counts once: as white noise √bins times as large.
        """
        design, change, like = self.design, 0, half_rad if final is None else final.half_rad
        spread = float(np.hypot(noise.white_rad, noise.drift_rad))
        if free := self.courses[course].free:
            margin = min(3.0 * spread, 0.2 * like)
            inside = np.abs(self.measured_lag) < like - margin
            lag = np.where(inside, self.measured_lag, half_rad * np.sign(self.measured_lag))
            loose = np.where(inside, (ANYWHERE * like) ** 2, 0.0)
            change = int(np.count_nonzero(np.diff(inside)))
        else:
            lag = self.paths.binned(self.lag(course, half_rad))
            # In the gap, and nowhere without one.
            share = 1.0 - np.abs(lag) / half_rad if half_rad else np.zeros(lag.size)
            loose = (LOOSE * like * np.maximum(share, 0.0)) ** 2
        of_noise = noise.white_rad**2 * self.share + self.reading
        white = of_noise + loose
        if final is not None:
            # A load that is anywhere is where other values of skew and ratio have it.
            anywhere = loose * free * lag.size
            white = of_noise + np.maximum(final.passing, anywhere)
            white += lag.size * final.misfit_rad**2
        both = design.beside(lag)
        log = -change * CHANGE + whitened(both, self.step_s, white, noise.drift_rad, noise.drift_s)
        least = VISIBLE * spread if free else self.visible * self.courses[course].drives
        log -= 1e9 * float(like < least)
        precision, products = design.precision(noise), both.T @ both
        inner, towards = products[:-1, :-1].copy(), products[:-1, -1]
        inner.flat[:: precision.size + 1] += precision
        factor = cho_factor(inner, lower=True, overwrite_a=True, check_finite=False)
        root, beta = np.asarray(factor[0]), cho_solve(factor, towards, check_finite=False)
        square = float(products[-1, -1]) - float(towards @ beta)
        width = float(np.log(np.diag(root)).sum()) - 0.5 * float(np.log(precision).sum())
        evidence = log - 0.5 * square - width
        return Cell(course, half_rad, evidence, beta + design.centre, root, lag)

    def place(self, cell: Cell) -> FloatArray | None:
        """Where a course that was placed is: ln h, ln of the drag, and both parts of a weight."""
        how = self.courses[cell.course]
        if how.free or not np.isfinite(how.drag) or how.drag <= 0.0 or cell.half_rad <= 0.0:
            return None
        way = [how.weight.real, how.weight.imag] if how.weight else []
        return np.array([np.log(cell.half_rad), np.log(how.drag), *way])

    def final(self, best: Cell, misfit_rad: float) -> Final:
        """What the cells near the best one have."""
        half, lag = best.half_rad, best.lag
        side = np.where(np.abs(lag) < TOUCHES * half, 0.0, np.sign(lag))
        near = np.convolve(np.diff(side) != 0.0, np.ones(4))[1:-1] + (side == 0.0) > 0.0
        passages = 1 + np.count_nonzero(np.diff(np.sign(lag)))
        # A load that rests there has the same count at each turn at the same place.
        common = (COMMON * half) ** 2 + self.paths.load_step_rad**2 / 12.0
        return Final(misfit_rad, half, passages * common * near)

    def misfit(self, noise: Noise) -> float:
        """What lasts for a stroke, and white noise beyond twice that of readings, rad."""
        readings = max(self.paths.scatter_variance(), float(np.median(self.reading)))
        beyond = max(noise.white_rad**2 - 2.0 * readings, 0.0)
        return float(np.sqrt(noise.drift_rad**2 + beyond))

    def again(self, noise: Noise) -> Noise:
        """Noise of which each repetition counts once."""
        return replace(noise, white_rad=noise.white_rad * np.sqrt(self.counted))

    def residual(self, cell: Cell) -> FloatArray:
        """e at the bins, rad."""
        columns = self.design.columns(cell.lag)
        return np.asarray(self.design.load_rad - columns @ cell.beta)

    def repeats(self, cell: Cell) -> float:
        """Times that the same misfit is counted: one, and the share that repeats for each more.

        What repeats whenever the motor passes the same place in the same direction is no noise,
        and does not average out over cycles (one-way analysis of variance).
        """
        residual, x = self.residual(cell), self.design.motor_rad
        place = np.minimum((x - x.min()) / np.ptp(x) * PLACES, PLACES - 1).astype(int)
        forward = self.paths.binned(self.paths.speed) > 0.0
        group = 2 * place + forward
        stroke = np.cumsum(np.append(False, np.diff(forward.astype(int)) != 0))
        # A mean for each pass, so that the many samples of one are not taken for many passes.
        passes, inverse = np.unique(group * (stroke.max() + 1) + stroke, return_inverse=True)
        mean = np.bincount(inverse, residual) / np.bincount(inverse)
        where = np.unique(passes // (stroke.max() + 1), return_inverse=True)[1]
        number = np.bincount(where)
        centre = np.bincount(where, mean) / number
        freedom = mean.size - number.size
        often = mean.size / number.size
        if freedom < 4 or number.size < 2:
            return 1.0
        within = float(np.sum((mean - centre[where]) ** 2)) / freedom
        between = float(np.sum(number * (centre - mean.mean()) ** 2)) / (number.size - 1)
        common = max(between - within, 0.0) / often
        return 1.0 + common / max(common + within, 1e-300) * (often - 1.0)

    def profiled(self, course: int, half_rad: float, first: Noise) -> tuple[Noise, Cell]:
        """The cell with noise of about the size of what it leaves: on the flanks, of a load that
        goes its own way. A large play makes more of it than a gap can be seen in, if that is first
        taken for drift.
        """
        if self.courses[course].free:
            least = 0.5 * half_rad / VISIBLE
            white, drift = min(first.white_rad, least), min(first.drift_rad, least)
            first = replace(first, white_rad=white, drift_rad=drift)
        cell = self.cell(course, half_rad, first)
        residual = self.residual(cell)
        if self.courses[course].free and np.any(on_flank := np.abs(cell.lag) >= half_rad):
            residual = residual[on_flank]
        jumps = 1.05 * float(np.median(np.abs(np.diff(residual)))) if residual.size > 1 else 0.0
        spread = 1.5 * float(np.median(np.abs(residual)))
        noise = Noise(max(jumps, LEAST_RAD), max(spread, LEAST_RAD), first.drift_s, first.curve_rad)
        return noise, self.cell(course, half_rad, noise)

    def fitted(
        self, course: int, half_rad: float, first: Noise, evaluations: int = 240
    ) -> tuple[Noise, Cell]:
        """Noise and h of the largest evidence from a first guess; h stays zero if it is."""
        # A drift over many strokes would take the place of the offset that it cannot be told from.
        stroke = float(np.ptp(self.design.time_s)) / (self.paths.reversals + 1)
        least = 2.0 * float(np.min(self.step_s))
        low = np.log([LEAST_RAD, LEAST_RAD, least, 1e-6])
        high = np.log([1.0, 1.0, max(stroke, least), MOST_CURVE_RAD])
        guess, _there = self.profiled(course, half_rad, first)
        starts = [np.clip(np.log(astuple(each)), low, high) for each in (guess, first)]

        def at(point: FloatArray) -> Cell:
            half = half_rad * float(np.exp(np.clip(point[4], -1.0, 1.0))) if half_rad else 0.0
            return self.cell(course, half, Noise(*np.exp(np.clip(point[:4], low, high))))

        def cost(point: FloatArray) -> float:
            beyond = float(np.sum((point[:4] - np.clip(point[:4], low, high)) ** 2))
            outside = beyond + max(abs(float(point[4])) - 1.0, 0.0)
            return 10.0 * outside - at(point).log_evidence

        points = [np.append(start, 0.0) for start in starts]
        start = min(points, key=cost)
        steps = np.diag([*np.where(start[:4] < high - 1.0, 0.7, -0.7), 0.2])
        simplex = np.vstack([start, start + steps])[: 6 if half_rad else 5]
        if half_rad:
            optimum = lowest(cost, simplex, evaluations)
        else:
            optimum = np.append(lowest(lambda p: cost(np.append(p, 0.0)), simplex[:, :4], 160), 0.0)
        return Noise(*np.exp(np.clip(optimum[:4], low, high))), at(optimum)


def lowest(
    cost: Callable[[FloatArray], float], simplex: FloatArray, evaluations: int
) -> FloatArray:
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 3e-3, "fatol": 0.05}
    return np.asarray(minimize(cost, simplex[0], method="Nelder-Mead", options=options).x)
