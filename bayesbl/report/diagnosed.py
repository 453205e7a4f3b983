"""A diagnosis in words: what is missing, how sure that is, and how far the gap closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesbl.report import words
from bayesbl.report.output import add_row, new_table, print_table, say
from bayesbl.report.words import Summary

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_USES = {"used": "fitted on", "held_out": "held out"}


def print_diagnosis(summary: Summary, console: Console) -> None:
    """Verdict, one sentence per effect and parameter, the gaps, what still repeats."""
    say(console, headline(summary), "bold")
    for sentence in (*effects(summary), *parameter_errors(summary)):
        say(console, sentence)
    print_table(_gap_table(summary), console)
    for sentence in remaining(summary):
        say(console, sentence)


def headline(summary: Summary) -> str:
    """The verdict as a sentence."""
    names = [in_words(effect["name"]) for effect in summary["effects"]]
    match summary["verdict"]:
        case "named":
            listed = names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
            return f"Missing in the bench: {listed}."
        case "parameter_error":
            return "No effect is missing, but parameters of the bench are wrong."
        case "unexplained":
            return "Something repeats that no effect of the catalogue explains."
        case _:
            return "Nothing is missing: what is left does not repeat, or does not generalise."


def in_words(name: str) -> str:
    """``motor Coulomb friction``."""
    return name.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def effects(summary: Summary) -> Iterator[str]:
    """Each named effect with its parameters and what it cannot be told from."""
    for effect in summary["effects"]:
        parameters = ", ".join(
            f"{name} {_value(interval)}" for name, interval in effect["parameters"].items()
        )
        text = (
            f"{in_words(effect['name'])}: {parameters}; {effect['z']:.0f} standard deviations "
            "from nothing."
        )
        alike = effect["indistinguishable_from"]
        if alike:
            text += f" Not told apart from {', '.join(in_words(name) for name in alike)}."
        yield text[0].upper() + text[1:]


def parameter_errors(summary: Summary) -> Iterator[str]:
    """Parameters that do not hold what the bench file says."""
    for error in summary["parameter_errors"]:
        yield (
            f"{error['name']} is {_value(error['fitted'])}, not {error['believed']:.4g} ± "
            f"{error['tolerance']:.3g}."
        )


def remaining(summary: Summary) -> Iterator[str]:
    """What still repeats after naming."""
    unit = summary["gap"]["unit"]
    for line in summary["remaining"]:
        yield (
            f"What is left repeats {line['order']:.2f} times per turn of the motor, with "
            f"{words.significant(line['amplitude'])} {unit}."
        )


def _value(interval: dict[str, Any]) -> str:
    if interval["low"] is None:
        return f"{interval['median']:.4g}"
    return f"{interval['median']:.4g} ({interval['low']:.4g} to {interval['high']:.4g})"


def _gap_table(summary: Summary) -> Table:
    unit = summary["gap"]["unit"]
    table = new_table(
        ("Recording", "left"),
        ("Use", "left"),
        (f"Gap before\n({unit})", "right"),
        (f"after\n({unit})", "right"),
        (f"Noise floor\n({unit})", "right"),
        ("Closed", "right"),
    )
    for recording, channels in summary["gap"]["recordings"].items():
        for uses in channels.values():
            for use, gap in uses.items():
                _add_gap(table, recording, use, gap)
    for use, gap in summary["gap"]["over_all"].items():
        _add_gap(table, "all", use, gap)
    return table


def _add_gap(table: Table, recording: str, use: str, gap: dict[str, Any]) -> None:
    closed = gap["closed_fraction"]
    add_row(
        table,
        recording,
        _USES[use],
        *(f"{gap[name]:.3g}" for name in ("before", "after", "noise_floor")),
        "" if closed is None else f"{100.0 * closed:.1f} %",
    )
