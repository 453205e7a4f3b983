"""What comes with an answer from simulations of the bench: the bound, the check, the amplitude."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Sentence, Table, numbers, table, text

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import (
        MeasuredSummary,
        RouteSummary,
        SnapshotSummary,
    )

BOUND_EXPLAINED = (
    "Cramér-Rao: the smallest standard deviation that any unbiased estimate from these recordings "
    "can have without prior knowledge of the bench."
)

CHECK_EXPLAINED = (
    "Power of the difference between recording and simulation that repeats every rotation, over "
    "the power expected from noise; the probability that noise alone gives as much."
)


CHECK_OF_MOTION = (
    "Power of the difference between recording and simulation that repeats every cycle, or is slow "
    "where the motion does not repeat, over the power expected from noise; the probability that "
    "noise alone gives as much."
)


def is_direct(summary: MeasuredSummary) -> bool:
    """Whether the answer comes from simulations of the bench."""
    first = summary["snapshots"][0] if summary["kind"] == "compare" else summary
    return first["route"] == "direct"


def blocks(part: SnapshotSummary) -> Iterator[Block]:
    """Every unknown with its interval and its bound, the predictive check, noise and sampling."""
    yield _parameter_table(part)
    yield Sentence(BOUND_EXPLAINED, "aside")
    yield _check_table(part)
    yield Sentence(CHECK_OF_MOTION if "motion" in part else CHECK_EXPLAINED, "aside")
    lines = {
        "Noise": joint_noise(part),
        "Sampling": words.sampling(part),
        "Full simulation": simulated(part),
    }
    for label, sentence in lines.items():
        yield Sentence(sentence, label=label)


def joint_noise(part: SnapshotSummary) -> str:
    """``AR(1), standard deviation 1.51 rpm in speed, 0.0501 A in current``."""
    found = part["noise"]
    kind = f"AR({found['order']})" if found["order"] else "white"
    text = f"{kind}, standard deviation {found['sd_rpm']:.3g} rpm in speed"
    return text if found["sd_a"] is None else f"{text}, {found['sd_a']:.3g} A in current"


def simulated(part: SnapshotSummary) -> str:
    """What full simulations say of the draws of the surrogate."""
    found = part["diagnostics"]
    return (
        f"{found['effective_after_simulation']:.0f} effective draws by {found['simulated_draws']} "
        f"simulations, surrogate fitted again {found['surrogate_refits']} times"
    )


def beside(part: SnapshotSummary) -> str | None:
    """The route that was run beside the one that answers; ``None`` without one."""
    return next((route for route in part["routes"] if route != part["route"]), None)


def other_route(parts: Sequence[tuple[str, SnapshotSummary]]) -> Iterator[str]:
    """What the column of the other route rests on, and why it has no answer where it has none.

    ``parts``: name and summary of every snapshot.
    """
    route = beside(parts[0][1])
    if route is None:
        return
    if any(part["routes"][route]["delta_rad"] is not None for _, part in parts):
        yield f"For comparison {_by(route, parts[0][1]['routes'][route])}."
    reasons: dict[str, list[str]] = {}
    for name, part in parts:
        found = part["routes"][route]
        reason = found["reason"] or ""
        # Where it is why the other one answers, that has been said of the snapshot.
        if found["delta_rad"] is None and not any(
            reason in told for told in part["diagnostics"]["reasons"]
        ):
            reasons.setdefault(reason, []).append(name)
    for reason, names in reasons.items():
        yield f"No answer by {route}{words.of(*names)}: {reason}"


def _by(route: str, found: RouteSummary) -> str:
    if route == "direct":
        return "by direct simulations of the bench"
    curve = found.get("curve", "")
    belongs = " (that curve belongs to the paper's bench)" if curve == "published" else ""
    return f"by the ringing's amplitude and the curve of {Path(curve).name}{belongs}"


def _parameter_table(part: SnapshotSummary) -> Table:
    kind = words.short_kind(next(iter(part["parameters"].values())))
    titles = ("Optimum", "Posterior sd", "Cramér-Rao", kind)
    rows = [_row(part, name) for name in part["optimum"]]
    return table((text("Parameter"), *map(numbers, titles)), rows)


def _row(part: SnapshotSummary, name: str) -> tuple[str, ...]:
    found = part["delta_rad"] if name == "delta_rad" else part["parameters"][name]
    errors = (words.significant(part[key][name], 3) for key in ("posterior_sd", "cramer_rao_sd"))
    if found is None:
        return name, "withheld", *errors, "withheld"
    best = f"{part['optimum'][name]:.6g}"
    return name, best, *errors, words.bounds(found, places=words.decimals(found))


def _check_table(part: SnapshotSummary) -> Table:
    orders = "Orders of the\ncycle up to" if "motion" in part else "Load orders\nup to"
    titles = (orders, "Repeating\nover noise", "Probability")
    rows = [
        (
            entry["channel"],
            entry["highest_order"] or "mean",
            words.significant(entry["ratio"], 3),
            words.probability(entry["probability"]),
        )
        for entry in part["predictive_check"]
    ]
    return table((text("Channel"), *map(numbers, titles)), rows)
