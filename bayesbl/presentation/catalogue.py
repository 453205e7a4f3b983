"""The catalogue of effects: a list, or one entry in full."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation.blocks import Block, Sentence, numbers, table, text

if TYPE_CHECKING:
    from bayesbl.bench.effect_declaration import Effect


def catalogue(effects: Iterable[Effect]) -> Iterator[Block]:
    """Each effect with where it enters and what it is."""
    for effect in effects:
        yield Sentence(effect.sentence, label=f"{effect.name} ({effect.enters})")
    yield Sentence("bayesbl effects NAME shows one in full.", "aside")


def entry(effect: Effect) -> Iterator[Block]:
    """Everything that the catalogue says of one effect."""
    yield Sentence(effect.name, "answer")
    lines = {
        "What": effect.sentence,
        "Equation": effect.equation,
        "Enters": effect.enters,
        "Depends on": ", ".join(effect.depends_on).replace("_", " "),
        "Repeats each load rotation": _repeats(effect),
        "In the data": effect.data,
        "Reference": effect.reference,
    }
    for label, content in lines.items():
        if content:
            yield Sentence(content, label=label)
    rows = [
        (item.name, item.unit or "1", *map(_plain, (item.low, item.high, item.neutral)))
        for item in effect.parameters
    ]
    columns = (text("Parameter"), text("Unit"), *map(numbers, ("Low", "High", "Off or default")))
    yield table(columns, rows)
    for item in effect.parameters:
        yield Sentence(item.meaning, "aside", item.name)


def _plain(value: float) -> str:
    return f"{value:g}".replace("-", "−")


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
