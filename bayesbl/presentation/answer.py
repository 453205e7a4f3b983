"""A fit or a comparison in words: its gaps, their change, and everything that limits the answer.

Where several routes answered they stand side by side: which is the answer and why, in one line; a
disagreement between them comes first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard

from bayesbl.presentation import joint_check, torque_ramps, two_encoders, wear, words
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text
from bayesbl.presentation.words import route_in_words
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import (
        MeasuredSummary,
        ReasonSummary,
        RouteSummary,
        SamplerCheckSummary,
        SnapshotSummary,
    )
    from bayesbl.results.intervals import Interval
    from bayesbl.runs.summary import Summary

GAP_EXPLAINED = "The gap δ is half the total clearance, as an angle at the load."

RINGING_EXPLAINED = (
    "The amplitude A is that of the ringing after each impact, in the motor's speed."
)

OTHER_MACHINE = "If this joint were the paper's test bench, at an assumed 2000 rpm"

DISAGREE = "routes_disagree"
"""Code of the reason that two routes answer, and not alike."""

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


def codes(reason: ReasonSummary | None) -> list[str]:
    """Of a reason and of all beneath it."""
    if reason is None:
        return []
    return [reason["code"], *(code for also in reason.get("also", ()) for code in codes(also))]


def answering(part: SnapshotSummary) -> list[RouteSummary]:
    """What each route that ran says of a snapshot, the one that answers first."""
    return [route for route in part["routes"].values() if "diagnostics" in route]


def with_ringing(part: SnapshotSummary) -> RouteSummary | None:
    """What the route that fitted the ringing says of a snapshot."""
    return next((route for route in answering(part) if "rmse_rpm" in route), None)


def is_simulated(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from simulations of the bench."""
    return "cramer_rao_sd" in snapshots(summary)[0][1]


def is_ringing_alone(summary: MeasuredSummary) -> bool:
    """Whether the ringing was measured and no curve leads from it to a gap."""
    return all("rmse_rpm" in part and part["curve"] is None for _, part in snapshots(summary))


def blocks(summary: MeasuredSummary) -> Iterator[Block]:
    """Everything below the headline: tables of the snapshots, wear, and what limits the answer."""
    parts = snapshots(summary)
    _, *others = lead(summary)
    limits = above_limit(summary), in_unit_of_limit(summary)
    for sentence in (*others, which(summary), *steps(summary), *limits):
        if sentence:
            yield Sentence(sentence)
    if has_shrunk(summary):
        yield Sentence(SHRANK, "warning")
    yield _gap_table(summary)
    if with_ringing(parts[0][1]) is not None:
        yield _ringing_table(summary)
    for name, part in parts:
        if "sampler_check" in part:
            yield Sentence(sampler_check(part["sampler_check"]), "aside", name)
    if summary["kind"] == "compare" and summary["wear"] is not None:
        yield from wear.blocks(summary, summary["wear"])
    yield Sentence(RINGING_EXPLAINED if is_ringing_alone(summary) else GAP_EXPLAINED, "aside")
    if torque_ramps.is_by_ramps(summary):
        for sentence in torque_ramps.of_positions(parts):
            yield Sentence(sentence, "aside")
    for sentence in (*outliers(summary), *budget(summary)):
        yield Sentence(sentence, "aside")
    for sentence in not_answering(parts):
        yield Sentence(sentence, "aside")
    for label, sentence in reasons(summary):
        yield Sentence(sentence, "warning", label)
    reason = summary["reason"]
    if reason is not None and summary["outcome"] == "no_curve":
        yield Sentence(reason["text"], "warning", "No gap")
    elif reason is not None and change_is_withheld(summary) and DISAGREE not in codes(reason):
        yield Sentence(reason["text"], "warning", "Withheld")
    yield from joint_check.blocks(summary, codes(reason))


def lead(summary: MeasuredSummary) -> Iterator[str]:
    """What a fit or a comparison leads with: a disagreement, then the wear where it has a rate."""
    if DISAGREE in codes(summary["reason"]) and summary["reason"] is not None:
        yield words.capitalised(summary["reason"]["text"])
    if summary["kind"] == "compare" and (rated := wear.with_rate(summary)) is not None:
        yield wear.headline(summary, rated)
        if wear.spans_repair(summary, rated):
            return
    yield headline(summary)


def headline(summary: MeasuredSummary) -> str:
    """The gap, or the change of compared ones."""
    if is_ringing_alone(summary):
        return ringing_headline(summary)
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
    elif summary["delta_upper_bound_rad"] is not None:
        bound = words.significant(1e3 * summary["delta_upper_bound_rad"])
        return f"The gap is not told from none: it is below {bound} mrad with 95 % probability."
    what = "change of the gap" if summary["kind"] == "compare" else "gap"
    return f"The {what} is withheld: these data do not give an answer that can be trusted."


def ringing_headline(summary: MeasuredSummary) -> str:
    """The amplitude, or its change from first to last, where there is no gap."""
    if summary["outcome"] == "withheld":
        what = "change of the ringing" if summary["kind"] == "compare" else "ringing"
        return f"The {what} is withheld: these data do not give an answer that can be trusted."
    if summary["kind"] == "compare":
        change, grew = summary["ringing_change"], summary["probability_ringing_grew"]
        if change is None or grew is None:
            return "The change of the ringing is withheld."
        told = words.change_of("The ringing", change, "%", 100.0)
        told += f"; probability that it grew: {words.probability(grew)}"
        if not summary["same_joint"]["agrees"]:
            told += ". Something other than the gap changed, so this says nothing of wear"
        elif (unseen := joint_check.unseen_without_current(summary)) is not None:
            told += (
                f". This says something of the gap only if {unseen} did not change: no motor "
                "current can be compared"
            )
        return f"{told}."
    found = summary["amplitude_rpm"]
    if found is None:
        return "The ringing is withheld."
    return f"The ringing has an amplitude of {words.with_bounds(found, 'rpm')}."


def which(summary: MeasuredSummary) -> str | None:
    """Which route's answer is the answer, why, and what each rests on; ``None`` for one alone."""
    first = snapshots(summary)[0][1]
    if len(first["routes"]) < 2:
        return None
    own = summary["answer"]
    rests = "; ".join(
        f"by {route_in_words(route['route'])}: {_rests_on(route)}" for route in answering(first)
    )
    return (
        f"The answer is that by {route_in_words(own['route'])}, as {own['text'].rstrip('.')}. "
        f"{words.capitalised(rests)}."
    )


def _rests_on(route: RouteSummary) -> str:
    if "rmse_rpm" not in route:
        return "speed and current of the whole recording against the bench"
    if route["curve"] is None:
        return "the amplitude A alone"
    name = Path(route["curve"]).name
    belongs = " (of the paper's bench)" if route["curve"] == "published" else ""
    return f"the amplitude A through the gap curve of {name}{belongs}"


def not_answering(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """Why a route beside the answer has none, unless that is why the other one answers."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for name, part in parts:
        listed = [reason["code"] for reason in part["diagnostics"]["reasons"]]
        for route, found in part["routes"].items():
            reason = found["reason"]
            if route == part["route"] or reason is None or "by_amplitude_instead" in listed:
                continue
            reasons.setdefault((route, reason["text"]), []).append(name)
    for (route, why), names in reasons.items():
        yield f"No answer by {route_in_words(route)}{words.of(*names)}: {why}"


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

    return snapshots(summary)[0][1]["curve"] == PUBLISHED


def explained(summary: MeasuredSummary) -> str:
    """What δ and the range beneath it are, and what they rest on."""
    if torque_ramps.is_by_ramps(summary):
        condition = "the ramps reach both flanks"
    elif two_encoders.is_by_two_encoders(summary):
        condition = two_encoders.CONDITION
    elif is_simulated(summary):
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
    if not limited or is_ringing_alone(summary) or is_by_other_machine(summary):
        return None
    each = ", ".join(
        _probability_or_withheld(part) + (f" ({name})" if name else "") for name, part in limited
    )
    first = limited[0][1]
    limit = f"{1e3 * first['limit_rad']:.4g} mrad"
    if (stated := first.get("limit")) is not None:
        limit = f"{limit} ({words.limit(stated['text'])})"
    return f"Probability that the gap is above its limit of {limit}: {each}."


def in_unit_of_limit(summary: MeasuredSummary) -> str | None:
    """Each gap in the unit and of the kind that the limit was stated in; ``None`` without one."""
    stated = [(n, p["limit"]) for n, p in snapshots(summary) if "limit" in p]
    values = ", ".join(
        f"{number(one['median'], words.decimals(one))} ({words.bounds(one)}){words.of(name)}"
        for name, limit in stated
        if (one := limit["measured"]) is not None
    )
    return f"The gap in {stated[0][1]['unit']}: {values}." if values else None


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
        for reason in part["diagnostics"]["reasons"]:
            label = "Withheld" if reason["withholds"] else "Note"
            names.setdefault((label, reason["text"]), []).append(name)
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


def _gap_table(summary: MeasuredSummary) -> Table:
    """A row a snapshot, and one of the change; columns for each route."""
    parts = snapshots(summary)
    compared = summary["kind"] == "compare"
    places = words.common_decimals(part["delta_rad"] for _, part in parts)
    if torque_ramps.is_by_ramps(summary):
        return torque_ramps.snapshot_table(parts, places)
    if two_encoders.is_by_two_encoders(summary):
        return two_encoders.snapshot_table(parts, places)
    if is_ringing_alone(summary):
        return _ringing_alone_table(parts)
    routes = [name for name, found in parts[0][1]["routes"].items() if "diagnostics" in found]
    first = next((p["delta_rad"] for _, p in parts if p["delta_rad"]), None)
    kind = words.short_kind(first or next(iter(parts[0][1]["parameters"].values())))
    columns = [text("Snapshot")] if compared else []
    for route in routes:
        by = f"{words.capitalised(words.short_route(route))}\n" if len(routes) > 1 else "Gap "
        columns += [numbers(f"{by}δ (mrad)"), numbers(f"{kind}\n(mrad)")]
    columns.append(text("Outcome"))
    rows = []
    for name, part in parts:
        gaps = [part["routes"][route]["delta_rad"] for route in routes]
        cells = [name] if compared else []
        for gap in gaps:
            cells += words.gap_cells(gap, words.common_decimals([gap]))
        rows.append([*cells, part["diagnostics"]["outcome"]])
    if summary["kind"] == "compare":
        cells = ["change"]
        for route in routes:
            by_route = summary["routes"][route]["change_rad"]
            given = summary["change_rad"] if route == routes[0] else by_route
            cells += words.gap_cells(given, words.common_decimals([given]))
        rows.append([*cells, summary["outcome"]])
    return table(columns, rows)


def _ringing_table(summary: MeasuredSummary) -> Table:
    """What the ringing of each snapshot is: A, τ, ω, and how well the waveform fits."""
    from bayesbl.ringing.symbols import DECAY, FREQUENCY

    compared = summary["kind"] == "compare"
    columns = (
        *([text("Ringing")] if compared else []),
        numbers("A\n(rpm)"),
        numbers("τ\n(1/s)"),
        numbers("1/τ\n(ms)"),
        numbers("ω/2π\n(Hz)"),
        numbers("RMSE\n(rpm)"),
        numbers("Noise sd\n(rpm)"),
    )
    rows = []
    for name, part in snapshots(summary):
        found = with_ringing(part)
        if found is None:
            continue
        symbol = {n: v["median"] for n, v in found["parameters"].items()}
        decay, frequency = (symbol.get(n, found["optimum"][n]) for n in (DECAY, FREQUENCY))
        amplitude = found["amplitude_rpm"]
        cells = [
            "–"
            if amplitude is None
            else f"{amplitude['median']:.1f} ({words.bounds(amplitude, places=1)})",
            f"{decay:.3g}",
            f"{1e3 / decay:.3g}",
            f"{frequency / (2.0 * math.pi):.2f}",
            f"{found['rmse_rpm']:.2f} ({100.0 * found['relative_rmse']:.0f} %)",
            f"{found['noise']['sd_rpm']:.2f}",
        ]
        rows.append([*([name] if compared else []), *cells])
    return table(columns, rows)


def _ringing_alone_table(parts: Sequence[tuple[str, SnapshotSummary]]) -> Table:
    named = [text("Snapshot")] if any(name for name, _ in parts) else []
    kind = words.short_kind(parts[0][1]["parameters"]["amplitude_rpm"])
    columns = (*named, numbers("Ringing A\n(rpm)"), numbers(f"{kind}\n(rpm)"), text("Outcome"))
    rows = []
    for name, part in parts:
        found = part["amplitude_rpm"]
        cells = [words.median_of(found, 1), "–" if found is None else words.bounds(found, places=1)]
        rows.append([*([name] if named else []), *cells, part["diagnostics"]["outcome"]])
    return table(columns, rows)
