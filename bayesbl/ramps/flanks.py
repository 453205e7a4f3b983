"""Which ramps of a snapshot reach both flanks, and whether there is play between them.

A joint with play is softest around zero torque, as it crosses the play there at nearly no torque.
A preloaded one is stiffer there than beyond, as both flanks carry it; one that is neither is as
stiff there as elsewhere. So the compliance between the positions that small ramps leave is held
against the compliance behind it, at once and a half the friction, and over all, as a preload may
reach beyond. Ramps of one size show both.

One flank of a preloaded joint lifts at some torque. Up to it both flanks carry the joint, beyond it
one alone: of linear flanks the compliance doubles there. Friction lifts one branch of the loop by
as much as it lowers the other, so half the sum of both torques at a position is the torque e
without friction. With W(e) the width between the positions at ±e, the compliance from e to 2e over
that up to e is

    q(e) = (W(2e) − W(e)) / W(e)

It is 1 where the compliance stays, and has its maximum where it rises: 2 for linear flanks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtr

from bayesbl.ramps.torque_cycles import Cycle, Ramps
from bayesbl.recording.types import FloatArray

HELD = 4.0
"""Wind-up that ramps leave, as a multiple of what the compliance behind the play would leave, at
most. The factor is drawn uniformly from 0 on.

Flanks are softer at small torque: if a flank's wind-up is a power p of the torque, 1/(2^p − 1)
times from the friction on, which is 1 for a linear flank, 1.7 for Hertz's contact of points, and
3.8 for p = 1/3. What friction varies from place to place leaves between 0 and 1.
"""

SAME_LEVEL = 1.5
"""Times the smallest of a level, from which ramps are of another."""

STUCK = 0.25
"""Relative compliance below which the friction holds the joint, whatever its flanks do.

Two flanks that both carry the joint are at most twice as stiff as one under the largest load, if
they harden: half its compliance. Half of that again is left for compliance that changes round the
turn (by up to 1.3 each way on the gearboxes of the stand).
"""

LEFT_STUCK = 0.3
"""Share of their range, and of what larger ramps leave, below which small ramps tell nothing.

A joint that sticks in front of a compliance moves and leaves nothing: its compliance between the
positions left is a ratio of two numbers near zero. By Dahl's law ramps to half of the friction
leave 0.26 of their range; a preloaded joint leaves half at three times the friction.
"""

TIMES_FRICTION = 4.0
"""Times the friction, to which the largest ramps go at least: up to twice the friction behind the
play, both ways then slide, as a turn takes twice the friction."""

LARGEST_NEXT = 3.0
"""Times the largest ramps: what to record next."""

LEAST_WINDUP = 1e-6
"""Of the width: ramps with less friction than noise leave no measurable wind-up."""

FEWEST_STEPS = 5.0
"""Of the encoder, that ramps must move the joint by: the width of fewer is rounding."""

SEEN = 4.0 / 3.0
"""q from which a flank is seen to lift: both are then at most 3/4 as compliant as one, halfway
from two linear flanks to one."""

SMALLEST = 0.01
"""Of the largest torque: the smallest torque tried. Less is noise of the torque."""

TRIED = 200
"""Torques tried, by equal ratios: 1 to 50 in steps of 2 %."""

AT_THE_END = 0.9
"""Of the largest torque tried: a maximum beyond may be a rise that is farther up."""

Finding = Literal["play", "preloaded", "too_small"]


@dataclass(frozen=True, slots=True)
class Level:
    """Cycles of about the same amplitude, by file; files without any are empty."""

    files: tuple[tuple[Cycle, ...], ...]

    @property
    def cycles(self) -> list[Cycle]:
        """Of all files."""
        return [cycle for file in self.files for cycle in file]

    @property
    def amplitude_nm(self) -> float:
        """Mean over all cycles."""
        return float(np.mean([c.amplitude_nm for c in self.cycles]))

    @property
    def friction_nm(self) -> float:
        """Mean over all cycles."""
        return float(np.mean([c.friction_nm for c in self.cycles]))

    @property
    def range_rad(self) -> float:
        """Mean over all cycles."""
        return float(np.mean([c.range_rad for c in self.cycles]))

    @property
    def elastic_nm(self) -> float:
        """Between the positions left, without friction, mean over all cycles."""
        return float(np.mean([c.elastic_nm for c in self.cycles]))

    @property
    def middle_rad(self) -> float:
        """Between the flanks, mean over all cycles."""
        middles = [0.5 * (c.first.left_rad + c.last.left_rad) for c in self.cycles]
        return float(np.mean(middles))

    @property
    def width_rad(self) -> float:
        """Mean over all cycles."""
        return float(np.mean([c.width_rad for c in self.cycles]))

    def widths(self) -> list[FloatArray]:
        """Of every file with cycles: its independent measurements of the width, rad, shape (k,).

        Neighbouring cycles share a flank, and go round in opposite ways, so that drift changes
        their widths by opposite amounts: they count as one in pairs.
        """
        widths = []
        for file in filter(None, self.files):
            width = np.array([c.width_rad for c in file])
            even = width.size // 2 * 2
            pairs = width[:even].reshape(-1, 2).mean(axis=1)
            widths.append(pairs if pairs.size else width)
        return widths


@dataclass(frozen=True, slots=True)
class Flanks:
    """What the ramps of a snapshot show.

    Attributes
    ----------
    finding
        ``play`` or ``preloaded`` (no play), or why neither can be said.
    level
        The ramps that tell it, the smallest that can.
    largest
        The largest ramps.
    skipped_nm
        Amplitudes of smaller ramps, which friction held.
    needed_nm
        Torque that ramps should reach where they are too small.
    left_by_larger
        Widest that larger ramps leave over what these do; one where they leave less.
    windup_rad
        Of every large cycle, by file: what friction would hold between the positions left if the
        compliance there were that behind them.
    relative_compliance
        The width over that: above one with play. NaN without an answer.
    probability_of_play
        That it is above one, by its scatter round the turn (by that of cycles, of one file).
    """

    finding: Finding
    level: Level
    largest: Level
    skipped_nm: tuple[float, ...] = ()
    needed_nm: float = 0.0
    left_by_larger: float = 1.0
    windup_rad: tuple[FloatArray, ...] = ()
    relative_compliance: float = np.nan
    probability_of_play: float = 1.0

    @property
    def answered(self) -> bool:
        """Whether there is an answer."""
        return self.finding in ("play", "preloaded")


def levels_of(files: Sequence[Ramps]) -> list[Level]:
    """All cycles by amplitude, the smallest first."""
    every = [(c.amplitude_nm, n, c) for n, file in enumerate(files) for c in file.cycles]
    every.sort(key=lambda item: item[0])
    groups: list[list[tuple[float, int, Cycle]]] = []
    for item in every:
        if groups and item[0] < SAME_LEVEL * groups[-1][0][0]:
            groups[-1].append(item)
        else:
            groups.append([item])
    return [
        Level(
            tuple(
                tuple(sorted((c for _, k, c in group if k == n), key=lambda c: c.first.begin))
                for n in range(len(files))
            )
        )
        for group in groups
    ]


def find_flanks(files: Sequence[Ramps], resolution_rad: float = 0.0) -> Flanks | None:
    """The smallest ramps that reach both flanks, and whether there is play between them.

    ``None`` without a whole cycle.

    Parameters
    ----------
    resolution_rad
        The encoder's step at the output.
    """
    levels = levels_of(files)
    if not levels:
        return None
    largest = levels[-1]
    skipped: list[float] = []
    windups = [_windup(level, largest) for level in levels]
    means = [float(np.concatenate(windup).mean()) for windup in windups]
    least_play = [level.width_rad - HELD * mean for level, mean in zip(levels, means, strict=True)]
    for number, level in enumerate(levels):
        if largest.amplitude_nm < TIMES_FRICTION * largest.friction_nm:
            break
        widest = max(larger.width_rad for larger in levels[number:])
        reaches = level.width_rad >= max(least_play[number:])
        moved = level.width_rad >= STUCK * means[number]
        separates = level.width_rad > LEFT_STUCK * min(widest, level.range_rad)
        is_seen = level.range_rad >= FEWEST_STEPS * resolution_rad
        if separates and moved and reaches and is_seen:
            relative = _log_relative(level, windups[number])
            probability = _probability_positive(relative)
            return Flanks(
                "play" if probability > 0.5 else "preloaded",
                level,
                largest,
                tuple(skipped),
                left_by_larger=widest / level.width_rad,
                windup_rad=tuple(windups[number]),
                relative_compliance=float(np.exp(relative.mean())),
                probability_of_play=probability,
            )
        skipped.append(level.amplitude_nm)
    needed, widths = LARGEST_NEXT * largest.amplitude_nm, of_cycles(largest, lambda c: c.width_rad)
    return Flanks("too_small", largest, largest, tuple(skipped), needed, windup_rad=tuple(widths))


def _windup(level: Level, largest: Level) -> list[FloatArray]:
    """Behind the play, over the torque between the positions left: by file and large cycle, rad.

    By the largest compliance from e to 2e, e from the friction on: a preload may reach beyond it.
    Below, e is not known: friction varies by a share of itself from place to place, and the torque
    may rise while the joint crosses the play.
    """
    elastic, width = max(level.elastic_nm, 0.0), level.width_rad

    def windup(c: Cycle) -> float:
        place, *ways = _branches(c)
        low, high = sorted((c.first.left_rad, c.last.left_rad))
        height = np.abs(ways[1] - ways[0])[(place >= low) & (place <= high)]
        between = 0.5 * float(height.mean()) if height.size else 0.0
        friction = max(between, c.friction_nm, SMALLEST * c.amplitude_nm)
        torque = np.geomspace(friction, max(_most(c), friction), TRIED)
        rise = _width(c, 2.0 * torque) - _width(c, torque)
        return max(0.5 * elastic * float(np.max(rise / torque)), LEAST_WINDUP * width)

    return [np.array([windup(c) for c in file]) for file in largest.files]


def _most(cycle: Cycle) -> float:
    """Half of the torque at which both ways still slide: nearer to the turn, one sticks."""
    return 0.5 * (cycle.amplitude_nm - 2.0 * cycle.friction_nm)


def _log_relative(level: Level, windup: Sequence[FloatArray]) -> FloatArray:
    """ln of the width over the wind-up behind it, by file with both kinds of ramps; of one file by
    cycle. Where no file has both, that of all together, once."""
    logs = [
        np.log([max(c.width_rad / behind.mean(), LEAST_WINDUP) for c in cycles])
        for cycles, behind in zip(level.files, windup, strict=True)
        if cycles and behind.size
    ]
    if not logs:
        return np.log([level.width_rad / np.concatenate(windup).mean()])
    return observations(logs)


def _probability_positive(values: FloatArray) -> float:
    """Of the mean of values, by Student's t; 0 or 1 where there is one."""
    mean = float(values.mean())
    error = float(values.std(ddof=1)) / np.sqrt(values.size) if values.size > 1 else 0.0
    if error == 0.0:
        return float(mean > 0.0)
    return float(stdtr(values.size - 1, mean / error))


def lost_motion(cycle: Cycle, torque_nm: float) -> float:
    """Between the positions that ±torque holds without friction, rad: play and twist of both ways.

    Makers state the middles of the loop at ±torque, which is the same where that is well above the
    friction. Below it both ways stick, and the middles meet however large the play is.
    """
    return float(_width(cycle, np.array([torque_nm]))[0])


def stiffness(cycle: Cycle) -> float:
    """Torque over position as test reports state it, N m/rad.

    The mean over both sides of 1/slope, the slope that of the position over the torque by least
    squares along a whole ramp there and back: softer than a flank, by what lies between the flanks.
    """
    slopes = []
    for excursion in (cycle.first, cycle.last):
        part = slice(excursion.begin, excursion.back + 1)
        slopes.append(float(np.polyfit(cycle.torque_nm[part], cycle.position_rad[part], 1)[0]))
    return float(np.mean([1.0 / slope if slope > 0.0 else np.inf for slope in slopes]))


def of_cycles(level: Level, value: Callable[[Cycle], float]) -> list[FloatArray]:
    """A quantity of every cycle, by file with cycles."""
    return [np.array([value(c) for c in file]) for file in level.files if file]


def observations(by_file: Sequence[FloatArray]) -> FloatArray:
    """What scatters: the mean of every file, of one file alone its cycles."""
    return by_file[0] if len(by_file) == 1 else np.array([v.mean() for v in by_file])


def lifting_torque(largest: Level) -> list[FloatArray]:
    """At which one flank lifts, by file and large cycle, N m; empty unless every cycle shows it."""
    torques = of_cycles(largest, _lifts)
    return torques if np.all(np.isfinite(np.concatenate(torques))) else []


def _lifts(cycle: Cycle) -> float:
    """NaN where the compliance does not rise, or farther up than the ramps show."""
    most = _most(cycle)
    if most <= SMALLEST * cycle.amplitude_nm:
        return np.nan
    elastic = np.geomspace(SMALLEST * cycle.amplitude_nm, most, TRIED)
    width = _width(cycle, elastic)
    rise = _width(cycle, 2.0 * elastic) - width
    # Where the joint has not moved yet, nothing is told.
    ratio = np.divide(rise, width, out=np.zeros_like(width), where=width > 0.0)
    top = int(np.argmax(ratio))
    is_visible = ratio[top] > SEEN and elastic[top] < AT_THE_END * most
    return float(elastic[top]) if is_visible else np.nan


def _branches(cycle: Cycle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions in equal steps, rad, and the torque of both ways there, N m, same shape."""
    torque, position = cycle.torque_nm, cycle.position_rad
    first, last = cycle.first, cycle.last
    leaves, arrives = first.top, last.top
    low, high = sorted((float(position[leaves]), float(position[arrives])))
    way = np.arange(leaves, arrives + 1)
    other = np.concatenate((np.arange(arrives, last.back + 1), np.arange(first.begin, leaves + 1)))
    place = np.linspace(low, high, way.size)
    there, back = (
        # Torque at each place, of a path that goes to larger side · position.
        np.interp(side * place, np.maximum.accumulate(side * position[path]), torque[path])
        for side, path in ((last.side, way), (first.side, other))
    )
    return place, there, back


def _width(cycle: Cycle, elastic_nm: FloatArray) -> FloatArray:
    """Between the positions at ± each torque without friction, rad, same shape."""
    place, there, back = _branches(cycle)
    elastic = np.maximum.accumulate(0.5 * (there + back))
    width = np.interp(elastic_nm, elastic, place) - np.interp(-elastic_nm, elastic, place)
    return np.asarray(width)
