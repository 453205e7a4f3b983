"""An identified bench in words: what was found, what was learned, what to record next."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Advice, Block, Sentence, Table, aside, table
from bayesbl.presentation.diagnosis import disagreement_table, effect_in_words
from bayesbl.units import in_words

if TYPE_CHECKING:
    from bayesbl.identification.groups import IdentificationSummary, TogetherSummary
    from bayesbl.identification.next_recording import NextRecordingSummary

LITTLE = 0.1  # A parameter of which less is learned is no better known than from its data sheet


def headline(summary: IdentificationSummary) -> str:
    """Whether the bench was identified."""
    if summary["outcome"] == "withheld":
        return "The bench is withheld: " + (
            summary["reason"] or "it does not explain the recordings."
        )
    if summary["verdict"] == "missing_effect":
        names = " and ".join(in_words(members[0]) for members in summary["missing"])
        return f"The bench is identified, with an addition to the data sheet: {names}."
    return "The bench is identified: it explains every recording to within noise."


def blocks(summary: IdentificationSummary) -> Iterator[Block]:
    """Gaps, parameters, what is only known together, the model error, what to record next."""
    for name, gap in summary["gaps"].items():
        if gap is not None:
            yield Sentence(f"The gap in {name} is {words.in_mrad(gap)}.")
    yield _parameters(summary)
    yield from map(Sentence, map(effect_in_words, summary["effects"]))
    is_found = summary["outcome"] != "withheld"
    for together in summary["not_told_apart"] if is_found else []:
        yield Sentence(_together(together))
    unlearned = [n for n, p in summary["parameters"].items() if p["learned"] < LITTLE]
    if unlearned and is_found:
        names = ", ".join(map(in_words, unlearned))
        yield Sentence(f"These recordings add nothing to the data sheet for: {names}.")
    yield disagreement_table(summary["disagreement"])
    yield aside(compared(summary))
    if summary["suggested_recording"] is not None and is_found:
        yield Sentence(suggestion(summary["suggested_recording"]))


def compared(summary: IdentificationSummary) -> str:
    """What before and after mean; a data sheet that no joint can have is not simulated."""
    overall = summary["disagreement"]["over_all"].values()
    if overall and all(part["before"] == part["after"] for part in overall):
        return (
            "The data sheet's values cannot be simulated, so before and after both mean the "
            "identified bench."
        )
    return "Before: the data sheet's values. After: the identified bench."


def suggestion(recording: NextRecordingSummary) -> str:
    """What to record next, and what it would show."""
    speed = abs(recording["reference_speed_rpm"])
    direction = "in reverse" if recording["reference_speed_rpm"] < 0.0 else "forward"
    what, length = f"one at {speed:g} rpm {direction}", "five rotations"
    if recording["motion_of"] is not None:
        what = f"the motion of {recording['motion_of']}, at up to {speed:g} rpm,"
        length = "as long as that one"
    name = "the gap" if recording["sharpens"] == "gap_rad" else in_words(recording["sharpens"])
    return (
        f"The most useful next recording is {what} ({length}: "
        f"{recording['information_bits']:.1f} bits). It would sharpen {name} most, from "
        f"{_percent(recording['sd_before'])} to {_percent(recording['sd_after'])} %."
    )


def advice(summary: IdentificationSummary) -> Advice:
    """How to use the bench."""
    if summary["outcome"] == "withheld":
        return Advice("watch", "Do not use this bench.", (summary["reason"] or "",))
    sentences = (
        "Measure later recordings with it: `bayesbl compare FIRST SECOND --bench RESULT`. RESULT "
        "is this result's folder; it keeps the correlations between the parameters.",
        "bench.toml, in that folder, is the same bench as a file with a tolerance for each "
        "parameter, without the correlations: it gives a wider interval of the gap.",
    )
    return Advice("fine", "Measure with this bench.", sentences)


ASSUMPTIONS = (
    "Each value has a normal prior around that of the data sheet, as wide as its tolerance.",
    "Each recording has a gap of its own.",
    "Nothing but the gap differs between the recordings: same controller and load.",
    "Noise does not repeat from one rotation to the next, and it is steady.",
)


def _parameters(summary: IdentificationSummary) -> Table:
    rows = []
    for name, parameter in summary["parameters"].items():
        prior, learned = parameter["prior"], max(0.0, 100.0 * parameter["learned"])
        half = prior["high"] - prior["value"]
        tolerance = f"± {words.significant(half, 2)}"
        if prior["value"]:
            tolerance = f"±{100.0 * half / abs(prior['value']):.0f} %"
        sheet = f"{words.significant(prior['value'], 3)} {tolerance}"
        found = words.with_ends(parameter["posterior"], 3)
        rows.append((in_words(name), sheet, found, parameter["unit"], f"{learned:.0f} %"))
    level = next(iter(summary["parameters"].values()))["posterior"]["level"]
    identified = f"#Identified ({100.0 * level:g} % interval)"
    return table(("Parameter", "#Data sheet", identified, "Unit", "#Learned"), rows)


def _together(group: TogetherSummary) -> str:
    names = [in_words(name) for name in group["parameters"]]
    alone, together = _percent(group["alone_sd"]), _percent(group["together_sd"])
    if group["told"] == "product":
        return (
            f"Only the product of {names[0]} and {names[1]} is known well: to {together} %, each "
            f"factor to {alone} %."
        )
    ratio = f"ratio of {' / '.join(names)} is"
    if len(names) > 2:
        ratio = f"ratios of {', '.join(names)} are"
    return (
        f"Only the {ratio} known well: to {together} % or better, each value to {alone} %. A "
        "factor common to all hardly changes these recordings."
    )


def _percent(sd: float) -> str:
    return f"{100.0 * sd:.2g}"
