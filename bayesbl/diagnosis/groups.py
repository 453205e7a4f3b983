"""Groups of ``result.nc`` by which a diagnosis is stored, each where there is something to store.

``signals``: measured and predicted, for every piece (a channel of a recording, or of a part of it);
of a closed loop for those held out. ``posterior``: draws of everything unknown, with what was named
added. ``learned_torque``, ``encoder_error``: what was learned, over what it depends on.

``residuals_before``, ``residuals_after``: what the simulation does not explain. Variables begin
with their channel's name. Dimensions: ``recording``, ``load_angle_rad`` (720), ``bin`` of the
spectra and ``line`` of the significant lines, strongest first; shorter ones are padded with NaN,
missing channels filled with it. The attribute ``unexplained`` holds, as JSON, what is significant
over all recordings.

The answer in the words of ``summary.json``, the disagreement among it, is JSON in the attribute
``diagnosis`` of the root, the bench with what was named in it a bench file in the attribute
``augmented_bench``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.bench.learned import ENCODER_ERROR, LEARNED_TORQUE
from bayesbl.config.bench import dump_bench
from bayesbl.diagnosis.diagnosis import Diagnosis, PieceSignals
from bayesbl.diagnosis.residuals import FALSE_LINES, MAP_POINTS, ChannelResiduals, ResidualAnalysis
from bayesbl.diagnosis.summary import answer_of, plain
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.measurement.direct_route import result_name, unit_and_meaning
from bayesbl.measurement.shared_groups import CHAIN, DRAW, numbered
from bayesbl.recording.types import CHANNELS
from bayesbl.results.intervals import IntervalKind
from bayesbl.results.variables import Group, Variable, columns, dataset, labels, padded, table
from bayesbl.units import unit_of

STAGES = ("before", "after")
"""The bench as believed, and with what was named."""


def signals_group(unit: str) -> Group:
    """Signals in the unit of their channel; a row for each :class:`PieceSignals`."""
    return Group(
        "signals",
        table(f"""
            time_s (piece, sample) | s | time
            measured (piece, sample) | {unit} | measured
            before (piece, sample) | {unit} | bench without the named effects
            after (piece, sample) | {unit} | bench with the named effects
        """),
        table("""
            recording (piece) | text | recording
            channel (piece) | text | channel
            use (piece) | text | fitted on (used) or predicted (held_out)
        """),
    )


def _unknown(name: str) -> Variable:
    """An unknown; one that belongs to a single recording has its name behind it, in brackets."""
    shared, _, recording = name.removesuffix(")").partition(" (")
    unit, meaning = unit_and_meaning(shared)
    return Variable(
        name, ("chain", "draw"), unit, f"{meaning}, {recording}" if recording else meaning
    )


POSTERIOR = Group("posterior", coordinates=(CHAIN, DRAW), named=_unknown)

LEARNED = {
    LEARNED_TORQUE: Group(
        LEARNED_TORQUE,
        table("""
            torque_nm (point) | N m | learned torque against the side it acts at, turning forwards
            sd_nm (point) | N m | its standard deviation
        """),
        table("variable (point) | 1 | what it depends on, in rad, rad/s or s"),
    ),
    ENCODER_ERROR: Group(
        ENCODER_ERROR,
        table("""
            angle_rad (point) | rad | what the motor's encoder shows too much
            sd_rad (point) | rad | its standard deviation
        """),
        table("variable (point) | rad | angle of the motor"),
    ),
}
"""By the name of what was learned."""


def _of_channel(channel: str) -> tuple[Variable, ...]:
    """Named as attributes of its :class:`ChannelResiduals`; behind ``line_``, of a line."""
    unit, name = unit_of(channel), CHANNELS[channel]
    return table(f"""
        {channel}_offset (recording) | {unit} | {name}: mean of recording less simulation
        {channel}_repeating_rms (recording) | {unit} | {name}: RMS that repeats with the load angle
        {channel}_noise_sd (recording) | {unit} | {name}: standard deviation of the noise
        {channel}_drift_per_s (recording) | {unit}/s | {name}: slope over the recording
        {channel}_outliers (recording) | 1 | {name}: samples that no noise explains
        {channel}_map_error (recording) | {unit} | {name}: standard error of rotation averages
        {channel}_load_map (recording, load_angle_rad) | {unit} | {name}: residual that repeats
        {channel}_amplitude (recording, bin) | {unit} | {name}: amplitude of the residual
        {channel}_noise_amplitude (recording, bin) | {unit} | {name}: RMS amplitude of noise
        {channel}_line_frequency_hz (recording, line) | Hz | {name}: frequency of a line
        {channel}_line_load_order (recording, line) | 1 | {name}: cycles of it per turn of the load
        {channel}_line_motor_order (recording, line) | 1 | {name}: the same of the motor
        {channel}_line_amplitude (recording, line) | {unit} | {name}: its amplitude
        {channel}_line_phase_rad (recording, line) | rad | {name}: of a cosine at the first sample
        {channel}_line_dependence (recording, line) | text | {name}: what it repeats with
    """)


def _named(name: str) -> Variable | None:
    """A variable of any channel."""
    of_any = (v for channel in CHANNELS if name.startswith(channel) for v in _of_channel(channel))
    return next((variable for variable in of_any if variable.name == name), None)


def residuals_group(stage: str) -> Group:
    """Of the bench as believed (``before``), or with what was named (``after``)."""
    return Group(
        f"residuals_{stage}",
        table("load_order (recording, bin) | 1 | cycles per turn of the load"),
        (
            labels("recording", "recording"),
            *table("load_angle_rad (load_angle_rad) | rad | load angle"),
        ),
        _named,
    )


def diagnosis_tree(found: Diagnosis, level: float, kind: IntervalKind) -> xr.DataTree:
    """The whole result, without its origin.

    Parameters
    ----------
    level, kind
        Of the credible intervals.
    """
    groups = {}
    if found.signals:
        groups["signals"] = signals_dataset(found.signals)
    if found.posterior is not None:
        groups["posterior"] = posterior_dataset(found.posterior)
    if found.learned is not None:
        curve, group = found.learned.curve, LEARNED[found.learned.term.block]
        size, sd = (variable.name for variable in group.variables)
        groups[group.name] = dataset(
            group, {size: curve.value, sd: curve.sd}, {"variable": curve.variable}
        )
    analyses = (found.residuals_before, found.residuals_after)
    for stage, analysis in zip(STAGES, analyses, strict=True):
        if analysis is not None:
            groups[f"residuals_{stage}"] = residuals_dataset(analysis, stage)
    tree = xr.DataTree.from_dict(groups)
    doubts = found.posterior is not None and bool(found.posterior.diagnostics.reasons)
    bench = found.augmented_bench
    tree.attrs = {
        "kind": "diagnose",
        "outcome": "usable" if doubts else "converged",
        "reason": "",
        "warnings": list(found.notes),
        "interval_level": level,
        "interval_kind": kind,
        "diagnosis": json.dumps(answer_of(found, level, kind), ensure_ascii=False),
        "augmented_bench": "" if bench is None else dump_bench(bench),
    }
    return tree


def signals_dataset(signals: Sequence[PieceSignals]) -> xr.Dataset:
    """Padded with NaN to the longest."""
    units = {unit_of(piece.channel) for piece in signals}
    group = signals_group(units.pop() if len(units) == 1 else "as the channel")
    values = columns(group, signals)
    longest = max(piece.time_s.size for piece in signals)
    values |= {
        v.name: padded([getattr(s, v.name) for s in signals], longest) for v in group.variables
    }
    return dataset(group, values)


def posterior_dataset(posterior: DirectPosterior) -> xr.Dataset:
    """Draws of every unknown, in its own unit."""
    values = {}
    for i, unknown in enumerate(posterior.fit.model.unknowns):
        name = result_name(unknown)
        label = name if unknown.recording is None else f"{name} ({unknown.recording})"
        values[label] = unknown.value(posterior.draws[..., i])
    return dataset(POSTERIOR, values, numbered(posterior.draws.shape))


def residuals_dataset(analysis: ResidualAnalysis, stage: str) -> xr.Dataset:
    """All that an analysis holds, as the text of this module describes it."""
    recordings = analysis.recordings
    names = list(dict.fromkeys(c.channel for r in recordings for c in r.channels))
    orders = [r.whole.load_order for r in recordings]
    sizes = {
        "line": max(len(c.lines) for r in recordings for c in r.channels),
        "bin": max(order.size for order in orders),
        "load_angle_rad": MAP_POINTS,
    }
    values: dict[str, object] = {"load_order": padded(orders, sizes["bin"])}
    for name in names:
        seen = [next((c for c in r.channels if c.channel == name), None) for r in recordings]
        for variable in _of_channel(name):
            attribute = variable.name.removeprefix(f"{name}_")
            own: Any = [np.nan if c is None else _value(c, attribute) for c in seen]
            if len(variable.dims) == 2:
                own = [[] if c is None else x for c, x in zip(seen, own, strict=True)]
                own = padded(own, sizes[variable.dims[1]], variable.kind == "text")
            values[variable.name] = own
    angles = 2.0 * np.pi * np.arange(MAP_POINTS) / MAP_POINTS
    coordinates = {"recording": [r.name for r in recordings], "load_angle_rad": angles}
    made = dataset(residuals_group(stage), values, coordinates)
    made.attrs = {
        "channels": names,
        "false_discovery_rate": FALSE_LINES,
        "unexplained": json.dumps(plain(analysis.remaining), ensure_ascii=False),
    }
    return made


def _value(residuals: ChannelResiduals, attribute: str) -> Any:
    of_line = attribute.removeprefix("line_")
    if of_line != attribute:
        return [getattr(line, of_line) for line in residuals.lines]
    return getattr(residuals, attribute)
