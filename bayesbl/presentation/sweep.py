"""Prints what a sweep found; what is said stands in ``words``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.presentation import words
from bayesbl.presentation.terminal import add_row, new_table, print_table, say
from bayesbl.presentation.words import Summary
from bayesbl.units import number

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def print_sweep(summary: Summary, console: Console) -> None:
    """The curve in words, its polynomial, and how well each degree describes the sweep."""
    say(console, words.swept(summary), "bold")
    for sentence in words.curve_quality(summary):
        say(console, sentence)
    print_table(_coefficient_table(summary), console)
    say(console, words.GAP_EXPLAINED, "dim")
    say(console, words.polynomial(summary), "dim")
    print_table(_degree_table(summary), console)
    say(console, words.DEGREES_EXPLAINED, "dim")


def _coefficient_table(summary: Summary) -> Table:
    table = new_table(("Term", "left"), ("Coefficient", "right"), ("Unit", "left"))
    for power, value in enumerate(summary["coefficients"]):
        term, unit = words.power_of_amplitude(power)
        add_row(table, term, f"{value:.6e}".replace("-", "−"), unit)
    return table


def _degree_table(summary: Summary) -> Table:
    table = new_table(
        ("Degree", "right"),
        ("RMS\ndeparture (%)", "right"),
        ("Largest\ndeparture (%)", "right"),
        ("Log evidence\nbelow best", "right"),
        ("", "left"),
    )
    best = max(found["log_evidence"] for found in summary["degrees"].values())
    for degree, found in summary["degrees"].items():
        add_row(
            table,
            degree,
            words.significant(100.0 * found["rms_departure"]),
            words.significant(100.0 * found["largest_departure"]),
            number(best - found["log_evidence"], 1),
            "used" if int(degree) == summary["degree"] else "",
        )
    return table
