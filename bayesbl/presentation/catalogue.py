"""The catalogue of effects on the terminal: a list, or one entry in full."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesbl.presentation.terminal import add_row, new_table, print_table, say

if TYPE_CHECKING:
    from rich.console import Console

    from bayesbl.bench.effect_declaration import Effect


def print_catalogue(effects: tuple[Effect, ...], console: Console) -> None:
    """Each effect with where it enters and what it is."""
    for effect in effects:
        say(console, effect.sentence, label=f"{effect.name} ({effect.enters})")
    say(console, "bayesbl effects NAME shows one in full.", "dim")


def print_effect(effect: Effect, console: Console) -> None:
    """Everything that the catalogue says of one effect."""
    say(console, effect.name, "bold")
    lines = {
        "What": effect.sentence,
        "Equation": effect.equation,
        "Enters": effect.enters,
        "Depends on": ", ".join(effect.depends_on).replace("_", " "),
        "Repeats each load rotation": _repeats(effect),
        "In the data": effect.data,
        "Reference": effect.reference,
    }
    for label, text in lines.items():
        if text:
            say(console, text, label=label)
    table = new_table(
        ("Parameter", "left"),
        ("Unit", "left"),
        ("Low", "right"),
        ("High", "right"),
        ("Off or default", "right"),
    )
    for item in effect.parameters:
        unit = item.unit or "1"
        bounds = (f"{item.low:g}", f"{item.high:g}", f"{item.neutral:g}")
        add_row(table, item.name, unit, *(text.replace("-", "−") for text in bounds))
    print_table(table, console)
    for item in effect.parameters:
        say(console, item.meaning, "dim", label=item.name)


_REPEATS = {
    "always": "yes",
    "whole_orders": "with a whole number of cycles per load rotation",
    "never": "no",
}


def _repeats(effect: Effect) -> str:
    answers = {item.name: _REPEATS[item.repeats] for item in effect.amplitudes}
    if len(set(answers.values())) == 1:
        return next(iter(answers.values()))
    return ", ".join(f"{name}: {answer}" for name, answer in answers.items())
