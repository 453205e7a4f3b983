"""Groups of ``result.nc`` by which a diagnosis is stored, each where there is something to store.

``disagreement``: RMS before and after, for every piece (a channel of a recording, or of a part of
it). ``signals``: measured and predicted, for every piece; of a closed loop
for those held out. ``order_sizes``: lines of a speed loop.
``posterior``: draws of everything unknown, with what was named added. ``ranking``: every candidate
added alone. ``residuals_before``, ``residuals_after``: what the simulation does not explain, over
load angle, order and time. ``learned_torque``, ``encoder_error``: what was learned, over what it
depends on.
The answer in the words of ``summary.json`` is JSON in the attribute ``diagnosis`` of the root, the
bench with what was named in it a bench file in the attribute ``augmented_bench``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import xarray as xr

from bayesbl.bench.learned import EncoderError, LearnedTorque
from bayesbl.config.bench import dump_bench
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.residual_groups import residuals_dataset, residuals_group
from bayesbl.diagnosis.summary import answer_of
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.measurement.direct_route import result_name, unit_and_meaning
from bayesbl.measurement.shared_groups import CHAIN, DRAW, numbered
from bayesbl.results.intervals import IntervalKind
from bayesbl.results.variables import Group, Variable, dataset, labels, padded, table
from bayesbl.units import unit_of

STAGES = ("before", "after")
"""The bench as believed, and with what was named."""

_PIECE = table("""
    recording (piece) | text | recording
    channel (piece) | text | channel
    use (piece) | text | fitted on (used) or predicted (held_out)
""")


def signals_group(unit: str) -> Group:
    """Signals in the unit of their channel; a row for each :class:`PieceSignals`."""
    variables = table(f"""
        time_s (piece, sample) | s | time
        measured (piece, sample) | {unit} | measured
        before (piece, sample) | {unit} | bench without the named effects
        after (piece, sample) | {unit} | bench with the named effects
    """)
    return Group("signals", variables, _PIECE, optional=True)


def disagreement_group(unit: str) -> Group:
    """RMS between bench and measurement in the unit of the channel; a row for each piece."""
    variables = table(f"""
        before (piece) | {unit} | RMS without the named effects
        after (piece) | {unit} | RMS with the named effects
        noise_floor (piece) | {unit} | RMS of what does not follow from the recording's past
        closed_fraction (piece) | 1 | closed share of the excess over the floor
    """)
    past = table("noise_floor_from (piece) | text | that past: rotation or samples")
    return Group("disagreement", variables, (*_PIECE, *past))


def _unknown(name: str) -> Variable:
    """An unknown; one that belongs to a single recording has its name behind it, in brackets."""
    shared, _, recording = name.removesuffix(")").partition(" (")
    unit, meaning = unit_and_meaning(shared)
    return Variable(
        name, ("chain", "draw"), unit, f"{meaning}, {recording}" if recording else meaning
    )


ORDER_SIZES = Group(
    "order_sizes",
    table("""
        speed_rpm (line) | rpm | mean speed of the motor
        torque_nm (line) | N m | torque that would make the line at this order
        sd_nm (line) | N m | its standard deviation
        by_law_nm (line) | N m | what the order's law gives at this speed
    """),
    table("""
        order (line) | 1 | order of the motor's turning
        law (line) | text | torque, angle, both or none
        recording (line) | text | recording
        use (line) | text | fitted on (used) or predicted (held_out)
    """),
    optional=True,
)


POSTERIOR = Group("posterior", coordinates=(CHAIN, DRAW), named=_unknown, optional=True)

RANKING = Group(
    "ranking",
    table("""
        chi_square_gain (candidate) | 1 | drop of χ² by this candidate alone
        log_evidence_gain (candidate) | 1 | log evidence over the bench before
    """),
    (labels("candidate", "effect or bench parameter"),),
    optional=True,
)


LEARNED = {
    LearnedTorque.block: Group(
        LearnedTorque.block,
        table("""
            torque_nm (point) | N m | learned torque against the side it acts at, turning forwards
            sd_nm (point) | N m | its standard deviation
        """),
        table("variable (point) | 1 | what it depends on, in rad, rad/s or s"),
        optional=True,
    ),
    EncoderError.block: Group(
        EncoderError.block,
        table("""
            angle_rad (point) | rad | what the motor's encoder shows too much
            sd_rad (point) | rad | its standard deviation
        """),
        table("variable (point) | rad | angle of the motor"),
        optional=True,
    ),
}
"""By the name of what was learned."""


def declared_groups(_: xr.DataTree) -> tuple[Group, ...]:
    """All groups of a diagnosis."""
    of_pieces = (disagreement_group(""), signals_group(""))
    named = (ORDER_SIZES, POSTERIOR, RANKING, *LEARNED.values())
    return (*of_pieces, *named, *map(residuals_group, STAGES))


def diagnosis_tree(found: Diagnosis, level: float, kind: IntervalKind) -> xr.DataTree:
    """The whole result, without its origin.

    Parameters
    ----------
    level, kind
        Of the credible intervals.
    """
    group = disagreement_group(found.disagreement.unit or "as the channel")
    groups = {"disagreement": of_rows(group, found.disagreement.pieces)}
    if found.signals:
        units = {unit_of(piece.channel) for piece in found.signals}
        group = signals_group(units.pop() if len(units) == 1 else "as the channel")
        groups["signals"] = of_rows(group, found.signals)
    if found.order_sizes:
        groups["order_sizes"] = of_rows(ORDER_SIZES, found.order_sizes)
    if found.posterior is not None:
        groups["posterior"] = posterior_dataset(found.posterior)
    if found.learned is not None:
        curve, group = found.learned.curve, LEARNED[found.learned.term.block]
        size, sd = (variable.name for variable in group.variables)
        groups[group.name] = dataset(
            group, {size: curve.value, sd: curve.sd}, {"variable": curve.variable}
        )
    if found.ranking:
        groups["ranking"] = of_rows(RANKING, found.ranking)
    for stage, analysis in zip(
        STAGES, (found.residuals_before, found.residuals_after), strict=True
    ):
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


def of_rows(group: Group, rows: Sequence[object]) -> xr.Dataset:
    """A group of which every declared variable is an attribute of each row."""
    return dataset(
        group,
        {v.name: _stacked(rows, v) for v in group.variables},
        {v.name: _stacked(rows, v) for v in group.coordinates},
    )


def _stacked(rows: Sequence[object], declared: Variable) -> object:
    """Of all rows; arrays of different lengths padded with NaN, ``None`` as NaN."""
    values = [getattr(row, declared.name) for row in rows]
    if declared.kind == "text":
        return values
    if len(declared.dims) == 1:
        return np.array(values, dtype=float)
    return padded(values, max(value.size for value in values))


def posterior_dataset(posterior: DirectPosterior) -> xr.Dataset:
    """Draws of every unknown, in its own unit."""
    values = {}
    for i, unknown in enumerate(posterior.fit.model.unknowns):
        name = result_name(unknown)
        label = name if unknown.recording is None else f"{name} ({unknown.recording})"
        values[label] = unknown.value(posterior.draws[..., i])
    return dataset(POSTERIOR, values, numbered(posterior.draws.shape))
