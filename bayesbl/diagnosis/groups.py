"""Groups of ``result.nc`` by which a diagnosis is stored, each where there is something to store.

``disagreement``: RMS before and after, for every piece (a channel of a recording, or of a part of
it). ``signals``: measured and predicted, for every piece. ``posterior``: draws of everything
unknown, with what was named added. ``ranking``: every candidate added alone. ``residuals_before``,
``residuals_after``: what the simulation does not explain, over load angle, order and time. The
answer in the words of ``summary.json`` is JSON in the attribute ``diagnosis`` of the root, the
bench with what was named in it a bench file in the attribute ``augmented_bench``.
"""

from __future__ import annotations

import json

import numpy as np
import xarray as xr

from bayesbl.config.bench import dump_bench
from bayesbl.diagnosis.diagnosis import Diagnosis, PieceSignals, RankedCandidate
from bayesbl.diagnosis.disagreement import DisagreementTable
from bayesbl.diagnosis.residual_groups import residuals_dataset
from bayesbl.diagnosis.summary import answer_of
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.measurement.direct_groups import result_name, unit_and_meaning
from bayesbl.recording.types import FloatArray
from bayesbl.results.intervals import IntervalKind
from bayesbl.results.variables import Group, Variable, dataset, labels
from bayesbl.units import unit_of

_PIECE = (
    Variable("recording", ("piece",), "", "recording", "text"),
    Variable("channel", ("piece",), "", "channel", "text"),
    Variable("use", ("piece",), "", "fitted on (used) or predicted (held_out)", "text"),
)


def signals_group(unit: str) -> Group:
    """Signals in the unit of their channel."""
    dims = ("piece", "sample")
    return Group(
        "signals",
        (
            Variable("time_s", dims, "s", "time"),
            Variable("measured", dims, unit, "measured"),
            Variable("before", dims, unit, "bench without the named effects"),
            Variable("after", dims, unit, "bench with the named effects"),
        ),
        _PIECE,
        optional=True,
    )


def disagreement_group(unit: str) -> Group:
    """Model error in the unit of the channel."""
    bench = "RMS between bench and measurement"
    return Group(
        "disagreement",
        (
            Variable("before", ("piece",), unit, f"{bench} without the named effects"),
            Variable("after", ("piece",), unit, f"{bench} with the named effects"),
            Variable(
                "noise_floor",
                ("piece",),
                unit,
                "RMS of what does not follow from the recording's own past",
            ),
            Variable(
                "closed_fraction",
                ("piece",),
                "1",
                "share of the excess over the noise floor that is closed",
            ),
        ),
        (
            *_PIECE,
            Variable(
                "noise_floor_from",
                ("piece",),
                "",
                "past that the noise floor is counted from: the rotation or the samples before",
                "text",
            ),
        ),
    )


def _unknown(name: str) -> Variable:
    """An unknown; one that belongs to a single recording has its name behind it, in brackets."""
    shared, _, recording = name.removesuffix(")").partition(" (")
    unit, meaning = unit_and_meaning(shared)
    return Variable(
        name, ("chain", "draw"), unit, f"{meaning}, {recording}" if recording else meaning
    )


POSTERIOR = Group(
    "posterior",
    coordinates=(
        Variable("chain", ("chain",), "1", "ensemble"),
        Variable("draw", ("draw",), "1", "draw"),
    ),
    named=_unknown,
    optional=True,
)

RANKING = Group(
    "ranking",
    (
        Variable("chi_square_gain", ("candidate",), "1", "drop of χ² by this candidate alone"),
        Variable(
            "log_evidence_gain", ("candidate",), "1", "log evidence over the bench as believed"
        ),
    ),
    (labels("candidate", "effect or bench parameter"),),
    optional=True,
)


def diagnosis_tree(found: Diagnosis, level: float, kind: IntervalKind) -> xr.DataTree:
    """The whole result, without its origin.

    Parameters
    ----------
    level, kind
        Of the credible intervals.
    """
    groups = {"disagreement": _disagreement(found.disagreement)}
    if found.signals:
        groups["signals"] = _signals(found.signals)
    if found.posterior is not None:
        groups["posterior"] = _posterior(found.posterior)
    if found.ranking:
        groups["ranking"] = _ranking(found.ranking)
    analyses = {"before": found.residuals_before, "after": found.residuals_after}
    for stage, analysis in analyses.items():
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


def _signals(signals: tuple[PieceSignals, ...]) -> xr.Dataset:
    longest = max(piece.measured.size for piece in signals)

    def padded(rows: list[FloatArray]) -> FloatArray:
        table = np.full((len(rows), longest), np.nan)
        for row, values in zip(table, rows, strict=True):
            row[: values.size] = values
        return table

    names = ("time_s", "measured", "before", "after")
    return dataset(
        signals_group(unit_of(signals[0].channel)),
        {name: padded([getattr(piece, name) for piece in signals]) for name in names},
        {
            name: [getattr(piece, name) for piece in signals]
            for name in ("recording", "channel", "use")
        },
    )


def _disagreement(table: DisagreementTable) -> xr.Dataset:
    values = {
        name: np.array([getattr(found, name) for _, found in table.pieces], dtype=float)
        for name in ("before", "after", "noise_floor", "closed_fraction")
    }
    return dataset(
        disagreement_group(table.unit or "as the channel"),
        values,
        {
            name: [getattr(piece, name) for piece, _ in table.pieces]
            for name in ("recording", "channel", "use", "noise_floor_from")
        },
    )


def _posterior(posterior: DirectPosterior) -> xr.Dataset:
    chains, count, _ = posterior.draws.shape
    values = {}
    for i, unknown in enumerate(posterior.fit.model.unknowns):
        name = result_name(unknown)
        label = name if unknown.recording is None else f"{name} ({unknown.recording})"
        values[label] = unknown.value(posterior.draws[..., i])
    return dataset(POSTERIOR, values, {"chain": np.arange(chains), "draw": np.arange(count)})


def _ranking(ranking: tuple[RankedCandidate, ...]) -> xr.Dataset:
    return dataset(
        RANKING,
        {
            name: [getattr(candidate, name) for candidate in ranking]
            for name in ("chi_square_gain", "log_evidence_gain")
        },
        {"candidate": [candidate.name for candidate in ranking]},
    )
