"""A sweep in words: its range of gaps, and its gap curve."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation.answer import GAP_EXPLAINED
from bayesbl.presentation.blocks import Advice, Block, Sentence, Table, aside, table
from bayesbl.presentation.words import in_words, percent, significant
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.runs.sweep import SweepSummary


DEGREES_EXPLAINED = (
    "Departure of δ from the polynomial alone, fitted with relative weights. The log evidence is "
    "that of the polynomial with a smooth lack of fit."
)

_KINDS = {1: "straight line", 2: "parabola", 3: "cubic"}

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def headline(summary: SweepSummary) -> str:
    """The range of gaps, and of the amplitude."""
    first, last = (f"{1e3 * gap:g}" for gap in summary["gap_rad"])
    low, high = (f"{amplitude:.1f}" for amplitude in summary["amplitude_rpm"])
    return (
        f"As the gap grows from {first} to {last} mrad, the amplitude A of the ringing grows from "
        f"{low} to {high} rpm."
    )


def blocks(summary: SweepSummary) -> Iterator[Block]:
    """How well the polynomial fits, how certain the curve is, its distance from eq. 4; tables."""
    degree = summary["degree"]
    fit = summary["degrees"].get(str(degree))
    if fit is not None:
        yield Sentence(
            f"A {_KINDS.get(degree, f'polynomial of degree {degree}')} describes δ of the sweep "
            f"within {percent(fit['largest_departure'])} ({percent(fit['rms_departure'])} RMS)."
        )
    ordered = sorted(summary["relative_sd"].items(), key=lambda item: -item[1])
    each = ", ".join(f"{in_words(name)} {percent(sd)}" for name, sd in ordered)
    yield Sentence(f"Largest standard deviation of δ along the curve, by source: {each}.")
    yield Sentence(
        "At a given gap, A differs from that of the paper's eq. 4 by at most "
        f"{percent(summary['largest_departure_from_published'])}."
    )
    rows = []
    for power, value in enumerate(summary["coefficients"]):
        raised = "" if power == 1 else str(power).translate(_SUPERSCRIPTS)
        term, unit = (f"A{raised}", f"rad/rpm{raised}") if power else ("1", "rad")
        rows.append((term, f"{value:.6e}".replace("-", "−"), unit))
    yield table(("Term", "#Coefficient", "Unit"), rows)
    yield aside(GAP_EXPLAINED)
    yield aside(
        "δ(A) is the sum of these terms times a smooth correction for lack of fit, at most "
        f"{percent(summary['largest_correction'])}. The stored curve includes the correction; the "
        "coefficients alone are off by as much."
    )
    yield _degree_table(summary)
    yield aside(DEGREES_EXPLAINED)


def _degree_table(summary: SweepSummary) -> Table:
    departures = "#RMS\ndeparture (%)", "#Largest\ndeparture (%)"
    best = max(fit["log_evidence"] for fit in summary["degrees"].values())
    rows = [
        (
            degree,
            significant(100.0 * fit["rms_departure"]),
            significant(100.0 * fit["largest_departure"]),
            number(best - fit["log_evidence"], 1),
            "used" if int(degree) == summary["degree"] else "",
        )
        for degree, fit in summary["degrees"].items()
    ]
    return table(("#Degree", *departures, "#Log evidence\nbelow best", ""), rows)


ASSUMPTIONS = (
    "The simulated bench is a two-mass drive whose only play is one gap.",
    "The joint has the bench's parameters, within any tolerances.",
    "Measured recordings are fitted as these simulated ones were.",
)


def advice(_: SweepSummary) -> Advice:
    """How to use the curve."""
    return Advice(
        "note",
        "Use this curve for recordings of this joint.",
        (
            "Use it in a comparison: `bayesbl compare FIRST SECOND --curve result.nc`. "
            "It is valid only for a joint like the simulated bench.",
        ),
    )
