"""How much of h is play and how much the load's friction winds up: h = δ + w/2.

w is what makers' sheets let expect, and, where there is a torque, what it does on the way between
the flanks (:func:`of_windup`). δ has a mass at zero. If weight keeps the load on one flank, h is
w/2 alone, whatever δ is: a third case beside play and none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import ndtr, ndtri
from scipy.stats import beta as beta_distribution
from scipy.stats import norm

from bayesbl.recording.types import FloatArray
from bayesbl.two_encoders.model import INERTIA_S2, WEIGHT, Cell, Model
from bayesbl.two_encoders.paths import ALIKE, COUNTS, SMOOTH_S, Paths

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

LOGITS = np.linspace(-14.0, 10.0, 241)

PARTS = 1.0 / (1.0 + np.exp(-LOGITS))
"""Parts of h that are wind-up, w/2h: fine where either is a small part of the other."""

IMPOSSIBLE = 1e-200
"""Likelihood of what the torque excludes: its logarithm is a number."""


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


def of_friction(paths: Paths) -> tuple[float | None, float]:
    """Friction that turns with the direction, N m, by the motor's torque, and how much more often
    the torque of the load's weight is above it on one side than on the other; nan if no friction
    shows, and ``None`` without a torque. Inertia that is a curve of the angle counts as weight: it
    may be that.
    """
    if paths.torque_nm is None:
        return None, np.nan
    columns, moves = of_motor(paths)
    inertia, weight = columns[moves, 2], columns[moves, 3:]
    own_inertia = inertia - weight @ np.linalg.lstsq(weight, inertia, rcond=1e-6)[0]
    columns[:, 2] *= float(own_inertia @ own_inertia) > ALIKE * float(inertia @ inertia)
    beta = np.linalg.lstsq(columns[moves], paths.torque_nm[moves], rcond=1e-6)[0]
    fast = np.abs(columns[:, 1]) > 0.2
    pull, friction = columns[fast, 3:] @ beta[3:], float(beta[0])
    if friction <= 0.0:
        return 0.0, np.nan
    return friction, float(abs(np.mean(np.sign(pull) * (np.abs(pull) > friction))))


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
    if paths.torque_nm is None or half <= 0.0 or how.drives:
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


def density_of_held(model: Model, cell: Cell) -> Callable[[FloatArray], tuple[FloatArray, ...]]:
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


def priors_of(
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
