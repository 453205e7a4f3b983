"""What is said of each kind of result.

Sweeps, plans and studies are put in words here, other kinds in modules of their own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from bayesbl.presentation import answer, diagnosis, estimates, fleet, identification
from bayesbl.presentation.answer import GAP_EXPLAINED
from bayesbl.presentation.blocks import (
    Advice,
    Block,
    Sentence,
    Table,
    aside,
    labelled,
    numbers,
    table,
    text,
)
from bayesbl.presentation.words import percent, significant, source_in_words
from bayesbl.units import number

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.runs.kinds import Summary
    from bayesbl.runs.plan import PlannedEntry, PlanSummary
    from bayesbl.runs.study import StudySummary
    from bayesbl.runs.sweep import SweepSummary


DEGREES_EXPLAINED = (
    "Departure of δ from the polynomial alone, fitted with relative weights. The log evidence is "
    "that of the polynomial with a smooth lack of fit."
)

_KINDS = {1: "straight line", 2: "parabola", 3: "cubic"}

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def sweep_headline(summary: SweepSummary) -> str:
    """Over which gaps the bench was swept, and how it then rings."""
    first, last = (f"{1e3 * gap:g}" for gap in summary["gap_rad"])
    low, high = (f"{amplitude:.1f}" for amplitude in summary["amplitude_rpm"])
    return (
        f"As the gap grows from {first} to {last} mrad, the amplitude A of the ringing grows from "
        f"{low} to {high} rpm."
    )


def sweep_blocks(summary: SweepSummary) -> Iterator[Block]:
    """The curve in words, its polynomial, and other degrees beside it."""
    yield from map(Sentence, curve_quality(summary))
    yield _coefficient_table(summary)
    yield aside(GAP_EXPLAINED)
    yield aside(
        "δ(A) is the sum of these terms times a smooth correction for lack of fit, at most "
        f"{percent(summary['largest_correction'])}. The stored curve includes the correction; the "
        "coefficients alone are off by as much."
    )
    yield _degree_table(summary)
    yield aside(DEGREES_EXPLAINED)


def curve_quality(summary: SweepSummary) -> Iterator[str]:
    """How well the polynomial describes the sweep, how sure the curve is, how far from eq. 4."""
    degree = summary["degree"]
    found = summary["degrees"].get(str(degree))
    if found is not None:
        yield (
            f"A {_KINDS.get(degree, f'polynomial of degree {degree}')} describes δ of the sweep "
            f"within {percent(found['largest_departure'])} "
            f"({percent(found['rms_departure'])} RMS)."
        )
    ordered = sorted(summary["relative_sd"].items(), key=lambda item: -item[1])
    each = ", ".join(f"{source_in_words(name)} {percent(sd)}" for name, sd in ordered)
    yield f"Largest standard deviation of δ along the curve, by source: {each}."
    yield (
        "At a given gap, A differs from that of the paper's eq. 4 by at most "
        f"{percent(summary['largest_departure_from_published'])}."
    )


def _coefficient_table(summary: SweepSummary) -> Table:
    rows = []
    for power, value in enumerate(summary["coefficients"]):
        raised = "" if power == 1 else str(power).translate(_SUPERSCRIPTS)
        term, unit = (f"A{raised}", f"rad/rpm{raised}") if power else ("1", "rad")
        rows.append((term, f"{value:.6e}".replace("-", "−"), unit))
    return table((text("Term"), numbers("Coefficient"), text("Unit")), rows)


def _degree_table(summary: SweepSummary) -> Table:
    titles = ("Degree", "RMS\ndeparture (%)", "Largest\ndeparture (%)", "Log evidence\nbelow best")
    best = max(found["log_evidence"] for found in summary["degrees"].values())
    rows = [
        (
            degree,
            significant(100.0 * found["rms_departure"]),
            significant(100.0 * found["largest_departure"]),
            number(best - found["log_evidence"], 1),
            "used" if int(degree) == summary["degree"] else "",
        )
        for degree, found in summary["degrees"].items()
    ]
    return table((*map(numbers, titles), text("")), rows)


SWEEP_ASSUMES = (
    "The simulated bench is a two-mass drive whose only play is one gap.",
    "The joint has the bench's parameters, within their tolerances where they have any.",
    "Measured recordings are fitted as these simulated ones were.",
)


def sweep_advice(_: SweepSummary) -> Advice:
    """What the curve of a sweep is for."""
    return Advice(
        "note",
        "Use this curve for recordings of this joint.",
        (
            "Give it to a comparison: `bayesbl compare FIRST SECOND --curve result.nc`. "
            "It holds for a joint like the simulated bench, and for no other.",
        ),
    )


MOST_ROWS = 12

EXPLAINED = (
    "Load angles: 0 hangs straight down. Expected standard deviation of δ, as a share of it, from "
    "one recording with the noise and the tolerances of the bench file."
)


def plan_headline(summary: PlanSummary) -> str:
    """The best motion."""
    if summary["reason"]:
        return "No motion within these limits shows the gap."
    best, *_ = summary["plan"]["motions"]
    low, high = (number(math.degrees(angle), 0) for angle in best["range_rad"])
    return (
        f"Record strokes of the load from {low}° to {high}°, up to {best['speed_rpm']:g} rpm of "
        f"the motor at {best['acceleration_rpm_per_s']:g} rpm/s, for {best['duration_s']:g} s: δ "
        f"to {percent(best['expected_relative_sd'] or 0.0)}."
    )


def plan_blocks(summary: PlanSummary) -> Iterator[Block]:
    """The best motions in a table, and how many show nothing."""
    plan = summary["plan"]
    shown = [m for m in plan["motions"] if m["expected_relative_sd"] is not None]
    if summary["reason"]:
        yield Sentence(summary["reason"], "warning", "Withheld")
    if shown:
        yield _plan_table(shown[:MOST_ROWS])
        yield aside(EXPLAINED)
    blind = len(plan["motions"]) - len(shown)
    if blind and shown:
        yield aside(
            f"{blind} of {len(plan['motions'])} motions would show nothing, because the load "
            "hardly reaches the other tooth flank."
        )
    yield aside(f"Calculated for δ = {1e3 * plan['gap_rad']:g} mrad.")


def _plan_table(motions: list[PlannedEntry]) -> Table:
    titles = ["From\n(°)", "To\n(°)", "Speed\n(rpm)", "Acceleration\n(rpm/s)"]
    titles += ["Flank\nchanges", "Expected sd\nof δ"]
    rows = [
        (
            *(number(math.degrees(angle), 1) for angle in motion["range_rad"]),
            f"{motion['speed_rpm']:g}",
            f"{motion['acceleration_rpm_per_s']:g}",
            motion["flank_changes"],
            percent(motion["expected_relative_sd"] or 0.0),
        )
        for motion in motions
    ]
    return table(map(numbers, titles), rows)


PLAN_ASSUMES = (
    "The joint behaves as its bench file says, within the tolerances given there.",
    "Its noise is that of the bench file, and it starts from rest.",
)


def plan_advice(summary: PlanSummary) -> Advice:
    """What to record."""
    if summary["reason"]:
        return Advice("withheld", "Widen the limits.", (summary["reason"],))
    return Advice(
        "note",
        "Record the first motion of the table.",
        (
            "Record the motor's speed and current, and the commanded speed or position, at about "
            "1 kHz. Then: `bayesbl fit RECORDING --bench FILE`.",
        ),
    )


def study_headline(summary: StudySummary) -> str:
    """Which study, and how much of it."""
    rows = summary["rows"]
    cases = sum(int(row["cases"]) for row in rows)
    return f"Study {summary['study']}: {cases} cases in {len(rows)} rows."


def study_blocks(summary: StudySummary) -> Iterator[Block]:
    """The table with the time that each row took; commits are in the files."""
    from bayesbl.runs.study import table_columns

    yield study_table(summary["rows"], [*table_columns(summary["rows"])[:-1], "seconds"])


def study_table(lines: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> Table:
    """One line a row, all values whole; what a row lacks stays empty.

    Parameters
    ----------
    lines
        The rows of the study, column to value.
    columns
        What is shown, in this order; the first one names the row.
    """
    from bayesbl.runs.study import cell

    first, *others = columns
    rows = [[cell(line.get(column)) for column in columns] for line in lines]
    return table((text(first), *map(numbers, others)), rows)


STUDY_ASSUMES = ("Each case has random numbers of its own, from the seed, the row and its number.",)


def study_advice(summary: StudySummary) -> Advice:
    """Whether all cases of a study count."""
    failed = sum(int(row["failed"]) for row in summary["rows"])
    if failed:
        why = f"{failed} cases failed and are not in the numbers; result.nc says why."
        return Advice("watch", "Look at the cases that failed first.", (why,))
    return Advice("note", "Read the table below, row by row.", ("No case failed: all count.",))


@dataclass(frozen=True, slots=True)
class Subject:
    """How one kind of result is presented, each from its summary.

    Attributes
    ----------
    title
        Of the page.
    headline, blocks
        The answer in a sentence, and all that is said below it.
    details
        Diagnostics, from the stored result too.
    """

    title: str
    headline: Callable[[Any], str]
    blocks: Callable[[Any], Iterator[Block]]
    advice: Callable[[Any], Advice]
    assumptions: Callable[[Any], Iterable[str]]
    details: Callable[[xr.DataTree, Any], Iterator[Block]] = lambda tree, summary: iter(())
    warning_label: str = "Warning"


def _measured(title: str) -> Subject:
    return Subject(
        title,
        lambda summary: next(answer.lead(summary)),
        answer.blocks,
        answer.advice,
        answer.assumptions,
        estimates.blocks,
    )


SUBJECTS: Mapping[str, Subject] = MappingProxyType(
    {
        "diagnose": Subject(
            "What a bench lacks",
            diagnosis.headline,
            diagnosis.blocks,
            diagnosis.advice,
            lambda _: diagnosis.ASSUMES,
            warning_label="Note",
        ),
        "identify": Subject(
            "Bench of a joint, from its data sheet and recordings",
            identification.headline,
            identification.blocks,
            identification.advice,
            identification.assumptions,
            warning_label="Note",
        ),
        "sweep": Subject(
            "Gap curve of a virtual bench",
            sweep_headline,
            sweep_blocks,
            sweep_advice,
            lambda _: SWEEP_ASSUMES,
        ),
        "plan": Subject(
            "Motions that would show the gap",
            plan_headline,
            plan_blocks,
            plan_advice,
            lambda _: PLAN_ASSUMES,
        ),
        "study": Subject(
            "Study", study_headline, study_blocks, study_advice, lambda _: STUDY_ASSUMES
        ),
        "fleet": Subject(
            "Backlash gaps of a plant",
            fleet.headline,
            fleet.blocks,
            fleet.advice,
            fleet.assumptions,
        ),
        "compare": _measured("Backlash gap of a joint and its change"),
        "fit": _measured("Backlash gap of a joint"),
    }
)


def blocks(summary: Summary) -> Iterator[Block]:
    """Everything that is said of a result below its headline."""
    subject = SUBJECTS[summary["kind"]]
    yield from subject.blocks(summary)
    for warning in summary["warnings"]:
        yield Sentence(warning, "warning", subject.warning_label)


def origin(tree: xr.DataTree) -> Iterator[Block]:
    """Where a stored result comes from: versions, seed, inputs."""
    stored = tree.attrs
    inputs = json.loads(stored.get("input_sha256", "{}"))
    versions = json.loads(stored.get("dependency_versions", "{}"))
    packages = {"python": stored.get("python_version"), **versions}
    lines = {
        "Version": f"{stored.get('bayesbl_version')}, commit {stored.get('git_commit')}",
        "Made": stored.get("created_utc"),
        "Seed": stored.get("seed"),
        "Packages": ", ".join(f"{name} {version}" for name, version in packages.items() if version),
        **{f"SHA-256 of {file}": digest for file, digest in inputs.items()},
    }
    yield from labelled(lines)
