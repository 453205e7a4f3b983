"""What to do about a result, for a reader who knows nothing of statistics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bayesbl.presentation import answer, diagnosis, joint_check, torque_ramps, two_encoders, wear
from bayesbl.presentation.words import SURE
from bayesbl.results.folder import AUGMENTED_BENCH
from bayesbl.units import in_words

if TYPE_CHECKING:
    from bayesbl.diagnosis.summary import DiagnosisSummary
    from bayesbl.measurement.summary_types import (
        ComparisonSummary,
        MeasuredSummary,
        SnapshotSummary,
        WearSummary,
    )
    from bayesbl.runs.plan import PlanSummary
    from bayesbl.runs.study import StudySummary
    from bayesbl.runs.sweep_summary import SweepSummary

CLOSE = 0.05
"""Relative distance from the limit that a guess in two digits does not resolve."""

NOT_SHOWN = "No wear is shown: something other than the gap may have changed."

Tone = Literal["fine", "watch", "act", "withheld", "note"]


@dataclass(frozen=True, slots=True)
class Advice:
    """A short order and why; ``tone`` decides the colour, never the meaning alone."""

    tone: Tone
    title: str
    sentences: tuple[str, ...]


def of_sweep(_: SweepSummary) -> Advice:
    """What the curve of a sweep is for."""
    return Advice(
        "note",
        "Use this curve for recordings of this joint.",
        (
            "Give it to a comparison: `bayesbl compare FIRST SECOND --curve result.nc`. "
            "It holds for a joint like the simulated bench, and for no other.",
        ),
    )


def of_plan(summary: PlanSummary) -> Advice:
    """What to record."""
    if summary["reason"]:
        return Advice("withheld", "Widen the limits.", (summary["reason"],))
    return Advice(
        "note",
        "Record the first motion of the table.",
        (
            "With the motor's speed and current, and the speed or position that the controller was "
            "asked for, at 1 kHz or so. Then: `bayesbl fit RECORDING --bench FILE`.",
        ),
    )


def of_study(summary: StudySummary) -> Advice:
    """Whether all cases of a study count."""
    failed = sum(int(row["failed"]) for row in summary["rows"])
    if failed:
        why = f"{failed} cases failed and are not in the numbers; result.nc says why."
        return Advice("watch", "Look at the cases that failed first.", (why,))
    return Advice("note", "Read the table below, row by row.", ("No case failed: all count.",))


def of_snapshots(summary: MeasuredSummary) -> Advice:
    """Whether and when to repair, by the last snapshot."""
    last = answer.snapshots(summary)[-1][1]
    if summary["outcome"] == "no_curve":
        return _of_ringing(summary)
    if last["delta_rad"] is None:
        again = "longer and at one constant speed"
        if "motion" in last:
            again = "the motion two times or more in a row"
        if torque_ramps.is_by_ramps(summary):
            again = "with the ramps that are asked for"
        elif two_encoders.is_by_two_encoders(summary):
            again = "with more reversals, slow and fast"
        return Advice(
            "withheld",
            "Do not decide from these recordings.",
            (
                *(why for label, why in answer.reasons(summary) if label == "Withheld"),
                f"Fix this, or record again, {again}; until then decide as you would without this "
                "measurement.",
            ),
        )
    compared = summary if summary["kind"] == "compare" else None
    rated = wear.with_rate(compared) if compared else None
    unless = joint_check.unless(compared) if compared else ""
    head = (_by_forecast(rated, last, unless) if rated else None) or _by_limit(summary, last)
    if answer.is_by_other_machine(summary):
        head = Advice("note", "Do not act on these gaps: they are of another machine's curve.", ())
    elif head is None:
        head = _without_limit(compared, rated)
    if answer.has_shrunk(summary) and head.tone != "act":
        title = "Are the files in order, or was the joint repaired?"
        head = Advice("watch", title, head.sentences)
    return Advice(head.tone, head.title, (*head.sentences, *_caveats(summary, last)))


def of_diagnosis(summary: DiagnosisSummary) -> Advice:
    """Whether the bench can be used, and how it should be completed."""
    withheld = summary.get("gap_withheld")
    if withheld and diagnosis.learned_of(summary) is None:
        return Advice("watch", "Correct the bench before you rely on it.", (withheld,))
    match summary["verdict"]:
        case "named" if diagnosis.has_augmented_bench(summary):
            return Advice("note", f"Go on with {AUGMENTED_BENCH}.", tuple(_go_on(summary)))
        case "named":
            names = ", ".join(in_words(effect["name"]) for effect in summary["effects"])
            return Advice(
                "note",
                "Complete the bench before you rely on it.",
                (f"Add to its file under [[effects]]: {names}. Then simulate and sweep again.",),
            )
        case "parameter_error":
            wrong = tuple(diagnosis.parameter_errors(summary))
            if diagnosis.has_augmented_bench(summary):
                title = f"Go on with {AUGMENTED_BENCH}."
                return Advice("note", title, (*wrong, *_go_on(summary)))
            return Advice("note", "Correct the bench before you rely on it.", wrong)
        case "unexplained" if diagnosis.has_augmented_bench(summary):
            return Advice("watch", f"Go on with {AUGMENTED_BENCH}.", tuple(_go_on(summary)))
        case "unexplained":
            return Advice(
                "watch",
                "Look at the residuals before you rely on the bench.",
                ("No effect of the catalogue explains them; the figures show where they are.",),
            )
        case _:
            return Advice(
                "fine", "The bench may be used as it is.", ("These recordings show no defect.",)
            )


def _of_ringing(summary: MeasuredSummary) -> Advice:
    """What to do about a ringing that no curve leads from to a gap."""
    if summary["kind"] == "compare" and not summary["same_joint"]["agrees"]:
        return Advice(
            "watch",
            "Find out what changed besides the gap.",
            (*summary["same_joint"]["sentences"], _why(summary)),
        )
    grew = summary["kind"] == "compare" and (summary["probability_ringing_grew"] or 0.0) >= SURE
    title = "The ringing grew: describe the joint in a bench file to learn by how much gap."
    if not grew:
        title = "Describe the joint in a bench file to learn the gap."
    return Advice("watch" if grew else "note", title, (_why(summary),))


def _why(summary: MeasuredSummary) -> str:
    return "" if summary["reason"] is None else summary["reason"]["text"]


def _by_forecast(found: WearSummary, last: SnapshotSummary, unless: str) -> Advice | None:
    """Until when no repair is due, where the limit is ahead.

    ``unless``: on what condition, if the growth could be something else.
    """
    above = last.get("probability_above_limit")
    if above is None or above > 1.0 - SURE:
        return None
    sentences = tuple(wear.sentences(found, unless=unless))
    if found["probability_wear"] < SURE or unless:
        return Advice("fine", "No repair is due, and no wear is shown.", sentences)
    earliest = wear.not_before(found)
    if earliest is None:
        return Advice("fine", "No repair is due for years.", sentences)
    asked = found["probability_before"]
    tone: Tone = "fine" if asked is None or asked["probability"] <= 1.0 - SURE else "watch"
    return Advice(tone, f"Plan the repair for {earliest} or before.", sentences)


def _by_limit(summary: MeasuredSummary, last: SnapshotSummary) -> Advice | None:
    """Repair or not, by the probability that the last gap is above its limit."""
    above, why = last.get("probability_above_limit"), answer.above_limit(summary)
    if above is None or why is None:
        return None
    if above >= SURE:
        return Advice("act", "The joint is due for repair.", (why,))
    if above <= 1.0 - SURE:
        return Advice("fine", "No repair is due.", (why,))
    again = "It may be on either side: inspect the joint, or record it again for longer."
    return Advice("watch", "Look at this joint soon.", (why, again))


def _without_limit(summary: ComparisonSummary | None, rated: WearSummary | None) -> Advice:
    ask = "To see whether a repair is due, give the gap at which it is (--limit-rad)."
    if rated is not None:
        if summary is not None and joint_check.other_cause(summary) is not None:
            return Advice("watch", NOT_SHOWN, (wear.headline(summary, rated), ask))
        if rated["probability_wear"] >= SURE:
            sentences = tuple(wear.sentences(rated))
            return Advice("watch", "The joint wears: keep measuring it.", (*sentences, ask))
        return Advice("fine", "No wear is shown: measure again later.", (ask,))
    if summary is not None and joint_check.other_cause(summary) is not None:
        return Advice("watch", NOT_SHOWN, (answer.headline(summary), ask))
    change = None if summary is None else summary["change_rad"]
    if change is None:
        return Advice("note", "Compare this gap with what the joint may have.", (ask,))
    if change["low"] > 0.0:
        return Advice("watch", "The joint wears: keep measuring it.", (ask,))
    why = "These recordings do not show that the gap grew."
    return Advice("fine", "No wear is shown: measure again later.", (why, ask))


def _caveats(summary: MeasuredSummary, last: SnapshotSummary) -> Iterator[str]:
    if summary["kind"] == "compare":
        yield from _caveats_of_change(summary, last)
    if answer.has_shrunk(summary):
        yield answer.SHRANK
    if answer.is_by_other_machine(summary):
        yield (
            "These gaps rest on the curve of another machine, the paper's test bench, at a speed "
            "that is assumed: describe your joint in a bench file (--bench) before you act on "
            "them. No probability of a limit, no rate and no date are given."
        )


def _caveats_of_change(summary: ComparisonSummary, last: SnapshotSummary) -> Iterator[str]:
    change, found = summary["change_rad"], summary["wear"]
    if found is None:
        shown = joint_check.other_cause(summary) is None
        if shown and change is not None and change["low"] > 0.0:
            yield from _growth_again(last, change["median"])
        return
    if found["reason"] is not None:
        yield found["reason"]["text"]
    if len(found["snapshots"]) == 2:
        yield "Two snapshots cannot show whether the wear is steady: take a third."


def _growth_again(last: SnapshotSummary, change_rad: float) -> Iterator[str]:
    """Where as much wear again would end, as long as the limit may be ahead."""
    limit_rad, above = last.get("limit_rad"), last.get("probability_above_limit")
    if limit_rad is None or above is None or above >= SURE or last["delta_rad"] is None:
        return
    further_rad = last["delta_rad"]["median"] + change_rad
    limit = f"limit of {1e3 * limit_rad:g} mrad"
    if abs(further_rad / limit_rad - 1.0) < CLOSE:
        place = f"close to its {limit}"
    else:
        where = "beyond" if further_rad > limit_rad else "still below"
        place = f"to about {1e3 * further_rad:.2g} mrad, {where} the {limit}"
    yield (
        f"As much growth again would bring the gap {place}. Give the recordings their dates "
        "(--date) for a forecast of when it is reached."
    )


def _go_on(summary: DiagnosisSummary) -> Iterator[str]:
    """What to do with the bench that the diagnosis wrote."""
    yield (
        f"{AUGMENTED_BENCH}, beside this page, is the bench with what was found, a bench file like "
        "any other."
    )
    if any(effect["indistinguishable_from"] for effect in summary["effects"]):
        yield "These recordings cannot tell all of it apart."
        yield from diagnosis.suggestion(summary)
    if diagnosis.learned_of(summary) and summary["delta_rad_after"] is None:
        return
    yield (
        "For a gap curve, copy configs/sweep.toml, name the bench and an output of your own there "
        f'(bench = "…/{AUGMENTED_BENCH}"), run `bayesbl sweep` on it, and give its result to a '
        "comparison: `--curve …/result.nc`"
    )
    yield (
        "To measure without a curve: `bayesbl compare FIRST SECOND --route direct --bench "
        f"{AUGMENTED_BENCH}`"
    )
