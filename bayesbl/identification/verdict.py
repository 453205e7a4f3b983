"""Why what was identified cannot be used, in a sentence with a next step."""

from __future__ import annotations

from collections.abc import Sequence

from bayesbl.bench.effects import with_bench_file_hint
from bayesbl.identification.identify import BeyondDataSheet, Identification
from bayesbl.matching.predictive_check import RepeatingPower, agrees, standing_out
from bayesbl.units import in_words


def reason_of(result: Identification) -> str | None:
    """Why gaps and bench are withheld; ``None`` where they are not."""
    if result.missing and not result.completed:
        return _lacking(result)
    if result.beyond is not None:
        return beyond_in_words(result.beyond)
    if (result.verdict == "unexplained" and not result.allows_for_misfit) or _stands_out(result):
        return (
            "No values within the tolerances, no single value beyond them and no effect of the "
            "catalogue explain these recordings: something of the joint is not in the bench, "
            "several values of the data sheet are wrong, or the gap was not the same in all "
            "recordings (give their dates). "
            f"{left_over(result.check)} Check the data sheet, or widen its tolerances."
        )
    if result.posterior.diagnostics.outcome == "withheld":
        return " ".join(result.posterior.diagnostics.reasons)
    # The bench is the answer: a value that its sheet excludes is none, whatever δ makes of it.
    if contradicted := result.posterior.contradicted:
        return " ".join(
            [*contradicted, "Correct the data sheet, or widen this tolerance, and identify again."]
        )
    return None


def misfit_in_words(result: Identification) -> list[str]:
    """What a user of gaps and bench must know of what nothing explains; empty without it."""
    if not result.allows_for_misfit:
        return []
    return [
        f"Something of the joint is not in the bench. {left_over(result.check)} All intervals "
        "include what that may do to them. `bayesbl diagnose` looks for what is missing."
    ]


def _lacking(result: Identification) -> str:
    names = " and ".join(" or ".join(map(in_words, members)) for members in result.missing)
    lacks = (
        f"The bench lacks an effect that these recordings show: {names}. Let it be found "
        '(--effects catalogue, or effects = "catalogue" under [identify]), or add it to the '
        "data sheet under [[effects]]."
    )
    return with_bench_file_hint(lacks, (members[0] for members in result.missing))


def beyond_in_words(wrong: BeyondDataSheet) -> str:
    """Which value of the data sheet is wrong, by how much, and what else it could be."""
    text = (
        f"{wrong.name} is {wrong.deviations:.0f} standard deviations outside its data sheet: "
        f"{wrong.found:.4g} by the recordings, {wrong.believed:.4g} ± {wrong.tolerance:.2g} there."
    )
    if wrong.could_be:
        text += f" It could also be {' or '.join(wrong.could_be)}."
    return text + " Correct the data sheet, or widen this tolerance, and identify again."


def left_over(check: Sequence[RepeatingPower]) -> str:
    """Where recording and simulation disagree most."""
    worst = max(standing_out(check) or check, key=lambda entry: entry.ratio)
    where = f"orders up to {worst.highest_order}" if worst.highest_order else "the mean"
    return (
        f"The disagreement is largest in {worst.channel} of {worst.recording}, {where}: "
        f"{worst.ratio:.3g} times the power expected from noise."
    )


def _stands_out(result: Identification) -> bool:
    """Whether anything still repeats although effects were named."""
    return result.completed and not agrees(result.check)
