"""Posterior of play, wind-up, ratio, skew and transmission error from both encoders at once.

With x the motor's position at the load and θ_l the load's,

    θ_l = x − s(x; h) + H β + e,        s within ±h

where s is the lag of :func:`bayesbl.two_encoders.paths.load_lag`, and H has an offset, how that
wanders over many strokes, what the ratio is off by (x), the skew of the channels (ẋ), inertia that
winds the joint up (ẍ), torque that bends it, and the transmission error: harmonics of motor and
load angle (one curve of the angle, the same both ways, where the load makes less than a turn). β is
normal and integrated out. The noise e is white beside a process with a correlation time (Ornstein
and Uhlenbeck), both by the largest evidence: a drift from stroke to stroke so counts once a stroke,
not once a sample. Counts of the encoders and motion between two samples add to it
(:meth:`bayesbl.two_encoders.paths.Paths.reading_variance`). In the gap the load is where it likes,
so the noise is as wide as the gap there. Misfit that lasts for a stroke is no noise: it moves h, β
and all together (:class:`Final`).

Every course of the flanks (a load that stays, coasts on by some deceleration, or is
moved by its weight) is tried over a grid of h, and their probabilities are added. h, half of what
lies between both directions, is δ and half of what friction of the load winds up:

    h = δ + w/2

w is what makers' sheets let expect, and, where there is a torque, what it does on the way between
the flanks (:func:`of_windup`) and on them (:class:`Compliance`). δ has a mass at zero. If weight
keeps the load on one flank, h is w/2 alone, whatever δ is: a third case beside play and none. Skew,
eccentricity and a wrong ratio make no lag that keeps its size from slow to fast and turns with the
direction: they are told from play by their evidence, here and not before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp, ndtr, ndtri, softmax
from scipy.stats import beta as beta_distribution
from scipy.stats import f as f_distribution
from scipy.stats import norm, qmc

from bayesbl.compiled import compiled
from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.two_encoders.paths import (
    ALIKE,
    COUNTS,
    LONGEST_SKEW_S,
    SMOOTH_S,
    Channels,
    Paths,
    load_lag,
    moving_mean,
    scaled_paths,
)

PLAY_RAD = (1e-5, 1.0)
"""Range of δ; its logarithm is uniform there."""

NO_PLAY = 0.5
"""Probability of none, beforehand."""

HELD_RAD, HELD_SPREAD = 2.5e-5, 1.2
"""Half of what friction winds up, where no torque tells it: median, and standard deviation of ln.

Makers of precision reducers state 0.3 to 0.6 arcmin of lost motion at 3 % of the rated torque,
about what a free output's friction is: 0.04 to 0.09 mrad each way, at most.
"""

SOFT, SOFT_RAD, SOFT_SPREAD = 0.06, 7e-4, 1.0
"""Share of joints that are no such reducers (belts, printed gears, joints that are built elastic),
and the same of theirs without play: one of a hundred winds up by 1.7 mrad each way or more.
"""

PRECISE_RAD = 3e-3
"""δ at which a joint is as likely as not such a reducer: makers' coarsest have 20 arcmin of play.
Beyond, more and more joints are no such reducers."""

SOFT_PART = (0.5, 4.0)
"""Beta distribution of the part of h that is wind-up in joints with play that are no such reducers:
a ninth in the mean, two fifths at most in nineteen of twenty. A judgement."""

FRICTION_SPREAD = 0.5
"""Standard deviation of ln of the load's friction over the recordings of a joint. A judgement, and
a wide one, since here no signal shows that friction: grease 20 K colder may have twice of it.
"""

STOPS, STOPS_SPREAD = 30.0, 1.7
"""Deceleration of a free load by its friction, rad/s²: median, and standard deviation of ln. An arm
has some 2, a bare output behind its seals some 500."""

FILTERS_S2 = 2e-5
"""Standard deviation of what filters of the encoders add to the inertia: a mean over T is as T²/24,
and this is of 20 ms."""

INFORMED, ONE_SD = 0.5, (0.16, 0.84)
"""Half of what lies between these quantiles of ln w, over its scale beforehand, up to which the
torque has told it: above it a compliance would be the makers', not this joint's."""

COASTING = (3.0, 1.0, 0.3, 0.1, 0.0)
"""Decelerations of a free load by its friction, over the motor's root mean square acceleration."""

WEIGHT, RUBBED, HALF = (3.0, 120.0), (0.03, 1.0), (0.5, 4.0)
"""Deceleration by the load's weight, rad/s² (gravity over 3 m to 8 cm), parts of it that friction
makes, and h over half of what the encoders differ by: to begin with."""

WEIGHTS = 9
"""Of these, beside the likeliest, in the answer."""

TRIED, MOVED = 512, 4
"""Points of this space that are weighed, and the best of them that are moved."""

STAYS = 0.5
"""Probability that the load stays, beforehand."""

CURVE_ORDERS, MOTOR_ORDERS, LOAD_ORDERS = 16, 4, 8
"""Of the transmission error: of the travel, and of each angle where it makes a turn."""

ANYWHERE, VISIBLE, CHANGE = 0.8, 8.0, np.log(3.0)
"""Of a load whose way through the gap is not known: its standard deviation there over h (that of a
normal density as high as the uniform one), the least h over the noise, and the cost of a change
between flank and gap."""

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

PLACES = 24
"""Along the travel, at which misfits of one pass and the next are compared."""

MODEL = 1e-2
"""Relative standard deviation of h for all that the model leaves out: flanks that are not straight,
impacts, motion between two samples."""

MOST_CURVE_RAD, STEEPEST = 8e-3, 0.02
"""Largest standard deviation of the first order of the transmission error, and over the travel:
more is another motion.
"""

ENDS = (0.005, 0.995)
"""Quantiles of a misfit between which a hidden play would show."""

LOGITS = np.linspace(-14.0, 10.0, 241)
PARTS = 1.0 / (1.0 + np.exp(-LOGITS))
"""Parts of h that are wind-up, w/2h: fine where either is a small part of the other."""

IMPOSSIBLE = 1e-200
"""Likelihood of what the torque excludes: its logarithm is a number."""

LEAST_TORQUE = 1e-6
"""Of a torque: below it is rounding."""

TORQUE = 4
"""Column of H of what bends the joint, where there is a torque."""

LOOSE = 0.3
"""Standard deviation midway between the flanks, over h."""

COMMON, TOUCHES = 0.1, 0.999
"""The same, of what all passages of a load that coasts have in common, and the lag over h from
which it is on a flank.
"""

WAY_SHARES, ONE_SPEED = (0.1, 0.9), 0.8
"""Shares of the way, up to which it is travelled more slowly than at some speed; the share of those
speeds that calls them one."""

USUAL_SKEW_S, LATE_S = 5e-3, 5e-2
"""Standard deviation of the skew of the channels: of one recorder, and of one that a network is
between."""

LINEAR = 0.02
"""Of the sampling period: a skew up to which the motion is straight."""

RATIO_STATED = 0.01
"""Relative standard deviation of a gear ratio that is stated."""

EDGE = 0.1
"""Of a recording, at most left out at each end."""

MOST_ROUNDS = 10
"""Of fits, until ratio and skew move no more."""

INERTIA_S2 = 3e-4
"""Standard deviation of (1/2πf)², by which inertia winds up a joint that rings at f = 9 Hz."""

UNLIKELY = 20.0
"""Log probability by which a course is below the best, from which it is left out."""

PER_DECADE = 4
"""Of the first grid of h; what holds much of the probability is refined."""

LEAST_RAD = 1e-8
"""Noise beside that of the encoders' counts."""

SURE = 0.95
"""Probability of play from which a load that coasts at one speed is believed."""

DRAWS = (4, 1000)


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations and correlation time of e, and the size of the transmission error."""

    white_rad: float
    drift_rad: float
    drift_s: float
    curve_rad: float


FIRST_NOISE = Noise(1e-3, 3e-4, 0.1, 1e-3)


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


@dataclass(frozen=True, slots=True)
class Transmission:
    """Draws of shape (chain, draw), independent of one another, and what they were drawn from.

    Attributes
    ----------
    draws
        ``delta_rad``, ``play_rad``, ``lost_motion_rad``, ``held_windup_rad``, ``gear_ratio``,
        ``channel_skew_s``, ``transmission_error_rad`` (peak to peak); with a torque that tells it
        ``compliance_rad_per_nm``.
    harmonics
        Draws of amplitudes of the transmission error, rad, by (encoder, order), where that angle
        makes a turn or more.
    probability_of_play
        That δ is not zero.
    counted
        Times that a misfit which repeats is counted.
    misfit_rad
        What the model leaves that is no noise: it lasts for a stroke, or readings scatter less.
    position_rad, lag_rad, modelled_rad, curve_rad
        At the bins: the load's angle, motor less load without all but the lag, the lag as
        modelled, and the transmission error.
    half_lag_rad
        Half of what lies between both directions, in both halves of the recording.
    reversals
        Of the motor.
    friction_nm, gravity_holds
        Friction at the output by the torque, and how much more often the load's weight is above it
        on one side than on the other: nan where no torque tells it.
    of_play
        Evidence, up to a factor, of a joint without play, of one with play whose load leaves its
        flank, and of one with play whose load rests on a flank, each with its odds of play.
    skew_or_play
        All motion has one speed, and between the flanks the load goes its own way, or coasts and
        play is not sure, or most of what lies between both directions is taken for skew of the
        channels: it may be either.
    """

    paths: Paths
    draws: dict[str, FloatArray]
    harmonics: dict[tuple[str, int], FloatArray]
    probability_of_play: float
    counted: float
    misfit_rad: float
    noise: Noise
    position_rad: FloatArray
    lag_rad: FloatArray
    modelled_rad: FloatArray
    curve_rad: FloatArray
    half_lag_rad: tuple[float, float]
    reversals: int
    friction_nm: float | None
    gravity_holds: float
    of_play: tuple[float, float, float]
    skew_or_play: bool


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


class Design:
    """H at the bins with the prior standard deviations of β.

    ``curve`` are the columns of the transmission error, whose size is a parameter of the noise.
    """

    def __init__(self, paths: Paths, scaling: Scaling) -> None:
        self.one_speed = scaling.edge_s > 0.0
        self.motor_rad = paths.binned(paths.motor_rad)
        self.load_rad = paths.binned(paths.load_rad)
        self.time_s = paths.binned(paths.time_s)
        self.travel_rad = float(np.ptp(self.motor_rad))
        motor_turn = 2.0 * np.pi * abs(paths.slope)
        moves = paths.binned(paths.speed), paths.binned(paths.acceleration)
        plain = [np.ones_like(self.motor_rad), self.motor_rad, *moves]
        names = ["offset", "ratio", "skew", "inertia"]
        sd = [1e3, RATIO_STATED if scaling.stated else 0.3, scaling.skew_sd_s, INERTIA_S2]
        self.friction_nm: float | None = None
        self.gravity_holds = np.nan
        if paths.torque_nm is not None:
            self.friction_nm, self.gravity_holds, rest = of_friction(paths)
            bends = paths.binned(rest)
            plain, names = [*plain, bends], [*names, "torque"]
            least = LEAST_TORQUE * max(float(np.abs(paths.torque_nm).max()), 1e-300)
            sd.append(MOST_CURVE_RAD / max(float(np.std(bends)), least))
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
        if self.friction_nm is not None:
            on = on_flank(lag)
            bends = np.interp(self.time_s, self.time_s[on], self.base[on, TORQUE])
            # Its friction is in h.
            square = float(lag @ lag)
            both[:, TORQUE] = bends - lag * (float(lag @ bends) / square if square else 0.0)
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
def _whiten(
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
        as_read = np.eye(design.sd.size)
        self.reference = Cell(0, 0.0, -1e9, as_read[1], as_read, self.measured_lag)
        self.counted, self.repeating = 1.0, 1.0
        self.lead = float(np.mean(paths.motor_rad[:5] - paths.load_rad[:5]))

    def measure_lag(self, cell: Cell) -> None:
        """Take the lag from the measurement, with all else as in a cell."""
        rest = cell.beta.copy()
        rest[1] = 0.0
        other = self.design.columns(cell.lag) @ rest
        self.measured_lag = self.design.motor_rad - (self.design.load_rad - other) / cell.beta[1]
        self.reference = cell

    def centre_lag(self) -> None:
        """Take the middle of what was measured for the middle of the play."""
        self.measured_lag -= np.mean(np.quantile(self.measured_lag, ENDS))

    def lag(self, course: int, half_rad: float) -> FloatArray:
        """s at every sample."""
        if half_rad <= 0.0:
            return np.zeros(self.paths.motor_rad.size)
        path, how = self.paths, self.courses[course]
        # Weight has moved a load to a flank before.
        most = np.copysign(np.inf, self.lead) if how.weight else self.lead
        start = float(np.clip(most, -half_rad, half_rad))
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
            if like < VISIBLE * spread:
                return replace(self.reference, course=course, half_rad=half_rad, log_evidence=-1e9)
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
        log = -change * CHANGE + _whiten(both, self.step_s, white, noise.drift_rad, noise.drift_s)
        precision = design.precision(noise)
        products = both.T @ both
        inner, towards = products[:-1, :-1].copy(), products[:-1, -1]
        inner.flat[:: precision.size + 1] += precision
        factor = cho_factor(inner, lower=True, overwrite_a=True, check_finite=False)
        beta = cho_solve(factor, towards, check_finite=False)
        square = float(products[-1, -1]) - float(towards @ beta)
        diagonal = np.diag(factor[0])
        beta = beta + design.centre
        log -= 1e9 * float(self.courses[course].drives and like < self.visible)
        log += -0.5 * square - float(np.log(diagonal).sum()) + 0.5 * float(np.log(precision).sum())
        return Cell(course, half_rad, log, beta, np.asarray(factor[0]), lag)

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
        # How a load flies is not known, and the same in all passages.
        stays = np.isinf(self.courses[best.course].drag) and not self.design.one_speed
        lasts = misfit_rad * float(np.sqrt(self.repeating)) if stays else misfit_rad
        return Final(lasts, half, passages * common * near)

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

    def repeats(self, cell: Cell) -> tuple[float, float]:
        """Times that the same misfit is counted: one, and the share that repeats for each more;
        and the mean of this share over all that it may be, beforehand alike from none to all.

        What repeats whenever the motor passes the same place in the same direction is no noise,
        and does not average out over cycles (one-way analysis of variance). As strokes and not
        places are independent, the variances have as many degrees of freedom as there are strokes.
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
            return 1.0, 0.5
        within = float(np.sum((mean - centre[where]) ** 2)) / freedom
        between = float(np.sum(number * (centre - mean.mean()) ** 2)) / (number.size - 1)
        common = max(between - within, 0.0) / often
        counted = 1.0 + common / max(common + within, 1e-300) * (often - 1.0)
        shares = (np.arange(256) + 0.5) / 256.0
        scales = 1.0 + often * shares / (1.0 - shares)
        strokes = max(int(stroke.max()) - 1, 1)
        free = min(number.size - 1, strokes), min(freedom, strokes)
        weights = f_distribution.pdf(between / max(within, 1e-300) / scales, *free) / scales
        return counted, float(weights @ shares / max(float(weights.sum()), 1e-300))

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
            optimum = _lowest(cost, simplex, evaluations)
        else:
            optimum = np.append(
                _lowest(lambda p: cost(np.append(p, 0.0)), simplex[:, :4], 160), 0.0
            )
        return Noise(*np.exp(np.clip(optimum[:4], low, high))), at(optimum)


def on_flank(lag: FloatArray) -> NDArray[np.bool_]:
    """Bins where the motor's torque is the load's: not between the flanks, and not by the bins
    where a flank takes the load.
    """
    on = np.abs(lag) >= TOUCHES * float(np.abs(lag).max())
    within = np.asarray(np.convolve(on, np.ones(5), "same") > 4.5)
    return within if within.any() else on


def _lowest(
    cost: Callable[[FloatArray], float], simplex: FloatArray, evaluations: int
) -> FloatArray:
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 3e-3, "fatol": 0.05}
    return np.asarray(minimize(cost, simplex[0], method="Nelder-Mead", options=options).x)


def start_slope(channels: Channels, ratio: float | None) -> tuple[float, bool]:
    """θ_l over θ_m to begin with, and whether it is the stated ratio's.

    The motor's position may be divided by the ratio already, and either sign may be turned.
    """
    slope = channels.slope()
    stated = [] if ratio is None else [1.0 / ratio, 1.0]
    near = [s for s in stated if 0.1 < abs(slope / s) < 1.6]
    if not near:
        return slope, False
    best = min(near, key=lambda s: abs(np.log(abs(slope / s))))
    return float(np.copysign(best, slope)), True


def of_motor(paths: Paths) -> tuple[FloatArray, NDArray[np.bool_]]:
    """What the torque has beside the load's friction: columns (n, 6), and where the motor moves.

    The motor's friction turns with its direction, at once. At rest it has any value.
    """
    usual = float(np.sqrt(np.mean(paths.speed**2)))
    columns = [
        np.sign(paths.speed),
        paths.speed / usual,
        paths.acceleration / max(paths.typical_acceleration, 1e-300),
        np.ones(paths.speed.size),
        np.cos(paths.load_rad),
        np.sin(paths.load_rad),
    ]
    return np.column_stack(columns), np.abs(paths.speed) > max(
        paths.motor_step_rad / SMOOTH_S, usual / COUNTS
    )


def of_friction(paths: Paths) -> tuple[float, float, FloatArray]:
    """By the motor's torque: friction at the usual speed, N m; how much more often the torque of
    the load's weight is above what turns with the direction on one side than on the other, nan if
    no friction shows; and the rest, shape (n,), which bends the joint where the load makes it.

    Inertia that is a curve of the angle counts as weight: it may be that.
    """
    assert paths.torque_nm is not None
    columns, moves = of_motor(paths)
    if not moves.any():  # the steps of a coarse encoder hide all motion
        return 0.0, np.nan, np.zeros(paths.time_s.size)
    inertia, weight = columns[moves, 2], columns[moves, 3:]
    own_inertia = inertia - weight @ np.linalg.lstsq(weight, inertia, rcond=1e-6)[0]
    columns[:, 2] *= float(own_inertia @ own_inertia) > ALIKE * float(inertia @ inertia)
    beta = np.linalg.lstsq(columns[moves], paths.torque_nm[moves], rcond=1e-6)[0]
    fast = np.abs(columns[:, 1]) > 0.2
    pull, friction = columns[fast, 3:] @ beta[3:], float(beta[0])
    # At rest the motor's friction has any value. The acceleration is as smooth.
    rest = np.interp(paths.time_s, paths.time_s[moves], (paths.torque_nm - columns @ beta)[moves])
    rest = moving_mean(rest, paths.time_s, 3.0 * SMOOTH_S)
    # At one speed a part of it is taken for viscous.
    most = max(friction + max(float(beta[1]), 0.0), 0.0)
    if friction <= 0.0:
        return most, np.nan, rest
    return most, float(abs(np.mean(np.sign(pull) * (np.abs(pull) > friction)))), rest


def of_windup(model: Model, cell: Cell) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Likelihood of each of ``PARTS`` of h to be wind-up, by the torque, and the load's friction
    with it and its standard deviation, N m, shapes (parts,).

    The joint hands the load's friction over from where its play ends: with the lag over h as s and
    the part w, sign(s) max(1 − (1 − |s|)/w, 0). Beside it the torque has what the motor itself
    needs. Noise counts once for each passage between the flanks; what is left beyond the scatter
    of readings is the same in all, and counts once. The flanks count as much as all passages: they
    tell what the motor needs. The load stays on the way, or is where it was measured.
    """
    paths, design, half = model.paths, model.design, cell.half_rad
    how = model.courses[cell.course]
    nothing = np.ones(PARTS.size), *np.full((2, PARTS.size), np.nan)
    assert paths.torque_nm is not None
    if half <= 0.0 or how.drives:
        return nothing
    rest = cell.beta.copy()
    rest[1] = 0.0
    other = np.interp(paths.time_s, design.time_s, design.columns(cell.lag) @ rest)
    measured_lag = (paths.motor_rad - (paths.load_rad - other) / cell.beta[1]) / half
    columns, moves = of_motor(paths)
    lag = model.lag(0 if how.free else cell.course, half)[moves] / half
    inside = np.abs(lag) < 1.0 - 1e-9
    passages = min(int(inside.sum()), paths.reversals)
    if not columns.shape[1] < inside.sum() < inside.size:
        return nothing
    root = np.sqrt(np.where(inside, 1.0, inside.sum() / (inside.size - inside.sum())))
    others, _ = np.linalg.qr(columns[moves] * root[:, None])
    torque = paths.torque_nm[moves] * root
    torque -= others @ (others.T @ torque)
    squares, friction, handed_square = np.empty((3, 2, PARTS.size))
    for k, way in enumerate((lag, measured_lag[moves])):
        for i, part in enumerate(PARTS):
            handed = root * np.sign(way) * np.maximum(1.0 - (1.0 - np.abs(way)) / part, 0.0)
            handed -= others @ (others.T @ handed)
            square = float(handed @ handed)
            handed_square[k, i] = square / float(root @ root)
            friction[k, i] = max(float(handed @ torque) / square, 0.0)
            residual = torque - friction[k, i] * handed
            squares[k, i] = float(residual @ residual) / float(root @ root)
    bends = np.diff(paths.torque_nm, 2)
    readings = float(np.median(np.abs(bends)) / 0.6745) ** 2 / 6.0
    least = squares.min()
    variance = max(least - readings, 0.0) + least / passages
    likely = np.maximum(np.exp(-0.5 * (squares - least) / max(variance, 1e-300)), IMPOSSIBLE)
    best, at = likely.argmax(axis=0), np.arange(PARTS.size)
    spread = np.sqrt(variance / handed_square)
    return likely.mean(axis=0), friction[best, at], spread[best, at]


class Compliance:
    """What the load's friction winds up, and the compliance, by how the joint bends with the torque
    beside friction and inertia.

    The compliance is y/q: H has y, and q is the share of that torque's variance that the load
    makes, at least what the misfit allows for; or the load makes none of it, and y tells nothing.
    The load's friction is at most all that the torque has, about as the way between the flanks has
    it (:func:`of_windup`).
    """

    def __init__(self, model: Model, cell: Cell, noise: Noise, total_nm: float) -> None:
        design, on, misfit_rad = model.design, on_flank(cell.lag), model.misfit(noise)
        columns = design.columns(cell.lag)
        others = np.column_stack([np.delete(columns, TORQUE, axis=1), cell.lag])[on]
        both = np.stack([columns[:, TORQUE], design.motor_rad - cell.lag - design.load_rad], axis=1)
        own, behind = (both[on] - others @ np.linalg.lstsq(others, both[on], rcond=1e-9)[0]).T
        square = max(float(own @ own), own.size * (LEAST_TORQUE * total_nm) ** 2)
        measured = float(own @ behind) / square
        # No torque changes with the place: of the misfit, what repeats there counts once.
        lasts = own.size * model.repeating * misfit_rad**2
        error = float(np.sqrt((noise.white_rad**2 + lasts) / square))
        bend = measured**2 * square / own.size
        least = bend / max(bend + misfit_rad**2, 1e-300)
        shares = least + (1.0 - least) * (np.arange(8) + 0.5) / 8.0
        bends = measured + error * ndtri((np.arange(32) + 0.5) / 32.0)
        bends, shares = np.meshgrid(bends[bends > 0.0], shares)
        self.per_nm = (bends / shares).ravel()
        self.weights = 1.0 / (32 * 8 * bends.ravel())
        self.weight_of_none = max(float(norm.pdf(0.0, measured, error)), IMPOSSIBLE)
        self.of_way, friction_nm, spread_nm = of_windup(model, cell)
        self.total_nm, shown = total_nm, np.isfinite(friction_nm)
        self.friction_nm = np.where(shown, np.minimum(friction_nm, total_nm), 0.0)
        self.spread_nm = np.where(shown, spread_nm, 1e3 * total_nm)
        ends = ((end - self.friction_nm) / self.spread_nm for end in (0.0, total_nm))
        self.low, high = map(ndtr, ends)
        self.within = np.maximum(high - self.low, 1e-300)

    def _each(self, windup_rad: FloatArray, part: NDArray[np.int64], k: int) -> FloatArray:
        """Density of ln of the load's friction, if this is the compliance, over all weights."""
        torque, sd = windup_rad / self.per_nm[k], self.spread_nm[part]
        density = np.exp(-0.5 * ((torque - self.friction_nm[part]) / sd) ** 2) * torque
        density *= torque < self.total_nm
        return np.asarray(
            density * self.weights[k] / (np.sqrt(2.0 * np.pi) * sd * self.within[part])
        )

    def likely(self, windup_rad: FloatArray) -> FloatArray:
        """Of half of what friction winds up, shapes (cells, parts)."""
        likely, parts = np.full(windup_rad.shape, self.weight_of_none), np.arange(PARTS.size)
        for k in range(self.per_nm.size):
            likely += self._each(windup_rad, parts, k)
        return np.asarray(likely * self.of_way)

    def drawn(
        self, windup_rad: FloatArray, part: NDArray[np.int64], generator: np.random.Generator
    ) -> FloatArray:
        """Compliances, rad/(N m), of draws with these halves of wind-up, shapes (n,)."""
        each = [self._each(windup_rad, part, k) for k in range(self.per_nm.size)]
        edges = np.cumsum([*each, np.full(part.size, self.weight_of_none)], axis=0)
        level, own = generator.uniform(size=(2, part.size))
        which = (edges < level * edges[-1]).sum(axis=0)
        friction = ndtri(self.low[part] + own * self.within[part])
        friction = self.friction_nm[part] + self.spread_nm[part] * friction
        by_friction = windup_rad / np.maximum(friction, 1e-3 * self.total_nm)
        compliances = np.append(self.per_nm, 0.0)[which]
        return np.asarray(np.where(which < self.per_nm.size, compliances, by_friction))


def _settled(channels: Channels, at: Scaling, report: Progress) -> tuple[Model, Noise, Cell]:
    """The best course where ratio and skew move no more."""
    settled, placed, first = False, None, FIRST_NOISE
    tried: Sequence[int] = ()
    for made in range(MOST_ROUNDS):
        report(made, MOST_ROUNDS + 1)
        model = _model(channels, at)
        # All courses at first and once skew and ratio are settled, else from the last.
        if made == 0 or settled:
            tried = range(2)
        fits = [model.fitted(*_searched(model, first, k), 240 if settled else 80) for k in tried]
        noise, best = max(fits, key=lambda fit: fit[1].log_evidence)
        tried = [best.course]
        if placed is not None:
            noise, best = _placed(model, noise, best, [placed], 0.1 * (1.0 - STAYS))
        if made == 0 or settled:
            noise, best = _coasting(model, noise, best)
        if settled:
            noise, best = _with_weight(model, noise, best)
        placed = model.place(best)
        names = model.design.names
        scale, late = best.beta[names.index("ratio")], -best.beta[names.index("skew")]
        moved = abs(late) > LINEAR * model.paths.period_s
        moved &= abs(at.skew_s + late) < (at.edge_s or LONGEST_SKEW_S)
        scaled = not at.stated and abs(scale - 1.0) > 5e-3
        if at.stated and abs(scale / model.design.centre[1] - 1.0) > RATIO_STATED:
            # Stated wrong, it says nothing: a mean of it and of what is seen is neither.
            at, settled, scaled = replace(at, stated=False), False, True
        if not moved and not scaled:
            if settled:
                break
            settled = True
            continue
        at = replace(
            at,
            skew_s=at.skew_s + float(late) * moved,
            slope=at.slope * (float(scale) if scaled else 1.0),
        )
    return model, noise, best


def fit_transmission(
    channels: Channels,
    seed: np.random.SeedSequence,
    of_joint: np.random.SeedSequence,
    ratio: float | None = None,
    progress: Progress | None = None,
) -> Transmission:
    """Fit one recording; ``ratio`` is the stated one, motor over load.

    ``of_joint``: of what all recordings of a joint have in common.
    """
    report = progress or (lambda made, allowed: None)
    slope, stated = start_slope(channels, ratio)
    paths, at = scaled_paths(channels, slope), Scaling(slope, slope, stated)
    if has_one_speed(paths):
        at = replace(at, edge_s=min(LONGEST_SKEW_S, EDGE * float(np.ptp(paths.time_s))))
    starts = [_settled(channels, at, report)]
    if at.edge_s:
        # At one speed a skew makes the lag of a play: another fit begins with all of it as skew.
        first, _, best = starts[0]
        usual_speed = float(np.std(first.paths.binned(first.paths.speed)))
        skew = min(first.paths.skew_s + best.half_rad / usual_speed, at.edge_s)
        late = replace(at, skew_s=skew, skew_sd_s=LATE_S)
        starts.append(_settled(channels, late, report))
    as_read = replace(at, slope=slope, skew_s=0.0)
    own = [_with_own_way(channels, as_read, start) for start in starts]
    report(MOST_ROUNDS, MOST_ROUNDS + 1)
    # Their evidence is compared with the same misfit, on the way as well: all have the same bins.
    finals = [model.final(best, model.misfit(noise)) for model, noise, best in own]
    misfit = max(final.misfit_rad for final in finals)
    passing = np.max([final.passing for final in finals], axis=0)
    finals = [replace(final, misfit_rad=misfit, passing=passing) for final in finals]
    found = [
        _answered(*each, final, seed, of_joint) for each, final in zip(own, finals, strict=True)
    ]
    return _mixed(found, seed)


def _with_own_way(
    channels: Channels, at: Scaling, start: tuple[Model, Noise, Cell]
) -> tuple[Model, Noise, Cell]:
    """The best course, with a load that goes its own way."""
    model, free, best = start
    # A load that goes its own way is tried last: it would follow any other skew and ratio too. A
    # large play bends those of all other courses, so it is also tried as the recording has it.
    model.measure_lag(best)
    as_read = _model(channels, at)
    as_read.centre_lag()
    for here in (model, as_read):
        fitted, own = _own_way(here, free)
        if own.log_evidence > best.log_evidence:
            model, free, best = here, fitted, own
    model.measure_lag(best)
    free, best = model.fitted(best.course, best.half_rad, free)
    model.counted, model.repeating = model.repeats(best)
    return model, free, best


def _answered(
    model: Model,
    free: Noise,
    best: Cell,
    final: Final,
    seed: np.random.SeedSequence,
    of_joint: np.random.SeedSequence,
) -> tuple[Transmission, float]:
    """The answer about the best course, and its log evidence in the end."""
    noise, _none = model.fitted(0, 0.0, FIRST_NOISE)
    noises = [model.again(noise), model.again(free)]
    sharp = _refined(model, range(len(model.courses)), best, noises, None)
    course = np.array([c.course for c in sharp])
    whole = _of_courses(_log_masses(sharp, np.zeros(len(sharp)), model), course)
    # Passages at one speed are alike: their number does not tell which course the load takes.
    least = -np.inf if model.design.one_speed else whole.max() - UNLIKELY
    likely = sorted({sharp[i].course for i in np.flatnonzero(whole >= least)})
    if best.course in likely and model.courses[best.course].weight:
        likely = [k for k in likely if k == best.course or not model.courses[k].weight]
        others, final = _weights(model, best, noises, final)
        likely += others
    model.design.hold(best.lag)
    lists = sharp, _refined(model, likely, best, noises, final)
    generator = np.random.default_rng(seed)
    evidence = logsumexp(_log_masses(lists[1], np.zeros(len(lists[1])), model))
    return _drawn(model, best, lists, free, generator, of_joint), float(evidence)


def _weights(
    model: Model, best: Cell, noises: Sequence[Noise], final: Final
) -> tuple[list[int], Final]:
    """Courses by other weights than the best one's, each with the friction of the most evidence;
    and what all cells have, where the load flies by any of them.

    Weight moves the load at the same angle both ways: a heavy one over a small h, beside a larger
    transmission error, leaves as little as a light one over a large h.
    """
    first, how = len(model.courses), model.courses[best.course]
    found = [model.cell(best.course, best.half_rad, noise, final) for noise in noises]

    def at(point: FloatArray, weight: complex) -> Cell:
        half, drag = np.exp(point).tolist()
        model.courses[-1] = replace(how, drag=drag, weight=weight)
        cells = [model.cell(len(model.courses) - 1, half, noise, final) for noise in noises]
        return max(cells, key=lambda cell: cell.log_evidence)

    for weight in (np.geomspace(*WEIGHT, WEIGHTS) * how.weight / abs(how.weight)).tolist():
        model.courses.append(how)
        start = np.log([best.half_rad, abs(weight) * float(np.sqrt(np.prod(RUBBED)))])
        simplex = np.vstack([start, start + np.diag([0.2, 0.7])])
        cost = partial(lambda weight, point: -at(point, weight).log_evidence, weight)
        found.append(at(_lowest(cost, simplex, 60), weight))
    least = max(cell.log_evidence for cell in found) - UNLIKELY
    flown = [model.final(cell, final.misfit_rad) for cell in found if cell.log_evidence > least]
    passing = np.max([final.passing, *(each.passing for each in flown)], axis=0)
    return list(range(first, len(model.courses))), replace(final, passing=passing)


def _mixed(
    found: Sequence[tuple[Transmission, float]], seed: np.random.SeedSequence
) -> Transmission:
    """Draws of all answers by their evidence: all passages at one speed are alike, and tell only
    once which skew is the right one. What no draws say is of the likeliest.
    """
    answers = [transmission for transmission, _ in found]
    shares = softmax([evidence for _, evidence in found])
    of = np.random.default_rng(seed.spawn(1)[0]).choice(shares.size, size=DRAWS, p=shares)
    best = answers[int(shares.argmax())]
    common = [name for name in best.draws if all(name in each.draws for each in answers)]
    draws = {name: np.choose(of, [each.draws[name] for each in answers]) for name in common}
    return replace(
        best,
        draws=draws,
        of_play=tuple(shares @ np.array([each.of_play for each in answers])),
        probability_of_play=float(np.mean(draws["delta_rad"] > 0.0)),
    )


def _own_way(model: Model, noise: Noise) -> tuple[Noise, Cell]:
    """With a load that goes its own way between the flanks, as it was measured.

    Where it is on them shows by which offset, skew and ratio it was measured: until they agree.
    """
    freely = next(i for i, how in enumerate(model.courses) if how.free)
    best = None
    for _ in range(MOST_ROUNDS):
        fitted, own = model.fitted(*_searched(model, noise, freely))
        if best is not None and own.log_evidence < best[1].log_evidence + 1.0:
            break
        best = fitted, own
        model.measure_lag(own)
    assert best is not None
    return best


def _model(channels: Channels, at: Scaling) -> Model:
    """The model with the courses that are tried in any case."""
    paths = scaled_paths(channels, at.slope, at.skew_s, at.edge_s)
    rest = 1.0 - STAYS
    drags = np.array(COASTING) * paths.typical_acceleration
    courses = [Course(float(drag), 0.5 * rest / drags.size) for drag in drags]
    courses = [*courses, Course(0.0, 0.2 * rest, free=True)]
    driven = [Course(np.inf, STAYS), Course(np.inf, 0.1 * rest, drives=True)]
    return Model(paths, Design(paths, at), driven + courses)


def _halves(model: Model, least: float, per_decade: int) -> FloatArray:
    most = max(0.6 * float(np.ptp(model.paths.motor_rad)), 1e-4)
    return np.geomspace(least, most, int(per_decade * np.log10(most / least)) + 2)


def _searched(model: Model, noise: Noise, course: int) -> tuple[int, float, Noise]:
    """Course, h and noise to begin with: over a grid, then between its points.

    A peak of h is as narrow as the noise is small, so the noise is sized anew for every h.
    """

    def cost(log: float) -> float:
        return -model.profiled(course, float(np.exp(log)), noise)[1].log_evidence

    logs = np.log(_halves(model, 3e-5, 2 * PER_DECADE))
    first = float(logs[int(np.argmin([cost(log) for log in logs]))])
    step = float(logs[1] - logs[0])
    result = minimize_scalar(
        cost,
        bounds=(first - step, first + step),
        method="bounded",
        options={"maxiter": 16, "xatol": 1e-4},
    )
    half = float(np.exp(result.x))
    return course, half, model.profiled(course, half, noise)[0]


def _placed(
    model: Model, noise: Noise, best: Cell, tried: Sequence[FloatArray], prior: float
) -> tuple[Noise, Cell]:
    """With one more course, where its evidence is the largest.

    ``tried``: ln h, ln of the drag, and both parts of a weight that moves the load.
    The best of them are moved to where the evidence is largest, with the noise of what was best
    without: with less of it the peak is too narrow to be found.
    """
    trial = len(model.courses)

    def at(point: FloatArray) -> Cell:
        drag, weight = float(np.exp(point[1])), complex(*point[2:])
        model.courses[trial:] = [Course(drag, prior, False, weight)]
        return model.cell(trial, float(np.exp(point[0])), noise)

    order = np.argsort([-at(point).log_evidence for point in tried])
    moved: list[tuple[float, FloatArray]] = []
    for point in (tried[int(i)] for i in order[:MOVED]):
        pull = 0.2 * abs(complex(*point[2:]))
        steps = np.diag([0.2, 0.4, pull, pull][: point.size])
        simplex = np.vstack([point, point + steps])
        optimum = _lowest(lambda p: -at(p).log_evidence, simplex, 30 * point.size)
        moved.append((at(optimum).log_evidence, optimum))
    fitted, cell = model.fitted(trial, at(max(moved, key=lambda m: m[0])[1]).half_rad, noise)
    if cell.log_evidence + np.log(prior / model.courses[best.course].prior) <= best.log_evidence:
        del model.courses[trial:]
        return noise, best
    return fitted, cell


def _coasting(model: Model, noise: Noise, best: Cell) -> tuple[Noise, Cell]:
    """With a load that coasts by a deceleration of its own."""
    drags = np.array(COASTING[:-1]) * model.paths.typical_acceleration
    halves = _halves(model, 1e-4, PER_DECADE)
    tried = [np.log([half, drag]) for drag in drags for half in halves]
    return _placed(model, noise, best, tried, 0.1 * (1.0 - STAYS))


def _with_weight(model: Model, noise: Noise, best: Cell) -> tuple[Noise, Cell]:
    """With a load that its weight moves; to begin with by points that fill the space evenly.

    Weight changes the flank at the same angle both ways, as a transmission error would. So h is
    sought about what the error leaves, and about all that it may hold.
    """
    design = model.design
    plain = design.columns(np.zeros(design.load_rad.size))[:, : design.plain]
    held = design.load_rad - plain @ np.linalg.lstsq(plain, design.load_rad, rcond=None)[0]
    fits = [(noise, best)]
    for rest in (model.residual(model.cell(0, 0.0, noise)), held):
        low, high = (np.log([HALF[i], RUBBED[i], WEIGHT[i]]) for i in (0, 1))
        about = np.log(0.5 * float(np.ptp(np.quantile(rest, (0.05, 0.95)))))
        low[0], high[0] = low[0] + about, high[0] + about
        tried = []
        for *shares, turn in qmc.Sobol(4, scramble=False).random(TRIED):
            half, rubbed, weight = low + np.array(shares) * (high - low)
            pull = np.exp(weight + 2j * np.pi * turn)
            tried.append(np.array([half, rubbed + weight, pull.real, pull.imag]))
        fits.append(_placed(model, noise, best, tried, 0.2 * (1.0 - STAYS) / TRIED))
    return max(fits, key=lambda fit: fit[1].log_evidence)


def _refined(
    model: Model, courses: Sequence[int], best: Cell, noises: Sequence[Noise], final: Final | None
) -> list[Cell]:
    """Cells over courses and a grid of h, finer where they hold much of the probability: of all,
    and with ``final`` of each course.
    """
    halves = _halves(model, 1e-6, PER_DECADE)
    wanted = [(course, float(half)) for course in courses for half in halves]
    wanted += [(course, best.half_rad) for course in courses]
    cells: list[Cell] = []
    for _ in range(11):
        for place in wanted:
            here = [model.cell(*place, noise, final) for noise in noises]
            cells.append(max(here, key=lambda cell: cell.log_evidence))
        cells.sort(key=lambda cell: (cell.course, cell.half_rad))
        masses = _log_masses(cells, np.zeros(len(cells)), model)
        course = np.array([cell.course for cell in cells])
        whole = _of_courses(masses, course) if final else logsumexp(masses)
        wanted = [
            (cells[i].course, float(half))
            for i in np.flatnonzero(masses - whole > np.log(0.04))
            if cells[i + 1].half_rad / cells[i].half_rad > 1.0 + 1e-5
            for half in np.geomspace(cells[i].half_rad, cells[i + 1].half_rad, 5)[1:-1]
        ]
    return cells


def _of_courses(masses: FloatArray, course: NDArray[np.int64]) -> FloatArray:
    """Log probability of each cell's course, shape (cells − 1,)."""
    of = course[:-1]
    wholes = np.array([logsumexp(masses[of == k]) for k in range(of.max() + 1)])
    return np.asarray(wholes[of])


def _log_masses(cells: Sequence[Cell], prior: FloatArray, model: Model) -> FloatArray:
    """Log probability between each cell and the next, shape (cells − 1,).

    ``prior``: log density over ln h at each cell.
    """
    weights = np.log([model.courses[c.course].prior for c in cells])
    log = np.array([c.log_evidence for c in cells]) + prior + weights
    width = np.diff(np.log([c.half_rad for c in cells]))
    same = np.diff([c.course for c in cells]) == 0
    with np.errstate(divide="ignore"):
        between = np.logaddexp(log[1:], log[:-1]) + np.log(np.where(same, 0.5 * width, 1.0))
    return np.asarray(np.where(same, between, -np.inf))


def _density_of_held(model: Model, cell: Cell) -> Callable[[FloatArray], tuple[FloatArray, ...]]:
    """Over ln(w/2) of half of what friction winds up: densities of usual and of soft joints, the
    likelihood by the inertia, and density times likelihood of a joint whose play weight hides.

    On one flank w/2 alone shows, whatever δ is. The load's weight is then above its friction, which
    bounds d; and a joint so soft that it rings below some 9 Hz is rare.

    Friction that winds the joint up by w/2 and stops a free load by d comes with an inertia that
    winds it up by w/2d per acceleration. That is seen, or not: a large w needs much friction then.
    """
    inertia = model.design.names.index("inertia")
    unit = np.zeros(cell.beta.size)
    unit[inertia] = 1.0
    column = solve_triangular(cell.root, unit, lower=True)
    variance = float(column @ column)
    # Without the prior of the inertia, which is of any joint.
    known = max(1.0 / variance - INERTIA_S2**-2.0, 1e-3 * INERTIA_S2**-2.0)
    # Of the side that is moved: the load lags behind the motor, or leads it.
    how = model.courses[cell.course]
    sides = np.array([-1.0, 1.0] if how.free else [1.0] if how.drives else [-1.0])[:, None, None]
    measured, spread = cell.beta[inertia] / (variance * known), np.hypot(known**-0.5, FILTERS_S2)
    even = (np.arange(64) + 0.5) / 64.0
    logs = np.linspace(np.log(1e-9), np.log(1e2), 600)

    def likely(stops: FloatArray, softest_s2: float = np.inf) -> FloatArray:
        winds = np.exp(logs)[:, None] / stops
        of_inertia = norm.pdf(measured, sides * winds, spread)
        of_inertia *= np.exp(-0.5 * (winds / softest_s2) ** 2)
        usual = norm.pdf(measured, 0.0, np.hypot(spread, INERTIA_S2))
        return np.asarray(of_inertia.mean(axis=(0, 2)) / usual)

    usual = norm.pdf(logs, np.log(HELD_RAD), HELD_SPREAD)
    soft = norm.pdf(logs, np.log(SOFT_RAD), SOFT_SPREAD)
    any_stop = likely(STOPS * np.exp(STOPS_SPREAD * ndtri(even)))
    below_weight = likely((np.geomspace(*WEIGHT, 64)[:, None] * even[::8]).ravel(), INERTIA_S2)
    delta = np.geomspace(*PLAY_RAD, 256)
    part, is_soft = np.exp(logs)[:, None] / (np.exp(logs)[:, None] + delta), _is_soft(delta)
    hidden = is_soft * beta_distribution.pdf(part, *SOFT_PART) * part * (1.0 - part)
    hidden += (1.0 - is_soft) * usual[:, None]
    densities = usual, soft, any_stop, hidden.mean(axis=1) * below_weight

    def at(held: FloatArray) -> tuple[FloatArray, ...]:
        return tuple(np.interp(np.log(held), logs, each) for each in densities)

    return at


def _is_soft(delta: FloatArray) -> FloatArray:
    """Probability of a joint with this δ, rad, to be no precision reducer."""
    return SOFT + (1.0 - SOFT) * delta**2 / (delta**2 + PRECISE_RAD**2)


def _priors(
    cells: Sequence[Cell],
    flies: NDArray[np.bool_],
    likely: FloatArray,
    of_held: Callable[[FloatArray], tuple[FloatArray, ...]],
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray]:
    """Log densities over ln h at cells, without play, with it and with one that is hidden,
    (cells,), and the second's shares by ``PARTS`` of h that are wound up, of usual and of soft
    joints, (2, cells, parts). ``likely``: by the torque; ``of_held``: densities of what is wound
    up. Where the load ``flies`` from flank to flank, it does so over a part of h that is no
    wind-up, and all sizes of that part are alike.
    """
    half = np.array([c.half_rad for c in cells])
    likely = likely * np.where(flies[:, None], 1.0 - PARTS, 1.0)
    (low, high), gap = PLAY_RAD, half[:, None] * (1.0 - PARTS)
    usual, _, inertia, _ = of_held(half[:, None] * PARTS)
    share = _is_soft(gap)
    # Over the logits here.
    soft = beta_distribution.pdf(PARTS, *SOFT_PART) * PARTS * (1.0 - PARTS)
    of_gap = np.stack([(1.0 - share) * usual, share * soft])
    of_gap *= inertia * likely * ((gap > low) & (gap < high))
    of_gap *= (1.0 - NO_PLAY) / np.log(high / low) * (LOGITS[1] - LOGITS[0])
    usual, soft, inertia, hidden = of_held(half)
    with np.errstate(divide="ignore"):
        held = NO_PLAY * ((1.0 - SOFT) * usual + SOFT * soft) * inertia
        alone = np.maximum(likely[:, -1], IMPOSSIBLE)
        bare, rests = np.log(alone * held), np.log((1.0 - NO_PLAY) * alone * hidden)
        return (bare, np.log(of_gap.sum(axis=(0, 2))), rests), np.asarray(of_gap)


def _drawn(
    model: Model,
    best: Cell,
    lists: Sequence[Sequence[Cell]],
    noise: Noise,
    generator: np.random.Generator,
    of_joint: np.random.SeedSequence,
) -> Transmission:
    """Draws by two lists of cells: whether there is play, and how large it is."""
    paths, design = model.paths, model.design
    names = design.names
    count = int(np.prod(DRAWS))
    # Noise tells whether there is play and which course the load takes, misfit that lasts only h.
    cells = lists[1]
    again = model.again(noise)
    last = model.final(best, model.misfit(noise))
    of_held = _density_of_held(model, model.cell(best.course, best.half_rad, again, last))
    shown = VISIBLE * float(np.hypot(noise.white_rad, model.misfit(noise)))
    falls = [abs(how.weight) > how.drag for how in model.courses]
    flies = [np.array([falls[c.course] and c.half_rad > shown for c in each]) for each in lists]
    compliance = None
    if design.friction_nm:
        compliance = Compliance(model, best, noise, design.friction_nm)
    priors = []
    for each, flying in zip(lists, flies, strict=True):
        windup = np.array([c.half_rad for c in each])[:, None] * PARTS
        likely = np.ones_like(windup) if compliance is None else compliance.likely(windup)
        priors.append(_priors(each, flying, likely, of_held))
    of_parts = priors[1][1]
    sharp, blunt = (
        [_log_masses(each, log, model) for log in prior[0]]
        for each, prior in zip(lists, priors, strict=True)
    )
    # An interval of h that reaches down to none leaves it open whether there is any.
    bare, with_play, rests = np.array([[logsumexp(m) for m in each] for each in (sharp, blunt)]).T
    seen = np.logaddexp(bare, with_play)
    probability = float(np.exp(with_play - seen)[1])
    of_play = np.exp(np.array([bare, with_play, rests]) - np.logaddexp(seen, rests)).T
    # The same joint has play or none in all recordings, and is as soft: a change is not as unknown
    # as what it is of. Its friction is not the same.
    joint = np.random.default_rng(of_joint)
    kind, softer = joint.uniform(size=count), joint.standard_normal(count)
    plays = joint.uniform(size=count) < probability
    half = np.array([c.half_rad for c in cells])
    interval = np.zeros(count, dtype=np.int64)
    # All weights are one course.
    weights = [k for k, how in enumerate(model.courses) if how.weight]
    tried, course = (np.array([c.course for c in each]) for each in lists)
    for index in (tried, course):
        index[np.isin(index, weights)] = min(weights, default=0)
    for mine, masses, wide in zip((~plays, plays), sharp[:2], blunt[:2], strict=True):
        known = dict(zip(tried[:-1].tolist(), _of_courses(masses, tried), strict=True))
        if not model.design.one_speed:
            wide += [known[k] for k in course[:-1].tolist()] - _of_courses(wide, course)
        weights = np.exp(wide - logsumexp(wide))
        interval[mine] = generator.choice(weights.size, size=int(mine.sum()), p=weights)
    share = generator.uniform(size=count)
    lost = np.exp((1.0 - share) * np.log(half[interval]) + share * np.log(half[interval + 1]))
    nearest = interval + (share > 0.5)
    chosen = np.full(count, PARTS.size - 1)
    own = generator.standard_normal(count)
    for cell in np.unique(nearest[plays]):
        usual, soft = of_parts[:, cell]
        here = plays & (nearest == cell)
        is_soft = kind * (usual.sum() + soft.sum()) >= usual.sum()
        for part, those in ((usual, here & ~is_soft), (soft, here & is_soft)):
            if part.any() and those.any():
                chosen[those] = drawn_parts(part, softer[those], own[those])
    step = LOGITS[1] - LOGITS[0]
    logit = LOGITS[chosen] + step * generator.uniform(-0.5, 0.5, size=count)
    delta = np.where(plays, np.clip(lost / (1.0 + np.exp(logit)), *PLAY_RAD), 0.0)
    # What repeats, what lasts and what the model leaves out of the lag do not average out.
    beta = np.empty((count, len(names)))
    for cell in np.unique(nearest):
        there = np.flatnonzero(nearest == cell)
        lasts = float(np.hypot(MODEL * half[cell], last.misfit_rad))
        final = replace(last, misfit_rad=lasts, half_rad=half[cell])
        at = model.cell(cells[cell].course, half[cell], again, final)
        normal = generator.standard_normal((len(names), there.size))
        moved = solve_triangular(at.root, normal, lower=True, trans=1)
        beta[there] = (at.beta[:, None] + moved).T
    # s is scaled as the load follows the motor: a ratio and a transmission error can be exchanged
    # over a part of a turn, not the slope that both make. No model of a gap is better than MODEL.
    mode = cells[nearest[np.argsort(half[nearest])[count // 2]]]
    columns = design.columns(mode.lag)
    measured_lag = mode.lag + columns @ mode.beta - design.load_rad
    flank = np.abs(mode.lag) > np.where(mode.half_rad > 0.0, 0.25 * mode.half_rad, -1.0)
    parts = np.array_split(np.abs(measured_lag[flank]), 2)
    halves = (float(np.median(parts[0])), float(np.median(parts[1])))
    scale = beta @ design.slopes(columns) * np.exp(MODEL * generator.standard_normal(count))
    # Both halves of a recording are two measurements: they scatter by as much as they differ.
    moved = (halves[1] - halves[0]) / np.sqrt(2.0) * generator.standard_normal(count)
    lost = np.maximum(lost * scale + moved, 0.0)
    delta = np.where(plays, np.clip(delta * scale + moved, 0.0, lost), 0.0)
    # What is more than any transmission error may be the load's motion within a play.
    if model.misfit(noise) > max(best.half_rad, MOST_CURVE_RAD):
        share = generator.uniform(size=count) * (generator.uniform(size=count) > NO_PLAY)
        beyond = share * np.maximum(hidden_rad(measured_lag, noise) - lost, 0.0)
        lost, delta = lost + beyond, np.where(beyond > 0.0, lost + beyond, delta)
    # Friction that winds the joint up may follow the speed in any way, and is then like a skew.
    stays = [bool(np.isinf(model.courses[cells[c].course].drag)) for c in nearest]
    usual_speed = float(np.std(paths.binned(paths.speed)))
    by_speed_s = (lost - delta) / usual_speed * generator.standard_normal(count)
    thin = np.linspace(0, design.time_s.size - 1, min(300, design.time_s.size)).astype(int)
    curves = beta[:, design.curve] @ columns[thin][:, design.curve].T
    draws = {
        "delta_rad": delta,
        "play_rad": 2.0 * delta,
        "lost_motion_rad": 2.0 * lost,
        "held_windup_rad": 2.0 * (lost - delta),
        "gear_ratio": 1.0 / (paths.slope * beta[:, names.index("ratio")]),
        "channel_skew_s": paths.skew_s - beta[:, names.index("skew")] - by_speed_s,
        "transmission_error_rad": np.ptp(curves, axis=1),
    }
    if compliance is not None:
        windup = np.maximum(lost - delta, 1e-12)
        per_nm = compliance.drawn(windup, chosen, generator)
        if np.ptp(np.quantile(np.log(per_nm), ONE_SD)) < 2.0 * INFORMED * HELD_SPREAD:
            draws["compliance_rad_per_nm"] = per_nm
    pairs = [name.rsplit(" ", 2)[:2] for name in names if name.endswith(" cos") and "," not in name]
    harmonics = {
        (side, int(order)): np.hypot(
            beta[:, names.index(f"{side} {order} cos")],
            beta[:, names.index(f"{side} {order} sin")],
        ).reshape(DRAWS)
        for side, order in pairs
    }
    curve = columns[:, design.curve] @ mode.beta[design.curve]
    skew = draws["channel_skew_s"]
    shown_skew_s = abs(float(np.median(skew))) - 3.0 * float(skew.std())
    return Transmission(
        paths,
        {name: values.reshape(DRAWS) for name, values in draws.items()},
        harmonics,
        float(np.mean(delta > 0.0)),
        model.counted,
        model.misfit(noise),
        noise,
        design.load_rad,
        measured_lag,
        mode.lag,
        curve,
        halves,
        paths.reversals,
        design.friction_nm,
        design.gravity_holds,
        max(map(tuple, of_play.tolist()), key=lambda each: each[2]),
        design.one_speed
        and bool(
            (np.mean(stays) < 0.5 and np.mean(delta > 0.0) < SURE)
            or np.mean([model.courses[cells[c].course].free for c in nearest]) > 0.5
            or usual_speed * shown_skew_s > float(np.median(lost))
        ),
    )


def drawn_parts(density: FloatArray, joint: FloatArray, own: FloatArray) -> NDArray[np.int64]:
    """Indices of ``PARTS``, shape (n,), by a density over them, (parts,).

    From standard normals, (n,) each: of the joint, and of this recording, whose friction moves ln w
    by ``FRICTION_SPREAD``. A part that the recording's own torque narrows to less is its own.
    """
    edges = np.cumsum(density)
    mean = float(density @ LOGITS) / edges[-1]
    variance = float(density @ (LOGITS - mean) ** 2) / edges[-1]
    common = variance / (variance + FRICTION_SPREAD**2)
    levels = ndtr(np.sqrt(common) * joint + np.sqrt(1.0 - common) * own)
    return np.asarray(np.searchsorted(edges / edges[-1], levels)).clip(max=density.size - 1)


def hidden_rad(lag: FloatArray, noise: Noise) -> float:
    """The δ that a motion may be within that the model does not follow: half of the lag's range,
    beyond that of white noise.
    """
    low, high = np.quantile(lag, ENDS)
    of_noise = float(ndtri(ENDS[1])) * noise.white_rad
    return float(np.sqrt(max((0.5 * (high - low)) ** 2 - of_noise**2, 0.0)))


def has_one_speed(paths: Paths) -> bool:
    """Whether nearly all of the way is travelled at one speed."""
    speed = np.sort(np.abs(paths.binned(paths.speed)))
    way = np.cumsum(speed)
    slow, fast = np.interp(WAY_SHARES, way / way[-1], speed)
    return bool(slow > ONE_SPEED * fast)
