"""What a result takes for granted, as sentences."""

from __future__ import annotations

from collections.abc import Iterator

from bayesbl.config.fields import PUBLISHED
from bayesbl.presentation import words
from bayesbl.presentation.words import Summary


def assumptions(summary: Summary) -> Iterator[str]:
    """Everything that has to hold for the numbers to mean what they say."""
    match summary["kind"]:
        case "fit" | "compare":
            yield from _of_snapshots(summary)
        case "sweep":
            yield "The simulated bench is a two-mass drive whose only play is one gap."
            yield "The joint has the bench's parameters, within their tolerances where it has any."
            yield "Measured recordings are fitted as these simulated ones were."
        case "diagnose":
            yield "What is missing, if anything, stands in the catalogue (bayesbl effects)."
            yield "Noise does not repeat; a named effect predicts what it was not fitted on."
            yield "The bench's other parameters hold what its file says, within their tolerances."
        case _:
            yield "Each case has random numbers of its own, from the seed, the row and its number."


def _of_snapshots(summary: Summary) -> Iterator[str]:
    parts = words.snapshots(summary)
    direct = parts[-1][1].get("route") == "direct"
    yield "The joint turned at one constant speed, and gravity changed flanks twice per rotation."
    if direct:
        yield "The joint behaves as its bench file says, within the tolerances given there."
    elif summary.get("curve") == PUBLISHED:
        yield "The joint rings as the paper's test bench does (curve published, eq. 4)."
    else:
        yield f"The joint rings as the bench of its gap curve does ({summary.get('curve')})."
    yield "Noise is what does not repeat from one rotation to the next; it stays alike throughout."
    yield "Before the recording every gap is as likely as any other in ln δ."
    if summary["kind"] == "compare":
        yield "Nothing but the gap changed between the snapshots: same joint, controller and load."
    found = parts[-1][1]["delta_rad"] or parts[-1][1].get("amplitude_rpm")
    if found is not None:
        yield (
            f"The {words.interval_kind(found)} is a credible interval: given all this, the value "
            f"lies in it with probability {100.0 * found['level']:g} %."
        )
