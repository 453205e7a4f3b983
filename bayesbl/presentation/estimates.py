"""What was estimated of each snapshot: parameters, noise, sampling, rival optima."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, direct_route, torque_ramps, two_encoders, words
from bayesbl.presentation.blocks import Block, Heading, Sentence, Table, numbers, table, text
from bayesbl.units import number

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.measurement.summary_types import MeasuredSummary, SnapshotSummary
    from bayesbl.results.intervals import Interval


def blocks(tree: xr.DataTree, summary: MeasuredSummary) -> Iterator[Block]:
    """Parameters and diagnostics of every snapshot."""
    for name, part in answer.snapshots(summary):
        yield Heading(f"Snapshot {name}" if name else "Fit")
        if "cramer_rao_sd" in part:
            yield from direct_route.blocks(part)
        elif "ramps" in part:
            yield from torque_ramps.blocks(part)
        elif "transmission_error" in part:
            yield from two_encoders.blocks(part)
        else:
            yield from _of_amplitude(part, "; ".join(_rivals(tree, name)) or "none")


def noise(part: SnapshotSummary) -> str:
    """``AR(1), standard deviation 1.51 rpm, coefficients 0.600, normal``."""
    found = part["noise"]
    kind = f"AR({found['order']})" if found["order"] else "white"
    if found["differentiated"]:
        kind = f"differentiated {kind}"
    text = f"{kind}, standard deviation {found['sd_rpm']:.3g} rpm"
    if found["order"]:
        text += ", coefficients " + ", ".join(number(c, 3) for c in found["coefficients"])
    if found["degrees_of_freedom"] is not None:
        text += f", Student-t with {found['degrees_of_freedom']:g} degrees of freedom"
    if found["student_t_evidence"] is not None:
        text += f" (log evidence for Student-t: {number(found['student_t_evidence'], 0)})"
    if found["repeating_rounding_sd_rpm"]:
        text += (
            f"; and rounding of {found['repeating_rounding_sd_rpm']:.3g} rpm that repeats every "
            "rotation"
        )
    return text


def _of_amplitude(part: SnapshotSummary, rivals: str) -> Iterator[Block]:
    yield _parameter_table(part)
    lines = {
        **({"Search": part["start"]} if "start" in part else {}),
        **({"Table 2's ranges": _box_search(part)} if "box_search" in part else {}),
        "Fit": f"RMSE {part['optimum']['rmse_rpm']:.3f} rpm",
        "Repeating misfit": f"{part['misfit_rms_rpm']:.3f} rpm RMS, the same in every rotation",
        "Noise": noise(part),
        "Sampling": words.sampling(part),
        "Rival optima": rivals,
    }
    for label, sentence in lines.items():
        yield Sentence(sentence, label=label)


def _box_search(part: SnapshotSummary) -> str:
    found = part["box_search"]
    return (
        f"the search ended at A = {found['amplitude_rpm']:.3g} rpm, RMSE {found['rmse_rpm']:.3g} "
        f"rpm; eq. 4 there: {1e3 * found['gap_as_printed_rad']:.3g} mrad"
    )


def _parameter_table(part: SnapshotSummary) -> Table:
    """All nine symbols and the time constant, with intervals or as fixed."""
    from bayesbl.ringing.symbols import DECAY, SYMBOLS

    kind = words.short_kind(next(iter(part["parameters"].values())))
    columns = (text("Parameter"), *map(numbers, ("Optimum", "Median", kind)), text("Unit"))
    rows = [_row(part, symbol.name, symbol.unit) for symbol in SYMBOLS.values()]
    rows.insert(list(SYMBOLS).index(DECAY) + 1, _time_constant(part))
    return table(columns, rows)


def _time_constant(part: SnapshotSummary) -> tuple[str, ...]:
    """The decay rate as the time constant that its symbol τ is often taken for."""
    from bayesbl.ringing.symbols import DECAY

    best, found = 1e3 / part["optimum"][DECAY], part["parameters"].get(DECAY)
    name = "  as a time constant"
    if found is None:
        return name, f"{best:.3g}", "", "fixed", "ms"
    inverse: Interval = {
        **found,
        "median": 1e3 / found["median"],
        "low": 1e3 / found["high"],
        "high": 1e3 / found["low"],
    }
    places = words.decimals(inverse, units=20.0)
    shown = (number(value, places) for value in (best, inverse["median"]))
    return name, *shown, words.bounds(inverse, places=places), "ms"


def _row(part: SnapshotSummary, name: str, unit: str) -> tuple[str, ...]:
    best, found = part["optimum"][name], part["parameters"].get(name)
    if found is None:
        return name, f"{best:g}", "", "fixed", unit
    places = words.decimals(found, units=20.0)
    shown = (number(value, places) for value in (best, found["median"]))
    return name, *shown, words.bounds(found, places=places), unit


def _rivals(tree: xr.DataTree, name: str) -> list[str]:
    """Other local optima of one snapshot, as amplitude and RMSE."""
    optimum = tree["optimum"].to_dataset()
    if name:
        optimum = optimum.sel(snapshot=name)
    amplitudes, errors = optimum["rival_amplitude_rpm"].values, optimum["rival_rmse_rpm"].values
    return [
        f"A = {a:.1f} rpm at RMSE {e:.3f} rpm"
        for a, e in zip(amplitudes, errors, strict=True)
        if a == a  # padding of snapshots with fewer rivals is NaN
    ]
