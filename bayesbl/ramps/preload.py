"""The torque at which one flank of a preloaded joint lifts.

Up to it both flanks carry the joint, beyond it one alone: of linear flanks the compliance doubles
there. Friction lifts one branch of the loop by as much as it lowers the other, so half the sum of
both torques at a position is the torque e without friction. With W(e) the width between the
positions at ±e, the compliance from e to 2e over that up to e is

    q(e) = (W(2e) − W(e)) / W(e)

It is 1 where the compliance stays, and has its maximum where it rises: 2 for linear flanks.
"""

from __future__ import annotations

import numpy as np

from bayesbl.ramps.flanks import Level, of_cycles
from bayesbl.ramps.torque_cycles import Cycle
from bayesbl.recording.types import FloatArray

SEEN = 4.0 / 3.0
"""q from which a flank is seen to lift: both are then at most 3/4 as compliant as one, halfway
from two linear flanks to one."""

SMALLEST = 0.01
"""Of the largest torque: the smallest torque tried. Less is noise of the torque."""

TRIED = 200
"""Torques tried, by equal ratios: 1 to 50 in steps of 2 %."""

AT_THE_END = 0.9
"""Of the largest torque tried: a maximum beyond may be a rise that is farther up."""


def lifting_torque(largest: Level) -> list[FloatArray]:
    """At which one flank lifts, by file and large cycle, N m; empty unless every cycle shows it."""
    found = of_cycles(largest, _lifts)
    return found if np.all(np.isfinite(np.concatenate(found))) else []


def _lifts(cycle: Cycle) -> float:
    """NaN where the compliance does not rise, or farther up than the ramps show."""
    # Nearer to the turn the way back is not that of the sliding joint.
    most = 0.5 * (cycle.amplitude_nm - 2.0 * cycle.friction_nm)
    if most <= SMALLEST * cycle.amplitude_nm:
        return np.nan
    elastic = np.geomspace(SMALLEST * cycle.amplitude_nm, most, TRIED)
    width = _width(cycle, elastic)
    rise = _width(cycle, 2.0 * elastic) - width
    # Where the joint has not moved yet, nothing is told.
    ratio = np.divide(rise, width, out=np.zeros_like(width), where=width > 0.0)
    top = int(np.argmax(ratio))
    seen = ratio[top] > SEEN and elastic[top] < AT_THE_END * most
    return float(elastic[top]) if seen else np.nan


def _width(cycle: Cycle, elastic_nm: FloatArray) -> FloatArray:
    """Between the positions at ± each torque without friction, rad, same shape."""
    torque, position = cycle.torque_nm, cycle.position_rad
    first, last = cycle.first, cycle.last
    leaves, arrives = first.top, last.top
    low, high = sorted((float(position[leaves]), float(position[arrives])))
    way = np.arange(leaves, arrives + 1)
    other = np.concatenate((np.arange(arrives, last.back + 1), np.arange(first.begin, leaves + 1)))
    place = np.linspace(low, high, way.size)
    branches = [
        # Torque at each place, of a path that goes to larger side · position.
        np.interp(side * place, np.maximum.accumulate(side * position[path]), torque[path])
        for side, path in ((last.side, way), (first.side, other))
    ]
    elastic = np.maximum.accumulate(0.5 * (branches[0] + branches[1]))
    width = np.interp(elastic_nm, elastic, place) - np.interp(-elastic_nm, elastic, place)
    return np.asarray(width)
