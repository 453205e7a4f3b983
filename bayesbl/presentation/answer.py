"""A fit or a comparison in words: its gaps, their change, and everything that limits the answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeGuard

from bayesbl.presentation import (
    direct_route,
    joint_check,
    ringing,
    torque_ramps,
    two_encoders,
    wear,
    words,
)
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import (
        MeasuredSummary,
        SamplerCheckSummary,
        SnapshotSummary,
    )
    from bayesbl.results.intervals import Interval
    from bayesbl.runs.summary import Summary

GAP_EXPLAINED = "The gap δ is half the total clearance, as an angle at the load."

OTHER_MACHINE = "If this joint were the paper's test bench, at an assumed 2000 rpm"

SHRANK = (
    "The gap shrank, and wear does not heal: are the files in order, or was the joint repaired "
    "between them?"
)


def is_measured(summary: Summary) -> TypeGuard[MeasuredSummary]:
    """Whether a summary is of gaps measured in recordings."""
    return summary["kind"] in ("fit", "compare")


def snapshots(summary: MeasuredSummary) -> list[tuple[str, SnapshotSummary]]:
    """(name, part) of every snapshot; the name of a fit's only one is empty."""
    if summary["kind"] == "compare":
        return [(part["name"], part) for part in summary["snapshots"]]
    return [("", summary)]


def blocks(summary: MeasuredSummary) -> Iterator[Block]:
    """Everything below the headline: table of the snapshots, wear, and what limits the answer."""
    _, *others = lead(summary)
    for sentence in (*others, *steps(summary), above_limit(summary)):
        if sentence:
            yield Sentence(sentence)
    if has_shrunk(summary):
        yield Sentence(SHRANK, "warning")
    yield _snapshot_table(summary)
    for name, part in snapshots(summary):
        if "sampler_check" in part:
            yield Sentence(sampler_check(part["sampler_check"]), "aside", name)
    if summary["kind"] == "compare" and summary["wear"] is not None:
        yield from wear.blocks(summary, summary["wear"])
    yield Sentence(ringing.EXPLAINED if ringing.is_alone(summary) else GAP_EXPLAINED, "aside")
    if torque_ramps.is_by_ramps(summary):
        for sentence in torque_ramps.of_positions(snapshots(summary)):
            yield Sentence(sentence, "aside")
    for sentence in (*outliers(summary), *budget(summary)):
        yield Sentence(sentence, "aside")
    for sentence in direct_route.other_route(snapshots(summary)):
        yield Sentence(sentence, "aside")
    for label, sentence in reasons(summary):
        yield Sentence(sentence, "warning", label)
    if summary["outcome"] == "no_curve":
        yield Sentence(summary["reason"] or "", "warning", "No gap")
    elif change_is_withheld(summary):
        yield Sentence(summary["reason"] or "", "warning", "Withheld")
    yield from joint_check.blocks(summary)


def lead(summary: MeasuredSummary) -> Iterator[str]:
    """What a fit or a comparison leads with: the wear where it has a rate, else gap or change."""
    if summary["kind"] == "compare" and (rated := wear.with_rate(summary)) is not None:
        yield wear.headline(summary, rated)
        if wear.spans_repair(summary, rated):
            return
    yield headline(summary)


def headline(summary: MeasuredSummary) -> str:
    """The gap, or the change of compared ones."""
    if ringing.is_alone(summary):
        return ringing.headline(summary)
    by = f"{OTHER_MACHINE}: " if is_by_other_machine(summary) else ""
    if summary["kind"] == "compare":
        change, growth = summary["change_rad"], summary["probability_increase"]
        if change is not None and growth is not None:
            if (cause := joint_check.other_cause(summary)) is not None:
                return f"{by}{if_nothing_else(change, growth, cause)}"
            told = words.change_of("The gap", change, "mrad", 1e3)
            return f"{by}{told}; {grew(growth)}{joint_check.unless(summary)}."
    elif summary["delta_rad"] is not None:
        if (none := torque_ramps.no_play(summary) or two_encoders.no_play(summary)) is not None:
            return none
        return f"{by}The gap is {words.in_mrad(summary['delta_rad'])}."
    what = "change of the gap" if summary["kind"] == "compare" else "gap"
    return f"The {what} is withheld: these data do not give an answer that can be trusted."


def if_nothing_else(change: Interval, growth: float, cause: str) -> str:
    """A change of the gap that another one, unseen, could make: never told as shown."""
    told = words.change_of("it", change, "mrad", 1e3)
    return (
        f"It is not shown that the gap changed: {told} if nothing else in the joint changed "
        f"({grew(growth)}), but a change of {cause} could do as much."
    )


def grew(value: float) -> str:
    """The probability of growth as part of a sentence."""
    return f"probability that it grew: {words.probability(value)}"


def has_shrunk(summary: MeasuredSummary) -> bool:
    """Whether a comparison without dates, which cannot show a repair, has less gap than before."""
    if summary["kind"] != "compare" or summary["wear"] is not None:
        return False
    if joint_check.other_cause(summary) is not None:
        return False
    return summary["change_rad"] is not None and summary["change_rad"]["high"] < 0.0


def steps(summary: MeasuredSummary) -> Iterator[str]:
    """Each step between neighbours, where there are more than two snapshots."""
    if summary["kind"] != "compare":
        return
    changes, unless = summary["changes"], joint_check.unless(summary)
    for step in changes if len(changes) > 1 else []:
        change, growth = step["change_rad"], step["probability_increase"]
        found = "withheld"
        if change is not None and growth is not None:
            found = f"{words.in_mrad(change)}; {grew(growth)}{unless}"
        yield f"From {step['from']} to {step['to']}: {found}."


def change_is_withheld(summary: MeasuredSummary) -> bool:
    """Whether the gaps of a comparison are given, and their change is not."""
    if summary["kind"] != "compare" or summary["change_rad"] is not None:
        return False
    return all(part["delta_rad"] is not None for _, part in snapshots(summary))


def is_by_other_machine(summary: MeasuredSummary) -> bool:
    """Whether the answer rests on the gap curve of the paper's test bench."""
    from bayesbl.config.fields import PUBLISHED  # pydantic is behind it

    return summary["curve"] == PUBLISHED and not direct_route.is_direct(summary)


def explained(summary: MeasuredSummary) -> str:
    """What δ and the range beneath it are, and what they rest on."""
    if torque_ramps.is_by_ramps(summary):
        condition = "the ramps reach both flanks"
    elif two_encoders.is_by_two_encoders(summary):
        condition = two_encoders.CONDITION
    elif direct_route.is_direct(summary):
        condition = "the bench is as its file says"
    else:
        condition = "the curve fits your joint"
    return (
        "The gap δ is half the play of the joint, as an angle at the load (1 mrad moves a point "
        "1 m away by 1 mm). The range below a number holds the true value with the stated "
        f"probability, if {condition}."
    )


def above_limit(summary: MeasuredSummary) -> str | None:
    """The probability of each snapshot above the limit; ``None`` without a limit."""
    limited = [(n, p) for n, p in snapshots(summary) if p.get("limit_rad") is not None]
    if not limited or ringing.is_alone(summary) or is_by_other_machine(summary):
        return None
    each = ", ".join(
        _probability_or_withheld(part) + (f" ({name})" if name else "") for name, part in limited
    )
    limit = 1e3 * limited[0][1]["limit_rad"]
    return f"Probability that the gap is above its limit of {limit:g} mrad: {each}."


def budget(summary: MeasuredSummary) -> Iterator[str]:
    """Where the width of the last interval given comes from, in one line."""
    answered = [(n, p) for n, p in snapshots(summary) if p["delta_rad"] is not None]
    for name, part in answered[-1:]:
        shares = sorted(part["budget"].items(), key=lambda item: -item[1])
        each = [
            f"{words.source_in_words(source)} {words.probability(share)}"
            for source, share in shares
            if share >= words.RAREST
        ]
        if each:
            yield f"Variance of the gap{words.of(name)}, by source: {', '.join(each)}."


def reasons(summary: MeasuredSummary) -> Iterator[tuple[str, str]]:
    """(``Withheld`` or ``Note``, sentence) of all that limits an answer, each once.

    The names of the snapshots that it applies to come first.
    """
    names: dict[tuple[str, str], list[str]] = {}
    for name, part in snapshots(summary):
        found: Sequence[str] = part["diagnostics"]["reasons"]
        for sentence in found:
            label = "Withheld" if sentence in (part["reason"] or "") else "Note"
            names.setdefault((label, sentence), []).append(name)
    for (label, sentence), whose in names.items():
        yield label, f"{', '.join(whose)}: {sentence}" if any(whose) else sentence


def outliers(summary: MeasuredSummary) -> Iterator[str]:
    """A sentence for every snapshot whose noise is Student-t."""
    for name, part in snapshots(summary):
        freedom = part["noise"]["degrees_of_freedom"]
        evidence = part["noise"].get("student_t_evidence")
        if freedom is not None and evidence is not None:
            yield (
                f"The noise{words.of(name)} has outliers: Student-t with {freedom:g} degrees of "
                f"freedom (log evidence against normal noise: {number(evidence, 0)})."
            )


def sampler_check(check: SamplerCheckSummary) -> str:
    """What the second sampler found of every parameter."""
    each = "; ".join(
        f"{symbol} {number(found['difference_sd'], 2)} sd, width × {found['width_ratio']:.2f}"
        for symbol, found in check["symbols"].items()
    )
    verdict = "agrees with" if check["agrees"] else "disagrees with"
    return f"Nested sampling {verdict} emcee (difference, width over emcee's): {each}."


def _probability_or_withheld(part: SnapshotSummary) -> str:
    value = part["probability_above_limit"]
    return "withheld" if value is None else words.probability(value)


def _snapshot_table(summary: MeasuredSummary) -> Table:
    parts = snapshots(summary)
    compared = summary["kind"] == "compare"
    first = parts[0][1]
    # There may be an answer where the ringing gives no amplitude.
    places = words.common_decimals(part["delta_rad"] for _, part in parts)
    if torque_ramps.is_by_ramps(summary):
        return torque_ramps.snapshot_table(parts, places)
    if two_encoders.is_by_two_encoders(summary):
        return two_encoders.snapshot_table(parts, places)
    kind = words.short_kind(first["amplitude_rpm"] or next(iter(first["parameters"].values())))
    alone = ringing.is_alone(summary)
    beside = direct_route.beside(first)
    repeats = "Motion\ncycles" if "motion" in first else "Load\nrotations"
    columns = (
        *([text("Snapshot")] if compared else []),
        *([] if alone else [numbers("Gap δ\n(mrad)"), numbers(f"{kind}\n(mrad)")]),
        *([numbers(f"By {beside}\n(mrad)")] if beside else []),
        numbers("Ringing A\n(rpm)"),
        *([numbers(f"{kind}\n(rpm)")] if alone else []),
        # Eighty columns hold no more.
        *([] if beside else [numbers(repeats), numbers("Noise sd\n(rpm)")]),
        text("Outcome"),
    )
    rows = [
        [*([name] if compared else []), *_cells(part, places, beside, alone)]
        for name, part in parts
    ]
    return table(columns, rows)


def _cells(part: SnapshotSummary, places: int, beside: str | None, alone: bool) -> Iterator[str]:
    amplitude = part["amplitude_rpm"]
    if not alone:
        yield from words.gap_cells(part["delta_rad"], places)
    if beside:
        other = part["routes"][beside]["delta_rad"]
        yield "withheld" if other is None else words.bounds(other, 1e3)
    yield words.median_of(amplitude, 1)
    if alone:
        yield "–" if amplitude is None else words.bounds(amplitude, places=1)
    if not beside:
        yield f"{part['rotations']:.1f}"
        yield f"{part['noise']['sd_rpm']:.2f}"
    yield part["diagnostics"]["outcome"]
