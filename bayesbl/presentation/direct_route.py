"""What the direct route's results say beyond the answer: the other route, the bound, the check."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.terminal import add_row, new_table, print_table, say
from bayesbl.presentation.words import Summary

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def print_other_route(summary: Summary, console: Console) -> None:
    """What the amplitude and the gap curve make of the same recordings."""
    for name, part in words.snapshots(summary):
        say(console, words.by_amplitude(name, part["amplitude_route"]), "dim")


def print_direct_details(name: str, part: Summary, console: Console) -> None:
    """Every unknown with its interval and its bound, the predictive check, noise and sampling."""
    console.print()
    say(console, f"Snapshot {name}" if name else "Fit", "bold")
    print_table(_parameter_table(part), console)
    say(console, words.BOUND_EXPLAINED, "dim")
    print_table(_check_table(part), console)
    say(console, words.CHECK_EXPLAINED, "dim")
    lines = {
        "Noise": words.joint_noise(part),
        "Sampling": words.sampling(part),
        "Full simulation": words.corrected(part),
    }
    for label, sentence in lines.items():
        say(console, sentence, label=label)


def _parameter_table(part: Summary) -> Table:
    delta = part["delta_rad"]
    table = new_table(
        ("Parameter", "left"),
        ("Optimum", "right"),
        ("Posterior sd", "right"),
        ("Cramér-Rao", "right"),
        (words.short_kind(next(iter(part["parameters"].values()))), "right"),
    )
    for name, best in part["optimum"].items():
        found = delta if name == "delta_rad" else part["parameters"][name]
        add_row(
            table,
            name,
            "withheld" if found is None else f"{best:.6g}",
            words.significant(part["posterior_sd"][name], 3),
            words.significant(part["cramer_rao_sd"][name], 3),
            "withheld" if found is None else words.bounds(found, places=words.decimals(found)),
        )
    return table


def _check_table(part: Summary) -> Table:
    table = new_table(
        ("Channel", "left"),
        ("Load orders\nup to", "right"),
        ("Repeating\nover noise", "right"),
        ("Probability", "right"),
    )
    for entry in part["predictive_check"]:
        add_row(
            table,
            entry["channel"],
            str(entry["highest_order"] or "mean"),
            words.significant(entry["ratio"], 3),
            words.probability(entry["probability"]),
        )
    return table
