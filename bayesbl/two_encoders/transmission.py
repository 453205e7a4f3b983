"""Posterior of play, wind-up, ratio, skew and transmission error from both encoders at once.

With x the motor's position at the load and θ_l the load's,

    θ_l = x − s(x; h) + H β + e,        s within ±h,        h = δ + w/2

where s is the lag of :func:`bayesbl.two_encoders.paths.load_lag`, H is linear
(:class:`bayesbl.two_encoders.model.Design`), and h, half of what lies between both directions, is
δ and half of what friction of the load winds up (:mod:`bayesbl.two_encoders.windup`). β is
integrated out; the noise e has the largest evidence (:class:`bayesbl.two_encoders.model.Model`).

Every course of the flanks (a load that stays, coasts on by some deceleration, or is
moved by its weight) is tried over a grid of h, and their probabilities are added. Skew,
eccentricity and a wrong ratio make no lag that keeps its size from slow to fast and turns with the
direction: they are told from play by their evidence, here and not before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp, ndtri, softmax
from scipy.stats import qmc

from bayesbl.progress import Progress
from bayesbl.recording.types import FloatArray
from bayesbl.two_encoders.model import (
    ENDS,
    FIRST_NOISE,
    HALF,
    LATE_S,
    MODEL,
    MOST_CURVE_RAD,
    RUBBED,
    VISIBLE,
    WEIGHT,
    Cell,
    Course,
    Design,
    Final,
    Model,
    Noise,
    Scaling,
    lowest,
    scalings,
)
from bayesbl.two_encoders.paths import LONGEST_SKEW_S, Channels, Paths, scaled_paths
from bayesbl.two_encoders.windup import (
    HELD_SPREAD,
    LOGITS,
    NO_PLAY,
    PARTS,
    PLAY_RAD,
    density_of_held,
    drawn_parts,
    of_friction,
    of_windup,
    priors_of,
)

INFORMED, ONE_SD = 0.5, (0.16, 0.84)
"""Half of what lies between these quantiles of ln w, over its scale beforehand, up to which the
torque has told it: above it a compliance would be the makers', not this joint's."""

COASTING = (3.0, 1.0, 0.3, 0.1, 0.0)
"""Decelerations of a free load by its friction, over the motor's root mean square acceleration."""

TRIED, MOVED = 512, 4
"""Points of this space that are weighed, and the best of them that are moved."""

STAYS = 0.5
"""Probability that the load stays, beforehand."""

LINEAR = 0.02
"""Of the sampling period: a skew up to which the motion is straight."""

EDGE = 0.1
"""Of a recording, at most left out at each end."""

MOST_ROUNDS = 10
"""Of fits, until ratio and skew move no more."""

UNLIKELY = 20.0
"""Log probability by which a course is below the best, from which it is left out."""

PER_DECADE = 4
"""Of the first grid of h; what holds much of the probability is refined."""

SURE = 0.95
"""Probability of play from which a load that coasts at one speed is believed."""

DRAWS = (4, 1000)


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
        begin = [[placed]] if placed is not None else []
        if made == 0 or settled:
            begin.append(_coasting(model))
        if settled:
            begin += _falling(model, noise)
        for points in begin:
            noise, best = _placed(model, noise, best, points)
        placed = model.place(best)
        scale, late = best.beta[1], -best.beta[2]
        moved = abs(late) > LINEAR * model.paths.period_s
        moved &= abs(at.skew_s + late) < (at.edge_s or LONGEST_SKEW_S)
        scaled = not at.stated and abs(scale - 1.0) > 5e-3
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
    ats = scalings(channels, ratio)
    if len(ats) > 1 or scaled_paths(channels, ats[0].slope).has_one_speed:
        # Fits that are compared have the same samples.
        edge_s = min(LONGEST_SKEW_S, EDGE * float(np.ptp(channels.time_s)))
        ats = [replace(at, edge_s=edge_s) for at in ats]
    settled = [(at, _settled(channels, at, report)) for at in ats]
    most = max(best.log_evidence for _, (_, _, best) in settled)
    own = []
    for at, start in settled:
        model, _, best = start
        if best.log_evidence < most - UNLIKELY:
            continue
        own.append(_with_own_way(channels, at, start))
        if model.paths.has_one_speed:
            # A skew makes the lag of a play: another fit begins with all of it as skew.
            skew = model.paths.skew_s + best.half_rad / model.paths.usual_speed
            late = replace(at, skew_s=min(skew, at.edge_s), skew_sd_s=LATE_S)
            late_start = _settled(channels, late, report)
            own.append(_with_own_way(channels, replace(late, skew_s=0.0), late_start))
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
    as_read.measured_lag -= np.mean(np.quantile(as_read.measured_lag, ENDS))
    for here in (model, as_read):
        fitted, own = _own_way(here, free)
        if own.log_evidence > best.log_evidence:
            model, free, best = here, fitted, own
    model.measure_lag(best)
    return model, *model.fitted(best.course, best.half_rad, free)


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
    model.counted = model.repeats(best)
    noises = [model.again(noise), model.again(free)]
    sharp = _refined(model, range(len(model.courses)), best, noises, None)
    whole = _of_courses(_log_masses(sharp, np.zeros(len(sharp)), model), sharp)
    # Passages at one speed are alike: their number does not tell which course the load takes.
    least = -np.inf if model.paths.has_one_speed else whole.max() - UNLIKELY
    likely = sorted({sharp[i].course for i in np.flatnonzero(whole >= least)})
    model.design.hold(best.lag)
    lists = sharp, _refined(model, likely, best, noises, final)
    generator = np.random.default_rng(seed)
    evidence = logsumexp(_log_masses(lists[1], np.zeros(len(lists[1])), model))
    return _drawn(model, best, lists, final, free, generator, of_joint), float(evidence)


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
    model: Model, noise: Noise, best: Cell, tried: Sequence[FloatArray]
) -> tuple[Noise, Cell]:
    """With one more course, where its evidence is the largest.

    ``tried``: ln h, ln of the drag, and both parts of a weight that moves the load.
    The best of them are moved to where the evidence is largest, with the noise of what was best
    without: with less of it the peak is too narrow to be found.
    """
    trial = len(model.courses)
    prior = (1.0 - STAYS) * (0.2 / TRIED if tried[0].size > 2 else 0.1)

    def at(point: FloatArray) -> Cell:
        drag, weight = float(np.exp(point[1])), complex(*point[2:])
        model.courses[trial:] = [Course(drag, prior, False, weight)]
        return model.cell(trial, float(np.exp(point[0])), noise)

    def cost(point: FloatArray) -> float:
        return -at(point).log_evidence

    moved = []
    for point in sorted(tried, key=cost)[:MOVED]:
        pull = 0.2 * abs(complex(*point[2:]))
        steps = np.diag([0.2, 0.4, pull, pull][: point.size])
        moved.append(lowest(cost, np.vstack([point, point + steps]), 30 * point.size))
    fitted, cell = model.fitted(trial, at(min(moved, key=cost)).half_rad, noise)
    if cell.log_evidence + np.log(prior / model.courses[best.course].prior) <= best.log_evidence:
        del model.courses[trial:]
        return noise, best
    return fitted, cell


def _coasting(model: Model) -> list[FloatArray]:
    """Where to begin for a load that coasts by a deceleration of its own."""
    drags = np.array(COASTING[:-1]) * model.paths.typical_acceleration
    halves = _halves(model, 1e-4, PER_DECADE)
    return [np.log([half, drag]) for drag in drags for half in halves]


def _falling(model: Model, noise: Noise) -> list[list[FloatArray]]:
    """Where to begin for a load that its weight moves: points that fill the space evenly.

    Weight changes the flank at the same angle both ways, as a transmission error would. So h is
    sought about what the error leaves, and about all that it may hold.
    """
    design = model.design
    plain = design.columns(np.zeros(design.load_rad.size))[:, : design.plain]
    held = design.load_rad - plain @ np.linalg.lstsq(plain, design.load_rad, rcond=None)[0]
    shares = qmc.Sobol(4, scramble=False).random(TRIED)
    halves, rubbed, weights = (
        np.exp(share * np.diff(np.log(ends)) + np.log(ends[0]))
        for share, ends in zip(shares.T, (HALF, RUBBED, WEIGHT), strict=False)
    )
    pulls = weights * np.exp(2j * np.pi * shares[:, 3])
    begin = []
    for rest in (model.residual(model.cell(0, 0.0, noise)), held):
        about = 0.5 * float(np.ptp(np.quantile(rest, (0.05, 0.95))))
        sizes = np.log([halves * about, rubbed * weights])
        begin.append(list(np.column_stack([*sizes, pulls.real, pulls.imag])))
    return begin


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
        whole = _of_courses(masses, cells) if final else logsumexp(masses)
        wanted = [
            (cells[i].course, float(half))
            for i in np.flatnonzero(masses - whole > np.log(0.04))
            if cells[i + 1].half_rad / cells[i].half_rad > 1.0 + 1e-5
            for half in np.geomspace(cells[i].half_rad, cells[i + 1].half_rad, 5)[1:-1]
        ]
    return cells


def _of_courses(masses: FloatArray, cells: Sequence[Cell]) -> FloatArray:
    """Log probability of each cell's course, shape (cells − 1,)."""
    course = np.array([c.course for c in cells[:-1]])
    wholes = np.array([logsumexp(masses[course == k]) for k in range(course.max() + 1)])
    return np.asarray(wholes[course])


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


@dataclass(frozen=True, slots=True)
class Cases:
    """No play, play that shows, and play that a load on one flank hides, over cells of h.

    ``of_play`` has their evidence; ``weights`` the probability between each cell and the next of
    the first two, (2, cells − 1); ``of_parts`` the second's by ``PARTS``, of usual and of soft
    joints, (2, cells, parts).
    """

    probability: float
    of_play: tuple[float, float, float]
    weights: FloatArray
    of_parts: FloatArray


def _weighed(
    model: Model,
    best: Cell,
    lists: Sequence[Sequence[Cell]],
    last: Final,
    noise: Noise,
    likely: FloatArray,
) -> Cases:
    """Cases by two lists of cells: noise tells whether there is play and which course the load
    takes, misfit that lasts only h. ``likely``: by the torque.
    """
    by_noise, cells = lists
    at = model.cell(best.course, best.half_rad, model.again(noise), last)
    of_held = density_of_held(model, at)
    shown = VISIBLE * float(np.hypot(noise.white_rad, model.misfit(noise)))
    falls = [abs(how.weight) > how.drag for how in model.courses]
    flies = [np.array([falls[c.course] and c.half_rad > shown for c in each]) for each in lists]
    priors = [priors_of(c, f, likely, of_held) for c, f in zip(lists, flies, strict=True)]
    sharp, blunt = (
        np.array([_log_masses(each, log, model) for log in prior[0]])
        for each, prior in zip(lists, priors, strict=True)
    )
    # An interval of h that reaches down to none leaves it open whether there is any.
    evidence = logsumexp(sharp, axis=1), logsumexp(blunt, axis=1)
    probability = min(softmax(each[:2])[1] for each in evidence)
    of_play = max((softmax(each) for each in evidence), key=lambda each: float(each[2]))
    if not model.paths.has_one_speed:
        for masses, wide in zip(sharp[:2], blunt[:2], strict=True):
            courses = (c.course for c in by_noise[:-1])
            known = dict(zip(courses, _of_courses(masses, by_noise), strict=True))
            wide += [known[c.course] for c in cells[:-1]] - _of_courses(wide, cells)
    none, seen, hidden = of_play.tolist()
    weights = softmax(blunt[:2], axis=1)
    return Cases(float(probability), (none, seen, hidden), weights, priors[1][1])


def _sizes(
    cells: Sequence[Cell], cases: Cases, generator: np.random.Generator, joint: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.int64], FloatArray, NDArray[np.int64], FloatArray]:
    """Draws, (n,) each: whether there is play, the nearest cell, h, the index of the part of it
    that is wound up, and δ.

    The same joint has play or none in all recordings, and is as soft: a change is not as unknown
    as what it is of. Its friction is not the same.
    """
    count = int(np.prod(DRAWS))
    kind, softer = joint.uniform(size=count), joint.standard_normal(count)
    plays = joint.uniform(size=count) < cases.probability
    half = np.array([c.half_rad for c in cells])
    interval = np.zeros(count, dtype=np.int64)
    for mine, weights in zip((~plays, plays), cases.weights, strict=True):
        interval[mine] = generator.choice(weights.size, size=int(mine.sum()), p=weights)
    share = generator.uniform(size=count)
    lost = np.exp((1.0 - share) * np.log(half[interval]) + share * np.log(half[interval + 1]))
    nearest = interval + (share > 0.5)
    chosen = np.full(count, PARTS.size - 1)
    own = generator.standard_normal(count)
    for cell in np.unique(nearest[plays]):
        usual, soft = cases.of_parts[:, cell]
        here = plays & (nearest == cell)
        is_soft = kind * (usual.sum() + soft.sum()) >= usual.sum()
        for part, those in ((usual, here & ~is_soft), (soft, here & is_soft)):
            if part.any() and those.any():
                chosen[those] = drawn_parts(part, softer[those], own[those])
    step = LOGITS[1] - LOGITS[0]
    logit = LOGITS[chosen] + step * generator.uniform(-0.5, 0.5, size=count)
    delta = np.where(plays, np.clip(lost / (1.0 + np.exp(logit)), *PLAY_RAD), 0.0)
    return plays, nearest, lost, chosen, delta


def _drawn(
    model: Model,
    best: Cell,
    lists: Sequence[Sequence[Cell]],
    last: Final,
    noise: Noise,
    generator: np.random.Generator,
    of_joint: np.random.SeedSequence,
) -> Transmission:
    """Draws by two lists of cells."""
    paths, design, names, cells = model.paths, model.design, model.design.names, lists[1]
    count = int(np.prod(DRAWS))
    likely, friction_nm, friction_sd = of_windup(model, best)
    cases = _weighed(model, best, lists, last, noise, likely)
    joint = np.random.default_rng(of_joint)
    plays, nearest, lost, chosen, delta = _sizes(cells, cases, generator, joint)
    half = np.array([c.half_rad for c in cells])
    # What repeats, what lasts and what the model leaves out of the lag do not average out.
    beta = np.empty((count, len(names)))
    for cell in np.unique(nearest):
        there = np.flatnonzero(nearest == cell)
        lasts = float(np.hypot(MODEL * half[cell], model.misfit(noise)))
        final = replace(last, misfit_rad=lasts, half_rad=half[cell])
        at = model.cell(cells[cell].course, half[cell], model.again(noise), final)
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
    by_speed_s = (lost - delta) / paths.usual_speed * generator.standard_normal(count)
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
    spread = np.ptp(np.quantile(np.log(np.maximum(lost - delta, 1e-12)), ONE_SD))
    is_informed = float(spread) < 2.0 * INFORMED * HELD_SPREAD
    handed_nm = friction_nm[chosen] + friction_sd[chosen] * generator.standard_normal(count)
    if is_informed and np.all(handed_nm > 0.0):
        draws["compliance_rad_per_nm"] = 0.5 * draws["held_windup_rad"] / handed_nm
    waves = [name[:-4] for name in names if name.endswith(" cos") and "," not in name]
    harmonics = {}
    for wave in waves:
        both = (beta[:, names.index(wave + part)] for part in (" cos", " sin"))
        side, order = wave.split()
        harmonics[side, int(order)] = np.hypot(*both).reshape(DRAWS)
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
        *of_friction(paths),
        cases.of_play,
        paths.has_one_speed
        and bool(
            (np.mean(stays) < 0.5 and np.mean(delta > 0.0) < SURE)
            or np.mean([model.courses[cells[c].course].free for c in nearest]) > 0.5
            or paths.usual_speed * shown_skew_s > float(np.median(lost))
        ),
    )


def hidden_rad(lag: FloatArray, noise: Noise) -> float:
    """The δ that a motion may be within that the model does not follow: half of the lag's range,
    beyond that of white noise.
    """
    low, high = np.quantile(lag, ENDS)
    of_noise = float(ndtri(ENDS[1])) * noise.white_rad
    return float(np.sqrt(max((0.5 * (high - low)) ** 2 - of_noise**2, 0.0)))
