"""Groups of ``result.nc`` by which the route of torque ramps stores a snapshot.

``cycles`` holds what every cycle left, ``loop`` the path of each file's cycles with its model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from bayesbl.measurement import shared_groups as shared
from bayesbl.ramps.flanks import Flanks
from bayesbl.ramps.loop import LoopModel
from bayesbl.ramps.torque_cycles import Cycle, Ramps
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.variables import Group, dataset, table
from bayesbl.sampling.convergence import Diagnostics

MOST_POINTS = 1500
"""Of a file's path in ``loop``."""

POSTERIOR = Group(
    "posterior",
    (
        shared.DELTA,
        *table("""
            width_rad (chain, draw) | rad
                | between the positions that ramps leave on either flank, at zero torque
            scatter_rad (chain, draw) | rad
                | standard deviation of that width round the turn, or of repeated ramps of one file
            shared_pattern? (chain, draw) | 1
                | correlation of the widths round the turn between snapshots
            lost_motion_rad (chain, draw) | rad
                | between the middles of the loop of the largest ramps at the stated torques
            compliance_rad_per_nm (chain, draw) | rad/(N m) | of the loaded joint at the output
            stiffness_nm_per_rad (chain, draw) | N m/rad
                | position over torque by least squares along the largest ramps, both sides
            friction_torque_nm (chain, draw) | N m | at the output, over the range of the ramps
            held_windup_rad (chain, draw) | rad
                | of the gap: compliance that friction holds at zero torque, if flanks do not harden
            preload_torque_nm (chain, draw) | N m
                | at which one flank of a preloaded joint lifts; 0 with play, NaN where not seen
        """),
    ),
    (shared.CHAIN, shared.DRAW),
)

SAMPLE_STATS = Group(
    "sample_stats",
    (
        *table("""
            lp (chain, draw) | 1 | log density of the scatter, widths integrated out, all snapshots
        """),
        shared.ACCEPTANCE,
    ),
)

CYCLES = Group(
    "cycles",
    table("""
        file (cycle) | 1 | number of the file, from 0
        amplitude_nm (cycle) | N m | largest torque
        width_rad (cycle) | rad | between the positions left at zero torque
        range_rad (cycle) | rad | between the farthest positions
        elastic_nm (cycle) | N m | torque without friction between the positions left
        friction_nm (cycle) | N m | half the mean height of the loop
        used (cycle) | 1 | whether the width counts (1): the smallest ramps that reach both flanks
        relative_compliance | 1 | between the positions left over that of larger ramps
        probability_of_play | 1 | that it is above one
        lost_motion_torque_nm | N m | torque, both ways, at which lost motion is stated
    """),
)

LOOP = Group(
    "loop",
    table("""
        torque_nm (point) | N m | averaged torque along the cycles of each file, at the output
        position_rad (point) | rad | averaged position
        model_rad (point) | rad | position by play, compliance and friction
        file (point) | 1 | number of the file, from 0
        last (point) | 1 | whether the point is of the file's last cycle to and fro (1)
        model_misfit_rad (position) | rad | root mean square of position less model, by file
        left_low_rad (position) | rad | mean position left by torque below zero
        left_high_rad (position) | rad | mean position left by torque above zero
    """),
)

DIAGNOSTICS = Group("diagnostics", (*shared.SAMPLING,), (shared.SAMPLED_SYMBOLS,))

GROUPS = (
    POSTERIOR,
    SAMPLE_STATS,
    shared.OBSERVED,
    CYCLES,
    LOOP,
    DIAGNOSTICS,
    shared.GAP,
)


@dataclass(frozen=True, slots=True)
class RampAnswer:
    """What one snapshot stores beside its recording.

    Attributes
    ----------
    draws
        Variables of :data:`POSTERIOR`.
    measured
        What all but the play was drawn from, by file and cycle.
    """

    files: tuple[Ramps, ...]
    flanks: Flanks
    draws: Mapping[str, FloatArray]
    measured: Mapping[str, Sequence[FloatArray]]
    log_density: FloatArray
    diagnostics: Diagnostics
    budget: Mapping[str, float]
    lost_motion_torque_nm: float


def ramp_groups(answer: RampAnswer, recording: Recording) -> dict[str, xr.Dataset]:
    """All groups of one snapshot, without a ``snapshot`` dimension."""
    shape = answer.log_density.shape
    lengths = [ramps.torque_nm.size for ramps in answer.files]
    file = np.repeat(np.arange(len(lengths), dtype=float), lengths)
    observed = shared.observed_group(recording, file=file)
    return {
        "posterior": dataset(POSTERIOR, answer.draws, shared.numbered(shape)),
        "sample_stats": dataset(
            SAMPLE_STATS,
            {"lp": answer.log_density, "acceptance_rate": answer.diagnostics.acceptance},
        ),
        "observed_data": observed,
        "cycles": _cycles(answer),
        "loop": _loop(answer),
        "diagnostics": dataset(
            DIAGNOSTICS,
            shared.sampling_values(answer.diagnostics, 0.0),
            {"symbol": list(answer.diagnostics.r_hat)},
        ),
        "gap": shared.gap_group(answer.budget),
    }


def _cycles(answer: RampAnswer) -> xr.Dataset:
    level = answer.flanks.level
    used = [] if level is None else level.cycles
    each = [(n, c) for n, file in enumerate(answer.files) for c in file.cycles]
    names = ("amplitude_nm", "width_rad", "range_rad", "elastic_nm", "friction_nm")
    return dataset(
        CYCLES,
        {
            "file": np.array([n for n, _ in each], dtype=float),
            **{name: np.array([getattr(c, name) for _, c in each]) for name in names},
            "used": np.array([any(c is other for other in used) for _, c in each], dtype=float),
            "relative_compliance": answer.flanks.relative_compliance,
            "probability_of_play": answer.flanks.probability_of_play,
            "lost_motion_torque_nm": answer.lost_motion_torque_nm,
        },
    )


def _loop(answer: RampAnswer) -> xr.Dataset:
    level = answer.flanks.level
    assert level is not None
    parts: dict[str, list[FloatArray]] = {
        name: [] for name in ("torque_nm", "position_rad", "model_rad", "file", "last")
    }
    misfit, low, high = [], [], []
    for n, (ramps, cycles) in enumerate(zip(answer.files, level.files, strict=True)):
        if not cycles:
            continue
        torque, position, last = _path(ramps, cycles)
        model = LoopModel.fitted(cycles, torque, position)
        modelled = model.follow(torque, position[0])
        left = {
            side: [e.left_rad for c in cycles for e in (c.first, c.last) if e.side == side]
            for side in (-1, 1)
        }
        parts["torque_nm"].append(torque)
        parts["position_rad"].append(position)
        parts["model_rad"].append(modelled)
        parts["file"].append(np.full(torque.size, float(n)))
        parts["last"].append(last)
        misfit.append(float(np.sqrt(np.mean((position - modelled) ** 2))))
        low.append(float(np.mean(left[-1])))
        high.append(float(np.mean(left[1])))
    return dataset(
        LOOP,
        {
            **{name: np.concatenate(values) for name, values in parts.items()},
            "model_misfit_rad": np.array(misfit),
            "left_low_rad": np.array(low),
            "left_high_rad": np.array(high),
        },
    )


def _path(ramps: Ramps, cycles: tuple[Cycle, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Torque and position of all cycles of a file in order, thinned, and which are of the last."""
    path = slice(cycles[0].first.begin, cycles[-1].last.back + 1)
    torque, position = ramps.torque_nm[path], ramps.position_rad[path]
    step = max(1, -(-torque.size // MOST_POINTS))
    last = np.arange(path.start, path.stop) >= cycles[-1].first.begin
    return torque[::step], position[::step], last[::step].astype(float)
