"""Torque ramps to and fro with the output held: what every cycle leaves behind.

Torque and position are those of the output. A ramp is found as an *excursion* of the torque to
one side of zero. What an excursion leaves is the position at which the torque is back at zero: the
friction holds the joint on the flank that it was pressed against. Two excursions to opposite sides
leave the two flanks, and nothing is assumed of the shape of the loop between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from bayesbl.recording.types import FloatArray

SMOOTHED_SHARE = 1.0 / 2000.0
"""Of a file: what torque and position are averaged over, if its ramps are few."""

FEWEST_WINDOWS = 40
"""Of these averages in an excursion: the largest torque of a triangle is then 1 % low at most."""

OVER_NOISE = 4.0
"""Standard deviations of the averaged torque that are no excursion: 6e-5 by chance, each sample."""

SMALLEST_EXCURSION = 0.01
"""Of the largest torque: less is what is left where the joint jumps, and no ramp."""

SHORTEST_EXCURSION = 0.025
"""Of the longer one beside it: the torque rings where the joint jumps or reaches a flank.

Small ramps at one rate are kept from 3.5 % of the large ones on.
"""

LARGEST_ASYMMETRY = 2.5
"""Ratio of the torques of a pair: a small ramp before a large one is of no one amplitude."""

LARGE = 0.5
"""Of the largest cycle's torque: cycles below say little of where the joint is free."""


@dataclass(frozen=True, slots=True)
class Excursion:
    """The torque on one side of zero.

    Attributes
    ----------
    side
        +1 or −1.
    begin, back
        Samples between which the torque is on that side; at ``back`` it is zero again.
    top
        The sample between them at which it is largest.
    torque_nm
        The largest, positive.
    reached_rad
        The farthest position in the direction of the torque.
    left_rad
        The position at ``back``: that which the excursion leaves.
    """

    side: int
    begin: int
    back: int
    top: int
    torque_nm: float
    reached_rad: float
    left_rad: float


@dataclass(frozen=True, slots=True)
class Cycle:
    """Two neighbouring excursions to opposite sides, ``first`` and ``last`` in time.

    Attributes
    ----------
    amplitude_nm
        Mean of their largest torques.
    width_rad
        Between the positions that they leave: the play, as far as they reached the flanks.
    range_rad
        Between the farthest positions.
    elastic_nm
        Torque between the ends of ``width_rad`` without friction: there the upper branch of the
        loop is T above and the lower T below it, so it is half the difference of the branches'
        torques, each at the end where the other one is zero.
    friction_nm
        Half the mean height of the loop, ∮ τ dθ/(2 range).
    torque_nm, position_rad
        Of the whole file, as in :class:`Ramps`.
    """

    first: Excursion
    last: Excursion
    amplitude_nm: float
    width_rad: float
    range_rad: float
    elastic_nm: float
    friction_nm: float
    torque_nm: FloatArray = field(repr=False)
    position_rad: FloatArray = field(repr=False)


@dataclass(frozen=True, slots=True)
class Ramps:
    """One file: averaged torque and position, shape (n,), and the ramps in them.

    ``turned``: the torque is counted the other way than in the file, where the position goes
    against it. Friction takes work and never gives it, which tells the way. ``offset_nm``: taken
    off the torque, in the sense that it is counted here.
    """

    torque_nm: FloatArray
    position_rad: FloatArray
    excursions: tuple[Excursion, ...]
    cycles: tuple[Cycle, ...]
    turned: bool = False
    offset_nm: float = 0.0


def find_ramps(torque_nm: FloatArray, position_rad: FloatArray) -> Ramps:
    """All excursions of a file, and the pairs of neighbours that make a cycle.

    Parameters
    ----------
    torque_nm, position_rad
        At the output, in the order of time, shape (n,).
    """
    window = max(1, round(SMOOTHED_SHARE * torque_nm.size))
    means = _averaged(torque_nm, window), _averaged(position_rad, window)
    turned = float(np.sum(means[0][1:] * np.diff(means[1]))) < 0.0
    if turned:
        torque_nm = -torque_nm
    ramps = _ramps(torque_nm, position_rad, window)
    offset = _offset(ramps)
    shifted = _ramps(torque_nm - offset, position_rad, window)
    if shifted.cycles:  # unless the torque then goes to one side alone
        return replace(shifted, turned=turned, offset_nm=offset)
    return replace(ramps, turned=turned)


def _ramps(torque_nm: FloatArray, position_rad: FloatArray, window: int) -> Ramps:
    while True:
        torque, position = _averaged(torque_nm, window), _averaged(position_rad, window)
        noise = float(np.median(np.abs(np.diff(torque_nm)))) / (0.6745 * np.sqrt(2.0 * window))
        threshold = max(OVER_NOISE * noise, SMALLEST_EXCURSION * float(np.abs(torque).max()))
        candidates = [
            _excursion(torque, position, (torque_nm, position_rad), threshold, window, *run)
            for run in _runs(torque, threshold)
        ]
        excursions = tuple(e for e in candidates if e is not None)
        lengths = [e.back - e.begin for e in excursions]
        if window == 1 or not lengths or np.median(lengths) >= FEWEST_WINDOWS * window:
            break
        window = max(1, window // 2)
    pairs = [
        (a, b)
        for a, b in pairwise(excursions)
        if a.side != b.side
        and max(a.torque_nm, b.torque_nm) <= LARGEST_ASYMMETRY * min(a.torque_nm, b.torque_nm)
    ]
    cycles = tuple(_cycle(torque, position, *pair) for pair in pairs)
    return Ramps(torque, position, excursions, cycles)


def _offset(ramps: Ramps) -> float:
    """Torque about which the joint is free: a load that hangs at it, or a sensor's zero.

    It moves both ways through the loop alike. By the large cycles: small ones may not cross the
    play at all.
    """
    largest = max((cycle.amplitude_nm for cycle in ramps.cycles), default=0.0)
    large = [cycle for cycle in ramps.cycles if cycle.amplitude_nm > LARGE * largest]
    return float(np.median([_free_at(cycle) for cycle in large])) if large else 0.0


def _free_at(cycle: Cycle) -> float:
    """Mean torque, there and back, at the middle between the flanks; 0 if one way is not there.

    It is between the positions at equal torques: a joint without play then has it at zero torque.
    The way back to the side of the first excursion is before it or behind the last one.
    """
    a, b, torque, position = cycle.first, cycle.last, cycle.torque_nm, cycle.position_rad
    equal = min(a.torque_nm, b.torque_nm)
    ends = [crossing(-torque, -e.side * equal, e.begin, e.top + 1, e.side) for e in (a, b)]
    beyond = b.side * (position - 0.5 * float(position[ends[0]] + position[ends[1]])) >= 0.0
    there = a.top + int(np.argmax(beyond[a.top : b.top + 1]))
    before = np.flatnonzero(beyond[a.begin : a.top + 1])
    if not before.size and beyond[b.back]:
        return 0.0
    back = a.begin + before[-1] if before.size else b.top + np.argmin(beyond[b.top : b.back + 1])
    return float(0.5 * (torque[there] + torque[back]))


def left_rad(cycles: Sequence[Cycle]) -> tuple[float, float]:
    """Mean positions that excursions to the negative and to the positive side leave."""
    excursions = [e for c in cycles for e in (c.first, c.last)]
    low, high = (np.mean([e.left_rad for e in excursions if e.side == side]) for side in (-1, 1))
    return float(low), float(high)


def crossing(torque_nm: FloatArray, level_nm: float, begin: int, stop: int, side: int) -> int:
    """The first sample from ``begin`` on at which side · torque is not above side · level."""
    beyond = np.flatnonzero(side * (torque_nm[begin:stop] - level_nm) <= 0.0)
    return begin + int(beyond[0]) if beyond.size else stop - 1


def _averaged(values: FloatArray, window: int) -> FloatArray:
    """Mean over ``window`` samples, fewer at the ends, shape as given."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    place = np.arange(values.size)
    low = np.maximum(place - window // 2, 0)
    high = np.minimum(place + (window - window // 2), values.size)
    return np.asarray((total[high] - total[low]) / (high - low))


def _runs(torque: FloatArray, threshold: float) -> list[tuple[int, int, int]]:
    """(side, begin, stop) of the stretches in which the torque is beyond ±threshold on one side.

    Short ones are dropped; neighbours of one side are then one.
    """
    outside = np.flatnonzero(np.abs(torque) > threshold)
    if outside.size == 0:
        return []
    side = np.sign(torque[outside]).astype(int)
    parts = np.split(outside, np.flatnonzero(np.diff(side)) + 1)
    runs = [(int(np.sign(torque[part[0]])), int(part[0]), int(part[-1])) for part in parts]
    while (ringing := _ringing(runs)) is not None:
        del runs[ringing]
        for place in range(len(runs) - 1, 0, -1):
            if runs[place][0] == runs[place - 1][0]:
                runs[place - 1 : place + 1] = [(*runs[place - 1][:2], runs[place][2])]
    return runs


def _ringing(runs: Sequence[tuple[int, int, int]]) -> int | None:
    """The shortest run, where it is far shorter than one beside it."""
    lengths = [last - first + 1 for _, first, last in runs]
    order = sorted(range(len(runs)), key=lengths.__getitem__)
    for place in order:
        beside = lengths[max(place - 1, 0) : place] + lengths[place + 1 : place + 2]
        if beside and lengths[place] < SHORTEST_EXCURSION * max(beside):
            return place
    return None


def _excursion(
    torque: FloatArray,
    position: FloatArray,
    raw: tuple[FloatArray, FloatArray],
    threshold: float,
    window: int,
    side: int,
    first: int,
    last: int,
) -> Excursion | None:
    """``None`` where the torque does not come back to zero, or at the end nearly so."""
    beyond = np.flatnonzero(side * torque[:first] <= 0.0)
    begin = int(beyond[-1]) if beyond.size else first
    peak = float(np.max(side * torque[first : last + 1]))
    unloads = first + int(np.flatnonzero(side * torque[first : last + 1] >= 0.5 * peak)[-1])
    home = np.flatnonzero(side * torque[unloads:] <= 0.0)
    if home.size == 0 and side * torque[-1] > threshold:
        return None
    back = unloads + int(home[0]) if home.size else torque.size - 1
    reached = side * float(np.max(side * position[first : back + 1]))
    top = begin + int(np.argmax(side * torque[begin : back + 1]))
    # A torque in steps passes zero within one, where its average is of both of its ends.
    near = slice(max(back - window, top), back + window + 1)
    left = float(raw[1][near][np.argmin(np.abs(raw[0][near]))])
    return Excursion(side, begin, back, top, peak, reached, left)


def _cycle(torque: FloatArray, position: FloatArray, a: Excursion, b: Excursion) -> Cycle:
    up, down = (a, b) if a.side > 0 else (b, a)
    path = slice(a.begin, b.back + 1)
    reach = up.reached_rad - down.reached_rad

    def arriving(e: Excursion, begin: int) -> float:
        """Torque at which an excursion comes to where it will leave the joint."""
        way = slice(begin, e.back + 1)
        there = np.flatnonzero(e.side * (position[way] - e.left_rad) >= 0.0)
        return float(torque[way][there[0]]) if there.size else e.side * e.torque_nm

    # The way out along the second excursion begins where the first one left the joint.
    elastic = 0.5 * abs(arriving(b, a.back) - arriving(a, a.begin))
    work = float(np.sum(0.5 * (torque[path][1:] + torque[path][:-1]) * np.diff(position[path])))
    return Cycle(
        a,
        b,
        0.5 * (a.torque_nm + b.torque_nm),
        up.left_rad - down.left_rad,
        reach,
        elastic,
        max(work, 0.0) / (2.0 * reach) if reach > 0.0 else 0.0,
        torque,
        position,
    )
