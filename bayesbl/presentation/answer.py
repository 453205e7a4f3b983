"""A fit or a comparison in words: gaps, their change, advice, assumptions, and all that limits
them.

If several routes answered, they are shown side by side. One line says which is the answer and why;
a disagreement comes first.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeGuard

from bayesbl.presentation import wear, words
from bayesbl.presentation.blocks import Advice, Block, Sentence, Table, aside, table
from bayesbl.presentation.words import SURE, interval_kind
from bayesbl.units import in_words as name_in_words
from bayesbl.units import number, quantity_and_unit

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import (
        MeasuredSummary,
        ReasonSummary,
        RouteSummary,
        SamplerCheckSummary,
        SnapshotSummary,
    )
    from bayesbl.results.store import Interval
    from bayesbl.runs.kinds import Summary


GAP_EXPLAINED = "The gap δ is half the total clearance, as an angle at the load."

RINGING_EXPLAINED = (
    "The amplitude A is that of the ringing after each impact, in the motor's speed."
)

OTHER_MACHINE = "If this joint were the paper's test bench, at an assumed 2000 rpm"
DISAGREE = "routes_disagree"  # code of the reason that two routes give different answers

SHRANK = (
    "The gap shrank, which wear cannot cause: are the files in order, or was the joint repaired "
    "between them?"
)


def is_measured(summary: Summary) -> TypeGuard[MeasuredSummary]:
    """Whether a summary is of gaps measured in recordings."""
    return summary["kind"] in ("fit", "compare")


def snapshots(summary: MeasuredSummary) -> list[tuple[str, SnapshotSummary]]:
    """Name and part of every snapshot; the only one of a fit has an empty name."""
    if summary["kind"] == "compare":
        return [(part["name"], part) for part in summary["snapshots"]]
    return [("", summary)]


def codes(reason: ReasonSummary | None) -> list[str]:
    """Codes of a reason and of all reasons below it."""
    if reason is None:
        return []
    return [reason["code"], *(code for also in reason.get("also", ()) for code in codes(also))]


def answering(part: SnapshotSummary) -> list[RouteSummary]:
    """The routes of a snapshot that ran, the answering one first."""
    return [route for route in part["routes"].values() if "diagnostics" in route]


def with_ringing(part: SnapshotSummary) -> RouteSummary | None:
    """The route that fitted the ringing of a snapshot."""
    return next((route for route in answering(part) if "rmse_rpm" in route), None)


def is_simulated(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from simulations of the bench."""
    return "cramer_rao_sd" in snapshots(summary)[0][1]


def is_ringing_alone(summary: MeasuredSummary) -> bool:
    """Whether the ringing was measured and no curve converts it to a gap."""
    return all("rmse_rpm" in part and part["curve"] is None for _, part in snapshots(summary))


def blocks(summary: MeasuredSummary) -> Iterator[Block]:
    """Everything below the headline: tables of the snapshots, wear, and what limits the answer."""
    parts = snapshots(summary)
    _, *others = lead(summary)
    limits = above_limit(summary), in_unit_of_limit(summary)
    sentences = (*others, which(summary), *steps(summary), *limits)
    yield from map(Sentence, filter(None, sentences))
    if not is_ringing_alone(summary):
        yield _gap_table(summary)
    if with_ringing(parts[0][1]) is not None:
        yield _ringing_table(summary)
    for name, part in parts:
        if "sampler_check" in part:
            yield Sentence(sampler_check(part["sampler_check"]), "aside", name)
    if summary["kind"] == "compare" and summary["wear"] is not None:
        yield from wear.blocks(summary, summary["wear"], is_told=shrinkage(summary) is not None)
    yield aside(RINGING_EXPLAINED if is_ringing_alone(summary) else GAP_EXPLAINED)
    positions = _of_positions(parts) if "ramps" in parts[0][1] else ()
    yield from map(aside, (*positions, *friction(summary), *budget(summary), *not_answering(parts)))
    for label, sentence in reasons(summary):
        yield Sentence(sentence, "warning", label)
    reason = summary["reason"]
    if reason is not None and summary["outcome"] == "no_curve":
        yield Sentence(reason["text"], "warning", "No gap")
    elif reason is not None and DISAGREE not in codes(reason):
        gaps_alone = summary["kind"] == "compare" and summary["change_rad"] is None
        if gaps_alone and all(part["delta_rad"] is not None for _, part in parts):
            yield Sentence(reason["text"], "warning", "Withheld")
    yield from wear.check_blocks(summary, codes(reason))


def lead(summary: MeasuredSummary) -> Iterator[str]:
    """The first sentences: a disagreement, a shrunken gap, the wear, then the answer."""
    if DISAGREE in codes(summary["reason"]) and summary["reason"] is not None:
        yield words.capitalised(summary["reason"]["text"])
    if (why := shrinkage(summary)) is not None:
        yield why
    if summary["kind"] == "compare" and (rated := wear.with_rate(summary)) is not None:
        yield wear.headline(summary, rated)
        if wear.spans_repair(summary, rated):
            return
    yield in_words(summary)
    if summary["kind"] == "compare" and summary["wear"] is None:
        last = summary["snapshots"][-1]
        gap, is_bound = last["delta_rad"], last["delta_upper_bound_rad"] is not None
        if gap is not None and not (is_bound or is_by_other_machine(summary)):
            yield f"The gap is {words.in_mrad(gap)} now."


def headline(summary: MeasuredSummary) -> str:
    """The first of these sentences."""
    return next(lead(summary))


def in_words(summary: MeasuredSummary) -> str:
    """The gap or the change of compared gaps; without a curve, that of the ringing."""
    alone = is_ringing_alone(summary)
    text = _ringing_in_words(summary) if alone else _gap_in_words(summary)
    what = "ringing" if alone else "gap"
    what = f"change of the {what}" if summary["kind"] == "compare" else what
    return text or (
        f"The {what} is withheld: these data do not give an answer that can be trusted."
    )


def _gap_in_words(summary: MeasuredSummary) -> str | None:
    by = f"{OTHER_MACHINE}: " if is_by_other_machine(summary) else ""
    if summary["kind"] == "compare":
        change, growth = summary["change_rad"], summary["probability_increase"]
        if change is None or growth is None:
            return None
        if (cause := wear.other_cause(summary)) is not None:
            text = words.change_of("it", change, "mrad", 1e3)
            return (
                f"{by}The gap is not shown to have changed: {text} if nothing else in the "
                f"joint changed ({grew(growth)}), but a change of {cause} could explain as much."
            )
        text = words.change_of("The gap", change, "mrad", 1e3)
        return f"{by}{text}; {grew(growth)}{wear.unless(summary)}."
    if (none := _no_play_by_ramps(summary)) is not None:
        return none
    if (upper_rad := summary["delta_upper_bound_rad"]) is not None:
        bound = words.significant(1e3 * upper_rad)
        return f"There may be no gap: it is below {bound} mrad with 95 % probability."
    gap = summary["delta_rad"]
    return None if gap is None else f"{by}The gap is {words.in_mrad(gap)}."


def _ringing_in_words(summary: MeasuredSummary) -> str | None:
    """The amplitude, or its change from first to last."""
    if summary["outcome"] == "withheld":
        return None
    if summary["kind"] == "fit":
        amplitude = summary["amplitude_rpm"]
        shown = None if amplitude is None else words.with_bounds(amplitude, "rpm")
        return shown and f"The ringing has an amplitude of {shown}."
    change, growth = summary["ringing_change"], summary["probability_ringing_grew"]
    if change is None or growth is None:
        return None
    text = f"{words.change_of('The ringing', change, '%', 100.0)}; {grew(growth)}"
    if not summary["same_joint"]["agrees"]:
        text += ". Something other than the gap changed, so this is no evidence of wear"
    elif (unseen := wear.unseen_without_current(summary)) is not None:
        text += (
            f". It is evidence about the gap only if {unseen} did not change: no motor "
            "current can be compared"
        )
    return f"{text}."


def which(summary: MeasuredSummary) -> str | None:
    """Which route answers, why, and what each route uses; ``None`` if only one was asked for."""
    first = snapshots(summary)[0][1]
    if len(first["routes"]) < 2 or summary["answer"]["code"] == "only_route":
        return None
    own = summary["answer"]
    uses = "; ".join(f"{words.in_words(part['route'])} {_uses(part)}" for part in answering(first))
    because = own["text"].rstrip(".")
    return (
        f"The answer is the estimate by {words.in_words(own['route'])}, because {because}. "
        f"{words.capitalised(uses)}."
    )


def _uses(route: RouteSummary) -> str:
    if "reversals" in route:
        return "compare the positions of motor and load, without a bench"
    if "rmse_rpm" not in route:
        return "compares speed and current of the whole recording with the bench"
    if route["curve"] is None:
        return "uses the amplitude A alone"
    belongs = " (of the paper's bench)" if route["curve"] == "published" else ""
    return f"uses the amplitude A and the gap curve of {words.curve_name(route['curve'])}{belongs}"


def not_answering(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """Why another route has no answer, unless that is why this one answers."""
    reasons = defaultdict[tuple[str, str], list[str]](list)
    for name, part in parts:
        listed = part["diagnostics"]["reasons"]
        causes = tuple(cause["text"] for one in listed for cause in one.get("because", ()))
        for route, other in part["routes"].items():
            reason = other["reason"]
            if not (route == part["route"] or reason is None or reason["text"].startswith(causes)):
                reasons[route, reason["text"]].append(name)
    for (route, why), names in reasons.items():
        yield f"No answer by {words.in_words(route)}{words.of(*names)}: {why}"


def grew(value: float) -> str:
    """The probability of growth as part of a sentence."""
    return f"probability that it grew: {words.probability(value)}"


def shrinkage(summary: MeasuredSummary) -> str | None:
    """A sentence if a gap is smaller than before, and no repair is stated."""
    if summary["kind"] != "compare" or summary["change_rad"] is None:
        return None
    if (dated := summary["wear"]) is not None:
        why = dated["reason"]
        return why["text"] if why and why["code"] in ("gap_shrank", "gap_fell") else None
    shrank = summary["change_rad"]["high"] < 0.0 and wear.other_cause(summary) is None
    return SHRANK if shrank else None


def steps(summary: MeasuredSummary) -> Iterator[str]:
    """Each change between neighbours, if there are more than two snapshots."""
    if summary["kind"] != "compare" or len(summary["changes"]) == 1:
        return
    for step in summary["changes"]:
        change, growth = step["change_rad"], step["probability_increase"]
        text = "withheld"
        if change is not None and growth is not None:
            text = f"{words.in_mrad(change)}; {grew(growth)}{wear.unless(summary)}"
        yield f"From {step['from']} to {step['to']}: {text}."


def is_by_other_machine(summary: MeasuredSummary) -> bool:
    """Whether the answer uses the gap curve of the paper's test bench."""
    from bayesbl.config.sections import PUBLISHED

    return snapshots(summary)[0][1]["curve"] == PUBLISHED


def above_limit(summary: MeasuredSummary) -> str | None:
    """The probability of each snapshot to be above the limit; ``None`` without a limit."""
    limited = [(n, p) for n, p in snapshots(summary) if p.get("limit_rad") is not None]
    if not limited or is_ringing_alone(summary) or is_by_other_machine(summary):
        return None
    each = ", ".join(
        ("withheld" if (p := part["probability_above_limit"]) is None else words.probability(p))
        + (f" ({name})" if name else "")
        for name, part in limited
    )
    first = limited[0][1]
    limit = words.limit(first["limit_rad"], first.get("limit", {}).get("text"))
    return f"Probability that the gap is above its limit of {limit}: {each}."


def in_unit_of_limit(summary: MeasuredSummary) -> str | None:
    """Each gap in the limit's unit and kind; ``None`` without a limit."""
    stated = [(n, p["limit"]) for n, p in snapshots(summary) if "limit" in p]
    if stated and stated[0][1]["unit"] == "mrad of δ":
        return None  # as in the table
    values = ", ".join(
        f"{words.middle(one)} ({words.bounds(one)}){words.of(name)}"
        for name, limit in stated
        if (one := limit["measured"]) is not None
    )
    return f"The gap in {stated[0][1]['unit']}: {values}." if values else None


def budget(summary: MeasuredSummary) -> Iterator[str]:
    """The sources of each gap's variance, in one line."""
    for name, part in snapshots(summary):
        shares = sorted(part["budget"].items(), key=lambda item: -item[1])
        each = [
            f"{words.in_words(source)} {words.probability(share)}"
            for source, share in shares
            if share >= words.RAREST and part["delta_rad"] is not None
        ]
        if each:
            yield f"Variance of the gap{words.of(name)}, by source: {', '.join(each)}."


def friction(summary: MeasuredSummary) -> Iterator[str]:
    """The friction that the direct route fitted to all recordings, in one line.

    Friction less than two standard deviations from zero is left out: a 90 % interval at two is
    (1 − 0.82) to (1 + 0.82) of its centre, with ends that differ by a factor of ten.
    """
    for route in answering(snapshots(summary)[0][1]):
        each = [
            f"{name_in_words(effect)} {words.with_ends(value)} {quantity_and_unit(parameter)[1]}"
            for name, value in route["parameters"].items()
            for effect, _, parameter in [name.partition("__")]
            if "cramer_rao_sd" in route and effect.endswith("friction")
            if value["low"] > 0.1 * value["high"]
        ]
        if each and route["delta_rad"] is not None:
            yield f"Friction, fitted with the gap: {', '.join(each)}."


def reasons(summary: MeasuredSummary) -> Iterator[tuple[str, str]]:
    """Label (``Withheld`` or ``Note``) and sentence of all that limits an answer, each once.

    The names of the snapshots concerned come first.
    """
    names = defaultdict[tuple[str, str], list[str]](list)
    for name, part in snapshots(summary):
        for reason in part["diagnostics"]["reasons"]:
            names["Withheld" if reason["withholds"] else "Note", reason["text"]].append(name)
    for (label, sentence), whose in names.items():
        yield label, f"{', '.join(whose)}: {sentence}" if any(whose) else sentence


def sampler_check(check: SamplerCheckSummary) -> str:
    """How the second sampler differs, for each parameter."""
    differences = "; ".join(
        f"{symbol} {number(each['difference_sd'], 2)} sd, width × {each['width_ratio']:.2f}"
        for symbol, each in check["symbols"].items()
    )
    verdict = "agrees with" if check["agrees"] else "disagrees with"
    return f"Nested sampling {verdict} emcee (difference, width over emcee's): {differences}."


def _gap_table(summary: MeasuredSummary) -> Table:
    """A row for each snapshot and for the change; columns for each route."""
    parts = snapshots(summary)
    columns = ["Snapshot"] * (summary["kind"] == "compare")
    routes = [route["route"] for route in answering(parts[0][1])]
    first = next((p["delta_rad"] for _, p in parts if p["delta_rad"]), None)
    kind = words.interval_kind(first or next(iter(parts[0][1]["parameters"].values())))
    for route in routes:
        way = words.capitalised(words.in_words(route).removeprefix("the "))
        by = f"{way}\n" if len(routes) > 1 else "Gap "
        columns += [f"#{by}δ (mrad)", f"#{kind}\n(mrad)"]
    beside = _play_columns(parts[0][1])
    columns += [*beside, "Outcome"]
    rows = []
    for name, part in parts:
        cells = [name] * (summary["kind"] == "compare")
        for own in (part["routes"][route] for route in routes):
            cells += words.gap_cells(own["delta_rad"], own["delta_upper_bound_rad"])
        cells += [shown(part) for shown in beside.values()]
        rows.append([*cells, _outcome(part)])
    if summary["kind"] == "compare":
        cells = ["change", *words.gap_cells(summary["change_rad"])]
        for route in routes[1:]:
            cells += words.gap_cells(summary["routes"][route]["change_rad"])
        rows.append([*cells, *("" for _ in beside), summary["outcome"]])
    return table(columns, rows)


def _ringing_table(summary: MeasuredSummary) -> Table:
    """The ringing of each snapshot: A, τ, ω, and how well the waveform fits."""
    from bayesbl.ringing.symbols import DECAY, FREQUENCY

    named = ["Ringing"] * (summary["kind"] == "compare")
    titles = ["#A\n(rpm)", "#τ\n(1/s)", "#1/τ\n(ms)", "#ω/2π\n(Hz)", "#RMSE\n(rpm)"]
    rows = []
    for name, part in snapshots(summary):
        ringing = with_ringing(part)
        if ringing is None:
            continue
        symbol = ringing["optimum"] | {n: v["median"] for n, v in ringing["parameters"].items()}
        amplitude, decay = ringing["amplitude_rpm"], symbol[DECAY]
        bounds = None if amplitude is None else words.bounds(amplitude, places=1)
        cells = [
            "–" if amplitude is None else f"{amplitude['median']:.1f} ({bounds})",
            f"{decay:.3g}",
            f"{1e3 / decay:.3g}",
            f"{symbol[FREQUENCY] / (2.0 * math.pi):.2f}",
            f"{ringing['rmse_rpm']:.2f} ({100.0 * ringing['relative_rmse']:.0f} %)",
            f"{ringing['noise']['sd_rpm']:.2f}",
        ]
        rows.append([name] * len(named) + cells)
    return table([*named, *titles, "#Noise sd\n(rpm)"], rows)


_AGAIN = {
    "motion": "the motion two times or more in a row",
    "ramps": "with the ramps stated in the reason",
    "reversals": "with more reversals, slow and fast",
}
_LONGER = "longer and at one constant speed"
"""How to record again, by a key of the route's summary; the latter for other routes."""

NOT_SHOWN = "No wear is shown: something other than the gap may have changed."


def advice(summary: MeasuredSummary) -> Advice:
    """Whether and when to repair, by the last snapshot."""
    last = snapshots(summary)[-1][1]
    if summary["outcome"] == "no_curve":
        return _of_ringing(summary)
    if last["delta_rad"] is None:
        again = next((how for key, how in _AGAIN.items() if key in last), _LONGER)
        why = [sentence for label, sentence in reasons(summary) if label == "Withheld"]
        why += [f"Fix this, or record again, {again}; until then, decide without this measurement."]
        return Advice("withheld", "Do not decide from these recordings.", tuple(why))
    head = _verdict(summary, last)
    if shrinkage(summary) is not None and head.tone != "act":
        title = "Do not decide: are the files in order, or was the joint repaired?"
        head = Advice("watch", title, head.sentences)
    return replace(head, sentences=(*head.sentences, *_caveats(summary)))


def _verdict(summary: MeasuredSummary, last: SnapshotSummary) -> Advice:
    """Advice by the limit, by a forecast if the limit is ahead, or by growth without a limit."""
    compared = summary if summary["kind"] == "compare" else None
    rated = wear.with_rate(compared) if compared else None
    cause, unless = (wear.other_cause(compared), wear.unless(compared)) if compared else (None, "")
    forecast = tuple(wear.sentences(rated, unless=unless)) if rated else ()
    above, limited = last.get("probability_above_limit"), above_limit(summary)
    if above is not None and limited is not None and above >= SURE:
        return Advice("act", "The joint is due for repair.", (limited,))
    if DISAGREE in codes(summary["reason"]):
        return Advice("watch", "Find out why the two estimates differ.", (_why(summary),))
    if is_by_other_machine(summary):
        return Advice("note", "Do not act on these gaps: the curve is another machine's.", ())
    if above is not None and limited is not None:
        if above > 1.0 - SURE:
            again = (
                "The gap may be on either side of the limit: inspect the joint, or record it again "
                "for longer."
            )
            return Advice("watch", "Look at this joint soon.", (limited, again))
        if rated is None:
            return Advice("fine", "No repair is due.", (limited,))
        if rated["probability_wear"] < SURE or unless:
            return Advice("fine", "No repair is due, and no wear is shown.", forecast)
        earliest, asked = wear.not_before(rated), rated["probability_before"]
        if earliest is None:
            return Advice("fine", "No repair is due for years.", forecast)
        is_soon = asked is not None and asked["probability"] > 1.0 - SURE
        title = f"Plan the repair for {earliest} or earlier."
        return Advice("watch" if is_soon else "fine", title, forecast)
    ask = "To learn whether a repair is due, give the largest gap allowed (--limit)."
    change = None if compared is None else compared["change_rad"]
    if compared is not None and cause is not None:
        headline = in_words(summary) if rated is None else wear.headline(compared, rated)
        return Advice("watch", NOT_SHOWN, (headline, ask))
    if rated is None and change is None:
        return Advice("note", "Compare this gap with the joint's limit.", (ask,))
    has_grown = change is not None and change["low"] > 0.0
    if rated["probability_wear"] >= SURE if rated else has_grown:
        return Advice("watch", "The joint is wearing: keep measuring it.", (*forecast, ask))
    return Advice("fine", "No wear is shown: measure again later.", (ask,))


def _of_ringing(summary: MeasuredSummary) -> Advice:
    """Advice for a ringing without a gap curve."""
    if summary["kind"] == "compare" and not summary["same_joint"]["agrees"]:
        found = [one["text"] for one in summary["same_joint"]["findings"]]
        title = "Find out what changed besides the gap."
        return Advice("watch", title, (*found, _why(summary)))
    grew = summary["kind"] == "compare" and (summary["probability_ringing_grew"] or 0.0) >= SURE
    title = "The ringing grew. To learn how much the gap grew, describe the joint in a bench file."
    if not grew:
        title = "Describe the joint in a bench file to learn the gap."
    return Advice("watch" if grew else "note", title, (_why(summary),))


def _why(summary: MeasuredSummary) -> str:
    return "" if summary["reason"] is None else summary["reason"]["text"]


def _caveats(summary: MeasuredSummary) -> Iterator[str]:
    if summary["kind"] == "compare":
        change, wear_summary = summary["change_rad"], summary["wear"]
        if (why := shrinkage(summary)) is not None:
            yield why
        elif wear_summary is not None and wear_summary["reason"] is not None:
            yield wear_summary["reason"]["text"]
        grown = change is not None and change["low"] > 0.0 and wear.other_cause(summary) is None
        if wear_summary is None and grown:
            yield (
                "To learn how fast the gap grows, give dates: date = 2026-03-01 in each "
                "[[recordings]], or --date for each."
            )
    if is_by_other_machine(summary):
        yield (
            "These gaps come from the curve of another machine, the paper's test bench, at an "
            "assumed speed. Describe your joint in a bench file (--bench) before you act on them. "
            "No probability of a limit, no rate and no date is given."
        )


def assumptions(summary: MeasuredSummary) -> Iterator[str]:
    """Assumptions of a measured gap."""
    last = snapshots(summary)[-1][1]
    if "ramps" in last:
        yield from _RAMPS_ASSUME
    elif "reversals" in last:
        yield from _ENCODERS_ASSUME
    else:
        yield from _of_ringing_joint(summary, last)
    if summary["kind"] == "compare":
        if is_simulated(summary):
            yield (
                "Between the snapshots, damping, friction, stiffness and the motor's torque "
                "constant drift no more than usual ([joint.drift]); controller and load are the "
                "same, unless a change is reported."
            )
        else:
            yield "Only the gap changed between the snapshots: same joint, controller and load."
    interval = last["delta_rad"] or last["amplitude_rpm"]
    if interval is not None:
        yield (
            f"The {interval_kind(interval)} is a credible interval: on these assumptions, it "
            f"contains the value with probability {100.0 * interval['level']:g} %."
        )


def _of_ringing_joint(summary: MeasuredSummary, last: SnapshotSummary) -> Iterator[str]:
    if "motion" in last:
        yield "The reference channel is the motion that the joint was commanded to make."
    else:
        yield (
            "The joint turned at one constant speed, and gravity moved the load to the other flank "
            "twice per rotation."
        )
    if is_simulated(summary):
        yield "The joint behaves as its bench file says, within the tolerances given there."
    elif is_ringing_alone(summary):
        yield "More ringing may mean more gap, or another load, stiffness, damping or controller."
    elif is_by_other_machine(summary):
        yield "The joint rings like the paper's test bench (curve published, eq. 4)."
        yield "The paper's test bench turned at 2000 rpm, which the paper does not state."
    else:
        yield f"The joint rings like the bench of its gap curve ({summary['curve']})."
    again = "cycle" if "motion" in last else "rotation"
    yield f"Noise does not repeat from one {again} to the next, and it is steady."
    if not is_ringing_alone(summary):
        yield "A priori, every gap is equally likely on a logarithmic scale, linear near zero."


def _no_play_by_ramps(part: SnapshotSummary) -> str | None:
    """The answer for a preloaded joint; ``None`` with play."""
    if not part.get("preloaded") or part["delta_rad"] is None:
        return None
    lifts = part["preload_torque_nm"]
    up_to = "the preload is unknown"
    if lifts is not None:
        up_to = f"both flanks carry the torque up to {words.with_bounds(lifts, 'N m')}"
    most = words.significant(1e3 * part["delta_rad"]["high"])
    return (
        "These ramps show no play: the joint is stiffer around zero torque than at larger torque; "
        f"{up_to}. Any gap δ that this hides is below {most} mrad."
    )


def _play_columns(part: SnapshotSummary) -> dict[str, Callable[[SnapshotSummary], str]]:
    """Further columns of numbers of a route that measures the play, by title."""
    if "ramps" in part:
        at = words.significant(part["lost_motion_torque_nm"])
        return {
            f"#Lost motion\n±{at} N m\n(mrad)": lambda p: _median(p["lost_motion_rad"], 1e3),
            "#Compliance\n(mrad/N m)": lambda p: _median(p["compliance_rad_per_nm"], 1e3),
            "#Friction\n(N m)": lambda p: _median(p["friction_torque_nm"]),
        }
    if "reversals" in part:
        return {
            "#Play 2δ\n(mrad)": lambda p: _median(p["play_rad"], 1e3),
            "#Lost motion\n(mrad)": lambda p: _median(p["lost_motion_rad"], 1e3),
            "#Skew\n(ms)": lambda p: words.bounds(p["channel_skew_s"], 1e3),
            "#Gear\nratio": lambda p: words.middle(p["gear_ratio"]),
        }
    return {}


def _outcome(part: SnapshotSummary) -> str:
    """The outcome of a snapshot, or whether there is play if that is uncertain."""
    if part.get("preloaded"):
        return "no play"
    if "reversals" in part and part["delta_upper_bound_rad"] is not None:
        return "play likely" if part["probability_of_play"] > 0.5 else "no play found"
    return part["diagnostics"]["outcome"]


def _of_positions(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """Widths at the positions around the turn, and the wind-up within them, for each snapshot."""
    for name, part in parts:
        if part["delta_rad"] is None:
            continue
        ramps = part["ramps"]
        each = ", ".join(words.significant(500.0 * w, 3) for w in ramps["width_rad"])
        where = "1 position" if ramps["positions"] == 1 else f"{ramps['positions']} positions"
        yield (
            f"Half the width at zero torque{words.of(name)}, at {where} around the turn: {each} "
            f"mrad ({ramps['cycles']} cycles of ±{ramps['torque_nm']:.3g} N m)."
        )
    for name, part in parts:
        held = part["held_windup_rad"]["median"]
        if held > 0.0 and not part["preloaded"] and part["delta_rad"] is not None:
            yield (
                f"About {words.significant(1e3 * held)} mrad of half the width{words.of(name)} may "
                "be wind-up that friction holds at zero torque, or more if the flanks are softer "
                "at small torque. From 0 to 4 times as much was subtracted from the gap."
            )


def _median(interval: Interval | None, scale: float = 1.0) -> str:
    return "withheld" if interval is None else words.significant(scale * interval["median"], 3)


_RAMPS_ASSUME = (
    "The output was held and did not give way; position and torque are those of the output.",
    "The ramps are slow: friction and inertia do not depend on how fast the joint moves.",
    "The measured positions represent the whole turn.",
    "Play is the width of the loop at zero torque. If the joint is soft, part of this width is "
    "wind-up held by friction.",
)

_ENCODERS_ASSUME = (
    "Friction drags the load through the play, or the load crosses it by itself; the load's weight "
    "does not hold it on one flank in both directions.",
    "Both encoders turn with their shafts and read without hysteresis: a loose ring or coupling "
    "looks like play, and so does hysteresis.",
    "Transmission error depends only on the angles and is the same in both directions.",
)
