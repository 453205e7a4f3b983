"""Why what was identified cannot be used, in a sentence with a next step."""

from __future__ import annotations

from bayesbl.identification.identify import Identification, Problem
from bayesbl.units import in_words


def reason_of(found: Identification, problem: Problem, level: float = 0.9) -> str | None:
    """Why gaps and bench are withheld; ``None`` where they are not. ``level``: of the interval."""
    if found.beyond is not None:
        return beyond_in_words(found)
    if found.missing and problem.effects != "catalogue":
        names = " and ".join(" or ".join(map(in_words, members)) for members in found.missing)
        return (
            f"The bench lacks an effect that these recordings show: {names}. Let it be found "
            '(--effects catalogue, or effects = "catalogue" under [identify]), or add it to the '
            "data sheet under [[effects]]."
        )
    if found.verdict == "unexplained" or any(_stands_out(found)):
        return (
            "No values within the tolerances, no single value beyond its tolerance and no effect "
            "of the catalogue explains these recordings: something of the joint is not in the "
            "bench, several values of the data sheet are wrong, or the gap was not the same in "
            "all recordings (give their dates). Check the data sheet, or widen its tolerances."
        )
    if found.posterior.diagnostics.outcome == "withheld":
        return " ".join(found.posterior.diagnostics.reasons)
    gaps = [None] if problem.shares_gap else [seen.name for seen in problem.used]
    for gap in gaps:
        beyond = found.posterior.beyond_tolerance(gap, level)
        if beyond is not None:
            # The wrong value need not be the one that δ depends on: all at an edge are told.
            return " ".join([beyond, *found.posterior.diagnostics.reasons])
    return None


def beyond_in_words(found: Identification) -> str:
    """Which value of the data sheet is wrong, by how much, and what else it could be."""
    wrong = found.beyond
    assert wrong is not None
    text = (
        f"{wrong.name} lies {wrong.deviations:.0f} standard deviations outside its data sheet: "
        f"{wrong.found:.4g} by the recordings, {wrong.believed:.4g} ± {wrong.tolerance:.2g} there."
    )
    if wrong.could_be:
        text += f" It could also be {' or '.join(wrong.could_be)}."
    return text + " Correct the data sheet, or widen this tolerance, and identify again."


def _stands_out(found: Identification) -> list[bool]:
    """Whether anything still repeats although effects were named."""
    from bayesbl.identification.identify import FALSE_ALARM
    from bayesbl.matching.predictive_check import agrees

    return [found.completed and not agrees(list(found.check), FALSE_ALARM)]
